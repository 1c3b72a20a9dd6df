"""The only place of Warp: the hot loops of the eye, for CPU and CUDA from one source.

Each file holds one stage: its kernels, and a class that owns the buffers and queues the launches. Buffers keep their
address for life, so that a sequence of stages is captured once (`Graph`) and replayed.
"""

from hrc.vision.kernels.chords import Chords
from hrc.vision.kernels.clearance import Clearances, Witnesses
from hrc.vision.kernels.contact import ContactPoints, Found
from hrc.vision.kernels.distance import Distance
from hrc.vision.kernels.evidence import Evidence
from hrc.vision.kernels.filtering import Filter
from hrc.vision.kernels.noise import Noise
from hrc.vision.kernels.raster import Rasteriser, Surface
from hrc.vision.kernels.runtime import Graph, check_device, read, upload, warm, warm_for_others, write
from hrc.vision.kernels.touches import Touches
from hrc.vision.kernels.types import MODULE, NO_LINK, Grid, grid, key_depth, pack, to_image, unpack

__all__ = [
    "MODULE", "NO_LINK", "Chords", "Clearances", "ContactPoints", "Distance", "Evidence", "Filter", "Found", "Graph", "Grid",
    "Noise", "Rasteriser", "Surface", "Touches", "Witnesses", "check_device", "grid", "key_depth", "pack", "read", "to_image",
    "unpack", "upload", "warm", "warm_for_others", "write",
]
