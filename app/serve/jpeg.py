"""Images for the browser's image widgets. For each image viser looks for OpenCV along the whole import path, and without it for
a plugin of imageio's, which is three quarters of an image's time; here Pillow is asked at once.
"""

import io

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image

QUALITY = 80
CONTENT = "_data"
"""What a widget shows, by its private name in viser."""


def show(widget: viser.GuiImageHandle, picture: NDArray[np.uint8]) -> None:
    """Put an RGB picture (rows, columns, 3) into a widget that was made with format "jpeg"."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "jpeg", quality=QUALITY)
    setattr(widget, CONTENT, buffer.getvalue())
