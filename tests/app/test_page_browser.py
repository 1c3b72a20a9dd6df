"""The page in a real Chromium: loading, camera images, pushing with the mouse, and stopping with the keyboard."""

from typing import Any
from urllib.parse import urlsplit

import pytest
from mouse import pushed
from playwright.sync_api import expect
from vclient import VClient, until

from app.serve.main import Page

pytestmark = pytest.mark.browser

COVERS = """() => {
  window.broken = [];
  document.addEventListener("securitypolicyviolation", (e) => window.broken.push(`${e.violatedDirective} ${e.blockedURI}`));
}"""
WHILE_A_SLIDER_MOVES = """() => {
  const slider = document.querySelector("[role=slider]");
  const press = (target, key) =>
    target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  press(slider, "ArrowRight");
  press(slider, "ArrowLeft");
  press(document.body, "Escape");
  press(slider, "ArrowRight");
  press(slider, "ArrowLeft");
}"""


def test_pushing_a_link_with_the_mouse_shows_relax_or_abort(tab: Any) -> None:
    expect(tab).to_have_title("Elbowroom")
    banner = tab.locator("#eb-banner")
    expect(banner).to_have_attribute("data-mode", "idle")
    # The page lets go when its browser falls silent, as one on a busy machine without graphics may: then grab again.
    assert any(pushed(tab) for _ in range(6)), "the banner never said RELAX or ABORT"
    tab.mouse.up()
    expect(banner).to_have_attribute("data-truth", "0.00")
    expect(banner).to_have_attribute("data-mode", "idle")


def test_three_camera_images_are_on_the_page_and_live(tab: Any) -> None:
    images = tab.locator('img[src^="blob:"]')
    expect(images).to_have_count(3)
    for label in ("Depth image", "Robot as expected", "What is left"):
        expect(tab.get_by_text(label, exact=True)).to_be_visible()
    boxes = [images.nth(i).bounding_box() for i in range(3)]
    assert boxes[0]["y"] == boxes[1]["y"], "measured and expected side by side"
    assert all(box["width"] > 100 for box in boxes)
    tab.wait_for_function("() => [...document.querySelectorAll('img[src^=\"blob:\"]')].every(i => i.naturalWidth > 100)")
    first = images.first.get_attribute("src")
    expect(images.first).not_to_have_attribute("src", first)


def test_escape_stops_the_arm_from_anywhere_and_it_stays_stopped(tab: Any) -> None:
    banner, resume = tab.locator("#eb-banner"), tab.get_by_role("button", name="Resume")
    expect(banner).to_have_attribute("data-mode", "idle")
    tab.keyboard.press("Escape")
    expect(banner).to_have_attribute("data-mode", "stop")
    stopped_at = float(banner.get_attribute("data-time"))
    tab.wait_for_function(f"() => Number(document.querySelector('#eb-banner').dataset.time) > {stopped_at + 1.0}")
    expect(banner).to_have_attribute("data-mode", "stop")
    resume.click()
    expect(banner).to_have_attribute("data-mode", "idle")
    slider = tab.locator("label", has_text="F_abort").locator("xpath=ancestor::div[contains(@class,'Flex-root')][1]")
    slider.locator("input:not([type=hidden])").last.focus()
    tab.keyboard.press("Escape")
    expect(banner).to_have_attribute("data-mode", "stop")
    resume.click()
    expect(banner).to_have_attribute("data-mode", "idle")
    tab.evaluate(WHILE_A_SLIDER_MOVES)
    expect(banner).to_have_attribute("data-mode", "stop")
    resume.click()
    expect(banner).to_have_attribute("data-mode", "idle")


def test_policy_lets_the_page_work_and_talk_to_no_other_host(chromium: Any, served: Page, raw: VClient) -> None:
    raw.hand_back()
    context, asked = chromium.new_context(viewport={"width": 1000, "height": 620}), set[str]()
    context.add_init_script(f"({COVERS})()")
    tab = context.new_page()
    tab.on("request", lambda request: asked.add(urlsplit(request.url).netloc))
    reply = tab.goto(f"{served.url}?fixedDpr=0.25", wait_until="commit")
    assert "default-src 'none'" in reply.headers["content-security-policy"]
    tab.wait_for_function("() => window.__viserMutable?.nodeRefFromName?.['/robot/link_7']", timeout=30_000)
    expect(tab.locator('img[src^="blob:"]')).to_have_count(3)
    tab.wait_for_function("() => [...document.querySelectorAll('img[src^=\"blob:\"]')].every(i => i.naturalWidth > 100)")
    tab.evaluate("() => fetch('http://192.0.2.1/').catch(() => null)")  # to see that a violation would be noticed
    tab.wait_for_function("() => window.broken.length > 0")
    # The client's sorter of Gaussian splats wants eval; there are none on this page.
    assert set(tab.evaluate("() => window.broken")) - {"script-src eval"} == {"connect-src http://192.0.2.1/"}
    assert asked <= {urlsplit(served.url).netloc, ""}
    context.close()


def test_second_visitor_watches_until_it_is_handed_the_seat(tab: Any, raw: VClient) -> None:
    raw.set("Speed", 1.0)
    until(raw.drives)
    seat = tab.locator("#eb-seat")
    expect(seat).to_have_attribute("data-role", "visitor")
    assert not pushed(tab)
    tab.mouse.up()
    expect(tab.locator("#eb-banner")).to_have_attribute("data-truth", "0.00")
    tab.get_by_role("button", name="Take control").click()
    until(lambda: raw.gui[raw.widget("Hand over")]["props"]["visible"])
    raw.click("Hand over")
    expect(seat).to_have_attribute("data-role", "operator")
    expect(seat).to_contain_text("You drive")
    assert any(pushed(tab) for _ in range(6))
    tab.mouse.up()
