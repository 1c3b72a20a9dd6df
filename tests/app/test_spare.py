"""The cell's process begins to load before the page has said what it is for, and never outlives it."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from process import alive, children, launched
from vclient import until

from app.serve import spare
from app.serve.mailbox import Mailbox
from app.serve.process import Order
from app.serve.remote import RemoteCell

PREPARES = """
import signal, time
from app.serve import spare

signal.signal(signal.SIGINT, signal.default_int_handler)  # begun in the background of a shell, the tests' processes ignore it
with spare.prepared():
    print("there", flush=True)
    time.sleep(60)
"""


@pytest.mark.live
def test_a_cell_takes_the_process_that_has_begun(tmp_path: Path) -> None:
    with spare.prepared():
        (begun, _), = spare._waiting
        cell = RemoteCell(Mailbox(), Order(tmp_path), say=lambda _: None)
        cell.start("free")
        assert cell.pid == begun.pid
        assert not spare._waiting
        until(lambda: cell.config is not None)
    assert begun.is_alive()
    cell.close()
    until(lambda: begun.exitcode == 0)  # another thread waits for it, too: who comes second knows a little later


def test_one_that_nobody_took_ends_with_the_block() -> None:
    with spare.prepared():
        (begun, _), = spare._waiting
    assert not spare._waiting
    assert not begun.is_alive()


def test_one_that_has_ended_meanwhile_is_not_taken() -> None:
    with spare.prepared():
        (dead, _), = spare._waiting
        dead.kill()
        dead.join()
        process, link = spare.taken()
    assert process.pid != dead.pid
    assert process.is_alive()
    link.close()  # nobody will order
    process.join(60.0)
    assert process.exitcode == 0


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_it_ends_with_a_page_that_came_to_nothing(end: signal.Signals) -> None:
    with launched([sys.executable, "-c", PREPARES], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as page:
        assert page.stdout is not None
        assert page.stdout.readline() == "there\n"
        started = children(page.pid)
        assert started
        page.send_signal(end)
        page.wait()
        until(lambda: not any(alive(process) for process in started))
        assert page.stderr is not None
        said = page.stderr.read()
    assert said.count("Traceback") == (1 if end is signal.SIGINT else 0), said
