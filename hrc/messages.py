"""What flows between the parts: frozen, validated once, arrays read-only.

Ticks count the base rate (1 kHz simulated). Links are numbered 0 (base) to 7.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrc.errors import SensorError

Array = NDArray[np.float64]
LINKS = ("base", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6", "link_7")


_ALL = np.ones(21)


class Mode(StrEnum):
    """What the arm is doing. The paper's three states, the reflex for a contact without a point, the halt without a camera,
    and STOP."""

    IDLE = "idle"
    RELAX = "relax"
    ABORT = "abort"
    UNSEEN = "contact not seen"
    BLIND = "camera silent"
    STOP = "stop"


def frozen(values: ArrayLike, shape: tuple[int, ...], name: str = "array") -> Array:
    """A read-only float64 copy. Raises SensorError for a wrong shape or a value that is not finite."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise SensorError(f"{name} must have shape {shape}, not {array.shape}")
    # A sum is NaN or inf when any entry is, at a third of the cost of isfinite().all() on seven numbers.
    if not math.isfinite(np.add.reduce(array, axis=None)):
        raise SensorError(f"{name} holds a value that is not finite: {array.tolist()}")
    array.flags.writeable = False
    return array


def read_only(*arrays: NDArray[Any]) -> None:
    """Close these arrays for writing: many parts look at the same message."""
    for array in arrays:
        array.flags.writeable = False


@dataclass(frozen=True, eq=False, slots=True)
class RobotState:
    """What the robot measures.

    q: joint positions [rad], shape (7,). dq: joint velocities [rad/s], shape (7,).
    tau: link-side joint torques [N m], shape (7,), the mean over the last tick.
    """

    tick: int
    q: Array
    dq: Array
    tau: Array

    def __post_init__(self) -> None:
        try:
            q, dq, tau = frozen((self.q, self.dq, self.tau), (3, 7))
        except (SensorError, ValueError):  # which of them it is
            q, dq, tau = frozen(self.q, (7,), "q"), frozen(self.dq, (7,), "dq"), frozen(self.tau, (7,), "tau")
        keep = object.__setattr__
        keep(self, "q", q)
        keep(self, "dq", dq)
        keep(self, "tau", tau)

    @classmethod
    def of(cls, tick: int, readings: Array) -> "RobotState":
        """From q, dq and tau in one array (3, 7), which the state keeps: at half the cost, for one comes with every tick.

        Raises SensorError for a value that is not finite.
        """
        if not math.isfinite(_ALL @ readings.ravel()):
            return cls(tick, *readings)  # says which
        readings.flags.writeable = False
        state, keep = object.__new__(cls), object.__setattr__
        keep(state, "tick", tick)
        keep(state, "q", readings[0])
        keep(state, "dq", readings[1])
        keep(state, "tau", readings[2])
        return state


@dataclass(frozen=True, eq=False, slots=True)
class DepthFrame:
    """A depth image [m], shape (H, W), float32, +inf where nothing was measured; `tick` is when it was exposed."""

    tick: int
    depth: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.depth.ndim != 2 or self.depth.dtype != np.float32 or not self.depth.size:
            raise SensorError(f"depth must be a float32 image, not {self.depth.dtype} {self.depth.shape}")
        if np.isnan(self.depth.min()):  # numpy's min hands a NaN on
            raise SensorError("the depth image holds NaN; an invalid pixel is +inf")
        self.depth.flags.writeable = False


@dataclass(frozen=True, eq=False, slots=True)
class RobotImage:
    """The robot as the camera should see it: depth [m] (H, W) float32, +inf off the robot; link (H, W) uint8, 255 off it."""

    depth: NDArray[np.float32]
    link: NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class Nearest:
    """The point of a link's visible surface nearest to an obstacle: what vision sees, contact or not.

    stamp: tick of the depth frame used. p_world, p_link: that surface point [m], in the world at `tick` and fixed to the
    link, shape (3,). distance: of the link to the obstacle [m]. pixel: (u, v) of the point. camera: who sees it.
    sure: False where the obstacle goes on behind what the camera sees of the robot, so that a contact, if there is one, is
    likely to be at a hidden place, and where another link is as near elsewhere.
    """

    tick: int
    stamp: int
    link: int
    p_world: Array
    p_link: Array
    distance: float
    pixel: tuple[int, int]
    camera: str = ""
    sure: bool = True


@dataclass(frozen=True, eq=False, slots=True)
class Clearance:
    """How far a link is from the nearest obstacle, contact or not: distance [m] between two witness points.

    p_robot, p_obstacle: on the link's visible surface and on the obstacle [m], in the world, shape (3,). camera: who sees it.
    """

    tick: int
    stamp: int
    link: int
    distance: float
    p_robot: Array
    p_obstacle: Array
    camera: str = ""

    def __post_init__(self) -> None:
        read_only(self.p_robot, self.p_obstacle)


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """The newest frame of one camera, and what perception made of it.

    foreground: the frame without robot and environment. robot_image: the robot in that frame. silent: no frame for so long
    that this one says nothing about now; before the first frame all three are None. T_world_camera (4, 4): where perception
    takes the camera to have stood at that frame, and without one or while silent, to stand now; None: as configured.
    """

    camera: str
    frame: DepthFrame | None = None
    foreground: DepthFrame | None = None
    robot_image: RobotImage | None = None
    silent: bool = False
    T_world_camera: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Contact:
    """A contact: a detection by the residual, Eq. (4), with what is known of its place and force.

    link, p_world [m] (3,), p_link [m] (3,) (the same point fixed to the link), J_c (3, 7), Eq. (10);
    F_world: estimated force on the robot [N], shape (3,), Eq. (5).
    sigma_min: smallest singular value of J_c [m]; unobservable: unit direction of the force (3,) that goes with it.
    F_gate: length of a force [N] in this direction below which Eq. (4) would no longer detect it.
    seen: whether a camera sees an obstacle there; else the place is known from the joints alone. radius [m]: around p_world,
    holds the contact with 90 %.
    F_covariance: of the error of F_world [N^2] (3, 3), from the residual's noise, the point's uncertainty, and what no joint
    feels, for a force that changes slowly against 1 / K_I, as of when the place was last looked for; None where nobody has
    asked.
    """

    link: int
    p_world: Array
    p_link: Array
    J_c: Array
    F_world: Array
    sigma_min: float
    unobservable: Array
    F_gate: float = 0.0
    seen: bool = True
    radius: float = 0.0
    F_covariance: Array | None = None

    def __post_init__(self) -> None:
        read_only(self.p_world, self.p_link, self.J_c, self.F_world, self.unobservable)
        if self.F_covariance is not None:
            read_only(self.F_covariance)


@dataclass(frozen=True, eq=False, slots=True)
class Command:
    """The joint velocity command [rad/s], shape (7,), and what it came from.

    x, x_d: end effector and its reference [m] (3,). admittance_error: x_cd - x_c [m] (3,), zero outside ABORT.
    path_speed: 0 (path frozen) to 1. reason: why the arm came to be in this mode.
    """

    mode: Mode
    dq: Array
    x: Array
    x_d: Array
    admittance_error: Array
    path_speed: float = 0.0
    reason: str = ""

    def __post_init__(self) -> None:
        read_only(self.dq, self.x, self.x_d, self.admittance_error)


@dataclass(frozen=True, eq=False, slots=True)
class Truth:
    """The plant's own knowledge, for the recorder, the metrics and the screen; the estimator and controller never see it.

    F_world: net contact force on the robot [N] (3,). link: the link with the largest force, -1 without contact.
    p_world: where that force acts [m] (3,), NaN without contact. tau_ext: joint torque of all contacts [N m] (7,).
    visible: whether a noise-free camera would see that point, to within 2 cm in depth.
    """

    F_world: Array
    p_world: Array
    link: int
    tau_ext: Array
    visible: bool = False

    def __post_init__(self) -> None:
        read_only(self.F_world, self.p_world, self.tau_ext)


@dataclass(frozen=True, eq=False, slots=True)
class Body:
    """An obstacle in the scene: shape "sphere" (size = (r,)), "capsule" (radius, half length of its axis, along z), "box"
    (half lengths) or "figure" (height) [m], pose T_world_body (4, 4)."""

    name: str
    shape: str
    size: tuple[float, ...]
    T_world_body: Array
    present: bool = True
    virtual: bool = False
    """Drawn in the depth scene but without contact: the hand that holds a mouse pull."""


@dataclass(frozen=True, eq=False, slots=True)
class Aim:
    """What the end effector is to do now. kind: of the task.

    target: where it was told to go in the task "follow" [m] (3,); goal: where it goes, which is the target or as near to it as
    it comes; both None in other tasks. q_d: the desired posture that was asked for [rad] (7,). arrived: whether the reference
    is at the goal, or on its path.
    """

    kind: str
    q_d: Array
    target: "Array | None" = None
    goal: "Array | None" = None
    arrived: bool = True


@dataclass(frozen=True, eq=False, slots=True)
class Snapshot:
    """The latest of everything after one step. Recorder, browser and tests see nothing else.

    time: tick over the base rate [s]. fresh_control, fresh_frame: whether this very tick brought a new one.
    views: one for each camera. nearest: the nearest of all points that vision offers; touches: up to four separate places
    where an obstacle is as near as in a contact; clearances: one for each link with an obstacle within the monitored range.
    T_world_link [m]: poses of base and links (8, 4, 4), as measured at the last control tick.
    residual: r of Eq. (2) [N m] (7,).
    contact: the one that the reaction acts at; contacts: all with a known place, that one first.
    aim: the task as it is now.
    detected: Eq. (4) with hysteresis. events: those applied before this tick; refused: (event, reason).
    """

    tick: int
    time: float
    state: RobotState
    command: Command
    T_world_link: Array
    residual: Array
    detected: bool
    contact: Contact | None
    nearest: Nearest | None
    views: tuple[View, ...]
    truth: Truth
    bodies: tuple[Body, ...]
    events: tuple[Any, ...] = ()
    refused: tuple[tuple[Any, str], ...] = ()
    fresh_control: bool = False
    fresh_frame: bool = False
    pull: "tuple[Array, Array] | None" = field(default=None)
    """The grabbed point and the point it is pulled to [m], in the world, while somebody pulls: as of the last control tick or
    event."""
    touches: tuple[Nearest, ...] = ()
    clearances: tuple[Clearance, ...] = ()
    contacts: tuple[Contact, ...] = ()
    aim: Aim = field(default_factory=lambda: Aim("hold", np.zeros(7)))
    exposed: "tuple[Array, tuple[Body, ...]] | None" = None
    """What a camera took a frame of at this very tick, if one did: true poses of the links (8, 4, 4), obstacles. Truth."""

    def __post_init__(self) -> None:
        read_only(self.T_world_link, self.residual)

    @property
    def clearance(self) -> float:
        """Of the whole robot [m]: inf while no obstacle is within the monitored range."""
        return min((c.distance for c in self.clearances), default=math.inf)
