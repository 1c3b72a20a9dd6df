"""Columns for `send_columns`, made in Arrow at once, many entities from one array.

The SDK's own builders take as long as the sending: a dozen objects for each column, and an array of NumPy's for each, to let go
of which the SDK's threads have to take the interpreter's lock.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

_NONE = np.zeros(1, np.int32)


class Column(rr.ComponentColumn):
    """Of one component: a list of values for each row."""

    def __init__(self, descriptor: rr.ComponentDescriptor, lists: pa.ListArray) -> None:
        super().__init__(descriptor, lists, offsets=_NONE)  # as it is: `as_arrow_array` below knows better
        self._lists = lists

    def as_arrow_array(self) -> pa.ListArray:
        """The lists."""
        return self._lists


def scalars(curves: Sequence[NDArray[np.float64]]) -> list[Column]:
    """A column for each array of shape (rows,) or (rows, curves)."""
    flat = pa.array(np.concatenate([values.reshape(-1) for values in curves]))
    descriptor, columns, at = rr.Scalars.descriptor_scalars(), list[Column](), 0
    for values in curves:
        each = values.shape[1] if values.ndim > 1 else 1
        columns.append(Column(descriptor, pa.ListArray.from_arrays(_offsets(len(values), each), flat.slice(at, values.size))))
        at += values.size
    return columns


def vectors(descriptor: rr.ComponentDescriptor, values: NDArray[np.floating], there: NDArray[np.bool_] | None = None) -> Column:
    """A column of one vector a row, (rows, 3) or (rows, 4); a row that is not `there`, (rows,), is empty."""
    if there is None:
        offsets, kept = _offsets(len(values), 1), values
    else:
        offsets, kept = pa.array(np.concatenate([_NONE, np.cumsum(there, dtype=np.int32)])), values[there]
    return Column(descriptor, pa.ListArray.from_arrays(offsets, _fixed(kept)))


def transforms(tracks: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> list[list[Column]]:
    """The columns of Transform3D for each track of positions [m] (rows, 3) and quaternions (x, y, z, w) (rows, 4)."""
    names = rr.Transform3D.descriptor_translation(), rr.Transform3D.descriptor_quaternion()
    arrays = [_fixed(np.concatenate(parts)) for parts in zip(*tracks, strict=True)]
    columns, at = list[list[Column]](), 0
    for positions, _ in tracks:
        n = len(positions)
        columns.append([Column(name, pa.ListArray.from_arrays(_offsets(n, 1), array.slice(at, n)))
                        for name, array in zip(names, arrays, strict=True)])
        at += n
    return columns


def _fixed(values: NDArray[np.floating]) -> pa.FixedSizeListArray:
    width = values.shape[1]
    flat = pa.array(np.ascontiguousarray(values, np.float32).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, type=pa.list_(pa.field("item", pa.float32(), nullable=False), width))


@cache
def _offsets(rows: int, each: int) -> pa.Array:
    return pa.array(np.arange(rows + 1, dtype=np.int32) * each)
