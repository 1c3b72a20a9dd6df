#!/usr/bin/env python3
"""Make the project's environment (once), then start the web app or the tests.

    python3 start.py [ARGUMENTS]         elbowroom serve ARGUMENTS
    python3 start.py test                every test: those of the page, which need quiet cores, after all the others
    python3 start.py test ARGUMENTS      pytest ARGUMENTS

The environment is .venv beside this file (ELBOWROOM_VENV moves it), filled from the hashed lock file with uv if it
is on PATH, else with venv and pip; the system's own packages are never touched, so an externally managed Python is
fine. Standard library only, in syntax of Python 3.6: an old python3 finds a newer one by itself.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = Path(os.environ.get("ELBOWROOM_VENV") or ROOT / ".venv").absolute()
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "elbowroom-stamp"  # written last: an environment without it was never finished
RUN, DEV = "requirements.lock", "requirements-dev.lock"  # DEV holds every pin of RUN
PROJECT = "pyproject.toml"
SUPPORTED = ((3, 12), (3, 13), (3, 11), (3, 14))  # by preference


def main(arguments):
    """Make what is missing, then become the app or the tests."""
    test = arguments[:1] == ["test"]
    try:
        prepare(test)
    except subprocess.CalledProcessError as error:
        sys.exit("start.py: set-up failed (exit code %d, reason above); run it again to start afresh"
                 % error.returncode)
    except KeyboardInterrupt:
        sys.exit("start.py: set-up interrupted; run it again to start afresh")
    if test:
        os.chdir(str(ROOT))
        command = [str(PYTHON), "-m", "pytest", *arguments[1:]]
        if not arguments[1:]:
            side_by_side = subprocess.run([*command, "-n", "auto", "--dist", "loadfile", "-m", "not live"], check=False)
            if side_by_side.returncode:
                sys.exit(side_by_side.returncode)
            command += ["-m", "live"]
    else:
        command = [str(PYTHON.with_name("elbowroom")), "serve", *arguments]
    os.execv(command[0], command)


def prepare(test):
    """Bring the environment to its lock file; nothing to do if it is there already."""
    marks = STAMP.read_text().splitlines() if STAMP.is_file() and PYTHON.exists() else []
    libraries, package = (*marks, "", "")[:2]
    lock = DEV if test or libraries == mark(DEV) else RUN
    if libraries == mark(lock) and package == mark(PROJECT):
        return
    if STAMP.exists():
        STAMP.unlink()
    uv = shutil.which("uv")
    if libraries not in (mark(RUN), mark(DEV)):
        make_venv(uv)
    install = [uv, "pip", "install", "--quiet", "--python", PYTHON] if uv else pip_install()
    if libraries != mark(lock):
        call(*install, "--only-binary", ":all:", "--require-hashes", "-r", ROOT / lock)
    call(*install, "--no-deps", "--no-build-isolation", "--editable", ROOT)
    STAMP.write_text(mark(lock) + "\n" + mark(PROJECT) + "\n")


def mark(name):
    """What stands in the stamp for a file of this checkout (a copied environment still points at the old one)."""
    return hashlib.sha256(os.fsencode(str(ROOT / name)) + b"\0" + (ROOT / name).read_bytes()).hexdigest()


def make_venv(uv):
    """An empty environment in place of whatever is left of an older one.

    Where Python has no ensurepip (Debian without python3-venv) it gets no pip of its own: see `pip_install`.
    """
    parts = {"bin", "include", "lib", "lib64"}  # a venv killed before it wrote pyvenv.cfg
    if VENV.exists() and not (VENV / "pyvenv.cfg").exists() and not {path.name for path in VENV.iterdir()} <= parts:
        sys.exit("start.py: %s exists and is no Python environment; it is left alone (ELBOWROOM_VENV chooses the place)"
                 % VENV)
    python = find_python()
    if uv:
        call(uv, "venv", "--quiet", "--clear", "--python", python or "3.12", VENV)
    elif python is None:
        sys.exit("start.py: needs Python 3.11 to 3.14, and found only %d.%d; install one of them, or uv, and run it "
                 "again" % sys.version_info[:2])
    elif runs(python, "-c", "import ensurepip, venv"):
        call(python, "-m", "venv", "--clear", VENV)
    elif runs(python, "-c", "import pip, venv"):
        call(python, "-m", "venv", "--clear", "--without-pip", VENV)
    else:
        sys.exit("start.py: %s has neither ensurepip nor pip; on Debian and Ubuntu: apt install python3-venv" % python)


def find_python():
    """A supported Python that really runs: this one, else the first on PATH; None if there is none."""
    candidates = [getattr(sys, "_base_executable", None) or sys.executable]  # of a venv: the Python it was made from
    candidates += [shutil.which("python%d.%d" % version) for version in SUPPORTED]
    candidates += [shutil.which("python3")]
    return next((python for python in candidates if python and version_of(python) in SUPPORTED), None)


def version_of(python):
    """(major, minor) of an executable; None if it does not run, as a version manager's empty shim."""
    ask = [python, "-c", "import sys; print(*sys.version_info[:2])"]
    try:
        answer = subprocess.run(ask, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True, timeout=30).stdout
        return tuple(int(number) for number in answer.split())
    except (OSError, ValueError, subprocess.SubprocessError):
        return None


def pip_install():
    """The start of an install command: the environment's own pip, else the pip of the Python it was made from."""
    pip = [PYTHON, "-m", "pip"]
    if not runs(*pip, "--version"):
        pip = [find_python(), "-m", "pip", "--python", PYTHON]
    return [*pip, "install", "--quiet", "--disable-pip-version-check", "--no-input", "--no-user"]


def runs(*command):
    """Whether a command ends well; what it prints is dropped."""
    done = subprocess.run([str(part) for part in command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                          check=False)
    return done.returncode == 0


def call(*command):
    """Run one command of the set-up, and show it: a long download is no silence. Raises CalledProcessError."""
    words = [str(part) for part in command]
    print("start.py: " + " ".join(words), file=sys.stderr, flush=True)
    subprocess.run(words, check=True)


if __name__ == "__main__":
    if os.name == "nt":
        sys.exit("start.py: the robot dynamics have no Windows build; use Linux, macOS, WSL or the Dockerfile")
    main(sys.argv[1:])
