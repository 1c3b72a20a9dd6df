"""The inner loops of the raster in C++; see `native` for why.

Vertices are structures of arrays: all x, then all y, then all z; on the screen all u, v and 1/z. Faces are too: all first
corners, then all second and all third ones.
"""

import warp as wp

from hrc.vision.kernels.types import Floats, Grid, Ints, Keys

Bounds = wp.types.vector(length=5, dtype=wp.int32)
"""Of projected vertices: least column and row, largest column and row, and the bits of the largest 1/z."""


# Vertices [first, first + n), all of one frame: moved out by `margin` along the normal, then to (u, v, 1/z); 1/z is -1 for
# what is nearer than `near`, which the bounds leave out. Minima are taken over integers, which vectorises.
@wp.func_native(r"""
    const int total = points.shape[0] / 3, none = 1 << 30;
    const float* __restrict x = points.data + first; const float* __restrict a = normals.data + first;
    const float* __restrict y = x + total; const float* __restrict b = a + total;
    const float* __restrict z = y + total; const float* __restrict c = b + total;
    float* __restrict u = screen.data + first; float* __restrict v = u + total; float* __restrict w = v + total;
    float R[3][4];
    for (int i = 0; i < 3; ++i) for (int j = 0; j < 4; ++j) R[i][j] = T.data[i][j];
    int left = none, top = none, right = -none, bottom = -none, closest = 0;
    for (int i = 0; i < n; ++i) {
        const float px = x[i] + margin * a[i], py = y[i] + margin * b[i], pz = z[i] + margin * c[i];
        const float X = R[0][0] * px + R[0][1] * py + R[0][2] * pz + R[0][3];
        const float Y = R[1][0] * px + R[1][1] * py + R[1][2] * pz + R[1][3];
        const float Z = R[2][0] * px + R[2][1] * py + R[2][2] * pz + R[2][3];
        const bool ahead = Z > near;
        const float inverse = ahead ? 1.0f / Z : -1.0f, U = g.fx * X * inverse + g.cx, V = g.fy * Y * inverse + g.cy;
        u[i] = U;
        v[i] = V;
        w[i] = inverse;
        float column = U > -1.0e6f ? U : -1.0e6f, row = V > -1.0e6f ? V : -1.0e6f;
        column = column < 1.0e6f ? column : 1.0e6f;
        row = row < 1.0e6f ? row : 1.0e6f;
        const int j = (int)column, k = (int)row, bits = ahead ? __builtin_bit_cast(int, inverse) : 0;
        const int jl = ahead ? j : none, jr = ahead ? j : -none, kl = ahead ? k : none, kr = ahead ? k : -none;
        left = jl < left ? jl : left;
        right = jr > right ? jr : right;
        top = kl < top ? kl : top;
        bottom = kr > bottom ? kr : bottom;
        closest = bits > closest ? bits : closest;
    }
    wp::vec_t<5, wp::int32> found;
    found[0] = left; found[1] = top; found[2] = right; found[3] = bottom; found[4] = closest;
    return found;
""")
def project_run(points: Floats, normals: Floats, first: int, n: int, T: wp.mat44, margin: float, near: float, g: Grid,
                screen: Floats) -> Bounds: ...  # pyright: ignore


# Triangles [first, first + n), clipped to the image. `key` is the bits of 1/z, which sort like the value itself, with the id
# in the low four bits: one maximum keeps the nearest surface and its owner, 4 um being lost in depth. Front faces have a
# negative area, since rows count downwards.
#
# On a CPU the triangles go through in blocks of 64: all are set up side by side, and those with a pixel are drawn in whole
# columns of tiles. Most have one or two rows in a single column, and are drawn without a branch. The loop that draws reads,
# compares and writes, which races between threads, so CUDA takes an atomic maximum per pixel instead.
@wp.func_native(r"""
    const int total = screen.shape[0] / 3, m = faces.shape[0] / 3;
    const float* __restrict U = screen.data; const float* __restrict V = U + total; const float* __restrict W = V + total;
    const float right = (float)(g.width - 1), bottom = (float)(g.height - 1);
    constexpr int N = 64;
#if defined(__CUDA_ARCH__)
    constexpr int block = 1;
#else
    constexpr int block = N;
#endif
    float ax[block], ay[block], az[block], bdx[block], bdy[block], cdx[block], cdy[block], zb[block], zc[block];
    int x0[block], y0[block], x1[block], y1[block], kind[block];
    for (int start = first; start < first + n; start += block) {
        const int* __restrict A = faces.data + start; const int* __restrict B = A + m; const int* __restrict C = B + m;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < block; ++i) {
            const int a = A[i], b = B[i], c = C[i];
            const float x = U[a], y = V[a], z = W[a], bz = W[b], cz = W[c];
            const float bx = U[b] - x, by = V[b] - y, cx = U[c] - x, cy = V[c] - y;
            const float area = bx * cy - by * cx, inv = 1.0f / area;
            float lx = bx < cx ? bx : cx, hx = bx > cx ? bx : cx, ly = by < cy ? by : cy, hy = by > cy ? by : cy;
            lx = x + (lx < 0.0f ? lx : 0.0f); hx = x + (hx > 0.0f ? hx : 0.0f);
            ly = y + (ly < 0.0f ? ly : 0.0f); hy = y + (hy > 0.0f ? hy : 0.0f);
            const bool seen = (area < 0.0f) & (z > 0.0f) & (bz > 0.0f) & (cz > 0.0f)
                            & (hx >= 0.0f) & (lx <= right) & (hy >= 0.0f) & (ly <= bottom);
            lx = lx > 0.0f ? lx : 0.0f; lx = lx < right ? lx : right;
            hx = hx > 0.0f ? hx : 0.0f; hx = hx < right ? hx : right;
            ly = ly > 0.0f ? ly : 0.0f; ly = ly < bottom ? ly : bottom;
            hy = hy > 0.0f ? hy : 0.0f; hy = hy < bottom ? hy : bottom;
            const int l = (int)(lx + 0.9999f), t = (int)(ly + 0.9999f), r = (int)hx, e = (int)hy;
            const bool drawn = seen & (l <= r) & (t <= e), small = ((l >> 4) == (r >> 4)) & (e - t <= 1);
            ax[i] = x; ay[i] = y; az[i] = z; zb[i] = bz - z; zc[i] = cz - z;
            bdx[i] = cy * inv; bdy[i] = -cx * inv; cdx[i] = -by * inv; cdy[i] = bx * inv;
            x0[i] = l; y0[i] = t; x1[i] = r; y1[i] = e;
            kind[i] = drawn ? (small ? 1 : 2) : 0;
        }
        const wp::uint32* __restrict id = ids.data + start;
#if defined(__CUDA_ARCH__)
        if (kind[0] == 0) continue;
        for (int y = y0[0]; y <= y1[0]; ++y) {
            const float dy = (float)y - ay[0], b0 = bdy[0] * dy, c0 = cdy[0] * dy;
            for (int x = x0[0]; x <= x1[0]; ++x) {
                const float dx = (float)x - ax[0], b = bdx[0] * dx + b0, c = cdx[0] * dx + c0;
                const float iz = az[0] + b * zb[0] + c * zc[0];
                if (b >= -1e-6f && c >= -1e-6f && b + c <= 1.000001f)
                    atomicMax(keys.data + y * g.stride + x, (__float_as_uint(iz) & 0xFFFFFFF0u) | id[0]);
            }
        }
#else
        unsigned long long few = 0, many = 0;
        for (int i = 0; i < N; ++i) {
            few |= (unsigned long long)(kind[i] == 1) << i;
            many |= (unsigned long long)(kind[i] == 2) << i;
        }
        const auto paint = [&](const int i, const int y, const int base) {
            const float dy = (float)y - ay[i], b0 = bdy[i] * dy, c0 = cdy[i] * dy, left = (float)base - ax[i];
            const float bx = bdx[i], cx = cdx[i], z = az[i], bz = zb[i], cz = zc[i];
            const unsigned owner = id[i], skip = base - x0[i], wide = x1[i] - x0[i];
            unsigned* __restrict q = keys.data + y * g.stride + base;
            #pragma clang loop vectorize(enable) vectorize_width(16) interleave(disable)
            for (int k = 0; k < 16; ++k) {
                const float dx = left + (float)k, b = bx * dx + b0, c = cx * dx + c0, iz = z + b * bz + c * cz;
                const unsigned in = (unsigned)(b >= -1e-6f) & (unsigned)(c >= -1e-6f) & (unsigned)(b + c <= 1.000001f)
                                  & (unsigned)((unsigned)k + skip <= wide);
                const unsigned key = in ? (__builtin_bit_cast(unsigned, iz) & 0xFFFFFFF0u) | owner : 0u;
                const unsigned old = q[k];
                q[k] = old > key ? old : key;
            }
        };
        for (; few; few &= few - 1) {
            const int i = __builtin_ctzll(few), base = x0[i] & ~15;
            paint(i, y0[i], base);
            paint(i, y1[i], base);
        }
        for (; many; many &= many - 1) {
            const int i = __builtin_ctzll(many);
            for (int y = y0[i]; y <= y1[i]; ++y) for (int base = x0[i] & ~15; base <= x1[i]; base += 16) paint(i, y, base);
        }
#endif
    }
""")
def draw_triangles(screen: Floats, faces: Ints, ids: Keys, first: int, n: int, g: Grid, keys: Keys): ...
