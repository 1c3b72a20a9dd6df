"""What a time-of-flight camera makes of a perfect depth image: noise, flying pixels, dropouts, quantisation, range.

Every random number is an integer hash of (frame, pixel), so a frame has the same bits on every run and device.
"""

from typing import Any

import numpy as np
import warp as wp

from hrc.vision.kernels.runtime import read, write, zeros
from hrc.vision.kernels.types import MODULE, Floats, Grid, Keys, pixels, to_image


# Axial sigma after Fankhauser et al., ICAR 2015 [mm, m, rad]: 1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 th^2 / (pi/2 - th)^2.
# th, the angle of incidence, comes from the slope t = tan(th) of 1/z, which is affine over a plane. Polynomials stand in
# for what would need a root: z^0.5 = 0.68 + 0.34 z to 6 % from 0.8 to 4.5 m, th^2 / (pi/2 - th)^2 = t^2 (1.05 + 0.03 t^2)
# to 20 % between 45 and 80 degrees. Beyond 80 degrees nothing returns. The four bytes of a hash add up to a nearly normal
# number of sigma 147.8. An edge is a jump of 3 % in 1/z to one of the four neighbours.
@wp.func_native(r"""
    const unsigned KEEP = 0xFFFFFFF0u;
    const unsigned* __restrict here = keys.data + y * g.stride;
    const unsigned* __restrict above = keys.data + (y > 0 ? y - 1 : y) * g.stride;
    const unsigned* __restrict below = keys.data + (y < g.height - 1 ? y + 1 : y) * g.stride;
    float* __restrict out = depth.data + y * g.stride;
    const float inf = __builtin_bit_cast(float, 0x7F800000u);
    const unsigned draw = frame.data[0];
    const float per_metre = 1.0f / quantum;
    #pragma clang loop vectorize(enable)
    for (int x = 1; x < g.width - 1; ++x) {
        const float a = __builtin_bit_cast(float, here[x] & KEEP);
        const float l = __builtin_bit_cast(float, here[x - 1] & KEEP), r = __builtin_bit_cast(float, here[x + 1] & KEEP);
        const float u = __builtin_bit_cast(float, above[x] & KEEP), d = __builtin_bit_cast(float, below[x] & KEEP);
        float lo = l < r ? l : r, hi = l > r ? l : r;
        lo = u < lo ? u : lo; lo = d < lo ? d : lo; lo = a < lo ? a : lo;
        hi = u > hi ? u : hi; hi = d > hi ? d : hi; hi = a > hi ? a : hi;
        const float dl = l > a ? l - a : a - l, dr = r > a ? r - a : a - r, du = u > a ? u - a : a - u,
                    dd = d > a ? d - a : a - d;
        const float sx = (dl < dr ? dl : dr) * g.fx, sy = (du < dd ? du : dd) * g.fy;

        unsigned h = (unsigned)(y * g.width + x) * 0x9E3779B1u ^ draw;
        h ^= h >> 16; h *= 0x85EBCA6Bu; h ^= h >> 13; h *= 0xC2B2AE35u; h ^= h >> 16;
        unsigned k = h * 0x2C1B3C6Du;
        k ^= k >> 15;
        const float normal = ((float)(int)((h & 255u) + ((h >> 8) & 255u) + ((h >> 16) & 255u) + (h >> 24)) - 510.0f)
                           * (1.0f / 147.8f);
        const float chance = (float)(int)(k & 65535u) * (1.0f / 65536.0f);
        const float part = (float)(int)(k >> 16) * (1.0f / 65536.0f);

        const bool edge = (lo < 0.97f * a) | (0.97f * hi > a);
        const bool mixed = edge & (chance < flying) & (lo > 0.0f);
        // 1/hi + part (1/lo - 1/hi), with the one division that an unmixed pixel needs as well.
        float z = (mixed ? lo + part * (hi - lo) : 1.0f) / (mixed ? hi * lo : a);
        const float t2 = (sx * sx + sy * sy) * z * z, tilt = t2 < 32.0f ? t2 : 32.0f;
        const float sigma = 0.0015f - 0.0005f * z + 0.0003f * z * z
                          + 0.0001f * z * (0.68f + 0.34f * z) * tilt * (1.05f + 0.03f * tilt);
        z += scale * sigma * normal;
        const float steps = z * per_metre + 0.5f;
        z = (float)(int)(steps < 1.0e6f ? steps : 1.0e6f) * quantum;
        const bool lost = (edge & !mixed & (chance < flying + dropout)) | ((t2 > 32.0f) & !edge) | (a <= 0.0f)
                        | (z < nearest) | (z > farthest);
        out[x] = lost ? inf : z;
    }
    out[0] = inf;
    out[g.width - 1] = inf;
""")
def spoil_row(keys: wp.array(dtype=wp.uint32), y: int, frame: wp.array(dtype=wp.uint32), scale: float, flying: float,
              dropout: float, quantum: float, nearest: float, farthest: float, g: Grid,
              depth: wp.array(dtype=wp.float32)): ...


@wp.kernel(module=MODULE)
def spoil(keys: Keys, frame: Keys, scale: float, flying: float, dropout: float, quantum: float, nearest: float,
          farthest: float, g: Grid, depth: Floats):
    spoil_row(keys, wp.tid(), frame, scale, flying, dropout, quantum, nearest, farthest, g, depth)


class Noise:
    """Turns raster keys into a measured depth image.

    scale: of the axial sigma; flying, dropout: share of edge pixels that mix front and back, or measure nothing;
    quantum, nearest, farthest [m]. The first and last column measure nothing.
    """

    def __init__(self, g: Grid, keys: Any, device: str) -> None:
        self.grid, self.device, self._keys = g, device, keys
        self.scale, self.flying, self.dropout = 1.0, 0.3, 0.4
        self.quantum, self.nearest, self.farthest = 0.001, 0.5, 4.5
        self._frame = zeros(1, wp.uint32, device)
        self._depth = zeros(pixels(g), wp.float32, device)

    def draw(self, seed: int, frame: int) -> None:
        """Choose the random numbers: those of this frame of this seed."""
        # Fibonacci hashing: seeds and frames far apart in 32 bits; the kernel stirs them further for each pixel.
        write(self._frame, np.array([(seed * 0x9E3779B97F4A7C15 + frame * 0xBF58476D1CE4E5B9) >> 32 & 0xFFFFFFFF], np.uint32))

    def launch(self) -> None:
        """Queue the measurement."""
        inputs = [self._keys, self._frame, self.scale, self.flying, self.dropout, self.quantum, self.nearest,
                  self.farthest, self.grid, self._depth]
        wp.launch(spoil, dim=self.grid.height, inputs=inputs, device=self.device)

    def image(self) -> np.ndarray:
        """A fresh copy of the measured depth [m] (H, W), +inf where nothing was measured."""
        return to_image(read(self._depth), self.grid).copy()
