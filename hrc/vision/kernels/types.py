"""What all kernels share: the compile options of their one Warp module, array types, and the layout of an image.

Images are one-dimensional, row after row, padded to whole tiles. Nothing measured is +inf in an image, but `FAR`, a finite
depth, in the arithmetic: an infinite one would turn into NaN when multiplied by a ray that is zero.
"""

import math
import platform
from pathlib import Path

import numpy as np
import warp as wp

from hrc.vision.camera import Camera

wp.config.log_level = wp.LOG_WARNING

TILE_W = 16
TILE_H = 8
TILE = TILE_W * TILE_H
MAX_CANDIDATES = 256
"""Obstacle tiles a robot tile can list; one that needs more looks at all tiles instead."""
FAR = 1.0e3
"""No measurement [m]."""
NEAR = 0.05
"""Triangles with a vertex nearer to the camera than this [m] are not drawn."""
NO_LINK = 255
LINK_COUNT = 8
"""Base and links of the robot: the ids 0 to 7 of its raster."""
ID = wp.constant(wp.uint32(0x0000000F))
VALUE = wp.constant(wp.uint32(0xFFFFFFF0))
"""The parts of a raster key: the id of what is seen, and the bits of 1/z that remain."""

Floats = wp.array(dtype=wp.float32)
Ints = wp.array(dtype=wp.int32)
Keys = wp.array(dtype=wp.uint32)
Longs = wp.array(dtype=wp.int64)
Ranks = wp.array(dtype=wp.uint64)
Points = wp.array(dtype=wp.vec3)
Poses = wp.array(dtype=wp.mat44)


_FLAGS = "-mllvm=-inline-threshold=9000 -mllvm=-slp-recursion-max-depth=4"
_V4 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "avx2", "bmi2", "fma"}


def cpu_levels() -> tuple[str, ...]:
    """The compiler flags for each level of this architecture's CPUs, the most capable first.

    Warp's default names the very CPU it compiles on; a fixed level keeps the compiled kernels valid elsewhere.
    """
    if platform.machine() not in ("x86_64", "AMD64"):
        return (_FLAGS,)
    # A tile is 16 wide. Without the last flag of the first level the compiler would use half of a register.
    return f"{_FLAGS} -target-cpu x86-64-v4 -mprefer-vector-width=512", f"{_FLAGS} -target-cpu x86-64-v3", _FLAGS


def cpu_flags() -> str:
    """Those of the best level that this machine has; of the least where it does not tell."""
    levels, cpuinfo = cpu_levels(), Path("/proc/cpuinfo")
    if len(levels) == 1 or not cpuinfo.exists():
        return levels[-1]
    known = set(cpuinfo.read_text().partition("\nflags")[2].partition("\n")[0].split())
    return levels[0] if known >= _V4 else levels[1] if "avx2" in known else levels[2]


MODULE = wp.get_module("hrc_vision")
wp.set_module_options({"enable_backward": False, "max_unroll": 4, "cpu_compiler_flags": cpu_flags()}, module=MODULE)


@wp.struct
class Grid:
    """Intrinsics of the camera and the layout of its images on the device."""

    width: wp.int32
    height: wp.int32
    stride: wp.int32
    tiles_x: wp.int32
    tiles_y: wp.int32
    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    ray: wp.float32  # length of the longest ray at depth 1


def grid(camera: Camera) -> Grid:
    """The layout for a camera's images."""
    c, g = camera.config, Grid()
    g.width, g.height, g.fx, g.fy, g.cx, g.cy = c.width, c.height, c.fx, c.fy, c.cx, c.cy
    g.tiles_x, g.tiles_y = math.ceil(c.width / TILE_W), math.ceil(c.height / TILE_H)
    g.stride = g.tiles_x * TILE_W
    u = max(abs(c.cx), abs(c.width - 1 - c.cx)) / c.fx
    v = max(abs(c.cy), abs(c.height - 1 - c.cy)) / c.fy
    g.ray = math.sqrt(1.0 + u * u + v * v)
    return g


@wp.func
def depth_of(key: wp.uint32) -> float:
    """Depth [m] of a raster key that is not 0."""
    return 1.0 / wp.cast(key & VALUE, wp.float32)


def pixels(g: Grid) -> int:
    """Entries of an image buffer. Beyond the last row there is some to spare: triangles are drawn in whole vectors."""
    return g.stride * (g.tiles_y * TILE_H + 3) + TILE_W


def to_image(buffer: np.ndarray, g: Grid) -> np.ndarray:
    """The (H, W) view of a flat padded image."""
    rows = g.tiles_y * TILE_H
    return buffer[: g.stride * rows].reshape(rows, g.stride)[: g.height, : g.width]


def pack(depth: np.ndarray, link: np.ndarray, g: Grid) -> np.ndarray:
    """The flat raster keys of a depth image [m] (+inf where nothing is) and its link image: the raster's own format."""
    with np.errstate(divide="ignore"):
        bits = (1.0 / np.where(depth > 0, depth, np.inf)).astype(np.float32).view(np.uint32)
    # To the nearest key: `unpack` of it gives a depth that packs to the same key again.
    keys = np.where(bits > 0, ((bits + np.uint32(8)) & np.uint32(0xFFFFFFF0)) | (link & 15).astype(np.uint32), 0)
    flat = np.zeros(pixels(g), np.uint32)
    to_image(flat, g)[:] = keys
    return flat


def key_depth(key: np.uint32) -> float:
    """Depth [m] of one raster key that is not 0."""
    return 1.0 / float((key & np.uint32(0xFFFFFFF0)).view(np.float32))


def unpack(flat: np.ndarray, g: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] (H, W) float32, +inf where nothing is, and link (H, W) uint8, 255 there, from flat raster keys."""
    keys = to_image(flat, g)
    with np.errstate(divide="ignore"):
        depth = np.float32(1.0) / (keys & np.uint32(0xFFFFFFF0)).view(np.float32)
    return depth, np.where(keys > 0, keys & np.uint32(15), np.uint32(NO_LINK)).astype(np.uint8)
