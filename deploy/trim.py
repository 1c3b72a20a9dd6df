"""Make an installed site-packages smaller for an image: python trim.py SITE_PACKAGES

It removes what no run in a container needs: what a compiler reads, tests, and what draws to a screen or speaks to a cloud.
Shared libraries lose their symbols. Needs binutils; prints what each step saved.
"""

import filecmp
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

SOURCES = ("a", "c", "cpp", "cxx", "f", "f90", "h", "hpp", "pxd", "pxi", "pyi", "pyx")
UNUSED = {
    "C++ headers, build files, documents, programs":
        ("cmeel.prefix/include", "cmeel.prefix/lib/cmake", "cmeel.prefix/lib/*/cmake", "cmeel.prefix/lib/pkgconfig",
         "cmeel.prefix/share/doc", "cmeel.prefix/bin", "pyarrow/include", "pyarrow/src", "numpy/_core/include",
         "mujoco/doc", "viser/client/src", "mujoco/introspect", "*.dist-info/sboms", "*.dist-info/RECORD"),
    "tests and examples":
        ("*/tests", "numpy/**/tests", "scipy/**/tests", "matplotlib/**/tests", "dask/**/tests", "distributed/**/tests",
         "mujoco/*_test.py", "mujoco/testdata", "pyarrow/_pyarrow_cpp_tests*", "warp/examples",
         "matplotlib/mpl-data/sample_data", "tornado/test"),
    "Rerun's program with its viewers; `review` needs it, and recordings are looked at outside": ("rerun_cli",),
    "MuJoCo's plugins, of which no model makes use, its windows and OpenGL, for which an image without graphics has no library":
        ("mujoco/plugin", "mujoco/studio", "mujoco/_render_filament*", "mujoco/usd", "OpenGL", "glfw"),
    "Arrow's way to servers and clouds":
        ("pyarrow/libarrow_flight*", "pyarrow/*_flight*", "pyarrow/libarrow_s3*", "pyarrow/_s3fs*",
         "pyarrow/_gcsfs*", "pyarrow/_azurefs*", "pyarrow/_hdfs*"),
    "fontTools' compiled copies of its Python": ("fontTools/**/*.so",),
    "Pygments' grammars, but those from P to Python": ("pygments/lexers/[a-oq-z]*.py",),
    "AVIF images": ("PIL/_avif*", "pillow.libs/libavif*"),
}


def main(packages: Path) -> None:
    """Remove, link, strip, and say how much."""
    before = size(packages)
    for what, patterns in UNUSED.items():
        report(what, remove(path for pattern in patterns for path in packages.glob(pattern)))
    report("libraries that nothing links", remove(unlinked(packages / "cmeel.prefix/lib")))
    headers = packages / "warp/native"  # what its kernels are compiled with
    report("sources in other languages", remove(
        path for path in packages.rglob("*") if path.suffix[1:] in SOURCES and headers not in path.parents))
    report("copies of shared libraries, linked", link_twins(packages))
    report("symbols of shared libraries", strip(packages))
    print(f"{before / 1e6:.0f} MB -> {size(packages) / 1e6:.0f} MB")


def report(what: str, saved: int) -> None:
    """A line about one step. saved: bytes."""
    print(f"{saved / 1e6:8.1f} MB  {what}")


def size(path: Path) -> int:
    """Bytes of a file, or of all in a folder."""
    if path.is_symlink():
        return 0
    return path.stat().st_size if path.is_file() else sum(size(inner) for inner in path.iterdir())


def remove(paths: Iterable[Path]) -> int:
    """Remove files and folders; the bytes they had."""
    saved = 0
    for path in list(paths):
        if not (path.is_symlink() or path.exists()):  # gone with the folder it was in
            continue
        saved += size(path)
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    return saved


def unlinked(folder: Path) -> Iterator[Path]:
    """The libraries, and links to them, of a folder that no extension module below it needs, not even by another's need."""
    there = {path.name: path for path in folder.glob("*.so*")}
    queue, needed = [path for path in folder.rglob("*.so") if path.parent != folder], set[Path]()
    while queue:
        shown = subprocess.run(["readelf", "--dynamic", str(queue.pop())], capture_output=True, text=True, check=True).stdout
        for name in re.findall(r"\(NEEDED\).*\[(.*)\]", shown):
            if name in there and (library := there[name].resolve()) not in needed:
                needed.add(library)
                queue.append(library)
    return (path for path in there.values() if path.resolve() not in needed)


def strip(packages: Path) -> int:
    """Take the symbols that only a debugger reads out of all shared libraries; the bytes they had.

    Of some libraries that were patched for their wheel, strip drops what is to be loaded: those stay as they are.
    """
    libraries = [path for path in packages.rglob("*.so*") if is_library(path)]
    before = sum(map(size, libraries))
    for path in libraries:
        bare = path.with_name(f"{path.name}.bare")
        subprocess.run(["strip", "--strip-unneeded", "-o", str(bare), str(path)], check=True)
        if loaded(bare) == loaded(path):
            bare.replace(path)
        else:
            bare.unlink()
            print(f"         {path.name} stays whole")
    return before - sum(map(size, libraries))


def loaded(library: Path) -> list[tuple[str, ...]]:
    """Of each segment that is loaded its address, and its sizes in the file and in memory."""
    shown = subprocess.run(["readelf", "--segments", "--wide", str(library)], capture_output=True, text=True, check=True).stdout
    return re.findall(r"^ *LOAD +\w+ +(\w+) +\w+ +(\w+) +(\w+)", shown, re.MULTILINE)


def link_twins(packages: Path) -> int:
    """Link libx.so and libx.so.6 to libx.so.6.0.5 again: a wheel holds no links, but three copies. And what two wheels bring,
    such as the library of Fortran, is there once. The bytes saved.
    """
    saved = 0
    for folder in {path.parent for path in packages.rglob("*.so*")}:
        files = sorted(filter(is_library, folder.glob("*.so*")), key=lambda path: len(path.name), reverse=True)
        for i, path in enumerate(files):
            twins = (longer for longer in files[:i] if longer.name.startswith(path.name) and not longer.is_symlink()
                     and filecmp.cmp(path, longer, shallow=False))
            if (twin := next(twins, None)) is not None:
                saved += size(path)
                path.unlink()
                path.symlink_to(twin.name)
    named: dict[str, Path] = {}
    for path in filter(is_library, sorted(packages.glob("*.libs/*.so*"))):  # each wheel brings its own
        twin = named.setdefault(path.name, path)
        if twin is not path and filecmp.cmp(path, twin, shallow=False):
            saved += size(path)
            path.unlink()
            path.symlink_to(Path("..", *twin.relative_to(packages).parts))
    return saved


def is_library(path: Path) -> bool:
    """Whether this is an ELF file itself, and no link to one."""
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
