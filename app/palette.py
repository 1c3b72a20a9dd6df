"""The colours that the page and the recording share."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Colour = tuple[int, int, int]

LINKS: tuple[Colour, ...] = (
    (130, 130, 130), (94, 174, 255), (255, 160, 64), (110, 210, 110), (240, 90, 90), (180, 130, 255), (200, 160, 120),
    (255, 140, 200))
"""Base, and links 1 to 7."""
TOUCH: Colour = (255, 214, 10)
UNSURE: Colour = (170, 176, 184)
"""A touch that may be hidden."""
NEAR, MIDDLE, FAR = 0.05, 0.2, 0.5
"""Distances whose line is red, amber, and as dark as what is behind it [m]."""
_RED, _AMBER, _DARK = (255, 59, 48), (255, 190, 40), (41, 43, 48)


def by_distance(distances: ArrayLike) -> NDArray[np.uint8]:
    """Colours (n, 3) of the lines to obstacles at these distances [m] (n,)."""
    stops = np.array([_RED, _AMBER, _DARK], float)
    channels = [np.interp(np.asarray(distances, float), (NEAR, MIDDLE, FAR), channel) for channel in stops.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)
