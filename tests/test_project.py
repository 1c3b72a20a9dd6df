"""The project around the code: locks, what tracked files may say, the wheel, the README's example, start.py."""

import ast
import importlib
import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKS = ("requirements.lock", "requirements-dev.lock")


def pins(lock: str) -> dict[str, str]:
    """Version by package name of one lock file (each package has one version on every Python)."""
    found = re.findall(r"^([A-Za-z0-9._-]+)==([^\s;]+)", (ROOT / lock).read_text(), flags=re.MULTILINE)
    assert len(found) == len(dict(found)), f"{lock} pins a package twice"
    return {canonicalize_name(name): version for name, version in found}


def wanted(lock: str) -> list[Requirement]:
    """What pyproject.toml asks of a lock file: what runs, with the extras of `all`, the build backend, and in one the tools."""
    project, groups = PROJECT["project"], PROJECT["dependency-groups"]
    texts = [*PROJECT["build-system"]["requires"], *project["dependencies"], *groups["build"]]
    extras = project["optional-dependencies"].items()
    texts += [text for name, extra in extras if name not in ("bench", "mcap", "slurm") for text in extra]
    if lock == "requirements-dev.lock":
        texts += [text for text in groups["dev"] if isinstance(text, str)]
    return [requirement for requirement in map(Requirement, texts) if requirement.name != project["name"]]


def imported(folder: str) -> set[str]:
    """Third-party packages that the sources of a folder import."""
    trees = [ast.parse(path.read_text()) for path in (ROOT / folder).rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module and not node.level}
    ours = {"hrc", "app", *(path.stem for path in (ROOT / folder).rglob("*.py"))}
    return {name.partition(".")[0] for name in names} - ours - sys.stdlib_module_names


@pytest.mark.parametrize(("folder", "extras", "groups"), [
    ("hrc", (), ()),
    ("app", ("page", "record", "campaign", "mcap", "bench"), ()),
    ("assets", ("page", "record"), ("dev",)),
    ("tests", ("page", "record", "campaign"), ("dev",)),
])
def test_what_is_imported_is_declared(folder: str, extras: tuple[str, ...], groups: tuple[str, ...]) -> None:
    texts = [*PROJECT["project"]["dependencies"]]
    texts += [text for extra in extras for text in PROJECT["project"]["optional-dependencies"][extra]]
    texts += [text for group in groups for text in PROJECT["dependency-groups"][group] if isinstance(text, str)]
    declared = {canonicalize_name(Requirement(text).name) for text in texts}
    provides = {**importlib.metadata.packages_distributions(), "pinocchio": ["pin"]}  # pin hides it behind a .pth file
    missing = [name for name in imported(folder)
               if not {canonicalize_name(distribution) for distribution in provides.get(name, [name])} & declared]
    assert missing == [], "declare them in pyproject.toml and run .ci/lock"


def closure(requirements: list[Requirement]) -> Iterator[tuple[str, Requirement]]:
    """Each requirement with the one who has it, followed through what is installed here."""
    queue, seen = [("pyproject.toml", requirement) for requirement in requirements], set()
    while queue:
        by, requirement = queue.pop()
        if (by, str(requirement)) in seen:
            continue
        seen.add((by, str(requirement)))
        yield by, requirement
        for text in importlib.metadata.requires(requirement.name) or ():
            needed = Requirement(text)
            if any(needed.marker is None or needed.marker.evaluate({"extra": x}) for x in ("", *requirement.extras)):
                queue.append((requirement.name, needed))


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_satisfies_the_project(lock: str) -> None:
    have = pins(lock)
    bad = [f"{by} needs {requirement}; {lock} has {have.get(canonicalize_name(requirement.name))}"
           for by, requirement in closure(wanted(lock))
           if not requirement.specifier.contains(have.get(canonicalize_name(requirement.name), "0"), prereleases=True)
           or canonicalize_name(requirement.name) not in have]
    assert bad == [], "run .ci/lock"


def test_locks_agree() -> None:
    run, dev = (pins(lock) for lock in LOCKS)
    assert run.items() <= dev.items()


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_is_hashed_and_names_no_place(lock: str) -> None:
    entry = r"\S+==\S+( ; [^#:]*?)?(\s+--hash=sha256:[0-9a-f]{64})+"
    lines = (ROOT / lock).read_text().replace("\\\n", " ").splitlines()
    assert [line for line in lines if not re.fullmatch(entry, line)] == []


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Content of every file of the checkout that git tracks or would track, by its path."""
    ask = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    try:
        names = subprocess.run(ask, capture_output=True, check=True, text=True).stdout.split("\0")
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no git checkout")
    paths = [path for path in (ROOT / name for name in names if name) if path.is_file()]
    return {str(path.relative_to(ROOT)): path.read_bytes().decode("latin-1") for path in paths}


def test_no_file_names_a_registry(texts: dict[str, str]) -> None:
    hosts = ("pypi" + r"\.org", "python" + "hosted", "registry" + r"\.npmjs", "npmjs" + r"\.org", "conda" + r"\.org",
             "deb" + r"\.debian", "/pypi" + "/simple")
    assert [(path, host) for path, text in texts.items() for host in hosts if re.search(host, text)] == []


def test_no_file_holds_a_path_of_one_machine(texts: dict[str, str]) -> None:
    places = {re.escape(str(ROOT)), re.escape(str(Path.home())) + "/", "/home" + r"/(?!elbowroom\b)\w", "/Users" + "/"}
    places |= {r"(?<![\w./])/(?:" + name + ")/" for name in ("work", "root", "tmp/dev")}
    assert [(path, place) for path, text in texts.items() for place in places if re.search(place, text)] == []


def test_changelog_starts_with_this_version() -> None:
    first = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    assert first is not None
    assert first.group(1) == PROJECT["project"]["version"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("*.whl"))


def test_wheel_holds_the_packages_and_the_assets(wheel: Path) -> None:
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    expected = {str(path.relative_to(ROOT)) for package in ("hrc", "app") for path in (ROOT / package).rglob("*")
                if path.is_file() and "__pycache__" not in path.parts}
    expected |= {str(Path("hrc") / path.relative_to(ROOT)) for path in (ROOT / "assets").rglob("*")
                 if path.is_file() and "__pycache__" not in path.parts}
    assert names == expected


def test_wheel_works_away_from_the_checkout(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    program = """
import sys
from pathlib import Path
here = Path(sys.argv[1])
import app, hrc.paths
from hrc.cell.cell import Cell
from hrc.config import Config
for module in (app, hrc.paths):
    assert here in Path(module.__file__).parents, module.__file__
assert hrc.paths.assets() == here / "hrc" / "assets", hrc.paths.assets()
assert hrc.paths.static() == here / "app" / "static" and hrc.paths.static().is_dir(), hrc.paths.static()
Cell(Config()).step()
"""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-P", "-c", program, str(tmp_path)], cwd=tmp_path, env=environment,
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_readme_shows_the_two_commands_early_and_its_example_runs() -> None:
    readme = (ROOT / "README.md").read_text()
    top = readme.splitlines()[:15]
    assert any(line.startswith("python3 start.py ") for line in top), top
    assert any(line.startswith("python3 start.py test") for line in top), top
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", readme):
        assert (ROOT / picture).is_file(), picture
    example = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)[0]
    assert len(example.strip().splitlines()) <= 8, "the API in eight lines"
    done = subprocess.run([sys.executable, "-c", example], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"\d", done.stdout), "it prints the estimated force"


def test_start_leaves_a_folder_that_is_no_environment_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("three years of work")
    start = [sys.executable, str(ROOT / "start.py"), "test", "--version"]
    done = subprocess.run(start, env={**os.environ, "ELBOWROOM_VENV": str(tmp_path)}, capture_output=True, text=True,
                          check=False)
    assert done.returncode != 0
    assert "left alone" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_docs_name_what_is_there() -> None:
    """Every path, test and dotted name of the library that stands in backticks in docs/paper.md exists."""
    text = (ROOT / "docs" / "paper.md").read_text()
    named = set(re.findall(r"`([^`\n]+)`", text))
    for path in (n for n in named if re.fullmatch(r"(hrc|app|tests|assets)/[\w/.]+", n)):
        assert (ROOT / path).exists(), path
    for name in (n for n in named if re.fullmatch(r"hrc(\.\w+)+", n)):
        module, parts = name.split("."), []
        while not (ROOT / Path(*module)).with_suffix(".py").is_file() and not (ROOT / Path(*module)).is_dir():
            parts.insert(0, module.pop())
        found = importlib.import_module(".".join(module))
        for part in parts:
            found = getattr(found, part)
