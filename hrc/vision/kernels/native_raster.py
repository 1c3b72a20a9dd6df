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
# On a CPU the triangles go through in blocks of 64: all are set up side by side, and those with a pixel are drawn. Most fit
# into a patch of 4 x 4 pixels, which is one vector, and are drawn without a branch; the others go row by row, in vectors of 16.
# Either way what is outside of the triangle, even beyond the image, is written back as it was. Reading, comparing and writing
# races between threads, so CUDA takes an atomic maximum per pixel instead.
@wp.func_native(r"""
    const int total = screen.shape[0] / 3, m = faces.shape[0] / 3;
    const float* __restrict U = screen.data; const float* __restrict V = U + total; const float* __restrict W = V + total;
    const float right = (float)(g.width - 1), bottom = (float)(g.height - 1);
    constexpr int N = 64;
#if defined(__CUDA_ARCH__)
    constexpr int block = 1;
#else
    constexpr int block = N;
    typedef float Reals __attribute__((ext_vector_type(16)));
    typedef int Whole __attribute__((ext_vector_type(16)));
    typedef int Four __attribute__((ext_vector_type(4)));
    const Reals column = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
    const Reals row = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};
#endif
    float b0[block], bx[block], by[block], c0[block], cx[block], cy[block], za[block], zb[block], zc[block];
    float wide[block], high[block];
    int x0[block], y0[block], x1[block], y1[block], kind[block];
    for (int start = first; start < first + n; start += block) {
        const int* __restrict A = faces.data + start; const int* __restrict B = A + m; const int* __restrict C = B + m;
        #pragma clang loop vectorize(enable)
        for (int i = 0; i < block; ++i) {
            const int a = A[i], b = B[i], c = C[i];
            const float x = U[a], y = V[a], z = W[a], bz = W[b], cz = W[c];
            const float ux = U[b] - x, uy = V[b] - y, vx = U[c] - x, vy = V[c] - y;
            const float area = ux * vy - uy * vx, inv = 1.0f / area;
            float lx = ux < vx ? ux : vx, hx = ux > vx ? ux : vx, ly = uy < vy ? uy : vy, hy = uy > vy ? uy : vy;
            lx = x + (lx < 0.0f ? lx : 0.0f); hx = x + (hx > 0.0f ? hx : 0.0f);
            ly = y + (ly < 0.0f ? ly : 0.0f); hy = y + (hy > 0.0f ? hy : 0.0f);
            const bool seen = (area < 0.0f) & (z > 0.0f) & (bz > 0.0f) & (cz > 0.0f)
                            & (hx >= 0.0f) & (lx <= right) & (hy >= 0.0f) & (ly <= bottom);
            lx = lx > 0.0f ? lx : 0.0f; lx = lx < right ? lx : right;
            hx = hx > 0.0f ? hx : 0.0f; hx = hx < right ? hx : right;
            ly = ly > 0.0f ? ly : 0.0f; ly = ly < bottom ? ly : bottom;
            hy = hy > 0.0f ? hy : 0.0f; hy = hy < bottom ? hy : bottom;
            const int l = (int)(lx + 0.9999f), t = (int)(ly + 0.9999f), r = (int)hx, e = (int)hy;
            const bool drawn = seen & (l <= r) & (t <= e), small = (r - l < 4) & (e - t < 4);
            const float dx = (float)l - x, dy = (float)t - y;
            bx[i] = vy * inv; by[i] = -vx * inv; b0[i] = bx[i] * dx + by[i] * dy;
            cx[i] = -uy * inv; cy[i] = ux * inv; c0[i] = cx[i] * dx + cy[i] * dy;
            za[i] = z; zb[i] = bz - z; zc[i] = cz - z;
            wide[i] = (float)(r - l); high[i] = (float)(e - t);
            x0[i] = l; y0[i] = t; x1[i] = r; y1[i] = e;
            kind[i] = drawn ? (small ? 1 : 2) : 0;
        }
        const wp::uint32* __restrict id = ids.data + start;
#if defined(__CUDA_ARCH__)
        if (kind[0] == 0) continue;
        for (int y = y0[0]; y <= y1[0]; ++y) for (int x = x0[0]; x <= x1[0]; ++x) {
            const float dx = (float)(x - x0[0]), dy = (float)(y - y0[0]);
            const float b = b0[0] + bx[0] * dx + by[0] * dy, c = c0[0] + cx[0] * dx + cy[0] * dy;
            const float iz = za[0] + b * zb[0] + c * zc[0];
            if (b >= -1e-6f && c >= -1e-6f && b + c <= 1.000001f)
                atomicMax(keys.data + y * g.stride + x, (__float_as_uint(iz) & 0xFFFFFFF0u) | id[0]);
        }
#else
        unsigned long long few = 0, many = 0;
        for (int i = 0; i < N; ++i) {
            few |= (unsigned long long)(kind[i] == 1) << i;
            many |= (unsigned long long)(kind[i] == 2) << i;
        }
        const auto dab = [&](const int i) {
            const Reals b = b0[i] + bx[i] * column + by[i] * row, c = c0[i] + cx[i] * column + cy[i] * row;
            const Reals iz = za[i] + b * zb[i] + c * zc[i];
            const Whole in = (b >= -1e-6f) & (c >= -1e-6f) & (b + c <= 1.000001f) & (column <= wide[i]) & (row <= high[i]);
            const Whole key = ((__builtin_bit_cast(Whole, iz) & (int)0xFFFFFFF0u) | (int)id[i]) & in;
            unsigned* q = keys.data + y0[i] * g.stride + x0[i];
            const auto fold = [&](const Four now) {
                Four old;
                __builtin_memcpy(&old, q, sizeof old);
                old = __builtin_elementwise_max(old, now);
                __builtin_memcpy(q, &old, sizeof old);
                q += g.stride;
            };
            fold(__builtin_shufflevector(key, key, 0, 1, 2, 3));
            fold(__builtin_shufflevector(key, key, 4, 5, 6, 7));
            fold(__builtin_shufflevector(key, key, 8, 9, 10, 11));
            fold(__builtin_shufflevector(key, key, 12, 13, 14, 15));
        };
        for (; few; few &= few - 1) dab(__builtin_ctzll(few));
        for (; many; many &= many - 1) {
            const int i = __builtin_ctzll(many);
            const float bdx = bx[i], cdx = cx[i], z = za[i], bz = zb[i], cz = zc[i], last = wide[i];
            const unsigned owner = id[i];
            for (int y = y0[i]; y <= y1[i]; ++y) {
                const float dy = (float)(y - y0[i]), bl = b0[i] + by[i] * dy, cl = c0[i] + cy[i] * dy;
                for (int base = x0[i] & ~15; base <= x1[i]; base += 16) {
                    const float left = (float)(base - x0[i]);
                    unsigned* __restrict q = keys.data + y * g.stride + base;
                    #pragma clang loop vectorize(enable) vectorize_width(16) interleave(disable)
                    for (int k = 0; k < 16; ++k) {
                        const float dx = left + (float)k, b = bl + bdx * dx, c = cl + cdx * dx, iz = z + b * bz + c * cz;
                        const unsigned in = (unsigned)(b >= -1e-6f) & (unsigned)(c >= -1e-6f) & (unsigned)(b + c <= 1.000001f)
                                          & (unsigned)(dx >= 0.0f) & (unsigned)(dx <= last);
                        const unsigned key = in ? (__builtin_bit_cast(unsigned, iz) & 0xFFFFFFF0u) | owner : 0u;
                        const unsigned old = q[k];
                        q[k] = old > key ? old : key;
                    }
                }
            }
        }
#endif
    }
""")
def draw_triangles(screen: Floats, faces: Ints, ids: Keys, first: int, n: int, g: Grid, keys: Keys): ...
