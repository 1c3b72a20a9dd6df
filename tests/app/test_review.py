"""Looking at a recording: the viewer of the installed package, for this machine alone, and no word to any other host."""

import http.client
import os
import re
import shutil
import threading
import time

import pytest

pytest.importorskip("rerun")

from app.__main__ import main
from app.headless import Job, execute
from app.review import LOOPBACK, ReviewError, Server, recordings, viewer


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("review") / "out"
    execute(Job("push", out, duration=2.5, quiet=True))
    return out


@pytest.fixture(scope="module")
def server(folder):
    with Server(recordings([folder]), viewer()) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def answer(server, path, host=None):
    connection = http.client.HTTPConnection(LOOPBACK, server.server_port, timeout=30)
    connection.request("GET", path, headers={"Host": host} if host else {})
    response = connection.getresponse()
    return response, response.read()


def test_page_and_recording_come_with_a_policy_that_names_no_other_host(server, folder):
    response, body = answer(server, server.start)
    assert response.status == 200
    policy = response.headers["Content-Security-Policy"]
    assert "connect-src 'self';" in policy
    assert "://" not in policy
    assert not re.search(rb"<(link|script)[^>]*https?://", body)
    assert b"script.src" not in body or not re.search(rb'script\.src = "https?://', body)
    response, body = answer(server, "/0/session.rrd")
    assert body == (folder / "session.rrd").read_bytes()
    response, _ = answer(server, "/")
    assert (response.status, response.headers["Location"]) == (302, server.start)
    assert server.server_address[0] == LOOPBACK


@pytest.mark.parametrize("path", ["/1/session.rrd", "/0/config.json", "/0/../config.json", "/%2e%2e/config.json",
                                  "//etc/passwd", "/0", "/session.rrd", "/favicon.ico"])
def test_there_is_nothing_else(server, path):
    assert answer(server, path)[0].status == 404


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{80}", LOOPBACK, "localhost:1"])
def test_a_page_under_another_name_gets_nothing(server, host):
    assert answer(server, "/0/session.rrd", host)[0].status == 421


def test_what_cannot_be_shown_is_said(folder, tmp_path, capsys, server):
    with pytest.raises(SystemExit) as exit_:
        main(["review", str(tmp_path)])
    assert exit_.value.code == 2
    assert "--no-record" in capsys.readouterr().err
    with pytest.raises(ReviewError, match="listen"):
        Server([], {}, server.server_port)
    torn = shutil.copytree(folder, tmp_path / "torn") / "session.rrd"
    torn.write_bytes(torn.read_bytes()[:-5000])
    assert recordings([torn.parent]) == [torn.resolve()]
    assert "cut its last" in capsys.readouterr().err
    assert recordings([torn]) == [torn.resolve()]
    assert capsys.readouterr().err == ""


@pytest.mark.browser
def test_the_viewer_shows_it_and_asks_no_other_host(server, new_tab):
    """ELBOWROOM_SCREENSHOT=docs/review.png keeps what it looks like, at a time when the arm is touched."""
    tab, asked = new_tab(viewport={"width": 1280, "height": 800}), []
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("console", lambda message: [event.set() for text, event in said.items() if text in message.text])
    said = {"wgpu": (drawn := threading.Event()), "session.rrd has finished": (loaded := threading.Event())}
    tab.goto(server.url, wait_until="commit")
    deadline = time.monotonic() + 120.0
    while not (drawn.is_set() and any(url.endswith("/0/session.rrd") for url in asked)) and time.monotonic() < deadline:
        tab.wait_for_timeout(200)
    if picture := os.environ.get("ELBOWROOM_SCREENSHOT"):
        while not loaded.is_set() and time.monotonic() < deadline:
            tab.wait_for_timeout(200)
        tab.mouse.click(1030, 786)  # near the end of the time line
        tab.mouse.move(640, 20)
        tab.wait_for_timeout(15_000)
        tab.screenshot(path=picture)
    assert drawn.is_set()
    assert {url.split("?")[0] for url in asked} >= {server.url, f"{server.url}0/session.rrd"}
    assert [url for url in asked if not url.startswith((server.url, "data:", "blob:"))] == []
