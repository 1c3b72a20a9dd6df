"""How long one perception cycle takes, beside what one would put together without it: same frames, same core, same run."""

import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from app.bench.baselines import BASELINES, Tree, assemble
from app.bench.frames import Condition, Take, record
from app.bench.perception import Cycle, error
from app.bench.renderers import graphics
from app.bench.report import check, printed, write
from app.bench.stages import Stages
from app.bench.sweeps import swept
from app.bench.timing import Contender, Times, by_turns, hold, one_core
from hrc import meshes
from hrc.config import Config
from hrc.vision import kernels
from hrc.vision.localize import VisionConfig

SEED = 0
FRAMES, ROUNDS = 24, 12
SWEEP_FRAMES, SWEEP_ROUNDS = 12, 4
QUICK_FRAMES, QUICK_ROUNDS = 4, 1
DETAIL, OWN = "perception", "filter"
"""Detail of the meshes that remove the robot: as fine as those of the true surface, and as in the product."""
PACKAGES = ("numpy", "scipy", "warp-lang", "mujoco", "open3d")
NAMES = {"paper": "our cycle, the paper's rule", "default": "our cycle, default mode",
         "paper_own_mesh": "our cycle, the paper's rule, our filter mesh",
         "default_own_mesh": "our cycle, default mode, our filter mesh",
         "default_monitored": "our cycle, default mode, with touches and monitoring",
         "stages_paper": "stages of the paper's rule, one by one",
         "stages_default": "stages of the default mode, one by one"}


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False) -> None:
    """Measure, print a table, and write every figure with its conditions to `json`.

    device: measured as well as the CPU. quick: few frames and one sweep, to see that it works; its times say little.
    Raises DeviceError if there is no such device; OutputError, before anything is measured, if `json` cannot be written.
    """
    if json is not None:
        check(json)
    device = kernels.check_device(device)
    for name in {"cpu", device}:
        kernels.warm(name)
    with one_core() as core:
        figures = measure(device, core, quick=quick)
    if json is not None:
        write(json, figures)
    for line in printed(figures):
        print(line)


def measure(device: str, core: int | None, *, quick: bool) -> dict[str, Any]:
    """Every figure as it goes into the JSON; names that end in _ms are milliseconds."""
    frames, rounds = (QUICK_FRAMES, QUICK_ROUNDS) if quick else (FRAMES, ROUNDS)
    config = Config().vision
    take = record(Condition(), frames, SEED)[0]
    ours, stages = _ours(take, config, device), _stages(take, config)
    others = {name: assemble(name, take, config) for name in BASELINES}
    present: dict[str, Contender] = {name: other for name, other in others.items() if isinstance(other, Contender)}
    slow = {"brute_force": present.pop("brute_force")}
    drawn_by = graphics()
    hold()
    times = by_turns({**ours, **stages, **present}, frames, rounds) | by_turns(slow, frames, 1)
    for other in present.values():
        if isinstance(other, Tree):
            other.close()
    errors = {name: error(cycle) for name, cycle in ours.items()}
    paper, default = times["paper"], times["default"]
    sweep = (QUICK_FRAMES, QUICK_ROUNDS) if quick else (SWEEP_FRAMES, SWEEP_ROUNDS)
    return {
        "conditions": _conditions(config, core, drawn_by) | {
            "frames": frames, "rounds": rounds, "sweep_frames": sweep[0], "sweep_rounds": sweep[1], "quick": quick},
        "cycle": {
            "median_ms": paper.median_ms(), "p90_ms": paper.p90_ms(),
            "default_median_ms": default.median_ms(), "default_p90_ms": default.p90_ms(),
            "rows": {name: _entry(_name(name), times[name]) for name in ours},
            "stages": {name.removeprefix("stages_"): _entry(NAMES[name], times[name]) for name in stages},
        },
        "baselines": {name: {"name": BASELINES[name][0], "ratio": None, "missing": other} if isinstance(other, str)
                      else _entry(BASELINES[name][0], times[name]) | {
                          "ratio": times[name].median_ms() / paper.median_ms(),
                          "ratio_to_default": times[name].median_ms() / default.median_ms()}
                      for name, other in others.items()},
        "exact": {"max_abs_error_m": max(errors.values()), "frames": frames, "modes": errors},
        "sweeps": list(swept(config, *sweep, SEED, device, quick=quick)),
    }


def _ours(take: Take, config: VisionConfig, device: str) -> dict[str, Cycle]:
    paper = config.replace(mode="paper")
    ours = {"paper": Cycle([take], paper, DETAIL), "default": Cycle([take], config, DETAIL),
            "paper_own_mesh": Cycle([take], paper, OWN), "default_own_mesh": Cycle([take], config, OWN),
            "default_monitored": Cycle([take], config, DETAIL, monitored=True)}
    if device != "cpu":
        ours |= {f"paper_{device}": Cycle([take], paper, DETAIL, device),
                 f"default_{device}": Cycle([take], config, DETAIL, device)}
    return ours


def _name(key: str) -> str:
    mode, _, device = key.partition("_")
    return NAMES.get(key) or f"{NAMES[mode]}, on {device}"


def _stages(take: Take, config: VisionConfig) -> dict[str, Stages]:
    return {"stages_paper": Stages(take, config.replace(mode="paper"), DETAIL), "stages_default": Stages(take, config, DETAIL)}


def _entry(name: str, times: Times) -> dict[str, Any]:
    steps = {step: {"median_ms": times.median_ms(step), "p90_ms": times.p90_ms(step)} for step in times.steps}
    return {"name": name, "median_ms": times.median_ms(), "p90_ms": times.p90_ms(), "steps": steps}


def _conditions(config: VisionConfig, core: int | None, drawn_by: str) -> dict[str, Any]:
    camera = Condition()
    return {
        "cpu": _cpu(), "cores": os.cpu_count(), "pinned_core": core, "system": platform.platform(),
        "python": platform.python_version(), "packages": {name: _version(name) for name in PACKAGES}, "graphics": drawn_by,
        "resolution": "512 x 424", "reach_m": config.reach, "margin_m": config.margin, "seed": SEED,
        "scene": "moving arm, moving person with a hand at its forearm, simulated noise of a Kinect V2",
        "camera_distance_m": camera.distance,
        "triangles": {name: sum(len(mesh.faces) for mesh in meshes.robot(detail))
                      for name, detail in (("surface", "perception"), ("filter", DETAIL), ("own_filter", OWN))},
    }


def _cpu() -> str:
    """The processor's name."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
