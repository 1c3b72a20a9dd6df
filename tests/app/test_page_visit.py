"""A visit to the page in a real Chromium: its keys, its help, a phone, a browser without WebGL."""

import http.client
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mouse import ON_SCREEN, next_banner
from playwright.sync_api import expect
from vclient import VClient

from app.browser import COARSE, VIEWPORT
from app.serve.main import Page
from app.settings import read

pytestmark = pytest.mark.browser

DRAWN = "() => window.__viserMutable?.nodeRefFromName?.['/robot/link_7']"
FULL_IMAGES = "() => [...document.querySelectorAll('img[src^=\"blob:\"]')].every(image => image.naturalWidth > 100)"
SCHEME = "() => document.documentElement.dataset.mantineColorScheme"


def later(tab: Any, seconds: float = 0.3) -> None:
    """Wait until the banner shows a later time: the page is alive."""
    now = float(tab.locator("#eb-banner").get_attribute("data-time"))
    tab.wait_for_function(f"() => Number(document.querySelector('#eb-banner').dataset.time) > {now + seconds}")


def hover(tab: Any, x: float, y: float) -> None:
    """Rest the mouse on what is there, as a person does: the page finds out what it is in one of its next pictures."""
    tab.mouse.move(x, y)
    next_banner(tab)
    next_banner(tab)


def test_keys_palette_theme_hint_and_settings_file(tab: Any, tmp_path: Path) -> None:
    banner, hint = tab.locator("#eb-banner"), tab.locator(".eb-hint")
    expect(hint.locator("p")).to_have_count(3)
    expect(hint).to_be_visible()
    hint.get_by_role("button").click()
    expect(hint).to_be_hidden()
    tab.keyboard.press("p")
    expect(banner).to_have_attribute("data-paused", "true")
    next_banner(tab)
    next_banner(tab)  # it stands by now
    paused_at = float(banner.get_attribute("data-time"))
    tab.keyboard.press("n")
    expect(banner).to_have_attribute("data-time", f"{paused_at + 0.01:.3f}")
    tab.keyboard.press("p")
    expect(banner).to_have_attribute("data-paused", "false")
    later(tab, 1.0)
    before = banner.get_attribute("data-time")
    tab.keyboard.press("Backspace")
    tab.wait_for_function(f"() => Number(document.querySelector('#eb-banner').dataset.time) < {before}")
    assert tab.evaluate(SCHEME) == "dark"
    tab.keyboard.press("Control+k")
    tab.get_by_placeholder("Search commands").fill("light")
    tab.keyboard.press("Enter")
    tab.wait_for_function(f"() => ({SCHEME})() === 'light'")
    assert all(channel > 200 for channel in _colour(tab, ".mantine-Paper-root"))
    tab.get_by_role("tab", name="Parameters").click()
    with tab.expect_download() as download:
        tab.get_by_role("button", name="Save settings").click()
    download.value.save_as(tmp_path / "saved.toml")
    assert read(tmp_path / "saved.toml") == []
    tab.reload(wait_until="commit")
    expect(banner).to_have_attribute("data-mode", "idle")
    expect(hint).to_be_hidden()


def _colour(tab: Any, selector: str) -> list[int]:
    text = tab.locator(selector).first.evaluate("(element) => getComputedStyle(element).backgroundColor")
    return [int(channel) for channel in text[text.index("(") + 1 : -1].split(",")[:3]]


def test_a_click_on_a_link_shows_its_numbers_and_dragging_it_still_pushes(tab: Any, raw: VClient) -> None:
    banner, numbers = tab.locator("#eb-banner"), tab.locator("#eb-numbers")
    tab.get_by_role("tab", name="Numbers").click()
    tab.keyboard.press("p")
    expect(banner).to_have_attribute("data-paused", "true")
    next_banner(tab)
    next_banner(tab)  # what is drawn stands by now, however long the browser takes from one look to the next click
    for link, point in (("link_4", [0.0, 0.0, 0.0]), ("link_2", [0.0, 0.0, 0.1])):
        x, y = tab.evaluate(ON_SCREEN, [f"/robot/{link}", point])
        hover(tab, x, y)
        tab.mouse.click(x, y)
        expect(numbers).to_have_attribute("data-link", link)
    tab.keyboard.press("p")
    expect(banner).to_have_attribute("data-paused", "false")
    assert float(banner.get_attribute("data-truth")) == 0.0
    hover(tab, x, y)
    tab.mouse.down()
    tab.mouse.move(x + 10, y)
    for i in range(200):  # the page lets go of a mouse that is held still while its browser is silent
        tab.mouse.move(x + 60 + i % 2, y)
        if float(raw.banner()["truth"]) > 5.0:
            break
    else:
        pytest.fail("the drag did not push")
    tab.mouse.up()
    expect(banner).to_have_attribute("data-truth", "0.00")


def test_on_a_phone_the_sheet_is_as_wide_as_the_screen_and_the_arm_above_it(
        new_tab: Callable[..., Any], served: Page, raw: VClient) -> None:
    raw.hand_back()
    tab = new_tab(viewport={"width": 390, "height": 844}, is_mobile=True, has_touch=True)
    tab.goto(f"{served.url}?{COARSE}", wait_until="commit")
    tab.wait_for_function(DRAWN)
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "idle")
    stop = tab.get_by_role("button", name="STOP")
    expect(stop).to_be_in_viewport()
    sheet = tab.evaluate("() => document.querySelector('#eb-banner').getBoundingClientRect().toJSON()")
    assert sheet["width"] > 350
    for link in ("/robot/link_2", "/robot/link_4", "/robot/link_7"):
        x, y = tab.evaluate(ON_SCREEN, [link, [0.0, 0.0, 0.0]])
        assert 0 < x < 390
        assert 0 < y < sheet["y"] - 40
    stop.tap()
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "stop")
    tab.get_by_role("button", name="Resume").tap()
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "idle")


def test_without_webgl_the_page_says_so_and_all_else_works(another: Callable[..., Any], served: Page, raw: VClient) -> None:
    raw.hand_back()
    tab = another("--disable-3d-apis").new_context(viewport=VIEWPORT).new_page()
    tab.goto(served.url, wait_until="commit")
    banner = tab.locator("#eb-banner")
    expect(banner).to_have_attribute("data-mode", "idle")
    expect(tab.get_by_role("alert").filter(has_text="no WebGL")).to_be_visible()
    later(tab)
    expect(tab.locator('img[src^="blob:"]')).to_have_count(3)
    tab.wait_for_function(FULL_IMAGES)
    tab.wait_for_function("() => document.querySelector('.uplot canvas')?.width > 100")
    tab.keyboard.press("Escape")
    expect(banner).to_have_attribute("data-mode", "stop")
    tab.get_by_role("button", name="Resume").click()
    expect(banner).to_have_attribute("data-mode", "idle")


def test_help_is_served_with_each_equation(served: Page) -> None:
    def got(path: str) -> str:
        connection = http.client.HTTPConnection("127.0.0.1", served.server.get_port(), timeout=5)
        connection.request("GET", path)
        reply = connection.getresponse()
        assert reply.status == 200, path
        return reply.read().decode()

    text = got("/app/help.html")
    for equation in range(1, 16):
        assert f"({equation})" in text
    for asset in re.findall(r'(?:src|href)="(/[^"]+)"', text):
        assert got(asset)
