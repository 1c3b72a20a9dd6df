"""The cell in a process of its own: what becomes of the page when that hangs or dies, and of the cell when the page does."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from process import answers, children, free_port
from vclient import VClient, until

from app.record.repair import look
from app.serve import driver
from app.serve.access import Access
from app.serve.driver import Phase
from app.serve.main import Page
from app.serve.process import SILENT, URGENT, Host, Order
from app.serve.remote import RemoteCell
from app.serve.wire import Call, CutError, Pulse, Wire, slim, with_images
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import Pull, Stop
from hrc.messages import Mode, Snapshot


class Refusing:
    """A witness that refuses to tell."""

    def on_step(self, _: Snapshot) -> None:
        """Nothing."""

    def told(self) -> None:
        """Raises."""
        raise HrcError("my lips are sealed")

    def hang(self) -> None:
        """For longer than anybody waits."""
        time.sleep(600.0)


@pytest.fixture
def lone(tmp_path: Path) -> Iterator[tuple[Page, RemoteCell, list[str]]]:
    """A page of its own whose cell's process is to be broken, and what it says."""
    said = list[str]()
    page = Page("free", Access(port=0), say=said.append, recordings=tmp_path / "recordings", witness=Refusing)
    assert isinstance(page.session, RemoteCell)
    page.start()
    yield page, page.session, said
    if page.session.pid is not None:
        os.kill(page.session.pid, signal.SIGCONT)
    page.close()


def moving(page: Page) -> VClient:
    """A client of the page, when its arm moves."""
    client = VClient(page.server.get_port())
    until(lambda: client.ready.is_set() and client.banner()["mode"] == "idle" and float(client.banner()["time"]) > 0.5)
    return client


def test_the_cell_goes_before_the_page_where_the_system_lets_it(served: Page) -> None:
    """Every thread of it, for they share an interpreter."""
    assert isinstance(served.session, RemoteCell)
    until(lambda: served.session.status.phase is Phase.RUNNING)
    lets = subprocess.run([sys.executable, "-c", f"import os; os.nice({URGENT})"], stderr=subprocess.DEVNULL, check=False)
    own, of_cell = os.getpriority(os.PRIO_PROCESS, 0), Path(f"/proc/{served.session.pid}/task").iterdir()
    begun_later = {os.getpriority(os.PRIO_PROCESS, int(task.name)) for task in of_cell} - {own}
    assert begun_later == ({own + URGENT} if lets.returncode == 0 else set())


@pytest.mark.live
def test_a_cell_whose_process_is_killed_fails_and_is_made_anew(lone: tuple[Page, RemoteCell, list[str]]) -> None:
    page, cell, said = lone
    client, before = moving(page), cell.pid
    assert before is not None
    cell.speed = 0.5
    client.click("Record")
    archive = page.recordings.archive
    until(lambda: archive.now is not None and archive.now.seconds > 1.0)
    os.kill(before, signal.SIGKILL)
    until(lambda: client.banner()["mode"] == "failed")
    assert "exit code -9. Reset or choose a scenario." in client.text()
    assert not page.session.healthy
    assert "the cell failed (its process has ended, exit code -9); the page lives on" in said
    with pytest.raises(HrcError, match="the cell is not running"):
        cell.put(Stop())
    until(lambda: 'data-recording="false"' in client.text())
    client.set("Simulation", "Reset")
    until(lambda: client.banner()["mode"] == "idle" and float(client.banner()["time"]) > 0.3)
    assert cell.pid not in (None, before)
    assert page.session.healthy
    until(lambda: 0.4 < cell.factor < 0.6)  # as fast as was asked for
    (name,) = archive.names()
    assert archive.mend(name), "what a killed process left of the recording is put in order"
    client.close()


@pytest.mark.live
def test_a_cell_whose_process_stands_still_is_said_not_to_respond(
        lone: tuple[Page, RemoteCell, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "HANGS", 3.0)
    page, cell, _ = lone
    client = moving(page)
    assert cell.pid is not None
    os.kill(cell.pid, signal.SIGSTOP)
    until(lambda: client.banner()["mode"] == "not responding")
    until(lambda: not cell.healthy)
    beat = int(client.banner()["beat"])
    until(lambda: int(client.banner()["beat"]) > beat + 5)
    client.click("STOP (Esc)")  # it waits there, and holds as soon as the process goes on
    os.kill(cell.pid, signal.SIGCONT)
    until(lambda: client.banner()["mode"] == "stop" and cell.healthy)
    client.close()


@pytest.mark.live
def test_what_the_cell_raises_is_raised_here(lone: tuple[Page, RemoteCell, list[str]]) -> None:
    page, cell, _ = lone
    moving(page).close()
    with pytest.raises(HrcError, match="my lips are sealed"):
        cell.ask("told")
    with pytest.raises(HrcError, match="nothing is being recorded"):
        cell.call("end")
    failed = list[HrcError]()

    def asks() -> None:
        try:
            cell.ask("hang")
        except HrcError as error:
            failed.append(error)

    asking = threading.Thread(target=asks)
    asking.start()
    time.sleep(0.2)
    assert cell.pid is not None
    os.kill(cell.pid, signal.SIGKILL)
    asking.join(10.0)
    assert [str(error) for error in failed] == ["the cell is gone (its process has ended, exit code -9)"]


@pytest.mark.live
def test_nothing_but_the_state_is_sent_while_nobody_looks(lone: tuple[Page, RemoteCell, list[str]]) -> None:
    page, cell, _ = lone
    until(lambda: page.latest is not None and page.latest.time > 1.0)
    assert page.latest is not None
    assert page.latest.views[0].frame is None
    client = moving(page)
    until(lambda: page.latest is not None and page.latest.views[0].foreground is not None)
    view = page.latest.views[0]
    until(lambda: page.latest is not None and page.latest.views[0].frame is not view.frame)
    assert page.latest.views[0].T_world_camera is view.T_world_camera, "who draws it need not ask whether it has moved"
    client.close()
    cell.paused = True
    assert cell.paused, "at once, however long it takes to get there"
    until(lambda: cell.factor == 0.0)
    cell.put(Stop())
    until(lambda: page.latest is not None and page.latest.command.mode is Mode.STOP)


@pytest.mark.live
def test_a_page_that_is_killed_leaves_no_cell_and_a_whole_recording(
        serve: Callable[..., subprocess.Popen[bytes]], tmp_path: Path) -> None:
    port = free_port()
    process = serve(port, "--recordings", str(tmp_path / "recordings"))
    until(lambda: answers(port))
    client = VClient(port)
    until(lambda: client.ready.is_set() and client.banner()["mode"] == "idle")
    client.click("Record")
    until(lambda: 'data-recording="true"' in client.text())
    time.sleep(1.0)
    cells = children(process.pid)
    assert cells
    process.kill()
    until(lambda: not any(Path(f"/proc/{cell}/statm").read_text().split()[0] != "0" for cell in cells
                          if Path(f"/proc/{cell}").exists()), 30.0)
    client.close()
    (folder,) = (tmp_path / "recordings").iterdir()
    assert not look(folder / "session.rrd").torn
    assert (folder / "metrics.json").is_file()


@pytest.mark.live
def test_the_arm_is_let_go_when_the_page_stands_still(ends: tuple[Wire, Wire], tmp_path: Path) -> None:
    """The cell's side alone, and a page that gives no sign of life in mid-drag."""
    here, there = ends
    host = Host(there, Order(tmp_path))
    host.start()
    here.send(Call(1, "open", ("free",)))
    pulled, let_go = Pull(4, (0.0, 0.0, 0.0), (-0.3, 0.5, 0.6)), 0.0

    def next_snapshot() -> Snapshot:
        while not isinstance(pulse := here.receive(), Pulse) or pulse.snapshot is None:
            pass
        return pulse.snapshot

    while next_snapshot().time < 0.3:
        pass
    here.send(Call(2, "put", (pulled,)))
    while next_snapshot().pull is None:
        pass
    begin = time.monotonic()
    while time.monotonic() < begin + SILENT - 0.5:
        assert next_snapshot().pull is not None
        host.mind_the_page()
    while next_snapshot().pull is not None and let_go < SILENT + 1.0:
        let_go = time.monotonic() - begin
        host.mind_the_page()
    assert SILENT - 0.5 < let_go < SILENT + 1.0
    host.close()



@pytest.fixture
def ends() -> Iterator[tuple[Wire, Wire]]:
    here, there = Pipe()
    yield Wire(here), Wire(there)
    here.close()
    there.close()


def test_what_is_sent_arrives_in_order_and_bit_for_bit(ends: tuple[Wire, Wire]) -> None:
    here, there = ends
    cell = Cell(Config())
    for _ in range(150):
        snapshot = cell.step()
    image = snapshot.views[0].foreground
    assert image is not None
    sending = threading.Thread(target=lambda: [here.send(x) for x in ("first", slim(snapshot, images=True), "last")])
    sending.start()
    first, came, last = (there.receive() for _ in range(3))
    sending.join()
    assert (first, last) == ("first", "last")
    assert came.views[0].foreground.depth.tobytes() == image.depth.tobytes()
    assert came.state.q.tobytes() == snapshot.state.q.tobytes()
    assert came.command.mode is snapshot.command.mode
    assert came.exposed is None, "nobody at the page needs what only the plant knows"


def test_images_stay_until_others_come(ends: tuple[Wire, Wire]) -> None:
    here, there = ends
    cell = Cell(Config())
    for _ in range(150):
        snapshot = cell.step()

    def sent(message: Any) -> Any:
        thread = threading.Thread(target=here.send, args=(message,))
        thread.start()
        came = there.receive()
        thread.join()
        return came

    whole = with_images(sent(slim(snapshot, images=True)), None, own=True)
    later = with_images(sent(slim(cell.step(), images=False)), whole, own=False)
    assert later.tick == whole.tick + 1
    assert later.views[0].frame is whole.views[0].frame
    assert later.views[0].robot_image is whole.views[0].robot_image
    np.testing.assert_array_equal(later.views[0].frame.depth, snapshot.views[0].frame.depth)


def test_an_end_that_has_gone_is_said(ends: tuple[Wire, Wire]) -> None:
    here, there = ends
    there.close()
    with pytest.raises(CutError):
        here.receive()
    with pytest.raises(CutError):
        here.send("anybody there?")


def test_phases_have_their_patience() -> None:
    assert driver.Status(Phase.STARTING).well(100.0)
    assert not driver.Status(Phase.RUNNING).well(100.0)
    assert not driver.Status(Phase.FAILED).well(0.0)
