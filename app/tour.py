"""`elbowroom tour`: a picture of every main screen of the page, and a film, taken from the real page in a headless Chromium."""

import io
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from app.browser import executable, launched
from app.output import folder
from app.serve.access import Access
from app.serve.main import Page
from app.serve.recordings import START
from app.serve.results import LABEL
from hrc.cell.eyes import CameraSetup, rig
from hrc.errors import HrcError
from hrc.events import Event, MoveCamera, MoveObstacle, MoveTarget, Pull, Release, RemoveObstacle, Resume, SetTask
from hrc.geometry import apply, inverse
from hrc.messages import Snapshot

if TYPE_CHECKING:
    from playwright.sync_api import Page as Tab

DESKTOP, PHONE = (1280, 800), (390, 844)
READY = "() => window.__viserMutable?.nodeRefFromName?.['/robot/link_7']"
FADED_IN = "() => getComputedStyle(document.querySelector('.mantine-Spotlight-content')).opacity === '1'"
PATIENCE = 90_000
"""For anything on the page [ms]; a CPU draws it."""
FILM, FILM_SIZE, FILM_FPS, FILM_LENGTH = "film.webp", (1100, 600), 8, 17.0
"""Frames a second at most, and length [s]: of simulated time, which the film shows as it is."""
FILM_SPEED = 0.1
"""It is taken ten times slower, because a CPU draws it."""


@dataclass
class Stage:
    """What a screen is made on. look: the newest snapshot."""

    page: Page
    tab: "Tab"
    look: Callable[[], Snapshot]

    def put(self, *events: Event) -> None:
        """Let something happen in the cell."""
        for event in events:
            self.page.session.put(event)

    def until(self, condition: str) -> None:
        """Wait for the banner's data `b`, as "b.mode === 'relax'"."""
        self.tab.wait_for_function(f"() => {{ const b = document.querySelector('#eb-banner').dataset; return {condition}; }}",
                                   timeout=PATIENCE)

    def settle(self, seconds: float = 1.0) -> None:
        """Let simulated time pass, and the page draw it."""
        self.until(f"Number(b.time) > {float(self.look().time) + seconds}")

    def open_tab(self, name: str) -> None:
        """Bring a tab to the front."""
        self.tab.get_by_role("tab", name=name).click()

    def pull(self, distance: float) -> None:
        """Hold the elbow and pull it sideways [m]."""
        T = self.look().T_world_link[4]
        held = T[:3, 3] + np.array([0.06, 0.0, 0.0])
        x, y, z = apply(inverse(T), held).tolist()
        self.put(Pull(4, (x, y, z), (float(held[0]), float(held[1]) + distance, float(held[2]))))


def _start(stage: Stage) -> None:
    stage.until("b.mode === 'idle' && b.time > 4")
    stage.settle(3.0)  # the lights come on slowly


def _obstacle(stage: Stage) -> None:
    stage.put(MoveObstacle("ball", (-0.3, 0.4, 0.6)))
    stage.until("b.clearance < 0.25")
    stage.settle()
    stage.put(MoveObstacle("ball", (-0.35, 0.55, 0.35)))


def _figure(stage: Stage) -> None:
    stage.open_tab("Obstacles")
    stage.put(MoveObstacle("figure", (-0.95, 0.45, 0.45)), MoveObstacle("forearm", (0.15, 0.45, 0.5)))
    stage.tab.get_by_text("Figure", exact=True).scroll_into_view_if_needed()
    stage.settle(1.5)


def _relax(stage: Stage) -> None:
    stage.put(RemoveObstacle("figure"), RemoveObstacle("forearm"))
    stage.open_tab("Contact")
    stage.pull(0.15)
    stage.until("b.mode === 'relax' && b.force > 8")


def _numbers(stage: Stage) -> None:
    stage.open_tab("Numbers")
    stage.settle()


def _abort(stage: Stage) -> None:
    stage.open_tab("Signals")
    stage.pull(0.5)
    stage.until("b.mode === 'abort' && b.force > 20")
    stage.settle()


def _follow(stage: Stage) -> None:
    stage.put(Release())
    stage.until("b.mode === 'idle'")
    stage.put(SetTask("follow"))
    stage.until("b.task === 'follow' && b.off < 0.005")
    x, y, z = stage.look().command.x.tolist()
    stage.put(MoveTarget((x, y + 0.15, z + 0.1)))
    stage.settle(0.8)


def _posture(stage: Stage) -> None:
    stage.open_tab("Posture")
    stage.tab.get_by_text("Copy the arm's posture").scroll_into_view_if_needed()
    stage.settle()


def _view(stage: Stage) -> None:
    stage.open_tab("View")
    stage.tab.get_by_label("Move the depth sensor").check()
    stage.tab.get_by_role("button", name="Side", exact=True).click()
    stage.put(MoveCamera(_camera(stage).name, (0.5, 1.0, 1.1), (-0.3, 0.0, 0.4)))
    stage.settle(2.0)


def _record(stage: Stage) -> None:
    setup = _camera(stage)
    stage.put(MoveCamera(setup.name, setup.camera.eye, setup.camera.target))
    stage.tab.get_by_label("Move the depth sensor").uncheck()
    stage.tab.get_by_role("button", name="Sensor", exact=True).click()
    stage.open_tab("Record")
    stage.tab.get_by_role("button", name=START, exact=True).click()
    stage.tab.wait_for_selector("#eb-recording[data-recording=true]", timeout=PATIENCE)
    stage.settle(4.0)


def _camera(stage: Stage) -> CameraSetup:
    config = stage.page.session.config
    assert config is not None, "the cell runs"
    return rig(config)[0]


def _parameters(stage: Stage) -> None:
    stage.open_tab("Parameters")
    stage.tab.get_by_text("observer", exact=True).click()
    stage.tab.get_by_text("accelerating", exact=True).scroll_into_view_if_needed()
    stage.settle()


def _stop(stage: Stage) -> None:
    stage.open_tab("Log")
    stage.tab.keyboard.press("Escape")
    stage.until("b.mode === 'stop'")
    stage.settle()


def _light(stage: Stage) -> None:
    stage.put(Resume(), SetTask("hexagon"))
    stage.open_tab("Contact")
    stage.tab.keyboard.press("l")
    stage.settle()


def _palette(stage: Stage) -> None:
    stage.tab.keyboard.press("l")
    stage.tab.keyboard.press("Control+k")
    stage.tab.get_by_text("Look from: Top").wait_for()
    stage.tab.wait_for_function(FADED_IN)


def _demo(stage: Stage) -> None:
    stage.tab.get_by_placeholder("Search commands").fill("guided")
    stage.tab.keyboard.press("Enter")
    stage.tab.wait_for_selector('.eb-caption[data-step="3"]')
    stage.settle()


def _results(stage: Stage) -> None:
    stage.page.session.reset()
    stage.open_tab("View")
    stage.tab.get_by_label(LABEL).click()
    stage.tab.get_by_role("option").nth(1).click()
    stage.tab.wait_for_selector("#eb-results")
    stage.tab.locator("#eb-results").scroll_into_view_if_needed()
    stage.settle(3.0)


def _help(stage: Stage) -> None:
    stage.tab.goto(stage.page.url + "app/help.html")


SCREENS: dict[str, Callable[[Stage], None]] = {
    "start": _start, "obstacle": _obstacle, "figure": _figure, "relax": _relax, "numbers": _numbers, "abort": _abort,
    "follow": _follow, "posture": _posture, "view": _view, "record": _record, "parameters": _parameters, "stop": _stop,
    "light": _light, "commands": _palette, "demo": _demo, "results": _results, "help": _help}
"""On the desktop, in this order; each goes on from the one before. "results" needs those of a campaign."""
FURTHER_DOWN = ("figure", "posture", "view", "record", "results", "parameters", "stop")
"""Screens of what stands far down in the left dock; the others begin with the banner."""
ALSO = (("phone", PHONE, ()), ("no_webgl", DESKTOP, ("--disable-3d-apis",)))
"""Others: name, size of the window, flags of the browser."""


def tour(out: Path, *, film: bool = False, results: Path | None = None) -> None:
    """Write a picture of every screen as NAME.webp, and with `film` the guided demo as an animation.

    results: folder of a campaign, to show on the robot; without it that screen is left out.

    Raises HrcError without Chromium, or if the folder is there.
    """
    if executable() is None:
        raise HrcError("the tour needs a Chromium, and there is none on this machine (Debian: apt install chromium)")
    with folder(out) as partial, _served(results) as (page, look):
        _desktop(page, look, partial, [name for name in SCREENS if results is not None or name != "results"])
        page.session.reset()
        for name, size, flags in ALSO:
            with launched(*flags) as browser:
                _take(_opened(browser, page.url, size, drawn=not flags), partial / f"{name}.webp")
        if film:
            _film(page, look, partial / FILM)


@contextmanager
def _served(results: Path | None) -> Iterator[tuple[Page, Callable[[], Snapshot]]]:
    def look() -> Snapshot:
        assert page.latest is not None  # a screen is made when the robot is drawn
        return page.latest

    with TemporaryDirectory() as recordings:
        page = Page("free", Access(port=0), say=lambda _: None, recordings=Path(recordings), results=results)
        page.start()
        try:
            yield page, look
        finally:
            page.close()


def _opened(browser: Any, url: str, size: tuple[int, int], *, drawn: bool = True) -> "Tab":
    width, height = size
    phone = size == PHONE
    tab = browser.new_context(viewport={"width": width, "height": height}, is_mobile=phone, has_touch=phone).new_page()
    tab.set_default_timeout(PATIENCE)
    tab.goto(f"{url}?fixedDpr=1", wait_until="commit")
    tab.wait_for_selector("#eb-banner[data-mode=idle]")
    if drawn:
        tab.wait_for_function(READY)
    # That a CPU draws it need not be said in the picture.
    tab.locator(".mantine-Notification-closeButton").evaluate_all("(buttons) => buttons.forEach((button) => button.click())")
    tab.wait_for_timeout(1500)
    return tab


def _take(tab: "Tab", file: Path) -> None:
    Image.open(io.BytesIO(tab.screenshot())).convert("RGB").save(file, quality=80, method=6)
    print(file.name, flush=True)


def _desktop(page: Page, look: Callable[[], Snapshot], out: Path, names: Sequence[str]) -> None:
    with launched() as browser:
        stage = Stage(page, _opened(browser, page.url, DESKTOP), look)
        for name in names:
            SCREENS[name](stage)
            if name not in FURTHER_DOWN:
                stage.tab.evaluate("() => document.querySelector('#eb-banner')?.scrollIntoView()")
            _take(stage.tab, out / f"{name}.webp")


def _film(page: Page, look: Callable[[], Snapshot], file: Path) -> None:
    """The guided demo from its second caption to its sixth."""
    with launched() as browser:
        stage, frames = Stage(page, _opened(browser, page.url, FILM_SIZE), look), []
        # The real-time factor of the filming is not the arm's.
        stage.tab.add_style_tag(content=".eb-line span + span, .eb-hint { display: none }")
        stage.tab.get_by_role("button", name="Guided demo").click()
        stage.tab.wait_for_selector('.eb-caption[data-step="2"]')
        page.session.speed = FILM_SPEED
        begun = look().time
        times, due = list[float](), begun
        while look().time < begun + FILM_LENGTH:
            if look().time >= due:
                times.append(look().time)
                frames.append(Image.open(io.BytesIO(stage.tab.screenshot())).convert("RGB"))
                due = max(due + 1.0 / FILM_FPS, times[-1])
            time.sleep(0.01)
        page.session.speed = 1.0
    shown = [round(1000.0 * (then - now)) for now, then in zip(times, [*times[1:], times[-1] + 1.0], strict=True)]
    frames[0].save(file, save_all=True, append_images=frames[1:], duration=shown, loop=0, quality=45, method=4)
    print(f"{file.name}: {len(frames)} frames, {file.stat().st_size / 1e6:.1f} MB")
