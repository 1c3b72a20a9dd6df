"""Calibration of the simulated cell, whole: the file it writes is read again, helps, and bad input is one line."""

import numpy as np
import pytest

from app.__main__ import main
from app.calibrate import Job, execute, quiet, record
from app.settings import configured, read
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import ConfigError, HrcError


def test_a_calibration_takes_friction_away_and_its_file_is_read_again(tmp_path, capsys):
    out = tmp_path / "mine.toml"
    figures = execute(Job(out, minutes=0.5, robots=1, preset="realistic", motions=(("hexagon", 0.2), ("waypoints", 0.1))))
    assert sum(figures["rms_after"]) < 0.8 * sum(figures["rms_before"])
    assert "r_low" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
    config = configured("realistic", file=out)
    assert config.observer.r_low == figures["r_low"]
    np.testing.assert_allclose(config.friction.alpha, figures["friction"].alpha, rtol=1e-5)
    log = record(Cell(quiet(Config())), 2.0)
    plain, taken = log.residual(25.0), log.residual(25.0, config.friction)
    assert np.all(np.abs(taken) < config.observer.r_low)
    assert np.abs(taken).sum() < np.abs(plain).sum()


def test_settings_of_the_command_line_go_over_those_of_the_file(tmp_path):
    file = tmp_path / "some.toml"
    file.write_text("seed = 3\n[control]\nf_abort = 30\n")
    assert configured(file=file).control.f_abort == 30.0
    assert configured(file=file).seed == 3
    assert configured(file=file, settings=["control.f_abort=40"]).control.f_abort == 40.0
    assert configured(file=file, seed=5).seed == 5


@pytest.mark.parametrize(("text", "told"), [
    ("[observer]\nr_lo = [1]", "observer.r_low"), ("[observer]\nr_low = [1, 2]", "observer.r_low"),
    ("[friction]\na = [-1, 0, 0, 0, 0, 0, 0]", "friction.a"), ("[observer\n", "line 1"), (None, "cannot be read")])
def test_a_bad_settings_file_is_one_error_with_file_and_key(tmp_path, text, told, capsys):
    file = tmp_path / "bad.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError, match=r"bad\.toml") as error:
        read(file)
    assert told in str(error.value)
    with pytest.raises(SystemExit) as exit_:
        main(["run", "free", "--out", str(tmp_path / "out"), "--settings", str(file)])
    assert exit_.value.code == 2
    assert "bad.toml" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("changes", "told"), [
    ({"minutes": 0.1}, "minutes"), ({"robots": 0}, "robots"), ({"false_alarms_per_hour": 0.0}, "per hour"),
    ({"preset": "papr"}, "paper"), ({"seed": -1}, "seed")])
def test_what_cannot_be_calibrated_is_refused_before_anything_moves(tmp_path, changes, told):
    with pytest.raises(HrcError, match=told):
        execute(Job(tmp_path / "mine.toml", **changes))
    with pytest.raises(HrcError, match=r"\.toml"):
        execute(Job(tmp_path / "mine.txt"))
    assert list(tmp_path.iterdir()) == []
