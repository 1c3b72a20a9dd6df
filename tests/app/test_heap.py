"""What is freed between two things that stay goes back to the system while a page runs."""

import ctypes
import platform
import subprocess
import sys
import time
from pathlib import Path

import pytest

from app.serve import heap
from app.serve.heap import Holes


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps no such holes")
def test_holes_are_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heap, "PERIOD", 0.02)
    libc = ctypes.CDLL(None)
    libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]
    kept, freed = [], []
    for _ in range(800):  # 80 MB with something small that stays after every piece
        freed.append(libc.malloc(100_000))
        ctypes.memset(freed[-1], 1, 100_000)
        kept.append(libc.malloc(5000))
    for piece in freed:
        libc.free(piece)
    before = resident()
    holes = Holes()
    holes.start()
    try:
        end = time.monotonic() + 5.0
        while resident() > before - 60_000_000:
            assert time.monotonic() < end, f"{(before - resident()) / 1e6:.0f} MB of 80 came back"
            time.sleep(0.02)
    finally:
        holes.close()
        for piece in kept:
            libc.free(piece)


TELLS = """
import ctypes, threading
from app.serve.heap import Holes
holes = Holes()
threads = [threading.Thread(target=lambda: [bytes(3000) for _ in range(1000)]) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
libc = ctypes.CDLL(None)
libc.malloc_info(0, ctypes.c_void_p.in_dll(libc, "stdout"))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library has other heaps")
@pytest.mark.parametrize("one", [True, False])
def test_threads_share_a_heap(one: bool) -> None:
    code = TELLS if one else TELLS.replace("holes = Holes()", "")
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert (told.count("<heap nr") == 1) is one
