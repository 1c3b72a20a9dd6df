"""The inner loops that a CPU compiler can only vectorise when they are written out in C++.

Everything compiles for CUDA as well. Only the raster differs there: its vector loop reads, compares and writes, which
races between threads, so CUDA takes an atomic maximum per pixel instead.
"""

import warp as wp

from hrc.vision.kernels.types import Grid


# Vertices [first, first + n), all of one frame: moved out by `margin` along the normal, then to (u, v, 1/z); 1/z is -1 for
# what is nearer than `near`.
@wp.func_native(r"""
    const float* __restrict p = (const float*)(points.data + first);
    const float* __restrict q = (const float*)(normals.data + first);
    float* __restrict s = (float*)(screen.data + first);
    float R[3][4];
    for (int r = 0; r < 3; ++r) for (int c = 0; c < 4; ++c) R[r][c] = T.data[r][c];
    for (int i = 0; i < n; ++i) {
        const float x = p[3 * i], y = p[3 * i + 1], z = p[3 * i + 2];
        const float a = q[3 * i], b = q[3 * i + 1], c = q[3 * i + 2];
        const float X = R[0][0] * x + R[0][1] * y + R[0][2] * z + R[0][3]
                      + margin * (R[0][0] * a + R[0][1] * b + R[0][2] * c);
        const float Y = R[1][0] * x + R[1][1] * y + R[1][2] * z + R[1][3]
                      + margin * (R[1][0] * a + R[1][1] * b + R[1][2] * c);
        const float Z = R[2][0] * x + R[2][1] * y + R[2][2] * z + R[2][3]
                      + margin * (R[2][0] * a + R[2][1] * b + R[2][2] * c);
        const float inverse = Z > near ? 1.0f / Z : -1.0f;
        s[3 * i] = g.fx * X * inverse + g.cx;
        s[3 * i + 1] = g.fy * Y * inverse + g.cy;
        s[3 * i + 2] = inverse;
    }
""")
def project_run(points: wp.array(dtype=wp.vec3), normals: wp.array(dtype=wp.vec3), first: int, n: int, T: wp.mat44,
                margin: float, near: float, g: Grid, screen: wp.array(dtype=wp.vec3)): ...


# Triangles [first, first + n), clipped to the image, one row after another. `key` is the bits of 1/z, which sort like the
# value itself, with the id in the low four bits: one maximum keeps the nearest surface and its owner, 4 um being lost in
# depth. Front faces have a negative area, since rows count downwards.
@wp.func_native(r"""
    const wp::vec3* S = screen.data;
    const float right = (float)(g.width - 1), bottom = (float)(g.height - 1);
    for (int t = first; t < first + n; ++t) {
        const wp::vec3i k = faces.data[t];
        const float ax = S[k[0]][0], ay = S[k[0]][1], az = S[k[0]][2], bz = S[k[1]][2], cz = S[k[2]][2];
        const float bx = S[k[1]][0] - ax, by = S[k[1]][1] - ay, cx = S[k[2]][0] - ax, cy = S[k[2]][1] - ay;
        const float area = bx * cy - by * cx;
        if (!(area < 0.0f) || az <= 0.0f || bz <= 0.0f || cz <= 0.0f) continue;
        float lx = bx < cx ? bx : cx, hx = bx > cx ? bx : cx, ly = by < cy ? by : cy, hy = by > cy ? by : cy;
        lx = ax + (lx < 0.0f ? lx : 0.0f); hx = ax + (hx > 0.0f ? hx : 0.0f);
        ly = ay + (ly < 0.0f ? ly : 0.0f); hy = ay + (hy > 0.0f ? hy : 0.0f);
        if (!(hx >= 0.0f && lx <= right && hy >= 0.0f && ly <= bottom)) continue;
        const int x0 = lx <= 0.0f ? 0 : (int)(lx + 0.9999f), y0 = ly <= 0.0f ? 0 : (int)(ly + 0.9999f);
        const int x1 = hx >= right ? g.width - 1 : (int)hx, y1 = hy >= bottom ? g.height - 1 : (int)hy;
        if (x0 > x1 || y0 > y1) continue;
        const float inv = 1.0f / area;
        const float bdx = cy * inv, bdy = -cx * inv, cdx = -by * inv, cdy = bx * inv, zb = bz - az, zc = cz - az;
        const unsigned id = ids.data[t];
        for (int y = y0; y <= y1; ++y) {
            const float dy = (float)y - ay, b0 = bdy * dy, c0 = cdy * dy;
            unsigned* row = keys.data + y * g.stride;
#if defined(__CUDA_ARCH__)
            for (int x = x0; x <= x1; ++x) {
                const float dx = (float)x - ax, b = bdx * dx + b0, c = cdx * dx + c0;
                if (b >= -1e-6f && c >= -1e-6f && b + c <= 1.000001f)
                    atomicMax(row + x, (__float_as_uint(az + b * zb + c * zc) & 0xFFFFFFF0u) | id);
            }
#else
            for (int x = x0; x <= x1; x += 8) {
                unsigned* __restrict q = row + x;
                const float dx = (float)x - ax;
                const int last = x1 - x;
                #pragma clang loop vectorize(enable) vectorize_width(8) interleave(disable)
                for (int i = 0; i < 8; ++i) {
                    const float d = dx + (float)i, b = bdx * d + b0, c = cdx * d + c0, iz = az + b * zb + c * zc;
                    const unsigned in = (unsigned)(b >= -1e-6f) & (unsigned)(c >= -1e-6f)
                                      & (unsigned)(b + c <= 1.000001f) & (unsigned)(i <= last);
                    const unsigned key = in ? (__builtin_bit_cast(unsigned, iz) & 0xFFFFFFF0u) | id : 0u;
                    const unsigned old = q[i];
                    q[i] = old > key ? old : key;
                }
            }
#endif
        }
    }
""")
def draw_triangles(screen: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.vec3i), ids: wp.array(dtype=wp.uint32),
                   first: int, n: int, g: Grid, keys: wp.array(dtype=wp.uint32)): ...


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


# The filter of Sec. III-B on `n` <= 64 tiles side by side, row after row: d_f = d_r if d_r < d_v, else +inf. `cover` is the
# robot's raster, `fixed` the environment's 1/z. Also writes each tile's least and largest depth, (FAR, 0) for none.
@wp.func_native(r"""
    const float far = 1.0e3f, inf = __builtin_bit_cast(float, 0x7F800000u);
    int least[64], most[64];
    for (int k = 0; k < n; ++k) { least[k] = 0x7f7fffff; most[k] = 0; }
    for (int r = 0; r < 8; ++r) {
        for (int k = 0; k < n; ++k) {
            const int o = first + r * g.stride + 16 * k;
            const float* __restrict d = raw.data + o; const float* __restrict e = fixed.data + o;
            const unsigned* __restrict c = cover.data + o;
            float* __restrict f = foreground.data + o;
            int low = least[k], high = most[k];
            #pragma clang loop vectorize(enable)
            for (int i = 0; i < 16; ++i) {
                float z = d[i];
                z = ((z > 0.0f) & (z < far)) ? z : far;
                const float robot = __builtin_bit_cast(float, c[i] & 0xFFFFFFF0u), m = robot > e[i] ? robot : e[i];
                const bool keep = (z * m < 1.0f) & (z < far);
                const float q = keep ? z : far;
                const int bits = __builtin_bit_cast(int, q), hit = keep ? bits : 0;
                f[i] = keep ? z : inf;
                low = bits < low ? bits : low;
                high = hit > high ? hit : high;
            }
            least[k] = low;
            most[k] = high;
        }
    }
    for (int k = 0; k < n; ++k) {
        nearest.data[t + k] = __builtin_bit_cast(float, least[k]);
        farthest.data[t + k] = __builtin_bit_cast(float, most[k]);
    }
""")
def filter_tiles(raw: wp.array(dtype=wp.float32), cover: wp.array(dtype=wp.uint32), fixed: wp.array(dtype=wp.float32),
                 first: int, t: int, n: int, g: Grid, foreground: wp.array(dtype=wp.float32),
                 nearest: wp.array(dtype=wp.float32), farthest: wp.array(dtype=wp.float32)): ...


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


# Least squared distance from the point (x, y, z) to the pixels of one obstacle tile, each an interval of depths
# [d, d + thickness]: its point nearest in depth to z counts, in all three components (Sec. III-C, d(O, P)).
# The minimum is taken over the bits, which vectorises where a float minimum does not; all values are >= 0.
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
            const float d = f[i] < 1.0e3f ? f[i] : 1.0e3f, back = d + thickness, inner = z < back ? z : back;
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
def tile_distance(depth: wp.array(dtype=wp.float32), u: int, v: int, x: float, y: float, z: float, thickness: float,
                  g: Grid) -> float: ...
