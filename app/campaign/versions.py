"""Of what a record depends on besides its campaign: the packages that compute it, and this project's own code and data."""

import functools
import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import hrc
from hrc.paths import assets

PACKAGES = ("elbowroom", "numpy", "scipy", "mujoco", "pin", "warp-lang", "trimesh")
OWN = ("plan.py", "trial.py", "places.py", "contacts.py", "judge.py", "episode.py")
"""The modules beside this one that make a record."""


@functools.cache
def versions() -> dict[str, str]:
    """By package; `code` is a digest of the library, its data, and what makes records."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return {**found, "code": _digest()}


def differences(here: dict[str, str], there: dict[str, str]) -> str:
    """What differs, in words; empty if nothing does."""
    return ", ".join(f"{name} {there.get(name, 'unknown')} (here {here.get(name, 'unknown')})"
                     for name in (*here, *(set(there) - set(here))) if here.get(name) != there.get(name))


def _digest() -> str:
    package, own, data, total = Path(hrc.__file__).parent, Path(__file__).parent, assets(), hashlib.sha256()
    roots = {
        package: [file for file in package.rglob("*.py") if data not in file.parents],  # once installed, data is inside
        data: [file for file in data.rglob("*") if file.suffix in (".xml", ".stl") or file.parent.name == "scenes"],
        own: [own / name for name in OWN], own.parent: [own.parent / "bench" / name for name in ("pushes.py", "touches.py")]}
    for root, files in roots.items():
        for file in sorted(files):
            total.update(str(file.relative_to(root)).encode())
            total.update(file.read_bytes())
    return total.hexdigest()[:12]
