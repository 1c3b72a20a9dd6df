"""Recording from the page: what a visitor did with the mouse runs again bit for bit."""

import io
import json
import re
import threading
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mouse import ON_SCREEN, pushed
from playwright.sync_api import expect
from vclient import VClient, until

from app.record.repair import look
from app.replay import exact
from app.serve import download, recordings
from app.serve.access import Access
from app.serve.main import Page
from app.serve.remote import RemoteArchive


def recording(client: VClient) -> bool:
    return 'data-recording="true"' in client.text()


def test_record_stop_list_and_delete_over_the_wire(served: Page, raw: VClient) -> None:
    archive = served.recordings.archive
    raw.set("Images", "none")
    raw.click("Record")
    until(lambda: recording(raw))
    until(lambda: re.search(r"0:0[1-9], [0-9.]+ MB", raw.text()))
    raw.click("End the recording")
    until(lambda: not recording(raw) and archive.names())
    (name,) = archive.names()
    until(lambda: raw.gui[raw.widget("Recording")]["props"]["options"] == [name])
    refused = served.guard.refused.total()
    for value in ("../..", "/etc/passwd", name + "/..", ["x"], None):
        raw.send({"type": "GuiUpdateMessage", "uuid": raw.widget("Recording"), "updates": {"value": value}})
    until(lambda: served.guard.refused.total() == refused + 5)
    raw.click("Delete")
    until(lambda: f"Press Delete once more, and {name} is gone" in raw.text())
    assert archive.names() == [name]
    raw.click("Delete")
    until(lambda: list(archive.root.iterdir()) == [])


def test_what_follows_a_recording_is_about_that_one(served: Page, raw: VClient) -> None:
    archive, made = served.recordings.archive, list[str]()
    raw.set("Images", "none")
    for _ in range(2):
        until(lambda: not raw.gui[raw.widget("Record")]["props"]["disabled"] and not recording(raw))
        raw.click("Record")
        until(lambda: archive.now is not None and archive.now.seconds > 0.1)
        until(lambda: recording(raw) and not raw.gui[raw.widget("End the recording")]["props"]["disabled"])
        raw.click("End the recording")
        until(lambda: archive.now is None and len(archive.names()) > len(made))
        made.append(next(name for name in archive.names() if name not in made))
        until(lambda: raw.value("Recording") == made[-1])
    raw.click("Delete")
    until(lambda: f"{made[1]} is gone" in raw.text())
    raw.set("Recording", made[0])
    raw.click("Delete")
    until(lambda: f"{made[0]} is gone" in raw.text())
    assert len(archive.names()) == 2, "another one was chosen in between: that one is asked about anew"
    raw.click("Delete")
    until(lambda: archive.names() == [made[1]])
    archive.delete(made[1])


def test_a_download_leaves_room_for_the_banner_and_for_stop(served: Page, raw: VClient) -> None:
    big = served.recordings.archive.root / "big.bin"
    big.parent.mkdir(exist_ok=True)
    big.write_bytes(bytes(4_000_000))
    (client,) = (c for c in served.server.get_clients().values() if str(c.client_id) == raw.seat()["visitor"])
    waiting, most = client._websock_connection.get_message_buffer().message_from_id, 0
    download.send(served.server, client, "big.zip", big.open("rb"), 4_000_000)
    while any(thread.name == "download" for thread in threading.enumerate()):
        most = max(most, len(waiting))
    assert 1 <= most <= 5, "one of 31 pieces waits at a time, beside what else this visitor is told"
    until(lambda: raw.banner()["mode"] == "idle")
    big.unlink()


def test_a_cell_that_makes_room_for_another_ends_its_recording_and_says_so(served: Page, raw: VClient) -> None:
    archive = served.recordings.archive
    raw.click("Record")
    until(lambda: archive.now is not None and archive.now.seconds > 0.1)
    raw.set("Scenario", "push")
    until(lambda: "another cell has begun" in raw.text())
    (name,) = archive.names()
    assert look(archive.root / name / "session.rrd").torn == 0
    archive.delete(name)
    raw.set("Scenario", "free")
    until(lambda: raw.banner()["mode"] == "idle")


def test_nothing_is_recorded_while_another_cell_is_built(served: Page, raw: VClient) -> None:
    served.session.open("push")
    raw.click("Record")
    until(lambda: "there is nothing to record" in raw.text())
    until(lambda: raw.banner()["mode"] == "idle")
    assert served.recordings.archive.now is None
    assert served.recordings.archive.names() == []
    raw.set("Scenario", "free")
    until(lambda: raw.banner()["mode"] == "starting")
    until(lambda: raw.banner()["mode"] == "idle")


@pytest.mark.live
def test_the_recorder_is_loaded_when_the_arm_has_been_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[float] = []
    monkeypatch.setattr(recordings, "LOAD_AFTER", 1e9)
    page = Page("free", Access(port=0), say=lambda _: None, recordings=tmp_path / "recordings")
    archive = page.recordings.archive
    assert isinstance(archive, RemoteArchive)
    warm = archive.warm
    monkeypatch.setattr(archive, "warm", lambda: (warm(), loaded.append(page.session.healthy)))
    page.start()
    client = VClient(page.server.get_port())
    try:
        until(lambda: client.ready.is_set() and client.banner()["mode"] == "idle" and client.seat(), 120.0)
        point = client.position("/robot/link_4")
        client.drag("/robot/link_4", "start", point, point)
        client.drag("/robot/link_4", "update", point, point + np.array([0.0, 0.2, 0.0]))
        until(lambda: float(client.banner()["truth"]) > 8.0)
        monkeypatch.setattr(recordings, "LOAD_AFTER", 0.2)
        time.sleep(1.0)
        assert not loaded
        client.drag("/robot/link_4", "end", point, point)
        until(lambda: loaded)
        until(lambda: float(client.banner()["time"]) > 1.0)
        assert loaded == [True]
    finally:
        client.close()
        page.close()


@pytest.mark.browser
def test_a_session_of_pushes_drags_and_sliders_is_recorded_downloaded_and_replayed(served: Page, tab: Any) -> None:
    archive, banner = served.recordings.archive, tab.locator("#eb-banner")
    expect(banner).to_have_attribute("data-mode", "idle")
    tab.get_by_role("tab", name="Record").click()
    tab.get_by_role("button", name="Record", exact=True).click()
    expect(tab.locator("#eb-recording")).to_have_attribute("data-recording", "true")
    assert any(pushed(tab) for _ in range(6))
    tab.mouse.up()
    tab.get_by_role("tab", name="Contact").click()
    slider = tab.locator("label", has_text="F_abort").locator("xpath=ancestor::div[contains(@class,'Flex-root')][1]")
    slider.locator("[role=slider]").focus()
    tab.keyboard.press("ArrowRight")
    x, y = tab.evaluate(ON_SCREEN, ["/obstacles/ball", [0.0, 0.0, 0.0]])
    tab.mouse.move(x, y)
    tab.mouse.down()
    for pixels in range(4, 84, 4):
        tab.mouse.move(x - pixels, y)
    tab.mouse.up()
    tab.get_by_role("tab", name="Record").click()
    tab.get_by_role("button", name="End the recording").click()
    expect(tab.locator("#eb-recording")).to_have_attribute("data-recording", "false")
    until(lambda: archive.names())
    with tab.expect_download() as download:
        tab.get_by_role("button", name="Download").click()
    (name,) = archive.names()
    with zipfile.ZipFile(io.BytesIO(download.value.path().read_bytes())) as packed:
        assert packed.read(f"{name}/config.json") == (archive.folder(name) / "config.json").read_bytes()
    kinds = {json.loads(line)["event"]["type"] for line in (archive.folder(name) / "events.jsonl").read_text().splitlines()}
    assert kinds >= {"Pull", "Release", "SetParameter", "MoveObstacle"}
    tab.context.close()
    served.session.paused = True  # the cores are the replay's
    verdict, identical = exact(archive.folder(name))
    assert identical, verdict
    print(verdict, kinds)
    archive.delete(name)
