"""The inner loops of the distance in C++; see `native` for why."""

import warp as wp

from hrc.vision.kernels.types import Floats, Grid, Ints, Keys, Ranks


# The distance of `pixels` pixels of a tile, from its pixel `first` on, to the obstacles: +inf off the links in the bit set
# `links` and beyond reach. The candidates are the `count` tiles in its list, or all of the region's if these are more than its
# `room`. Each obstacle pixel is an interval of depths [d, d + thickness], or to `back` if that is nearer: its point nearest in
# depth to the robot's pixel counts, in all three components (Sec. III-C, d(O, P)). `nearest` takes the least rank of each link,
# which orders by distance, then by pixel: equal distances always give the same pixel. Bounds give way by the factor `slack`.
#
# From a pixel to the one below it, p', no distance to a set of obstacle pixels changes by more than |p' - p| and the way that
# an obstacle's point goes on its ray, |k| |z' - z|: so the row above bounds the distances from above, and what is known there
# of each tile bounds those to it from below, which spares half of the tiles. On a CPU a row of 16 pixels is decided at once, as
# no pixel waits for the one before; on CUDA there is one only.
#
# Minima are taken over the bits, which vectorises where a float minimum does not; all values are >= 0.
@wp.func_native(r"""
#if defined(__CUDA_ARCH__)
    constexpr int N = 1, MEMORY = 1;
    const auto lowest = [](const unsigned) { return 0; };
#else
    constexpr int N = 16, MEMORY = 256;
    const auto lowest = [](const unsigned bits) { return __builtin_ctz(bits); };
#endif
    const float inf = __builtin_bit_cast(float, 0x7F800000u), far_away = 1.0e3f, rounding = 1.0e-5f;
    const float ix = 1.0f / g.fx, iy = 1.0f / g.fy, most = reach * reach;
    const int tu = tile % g.tiles_x * 16, tv = tile / g.tiles_x * 8;
    const int left = region.data[0], top = region.data[1], wide = region.data[2] - left;
    const int n = count <= room ? count : wide * (region.data[3] - top);
    const int* __restrict list = lists.data + tile * room;

    const auto to_tile = [&](const int u, const int v, const float x, const float y, const float z) {
        int least[16];
        float kx[16];
        for (int i = 0; i < 16; ++i) { least[i] = 0x7f7fffff; kx[i] = ((float)(u + i) - g.cx) * ix; }
        for (int r = 0; r < 8; ++r) {
            const float ky = ((float)(v + r) - g.cy) * iy;
            const float* __restrict f = depth.data + (v + r) * g.stride + u;
            const float* __restrict b = back.data + (v + r) * g.stride + u;
            #pragma clang loop vectorize(enable)
            for (int i = 0; i < 16; ++i) {
                const float d = f[i] < far_away ? f[i] : far_away, last = d + thickness, end = b[i] < last ? b[i] : last;
                const float inner = z < end ? z : end;
                const float e = d < inner ? inner : d, dx = kx[i] * e - x, dy = ky * e - y, dz = e - z;
                const float s = dx * dx + dy * dy + dz * dz;
                const int bits = __builtin_bit_cast(int, s);
                least[i] = bits < least[i] ? bits : least[i];
            }
        }
        int m = 0x7f7fffff;
        for (int i = 0; i < 16; ++i) m = least[i] < m ? least[i] : m;
        return __builtin_bit_cast(float, m);
    };

    float xs[N], ys[N], zs[N], least[N], step[N];
    float above[MEMORY][N];
    int on[N];
    for (int i = 0; i < N; ++i) { xs[i] = ys[i] = zs[i] = 0.0f; least[i] = most; }
    for (int k = 0; k < MEMORY && k < n; ++k) for (int i = 0; i < N; ++i) above[k][i] = 0.0f;
    for (int j = first; j < first + pixels; j += N) {
        const int u = tu + j % 16, v = tv + j / 16, at = v * g.stride + u;
        const unsigned* __restrict key = keys.data + at;
        const float* __restrict f = depth.data + at;
        const float* __restrict b = back.data + at;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < N; ++i) {
            const unsigned here = key[i];
            const bool counts = (here != 0u) & (((links >> (here & 15u)) & 1u) != 0u);
            const float z = counts ? 1.0f / __builtin_bit_cast(float, here & 0xFFFFFFF0u) : far_away, last = f[i] + thickness;
            const bool inside = (f[i] <= z) & (z <= (b[i] < last ? b[i] : last));
            const float x = ((float)(u + i) - g.cx) * ix * z, y = ((float)v - g.cy) * iy * z;
            const float dx = x - xs[i], dy = y - ys[i], dz = z - zs[i];
            const float way = sqrtf(dx * dx + dy * dy + dz * dz) + g.ray * (dz < 0.0f ? -dz : dz) + rounding;
            const float bound = sqrtf(least[i]) + way, upper = bound * bound;
            least[i] = !counts ? most : (inside ? 0.0f : (upper < most ? upper : most));
            on[i] = (counts & !inside) ? 1 : 0;
            xs[i] = x; ys[i] = y; zs[i] = z; step[i] = way;
        }
        for (int k = 0; k < n; ++k) {
            const int o = count <= room ? list[k] : (top + k / wide) * g.tiles_x + left + k % wide;
            const int ou = o % g.tiles_x * 16, ov = o / g.tiles_x * 8;
            const int over = v < ov ? ov - v : (v > ov + 7 ? v - ov - 7 : 0);
            const float dy = (float)over * iy, front = near.data[o], end = far.data[o] + thickness, square = squares.data[o];
            float* __restrict known = above[k < MEMORY ? k : 0];
            float bound[N], found[N];
            unsigned near_enough = 0u;
            #pragma clang loop vectorize(enable)
            for (int i = 0; i < N; ++i) {
                const float z = zs[i], before = front - z, behind = z - end;
                const float ahead = before > behind ? before : behind, gap = ahead > 0.0f ? ahead : 0.0f;
                const int l = ou - u - i, r = u + i - ou - 15, side = l > r ? l : r;
                const float dx = (float)(side > 0 ? side : 0) * ix, still = k < MEMORY ? known[i] - step[i] : 0.0f;
                bound[i] = still > 0.0f ? still : 0.0f;
                const bool need = (on[i] != 0) & (slack * gap * gap < least[i]) & (bound[i] * bound[i] <= least[i])
                                & (slack * z * z * (dx * dx + dy * dy) < least[i] * square);
                near_enough |= need ? 1u << i : 0u;
            }
            for (int i = 0; i < N; ++i) found[i] = bound[i] * bound[i];
            for (unsigned rest = near_enough; rest; rest &= rest - 1) {
                const int i = lowest(rest);
                found[i] = to_tile(ou, ov, xs[i], ys[i], zs[i]);
            }
            #pragma clang loop vectorize(enable)
            for (int i = 0; i < N; ++i) {
                const bool got = (near_enough >> i) & 1u;
                least[i] = (got & (found[i] < least[i])) ? found[i] : least[i];
                if (k < MEMORY) known[i] = on[i] ? sqrtf(found[i]) : 0.0f;
            }
        }
        for (int i = 0; i < N; ++i) {
            distances.data[at + i] = least[i] < most ? sqrtf(least[i]) : inf;
            if (least[i] < most) {
                const wp::uint64 rank = ((wp::uint64)__builtin_bit_cast(unsigned, least[i]) << 32) | (wp::uint64)(at + i);
                wp::atomic_min(nearest, (int)(key[i] & 15u), rank);
            }
        }
    }
""")
def measure_pixels(keys: Keys, links: wp.uint32, depth: Floats, back: Floats, near: Floats, far: Floats, reach: float,
                   thickness: float, region: Ints, squares: Floats, g: Grid, lists: Ints, room: int, count: int, tile: int,
                   first: int, pixels: int, slack: float, distances: Floats, nearest: Ranks): ...
