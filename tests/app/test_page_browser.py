"""The page in a real Chromium: loading, camera images, pushing with the mouse, and stopping with the keyboard."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from mouse import grab, pull, pushed
from playwright.sync_api import expect
from vclient import VClient, until

from app.browser import opened
from app.serve.main import Page

pytestmark = pytest.mark.browser
ELBOW, BALL = "/robot/link_4", "/gizmos/ball"
ARROW = 0.13
"""A point of an arrow of the ball's gizmo, outside of the ball [m]."""

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


NOTES_MODES = """() => {
  window.modes = [];
  new MutationObserver(() => {
    const mode = document.querySelector("#eb-banner")?.dataset.mode;
    if (mode && mode !== window.modes.at(-1)) window.modes.push(mode);
  }).observe(document, {subtree: true, childList: true, attributes: true});
}"""


def softly_then_hard(tab: Any) -> bool:
    """Pull the elbow until the arm relaxes, hold it so, pull on until it aborts, let go; whether it did each in turn."""
    tab.mouse.up()
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "idle")
    tab.evaluate("() => { window.modes = []; }")
    at = grab(tab, ELBOW)
    if not pull(tab, at, (2.0, 0.0), "b.mode === 'relax'"):
        return False
    soft = not pull(tab, at, (0.0, 0.0), "b.mode !== 'relax'", most=5)
    if not (soft and pull(tab, at, (4.0, 0.0), "b.mode === 'abort'")):
        return False
    tab.mouse.up()
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "idle")
    return True


def test_a_soft_pull_relaxes_a_harder_one_aborts_and_letting_go_ends_both(tab: Any) -> None:
    tab.evaluate(NOTES_MODES)
    # The page lets go when its browser falls silent, as one on a busy machine without graphics may: then once more.
    assert any(softly_then_hard(tab) for _ in range(4)), tab.evaluate("() => window.modes")
    modes = [mode for mode in tab.evaluate("() => window.modes") if mode in ("relax", "abort")]
    assert modes[0] == "relax", "and not only after an abort"
    assert "abort" in modes, "an arm that gives way may be idle between two times of relaxing, so perhaps not as the second"
    expect(tab.locator("#eb-banner")).to_have_attribute("data-truth", "0.00")


def test_a_drag_with_ctrl_pulls_too(tab: Any) -> None:
    tab.keyboard.down("Control")
    assert any(pull(tab, grab(tab, ELBOW), (2.0, 0.0), "b.truth > 5") for _ in range(4))
    tab.mouse.up()
    tab.keyboard.up("Control")
    expect(tab.locator("#eb-banner")).to_have_attribute("data-truth", "0.00")


def killed(flag: str) -> int:
    """SIGKILL every process with this word in its command line; how many there were."""
    pids = [int(folder.name) for folder in Path("/proc").glob("[0-9]*") if flag in _command(folder)]
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    return len(pids)


def _command(folder: Path) -> str:
    try:
        return (folder / "cmdline").read_text()
    except OSError:  # it has just ended
        return ""


def test_a_browser_that_is_killed_in_mid_drag_lets_go_and_frees_the_seat(
        another: Callable[..., Any], served: Page, raw: VClient) -> None:
    raw.hand_back()
    flag = f"--elbowroom-{os.getpid()}"
    tab = opened(another(flag), served.url)
    assert any(pull(tab, grab(tab, ELBOW), (2.0, 0.0), "b.truth > 8") for _ in range(4))
    assert served.guard.seat.operator is not None
    assert float(raw.banner()["truth"]) > 0.0
    assert killed(flag)
    until(lambda: float(raw.banner()["truth"]) == 0.0 and served.guard.seat.operator is None)
    until(lambda: raw.banner()["mode"] == "idle")


def test_the_ball_is_dragged_into_the_arm_by_its_gizmo(tab: Any, raw: VClient) -> None:
    beside = raw.position(ELBOW) + np.array([0.0, 0.25, 0.0])
    raw.gizmo(BALL, beside.tolist())
    until(lambda: np.linalg.norm(raw.position("/obstacles/ball") - beside) < 0.02)
    raw.hand_back()
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "idle")
    expect(tab.locator("#eb-banner")).to_have_attribute("data-truth", "0.00")

    def brought() -> bool:
        tab.mouse.up()
        tab.keyboard.press("1")  # a drag that missed the arrow has turned the view
        return pull(tab, grab(tab, BALL, (0.0, ARROW, 0.0)), (-6.0, 0.0), "b.truth > 5", most=40)

    assert any(brought() for _ in range(3)), "the ball never pressed on the arm"
    tab.mouse.up()


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


def test_policy_lets_the_page_work_and_talk_to_no_other_host(
        new_tab: Callable[..., Any], served: Page, raw: VClient) -> None:
    raw.hand_back()
    tab, asked, errors = new_tab(), set[str](), list[str]()
    tab.add_init_script(f"({COVERS})()")
    tab.on("pageerror", lambda error: errors.append(error.message))
    tab.on("request", lambda request: asked.add(urlsplit(request.url).netloc))
    reply = tab.goto(f"{served.url}?fixedDpr=0.25", wait_until="commit")
    assert "default-src 'none'" in reply.headers["content-security-policy"]
    tab.wait_for_function("() => window.__viserMutable?.nodeRefFromName?.['/robot/link_7']")
    expect(tab.locator('img[src^="blob:"]')).to_have_count(3)
    tab.wait_for_function("() => [...document.querySelectorAll('img[src^=\"blob:\"]')].every(i => i.naturalWidth > 100)")
    assert errors == []
    tab.evaluate("() => fetch('http://192.0.2.1/').catch(() => null)")  # to see that a violation would be noticed
    tab.wait_for_function("() => window.broken.length > 0")
    # The client's sorter of Gaussian splats wants eval; there are none on this page.
    assert set(tab.evaluate("() => window.broken")) - {"script-src eval"} == {"connect-src http://192.0.2.1/"}
    assert asked <= {urlsplit(served.url).netloc, ""}


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
