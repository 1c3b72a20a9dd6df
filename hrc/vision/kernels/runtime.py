"""Devices, buffers and captured graphs: the little of Warp's runtime that the rest of the package sees."""

import functools
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from hrc.errors import DeviceError, unknown
from hrc.vision.kernels.types import MODULE, TILE, Grid, cpu_flags, cpu_levels, to_image


@functools.cache
def _start() -> None:
    """Initialise Warp without its line, written to stderr by C++, that there is no CUDA driver: on a CPU no news."""
    try:
        stderr = os.dup(2)
    except OSError:  # closed: then nothing can be written either
        wp.init()
        return
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            said.seek(0)
            for line in said.read().decode(errors="replace").splitlines():
                if "CUDA driver" not in line:
                    print(line, file=sys.stderr)


def check_device(name: str) -> str:
    """The device's full name. Raises DeviceError, naming those there are, if it is not available."""
    _start()
    known = [d.alias for d in wp.get_devices()]
    full = "cuda:0" if name == "cuda" else name
    if full not in known:
        raise DeviceError(unknown("device", name, known))
    return full


def warm(device: str = "cpu") -> None:
    """Compile or load every kernel for `device`: seconds the very first time, milliseconds from the cache.

    Raises DeviceError if there is no such device.
    """
    # The kernels' modules must be imported, or there is nothing to compile yet.
    from hrc.vision.kernels import clearance, contact, distance, evidence, filtering, noise, raster, touches  # noqa: F401

    wp.load_module(MODULE, device=check_device(device))


def warm_for_others() -> None:
    """Compile every kernel for all CPUs of this architecture into the cache, which an image takes to other machines."""
    for flags in (*cpu_levels(), cpu_flags()):  # what this machine can run is loaded last
        wp.set_module_options({"cpu_compiler_flags": flags}, module=MODULE)
        warm()


def zeros(n: int, dtype: Any, device: str) -> Any:
    """A device buffer of `n` zeros."""
    return wp.zeros(n, dtype=dtype, device=device)


def upload(values: np.ndarray, dtype: Any, device: str) -> Any:
    """A device buffer with these values; `dtype` may be a name, such as "uint32"."""
    return wp.array(values, dtype=getattr(wp, dtype) if isinstance(dtype, str) else dtype, device=device)


def write(buffer: Any, values: np.ndarray) -> None:
    """Overwrite a device buffer in place: its address is part of the captured graphs."""
    if buffer.device.is_cpu:
        buffer.numpy()[...] = values
    else:
        buffer.assign(values)


class Mirror:
    """A small device buffer and its values in numpy, which on a CPU are the same memory; `buffer` keeps its address."""

    def __init__(self, n: int, dtype: Any, device: str) -> None:
        self.buffer = zeros(n, dtype, device)
        self._values, self._same = self.buffer.numpy(), self.buffer.device.is_cpu

    def __len__(self) -> int:
        return len(self.buffer)

    def write(self, values: ArrayLike) -> None:
        """Put these values, or one for all, into the buffer."""
        self._values[...] = values
        if not self._same:
            self.buffer.assign(self._values)

    def read(self) -> np.ndarray:
        """The values there are now: on a CPU a view, valid until they change."""
        return self._values if self._same else self.buffer.numpy()


def write_image(buffer: Any, image: np.ndarray, g: Grid) -> None:
    """Overwrite the image (H, W) in a flat padded buffer in place; the padding is 0 and stays so."""
    if buffer.device.is_cpu:
        to_image(buffer.numpy(), g)[...] = image
    else:
        flat = np.zeros(len(buffer), wp.dtype_to_numpy(buffer.dtype))
        to_image(flat, g)[...] = image
        buffer.assign(flat)


def read(buffer: Any) -> np.ndarray:
    """A device buffer in numpy: on the CPU a view of it, valid until it is written again."""
    return buffer.numpy()


def pixels_per_thread(device: str) -> int:
    """How many pixels of a tile a thread takes: all of them on a CPU, where threads run one after another."""
    return TILE if device == "cpu" else 1


def tiles_per_thread(g: Grid, device: str) -> int:
    """How many tiles side by side a thread takes: a row of them on a CPU, so that it skips quickly what is out of a region."""
    return g.tiles_x if device == "cpu" else 1


def everywhere(g: Grid, device: str) -> Any:
    """The region of all tiles: from (x, y) to before (x, y)."""
    return upload(np.array([0, 0, g.tiles_x, g.tiles_y]), wp.int32, device)


class Graph:
    """A fixed sequence of launches, replayed as a whole at a few microseconds of overhead."""

    def __init__(self, stages: Sequence[Callable[[], None]], device: str) -> None:
        warm(device)
        with wp.ScopedCapture(device=device) as capture:
            for stage in stages:
                stage()
        assert capture.graph is not None
        self._graph = capture.graph

    def replay(self) -> None:
        """Run it. Returns when the launches are queued; reading a buffer waits for them."""
        wp.capture_launch(self._graph)
