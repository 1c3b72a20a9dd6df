"""The comparisons must be able to fail: each of these changes to the kernels has to be noticed."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import hrc
from hrc.paths import assets

SCENES = (1, 4, 21, 29, 60)
MUTANTS = {
    "none": ("", ""),
    "bounds that do not give way": ("SLACK = wp.constant(wp.float32(0.9999))", "SLACK = wp.constant(wp.float32(1.02))"),
    "tiles one pixel farther apart": ("b - a_end + 1, a - b_end + 1", "b - a_end + 2, a - b_end + 2"),
    "the longest ray too short": ("g.ray = math.sqrt(1.0 + u * u + v * v)", "g.ray = 1.0"),
    "nine tenths of the reach": ("< reach * reach * squares[o]", "< 0.81 * reach * reach * squares[o]"),
    "four bits of depth fewer": ("(__builtin_bit_cast(Whole, iz) & (int)0xFFFFFFF0u)",
                                 "(__builtin_bit_cast(Whole, iz) & (int)0xFFFFFF00u)"),
    "a patch of three rows": ("            fold(__builtin_shufflevector(key, key, 12, 13, 14, 15));\n", ""),
    "a tile as far from a pixel as from the one above": ("known[i] - step[i]", "known[i]"),
    "as near to the obstacles as the pixel above": ("sqrtf(least[i]) + way", "sqrtf(least[i])"),
    "the near plane 1 cm farther": ("NEAR = 0.05", "NEAR = 0.06"),
}
"""What is written in hrc/vision/kernels, once, and what is written in its place."""
PROGRAM = """
import sys
from pathlib import Path

import hrc
from eye_caster import check_raster
from eye_exact import NotExactError, check
from eye_random import scene

assert Path(hrc.__file__).parent.parent == Path.cwd(), hrc.__file__
try:
    for number in map(int, sys.argv[1:]):
        check_raster(scene(number))
        check(scene(number))
except NotExactError as error:
    print("not exact:", error)
else:
    print("exact")
"""


def run(folder: Path, old: str, new: str) -> str:
    """What the comparisons print with a copy of the package in which `old` is replaced."""
    shutil.copytree(Path(hrc.__file__).parent, folder / "hrc", ignore=shutil.ignore_patterns("__pycache__"))
    if not (folder / "hrc" / "assets").exists():
        (folder / "assets").symlink_to(assets())
    if old:
        kernels = (folder / "hrc" / "vision" / "kernels").glob("*.py")
        places = [path for path in kernels for _ in range(path.read_text(encoding="utf-8").count(old))]
        assert len(places) == 1, f"{old!r} stands {len(places)} times in the kernels: write this mutant anew"
        places[0].write_text(places[0].read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    path = os.pathsep.join([str(folder), str(Path(__file__).parent)])
    environment = os.environ | {"PYTHONPATH": path, "WARP_CACHE_PATH": str(folder / "cache")}
    done = subprocess.run([sys.executable, "-c", PROGRAM, *map(str, SCENES)], cwd=folder, env=environment, check=False,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """All of them at once: each compiles its kernels anew, which takes seconds."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield {name: pool.submit(run, tmp_path_factory.mktemp("mutant"), *change) for name, change in MUTANTS.items()}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_mutant_of_the_kernels_is_noticed(results, name):
    said = results[name].result()
    assert said.startswith("exact" if name == "none" else "not exact:"), said
