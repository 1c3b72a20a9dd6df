"""The page under test: one server with one cell for the whole session, and clients that come and go."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from small_campaign import SHORT
from target import TOKEN, WATCH
from vclient import PATIENCE, VClient, until

from app.browser import COARSE, FLAGS, PATIENCE_MS, VIEWPORT, executable

if TYPE_CHECKING:
    from app.serve.main import Page


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if isinstance(item, pytest.Function) and {"served", "keyed", "browser"} & set(item.fixturenames):
            item.add_marker(pytest.mark.live)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    report = yield
    setattr(item, f"report_{report.when}", report)
    return report


@pytest.fixture(scope="session", autouse=True)
def all_pictures() -> Iterator[None]:
    """A page of these tests shares its process with its visitors: what those spend is not the page's, and slows no picture."""
    from app.serve import tempo

    stock, tempo.SHARE = tempo.SHARE, 100.0
    yield
    tempo.SHARE = stock


@pytest.fixture(scope="session")
def pem(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Certificate and key for this machine."""
    folder = tmp_path_factory.mktemp("tls")
    cert, key = folder / "cert.pem", folder / "key.pem"
    try:
        subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                        "-keyout", key, "-out", cert, "-days", "2", "-subj", "/CN=localhost", "-addext",
                        "subjectAltName=DNS:localhost,IP:127.0.0.1"], check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("openssl is not on this machine")
    return cert, key


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[Page]":
    from app.serve.access import Access  # here, so that tests of the command line do not wait for all that it loads
    from app.serve.main import Page

    page = Page("free", Access(port=0), say=lambda _: None, recordings=tmp_path_factory.mktemp("page") / "recordings")
    page.start()
    yield page
    page.close()


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[Page]":
    """What `keyed` lets run."""
    from app.serve.access import Access
    from app.serve.keys import Keys
    from app.serve.main import Page

    recordings = tmp_path_factory.mktemp("keyed") / "recordings"
    page = Page("free", Access(port=0, keys=Keys(TOKEN, WATCH)), say=lambda _: None, recordings=recordings)
    page.start()
    yield page
    page.close()


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """The file of a campaign of a few short episodes."""
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


@pytest.fixture
def serve() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Starts the page on a port, in a process of its own, with more options if need be."""
    started: list[subprocess.Popen[bytes]] = []

    def start(port: int, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "app", "serve", "--port", str(port), *options]
        started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture
def moving(served: "Page") -> "Iterator[Page]":
    """The page whose cell runs: while no test looks at it, it leaves the cores to pages of other tests."""
    with _running(served):
        yield served


@pytest.fixture
def keyed(locked: "Page") -> "Iterator[Page]":
    """A page that asks for a token: target.TOKEN of who may drive, target.WATCH of who may watch; its cell runs likewise."""
    with _running(locked):
        yield locked


@contextlib.contextmanager
def _running(page: "Page") -> Iterator[None]:
    page.session.paused = False
    try:
        yield
    finally:
        page.session.paused = True


@pytest.fixture
def raw(moving: "Page") -> Iterator[VClient]:
    """A client of the freshly reset page, with the arm on its path; it drives."""
    with contextlib.closing(VClient(moving.server.get_port())) as client:
        until(client.ready.is_set)
        until(lambda: client.banner()["mode"] not in ("starting", "failed"), 120.0)
        until(lambda: client.seat())
        until(lambda: client.seat()["operator"] == "" or client.drives())  # whoever was there before is leaving
        client.click("Resume") if client.banner()["mode"] == "stop" else None
        until(lambda: float(client.banner()["time"]) > 0.3)
        before = float(client.banner()["time"])
        client.set("Simulation", "Reset")
        until(lambda: float(client.banner()["time"]) < before)
        until(lambda: client.banner()["mode"] == "idle" and float(client.banner()["time"]) > 0.3)
        yield client


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    path = executable()
    if path is None:
        message = "no Chromium on this machine: the browser tests need one (Debian: apt install chromium)"
        pytest.fail(message) if os.environ.get("CI") == "true" else pytest.skip(message)
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=1e3 * PATIENCE)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, headless=True, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def chromium(browser: Any) -> Iterator[Any]:
    """A browser whose tabs end with the test, however it ends: one that were left would take the cores from all that follow."""
    yield browser
    for context in browser.contexts:
        context.close()


@pytest.fixture
def another(browser: Any) -> Iterator[Callable[..., Any]]:
    """Starts a browser beside it, with more flags; it ends with the test."""
    with contextlib.ExitStack() as started:
        yield lambda *flags: started.enter_context(
            browser.browser_type.launch(executable_path=executable(), headless=True, args=[*FLAGS, *flags]))


@pytest.fixture
def new_tab(chromium: Any) -> Callable[..., Any]:
    """Makes an empty tab of a visitor whom the browser has not seen before; with the options of a context, if need be."""

    def new(**options: Any) -> Any:
        context = chromium.new_context(**{"viewport": VIEWPORT, **options})
        context.set_default_timeout(1e3 * PATIENCE)
        return context.new_page()

    return new


@pytest.fixture
def tab(new_tab: Callable[..., Any], served: "Page", raw: VClient, request: Any, tmp_path: Path) -> Iterator[Any]:
    """A browser tab with the page loaded and the robot drawn; small and coarse, because a CPU renders it. `raw` has given
    up the seat, so that whoever acts first drives.
    """
    raw.hand_back()
    tab, console = new_tab(), []
    tab.on("console", lambda message: console.append(f"{message.type}: {message.text}"))
    tab.on("pageerror", lambda error: console.append(f"pageerror: {error}"))
    tab.goto(f"{served.url}?{COARSE}", wait_until="commit")
    tab.wait_for_selector("#eb-banner", timeout=PATIENCE_MS)
    tab.wait_for_function("() => window.__viserMutable?.nodeRefFromName?.['/robot/link_7']", timeout=PATIENCE_MS)
    yield tab
    if request.node.report_call.failed and not tab.is_closed():
        tab.screenshot(path=str(tmp_path / "page.png"))
        (tmp_path / "console.txt").write_text("\n".join(console))
        print(f"screenshot and console: {tmp_path}")
