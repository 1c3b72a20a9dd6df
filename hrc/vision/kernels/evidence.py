"""The evidence of a residual at each of many places of the robot's surface: see `hrc.contact.proprioception`.

A few hundred operations for each of a thousand places, in double precision: it runs on the CPU, whatever device the images
are on.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import warp as wp

from hrc.vision.kernels.runtime import Graph, Mirror, upload
from hrc.vision.kernels.types import MODULE, Ints

Doubles = wp.array(dtype=wp.float64)
LANES = 16
"""So many places of one link are looked at side by side."""


# The places first .. first + count - 1 of a link, n in all. `arms` holds J_i / sigma of each link (7, 7, 6), `known` the
# residual in units of sigma (7), then friction, typical, least and largest force. The lanes beyond count work on copies of the
# first place.
@wp.func_native(r"""
    const int L = LANES;
    const double* __restrict A = arms.data + (link - 1) * 42;
    const double* __restrict r = known.data;
    const double friction = r[7], typical = r[8], least = r[9], most = r[10];
    double b[3][L] = {}, g[6][L] = {};
    double w[18][L];
    for (int q = 0; q < 18; ++q) {
        const double* __restrict from = wrenches.data + q * n + first;
        for (int l = 0; l < L; ++l) w[q][l] = from[l < count ? l : 0];
    }
    double whole = 0.0;
    for (int j = 0; j < 7; ++j) whole += r[j] * r[j];
    for (int j = 0; j < link; ++j) {  // the joints beyond do not feel it
        const double* __restrict a = A + 6 * j;
        for (int l = 0; l < L; ++l) {
            double J[3];
            for (int k = 0; k < 3; ++k) {
                J[k] = 0.0;
                for (int m = 0; m < 6; ++m) J[k] += a[m] * w[6 * k + m][l];
                b[k][l] += r[j] * J[k];
            }
            g[0][l] += J[0] * J[0];
            g[1][l] += J[1] * J[0];
            g[2][l] += J[1] * J[1];
            g[3][l] += J[2] * J[0];
            g[4][l] += J[2] * J[1];
            g[5][l] += J[2] * J[2];
        }
    }
    double y2s[L], half[L], det[L], off[L];
    for (int l = 0; l < L; ++l) {
        double normal = b[2][l] / (g[5][l] + 1e-9);  // best without friction
        normal = normal < least ? least : normal;
        normal = normal > most ? most : normal;
        const double across = friction * normal, aside2 = across * across, both = across * normal;
        const double b0 = b[0][l] * across, b1 = b[1][l] * across, b2 = b[2][l] * normal;
        // Cholesky factor of I + A^T A, and y with L y = A^T r.
        const double l00 = sqrt(1.0 + g[0][l] * aside2);
        const double l10 = g[1][l] * aside2 / l00, l20 = g[3][l] * both / l00;
        const double l11 = sqrt(1.0 + g[2][l] * aside2 - l10 * l10);
        const double l21 = (g[4][l] * both - l20 * l10) / l11;
        const double l22 = sqrt(1.0 + g[5][l] * (normal * normal) - l20 * l20 - l21 * l21);
        const double y0 = b0 / l00, y1 = (b1 - l10 * y0) / l11, y2 = (b2 - l20 * y0 - l21 * y1) / l22;
        const double up = y2 > 0.0 ? y2 : 0.0;
        const double x2 = up / l22, x1 = (y1 - l21 * x2) / l11, x0 = (y0 - l10 * x1 - l20 * x2) / l00;
        const double tangential = y0 * y0 + y1 * y1;
        y2s[l] = y2;
        half[l] = 0.5 * (tangential + up * up) - normal / typical;
        det[l] = l00 * l11 * l22;
        off[l] = whole - tangential - up * up;
        b[0][l] = x0 * across;
        b[1][l] = x1 * across;
        b[2][l] = x2 * normal;
    }
    for (int l = 0; l < count; ++l) {
        const double x = y2s[l] < 0.0 ? -y2s[l] : y2s[l];
        const double mills = 0.7978845608028654 / (x + sqrt(x * x + 2.546479089470325));  // exp(x^2 / 2) Phi(-x)
        const double far = x < 9.0 ? x : 9.0;
        const double part = y2s[l] < 0.0 ? mills : 1.0 - mills * exp(-0.5 * far * far);
        evidence.data[first + l] = half[l] + log(part / det[l]);
        misfit2.data[first + l] = off[l];
        for (int k = 0; k < 3; ++k) force.data[k * n + first + l] = b[k][l];
    }
""".replace("LANES", str(LANES)))
def explain_block(wrenches: Doubles, arms: Doubles, known: Doubles, link: int, first: int, count: int, n: int,
                  evidence: Doubles, force: Doubles, misfit2: Doubles): ...


@wp.kernel(module=MODULE)
def explain(wrenches: Doubles, arms: Doubles, known: Doubles, blocks: Ints, n: int, evidence: Doubles, force: Doubles,
            misfit2: Doubles):
    b = 3 * wp.tid()
    explain_block(wrenches, arms, known, blocks[b], blocks[b + 1], blocks[b + 2], n, evidence, force, misfit2)


class Explained(NamedTuple):
    """An `Explanation` of `hrc.contact.proprioception`, valid until the next one."""

    log_evidence: np.ndarray
    force: np.ndarray
    misfit2: np.ndarray


class Evidence:
    """Explains residuals at fixed places as `explanation` of `hrc.contact.proprioception` does, in a fifth of the time."""

    def __init__(self, wrenches: np.ndarray, of_link: Mapping[int, slice]) -> None:
        """wrenches (3, 6, n): of unit forces at each place along its axes, the normal last, in the link's frame.

        of_link: the places of each link 1 to 7.
        """
        n = wrenches.shape[2]
        blocks = [(link, first, min(LANES, part.stop - first)) for link, part in of_link.items()
                  for first in range(part.start, part.stop, LANES)]
        places = upload(np.ascontiguousarray(wrenches, np.float64).ravel(), wp.float64, "cpu")
        table = upload(np.array(blocks).ravel(), wp.int32, "cpu")
        self._arms, self._known = Mirror(7 * 7 * 6, wp.float64, "cpu"), Mirror(11, wp.float64, "cpu")
        out = [Mirror(m * n, wp.float64, "cpu") for m in (1, 3, 1)]
        evidence, force, misfit2 = (mirror.read() for mirror in out)
        self._found = Explained(evidence, force.reshape(3, n), misfit2)
        self._graph = Graph([lambda: wp.launch(explain, dim=len(blocks), device="cpu", inputs=[
            places, self._arms.buffer, self._known.buffer, table, n, *(mirror.buffer for mirror in out)])], "cpu")

    def __call__(self, r: np.ndarray, J_links: np.ndarray, friction: float, f_typical: float,
                 f_range: Sequence[float]) -> Explained:
        """r (7,), J_links (7, 7, 6): in units of the residual's error. friction: part of the normal force; the others: that
        [N]."""
        self._arms.write(J_links.ravel())
        self._known.write([*r.tolist(), friction, f_typical, *f_range])
        self._graph.replay()
        return self._found
