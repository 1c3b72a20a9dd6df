"""A session runs again, bit for bit, from its config, seed and events alone; and with other parameters it is looked at anew."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from app import metrics, open_loop
from app.__main__ import main
from app.headless import versions
from app.open_loop import Job, execute
from app.output import OutputError
from app.record.folder import EventLog, SessionError, read, write
from app.record.signals import SignalTable, digest, read_parquet, write_parquet
from app.replay import again, exact
from hrc.cell import pace
from hrc.cell.cell import Cell
from hrc.cell.run import Inbox, run
from hrc.config import PRESETS, harsh
from hrc.errors import ConfigError
from hrc.events import (
    MoveCamera,
    MoveObstacle,
    Press,
    Pull,
    Push,
    Release,
    RemoveObstacle,
    Reset,
    Resume,
    SetParameter,
    Stop,
    from_dict,
)
from hrc.messages import Truth
from hrc.parameters import assembled, keys
from hrc.sim.robot import SimulatedRobot

POINT = (0.0, 0.0, 0.0)
PRESS = Press("hand", 3, (0.0, 0.0, -0.07), (0.0, 1.0, 0.0), speed=0.3, depth=0.12, hold=1.0, stiffness=300.0, approach=0.3)
HANDS_ON = {  # by the number of ticks since the session began: at two Resets the cell's own ticks begin anew
    30: [SetParameter("control.f_relax", 6.5), SetParameter("vision.margin", 0.02), MoveObstacle("ball", (-0.5, 0.4, 0.5))],
    100: [PRESS], 333: [RemoveObstacle("nobody"), SetParameter("control.no_such", 1.0)],
    200: [MoveObstacle("slab", (-0.25, -0.6, 0.35))], 210: [MoveObstacle("slab", (-0.3, -0.5, 0.35), (0.6, 0.0, 0.8, 0.0))],
    650: [MoveCamera("camera", (-0.4, 1.9, 0.9), (-0.3, 0.0, 0.4))],
    700: [Stop("enough"), Resume()], 1301: [SetParameter("push.cap", 40.0), Pull(6, POINT, (-0.4, 0.3, 0.5)), Reset(), PRESS],
    1302: [SetParameter("sensor.noise", 2.0), MoveCamera("camera", (0.3, -1.2, 2.0), (-0.3, 0.0, 0.4))],
    1650: [Pull(5, POINT, (-0.6, 0.4, 0.7))],
    1777: [Pull(5, POINT, (-0.6, 0.5, 0.7))],
    1900: [Release(), Push(4, POINT, (0.0, 25.0, 0.0))], 2107: [Reset(), Reset()], 2200: [Push(6, POINT, (0.0, 0.0, -20.0))]}


class Hands:
    """Somebody at the page: puts events into the inbox, at ticks that no script knows of."""

    def __init__(self, inbox):
        self.inbox, self.steps = inbox, 0

    def on_step(self, _):
        self.steps += 1
        for event in HANDS_ON.get(self.steps, ()):
            self.inbox.put(event)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An interactive session on a robot in a bad state, with everything that a page can send."""
    cell, inbox, table, log = Cell(harsh().replace(seed=7)), Inbox(), SignalTable(), EventLog()
    config, hands = cell.config, Hands(inbox)
    run(cell, pace.FreeRun(7), inbox, [table, log, hands], until=10**9, stopped=lambda: hands.steps >= 2500)
    folder = tmp_path_factory.mktemp("session")
    write(folder, config, {"scenario": "free", "device": "cpu", **versions()}, table.columns(), log.lines())
    return folder


def test_an_interactive_session_runs_again_bit_for_bit(folder):
    columns = read_parquet(folder / "signals.parquet")
    assert (columns["contact_link_est"] >= 0).sum() > 50, "it was worth it"
    assert (np.diff(columns["tick"]) < 0).sum() == 2
    assert exact(folder) == (f"identical, 0 differing ticks of {len(columns['tick'])}", True)


def test_the_figures_of_a_session_with_resets_run_forward(folder):
    columns = read_parquet(folder / "signals.parquet")
    assert (np.diff(columns["t"]) <= 0).any()
    spans = metrics.compute(columns)["states"]
    assert all(start < end for start, end, _ in spans[:-1])
    assert spans[-1][1] == pytest.approx(2.5, abs=0.015), "Resets come between control ticks"


def test_the_log_says_when_and_why_not(folder):
    lines = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert [line["event"].get("key", line["event"].get("name")) for line in lines if "refused" in line] \
        == ["nobody", "control.no_such"]
    resets = [i for i, line in enumerate(lines) if line["event"]["type"] == "Reset"]
    assert [lines[i]["tick"] for i in resets] == [1301, 806], "the ticks that were left behind"
    assert lines[resets[0] + 1] == {"tick": 0, "event": lines[resets[0] + 1]["event"]}


def test_an_hour_of_dragging_is_kept_whole_in_little_memory():
    """As many events as twenty a second make in half a minute, of which one in nine is refused; a copy goes on by itself."""
    snapshot, whole = Cell().step(), EventLog()
    half = None
    for i in range(600):
        if i == 301:
            half = EventLog(whole)
        pull = Pull(6, POINT, (-0.4, 0.3, 0.5 + i / 7000))
        fields = {"refused": ((pull, 'not "refused" here'),)} if i % 9 == 0 else {"events": (pull,)}
        for log in filter(None, (whole, half)):
            log.on_step(dataclasses.replace(snapshot, tick=50 * i + 1, **fields))
    assert half is not None
    assert half.lines() == whole.lines()
    values = [json.loads(line) for line in whole.lines()]
    assert [value["tick"] for value in values] == [50 * i for i in range(600)]
    assert [from_dict(value["event"]) for value in values] == [Pull(6, POINT, (-0.4, 0.3, 0.5 + i / 7000)) for i in range(600)]
    assert (whole.taken, whole.refused) == (533, 67)
    assert whole.refusals() == ['Pull: not "refused" here'] * 67
    assert sum(map(len, whole._packed)) < 60 * 600


def copied(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copy")


def test_one_bit_is_found_with_its_tick_and_signal(folder, tmp_path):
    copy = copied(folder, tmp_path)
    columns = {name: np.array(values) for name, values in read_parquet(copy / "signals.parquet").items()}
    tick = columns["tick"][200]
    columns["residual"][200, 3] = np.nextafter(columns["residual"][200, 3], 9.0)
    columns["state"][210] = "stop"
    write_parquet(copy / "signals.parquet", columns)
    verdict, identical = exact(copy)
    assert not identical
    assert verdict == f"2 of {len(columns['tick'])} control ticks differ, first tick {tick}: residual"


def test_a_lost_event_is_found_and_the_command_says_so_with_its_exit_code(folder, tmp_path, capsys):
    copy = copied(folder, tmp_path)
    lines = (copy / "events.jsonl").read_text().splitlines()
    (copy / "events.jsonl").write_text("\n".join(line for line in lines if '"Push"' not in line))
    about = json.loads((copy / "config.json").read_text()) | {"numpy": "0.1"}
    (copy / "config.json").write_text(json.dumps(about))
    with pytest.raises(SystemExit) as exit_:
        main(["replay", str(copy), "--exact"])
    assert exit_.value.code == 1
    told = capsys.readouterr().out
    assert "control ticks differ" in told
    assert "numpy 0.1" in told


def test_open_loop_without_a_change_gives_every_bit_again(folder):
    replay = execute(Job(folder))
    assert replay.changed is None
    assert digest(replay.columns) == digest(read_parquet(folder / "signals.parquet"))
    assert replay.figures == replay.recorded


def test_open_loop_with_a_change_moves_the_robot_as_before_and_decides_anew(folder, tmp_path):
    out = tmp_path / "out"
    replay = execute(Job(folder, ("control.f_relax=12", "vision.margin=0.03"), out))
    recorded, columns = read_parquet(folder / "signals.parquet"), read_parquet(out / "signals.parquet")
    for name in ("q", "dq", "tau", "residual", "force_true", "contact_link_true"):
        np.testing.assert_array_equal(columns[name], recorded[name])
    assert (columns["state"] == "relax").sum() < (recorded["state"] == "relax").sum()
    assert not np.array_equal(columns["clearance_5"], recorded["clearance_5"])
    figures = json.loads((out / "metrics.json").read_text())
    assert figures["changes"] == {"control.f_relax": 12, "vision.margin": 0.03}
    assert figures["signals_sha256"] == metrics.compute(columns)["signals_sha256"] == digest(replay.columns)
    assert json.loads((out / "config.json").read_text())["parameters"]["control.f_relax"] == 12, "nor does an event change it"
    with pytest.raises(SessionError, match="is a replay"):
        exact(out)


def test_the_truth_does_not_reach_the_estimator_in_a_replay(folder, monkeypatch):
    recorded = read_parquet(folder / "signals.parquet")
    lie = Truth(np.full(3, 99.0), np.zeros(3), 1, np.full(7, 9.0))
    monkeypatch.setattr(SimulatedRobot, "truth", lambda _: lie)
    verdict, _ = exact(folder)
    assert verdict.endswith(f"first tick {recorded['tick'][0]}: force_true, contact_point_true, contact_link_true")
    session = read(folder)
    columns = again(Cell(session.config), session)
    told = {name for name, values in recorded.items() if values.tobytes() != columns[name].tobytes()}
    assert told <= {"force_true", "contact_point_true", "contact_link_true", "contact_visible"}


@pytest.mark.parametrize("preset", PRESETS)
def test_a_config_survives_its_file(preset):
    config = PRESETS[preset]()
    assert assembled(PRESETS["default"](), json.loads(json.dumps(keys(config)))) == config


def test_what_is_no_session_is_refused_in_a_line(folder, tmp_path, capsys):
    def refusal(*args):
        with pytest.raises(SystemExit) as exit_:
            main(["replay", *map(str, args)])
        assert exit_.value.code == 2
        return capsys.readouterr().err

    assert "has no config.json" in refusal(tmp_path, "--exact")
    assert "changes and writes nothing" in refusal(folder, "--exact", "--set", "control.f_abort=30")
    assert "did you mean control.f_abort" in refusal(folder, "--set", "control.f_abrot=30")
    assert "what it is" in refusal(folder, "--set", "sensor.noise=0.5")
    assert "150" in refusal(folder, "--set", "control.f_abort=1e9")
    copy = copied(folder, tmp_path)
    saved = json.loads((copy / "config.json").read_text())
    del saved["parameters"]["vision.margin"]
    (copy / "config.json").write_text(json.dumps(saved))
    assert "of another version" in refusal(copy, "--exact")
    (copy / "config.json").write_text("{")
    assert "parameters" in refusal(copy, "--exact")
    shutil.copy(folder / "config.json", copy)
    lines = (folder / "events.jsonl").read_text().splitlines()
    (copy / "events.jsonl").write_text("\n".join(lines[::-1]))
    with pytest.raises(SessionError, match="cannot follow"):
        read(copy)
    (copy / "events.jsonl").write_text('{"tick": 3, "event": {"type": "Pusch"}}')
    with pytest.raises(SessionError, match=r"line 1.*Push"):
        read(copy)
    (copy / "events.jsonl").write_text("")
    (copy / "signals.parquet").write_bytes(b"PAR1 no table")
    with pytest.raises(SessionError, match="cannot be read"):
        read(copy)


@pytest.mark.parametrize("out", ["copy", "copy/new", "link/new", "link/../copy", ".", "new/../copy"])
def test_a_replay_does_not_take_the_place_of_what_it_replays(folder, tmp_path, out):
    copy = copied(folder, tmp_path)
    (tmp_path / "link").symlink_to(copy)
    (tmp_path / "config.json").write_text("{}")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OutputError, match="is not apart from"):
        execute(Job(copy, ("control.f_relax=12",), tmp_path / out, overwrite=True))
    assert sorted(tmp_path.rglob("*")) == before


def test_where_nothing_can_be_written_is_said_before_the_work(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(open_loop, "again", None)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is no folder"):
        execute(Job(folder, ("control.f_relax=12",), tmp_path / "file" / "deep" / "out"))


def test_nor_of_a_killed_run_under_its_hidden_name(folder, tmp_path):
    hidden = shutil.copytree(folder, tmp_path / ".out.partial")
    with pytest.raises(OutputError, match="is not apart from"):
        execute(Job(hidden, ("control.f_relax=12",), tmp_path / "out"))
    assert (hidden / "signals.parquet").is_file()


def test_an_unknown_parameter_in_a_config_is_named():
    with pytest.raises(ConfigError, match="f_abort"):
        assembled(harsh(), {**keys(harsh()), "control.f_abrt": 1.0})
