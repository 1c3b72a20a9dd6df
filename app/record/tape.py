"""What a robot measured at every tick, and what stood before its cameras: enough for a replay that moves no robot."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.record.signals import Columns
from hrc.cell.playback import Tape
from hrc.messages import LINKS, Body, Snapshot
from hrc.scene import Scene
from hrc.sim.push import HAND

ROBOT, EXPOSURES = "robot.parquet", "exposures.parquet"
_ROWS, _WIDTH, _POSE = 5000, 22, 16


class TapeTable:
    """An observer that keeps the robot's readings at every tick and what stood before the cameras at every exposure."""

    def __init__(self) -> None:
        self._full: list[NDArray[np.float64]] = []
        self._block = np.empty((_ROWS, _WIDTH))
        self._n = 0
        self._exposed: dict[int, NDArray[np.float64]] = {}
        self._names: tuple[str, ...] = ()

    def on_step(self, snapshot: Snapshot) -> None:
        """Take one step."""
        state, row = snapshot.state, self._block[self._n]
        row[0], row[1:8], row[8:15], row[15:] = state.tick, state.q, state.dq, state.tau
        if snapshot.exposed is not None:
            T, bodies = snapshot.exposed
            self._names = tuple(body.name for body in bodies)
            poses = [T, *(body.T_world_body[None] if body.present else np.full((1, 4, 4), np.nan) for body in bodies)]
            self._exposed[len(self._full) * _ROWS + self._n] = np.concatenate(poses)
        self._n += 1
        if self._n == _ROWS:
            self._full.append(self._block)
            self._block, self._n = np.empty((_ROWS, _WIDTH)), 0

    def tape(self, columns: Columns, scene: Scene) -> Tape:
        """Together with the signals of the same steps."""
        rows = np.concatenate([*self._full, self._block[: self._n]])
        return _tape(rows, self._exposed, self._names, columns, scene)

    def write(self, folder: Path) -> None:
        """Write robot.parquet and exposures.parquet."""
        rows = np.concatenate([*self._full, self._block[: self._n]])
        _write(folder / ROBOT, {"stamp": rows[:, 0].astype(np.int64), "q": rows[:, 1:8], "dq": rows[:, 8:15],
                                "tau": rows[:, 15:]}, {"q": "rad", "dq": "rad/s", "tau": "N m"})
        poses = np.array(list(self._exposed.values())).reshape(len(self._exposed), -1, _POSE)
        bodies = {name: poses[:, len(LINKS) + i] for i, name in enumerate(self._names)}
        _write(folder / EXPOSURES, {"step": np.array(list(self._exposed), np.int64),
                                    "links": poses[:, : len(LINKS)].reshape(len(poses), len(LINKS) * _POSE), **bodies})


def read_tape(folder: Path, columns: Columns, scene: Scene) -> Tape:
    """The tape again, bit for bit. Raises OSError or ValueError for what is none."""
    robot, exposures = _read(folder / ROBOT), _read(folder / EXPOSURES)
    rows = np.concatenate([robot["stamp"][:, None], robot["q"], robot["dq"], robot["tau"]], axis=1)
    names = tuple(name for name in exposures if name not in ("step", "links"))
    poses = np.concatenate([exposures["links"], *(exposures[name] for name in names)], axis=1)
    poses = poses.reshape(len(poses), -1, 4, 4)
    return _tape(rows, dict(zip(exposures["step"].tolist(), poses, strict=True)), names, columns, scene)


def _tape(rows: NDArray[np.float64], exposed: Mapping[int, NDArray[np.float64]], names: tuple[str, ...], columns: Columns,
          scene: Scene) -> Tape:
    specs = {body.name: body for body in (*scene.bodies, HAND)}

    def bodies(poses: NDArray[np.float64]) -> tuple[Body, ...]:
        return tuple(Body(name, specs[name].shape, specs[name].size, T, present=bool(np.isfinite(T[0, 0])))
                     for name, T in zip(names, poses, strict=True))

    return Tape(
        rows[:, 0].astype(np.int64), rows[:, 1:8], rows[:, 8:15], rows[:, 15:],
        {step: (poses[: len(LINKS)], bodies(poses[len(LINKS) :])) for step, poses in exposed.items()},
        columns["dq_command"], columns["state"], columns["force_true"], columns["contact_point_true"],
        columns["contact_link_true"], columns["contact_visible"])


def _write(path: Path, columns: Mapping[str, NDArray[Any]], units: Mapping[str, str] | None = None) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays, fields = [], []
    for name, values in columns.items():
        flat = pa.array(values.reshape(-1), from_pandas=False)
        arrays.append(pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim > 1 else flat)
        fields.append(pa.field(name, arrays[-1].type, nullable=False, metadata={"unit": (units or {}).get(name, "1")}))
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path, compression="zstd")


def _read(path: Path) -> dict[str, NDArray[Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table, columns = pq.read_table(path), dict[str, NDArray[Any]]()
    for name in table.column_names:
        column = table[name].combine_chunks()
        if pa.types.is_fixed_size_list(column.type):
            columns[name] = column.flatten().to_numpy(zero_copy_only=False).reshape(-1, column.type.list_size)
        else:
            columns[name] = column.to_numpy(zero_copy_only=False)
    return columns
