#!/usr/bin/env python3
"""Build the image and try what docs/docker.md promises of it:  deploy/check_image.py [--base IMAGE] [--no-build]

Needs a Docker engine with BuildKit on Linux, and the ports 8080 and 8786; where no engine runs, deploy/private_engine brings
one. Each container runs read-only, without rights and on the network of the host. Prints one line for each promise; exit
code 1 if one is broken. For pip inside the build PIP_INDEX_URL and PIP_CERT of the environment hold, handed over as secrets.
Standard library only.
"""

import argparse
import contextlib
import http.client
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TAG, TOKEN = "elbowroom", "a-token-for-this-check"
PORT = 8080
MOST_BYTES = 1.1e9
RESTRICTED = ("--read-only", "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--tmpfs", "/tmp",
              "--network", "host")
WATCHED = ("--health-interval", "2s", "--health-timeout", "5s", "--health-retries", "2")
"""Sooner than the image's own health check, which is not changed otherwise."""
RECORD = f"""
from app.client import Client, until
client = Client({PORT}, path="/?token={TOKEN}")
assert client.ready.wait(60.0)
until(lambda: client.banner()["mode"] == "idle", 60.0)
client.click("Record")
until(lambda: 'data-recording="true"' in client.text())
"""
MOTION = """
import time
begin = time.perf_counter()
from hrc.cell.cell import Cell
from hrc.vision.kernels.types import cpu_flags
loaded = time.perf_counter()
cell = Cell()
while cell.tick < 100:
    snapshot = cell.step()
print(f"{loaded - begin:.2f} {time.perf_counter() - loaded:.2f} {cpu_flags().partition('-target-cpu ')[2] or 'base'}")
"""


class Check:
    """Says of each promise whether it holds. broken: how many do not."""

    def __init__(self) -> None:
        self.broken = 0

    def __call__(self, holds: bool, promise: str, figure: object = "") -> None:
        """One line. figure: what was found."""
        self.broken += not holds
        print(f"{'ok    ' if holds else 'BROKEN'}  {promise}{f': {figure}' if figure != '' else ''}", flush=True)


check = Check()


def docker(*arguments: str, timeout: float = 120.0) -> str:
    """What a docker command prints on stdout. Ends the check, with all that was printed, if it fails."""
    done = subprocess.run(["docker", *arguments], capture_output=True, text=True, timeout=timeout, check=False)
    if done.returncode:
        raise SystemExit(f"docker {' '.join(arguments)}\n{done.stdout}{done.stderr}")
    return done.stdout.strip()


def build(base: str | None) -> None:
    """Build the image; pip's configuration travels as secrets, of which nothing stays in a layer."""
    with tempfile.TemporaryDirectory() as folder:
        settings, secrets = ["[global]"], []
        if "PIP_INDEX_URL" in os.environ:
            settings.append(f"index-url = {os.environ['PIP_INDEX_URL']}")
        if "PIP_CERT" in os.environ:
            settings.append("cert = /run/secrets/certificates")
            secrets += ["--secret", f"id=certificates,src={os.environ['PIP_CERT']}"]
        (Path(folder) / "pip.conf").write_text("\n".join(settings) + "\n")
        secrets += ["--secret", f"id=pip,src={folder}/pip.conf"]
        command = ["docker", "build", "--network", "host", "--tag", TAG, *secrets]
        command += ["--build-arg", f"BASE={base}"] if base else []
        begin = time.monotonic()
        done = subprocess.run([*command, str(ROOT)], check=False, env={**os.environ, "DOCKER_BUILDKIT": "1"}, text=True,
                              stdout=subprocess.DEVNULL, stderr=None if sys.stderr.isatty() else subprocess.PIPE)
        if done.returncode:
            raise SystemExit("\n".join(["it does not build:", *(done.stderr or "").splitlines()[-30:]]))
    check(True, "it builds", f"{time.monotonic() - begin:.0f} s, of which the engine may have had parts already")


def outside() -> None:
    """What can be seen without running it."""
    image = json.loads(docker("image", "inspect", TAG))[0]
    check(image["Size"] <= MOST_BYTES, "it has at most 1.1 GB", f"{image['Size'] / 1e9:.3f} GB")
    check(image["Config"]["User"] == "10001", "its user is not root", image["Config"]["User"])
    if hadolint := shutil.which("hadolint"):
        done = subprocess.run([hadolint, str(ROOT / "Dockerfile")], capture_output=True, text=True, check=False)
        check(done.returncode == 0, "hadolint has nothing to say", done.stdout.strip())
    else:
        print("not tried: hadolint is not on PATH")


@contextlib.contextmanager
def container(*arguments: str, options: tuple[str, ...] = ()) -> Iterator[str]:
    """A container of the image, removed in the end."""
    name = docker("run", "--detach", *RESTRICTED, *options, TAG, *arguments)
    try:
        yield name
    finally:
        docker("rm", "--force", name)


@contextlib.contextmanager
def page(folder: Path) -> Iterator[str]:
    """A container that serves the page, as soon as it is healthy; its recordings are in the folder."""
    options = ("--env", f"ELBOWROOM_TOKEN={TOKEN}", "--volume", f"{folder}:/data", *WATCHED)
    with container(options=options) as name:
        if not until(lambda: health(name) == "healthy", 90.0):
            raise SystemExit(f"the page does not become healthy:\n{docker('logs', name)}")
        yield name


def health(name: str) -> str:
    """What the engine says of a container's health."""
    return docker("inspect", "--format", "{{.State.Health.Status}}", name)


def until(condition: Callable[[], bool], most: float) -> bool:
    """Wait for a condition, at most so long [s]; whether it came true."""
    deadline = time.monotonic() + most
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.2)
    return True


def status(path: str) -> int:
    """The HTTP status of an address of the page, as it comes: no redirection is followed."""
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=5.0)
    with contextlib.closing(connection):
        connection.request("GET", path)
        return connection.getresponse().status


def serves(folder: Path) -> None:
    """The page, who gets in, what it may do, and its health."""
    begin = time.monotonic()
    with page(folder) as name:
        check(True, "the page becomes healthy", f"{time.monotonic() - begin:.1f} s after docker run")
        found = [status(path) for path in ("/", "/?token=not-the-token", f"/?token={TOKEN}", "/healthz")]
        check(found == [401, 401, 302, 200], "page without, with a wrong and with the right token; /healthz without", found)
        process = docker("exec", name, "cat", "/proc/1/status")
        rights = dict(re.findall(r"(?m)^(Uid|CapEff|NoNewPrivs):\s+(\S+)", process))
        check(rights == {"Uid": "10001", "CapEff": "0" * 16, "NoNewPrivs": "1"}, "its process has no rights", rights)
        written = subprocess.run(["docker", "exec", "--user", "0", name, "touch", "/x"], capture_output=True, text=True,
                                 check=False)
        check("Read-only" in written.stderr, "its file system cannot be written, not even by root", written.stderr.strip())
        begin = time.monotonic()
        docker("kill", "--signal", "STOP", name)
        unhealthy = until(lambda: health(name) == "unhealthy", 60.0)
        check(unhealthy, "stopped by SIGSTOP it turns unhealthy", f"{time.monotonic() - begin:.0f} s")
        docker("kill", "--signal", "CONT", name)
        check(until(lambda: health(name) == "healthy", 60.0), "and healthy when it goes on")


def stops(number: str, folder: Path) -> None:
    """A page that records ends well on a signal."""
    with page(folder) as name:
        docker("exec", "--interactive", name, "python", "-c", RECORD)
        time.sleep(2.0)
        begin = time.monotonic()
        docker("kill", "--signal", number, name)
        code = docker("wait", name)
        seconds = time.monotonic() - begin
        check(code == "0" and seconds < 10.0, f"{number} ends it", f"exit code {code} after {seconds:.1f} s")
    (recording,) = (folder / "recordings").iterdir()
    told = docker("run", "--rm", *RESTRICTED, "--volume", f"{folder}:/data", TAG, "repair",
                  f"recordings/{recording.name}/session.rrd")
    check("is whole" in told, "its recording is closed", told)


def runs(folder: Path) -> None:
    """A run without a screen writes to a mounted folder."""
    told = docker("run", "--rm", *RESTRICTED, "--volume", f"{folder}:/data", TAG, "run", "push", "--duration", "2", "--out",
                  "push", "--quiet")
    found = {path.name for path in (folder / "push").iterdir()}
    check(found >= {"session.rrd", "signals.parquet", "metrics.json"}, "a run inside writes to a mounted folder",
          told.splitlines()[-1])
    told = docker("run", "--rm", *RESTRICTED, "--volume", f"{folder}:/data", TAG, "replay", "push", "--exact")
    check(told.startswith("identical"), "and replays exactly inside", told)


def campaigns(folder: Path) -> None:
    """A campaign with TLS across containers, one worker killed in the middle, against an undisturbed one in one container."""
    volume, episodes = ("--no-healthcheck", "--volume", f"{folder}:/data"), 24
    campaign = ("campaign", "force_accuracy", "--episodes", str(episodes), "--out")
    begin = time.monotonic()
    docker("run", "--rm", *RESTRICTED, *volume, TAG, *campaign, "one", timeout=600.0)
    alone = time.monotonic() - begin
    docker("run", "--rm", *RESTRICTED, *volume, "--entrypoint", "openssl", TAG, "req", "-x509", "-newkey", "ec", "-pkeyopt",
           "ec_paramgen_curve:prime256v1", "-nodes", "-keyout", "key.pem", "-out", "cert.pem", "-days", "1", "-subj",
           "/CN=check")
    tls = ("--tls-ca-file", "cert.pem", "--tls-cert", "cert.pem", "--tls-key", "key.pem")
    dask = (*volume, "--entrypoint", "dask", "--env", "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION=true", "--env",
            "DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION=1.0", "--env", "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES=1")
    worker = ("worker", "tls://127.0.0.1:8786", "--nthreads", "1", "--nworkers", "1", "--no-dashboard", "--local-directory",
              "/tmp", *tls)
    records = folder / "two" / "records.jsonl"
    with (container("scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port", "8786", "--no-dashboard", *tls,
                    options=dask),
          container(*worker, options=dask) as victim, container(*worker, options=dask),
          container(*campaign, "two", "--address", "tls://127.0.0.1:8786", "--tls-ca", "cert.pem", "--tls-cert", "cert.pem",
                    "--tls-key", "key.pem", options=volume) as client):
        begin = time.monotonic()
        until(lambda: records.exists() and len(read(records)) >= episodes // 3, 120.0)
        docker("kill", victim)
        there = len(read(records))
        code = docker("wait", client, timeout=600.0)
        took = time.monotonic() - begin
        logs = docker("logs", client)
    check(code == "0", f"a campaign across containers survives one of two workers, killed after {there} of {episodes} episodes",
          f"exit code {code}, {took:.0f} s; undisturbed in one container {alone:.0f} s" if code == "0" else logs)
    one, two = (read(folder / name / "records.jsonl") for name in ("one", "two"))
    same = sum(one[index] == two.get(index) for index in one)
    errors = sum(bool(record.get("error")) for record in two.values())
    check(same == len(two) == episodes and not errors and there < episodes,
          "and has the records of an undisturbed one, to the bit", f"{same} of {episodes} equal, {errors} errors")


def read(records: Path) -> dict[int, dict[str, Any]]:
    """The records of a campaign by index; a line that is just being written is left out."""
    lines = records.read_text().split("\n")[:-1]
    return {record["index"]: record for record in map(json.loads, lines)}


def starts_warm(folder: Path) -> None:
    """The kernels are there for CPUs of every level. The file system cannot be written: what is missing fails."""
    cpuinfo = Path("/proc/cpuinfo").read_text()
    lesser = {"this CPU": "", "one without AVX-512": r" avx512\w*", "one without AVX2": r" avx(512|2)\w*"}
    for what, flags in lesser.items():
        fake = folder / "cpuinfo"
        fake.write_text(re.sub(flags, "", cpuinfo) if flags else cpuinfo)
        options = ("--volume", f"{fake}:/proc/cpuinfo:ro", "--entrypoint", "python")
        told = docker("run", "--rm", *RESTRICTED, *options, TAG, "-c", MOTION).split()
        check(float(told[1]) < 3.0, f"kernels are compiled already for {what}",
              f"imports {told[0]} s, then the first 0.1 s of motion in {told[1]} s; level {told[2]}")
    cold = docker("run", "--rm", *RESTRICTED, "--env", "WARP_CACHE_PATH=/tmp/none", "--entrypoint", "python", TAG, "-c", MOTION)
    print(f"        for comparison without them: {cold.split()[1]} s")


def main() -> None:
    """All of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", help="the base image, if not the one that the Dockerfile names")
    parser.add_argument("--no-build", action="store_true", help="try the image that is there")
    parser.add_argument("--only", help="only the checks whose names contain this")
    arguments = parser.parse_args()
    print(f"docker {docker('version', '--format', '{{.Server.Version}}')}, {platform.platform()}, {os.cpu_count()} cores; "
          f"base {arguments.base or 'as in the Dockerfile'}")
    if not arguments.no_build:
        build(arguments.base)
    outside()
    checks = {"serves": serves, "SIGTERM": lambda folder: stops("SIGTERM", folder),
              "SIGINT": lambda folder: stops("SIGINT", folder), "runs": runs, "warm": starts_warm, "campaign": campaigns}
    for name, tried in checks.items():
        if arguments.only is None or arguments.only in name:
            with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
                Path(folder).chmod(0o777)  # the image's user writes here
                tried(Path(folder))
    print(f"{check.broken} promises broken" if check.broken else "all promises hold")
    sys.exit(bool(check.broken))


if __name__ == "__main__":
    main()
