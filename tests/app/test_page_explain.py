"""What the page explains and lets one tune, over its wire protocol: numbers, the chosen link, parameters, settings files."""

import re
import uuid
from typing import Any

import numpy as np
import pytest
from target import Target
from test_page_protocol import ELBOW, number, pull
from vclient import VClient, until

from app.serve import demo
from app.serve.demo import Demo
from app.serve.inputs import fine_step
from app.serve.mailbox import Mailbox
from app.serve.main import Page
from app.serve.session import Session
from app.settings import changed, configured, read, sift, written
from hrc.cell.cell import Cell
from hrc.config import Config, literal
from hrc.errors import ConfigError
from hrc.messages import Snapshot
from hrc.parameters import field_of, keys

LIVE = [key for key in keys(Config()) if field_of(Config(), key).metadata["live"]]


def numbers(client: VClient) -> str:
    """The block of numbers. Raises KeyError before there is one."""
    for widget in list(client.gui.values()):
        content = str(widget.get("props", {}).get("content", ""))
        if 'id="eb-numbers"' in content:
            return content
    raise KeyError("numbers")


def pair(client: VClient, name: str) -> str:
    """What stands beside a name among the numbers."""
    found = re.search(rf"<span>{re.escape(name)}</span><b>(.*?)</b>", numbers(client))
    if found is None:
        raise KeyError(name)
    return found[1]


def click(client: VClient, node: str) -> None:
    client.send({"type": "SceneNodeClickMessage", "name": node, "instance_index": None, "ray_origin": [2.0, 0.0, 1.0],
                 "ray_direction": [-1.0, 0.0, 0.0], "screen_pos": [0.5, 0.5], "modifier": None, "owner": ""})


def upload(client: VClient, text: str) -> None:
    """Hand in a settings file, as the browser does."""
    transfer, source, content = str(uuid.uuid4()), client.widget("Load settings"), text.encode()
    client.send({"type": "FileTransferStartUpload", "source_component_uuid": source, "transfer_uuid": transfer,
                 "filename": "mine.toml", "mime_type": "", "part_count": 1, "size_bytes": len(content)})
    client.send({"type": "FileTransferPart", "source_component_uuid": source, "transfer_uuid": transfer, "part_index": 0,
                 "content": content})


def test_numbers_show_a_push_in_residual_force_and_conditioning(raw: VClient) -> None:
    until(lambda: pair(raw, "Smallest singular value of J_c") == "-")
    point = pull(raw, 0.2)
    until(lambda: 'class="over"' in numbers(raw) and pair(raw, "Smallest singular value of J_c").endswith(" m"))
    assert float(pair(raw, "Force not felt below").split()[0]) > 0.5
    raw.drag(ELBOW, "end", point, point)
    until(lambda: 'class="over"' not in numbers(raw) and pair(raw, "Smallest singular value of J_c") == "-")
    until(lambda: all(f'data-stage="{stage}"' in numbers(raw) for stage in ("robot", "camera", "localize", "control")))


def test_a_click_chooses_a_link_and_does_not_push(raw: VClient) -> None:
    until(lambda: numbers(raw))
    plain = raw.nodes["/robot/link_2"]["color"]
    click(raw, "/robot/link_2")
    until(lambda: 'data-link="link_2"' in numbers(raw) and sum(raw.nodes["/robot/link_2"]["color"]) > sum(plain))
    click(raw, "/robot/link_6")
    until(lambda: 'data-link="link_6"' in numbers(raw) and raw.nodes["/robot/link_2"]["color"] == plain)
    assert number(raw, "truth") == 0.0
    raw.set("Simulation", "Pause")
    until(lambda: raw.banner()["paused"] == "true")
    beat = int(raw.banner()["beat"])
    until(lambda: int(raw.banner()["beat"]) > beat + 3)
    shown = np.array(re.findall(r"-?\d+\.\d+", pair(raw, "Origin")), float)
    np.testing.assert_allclose(shown, raw.position("/robot/link_6"), atol=0.006)


def test_every_live_parameter_has_its_widget_with_its_meaning(raw: VClient) -> None:
    made = {(widget["props"]["label"], widget["props"]["hint"])
            for widget in list(raw.gui.values()) if "hint" in widget.get("props", {}) and "label" in widget["props"]}
    config = Config()
    for key in LIVE:
        group, name = key.split(".")
        meta, value = field_of(config, key).metadata, keys(config)[key]
        unit = f" [{meta['unit']}]" if meta["unit"] else ""
        labels = [f"{name} {i}{unit}" for i in range(1, len(value) + 1)] if isinstance(value, tuple) else [f"{name}{unit}"]
        for label in labels:
            assert (label, getattr(config, group).docs()[name]) in made, key


def test_a_slider_shows_what_it_holds() -> None:
    for key in LIVE:
        meta, value = field_of(Config(), key).metadata, keys(Config())[key]
        if isinstance(value, bool) or not isinstance(value, (float, tuple)):
            continue
        for x in value if isinstance(value, tuple) else (value,):
            step = fine_step(meta["low"], meta["high"], x)
            steps = (x - meta["low"]) / step
            assert abs(steps - round(steps)) < 1e-6 * max(1.0, steps), f"{key} = {x} lies between two steps of {step}"
            assert (meta["high"] - meta["low"]) / step >= 99.0


def test_one_number_of_several_is_changed_and_all_go_back_to_default(raw: VClient) -> None:
    r_low = Config().observer.r_low
    raw.set("r_low 3 [N m]", 2.0)
    until(lambda: f"observer.r_low = {(*r_low[:2], 2.0, *r_low[3:])}" in raw.text())
    raw.set("f_abort [N]", 60.0)
    raw.set("f_relax [N]", 40.0)  # more than the default of f_abort: one has to wait for the other on the way back
    until(lambda: raw.value("F_relax [N]") == 40.0)
    raw.click("Reset to default")
    until(lambda: raw.value("F_relax [N]") == Config().control.f_relax and raw.value("f_abort [N]") == Config().control.f_abort
          and raw.value("r_low 3 [N m]") == r_low[2])


def test_a_settings_file_is_taken(raw: VClient) -> None:
    upload(raw, written(Config().replace(control=Config().control.replace(k_p=7.0, law="printed"))))
    until(lambda: raw.value("k_p [1/s]") == 7.0 and raw.value("law") == "printed")
    until(lambda: "mine.toml: 2 parameters changed" in raw.text())
    raw.click("Reset to default")
    until(lambda: raw.value("k_p [1/s]") == 10.0 and raw.value("law") == "latched")


def test_of_an_old_settings_file_the_rest_is_taken_after_asking(raw: VClient) -> None:
    upload(raw, "control.k_p = 6.0\ncontrol.k_old = 3.0\nrates.control_hz = 100\npush.cap = 1000.0\n")
    until(lambda: raw.gui[raw.widget("Apply the other one")]["props"]["visible"])
    for named in ("control.k_old", "rates.control_hz = 100 needs a new start", "push.cap: cap must be"):
        assert named in raw.text()
    assert raw.value("k_p [1/s]") == 10.0
    raw.click("Apply the other one")
    until(lambda: raw.value("k_p [1/s]") == 6.0)
    raw.click("Reset to default")
    until(lambda: raw.value("k_p [1/s]") == 10.0)


def test_who_has_lost_the_seat_can_still_close_the_question_and_changes_nothing(served: Page, raw: VClient) -> None:
    upload(raw, "control.k_p = 6.0\ncontrol.k_old = 3.0\n")
    until(lambda: raw.gui[raw.widget("Apply the other one")]["props"]["visible"])
    other = VClient(served.server.get_port())
    until(lambda: other.ready.is_set() and other.seat())
    raw.hand_back()
    other.click("Take control")
    until(other.drives)
    refused = served.guard.refused["not the operator"]
    raw.click("Apply the other one")
    raw.set("k_p [1/s]", 8.0)  # comes after it
    until(lambda: served.guard.refused["not the operator"] > refused)
    assert served.guard.refused["not the operator"] == refused + 1, "the answer was let in"
    until(lambda: other.value("k_p [1/s]") == 10.0)
    other.close()


@pytest.mark.parametrize("text", ["control = [", "\x00", "<html>"])
def test_a_file_that_holds_no_settings_is_named_in_the_log(raw: VClient, text: str) -> None:
    upload(raw, text)
    until(lambda: "mine.toml is no settings file" in raw.text())


@pytest.mark.parametrize("change", [
    {"size_bytes": 10**9}, {"part_count": 1000}, {"part_count": 0}, {"source_component_uuid": "nothing"}, {"filename": 3}])
def test_an_upload_that_the_page_does_not_offer_is_not_let_in(served: Page, raw: VClient, change: dict[str, Any]) -> None:
    refused = served.guard.refused.total()
    raw.send({"type": "FileTransferStartUpload", "source_component_uuid": raw.widget("Load settings"),
              "transfer_uuid": "t", "filename": "a.toml", "mime_type": "", "part_count": 1, "size_bytes": 10, **change})
    until(lambda: served.guard.refused.total() > refused)


def test_nobody_uploads_to_another_widget(served: Page, raw: VClient) -> None:
    refused = served.guard.refused.total()
    raw.send({"type": "FileTransferStartUpload", "source_component_uuid": raw.widget("Resume"), "transfer_uuid": "t",
              "filename": "a.toml", "mime_type": "", "part_count": 1, "size_bytes": 10})
    until(lambda: served.guard.refused.total() > refused)


def test_what_is_saved_is_what_the_command_line_reads(tmp_path: Any) -> None:
    higher = changed(Config(), [("control.f_relax", 40.0), ("control.f_abort", 60.0)])
    for config in (Config(), literal(), Config(seed=3, scene='a "b"\\c'), higher):
        file = tmp_path / "saved.toml"
        file.write_text(written(config), encoding="utf-8")
        assert changed(Config(), read(file)) == config
        assert configured(file=file) == config
    file.write_text("control.f_relax = 40.0\ncontrol.nothing = 1\nvision.margin = 9.0\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"saved\.toml: .*f_relax.*control\.nothing.*vision\.margin"):
        read(file)


def test_a_file_is_sifted() -> None:
    found = sift("control.f_relax = 40.0\ncontrol.f_abort = 60.0\ncontrol.k_p = 10.0\n[nothing]\na = 1\n", Config())
    assert found.changes == (("control.f_abort", 60.0), ("control.f_relax", 40.0)), "in an order in which each is valid"
    assert [line.split('"')[1] for line in found.trouble] == ["nothing.a"]


def test_a_demo_that_is_ended_while_it_goes_on_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    target, session = Target(guarded=False), Session(Mailbox(), say=lambda _: None)
    shown = Demo(target.server, session, lambda _: None)
    shown.add()

    def ended(_: Snapshot) -> bool:
        shown.toggle()  # as the sockets' thread may, in the midst of an update
        return True

    monkeypatch.setattr(demo, "STEPS", (demo.Step("one", ended, least=0.0), demo.Step("two", lambda _: False)))
    snapshot = Cell().step()
    shown.toggle()
    shown.begin()
    assert shown._caption.visible
    shown.update(snapshot)
    shown.update(snapshot)
    assert not shown._caption.visible
    session.scenario = "push"  # somebody has opened another since
    shown.toggle()
    shown.begin()
    assert shown._caption.visible, "it can be started again"
    target.server.stop()


def test_the_demo_tells_what_happens(raw: VClient) -> None:
    told: dict[str, set[str]] = {}

    def caption() -> str:
        for widget in list(raw.gui.values()):
            props = widget.get("props", {})
            if 'class="eb-caption"' in str(props.get("content", "")) and props.get("visible"):
                step = re.search(r'data-step="(\d)"', props["content"])
                told.setdefault(step[1] if step else "", set()).add(raw.banner()["mode"])
                return props["content"]
        return ""

    raw.set("Scenario", "push")
    until(lambda: raw.banner()["mode"] == "relax")
    raw.click("Guided demo")
    until(lambda: "draws a hexagon" in caption())
    assert raw.value("Scenario") == "free", "the one that the demo has opened"
    raw.set("Speed", 2.0)
    until(lambda: "drag a link" in caption(), 90.0)
    assert list(told) == list("1234567")
    assert "relax" in told["3"]
    assert "abort" in told["5"]
    assert "idle" in told["6"]
    raw.set("Simulation", "Reset")
    until(lambda: not caption())
    raw.set("Speed", 1.0)
