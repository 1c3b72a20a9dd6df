"""The reaction to contact: Eq. (13) as a state machine over the laws, with its transitions and limits.

    IDLE --|F| > F_relax--> RELAX --|F| > F_abort--> ABORT --contact gone, error recovered--> IDLE
    any of IDLE, RELAX --contact without a point--> UNSEEN --contact gone--> IDLE, wary for a while
    IDLE --no camera delivers images--> BLIND, the path waits --images again--> IDLE
    any --stop()--> STOP --resume()--> IDLE
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrc.control import guard, laws
from hrc.control.limits import limited, velocity_bounds
from hrc.control.posture import Posture
from hrc.control.reference import PathFollower
from hrc.errors import ConfigError
from hrc.geometry import apply, rotation_vector
from hrc.jacobian import Terms
from hrc.messages import Command, Contact, Mode
from hrc.parameters import Parameters, param

Array = NDArray[np.float64]
GATE_MARGIN = 1.3
"""RELAX yields down to this many times the force at which detection would end."""
PAPER_T_C = 0.005
"""T_c of the paper [s], for which lambda is given."""
W_RECONNECT = 0.5
"""The tool turns back to its orientation no faster than this [rad/s]."""
WAIT_TIME = 0.05
"""The path comes to a stand before a push in this time [s]: 4 m/s2 at 0.2 m/s, which every joint can follow."""
ZERO3, ZERO7 = np.zeros(3), np.zeros(7)
ZERO3.flags.writeable = ZERO7.flags.writeable = False


@dataclass(frozen=True)
class ReactionConfig(Parameters):
    """Gains, thresholds and readings of the control laws."""

    f_relax: float = param(5.0, low=0.5, high=100.0, unit="N")
    """F_relax: above this estimated force the arm gives way without leaving its task."""
    f_release: float = param(3.0, low=0.0, high=100.0, unit="N")
    """Below this force a contact counts as gone."""
    f_abort: float = param(25.0, low=1.0, high=150.0, unit="N")
    """F_abort: above this estimated force the arm abandons its task and follows the push."""
    k_0: float = param(5.0, low=0.0, high=20.0, unit="1/s")
    """K_0: how fast the null space returns to the desired posture, Eq. (12)."""
    k_f: float = param(0.02, low=0.0, high=0.5, unit="m/s/N")
    """K_f: how fast the contact point gives way per newton, Eq. (12)."""
    k_a: float = param(0.005, low=0.0, high=1.0, unit="m/s/N")
    """K_a: admittance while the task is abandoned, Eq. (6)."""
    k_e: float = param(350.0, low=0.0, high=5000.0, unit="N/m")
    """K_e: stiffness that brings the contact point back, Eq. (6)."""
    k_n: float = param(0.6, low=0.0, high=20.0, unit="1/s")
    """K_n: how fast the null space of the contact returns to the posture at contact, Eq. (7)."""
    k_p: float = param(10.0, low=0.0, high=50.0, unit="1/s")
    """K_p: feedback on the end effector's position, Eq. (11)."""
    lam: float = param(0.8, low=0.0, high=0.99)
    """lambda: forgetting factor of the null-space velocity over 5 ms, Eq. (15)."""
    n_s: int = param(20, low=1, high=400)
    """N_s: control cycles over which the command is blended when the task is abandoned or resumed, Eq. (14)."""
    law: str = param("latched", options=("latched", "printed"))
    """latched: ABORT lasts until the error is recovered, Eq. (15) has unit gain; printed: Eq. (13) and (15) to the letter."""
    relax_form: str = param("yielding", options=("yielding", "printed"))
    """yielding: (J_c P)# K_f F, never into the push; printed: P J_c# K_f F, Eq. (12)."""
    v_contact: float = param(0.25, low=0.01, high=50.0, unit="m/s")
    """The contact point gives way no faster than this."""
    v_reconnect: float = param(0.25, low=0.01, high=50.0, unit="m/s")
    """The end effector returns to its path no faster than this."""
    ddq_max: float = param(25.0, low=1.0, high=2000.0, unit="rad/s2")
    """Limit of the commanded joint acceleration."""
    k_reflex: float = param(0.04, low=0.0, high=0.2, unit="rad/s/(N m)")
    """Joint-space reflex dq = k r to a contact whose place is not known (an extension of the paper)."""
    relax_hold: float = param(0.2, low=0.0, high=5.0, unit="s")
    """RELAX ends when the force has been below f_release for this long."""
    abort_clear: float = param(0.15, low=0.0, high=5.0, unit="s")
    """ABORT may end when the force has been below f_release for this long."""
    abort_error: float = param(0.005, low=0.0005, high=0.1, unit="m")
    """ABORT may end when the contact point is this near to where it was."""
    abort_radius: float = param(0.1, low=0.0, high=1.0, unit="m")
    """A contact that no camera sees is a reason to abandon the task only if its place is known to this radius: the spring back
    to it would push elsewhere."""
    abort_distance: float = param(0.03, low=0.0, high=0.5, unit="m")
    """ABORT may end when no obstacle that is seen is nearer to the robot than this."""
    unseen_after: float = param(0.12, low=0.0, high=1.0, unit="s")
    """A contact without a point for this long starts the reflex; a camera that is two frames late needs 0.1 s to show it."""
    unseen_hold: float = param(0.3, low=0.0, high=5.0, unit="s")
    """The reflex ends when no such contact was felt for this long."""
    v_wary: float = param(0.05, low=0.005, high=1.0, unit="m/s")
    """After a contact that was not seen, the end effector returns to its path no faster than this."""
    wary_time: float = param(3.0, low=0.0, high=60.0, unit="s")
    """For how long after such a contact the arm moves like that, and the reflex answers a next one at once."""
    resume_time: float = param(0.5, low=0.01, high=10.0, unit="s")
    """The path speed rises from 0 to 1 over this time when the task is resumed, and falls so without a camera."""
    path_waits: bool = param(True)
    """In RELAX the path slows down, to a stand if need be, where it would move the contact point into the push and the null
    space cannot take that back (an extension of the paper)."""
    separation: bool = param(False)
    """Slow the path down while an obstacle is near, before any contact (an extension of the paper)."""
    slow_from: float = param(0.3, low=0.05, high=1.0, unit="m")
    """With `separation`, the path slows from this distance of robot and obstacles on."""
    stand_at: float = param(0.05, low=0.0, high=0.9, unit="m")
    """With `separation`, the path stands still from this distance on."""
    floor: float = param(0.08, low=-1.0, high=1.0, unit="m")
    """While the task is abandoned, elbow, wrist and end effector are kept above this height in the null space of the contact;
    so are forearm and tool kept off base and upper arm."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.f_release <= self.f_relax < self.f_abort:
            raise ConfigError(f"forces must rise from f_release ({self.f_release:g} N) to f_relax ({self.f_relax:g} N) to "
                              f"f_abort ({self.f_abort:g} N)")
        if not self.stand_at < self.slow_from:
            raise ConfigError(f"stand_at ({self.stand_at:g} m) must be less than slow_from ({self.slow_from:g} m)")


@dataclass(frozen=True)
class Surroundings:
    """What vision says beside the contact. clearance: of the whole robot [m]. blindness: why it says nothing, if so."""

    clearance: float = np.inf
    blindness: str = ""


OPEN = Surroundings()


@dataclass(frozen=True, eq=False)
class _Latch:
    """The contact that ABORT holds to: the point p on a link, and posture and poses at its beginning."""

    link: int
    p_link: Array
    q_cd: Array
    T_cd: Array

    @property
    def x_cd(self) -> Array:
        return apply(self.T_cd[self.link], self.p_link)


@dataclass(frozen=True, eq=False, slots=True)
class _Velocity:
    """A joint velocity in its two parts [rad/s] (7,): what is wanted first, and what is done in its null space."""

    task: Array
    null: Array


class Reaction:
    """Turns state, residual and contact into the joint velocity command, every control period."""

    def __init__(self, config: ReactionConfig, path: PathFollower, posture: Posture, bounds: tuple[Array, Array, Array],
                 dt: float, R_d: Array | None = None) -> None:
        """bounds: q_min, q_max [rad], dq_max [rad/s]. dt: control period T_c [s].

        R_d: orientation (3, 3) of the last link that belongs to the task (m = 6); None for a task of positions (m = 3).
        """
        self.config = config
        self.path, self.posture = path, posture
        self.mode = Mode.IDLE
        self.dq = ZERO7
        self._bounds, self._dt, self._R_d = bounds, dt, R_d
        self._latch: _Latch | None = None
        self._blend, self._blend_end, self._dq_switch = 0, 0, ZERO7
        self._ramp, self._kept, self._free = 0.0, 1.0, 1.0
        self._quiet = 0.0
        self._unseen = self._unfelt = self._wary = 0.0
        self._reason = "started"

    def stop(self, reason: str) -> None:
        """Come to a stand within the acceleration limit and stay, until resume()."""
        if self.mode is not Mode.STOP:
            self._enter(Mode.STOP, reason)

    def resume(self) -> None:
        """End a stop; the path starts again from zero speed."""
        if self.mode is Mode.STOP:
            self._enter(Mode.IDLE, "resumed")

    def come_back(self) -> None:
        """End an ABORT whose force is gone, wherever the contact point is: for an arm that does not move as commanded."""
        if self.mode is Mode.ABORT and self._quiet >= self.config.abort_clear:
            self._enter(Mode.IDLE, "the contact is gone, and the arm is back on its path")

    def update(self, q: Array, terms: Terms, residual: Array, detected: bool, contact: Contact | None,
               surroundings: Surroundings = OPEN) -> Command:
        """The command for the next control period.

        q [rad] (7,); residual r [N m] (7,); detected: Eq. (4); contact: the localized contact, None if there is none.
        """
        F = contact.F_world if contact is not None else ZERO3
        self._decide(q, terms, detected, contact, float(np.sqrt(F @ F)), surroundings)
        x_d, error, path_speed = self.path.x_d, ZERO3, 0.0
        if self.mode is Mode.STOP:
            wanted = _Velocity(ZERO7, ZERO7)
        elif self.mode is Mode.ABORT and self._latch is not None:
            wanted, error = self._abandon(q, terms, F, self._latch)
            if detected and contact is None:
                # The spring back to x_cd would press into whatever is felt there without being seen.
                wanted = self._reflex(residual, terms)
        elif self.mode is Mode.UNSEEN:
            wanted = self._reflex(residual, terms)
        else:
            wanted, path_speed = self._follow(q, terms, contact, self._allowed(surroundings))
        self._issue(q, self._blended(wanted))
        return Command(self.mode, self.dq, terms.x, x_d, error, path_speed, self._reason)

    # -- transitions ------------------------------------------------------------------------------------------------

    def _decide(self, q: Array, terms: Terms, detected: bool, contact: Contact | None, f: float,
                surroundings: Surroundings) -> None:
        """The next mode, from the force's norm f [N]."""
        c, dt = self.config, self._dt
        unseen = detected and contact is None
        self._quiet = self._quiet + dt if f <= c.f_release and not unseen else 0.0
        self._unseen = self._unseen + dt if unseen else 0.0
        self._unfelt = 0.0 if unseen else self._unfelt + dt
        self._wary = max(0.0, self._wary - dt)
        if self.mode is Mode.STOP:
            return
        if c.law == "printed":
            self._decide_as_printed(q, terms, contact, f)
        elif self.mode is Mode.ABORT and self._latch is not None:
            if contact is not None and not contact.seen:
                self._wary = c.wary_time  # nobody sees when it is out of the way
            self._follow_the_contact(contact, self._latch)
            e = apply(terms.T_world_link[self._latch.link], self._latch.p_link) - self._latch.x_cd
            recovered = self._quiet >= c.abort_clear and float(np.sqrt(e @ e)) < c.abort_error
            if recovered and surroundings.clearance > c.abort_distance:
                self._enter(Mode.IDLE, f"the contact is gone and made up for to {1e3 * c.abort_error:g} mm")
        elif contact is not None and f > c.f_abort and (contact.seen or contact.radius <= c.abort_radius):
            self._abort(q, terms, contact, f)
        elif self.mode is Mode.UNSEEN:
            self._wary = c.wary_time
            if f > c.f_relax:
                self._enter(Mode.IDLE, "the contact has a place now")
            elif self._unfelt >= c.unseen_hold:
                self._enter(Mode.IDLE, f"nothing was felt for {c.unseen_hold:g} s")
        elif self._unseen > (c.unseen_after if self._wary == 0.0 else 0.0):
            self._enter(Mode.UNSEEN, "a contact is felt, and nobody knows where")
        elif f > c.f_relax:
            self._become(Mode.RELAX, f"{f:.1f} N is more than f_relax, {c.f_relax:g} N")
        elif self.mode is Mode.RELAX and self._quiet >= c.relax_hold:
            self._become(Mode.IDLE, f"at most f_release, {c.f_release:g} N, for {c.relax_hold:g} s")
        elif self.mode is Mode.IDLE and surroundings.blindness:
            self._become(Mode.BLIND, surroundings.blindness)
        elif self.mode is Mode.BLIND and not surroundings.blindness:
            self._become(Mode.IDLE, "images come again")

    def _decide_as_printed(self, q: Array, terms: Terms, contact: Contact | None, f: float) -> None:
        """Eq. (13) without memory: the force now is the mode now."""
        if contact is not None and f > self.config.f_abort:
            if self.mode is not Mode.ABORT:
                self._abort(q, terms, contact, f)
        else:
            self._become(Mode.RELAX if f > self.config.f_relax else Mode.IDLE, f"{f:.1f} N, Eq. (13)")

    def _abort(self, q: Array, terms: Terms, contact: Contact, f: float) -> None:
        self._latch = _Latch(contact.link, contact.p_link, q.copy(), terms.T_world_link.copy())
        self._enter(Mode.ABORT, f"{f:.1f} N is more than f_abort, {self.config.f_abort:g} N")

    def _follow_the_contact(self, contact: Contact | None, latch: _Latch) -> None:
        """When the contact has moved to another link, hold to the new point, where it was at the beginning."""
        if contact is not None and contact.link != latch.link:
            self._latch = _Latch(contact.link, contact.p_link, latch.q_cd, latch.T_cd)
            self._begin_blend()

    def _become(self, mode: Mode, reason: str) -> None:
        """Another mode with the same task: no blend, for it would blend the task, too."""
        if mode is not self.mode:
            self.mode, self._reason = mode, reason

    def _enter(self, mode: Mode, reason: str) -> None:
        self.mode, self._reason = mode, reason
        self._ramp = 0.0
        self._quiet = self._unseen = self._unfelt = 0.0
        self._begin_blend()

    def _begin_blend(self) -> None:
        # A reflex is none if it takes its time: there the acceleration limit alone makes the transition smooth.
        cycles = 0 if self.mode is Mode.UNSEEN else self.config.n_s
        self._blend, self._blend_end, self._dq_switch = 0, cycles, self.dq

    # -- velocities -------------------------------------------------------------------------------------------------

    def _allowed(self, surroundings: Surroundings) -> float:
        """The part of the path's speed that the distance to the nearest obstacle allows, 0..1."""
        c = self.config
        if not c.separation:
            return 1.0
        return min(max((surroundings.clearance - c.stand_at) / (c.slow_from - c.stand_at), 0.0), 1.0)

    def _follow(self, q: Array, terms: Terms, contact: Contact | None, allowed: float) -> tuple[_Velocity, float]:
        """IDLE and RELAX: the task, with posture and yielding in its null space; and the path speed used, 0..1."""
        c = self.config
        # The feedback belongs to the reference now; advancing first would lead the arm by one period.
        e = self.path.x_d - terms.x
        target, step = 0.0 if self.mode is Mode.BLIND else allowed, self._dt / c.resume_time
        self._ramp = min(max(target, self._ramp - step), self._ramp + step)
        near = min(max(1.5 - math.sqrt(e @ e) / 0.02, 0.0), 1.0)
        path_speed = self._ramp * self._free * near * max(0.05, self._kept)
        v_reconnect = c.v_reconnect if self._wary == 0.0 else min(c.v_wary, c.v_reconnect)
        v = laws.task_velocity(self.path.advance(path_speed, self._dt), e, c.k_p, v_reconnect)
        if self._R_d is None:
            J = laws.inverse(terms.J)
        else:
            J = laws.inverse(terms.J_tool)
            turn = rotation_vector(self._R_d @ terms.T_world_link[-1, :3, :3].T)
            v = np.concatenate([v, laws.saturated(c.k_p * turn, W_RECONNECT)])
        task = J.pinv @ v  # (11)
        null = J.projector @ laws.posture_velocity(q, self.posture.advance(self._dt), c.k_0)  # (12), first branch
        if self.mode is Mode.RELAX and contact is not None:  # (12), second branch
            null = self._yielding(J.projector, contact, null)
        null = laws.with_forgetting(null, J.projector, self.dq, self._lam, unit_gain=c.law == "latched")  # (15)
        giving_way = contact if self.mode is Mode.RELAX and c.relax_form == "yielding" else None
        self._make_way(J, task + null, path_speed, giving_way)
        if giving_way is not None:
            null = laws.not_into_the_push(task, null, giving_way.J_c, J.projector, giving_way.F_world)
        return _Velocity(task, null), path_speed

    def _make_way(self, J: laws.Inverse, dq: Array, path_speed: float, contact: Contact | None) -> None:
        """Find the part of the path's speed that does not move a contact point into its push, for the next period.

        J: of the task. dq: what is wanted now, with the path at `path_speed` in it, and nothing given back yet.
        """
        c, free = self.config, 1.0
        if c.path_waits and self._unseen > 0.0:
            free = 0.0
        elif c.path_waits and contact is not None:
            path = J.pinv[:, :3] @ self.path.ahead(self._dt)
            free = laws.share_of_the_path(path, dq - path_speed * path, contact.J_c, J.projector, contact.F_world)
        self._free = min(max(free, self._free - self._dt / WAIT_TIME), self._free + self._dt / c.resume_time)

    def _yielding(self, P: Array, contact: Contact, null: Array) -> Array:
        c = self.config
        if c.relax_form == "printed":
            return null + P @ laws.relax_velocity_printed(contact.J_c, contact.F_world, c.k_f)
        # Yielding down to a force that Eq. (4) no longer detects would end the relaxation while the push goes on.
        threshold = max(c.f_relax, GATE_MARGIN * contact.F_gate)
        null = null + laws.relax_velocity(contact.J_c, P, contact.F_world, c.k_f, threshold)
        # The result is held, not the force term: spring and push together, so the excursion is not bounded by the cap.
        v_c = contact.J_c @ null
        speed = float(np.sqrt(v_c @ v_c))
        return null * (c.v_contact / speed) if speed > c.v_contact else null

    def _abandon(self, q: Array, terms: Terms, F: Array, latch: _Latch) -> tuple[_Velocity, Array]:
        """ABORT: admittance at the contact point, Eq. (6)-(7); and the admittance error x_cd - x_c [m] (3,)."""
        c = self.config
        x_c = apply(terms.T_world_link[latch.link], latch.p_link)
        J_c = laws.inverse(terms.J_contact(latch.link, x_c), laws.EPSILON_C)
        error = latch.x_cd - x_c
        task = J_c.pinv @ laws.admittance_velocity(F, error, c.k_a, c.k_e, c.v_contact)  # (6)
        null = J_c.projector @ (laws.posture_velocity(q, latch.q_cd, c.k_n) + guard.away(terms, c.floor, c.k_p))  # (7)
        if c.law == "printed":
            null = laws.with_forgetting(null, laws.inverse(terms.J).projector, self.dq, self._lam, unit_gain=False)
        else:
            null = laws.with_forgetting(null, J_c.projector, self.dq, self._lam, unit_gain=True)  # (15) with P_c
        return _Velocity(task, null), error

    def _reflex(self, residual: Array, terms: Terms) -> _Velocity:
        """Yield in the joints, dq = k r: what can be done about a contact without knowing its place."""
        return _Velocity(ZERO7, self.config.k_reflex * residual + guard.away(terms, self.config.floor, self.config.k_p))

    @property
    def _lam(self) -> float:
        """lambda of this control period: the same memory in seconds as the paper's at its T_c."""
        return self.config.lam ** (self._dt / PAPER_T_C)

    def _blended(self, wanted: _Velocity) -> _Velocity:
        """Eq. (14), at the beginning and at the end of an abandoned task."""
        if self._blend >= self._blend_end or self.mode is Mode.STOP:
            return wanted
        self._blend += 1
        a = laws.blend(self._blend, self._blend_end)
        return _Velocity(a * wanted.task, a * wanted.null + (1.0 - a) * self._dq_switch)

    def _issue(self, q: Array, wanted: _Velocity) -> None:
        """Apply the limits; what is issued is what Eq. (15) remembers."""
        q_min, q_max, dq_max = self._bounds
        bounds = velocity_bounds(q, q_min, q_max, dq_max, self.config.ddq_max)
        if not np.isfinite(wanted.task.sum() + wanted.null.sum()):
            self.stop("the command is not finite")
            wanted = _Velocity(ZERO7, ZERO7)
        result = limited(wanted.task, wanted.null, bounds, self.dq, self.config.ddq_max * self._dt)
        self._kept = result.task
        self.dq = result.dq
