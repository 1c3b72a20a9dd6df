"""The left dock: banner, STOP, the run, tabs for contact, obstacles, view and log. Callbacks only hand things on."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import viser

from app.serve.banner import banner, facts
from app.serve.journal import Journal
from app.serve.obstacles import ObstacleControls
from app.serve.scene import VIEWS
from app.serve.session import Session
from app.serve.steering import Steering
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Event, Resume, SetParameter, Stop
from hrc.messages import Mode, Snapshot
from hrc.parameters import field_of, keys

SLIDERS = {"control.f_relax": "F_relax", "control.f_abort": "F_abort", "push.stiffness": "Push stiffness"}
UNPLUGGED, REGION = "sensor.unplugged", "exposure.region"
PLAY = ("Pause", "Play")
STEP_TICKS = 10
HINT = """<ul class="eb-hint">
<li><b>Push the arm:</b> drag a link with the left mouse button. Gently it gives way, hard it abandons
its task. The arm goes on along its path while the hand stays: move with it.</li>
<li><b>Steer:</b> choose the task <i>follow</i> and drag the arrows at the tool, or use the arrow keys.</li>
<li><b>Bring an obstacle:</b> drag the blue ball, or its arrows, into the arm: the depth camera sees it.</li>
<li><b>Look around:</b> drag the background; the wheel zooms. <b>Esc</b> stops the arm.</li></ul>"""
NO_SAFETY = '<div class="eb-small">Stops the simulated arm. Not a safety function.</div>'
WIDTH = 320


class Panel:
    """The widgets, and how they follow the cell.

    for_all: what every visitor may use, whoever drives. seat: the folder in which each is told who does.
    """

    def __init__(self, server: viser.ViserServer, session: Session, *, scenarios: Sequence[str], scenario: str,
                 config: Config, look: Callable[[viser.ClientHandle, str], None],
                 layers: Mapping[str, Callable[[bool], None]], obstacles: ObstacleControls, steering: Steering,
                 journal: Journal) -> None:
        """look: moves one browser's view. layers: what can be shown or not, by its label."""
        self._server, self._session, self._journal, self._config = server, session, journal, config
        self._beat = 0
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
        with gui.add_folder("Run"):
            self._run = gui.add_button_group("Simulation", (PLAY[0], "Step", "Reset"))
            self._speed = gui.add_slider("Speed", min=0.1, max=2.0, step=0.1, initial_value=1.0,
                                         hint="Simulated seconds per second")
            self._scenario = gui.add_dropdown("Scenario", tuple(scenarios), initial_value=scenario,
                                              hint="A choice starts a new cell")
            steering.add_task(config)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Contact", viser.Icon.HAND_FINGER):
            self._inputs: dict[str, viser.GuiInputHandle[Any]] = {
                key: self._slider(config, key, label) for key, label in SLIDERS.items()}
            self._inputs[REGION] = self._choice(REGION, "Touches the")
        with tabs.add_tab("Obstacles", viser.Icon.BALL_FOOTBALL):
            obstacles.add_boxes()
        with tabs.add_tab("Posture", viser.Icon.STRETCHING):
            steering.add_posture()
        with tabs.add_tab("View", viser.Icon.EYE):
            self._add_view(look, layers)
        with tabs.add_tab("Log", viser.Icon.LIST):
            self._log = gui.add_html(journal.html())
        self._connect()

    def update(self, snapshot: Snapshot | None) -> None:
        """Banner and buttons, as things are now."""
        self._beat += 1
        known = facts(self._session, snapshot, self._config)
        self._banner.content = banner(known, self._beat)
        self._resume.visible = known.mode == Mode.STOP.value
        self._run.options = (PLAY[self._session.paused], "Step", "Reset")

    def update_log(self) -> None:
        """The log, if it has changed."""
        self._log.content = self._journal.html()

    def show_parameters(self, config: Config) -> None:
        """Set the widgets to what the cell has: after a start, a reset, or a change that it did not take."""
        self._config = config
        values = keys(config)
        for key, widget in self._inputs.items():
            widget.value = values[key]

    def _slider(self, config: Config, key: str, label: str) -> viser.GuiSliderHandle[float]:
        """A slider made from the parameter's field: range, unit, and its docstring as the tooltip."""
        field, (group, name) = field_of(config, key), key.split(".")
        low, high, unit = field.metadata["low"], field.metadata["high"], field.metadata["unit"]
        slider = self._server.gui.add_slider(
            f"{label} [{unit}]", min=low, max=high, step=0.5 if high - low < 200.0 else 10.0,
            initial_value=keys(config)[key], hint=type(getattr(config, group)).docs()[name])
        slider.on_update(self._sets(key))
        return slider

    def _checkbox(self, key: str, label: str) -> viser.GuiCheckboxHandle:
        group, name = key.split(".")
        box = self._server.gui.add_checkbox(label, keys(self._config)[key],
                                            hint=type(getattr(self._config, group)).docs()[name])
        box.on_update(self._sets(key))
        return box

    def _choice(self, key: str, label: str) -> viser.GuiDropdownHandle[str]:
        field, (group, name) = field_of(self._config, key), key.split(".")
        choice = self._server.gui.add_dropdown(label, field.metadata["options"], initial_value=keys(self._config)[key],
                                               hint=type(getattr(self._config, group)).docs()[name])
        choice.on_update(self._sets(key))
        return choice

    def _sets(self, key: str) -> Callable[[Any], Any]:
        async def on_update(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:  # else it was set by `show_parameters`
                self._put(SetParameter(key, event.target.value))

        return on_update

    def _add_view(self, look: Callable[[viser.ClientHandle, str], None],
                  layers: Mapping[str, Callable[[bool], None]]) -> None:
        gui = self._server.gui
        views = gui.add_button_group("Look from", tuple(VIEWS))
        self.for_all.append(views)

        async def on_look(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                look(event.client, event.target.value)

        def on_update(show: Callable[[bool], None]) -> Callable[[Any], Any]:
            async def switch(event: viser.GuiEvent[Any]) -> None:
                show(event.target.value)

            return switch

        async def light(event: viser.GuiEvent[Any]) -> None:
            self._server.scene.configure_default_lights(cast_shadow=event.target.value)

        views.on_click(on_look)
        for label, show in layers.items():
            gui.add_checkbox(label, True).on_update(on_update(show))
        self._inputs[UNPLUGGED] = self._checkbox(UNPLUGGED, "Unplug the cameras")
        gui.add_checkbox("Shadows", False, hint="Costly without a graphics card").on_update(light)

    def _connect(self) -> None:
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
        command = self._server.gui.add_command("Stop the arm", icon=viser.Icon.HAND_STOP)
        command.on_trigger(stop)
        self.for_all += [self._stop, command]

    def _put(self, event: Event) -> None:
        self._try(lambda: self._session.put(event))

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except HrcError as error:
            self._journal.refuse(str(error))
