"""The whole system as one object that steps on an integer clock. Clocks, browser and recorder stand outside and look."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from hrc.cell.clock import Delayed, Rate
from hrc.config import Config
from hrc.contact.estimate import ContactTracker
from hrc.contact.residual import Detector, MomentumObserver
from hrc.control.reaction import Reaction
from hrc.control.reference import Hexagon, PathFollower
from hrc.errors import ConfigError, SensorError
from hrc.events import Event, Reset, Resume, SetParameter, Stop
from hrc.jacobian import Terms
from hrc.messages import Command, Contact, Mode, Nearest, RobotState, Snapshot, Truth
from hrc.model import Dynamics, perturbed, pinocchio_model
from hrc.parameters import field_of, replaced
from hrc.scene import load_scene
from hrc.sim.depth_camera import DepthCamera
from hrc.sim.push import HAND
from hrc.sim.robot import SimulatedRobot
from hrc.vision.camera import Camera
from hrc.vision.localize import Localizer

Array = NDArray[np.float64]
HISTORY_S = 1.0
"""A stop keeps the control cycles of this long before it [s]."""


class Cell:
    """Robot, camera, perception, estimation and reaction; `step` is one tick of the base rate.

    Same config (with its seed) and same events at the same ticks give the same bits, headless or live, observed or not.
    """

    def __init__(self, config: Config | None = None, device: str = "cpu") -> None:
        """device: where vision runs, "cpu" or "cuda:0". Raises DeviceError if it is not there."""
        self.device = device
        self.scene = load_scene()
        self._initial = config or Config()
        self._build()

    def step(self) -> Snapshot:
        """One tick: the robot moves, and whatever is due looks, estimates and decides."""
        events, refused = self._take_news()
        state = self._move()
        tick = self.tick = self.tick + 1
        if state.tick == tick:
            self._tau_sum += state.tau
        fresh_frame = self._look(tick)
        if self._localize.due(tick) and self._localizer.foreground is not None:
            self._nearest.put(tick, self._localizer.localize(tick, self._dynamics.kinematics(state.q)[0]))
        fresh_control = self._control.due(tick)
        if fresh_control:
            self._decide(state)
        snapshot = self._snapshot(state, events, refused, fresh_control, fresh_frame)
        if fresh_control:
            self.history.append(snapshot)
        return snapshot

    def _decide(self, state: RobotState) -> None:
        """One control cycle: the whole paper in six lines."""
        terms = self._terms = self._dynamics.terms(state.q, state.dq)
        self.residual = self._observe(state, terms)  # (2)
        self.detected = self._detector.update(self.residual)  # (4)
        seen = self._seen()  # (8)-(9)
        self.nearest = seen[0] if seen else None
        self.contact = self._tracker.update(  # (5), (10)
            self.residual, self._detector, seen, terms, keep=self._reaction.mode is Mode.ABORT)
        self.command = self._reaction.update(state.q, terms, self.residual, self.detected, self.contact)  # (11)-(15)

    def _observe(self, state: RobotState, terms: Terms) -> Array:
        """The residual; zero without a reading, and starting anew after one: what would be made of the gap is no contact."""
        tau = self._mean_tau()
        if state.tick != self.tick:
            self._observer.reset()
            return np.zeros(7)
        return self._observer.update(terms.p, terms.Ct_dq, terms.g, tau, self._dt)

    def _seen(self) -> tuple[Nearest, ...]:
        """The latest localization, unless its image is so old that it says nothing about now: a camera may die."""
        seen = self._nearest.get(self.tick) or ()
        stale = self.config.tracker.stale * self.config.rates.base_hz
        return seen if seen and self.tick - seen[0].stamp <= stale else ()

    def _look(self, tick: int) -> bool:
        """Expose when due; filter the robot out of a frame when it arrives, with q as it was at the frame's stamp."""
        try:
            if self._camera_rate.due(tick):
                self._camera.expose(tick, self._robot.T_world_link(), self._robot.bodies())
                self._poses[tick] = self._dynamics.kinematics(self._state.q)[0]
            frame = self._camera.latest(tick)
            if frame is None or (self.frame is not None and frame.tick == self.frame.tick):
                return False
            self._localizer.filter(frame, self._poses[frame.tick])
        except SensorError as error:
            self._reaction.stop(f"camera: {error}")
            return False
        self.frame = frame
        self._poses = {t: T for t, T in self._poses.items() if t > frame.tick}
        return True

    def _move(self) -> RobotState:
        try:
            self._state = self._robot.step(self.command.dq)
        except SensorError as error:
            # What cannot be measured cannot be acted on: the arm stops on its last good reading, whose tick stays behind.
            self._reaction.stop(f"robot: {error}")
        return self._state

    # -- events -----------------------------------------------------------------------------------------------------

    def apply(self, event: Event) -> None:
        """Take an event before the next step. Raises HrcError, with nothing changed, for one that cannot be."""
        if isinstance(event, Reset):
            self._build()
        elif isinstance(event, SetParameter):
            self._set(event)
        elif isinstance(event, Stop):
            self._reaction.stop(event.reason)
        elif isinstance(event, Resume):
            self._reaction.resume()
        else:
            self._robot.apply(event)
        self.log.append((self.tick, event))
        self._news.append(event)

    def refuse(self, event: Event, reason: str) -> None:
        """Note an event that was not taken, so that whoever sent it can see why."""
        self._refusals.append((event, reason))

    def _set(self, event: SetParameter) -> None:
        if not field_of(self.config, event.key).metadata.get("live", True):
            raise ConfigError(f"{event.key} cannot change while the cell runs; set it before the start")
        config = self.config = replaced(self.config, event.key, event.value)
        self._observer.config = self._detector.config = config.observer
        self._tracker.config, self._tracker.force = config.tracker, config.force
        self._reaction.config = config.control
        self._reaction.path.speed = config.task.speed
        self._robot.grip.config, self._robot.obstacles.config = config.push, config.obstacle
        self._localizer.configure(config.vision)
        self._camera.configure(config.sensor)

    def _take_news(self) -> tuple[tuple[Event, ...], tuple[tuple[Event, str], ...]]:
        events, refused = tuple(self._news), tuple(self._refusals)
        self._news.clear()
        self._refusals.clear()
        return events, refused

    # -- construction -----------------------------------------------------------------------------------------------

    def _build(self) -> None:
        config = self.config = self._initial
        rates, base = config.rates, config.rates.base_hz
        plant_rng, model_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
        self._robot = SimulatedRobot(self.scene, config.plant, config.push, config.obstacle, base_hz=base,
                                     control_hz=rates.control_hz, rng=plant_rng)
        nominal = pinocchio_model(self._robot.model, armature=False)
        self._dynamics = Dynamics(perturbed(nominal, config.model.inertial_error, model_rng))
        path = PathFollower(Hexagon(config.task), config.task.speed)
        q_d = self._dynamics.solve_position(np.asarray(config.task.centre), np.deg2rad(config.task.posture_deg))
        q_start = self._dynamics.solve_position(path.x_d, q_d)
        limits = self._robot.limits
        if np.any(q_start <= limits.q_min) or np.any(q_start >= limits.q_max):
            raise ConfigError(f"the path starts beyond the joint limits, at {np.rad2deg(q_start).round().tolist()} deg")
        self._robot.place(q_start)

        camera = Camera(config.camera)
        if not hasattr(self, "_localizer"):
            self._localizer = Localizer(camera, self.scene.environment, config.vision, device=self.device)
        self._localizer.configure(config.vision)
        self._localizer.reset()
        self._camera = DepthCamera(camera, self.scene.environment, (*self.scene.bodies, HAND), config.sensor,
                                   seed=config.seed, latency=config.sensor.latency, device=self.device)
        self._camera_rate = Rate(rates.camera_hz, base)
        self._localize, self._control = Rate(rates.localize_hz, base), Rate(rates.control_hz, base)
        self._nearest: Delayed[tuple[Nearest, ...]] = Delayed(round(rates.localize_latency_s * base))
        self._poses: dict[int, Array] = {}

        self._dt = 1.0 / rates.control_hz
        self._observer, self._detector = MomentumObserver(config.observer), Detector(config.observer)
        self._tracker = ContactTracker(config.tracker, config.force, self._dt)
        self._reaction = Reaction(config.control, path, q_d, (limits.q_min, limits.q_max, limits.dq_max), self._dt)

        self.tick = 0
        self.log: list[tuple[int, Event]] = []
        self.history: deque[Snapshot] = deque(maxlen=round(HISTORY_S * rates.control_hz))
        self._news: list[Event] = []
        self._refusals: list[tuple[Event, str]] = []
        self._state = RobotState(0, q_start, np.zeros(7), np.zeros(7))
        self._terms = self._dynamics.terms(q_start, np.zeros(7))
        self._tau_sum = np.zeros(7)
        self.frame = None
        self.nearest: Nearest | None = None
        self.contact: Contact | None = None
        self.residual, self.detected = np.zeros(7), False
        self.truth, self.bodies = self._robot.truth(), self._robot.bodies()
        self.command = Command(Mode.IDLE, np.zeros(7), self._terms.x, path.x_d, np.zeros(3))

    def _mean_tau(self) -> Array:
        mean = self._tau_sum / (self.config.rates.base_hz // self.config.rates.control_hz)
        self._tau_sum = np.zeros(7)
        return mean

    def _truth(self) -> Truth:
        """What the plant knows, with what a perfect camera would see of it: for those who look, never for the loop."""
        t = self._robot.truth()
        return Truth(t.F_world, t.p_world, t.link, t.tau_ext, self._camera.sees(t.p_world)) if t.link >= 0 else t

    def _snapshot(self, state: RobotState, events: tuple[Event, ...], refused: tuple[tuple[Event, str], ...],
                  fresh_control: bool, fresh_frame: bool) -> Snapshot:
        if fresh_control:
            self.truth, self.bodies = self._truth(), self._robot.bodies()
        seen = self._localizer
        return Snapshot(
            tick=self.tick, time=self.tick / self.config.rates.base_hz, state=state, command=self.command,
            T_world_link=self._terms.T_world_link, residual=self.residual, detected=self.detected,
            contact=self.contact, nearest=self.nearest, frame=self.frame, foreground=seen.foreground,
            robot_image=seen.robot_image, truth=self.truth, bodies=self.bodies, events=events, refused=refused,
            fresh_control=fresh_control, fresh_frame=fresh_frame, pull=self._robot.grip.pull)



