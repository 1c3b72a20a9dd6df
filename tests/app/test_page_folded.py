"""The page with its panels folded away, and a link from elsewhere: what must hold whatever is on the screen."""

import http.server
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect
from process import answers, free_port
from target import TOKEN
from vclient import VClient, until

from app.serve.main import Page

pytestmark = pytest.mark.browser
PHONE = {"width": 390, "height": 780}


def fold(tab: Any) -> None:
    """Put the left dock away: the banner is not in the document any more."""
    tab.locator('[data-dock-region-handle="left"]').click()
    expect(tab.locator("#eb-banner")).to_have_count(0)


def test_escape_stops_the_arm_with_the_panel_folded_away(tab: Any, raw: VClient) -> None:
    fold(tab)
    tab.keyboard.press("Escape")
    until(lambda: raw.banner()["mode"] == "stop")
    raw.click("Resume")
    until(lambda: raw.banner()["mode"] == "idle")


@pytest.mark.parametrize("phone", [False, True])
def test_page_says_that_it_is_stale_with_its_panel_folded_away(
        new_tab: Callable[..., Any], serve: Callable[[int], subprocess.Popen[bytes]], phone: bool) -> None:
    port = free_port()
    server = serve(port)
    until(lambda: answers(port))
    tab = new_tab(viewport=PHONE if phone else {"width": 800, "height": 500})
    tab.goto(f"http://127.0.0.1:{port}/?fixedDpr=0.25", wait_until="commit")
    expect(tab.locator("#eb-banner")).to_have_attribute("data-mode", "idle")
    if phone:
        tab.get_by_text("Elbowroom", exact=True).last.click()
        expect(tab.locator("#eb-banner")).to_be_hidden()
    else:
        fold(tab)
    lost = tab.locator(".eb-lost")
    expect(lost).to_be_hidden()
    server.send_signal(signal.SIGKILL)
    expect(lost).to_be_visible()
    assert "WHAT YOU SEE IS OLD" in lost.inner_text()
    serve(port)
    expect(lost).to_be_hidden()


@pytest.fixture
def elsewhere() -> Iterator[Callable[[str], str]]:
    """The address of a page of another site that links to an address."""
    links: list[str] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(f'<a href="{links[-1]}">the robot</a>'.encode())

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing."""

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()

        def page(link: str) -> str:
            links.append(link)
            return f"http://localhost:{server.server_address[1]}/"

        yield page
        server.shutdown()


def test_a_link_with_a_token_opens_from_another_site(
        new_tab: Callable[..., Any], keyed: Page, elsewhere: Callable[[str], str]) -> None:
    tab = new_tab()
    tab.goto(elsewhere(f"http://127.0.0.1:{keyed.server.get_port()}/?token={TOKEN}&fixedDpr=0.25"))
    tab.get_by_text("the robot").click()
    expect(tab.locator("#eb-banner")).to_be_visible()
    assert "token" not in tab.url


def test_a_file_that_is_too_large_or_empty_is_named_and_the_button_stays(tab: Any, tmp_path: Path) -> None:
    tab.get_by_role("tab", name="Parameters").click()
    told: list[str] = []
    tab.on("dialog", lambda dialog: (told.append(dialog.message), dialog.accept()))
    for size in (0, 40_000):
        file = tmp_path / f"of_{size}.toml"
        file.write_bytes(b"#" * size)
        tab.locator("input[type=file]").first.set_input_files(file)
        until(lambda name=file.name: told and name in told[-1])
    assert "at most 32768" in told[-1]
    expect(tab.get_by_role("button", name="Load settings")).to_be_enabled()
