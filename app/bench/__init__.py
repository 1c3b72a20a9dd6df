"""Measurements: how fast perception is and how right, what is felt, and what the page costs."""

import ctypes
import os
import sys

if sys.platform == "linux":
    # Without a screen MuJoCo draws through EGL only, and asks for it once, when it is first imported: so before that.
    try:
        ctypes.CDLL("libEGL.so.1")
        os.environ.setdefault("MUJOCO_GL", "egl")
    except OSError:
        pass  # then what needs it is reported as missing
