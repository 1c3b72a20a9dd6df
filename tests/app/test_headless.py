"""A short real run, and the laws that its files and figures obey."""

import itertools
import json

import numpy as np
import pytest

from app import metrics, output
from app.headless import Job, execute
from app.record.signals import SIGNALS, digest, read_parquet, write_parquet
from hrc.config import Config
from hrc.errors import HrcError
from hrc.events import from_dict
from hrc.messages import Mode
from hrc.parameters import keys

SECONDS = 4.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    figures = execute(Job("push", out, seed=3, duration=SECONDS, quiet=True))
    return out, figures, read_parquet(out / "signals.parquet")


def test_the_folder_holds_everything_and_its_metrics_are_what_was_returned(run):
    out, figures, _ = run
    assert {path.name for path in out.iterdir()} == {
        "session.rrd", "signals.parquet", "metrics.json", "config.json", "events.jsonl", "robot.parquet",
        "exposures.parquet", "figure.png"}
    assert json.loads((out / "metrics.json").read_text()) == json.loads(json.dumps(figures))
    assert not figures["interrupted"]
    assert figures["recording_problem"] == ""
    for name, size in figures["sizes_bytes"].items():
        assert (out / name).stat().st_size == size > 0


def test_there_is_one_row_for_every_control_tick(run):
    _, figures, columns = run
    hz = Config().rates.control_hz
    assert columns["t"].size == figures["counts"]["control_ticks"] == SECONDS * hz
    np.testing.assert_allclose(np.diff(columns["t"]), 1.0 / hz, atol=1e-12)


def test_columns_survive_the_file_bit_for_bit_and_carry_their_units(run, tmp_path):
    import pyarrow.parquet as pq

    out, figures, columns = run
    write_parquet(tmp_path / "again.parquet", columns)
    again = read_parquet(tmp_path / "again.parquet")
    for name, values in columns.items():
        assert values.dtype == again[name].dtype
        assert values.tobytes() == again[name].tobytes()
    assert digest(columns) == figures["signals_sha256"]
    schema = pq.read_schema(out / "signals.parquet")
    told = {field.name: tuple(field.metadata[key].decode() for key in (b"unit", b"frame")) for field in schema}
    assert told == {s.name: (s.unit, s.frame) for s in SIGNALS}
    assert told["force_est"] == ("N", "world")


def test_one_seed_gives_the_same_bits_recorded_or_not_and_another_seed_does_not(run, tmp_path):
    _, figures, _ = run
    same = execute(Job("push", tmp_path / "same", seed=3, duration=SECONDS, record=False, quiet=True))
    assert same["signals_sha256"] == figures["signals_sha256"]
    assert same["everything_finite"]
    assert not (tmp_path / "same" / "session.rrd").exists()
    other = execute(Job("push", tmp_path / "other", seed=4, duration=0.5, record=False, quiet=True))
    start = read_parquet(tmp_path / "other" / "signals.parquet")
    again = read_parquet(tmp_path / "same" / "signals.parquet")
    assert other["seed"] == 4
    assert not np.array_equal(start["tau"], again["tau"][: start["tau"].shape[0]])


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: s.name)
def test_the_hash_sees_the_smallest_change_of_any_column(run, signal):
    _, figures, columns = run
    changed = dict(columns)
    changed[signal.name] = columns[signal.name].copy()
    changed[signal.name].view(np.uint8).reshape(-1)[-1] ^= 1
    assert digest(changed) != figures["signals_sha256"]


def write_half(out, error, **options):
    with output.folder(out, **options) as folder:
        (folder / "half").write_text("half")
        raise error


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    out = tmp_path / "deep" / "out"
    with pytest.raises(HrcError, match="half way"):
        write_half(out, HrcError("half way"))
    assert list(out.parent.iterdir()) == []
    with output.folder(out) as folder:
        (folder / output.MARK).write_text("{}")
        assert not out.exists()
    with pytest.raises(HrcError, match="half way"):
        write_half(out, HrcError("half way"), overwrite=True)
    assert [path.name for path in out.iterdir()] == [output.MARK]
    with output.folder(out, overwrite=True) as folder:
        (folder / "b").write_text("b")
    assert [path.name for path in out.iterdir()] == ["b"]


def test_what_a_bug_leaves_behind_is_kept_as_evidence(tmp_path):
    with pytest.raises(ZeroDivisionError) as caught:
        write_half(tmp_path / "out", ZeroDivisionError())
    (folder,) = tmp_path.iterdir()
    assert (folder / "half").exists()
    assert str(folder) in caught.value.__notes__[0]


def test_figures_follow_from_the_table_read_back(run):
    _, figures, columns = run
    again = json.loads(json.dumps(metrics.compute(columns)))
    assert {name: json.loads(json.dumps(figures[name])) for name in again} == again


def test_states_tile_the_run_and_the_push_makes_the_arm_relax(run):
    _, figures, columns = run
    spans = figures["states"]
    assert spans[0][0] == columns["t"][0]
    assert spans[-1][1] == columns["t"][-1]
    assert all(a[1] == b[0] and a[2] != b[2] for a, b in itertools.pairwise(spans))
    assert Mode.RELAX in {mode for *_, mode in spans}
    assert sum(figures["ticks_by_state"].values()) == columns["t"].size


def test_config_and_events_can_be_read_back(run):
    out, figures, _ = run
    saved = json.loads((out / "config.json").read_text())
    assert saved["seed"] == 3
    assert list(saved["parameters"]) == list(keys(Config()))
    lines = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    assert len(lines) == figures["counts"]["events"] > 0
    for line in lines:
        from_dict(line["event"])


def test_an_earlier_run_is_replaced_only_when_asked_and_only_by_a_run_that_ends(run):
    out, figures, _ = run
    with pytest.raises(HrcError, match="overwrite"):
        execute(Job("free", out, quiet=True))
    with pytest.raises(HrcError, match="device"):
        execute(Job("free", out, device="cuda:77", overwrite=True, quiet=True))
    assert json.loads((out / "metrics.json").read_text())["signals_sha256"] == figures["signals_sha256"]


def _columns(state, error, force_est=(10.0, 0.0, 0.0)):
    n = len(state)
    columns = {s.name: np.zeros((n, s.width) if s.width > 1 else n) for s in SIGNALS}
    columns |= {"t": np.arange(n) * 0.5, "state": np.array(state), "contact_visible": np.ones(n, bool),
                "contact_link_est": np.full(n, 5), "contact_link_true": np.full(n, 5)}
    columns["ee"][:, 0] = error
    columns["force_true"][:, 0] = 10.0
    columns["force_est"][:] = force_est
    return columns


def test_the_error_after_an_abort_does_not_count_for_two_seconds():
    columns = _columns(["relax", "abort", *["relax"] * 6], [1.0, 9, 8, 8, 8, 8, 2, 3])
    assert metrics.compute(columns)["ee_error"]["relax"] == {"ticks": 3, "max_m": 3.0, "rms_m": (14 / 3) ** 0.5}


def test_after_a_reset_the_clock_goes_on_and_no_figure_looks_across_it():
    columns = _columns(["idle", "abort", "idle", *["idle"] * 6, "abort"], [0.0, 0, 9, 9, 9, 1, 1, 1, 1, 0])
    columns["t"] = np.array([0.0, 0.5, 1.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0])  # set back to the very time that it was
    columns["dq"][:, 0] = [0.0] * 3 + [9.0] * 7
    figures = metrics.compute(columns)
    assert figures["states"] == [[0.0, 0.5, "idle"], [0.5, 1.0, "abort"], [1.0, 5.0, "idle"], [5.0, 5.0, "abort"]]
    assert figures["aborts"] == [0.5, 5.0]
    assert figures["ee_error"]["idle"]["max_m"] == 1.0
    assert figures["ddq_measured_max"] == 0.0


def test_a_figure_of_what_is_not_finite_is_none_for_json_has_no_such_number():
    columns = _columns(["idle"] * 3, 0.0)
    columns["dq"][1] = columns["ee"][1] = np.nan
    figures = metrics.compute(columns)
    assert figures["ddq_measured_max"] is figures["ee_error"]["idle"]["max_m"] is None
    json.dumps(figures, allow_nan=False)


def test_a_contact_nobody_located_counts_as_a_wrong_link():
    columns = _columns(["relax"] * 4, 0.0, force_est=(13.0, 4.0, 0.0))
    columns["contact_link_est"][:2] = -1
    columns["contact_point_est"][:, 1] = 0.03
    figures = metrics.compute(columns)
    assert figures["localisation"]["right_link"] == 0.5
    assert figures["localisation"]["right_link_of_estimates"] == 1.0
    assert figures["localisation"]["median_point_error_m"] == 0.03
    assert figures["force"]["links_4_to_7"] == {"ticks": 2, "median_error_N": 5.0, "median_relative_error": 0.5}
    columns["contact_visible"][:] = False
    assert metrics.compute(columns)["localisation"]["right_link"] is None


def test_a_value_that_is_not_finite_is_found():
    columns = _columns(["idle"] * 3, 0.0)
    assert metrics.compute(columns)["everything_finite"]
    columns["contact_link_est"][1] = -1
    columns["force_est"][1] = np.nan  # no contact, no estimate
    assert metrics.compute(columns)["everything_finite"]
    columns["tau"][2, 6] = np.inf
    assert not metrics.compute(columns)["everything_finite"]
