"""The whole system as one object that steps on an integer clock. Clocks, browser and recorder stand outside and look."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from hrc.cell.clock import Delayed, Rate
from hrc.cell.eyes import Eyes, Sighting, simulated
from hrc.cell.steering import Steering
from hrc.cell.task import plan
from hrc.cell.watch import Watch
from hrc.config import Config
from hrc.contact.estimate import ContactTracker
from hrc.contact.friction import friction
from hrc.contact.proprioception import ResidualLocalizer, SurfaceSamples
from hrc.contact.residual import Acceleration, Detector, MomentumObserver
from hrc.contact.zero import ResidualZero
from hrc.control.posture import Posture
from hrc.control.reaction import Reaction, Surroundings
from hrc.control.reference import PathFollower
from hrc.errors import ConfigError, SensorError
from hrc.events import Event, MoveCamera, MoveTarget, Reset, Resume, SetParameter, SetPosture, SetTask, Stop
from hrc.executor import Executor
from hrc.geometry import look_at
from hrc.jacobian import Terms
from hrc.messages import Body, Command, Contact, Mode, RobotState, Snapshot, Truth
from hrc.model import Dynamics, perturbed, pinocchio_model
from hrc.parameters import field_of, replaced
from hrc.scene import load_scene
from hrc.sim.robot import SimulatedRobot
from hrc.vision import kernels

Array = NDArray[np.float64]
HISTORY_S = 1.0
"""A stop keeps the control cycles of this long before it [s]."""


class Cell:
    """Robot, camera, perception, estimation and reaction; `step` is one tick of the base rate.

    Same config (with its seed) and same events at the same ticks give the same bits, headless or live, observed or not.
    """

    def __init__(self, config: Config | None = None, device: str = "cpu", executor: Executor | None = None) -> None:
        """device: where vision runs, "cpu" or "cuda:0". executor: renders what its cameras take; without, its own thread does.

        Raises DeviceError if the device is not there, AssetError for a bad scene.
        """
        self.device, self._executor = device, executor
        self._initial = config or Config()
        self.scene = load_scene(self._initial.scene)
        self._build()

    def step(self) -> Snapshot:
        """One tick: the robot moves, and whatever is due looks, estimates and decides."""
        events, refused = self._take_news()
        state = self._move()
        tick = self.tick = self.tick + 1
        if state.tick == tick:
            self._tau_sum += state.tau
        fresh_frame = self._look(tick)
        if self._localize.due(tick):
            self._sighting.put(tick, self._eyes.localize(tick, self._dynamics.kinematics(state.q)[0]))
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
        self.detected = self._detector.update(
            self.residual, self._acceleration.update(self._commanded, self.config.observer.k_i))  # (4)
        seen = self.seen = self._sighted()  # (8)-(9)
        self.contact = self._tracker.update(  # (5), (10)
            self.residual, self._detector, seen.nearest, terms, keep=self._reaction.mode is Mode.ABORT,
            touches=seen.touches)
        self.contacts = self._tracker.contacts
        self.command = self._reaction.update(  # (11)-(15)
            state.q, terms, self.residual, self.detected, self.contact,
            Surroundings(seen.clearance, self._eyes.blindness(self.tick)))

    def _observe(self, state: RobotState, terms: Terms) -> Array:
        """The residual; zero without a reading, and starting anew after one: what would be made of the gap is no contact."""
        tau = self._mean_tau()
        stuck = self._watch.update(state, self._commanded)
        if stuck:
            self._reaction.stop(f"robot: {stuck}")
        if stuck or state.tick != self.tick:
            self._observer.reset()
            return np.zeros(7)
        tau = tau - friction(self.config.friction, state.dq)
        r = self._observer.update(terms.p, terms.Ct_dq, terms.g, tau, self._dt)
        sees = not self._eyes.blindness(self.tick)
        return self._zero.update(r, state.dq, np.asarray(self.config.observer.r_low),
                                 clearance=self.seen.clearance if sees else 0.0, detected=self.detected)

    def _sighted(self) -> Sighting:
        """The latest localization, without what its images are too old to say about now."""
        stale = round(self.config.tracker.stale * self.config.rates.base_hz)
        return (self._sighting.get(self.tick) or Sighting()).since(self.tick - stale)

    def _look(self, tick: int) -> bool:
        """Expose the cameras that are due; filter the robot out of what arrives, with q as it was at the frame's stamp."""
        self.exposed = None
        if self._eyes.due(tick):
            self.exposed = self._before_cameras()
            q, dq = self._state.q, self._state.dq
            T = self._dynamics.kinematics(q)[0]
            T_later = self._dynamics.kinematics(q + dq * self.config.vision.skew)[0]
            self._eyes.expose(tick, *self.exposed, T, T_later)
        return self._eyes.receive(tick)

    @property
    def _commanded(self) -> Array:
        """What the robot moves by [rad/s] (7,)."""
        return self.command.dq

    def _before_cameras(self) -> tuple[Array, tuple[Body, ...]]:
        """What a camera takes a frame of: true poses of the links (8, 4, 4), and the obstacles."""
        return self._robot.T_world_link(), self._bodies()

    def _bodies(self) -> tuple[Body, ...]:
        return self._robot.bodies()

    def _move(self) -> RobotState:
        try:
            self._state = self._robot.step(self._commanded)
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
        elif isinstance(event, MoveCamera):
            self._eyes.move(event.name, look_at(event.eye, event.target))
        elif isinstance(event, (SetTask, MoveTarget, SetPosture)):
            self._steering.apply(event, self._state, self._reaction.mode)
        else:
            self._robot.apply(event)
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
        self._tracker.localizer.config = config.proprioception
        self._tracker.finder.config, self._zero.config = config.pair, config.zero
        self._reaction.config = config.control
        self._steering.configure(config.task)
        self._robot.grip.config, self._robot.obstacles.config = config.push, config.obstacle
        self._robot.faults.config = config.fault
        self._eyes.configure(config)

    def _take_news(self) -> tuple[tuple[Event, ...], tuple[tuple[Event, str], ...]]:
        events, refused = tuple(self._news), tuple(self._refusals)
        self._news.clear()
        self._refusals.clear()
        return events, refused

    # -- construction -----------------------------------------------------------------------------------------------

    def _build(self) -> None:
        if self._executor is not None:
            self._executor.idle()
        config = self.config = self._initial
        rates, base = config.rates, config.rates.base_hz
        plant_rng, model_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
        self._robot = SimulatedRobot(self.scene, config.plant, config.push, config.obstacle, base_hz=base,
                                     control_hz=rates.control_hz, rng=plant_rng)
        nominal = pinocchio_model(self._robot.model, armature=False)
        self._dynamics = Dynamics(perturbed(nominal, config.model.inertial_error, model_rng))
        limits = self._robot.limits
        task = plan(config.task, self._dynamics, limits, self.scene)
        path, posture, q_start = PathFollower(task.path, config.task.speed), Posture(task.q_d), task.q_start
        self._steering = Steering(config.task, task, path, posture, self._dynamics, limits, self.scene)
        self._robot.place(q_start)
        self._robot.faults.config = config.fault

        if not hasattr(self, "_eyes"):
            self._eyes = self._open_eyes(config)
        self._eyes.begin(config)
        self._localize, self._control = Rate(rates.localize_hz, base), Rate(rates.control_hz, base)
        self._sighting: Delayed[Sighting] = Delayed(round(rates.localize_latency_s * base))

        self._dt = 1.0 / rates.control_hz
        self._watch = Watch(self._dt)
        self._observer, self._detector = MomentumObserver(config.observer), Detector(config.observer)
        self._acceleration = Acceleration(self._dt)
        self._zero = ResidualZero(config.zero, self._dt)
        if not hasattr(self, "_surface"):
            self._surface = SurfaceSamples(config.proprioception.samples, self._dynamics.kinematics(task.q_d)[0])
            self._evidence = kernels.Evidence(self._surface.wrenches, self._surface.of_link)
        localizer = ResidualLocalizer(config.proprioception, self._surface, self._evidence)
        self._tracker = ContactTracker(config.tracker, config.force, localizer, self._dt, config.pair)
        self.aim = self._steering.aim
        self._reaction = Reaction(config.control, path, posture, (limits.q_min, limits.q_max, limits.dq_max), self._dt,
                                  task.R_d)

        self.tick = 0
        self.exposed: tuple[Array, tuple[Body, ...]] | None = None
        self.history: deque[Snapshot] = deque(maxlen=round(HISTORY_S * rates.control_hz))
        self._news: list[Event] = []
        self._refusals: list[tuple[Event, str]] = []
        self._state = RobotState(0, q_start, np.zeros(7), np.zeros(7))
        self._terms = self._dynamics.terms(q_start, np.zeros(7))
        self._tau_sum = np.zeros(7)
        self.seen, self.views = Sighting(), self._eyes.views(0)
        self.contact: Contact | None = None
        self.contacts: tuple[Contact, ...] = ()
        self.residual, self.detected = np.zeros(7), False
        self.truth, self.bodies, self.pull = self._robot.truth(), self._robot.bodies(), self._robot.grip.pull
        self.command = Command(Mode.IDLE, np.zeros(7), self._terms.x, path.x_d, np.zeros(3))

    def _open_eyes(self, config: Config) -> Eyes:
        return Eyes(self.scene, config, self.device, simulated(self._executor))

    def _mean_tau(self) -> Array:
        mean = self._tau_sum / (self.config.rates.base_hz // self.config.rates.control_hz)
        self._tau_sum = np.zeros(7)
        return mean

    def _truth(self) -> Truth:
        """What the plant knows, with what a perfect camera would see of it: for those who look, never for the loop."""
        t = self._robot.truth()
        return Truth(t.F_world, t.p_world, t.link, t.tau_ext, self._eyes.see(t.p_world)) if t.link >= 0 else t

    def _snapshot(self, state: RobotState, events: tuple[Event, ...], refused: tuple[tuple[Event, str], ...],
                  fresh_control: bool, fresh_frame: bool) -> Snapshot:
        if fresh_control or fresh_frame:
            self.views = self._eyes.views(self.tick)
        if fresh_control:
            self.truth, self.bodies = self._truth(), self._bodies()
            self.aim = self._steering.aim
        if fresh_control or events:
            self.pull = self._robot.grip.pull
        seen = self.seen
        return Snapshot(
            tick=self.tick, time=self.tick / self.config.rates.base_hz, state=state, command=self.command,
            T_world_link=self._terms.T_world_link, residual=self.residual, detected=self.detected,
            contact=self.contact, nearest=seen.nearest[0] if seen.nearest else None, touches=seen.touches,
            clearances=seen.clearances, contacts=self.contacts, views=self.views, truth=self.truth, bodies=self.bodies,
            events=events, refused=refused, fresh_control=fresh_control, fresh_frame=fresh_frame,
            pull=self.pull, aim=self.aim, exposed=self.exposed)
