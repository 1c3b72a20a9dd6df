"""Boxes around the pixels of a tile, in rays and depth, and how near the pixels of two of them can be to each other."""

from typing import Any

import warp as wp

from hrc.vision.kernels.types import TILE_W, Floats, Grid, Keys

Extent = wp.types.vector(length=8, dtype=wp.float32)
"""Of the pixels in a tile: first and last column, first and last row, least and largest depth [m], link bits, and the number of
one of them."""
ROUNDING = wp.constant(wp.float32(3.0e-6))
"""By this [m] the bounds give way, so that rounding never rules out the nearest pixel."""


@wp.struct
class Box:
    """Rays at depth 1 from left to right and from top to bottom, depths [m] from near to far.

    Of a tile also its first pixel (u, v), another that is in the box, and the bits of the links in it.
    """

    left: wp.float32
    right: wp.float32
    top: wp.float32
    bottom: wp.float32
    near: wp.float32
    far: wp.float32
    u: wp.int32
    v: wp.int32
    pixel: wp.int32
    links: wp.uint32


Boxes: Any = wp.array(dtype=Box)


# The extent of the robot pixels in the tile at (u, v) whose link is in the bit set `links`; its link bits are 0 without any.
@wp.func_native(r"""
    unsigned column[16], most = 0u, least = 0xFFFFFFFFu, bits = 0u;
    int top = 8, bottom = 0, left = 0, right = 15;
    for (int i = 0; i < 16; ++i) column[i] = 0u;
    for (int r = 0; r < 8; ++r) {
        const unsigned* __restrict k = keys.data + (v + r) * g.stride + u;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < 16; ++i) column[i] |= k[i];
    }
    for (int i = 0; i < 16; ++i) { bits |= column[i]; column[i] = 0u; }
    if (bits == 0u) return wp::vec_t<8, float>();
    bits = 0u;
    for (int r = 0; r < 8; ++r) {
        const unsigned* __restrict k = keys.data + (v + r) * g.stride + u;
        unsigned row = 0u;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < 16; ++i) {
            const unsigned key = k[i], on = key != 0u ? (1u << (key & 15u)) & links : 0u;
            const unsigned up = on ? key & 0xFFFFFFF0u : 0u, down = on ? key & 0xFFFFFFF0u : 0xFFFFFFFFu;
            column[i] |= on;
            row |= on;
            most = up > most ? up : most;
            least = down < least ? down : least;
        }
        if (row) { if (top > r) top = r; bottom = r; }
        bits |= row;
    }
    wp::vec_t<8, float> e;
    if (bits == 0u) return e;
    while (!column[left]) ++left;
    while (!column[right]) --right;
    int at = ((top + bottom) >> 1) * 16 + ((left + right) >> 1);
    for (;; at = (at + 1) % 128) {
        const unsigned key = keys.data[(v + at / 16) * g.stride + u + at % 16];
        if (key && ((1u << (key & 15u)) & links)) break;
    }
    e[0] = (float)(u + left); e[1] = (float)(u + right); e[2] = (float)(v + top); e[3] = (float)(v + bottom);
    e[4] = 1.0f / __builtin_bit_cast(float, most); e[5] = 1.0f / __builtin_bit_cast(float, least); e[6] = (float)bits;
    e[7] = (float)at;
    return e;
""")
def robot_extent(keys: Keys, u: int, v: int, links: wp.uint32, g: Grid) -> Extent: ...  # pyright: ignore


# The extent, without depths, of what is nearer than 1 km in the tile at (u, v), which has such pixels.
@wp.func_native(r"""
    int column[16], top = 8, bottom = 0, left = 0, right = 15;
    for (int i = 0; i < 16; ++i) column[i] = 0;
    for (int r = 0; r < 8; ++r) {
        const float* __restrict f = depth.data + (v + r) * g.stride + u;
        int row = 0;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < 16; ++i) {
            const int on = f[i] < 1.0e3f ? 1 : 0;
            column[i] |= on;
            row |= on;
        }
        if (row) { if (top > r) top = r; bottom = r; }
    }
    while (left < 15 && !column[left]) ++left;
    while (right > 0 && !column[right]) --right;
    int at = ((top + bottom) >> 1) * 16 + ((left + right) >> 1);
    for (int i = 0; i < 128 && !(depth.data[(v + at / 16) * g.stride + u + at % 16] < 1.0e3f); ++i) at = (at + 1) % 128;
    wp::vec_t<8, float> e;
    e[0] = (float)(u + left); e[1] = (float)(u + right); e[2] = (float)(v + top); e[3] = (float)(v + bottom);
    e[7] = (float)at;
    return e;
""")
def obstacle_extent(depth: Floats, u: int, v: int, g: Grid) -> Extent: ...  # pyright: ignore


# Pixels [first, first + n) of the tile at (u, v), as points (x, y, z) and the squared distance [m^2] that each must not
# exceed, that of its link from `mine` on; less than 0 off the links. In four runs of n floats from `at` on.
@wp.func_native(r"""
    float* __restrict x = points.data + at;
    float* __restrict y = x + n;
    float* __restrict z = y + n;
    float* __restrict limit = z + n;
    const float ix = 1.0f / g.fx, iy = 1.0f / g.fy;
    for (int i = 0; i < n; ++i) {
        const int column = u + (first + i) % 16, row = v + (first + i) / 16;
        const unsigned key = keys.data[row * g.stride + column];
        const bool on = key != 0u && ((links >> (key & 15u)) & 1u);
        const float depth = on ? 1.0f / __builtin_bit_cast(float, key & 0xFFFFFFF0u) : 1.0e3f;
        x[i] = ((float)column - g.cx) * ix * depth;
        y[i] = ((float)row - g.cy) * iy * depth;
        z[i] = depth;
        limit[i] = on ? limits.data[mine + (int)(key & 15u)] : -1.0f;
    }
""")
def load_pixels(keys: Keys, u: int, v: int, first: int, n: int, links: wp.uint32, limits: Floats, mine: int, g: Grid,
                points: Floats, at: int): ...


# `square_gap` of each of these n pixels to an obstacle box, into the run of floats after theirs; how many are within their
# limit.
@wp.func_native(r"""
    const float* __restrict px = points.data + at;
    const float* __restrict py = px + n;
    const float* __restrict pz = py + n;
    const float* __restrict limit = pz + n;
    float* __restrict gap = points.data + at + 4 * n;
    const float left = o.left, right = o.right, top = o.top, bottom = o.bottom, near = o.near, far = o.far;
    const float near_end = near + thickness, far_end = far + thickness;
    int count = 0;
    #pragma clang loop vectorize(enable)
    for (int i = 0; i < n; ++i) {
        const float x = px[i], y = py[i], z = pz[i];
        const float inner = z < near_end ? z : near_end, low = inner > near ? inner : near;
        const float outer = z < far_end ? z : far_end, high = outer > far ? outer : far;
        const float l0 = left * low, l1 = left * high, r0 = right * low, r1 = right * high;
        const float t0 = top * low, t1 = top * high, b0 = bottom * low, b1 = bottom * high;
        const float x0 = (l0 < l1 ? l0 : l1) - x, x1 = x - (r0 > r1 ? r0 : r1);
        const float y0 = (t0 < t1 ? t0 : t1) - y, y1 = y - (b0 > b1 ? b0 : b1);
        const float z0 = low - z, z1 = z - high;
        float dx = (x0 > x1 ? x0 : x1) - rounding, dy = (y0 > y1 ? y0 : y1) - rounding, dz = (z0 > z1 ? z0 : z1) - rounding;
        dx = dx > 0.0f ? dx : 0.0f;
        dy = dy > 0.0f ? dy : 0.0f;
        dz = dz > 0.0f ? dz : 0.0f;
        const float square = dx * dx + dy * dy + dz * dz;
        gap[i] = square;
        count += square <= limit[i] ? 1 : 0;
    }
    return count;
""")
def pixel_gaps(points: Floats, at: int, n: int, o: Box, thickness: float, rounding: float) -> int: ...


# Least squared distance from a robot pixel's point (x, y, z) to the obstacle pixels of the tile at (u, v), as in `square`.
@wp.func_native(r"""
    int least[16];
    float kx[16];
    const float ix = 1.0f / g.fx, iy = 1.0f / g.fy;
    for (int i = 0; i < 16; ++i) { least[i] = 0x7f7fffff; kx[i] = ((float)(u + i) - g.cx) * ix; }
    for (int r = 0; r < 8; ++r) {
        const float ky = ((float)(v + r) - g.cy) * iy;
        const float* __restrict f = depth.data + (v + r) * g.stride + u;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < 16; ++i) {
            const float d = f[i] < 1.0e3f ? f[i] : 1.0e3f, end = d + thickness, inner = z < end ? z : end;
            const float e = d < inner ? inner : d, dx = kx[i] * e - x, dy = ky * e - y, dz = e - z;
            const float s = dx * dx + dy * dy + dz * dz;
            const int bits = __builtin_bit_cast(int, s);
            least[i] = bits < least[i] ? bits : least[i];
        }
    }
    int m = 0x7f7fffff;
    for (int i = 0; i < 16; ++i) m = least[i] < m ? least[i] : m;
    return __builtin_bit_cast(float, m);
""")
def least_square(depth: Floats, u: int, v: int, x: float, y: float, z: float, thickness: float, g: Grid) -> float: ...


@wp.func
def pixel_in(b: Box, j: int, g: Grid) -> int:
    """Pixel j of a tile's box."""
    return (b.v + j / TILE_W) * g.stride + b.u + j % TILE_W


@wp.func
def tile_box(u: int, v: int, e: Extent, near: float, far: float, g: Grid) -> Box:  # pyright: ignore
    """Of the tile at (u, v)."""
    b = Box()
    b.left = (e[0] - g.cx) / g.fx
    b.right = (e[1] - g.cx) / g.fx
    b.top = (e[2] - g.cy) / g.fy
    b.bottom = (e[3] - g.cy) / g.fy
    b.near = near
    b.far = far
    b.u = u
    b.v = v
    b.pixel = pixel_in(b, int(e[7]), g)
    b.links = wp.uint32(e[6])
    return b


@wp.func
def pixel_box(pixel: int, z: float, g: Grid) -> Box:
    """Of one pixel at depth z [m]."""
    b = Box()
    b.left = (float(pixel % g.stride) - g.cx) / g.fx
    b.right = b.left
    b.top = (float(pixel / g.stride) - g.cy) / g.fy
    b.bottom = b.top
    b.near = z
    b.far = z
    return b


@wp.func
def gap(a: float, a_end: float, b: float, b_end: float) -> float:
    """Between two ranges, less the rounding; 0 where they overlap."""
    return wp.max(0.0, wp.max(a - b_end, b - a_end) - ROUNDING)


@wp.func
def square_gap(p: Box, o: Box, thickness: float) -> float:
    """No robot pixel in p is nearer to an obstacle pixel in o than the root of this [m^2].

    The obstacle's depth that counts, clamp(z, d, d + thickness), grows with z and with d: the ends give its range.
    """
    low = wp.clamp(p.near, o.near, o.near + thickness)
    high = wp.clamp(p.far, o.far, o.far + thickness)
    x = gap(wp.min(p.left * p.near, p.left * p.far), wp.max(p.right * p.near, p.right * p.far),
            wp.min(o.left * low, o.left * high), wp.max(o.right * low, o.right * high))
    y = gap(wp.min(p.top * p.near, p.top * p.far), wp.max(p.bottom * p.near, p.bottom * p.far),
            wp.min(o.top * low, o.top * high), wp.max(o.bottom * low, o.bottom * high))
    z = gap(low, high, p.near, p.far)
    return x * x + y * y + z * z


@wp.func
def square(p: Box, o: Box, thickness: float) -> float:
    """Squared distance [m^2] of a robot pixel to an obstacle pixel."""
    e = wp.clamp(p.near, o.near, o.near + thickness)
    x = o.left * e - p.left * p.near
    y = o.top * e - p.top * p.near
    z = e - p.near
    return x * x + y * y + z * z
