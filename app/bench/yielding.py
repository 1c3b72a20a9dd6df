"""What relaxing is worth: the same slow push on each link with relaxation and without."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.bench import report
from app.bench.pool import spread
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import EventError
from hrc.events import Press
from hrc.geometry import apply
from hrc.messages import Mode, Snapshot
from hrc.parameters import replaced

PLACES: dict[int, tuple[float, float, float]] = {
    3: (0.0, 0.0, -0.17), 4: (0.0, 0.0, 0.08), 5: (0.0, 0.0, -0.12), 6: (0.0, 0.0, 0.0), 7: (0.0, 0.0, 0.06)}
"""On the axis of each link [m], in its frame: towards these points a hand presses."""
SIDES = {"+y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0)}
SPEED, DEPTH, HOLD, STIFFNESS = 0.12, 0.10, 3.0, 200.0
"""Of the hand [m/s], [m], [s], [N/m]: held still, the arm would be pressed with 20 N."""
OFF: dict[str, Any] = {"control.k_f": 0.0, "control.path_waits": False}
"""Without relaxation: RELAX does what IDLE does."""
BRAKING = 0.1
"""The motion before a contact needs so long [s] to stop; F . v_c is judged after that."""


@dataclass(frozen=True)
class Work:
    """One push. relaxing: or not."""

    link: int
    side: str
    relaxing: bool
    seed: int
    device: str = "cpu"


@dataclass(frozen=True)
class Outcome:
    """Of one push: true force [N], peak and median while the hand holds still; how far the contact gave way along the push [m];
    the least F . v_c in RELAX [W] with the estimated force; the largest error of the end effector [m]."""

    link: int
    side: str
    relaxing: bool
    peak: float
    held: float
    given_way: float
    power: float | None
    ee_error: float


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False) -> None:
    """Push, print the table, and write it to a file. Raises HrcError, before anything moves, for a file that cannot be."""
    if json is not None:
        report.check(json)
    work = [Work(link, side, on, 100, device) for link in ((3,) if quick else PLACES) for side in (("+y",) if quick else SIDES)
            for on in (True, False)]
    found = [outcome for outcome in spread(run, work, alone=quick) if outcome is not None]
    print("\n".join(printed(found)))
    if json is not None:
        report.write(json, {"conditions": {"speed": SPEED, "depth": DEPTH, "hold": HOLD, "stiffness": STIFFNESS, "seed": 100},
                            "rows": [asdict(outcome) for outcome in found]})


def run(work: Work) -> Outcome | None:
    """One push on a cell of its own that holds its end effector in place, and never abandons that; None where the arm itself is
    in the hand's way."""
    config = replaced(replaced(Config(seed=work.seed), "control.f_abort", 150.0), "task.kind", "hold")
    for key, value in ({} if work.relaxing else OFF).items():
        config = replaced(config, key, value)
    cell, point = Cell(config, work.device), np.array(PLACES[work.link])
    n = np.array(SIDES[work.side])
    for _ in range(1000):
        cell.step()
    try:
        cell.apply(Press("hand", work.link, PLACES[work.link], SIDES[work.side], SPEED, DEPTH, HOLD, STIFFNESS, approach=0.6))
    except EventError:
        return None
    seen = [s for s in (cell.step() for _ in range(600 + round(1000 * (DEPTH / SPEED + HOLD)))) if s.fresh_control]
    force = np.array([np.linalg.norm(s.truth.F_world) for s in seen])
    held = force[-round(200 * (HOLD - 1.0)):]
    touched = seen[int(np.argmax(force > 1.0))]
    along = np.array([n @ (_at(s, work.link, point) - _at(touched, work.link, point)) for s in seen])
    return Outcome(work.link, work.side, work.relaxing, float(force.max()), float(np.median(held)),
                   float(np.median(along[-held.size:])), _power(seen),
                   max(float(np.linalg.norm(s.command.x - s.command.x_d)) for s in seen))


def _at(snapshot: Snapshot, link: int, point: np.ndarray) -> np.ndarray:
    return apply(snapshot.T_world_link[link], point)


def _power(seen: list[Snapshot]) -> float | None:
    """The least F . v_c in RELAX, once the arm had time to brake."""
    least, since = [], 0.0
    for s in seen:
        since = s.time if s.command.mode is not Mode.RELAX else since
        if s.contact is not None and s.time - since > BRAKING:
            least.append(float(s.contact.F_world @ s.contact.J_c @ s.command.dq))
    return min(least, default=None)


def printed(found: list[Outcome]) -> list[str]:
    """The table, relaxing and not side by side."""
    lines = [f"{'push':<6}{'force held [N]':>16}{'peak [N]':>16}{'gives way [cm]':>16}{'F.v_c [W]':>12}{'EE error [mm]':>16}",
             f"{'':6}" + f"{'relaxing':>10}{'not':>6}" * 3 + f"{'least':>12}{'relaxing':>10}{'not':>6}"]
    pairs = {(o.link, o.side, o.relaxing): o for o in found}
    for link, side in dict.fromkeys((o.link, o.side) for o in found):
        on, off = pairs[link, side, True], pairs[link, side, False]
        power = "-" if on.power is None else f"{on.power:.2f}"
        lines.append(f"{link} {side:<4}{on.held:10.1f}{off.held:6.1f}{on.peak:10.1f}{off.peak:6.1f}{100 * on.given_way:10.1f}"
                     f"{100 * off.given_way:6.1f}{power:>12}{1e3 * on.ee_error:10.2f}{1e3 * off.ee_error:6.2f}")
    return lines
