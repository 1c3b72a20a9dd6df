"""The import contract: what must never import what, read from the source of every module.

Imports inside functions and for type checkers count like all others.
"""

import ast
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted(path.relative_to(ROOT) for package in ("hrc", "app") for path in (ROOT / package).rglob("*.py"))
OTHERS = sorted(path.relative_to(ROOT) for folder in ("assets", "tests") for path in (ROOT / folder).rglob("*.py"))
LONGEST = 400  # lines

VISION, CONTACT, CONTROL = "hrc.vision", "hrc.contact", "hrc.control"
ENGINES = ("mujoco", "pinocchio")


def within(name: str, parents: tuple[str, ...]) -> bool:
    """Whether a dotted name is one of `parents` or lies inside one."""
    return any(name == parent or name.startswith(parent + ".") for parent in parents)


@dataclass(frozen=True)
class Rule:
    """Modules for which `applies` may not import a name for which `forbids`."""

    text: str
    applies: Callable[[str], bool]
    forbids: Callable[[str], bool]


def never(text: str, modules: tuple[str, ...], names: tuple[str, ...], but: tuple[str, ...] = ()) -> Rule:
    """`modules`, those in `but` excepted, never import `names`."""
    return Rule(text, lambda module: within(module, modules) and not within(module, but), lambda n: within(n, names))


def foreign(name: str) -> bool:
    """Whether a name is neither numpy, nor the standard library, nor one of the plain modules themselves."""
    return not (name.partition(".")[0] in {"numpy", *sys.stdlib_module_names} or within(name, PLAIN))


PLAIN = ("hrc.messages", "hrc.events", "hrc.geometry", "hrc.errors")
RULES = (
    never("the library does not know its users", ("hrc",), ("app", "viser", "rerun", "tyro")),
    Rule("plain modules hold to numpy and the standard library", lambda module: within(module, PLAIN), foreign),
    never("vision meets contact and control in the cell only", (VISION,), (CONTACT, CONTROL, "hrc.sim", "mujoco")),
    never("contact meets vision and control in the cell only", (CONTACT,), (VISION, CONTROL, "hrc.sim", "mujoco")),
    never("control meets vision and contact in the cell only", (CONTROL,), (VISION, CONTACT, "hrc.sim", "mujoco")),
    never("warp stays behind the kernels", ("hrc", "app"), ("warp",), but=("hrc.vision.kernels",)),
    never("the engines stay in the model and the plant", ("hrc", "app"), ENGINES,
          but=("hrc.model", "hrc.sim", "app.bench.renderers")),
    never("one reader of the wall clock", ("hrc",), ("time", "threading", "asyncio"), but=("hrc.cell.pace",)),
)


def module_name(path: Path) -> str:
    """hrc/vision/__init__.py -> hrc.vision"""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST, path: Path) -> Iterator[tuple[int, str]]:
    """Line and full dotted name of everything imported: `from a import b` counts as a.b, relative names resolved."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.parent.parts[: len(path.parent.parts) - node.level + 1] if node.level else ()
            origin = ".".join([*package, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{origin}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if function in ("import_module", "__import__"):
                yield node.lineno, str(node.args[0].value)


def breaches(source: str, path: Path) -> list[str]:
    """What in a source breaks the contract, as `path:line: name (rule)`."""
    found = list(imports(ast.parse(source), path))
    rules = [rule for rule in RULES if rule.applies(module_name(path))]
    return [f"{path}:{line}: {name} ({rule.text})" for rule in rules for line, name in found if rule.forbids(name)]


def private_uses(source: str, path: Path, private: set[str]) -> list[str]:
    """Private names of hrc that a source outside it imports, or reads from anything but its own `self`."""
    tree = ast.parse(source)
    own = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and _of_self(node)}
    own |= {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
    found = [f"{path}:{line}: {name}" for line, name in imports(tree, path)
             if name.startswith("hrc.") and any(_is_private(part) for part in name.split("."))]
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and not _of_self(node) and node.attr in private - own:
            found.append(f"{path}:{node.lineno}: .{node.attr}")
    return found


def private_names() -> set[str]:
    """Every private function, class and attribute that hrc defines."""
    names: set[str] = set()
    for path in SOURCES:
        if path.parts[0] == "hrc":
            for node in ast.walk(ast.parse((ROOT / path).read_text())):
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    names.add(node.name)
                elif isinstance(node, ast.Attribute) and _of_self(node):
                    names.add(node.attr)
    return {name for name in names if _is_private(name)}


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _of_self(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")


@pytest.mark.parametrize("path", SOURCES, ids=str)
def test_contract_holds(path: Path) -> None:
    assert breaches((ROOT / path).read_text(), path) == []


@pytest.mark.parametrize(("path", "source"), [
    ("hrc/cell/cell.py", "import viser"),
    ("hrc/cell/cell.py", "def f():\n    import rerun.blueprint as rrb"),
    ("hrc/cell/cell.py", "from app import bench"),
    ("hrc/cell/cell.py", "import importlib\nimportlib.import_module('tyro')"),
    ("hrc/messages.py", "import scipy"),
    ("hrc/events.py", "from hrc.scene import load_scene"),
    ("hrc/vision/distance.py", "from ..contact import force"),
    ("hrc/vision/distance.py", "from .. import control"),
    ("hrc/vision/distance.py", "from hrc import sim"),
    ("hrc/contact/force.py", "import mujoco"),
    ("hrc/control/laws.py", "if TYPE_CHECKING:\n    from hrc.vision.camera import Camera"),
    ("hrc/sim/depth_camera.py", "import warp as wp"),
    ("hrc/cell/cell.py", "import pinocchio"),
    ("app/bench/speed.py", "import mujoco"),
    ("hrc/cell/run.py", "from time import sleep"),
    ("hrc/cell/run.py", "import threading"),
])
def test_contract_sees_a_breach(path: str, source: str) -> None:
    assert breaches(source, Path(path))


@pytest.mark.parametrize(("path", "source"), [
    ("hrc/vision/kernels/window.py", "import warp as wp"),
    ("hrc/sim/robot.py", "import mujoco\nfrom hrc.vision.kernels import render"),
    ("hrc/cell/pace.py", "import time"),
    ("hrc/messages.py", "import numpy.typing\nfrom hrc.errors import SensorError"),
    ("hrc/cell/cell.py", "import timeit"),
    ("app/serve/page.py", "import asyncio\nimport viser"),
])
def test_contract_allows(path: str, source: str) -> None:
    assert breaches(source, Path(path)) == []


@pytest.mark.parametrize("path", [path for path in SOURCES if path.parts[0] == "app"], ids=str)
def test_app_uses_no_private_names_of_hrc(path: Path) -> None:
    assert private_uses((ROOT / path).read_text(), path, private_names()) == []


@pytest.mark.parametrize("source", [
    "from hrc.cell.cell import _snapshot",
    "import hrc._fast",
    "def f(cell):\n    return cell._plant",
])
def test_private_uses_are_seen(source: str) -> None:
    assert private_uses(source, Path("app/bench/speed.py"), {"_plant"})


def test_own_private_names_are_free() -> None:
    source = "class A:\n    def __init__(self, b):\n        self._plant = b._plant"
    assert private_uses(source, Path("app/bench/speed.py"), {"_plant"}) == []


@pytest.mark.parametrize("path", [*SOURCES, *OTHERS, Path("start.py")], ids=str)
def test_no_module_is_long(path: Path) -> None:
    lines = len((ROOT / path).read_text().splitlines())
    assert lines <= LONGEST, f"{lines} lines; one idea per file"


def test_library_works_without_the_app_and_its_packages() -> None:
    program = """
import sys
from importlib.abc import MetaPathFinder

class Block(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("app", "viser", "rerun", "rerun_sdk", "tyro", "tqdm", "pyarrow", "matplotlib"):
            raise ModuleNotFoundError(f"{name} is blocked", name=name)

sys.meta_path.insert(0, Block())
import hrc
from hrc.cell.cell import Cell
from hrc.config import Config

cell = Cell(Config())
for _ in range(40):
    snapshot = cell.step()
assert snapshot.tick == cell.tick == 40, (snapshot.tick, cell.tick)
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
