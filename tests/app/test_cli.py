"""The command line: quick help, and one clear line with exit code 2 for what the user can put right."""

import os
import signal
import subprocess
import sys
import time

import pytest
from process import launched

from app.__main__ import main
from app.settings import configured, parse, table
from hrc.cell import scenario
from hrc.config import Config
from hrc.errors import ConfigError
from hrc.parameters import keys


def refusal(capsys, *args):
    with pytest.raises(SystemExit) as exit_:
        main([str(arg) for arg in args])
    assert exit_.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    return [line for line in lines if line.startswith("elbowroom: ")]


@pytest.mark.parametrize(("args", "told"), [
    (["papr"], "paper"),
    (["push", "--set", "control.f_abrt=30"], "control.f_abort"),
    (["push", "--set", "control.f_abort"], "key=value"),
    (["push", "--set", "control.f_abort="], "key=value"),
    (["push", "--set", "control.f_abort=3 0"], "malformed value"),
    (["push", "--set", "control.f_abort=nan"], "150"),
    (["push", "--set", "control.f_abort=1e9"], "150"),
    (["push", "--set", "control.f_abort=true"], "number"),
    (["push", "--set", "control.law=latchd"], "latched"),
    (["push", "--preset", "papr"], "paper"),
    (["push", "--seed", "-1"], "seed"),
    (["push", "--duration", "nan"], "duration"),
    (["push", "--duration", "-1"], "duration"),
    (["push", "--duration", "inf"], "duration"),
    (["missing.toml"], "missing.toml"),
])
def test_bad_input_is_one_line_that_says_what_would_be_right_and_leaves_nothing(tmp_path, capsys, args, told):
    lines = refusal(capsys, "run", *args, "--out", tmp_path / "out")
    assert len(lines) == 1
    assert told in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_a_malformed_scenario_file_is_refused_with_its_line(tmp_path, capsys):
    file = tmp_path / "mine.toml"
    file.write_text('title = "Mine"\nduration = 2.0\n\n[[event]]\nt = 1.0\ntype = "Pusch"\n')
    (line,) = refusal(capsys, "run", file, "--out", tmp_path / "out")
    assert "line 4" in line
    assert "Push" in line
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


def test_an_existing_folder_is_refused_and_a_strangers_folder_even_with_overwrite(tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    assert "--overwrite" in refusal(capsys, "run", "free", "--out", out)[0]
    assert "earlier run" in refusal(capsys, "run", "free", "--out", out, "--overwrite")[0]
    assert (out / "thesis.txt").read_text() == "years of work"
    assert "output folder" in refusal(capsys, "run", "free", "--out", out / "thesis.txt", "--overwrite")[0]


def test_settings_are_toml_values_and_bare_words():
    assert parse("a.b=30") == ("a.b", 30)
    assert parse(" a.b = -1.5e-2 ") == ("a.b", -0.015)
    assert parse("a=true") == ("a", True)
    assert parse("a=[1, 2.5]") == ("a", [1, 2.5])
    assert parse('a="x=y"') == ("a", "x=y")
    assert parse("a=paper") == ("a", "paper")
    with pytest.raises(ConfigError, match="malformed"):
        parse("a=1\nb=2")


def test_a_setting_beats_the_scenario_and_the_preset():
    assert configured("paper").control.k_f == 0.05
    assert configured("paper", scenario.load("push"), ["control.k_f=0.03"], 7).control.k_f == 0.03
    assert configured(seed=7).seed == 7


def test_every_parameter_is_listed_with_its_meaning():
    lines = table(Config()).splitlines()
    assert [line.split()[0] for line in lines] == list(keys(Config()))
    assert any("camera.eye" in line and "[2.2, 0, 0.75]" in line and "optical centre" in line for line in lines)


def test_scenarios_are_listed(capsys):
    main(["scenarios"])
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == scenario.names()


@pytest.mark.parametrize("args", [["--help"], ["run", "--help"], ["serve", "--help"]])
def test_help_loads_no_engine(args):
    code = ("import sys\nfrom app.__main__ import main\ntry:\n    main(sys.argv[1:])\nexcept SystemExit as e:\n"
            "    assert not e.code\nheavy = {'warp', 'mujoco', 'pinocchio', 'rerun', 'viser'} & set(sys.modules)\n"
            "sys.exit(f'loaded {heavy}' if heavy else 0)")
    done = subprocess.run([sys.executable, "-c", code, *args], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "usage: elbowroom" in done.stdout


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_a_valid_partial_result(tmp_path, number):
    from app.record.signals import read_parquet

    out = tmp_path / "out"
    recording = tmp_path / ".out.partial" / "session.rrd"
    with launched([sys.executable, "-m", "app", "run", "free", "--out", out, "--duration", 600, "--depth", "none"],
                  stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        deadline = time.monotonic() + 120
        while not (recording.exists() and recording.stat().st_size > 1_000_000) and time.monotonic() < deadline:
            time.sleep(0.1)
        process.send_signal(number)
        told, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "interrupted" in told
    assert "Traceback" not in errors
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert 0 < read_parquet(out / "signals.parquet")["t"][-1] < 600
