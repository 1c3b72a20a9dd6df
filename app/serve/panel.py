"""The left dock: banner, STOP, the run, tabs for contact, obstacles, view and log. Callbacks only hand things on."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import viser

from app.serve.banner import banner, facts
from app.serve.commands import Commands
from app.serve.demo import Demo
from app.serve.driver import Driver
from app.serve.inputs import Inputs
from app.serve.journal import Journal
from app.serve.obstacles import ObstacleControls
from app.serve.placing import CameraControls
from app.serve.recordings import RecordingControls
from app.serve.results import ResultsView
from app.serve.scene import VIEWS
from app.serve.steering import Steering
from app.serve.theme import Theme
from app.serve.tuning import Tuning
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Event, Resume, Stop
from hrc.messages import Mode, Snapshot

SHORTCUTS = {"control.f_relax": "F_relax", "control.f_abort": "F_abort", "push.stiffness": "Push stiffness",
             "exposure.region": "Touches the"}
"""Parameters that stand on the first tab too, and their labels there."""
UNPLUGGED = "sensor.unplugged"
PLAY = ("Pause", "Play")
STEP_TICKS = 10
HINT = """<div class="eb-hint"><button aria-label="Do not show this again">&times;</button>
<p><b>Push:</b> drag a link of the arm with the mouse.</p>
<p><b>Steer:</b> choose the task <i>follow</i>, drag the arrows.</p>
<p><b>Bring an obstacle:</b> drag the blue ball into the arm.</p></div>"""
HELP = '<div class="eb-small"><a href="/app/help.html" target="_blank">What is this? The page explained</a></div>'
NO_SAFETY = '<div class="eb-small">Stops the simulated arm. Not a safety function.</div>'
WIDTH = 320


class Panel:
    """The widgets, and how they follow the cell.

    for_all: what every visitor may use, whoever drives. seat: the folder in which each is told who does.
    """

    def __init__(self, server: viser.ViserServer, session: Driver, *, scenarios: Sequence[str], scenario: str,
                 config: Config, look: Callable[[viser.ClientHandle, str], None],
                 layers: Mapping[str, Callable[[bool], None]], obstacles: ObstacleControls, placing: CameraControls,
                 steering: Steering, tuning: Tuning, demo: Demo, theme: Theme, recordings: RecordingControls, journal: Journal,
                 results: ResultsView | None = None) -> None:
        """look: moves one browser's view. layers: what can be shown or not, by its label."""
        self._server, self._session, self._journal, self._config = server, session, journal, config
        self._inputs, self._tuning, self._demo = Inputs(server, config, session.put, journal.refuse), tuning, demo
        self._recordings = recordings
        self._beat, self._shown = 0, scenario
        self.for_all: list[Any] = []
        gui = server.gui
        gui.main_panel.dock_left()
        gui.main_panel.set_width(WIDTH)
        self._banner = gui.add_html(banner(facts(session, None, config), 0))
        self._stop = gui.add_button("STOP (Esc)", color="red", icon=viser.Icon.HAND_STOP,
                                    hint="The arm stands still until Resume")
        self._resume = gui.add_button("Resume", color="green", icon=viser.Icon.PLAYER_PLAY, visible=False)
        gui.add_html(NO_SAFETY)
        self.seat = gui.add_folder("Who drives")
        gui.add_html(HINT)
        demo.add()
        gui.add_html(HELP)
        with gui.add_folder("Run"):
            self._run = gui.add_button_group("Simulation", (PLAY[0], "Step", "Reset"))
            self._speed = gui.add_slider("Speed", min=0.1, max=2.0, step=0.1, initial_value=1.0,
                                         hint="Simulated seconds per second")
            self._scenario = gui.add_dropdown("Scenario", tuple(scenarios), initial_value=scenario,
                                              hint="A choice starts a new cell")
            steering.add_task(config)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Contact", viser.Icon.HAND_FINGER):
            for key, label in SHORTCUTS.items():
                self._inputs.add(key, label)
        with tabs.add_tab("Obstacles", viser.Icon.BALL_FOOTBALL):
            obstacles.add_boxes()
        with tabs.add_tab("Posture", viser.Icon.STRETCHING):
            steering.add_posture()
        with tabs.add_tab("View", viser.Icon.EYE):
            self._add_view(look, layers, placing, theme)
            if results is not None:
                results.add()
        with tabs.add_tab("Parameters", viser.Icon.ADJUSTMENTS):
            tuning.add(self._inputs)
        with tabs.add_tab("Record", viser.Icon.PLAYER_RECORD):
            recordings.add()
        with tabs.add_tab("Log", viser.Icon.LIST):
            self._log = gui.add_html(journal.html())
        self._connect(look, theme)

    def update(self, snapshot: Snapshot | None) -> None:
        """Banner and buttons, as things are now."""
        self._beat += 1
        known = facts(self._session, snapshot, self._config)
        self._banner.content = banner(known, self._beat)
        self._resume.visible = known.mode == Mode.STOP.value
        if self._session.scenario not in ("", self._shown):  # a visitor chose it here, or it was opened in another way
            self._shown = self._scenario.value = self._session.scenario
        self._run.options = (PLAY[self._session.paused], "Step", "Reset")

    def update_log(self, snapshot: Snapshot | None) -> None:
        """The log and the recording, if they have changed."""
        self._recordings.update(snapshot)
        self._log.content = self._journal.html()

    def show_parameters(self, config: Config) -> None:
        """Set the widgets to what the cell has: after a start, a reset, or a change that it did not take."""
        self._config = self._tuning.config = config
        self._inputs.show(config)

    def _add_view(self, look: Callable[[viser.ClientHandle, str], None],
                  layers: Mapping[str, Callable[[bool], None]], placing: CameraControls, theme: Theme) -> None:
        gui = self._server.gui
        views = gui.add_button_group("Look from", tuple(VIEWS), hint="The keys 1, 2 and 3 do the same")
        brightness = gui.add_button("Light or dark", icon=viser.Icon.SUN_MOON, hint="The page of this visitor (L)")
        self.for_all += [views, brightness]

        async def on_look(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                look(event.client, event.target.value)

        def on_update(show: Callable[[bool], None]) -> Callable[[Any], Any]:
            async def switch(event: viser.GuiEvent[Any]) -> None:
                show(event.target.value)

            return switch

        async def light(event: viser.GuiEvent[Any]) -> None:
            self._server.scene.configure_default_lights(cast_shadow=event.target.value)

        async def on_brightness(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                theme.toggle(event.client)

        views.on_click(on_look)
        brightness.on_click(on_brightness)
        for label, show in layers.items():
            gui.add_checkbox(label, True).on_update(on_update(show))
        placing.add_box()
        self._inputs.add(UNPLUGGED, "Unplug the cameras")
        gui.add_checkbox("Shadows", False, hint="Costly without a graphics card").on_update(light)

    def _connect(self, look: Callable[[viser.ClientHandle, str], None], theme: Theme) -> None:
        async def stop(_: Any) -> None:
            self._put(Stop())

        async def resume(_: Any) -> None:
            self._put(Resume())

        async def run(event: viser.GuiEvent[Any]) -> None:
            choice = event.target.value
            if choice in PLAY:
                self._session.paused = choice == PLAY[0]
            elif choice == "Step":
                self._session.step(STEP_TICKS)
            else:
                self._try(self._session.reset)

        async def speed(event: viser.GuiEvent[Any]) -> None:
            self._session.speed = event.target.value

        async def scenario(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                self._session.open(event.target.value)

        self._stop.on_click(stop)
        self._resume.on_click(resume)
        self._run.on_click(run)
        self._speed.on_update(speed)
        self._scenario.on_update(scenario)
        commands = Commands(self._server)
        commands.add("Stop the arm", lambda _: self._put(Stop()), icon=viser.Icon.HAND_STOP, for_all=True)
        commands.add("Resume", lambda _: self._put(Resume()), "R", icon=viser.Icon.PLAYER_PLAY)
        commands.add("Pause or play", lambda _: self._toggle_pause(), "P", icon=viser.Icon.PLAYER_PAUSE)
        commands.add("Step", lambda _: self._session.step(STEP_TICKS), "N", icon=viser.Icon.PLAYER_TRACK_NEXT)
        commands.add("Reset", lambda _: self._try(self._session.reset), "backspace", icon=viser.Icon.REFRESH)
        commands.add("Guided demo", lambda _: self._demo.toggle(), "G", icon=viser.Icon.PRESENTATION)
        commands.add("All parameters to default", lambda _: self._tuning.reset(), icon=viser.Icon.ARROW_BACK_UP)
        for key, view in enumerate(VIEWS, start=1):
            commands.add(f"Look from: {view}", lambda client, view=view: look(client, view), str(key),
                         icon=viser.Icon.CAMERA, for_all=True)
        commands.add("Light or dark", theme.toggle, "L", icon=viser.Icon.SUN_MOON, for_all=True)
        self.for_all += [self._stop, *commands.for_all]

    def _toggle_pause(self) -> None:
        self._session.paused = not self._session.paused

    def _put(self, event: Event) -> None:
        self._try(lambda: self._session.put(event))

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except HrcError as error:
            self._journal.refuse(str(error))
