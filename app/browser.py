"""A headless Chromium, for measurements, soaks and tests of the page. It draws on the CPU: a floor for its rates."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing",
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows"]
"""WebGL on the CPU; the panels are put together by plain copying, as any Chromium without a GPU does it by itself. Through
WebGL's emulation they took all of a core, and a tab of two went without a picture for seconds."""
VIEWPORT: Any = {"width": 1000, "height": 620}
PATIENCE_MS = 180_000
"""How long a page may take to be there: a browser that gives way to the server on two slow cores takes over a minute."""
COARSE = "fixedDpr=0.25"
"""Asks the page for few pixels, because a CPU draws them."""
ASIDE = """#!/bin/sh
echo 19 2>/dev/null >/proc/self/autogroup
exec nice -n 19 {} "$@"
"""
"""Where the kernel shares the cores out by session, a process's own niceness counts within its session only."""
LATE = """() => {
  window.late = [];
  let seen = null;
  new MutationObserver(() => {
    const data = document.querySelector("#eb-banner")?.dataset;
    if (!data || data.beat === seen) return;
    seen = data.beat;
    window.late.push(performance.timeOrigin + performance.now() - 1000 * Number(data.sent));
    if (window.late.length > 20000) window.late.shift();
  }).observe(document, {subtree: true, childList: true, attributes: true});
}"""
"""Notes for each banner how long after it was published it stood in the page [ms]; both clocks are this machine's."""


def executable() -> str | None:
    """The path of an installed Chromium, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@contextmanager
def launched(*flags: str, aside: bool = False) -> "Iterator[Browser]":
    """A running one. flags: beside FLAGS. aside: it gives way to whoever else wants the cores, as if it ran elsewhere.

    Raises ModuleNotFoundError without playwright, FileNotFoundError without a Chromium.
    """
    from playwright.sync_api import sync_playwright

    path = executable()
    if path is None:
        raise FileNotFoundError("no Chromium on this machine (Debian: apt install chromium)")
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        if aside:
            script = Path(folder) / "chromium"
            script.write_text(ASIDE.format(path))
            script.chmod(0o700)
            path = str(script)
        browser = playwright.chromium.launch(executable_path=path, headless=True, args=[*FLAGS, *flags])
        try:
            yield browser
        finally:
            browser.close()


def opened(browser: "Browser", url: str, watch: "Callable[[Page], None]" = lambda _: None) -> "Page":
    """A tab with the page loaded and the robot drawn. url: with its token, where there is one. watch: sees the tab before.

    Raises TimeoutError if that takes longer than PATIENCE_MS.
    """
    from playwright.sync_api import TimeoutError as LateError

    tab = browser.new_context(viewport=VIEWPORT).new_page()
    watch(tab)
    tab.add_init_script(f"({LATE})()")
    try:
        tab.goto(f"{url}{'&' if '?' in url else '?'}{COARSE}", wait_until="commit", timeout=PATIENCE_MS)
        tab.wait_for_selector("#eb-banner", timeout=PATIENCE_MS)
        tab.wait_for_function("() => window.__viserMutable?.nodeRefFromName?.['/robot/link_7']", timeout=PATIENCE_MS)
    except LateError:
        raise TimeoutError(f"Chromium has not drawn the page within {PATIENCE_MS / 1e3:.0f} s: "
                           "the machine is busy with something else, or too slow") from None
    return tab


def delays(tab: "Page") -> list[float]:
    """How long after their publication the banners since the last call stood in the page [s]."""
    return [0.001 * ms for ms in tab.evaluate("() => window.late.splice(0)")]
