"""The inner loops that a CPU compiler can only vectorise when they are written out in C++.

Everything compiles for CUDA as well.
"""

import warp as wp

from hrc.vision.kernels.types import Grid


# The keys of one tile back to the background, 0 without one.
@wp.func_native(r"""
    for (int r = 0; r < 8; ++r) {
        unsigned* __restrict k = keys.data + first + r * g.stride;
        if (background.shape[0] == 0) {
            for (int i = 0; i < 16; ++i) k[i] = 0u;
        } else {
            const unsigned* __restrict b = background.data + first + r * g.stride;
            for (int i = 0; i < 16; ++i) k[i] = b[i];
        }
    }
""")
def erase_tile(keys: wp.array(dtype=wp.uint32), background: wp.array(dtype=wp.uint32), first: int, g: Grid): ...


# A row of raster keys to depth [m], +inf where nothing is, and id, 255 there.
@wp.func_native(r"""
    const unsigned* __restrict k = keys.data + row * g.stride;
    float* __restrict d = depth.data + row * g.stride;
    wp::uint8* __restrict l = link.data + row * g.stride;
    for (int i = 0; i < g.stride; ++i) {
        const unsigned key = k[i];
        d[i] = 1.0f / __builtin_bit_cast(float, key & 0xFFFFFFF0u);
        l[i] = (wp::uint8)(key ? key & 15u : 255u);
    }
""")
def resolve_row(keys: wp.array(dtype=wp.uint32), row: int, g: Grid, depth: wp.array(dtype=wp.float32),
                link: wp.array(dtype=wp.uint8)): ...


# The filter of Sec. III-B on the tile at (u, v): d_f = d_r if d_r < d_v, else +inf. `frame` holds the address of d_r, rows of
# g.width; `cover` is the robot's raster, `fixed` the environment's 1/z. A pixel stays only if at least `neighbours` of the
# eight around it pass as well, within `step` of it in depth. Returns the least and largest depth left, (FAR, 0) for none.
# Tiles at the image's border take the slow way, pixel by pixel.
@wp.func_native(r"""
    const float far = 1.0e3f, inf = __builtin_bit_cast(float, 0x7F800000u);
    const int W = g.width;
    const float* __restrict raw = (const float*)frame.data[0] + (long long)v * W + u;
    const unsigned* __restrict c = cover.data + v * g.stride + u;
    const float* __restrict e = fixed.data + v * g.stride + u;
    float* __restrict f = foreground.data + v * g.stride + u;
    const bool inside = (u > 0) & (v > 0) & (u + 16 < W) & (v + 8 < g.height);
    const int columns = u + 16 < W ? 16 : W - u, rows = v + 8 < g.height ? 8 : g.height - v;
    int least = 0x7f7fffff, most = 0;
    const auto keep = [&](const float z, const unsigned key, const float behind) {
        const float robot = __builtin_bit_cast(float, key & 0xFFFFFFF0u), m = robot > behind ? robot : behind;
        return (z > 0.0f) & (z < far) & (z * m < 1.0f);
    };
    const auto close = [&](const float a, const float b) { return (int)((a > 0.0f) & (a - b < step) & (b - a < step)); };
#if !defined(__CUDA_ARCH__)
    // The tile below is looked at soon, and a new frame is in no cache: a tile's rows are too far apart to be foreseen.
    for (int r = 8; r < 16; ++r) __builtin_prefetch(raw + r * W);
#endif
    if (inside) {
        for (int r = 0; r < 8; ++r) {
            #pragma clang loop vectorize(enable)
            for (int i = 0; i < 16; ++i) {
                const float z = raw[r * W + i];
                const bool kept = keep(z, c[r * g.stride + i], e[r * g.stride + i]);
                const int bits = __builtin_bit_cast(int, z), low = kept ? bits : 0x7f7fffff, high = kept ? bits : 0;
                f[r * g.stride + i] = kept ? z : inf;
                least = low < least ? low : least;
                most = high > most ? high : most;
            }
        }
        if (most == 0) return wp::vec2(far, 0.0f);
        if (neighbours > 0) {
            least = 0x7f7fffff; most = 0;
            float passed[10 * 18];
            for (int r = 0; r < 10; ++r) {
                const float* __restrict p = raw + (r - 1) * W - 1;
                const int o = (r - 1) * g.stride - 1;
                #pragma clang loop vectorize(enable)
                for (int i = 0; i < 18; ++i) passed[r * 18 + i] = keep(p[i], c[o + i], e[o + i]) ? p[i] : 0.0f;
            }
            for (int r = 0; r < 8; ++r) {
                const float* __restrict p = passed + (r + 1) * 18 + 1;
                #pragma clang loop vectorize(enable)
                for (int i = 0; i < 16; ++i) {
                    const float z = f[r * g.stride + i];
                    const int count = close(p[i - 19], z) + close(p[i - 18], z) + close(p[i - 17], z)
                                    + close(p[i - 1], z) + close(p[i + 1], z)
                                    + close(p[i + 17], z) + close(p[i + 18], z) + close(p[i + 19], z);
                    const bool kept = (z < far) & (count >= neighbours);
                    const int bits = __builtin_bit_cast(int, z), low = kept ? bits : 0x7f7fffff, high = kept ? bits : 0;
                    f[r * g.stride + i] = kept ? z : inf;
                    least = low < least ? low : least;
                    most = high > most ? high : most;
                }
            }
        }
    } else {
        for (int r = 0; r < 8; ++r) for (int i = 0; i < 16; ++i) {
            const bool seen = (r < rows) & (i < columns);
            const float z = seen ? raw[r * W + i] : inf;
            bool kept = seen && keep(z, c[r * g.stride + i], e[r * g.stride + i]);
            if (kept && neighbours > 0) {
                int count = -1;  // the pixel itself
                for (int y = r - 1; y <= r + 1; ++y) for (int x = i - 1; x <= i + 1; ++x)
                    if (v + y >= 0 && v + y < g.height && u + x >= 0 && u + x < W
                        && keep(raw[y * W + x], c[y * g.stride + x], e[y * g.stride + x])) count += close(raw[y * W + x], z);
                kept = count >= neighbours;
            }
            const int bits = __builtin_bit_cast(int, z);
            f[r * g.stride + i] = kept ? z : inf;
            if (kept && bits < least) least = bits;
            if (kept && bits > most) most = bits;
        }
    }
    return most == 0 ? wp::vec2(far, 0.0f)
                     : wp::vec2(__builtin_bit_cast(float, least), __builtin_bit_cast(float, most));
""")
def filter_tile(frame: wp.array(dtype=wp.uint64), cover: wp.array(dtype=wp.uint32), fixed: wp.array(dtype=wp.float32),
                u: int, v: int, neighbours: int, step: float, g: Grid, foreground: wp.array(dtype=wp.float32)) -> wp.vec2: ...


# Least and largest depth of the pixels of a tile whose link is in the bit set `links`; (FAR, 0) without any.
@wp.func_native(r"""
    unsigned most = 0u, least = 0xFFFFFFFFu;
    for (int r = 0; r < 8; ++r) {
        const unsigned* __restrict k = keys.data + first + r * g.stride;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < 16; ++i) {
            const unsigned key = k[i];
            const bool on = (key != 0u) & (((links >> (key & 15u)) & 1u) != 0u);
            const unsigned up = on ? key & 0xFFFFFFF0u : 0u, down = on ? key & 0xFFFFFFF0u : 0xFFFFFFFFu;
            most = up > most ? up : most;
            least = down < least ? down : least;
        }
    }
    if (most == 0u) return wp::vec2(1.0e3f, 0.0f);
    return wp::vec2(1.0f / __builtin_bit_cast(float, most), 1.0f / __builtin_bit_cast(float, least));
""")
def robot_range(keys: wp.array(dtype=wp.uint32), first: int, links: wp.uint32, g: Grid) -> wp.vec2: ...


# The runs of one surface along a line of n pixels, `stride` apart: no two side by side differ by `step` or more in depth.
# `square` is that of a pixel's length at depth 1. Every pixel gets the product of the run's lengths to either side, each up to
# `longest` pixels and the half to its border, and the square of their mean where the run is flat between these ends; or what is
# there, if it is less. After the last direction, it gets how far back the obstacle reaches.
@wp.func_native(r"""
    const float* __restrict d = depth.data + first_pixel;
    float* __restrict b = back.data + first_pixel;
    float before = __builtin_bit_cast(float, 0x7F800000u);
    int start = 0;
    for (int i = 0; i <= n; ++i) {
        const float z = i < n ? d[i * stride] : __builtin_bit_cast(float, 0x7F800000u);
        if (z - before < step && before - z < step) { before = z; continue; }
        if (before < 1.0e3f) {
            for (int j = start; j < i; ++j) {
                const int l = j - start < longest ? j - start : longest, r = i - 1 - j < longest ? i - 1 - j : longest;
                const float old = b[j * stride], depth_here = d[j * stride], width = (float)(l + r + 1);
                const float sag = 0.5f * (d[(j - l) * stride] + d[(j + r) * stride]) - d[(j + (r - l) / 2) * stride];
                const bool flat = sag < flatness * sqrtf(square) * width * depth_here;
                float s = square * (flat ? 0.25f * width * width : ((float)l + 0.5f) * ((float)r + 0.5f));
                if (!first_direction) s = old < s ? old : s;
                if (last_direction) {
                    const float t = 2.0f * sqrtf(s) * depth_here;
                    s = depth_here + (t < thickness ? t : thickness);
                }
                b[j * stride] = s;
            }
        }
        start = i;
        before = z;
    }
""")
def chord_line(depth: wp.array(dtype=wp.float32), first_pixel: int, stride: int, n: int, square: float, first_direction: int,
               last_direction: int, longest: int, step: float, flatness: float, thickness: float,
               back: wp.array(dtype=wp.float32)): ...
