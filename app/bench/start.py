"""How long a start takes: from the command to the first page, and to the first motion that a visitor sees."""

import contextlib
import os
import platform
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from app.bench.cpu import cores
from app.bench.report import check, write
from app.client import Client, until
from hrc.paths import assets

STARTS = 3
PATIENCE = 120.0
"""The longest that a start may take [s]."""
LINK, BARE_LINK = "/robot/link_4", "/link_4"
MOVED = 1e-4
"""From here on a link has moved [m]."""
LOADED, PAGE, CELL, MOTION = "loaded", "page", "cell", "motion"
STAGES = {LOADED: "Python and all imports", PAGE: "first page", CELL: "cell built", MOTION: "first motion seen"}
BARE = """
import sys, time, mujoco, viser
server = viser.ViserServer(host="127.0.0.1", port=int(sys.argv[1]), verbose=False)
model = mujoco.MjModel.from_xml_path(sys.argv[2])
data = mujoco.MjData(model)
data.qvel[:] = 0.5
frames = [(body, server.scene.add_frame("/" + model.body(body).name)) for body in range(1, model.nbody)]
while True:
    mujoco.mj_step(model, data)
    for body, frame in frames:
        frame.position, frame.wxyz = data.xpos[body], data.xquat[body]
    time.sleep(0.01)
"""
"""The least that shows a moving arm in a browser: MuJoCo and viser, a frame for each link; no sensor, no control."""


def bench(device: str = "cpu", json: Path | None = None, quick: bool = False) -> None:
    """Measure, print a table, and write every figure with its conditions to `json`.

    Raises OutputError, before anything is measured, if `json` cannot be written.
    """
    if json is not None:
        check(json)
    figures = measure(device, 1 if quick else STARTS)
    if json is not None:
        write(json, figures)
    for line in printed(figures):
        print(line)


def measure(device: str, starts: int) -> dict[str, Any]:
    """Every figure as it goes into the JSON: of each kind of start the times since the command [s], of so many starts each."""
    serve = ("-m", "app", "serve", "--device", device, "--port")
    bare = ("-c", BARE)
    model = str(assets() / "lwr" / "lwr.xml")
    with tempfile.TemporaryDirectory() as folder:
        kinds: dict[str, Callable[[int], dict[str, float]]] = {
            "kernels in their cache": lambda _: timed(serve, (), LINK, {}),
            "kernels to be compiled": lambda i: timed(serve, (), LINK, {"WARP_CACHE_PATH": f"{folder}/{i}"}),
            "MuJoCo and viser alone": lambda _: timed(bare, (model,), BARE_LINK, {}),
        }
        for start in kinds.values():
            start(-1)  # fills the caches: the kernels', and the system's of files
        rows: dict[str, list[dict[str, float]]] = {name: [] for name in kinds}
        for i in range(starts):  # by turns: a noisy neighbour meets them all
            for name, start in kinds.items():
                rows[name].append(start(i))
    conditions = {"cores": cores(), "load": os.getloadavg()[0], "system": platform.platform(), "device": device,
                  "python": platform.python_version(), "starts": starts, "scenario": "free"}
    return {"conditions": conditions, "rows": {name: _row(row) for name, row in rows.items()}}


def _row(starts: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    return {"median_s": {stage: median(start[stage] for start in starts) for stage in STAGES if stage in starts[0]},
            "all_s": [dict(start) for start in starts]}


def timed(command: Sequence[str], arguments: Sequence[str], link: str, settings: Mapping[str, str]) -> dict[str, float]:
    """When each stage was reached since the command [s], in a fresh process. settings: of its environment."""
    port = _free_port()
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, *command, str(port), *arguments], stdout=subprocess.PIPE, text=True,
                               env={**os.environ, "PYTHONUNBUFFERED": "1", **settings})
    times: dict[str, float] = {}
    reader = threading.Thread(target=_read, args=(process, begin, times))
    reader.start()
    try:
        until(lambda: _answers(process, port), PATIENCE)
        times[PAGE] = time.perf_counter() - begin
        with _visitor(port) as visitor:
            if link == LINK:
                until(lambda: float(visitor.banner()["time"]) > 0.0, PATIENCE)
            until(lambda: visitor.position(link) is not None, PATIENCE)
            rest = visitor.position(link)
            until(lambda: bool(np.linalg.norm(visitor.position(link) - rest) > MOVED), PATIENCE)
            times[MOTION] = time.perf_counter() - begin
    finally:
        process.terminate()
        process.wait(timeout=30.0)
        reader.join()
    return times


def _read(process: "subprocess.Popen[str]", begin: float, times: dict[str, float]) -> None:
    """Note when the process says what it has done."""
    assert process.stdout is not None
    for line in process.stdout:
        stage = LOADED if line.startswith("loading") else CELL if line.endswith("is running\n") else None
        if stage is not None:
            times[stage] = time.perf_counter() - begin


def _answers(process: "subprocess.Popen[str]", port: int) -> bool:
    """Whether the whole page has come."""
    if process.poll() is not None:
        raise RuntimeError(f"the page ended with exit code {process.returncode}")
    with contextlib.suppress(OSError, urllib.error.URLError), urllib.request.urlopen(f"http://127.0.0.1:{port}/") as reply:
        return bool(reply.read())
    return False


@contextlib.contextmanager
def _visitor(port: int) -> Iterator[Client]:
    """A client of the page; while that is still being built, it hangs up on whoever comes."""
    deadline = time.monotonic() + PATIENCE
    while True:
        client = Client(port)
        until(lambda client=client: client.ready.is_set() or client.closed.is_set(), PATIENCE)
        if client.ready.is_set():
            break
        if time.monotonic() > deadline:
            raise TimeoutError("the page lets nobody in")
    try:
        yield client
    finally:
        client.close()


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def printed(figures: Mapping[str, Any]) -> Iterator[str]:
    """The lines of the table."""
    c = figures["conditions"]
    yield (f"{c['cores']} cores, load {c['load']:.1f}, Python {c['python']}, {c['system']}; scenario {c['scenario']} on "
           f"{c['device']}; a fresh process each, by turns, median of {c['starts']} [s since the command]")
    yield f"{'':26}" + "".join(f"{name:>24}" for name in STAGES.values())
    for name, row in figures["rows"].items():
        yield f"{name:26}" + "".join(
            f"{row['median_s'][stage]:24.2f}" if stage in row["median_s"] else f"{'':24}" for stage in STAGES)
