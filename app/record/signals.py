"""The signals of a run: one row per control tick, float64 without loss, as columns in memory and as a Parquet file."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrc.errors import HrcError
from hrc.messages import Mode, Snapshot

if TYPE_CHECKING:
    import pyarrow as pa

Columns = Mapping[str, NDArray[Any]]
MODES = tuple(Mode)
_CODE = {mode: code for code, mode in enumerate(MODES)}
_ROWS = 1000
MOST_TOUCHES = 4
"""Touches a row has room for."""


@dataclass(frozen=True)
class Signal:
    """One column. width 1 is a scalar, else a vector; kind: "float", "int", "bool" or "mode".

    frame: "world" for what has coordinates there, "joints" for one value of each joint 1 to 7, else empty.
    """

    name: str
    width: int
    unit: str
    meaning: str
    kind: str = "float"
    frame: str = ""


SIGNALS = (
    Signal("tick", 1, "1", "tick of the base rate", "int"),
    Signal("t", 1, "s", "simulated time"),
    Signal("q", 7, "rad", "measured joint positions", frame="joints"),
    Signal("dq", 7, "rad/s", "measured joint velocities", frame="joints"),
    Signal("dq_command", 7, "rad/s", "commanded joint velocities", frame="joints"),
    Signal("tau", 7, "N m", "measured link-side joint torques", frame="joints"),
    Signal("residual", 7, "N m", "momentum residual, Eq. (2)", frame="joints"),
    Signal("ee", 3, "m", "end effector", frame="world"),
    Signal("ee_desired", 3, "m", "reference of the end effector", frame="world"),
    Signal("force_est", 3, "N", "estimated contact force on the robot, Eq. (5); NaN without a contact", frame="world"),
    Signal("force_true", 3, "N", "true net contact force on the robot", frame="world"),
    Signal("contact_point_est", 3, "m", "estimated contact point; NaN without a contact", frame="world"),
    Signal("contact_point_true", 3, "m", "true contact point; NaN without a contact", frame="world"),
    Signal("contact_link_est", 1, "1", "estimated link in contact; -1 without a contact", "int"),
    Signal("contact_seen", 1, "1", "whether a camera sees an obstacle at the estimated contact; else it is felt alone", "bool"),
    Signal("contact_radius", 1, "m", "radius around the estimated point, holds the contact with 90 %; NaN without a contact"),
    Signal("contact_link_true", 1, "1", "true link in contact; -1 without a contact", "int"),
    Signal("contact_visible", 1, "1", "whether a noise-free camera would see the true contact point", "bool"),
    Signal("contact_power", 1, "W", "estimated force times the commanded velocity of the contact point; "
                                    "NaN without a contact"),
    Signal("distance_min", 1, "m", "distance of the nearest point at which a contact is looked for; NaN with none"),
    *(Signal(f"clearance_{link}", 1, "m", f"distance of link {link} to the nearest obstacle; inf with none in range")
      for link in range(1, 8)),
    Signal("touches", 1, "1", "separate places where an obstacle is as near as in a contact", "int"),
    Signal("touch_links", MOST_TOUCHES, "1", "link of each touch; NaN beyond the last"),
    Signal("touch_points", 3 * MOST_TOUCHES, "m", "point of each touch, one after another; NaN beyond the last", frame="world"),
    Signal("touch_sure", MOST_TOUCHES, "1", "1 where the touch is sure, 0 where it may be hidden; NaN beyond the last"),
    Signal("silent_cameras", 1, "1", "cameras without images: 1 for the first, plus 2 for the second, plus 4 ...", "int"),
    Signal("sigma_min", 1, "m", "smallest singular value of the contact Jacobian, Eq. (10); NaN without a contact"),
    Signal("admittance_error", 3, "m", "admittance error x_cd - x_c; zero outside ABORT", frame="world"),
    Signal("state", 1, "text", "mode of the reaction", "mode"),
)


def _slices() -> Iterator[tuple[str, slice]]:
    start = 0
    for signal in SIGNALS:
        yield signal.name, slice(start, start + signal.width)
        start += signal.width


AT = dict(_slices())
"""Where each signal lies in a row."""
WIDTH = sum(signal.width for signal in SIGNALS)
_NAN = float("nan")
_NOWHERE = (_NAN, _NAN, _NAN)


def row(snapshot: Snapshot) -> NDArray[np.float64]:
    """The signals of one snapshot in the order of `SIGNALS`, shape (WIDTH,); whole numbers are exact in float64."""
    state, command, truth, contact = snapshot.state, snapshot.command, snapshot.truth, snapshot.contact
    nearest, touches = snapshot.nearest, snapshot.touches
    if contact is None:
        force = point = _NOWHERE
        link, power, sigma_min, seen, radius = -1, _NAN, _NAN, False, _NAN
    else:
        force, point, link, sigma_min = contact.F_world.tolist(), contact.p_world.tolist(), contact.link, contact.sigma_min
        power, seen, radius = float(contact.F_world @ (contact.J_c @ command.dq)), contact.seen, contact.radius
    clearance = [math.inf] * 8
    for c in snapshot.clearances:
        clearance[c.link] = min(clearance[c.link], c.distance)
    beyond = (MOST_TOUCHES - len(touches)) * (_NAN,)
    return np.array((  # numbers of Python's own: to join two dozen short arrays takes twice the time
        snapshot.tick, snapshot.time, *state.q.tolist(), *state.dq.tolist(), *command.dq.tolist(), *state.tau.tolist(),
        *snapshot.residual.tolist(), *command.x.tolist(), *command.x_d.tolist(),
        *force, *truth.F_world.tolist(), *point, *truth.p_world.tolist(),
        link, seen, radius, truth.link, truth.visible, power, nearest.distance if nearest else _NAN,
        *clearance[1:], len(touches), *(touch.link for touch in touches), *beyond,
        *(x for touch in touches for x in touch.p_world.tolist()), *beyond, *beyond, *beyond,
        *(touch.sure for touch in touches), *beyond, sum(1 << i for i, view in enumerate(snapshot.views) if view.silent),
        sigma_min, *command.admittance_error.tolist(), _CODE[command.mode]), np.float64)


class SignalTable:
    """An observer that keeps the signals of every control tick."""

    def __init__(self) -> None:
        self._full: list[NDArray[np.float64]] = []
        self._block = np.empty((_ROWS, WIDTH))
        self._n = 0

    def on_step(self, snapshot: Snapshot) -> None:
        """Append a row if this tick brought a new command."""
        if not snapshot.fresh_control:
            return
        self._block[self._n] = row(snapshot)
        self._n += 1
        if self._n == _ROWS:
            self._full.append(self._block)
            self._block, self._n = np.empty((_ROWS, WIDTH)), 0

    def __len__(self) -> int:
        return len(self._full) * _ROWS + self._n

    def columns(self) -> dict[str, NDArray[Any]]:
        """Every signal by name, shape (rows,) or (rows, width)."""
        return typed(np.concatenate([*self._full, self._block[: self._n]]))


def typed(rows: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Rows of shape (n, WIDTH) as columns, each in the type of its signal."""
    return {signal.name: _typed(signal, rows[:, AT[signal.name]]) for signal in SIGNALS}


def _typed(signal: Signal, values: NDArray[np.float64]) -> NDArray[Any]:
    if signal.width > 1:
        return np.ascontiguousarray(values)
    scalar = values[:, 0]
    if signal.kind == "mode":
        return np.array([mode.value for mode in MODES])[scalar.astype(int)]
    return scalar.astype({"float": np.float64, "int": np.int64, "bool": np.bool_}[signal.kind])


def digest(columns: Columns) -> str:
    """SHA-256 over names and bytes of all columns: equal for two runs exactly when every bit is."""
    total = hashlib.sha256()
    for name, values in columns.items():
        total.update(name.encode())
        total.update(np.ascontiguousarray(values).tobytes())
    return total.hexdigest()


def arrow(columns: Columns, about: Mapping[str, Any] | None = None) -> "pa.RecordBatch":
    """The columns for Arrow; unit, frame and meaning stand in each field's metadata, `about` as JSON in the schema's."""
    import pyarrow as pa  # here and below, because `replay` and the page start without it

    arrays, fields = [], []
    for signal in SIGNALS:
        values = columns[signal.name]
        mode = signal.kind == "mode"
        flat = pa.array(values.tolist(), pa.string()) if mode else pa.array(values.reshape(-1), from_pandas=False)
        array = pa.FixedSizeListArray.from_arrays(flat, signal.width) if signal.width > 1 else flat
        arrays.append(array)
        fields.append(pa.field(signal.name, array.type, nullable=False,
                               metadata={"unit": signal.unit, "frame": signal.frame, "meaning": signal.meaning}))
    return pa.RecordBatch.from_arrays(arrays, schema=pa.schema(fields, metadata={"elbowroom": json.dumps(dict(about or {}))}))


def write_parquet(path: Path, columns: Columns, about: Mapping[str, Any] | None = None) -> None:
    """Write the columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_batches([arrow(columns, about)]), path, compression="zstd")


def read_parquet(path: Path) -> dict[str, NDArray[Any]]:
    """The columns again, bit for bit. Raises HrcError if the file lacks one of them."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    missing = [signal.name for signal in SIGNALS if signal.name not in table.column_names]
    if missing:
        raise HrcError(f"{path} is no table of signals: it lacks {', '.join(missing)}")
    return columns_of(table)


def columns_of(table: "pa.Table") -> dict[str, NDArray[Any]]:
    """What `arrow` has made, as columns again, bit for bit."""
    columns: dict[str, NDArray[Any]] = {}
    for signal in SIGNALS:
        column = table[signal.name].combine_chunks()
        if signal.width > 1:
            columns[signal.name] = column.flatten().to_numpy(zero_copy_only=False).reshape(-1, signal.width)
        elif signal.kind == "mode":
            columns[signal.name] = np.array(column.to_pylist(), dtype=_typed(signal, np.zeros((0, 1))).dtype)
        else:
            columns[signal.name] = column.to_numpy(zero_copy_only=False)
    return columns
