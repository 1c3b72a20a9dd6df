"""The command line. Each command imports what it needs when it runs, so that --help is quick."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg

from hrc.errors import HrcError

Settings = Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(name="set", metavar="KEY=VALUE")]
SettingsFile = Annotated[Path | None, arg(name="settings", metavar="FILE")]

EXTRAS = {"viser": "page", "websockets": "page", "msgspec": "page", "playwright": "bench", "rerun": "record",
          "pyarrow": "record", "matplotlib": "record", "mcap": "mcap", "distributed": "campaign"}
"""What may not be installed, and the extra that brings it."""

commands = tyro.extras.SubcommandApp()


@commands.command
def serve(scenario: str = "free", host: str = "127.0.0.1", port: int | Literal["auto"] = 8080, device: str = "cpu",
          settings: Settings = (), settings_file: SettingsFile = None, seed: int = 0,
          open_browser: FlagCreatePairsOff[bool] = False, token: str | None = None, view_token: str | None = None,
          allow_host: UseAppendAction[tuple[str, ...]] = (), tls_cert: Path | None = None,
          tls_key: Path | None = None, recordings: Path = Path("recordings"), results: Path | None = None) -> None:
    """Open the cell in the browser: push the arm, drag obstacles into it (the command without a name does this).

    Args:
        scenario: Name of a scenario, or a TOML file.
        host: Address to listen on; on any but this machine's own a visitor needs a token.
        port: Port to listen on; auto takes 8080 or the next that is free.
        device: Compute device of the vision, cpu or cuda:0.
        settings: Parameters to change, as control.f_abort=30.
        settings_file: TOML file of parameters to change, as calibrate writes it; --set goes over it.
        seed: Seed of all noise.
        open_browser: Open the page in the default browser.
        token: What a visitor must know to drive; made and printed where one is needed. Others can see a command line:
            the environment's ELBOWROOM_TOKEN does the same.
        view_token: What a visitor must know to watch only; made and printed with the other, or ELBOWROOM_VIEW_TOKEN.
        allow_host: A further host name of the page, as behind a proxy; can be given again.
        tls_cert: Certificate in PEM, to serve HTTPS.
        tls_key: Its key in PEM, unencrypted.
        recordings: Folder for what is recorded from the page; made with the first.
        results: Folder of a campaign, whose metrics the page can then show on the robot.
    """
    from app.serve import spare
    with spare.prepared():  # it loads beside what follows
        from app.serve.access import Access
        from app.serve.main import serve as start
        from app.settings import parse, read

        access = Access.of(host, port, token=token, view_token=view_token, names=allow_host, tls_cert=tls_cert, tls_key=tls_key)
        changes = [*(read(settings_file) if settings_file else ()), *map(parse, _flat(settings))]
        start(scenario, access, device=device, settings=changes, seed=seed, open_browser=open_browser, recordings=recordings,
              results=results)


@commands.command
def run(scenario: Annotated[Positional[str], arg(metavar="SCENARIO")], out: Path, seed: int = 0,
        duration: float | None = None, settings: Settings = (), preset: str = "default", device: str = "cpu",
        depth: Literal["none", "sampled", "full"] = "sampled", overwrite: FlagCreatePairsOff[bool] = False,
        quiet: FlagCreatePairsOff[bool] = False, no_record: FlagCreatePairsOff[bool] = False,
        settings_file: SettingsFile = None, check: Annotated[str | None, arg(metavar="GATES")] = None) -> None:
    """Run a scenario without a screen and write a folder: recording, signals, metrics, figure.

    Args:
        scenario: Name of a scenario, or a TOML file.
        out: Folder to write; it must not exist.
        seed: Seed of all noise.
        duration: Simulated seconds to run; the scenario's own by default.
        settings: Parameters to change, as control.f_abort=30.
        preset: Values to start from: default; paper, those printed in the paper; literal, its laws to the letter; ideal, a
            robot without noise or model error; harsh, one with more of both; two_cameras.
        device: Compute device of the vision, cpu or cuda:0.
        depth: Depth images to keep in session.rrd: none, sampled (5 a second), full (all).
        overwrite: Replace the folder of an earlier run.
        quiet: Print only the result.
        no_record: Leave session.rrd out.
        settings_file: TOML file of parameters to change, as calibrate writes it; --set goes over it.
        check: Gates that the figures must pass, a TOML file or `paper`; one that does not hold is exit code 1.
    """
    from app import gates
    from app.headless import Job, execute, printed

    bounds = gates.load(check) if check is not None else ()
    job = Job(scenario, out, seed, duration, _flat(settings), preset, device, depth, not no_record, overwrite, quiet,
              settings_file)
    figures = execute(job)
    print("\n".join(printed(figures, out)))
    if figures["recording_problem"]:
        print(f"elbowroom: {figures['recording_problem']}", file=sys.stderr)
    if figures["interrupted"] or figures["recording_problem"]:
        raise SystemExit(130 if figures["interrupted"] else 1)
    verdicts = gates.judge(bounds, figures)
    failed = sum(not verdict.holds for verdict in verdicts)
    if failed:
        print(f"{failed} of {len(verdicts)} gates do not hold:\n{gates.table(verdicts)}")
        raise SystemExit(1)
    if verdicts:
        print(f"all {len(verdicts)} gates hold")


@commands.command
def replay(folder: Annotated[Positional[Path], arg(metavar="FOLDER")], exact: FlagCreatePairsOff[bool] = False,
           settings: Settings = (), out: Path | None = None, device: str | None = None,
           overwrite: FlagCreatePairsOff[bool] = False, depth: Literal["rendered", "recorded"] = "rendered") -> None:
    """Run a recorded session again: exactly, or with other parameters of what sees, feels and decides.

    Args:
        folder: What `run` has written.
        exact: Run robot and all again from config, seed and events, and compare every bit.
        settings: Parameters to change, as vision.margin=0.02; the robot moves as recorded.
        out: Folder to write: signals, metrics, and session.rrd, which `review` lays over the recorded one.
        device: Compute device of the vision, cpu or cuda:0; by default the one of the session.
        overwrite: Replace the folder of an earlier replay.
        depth: Where depth images come from: rendered anew, or recorded, which needs a run with --depth full.
    """
    if exact and (settings or out):
        raise HrcError("an exact replay changes and writes nothing; leave --exact out for one with --set or --out")
    if exact:
        from app.replay import exact as again

        verdict, identical = again(folder, device)
        print(verdict)
        raise SystemExit(0 if identical else 1)
    from app.open_loop import Job, execute, table

    found = execute(Job(folder, _flat(settings), out, device, overwrite, depth))
    print(table(found))
    print(f"{found.changed or 'every bit as recorded'}; at {found.factor:.1f} x real time")
    if found.changed is not None and not settings:
        raise SystemExit(1)


@commands.command
def review(folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="FOLDER")], port: int = 0,
           native: FlagCreatePairsOff[bool] = False, open_browser: FlagCreatePairsOff[bool] = False) -> None:
    """Look at recordings in Rerun's viewer: in the browser, served to this machine alone, or in its own window.

    Args:
        folders: What `run` has written; a replay beside its recording is drawn over it.
        port: Port to listen on; 0 takes a free one.
        native: Open the native viewer.
        open_browser: Open the page in the default browser.
    """
    from app.review import review as show

    if not folders:
        raise HrcError("name a folder that `run` has written")
    show(folders, port=port, in_native=native, open_browser=open_browser)


@commands.command
def report(folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="FOLDER")], out: Path = Path("report.html"),
           overwrite: FlagCreatePairsOff[bool] = False) -> None:
    """Write one HTML page about sessions, with all in it: figures, metrics, parameters, and what differs between them.

    Args:
        folders: What `run` or `replay` has written; the others are compared with the first.
        out: File to write.
        overwrite: Replace the file if it exists.
    """
    from app.session_report import write

    write(folders, out, overwrite=overwrite)
    print(out)


@commands.command
def export(folder: Annotated[Positional[Path], arg(metavar="FOLDER")], out: Annotated[Path, arg(metavar="FILE.mcap")]) -> None:
    """Write a session as an MCAP file, which Foxglove opens: robot, obstacles, contacts, depth images, signals, log.

    Args:
        folder: What `run` has written, or a folder of a recording from the page.
        out: File to write; it must not exist.
    """
    from app.record.mcap_file import export as write
    from app.replay import opened

    print(f"{out}: {write(opened(folder), out)} messages, {out.stat().st_size / 1e6:.1f} MB")


@commands.command
def repair(path: Annotated[Positional[Path], arg(metavar="FOLDER|FILE.rrd")]) -> None:
    """Complete a session whose process was killed, and cut off what a recording has that was not written to the end.

    `replay`, `review`, `report` and `export` do the same by themselves.

    Args:
        path: What `run` was to write, a folder of a recording from the page, or a recording alone.
    """
    from app.record.recover import mend

    done: list[str] = []
    mend(path, done.append)
    print("\n".join(done) or f"{path} is whole; nothing to do")


@commands.command
def compare(scenario: Annotated[Positional[str], arg(metavar="SCENARIO")], out: Path,
            presets: tuple[str, ...] = ("default", "literal"), seed: int = 0, duration: float | None = None,
            settings: Settings = (), overwrite: FlagCreatePairsOff[bool] = False,
            quiet: FlagCreatePairsOff[bool] = False) -> None:
    """Run a scenario with several presets, and show them side by side in one figure and one table.

    Args:
        scenario: Name of a scenario, or a TOML file.
        out: Folder to write; it must not exist.
        presets: Two or more presets; literal is the paper's laws to the letter.
        seed: Seed of all noise.
        duration: Simulated seconds to run; the scenario's own by default.
        settings: Parameters to change in all of them, as control.f_abort=30.
        overwrite: Replace the folder of an earlier comparison.
        quiet: Print only the table.
    """
    from app.compare import Job, execute

    execute(Job(scenario, out, presets, seed, duration, _flat(settings), overwrite, quiet))


@commands.command
def bench(what: Annotated[Positional[Literal["speed", "accuracy", "contact", "yielding", "web", "record", "start"]],
                          arg(metavar="speed|accuracy|contact|yielding|web|record|start")] = "speed",
          json: Annotated[Path | None, arg(metavar="FILE")] = None, device: str = "cpu",
          quick: FlagCreatePairsOff[bool] = False, hours: float = 0.0, settings_file: SettingsFile = None) -> None:
    """Measure on this machine: the speed of perception beside what one would use instead, its accuracy, or what is felt.

    Args:
        what: speed, on one core; accuracy, of the contact point and of the filter; contact: force, delay, false alarms;
            yielding: what relaxing is worth; web: what the page costs, and how quick it is, for one and three clients;
            record: what a recording costs; start: how long it takes to the first page, and to the first motion.
        json: File for all figures with their conditions.
        device: Measured beside the CPU (speed), or used: cpu or cuda:0.
        quick: Few frames or pushes, to see that it works.
        hours: Of free motion with calibrated thresholds (contact); calibrated first if there is no settings file.
        settings_file: TOML file that calibrate wrote (contact).
    """
    from importlib import import_module

    more = {"hours": hours, "settings": settings_file} if what == "contact" else {}
    import_module(f"app.bench.{what}").bench(device=device, json=json, quick=quick, **more)


@commands.command
def campaign(file: Annotated[Positional[str], arg(metavar="FILE")], out: Path, episodes: int | None = None,
             workers: int | None = None, address: str | None = None, tls_ca: Path | None = None, tls_cert: Path | None = None,
             tls_key: Path | None = None, record: int = 0, scaling: FlagCreatePairsOff[bool] = False,
             overwrite: FlagCreatePairsOff[bool] = False, quiet: FlagCreatePairsOff[bool] = False) -> None:
    """Play many short episodes over a grid of parameters, here or on a cluster; what is in the folder is not played again.

    Args:
        file: Name of a campaign, or a TOML file.
        out: Folder for records, tables and the report; one that was begun goes on from there.
        episodes: How many at each point of the sweep; the file's own by default.
        workers: Processes on this machine; one for each core by default.
        address: Scheduler of a cluster, tcp://host:port or tls://host:port, instead.
        tls_ca: Certificate that has signed those of the cluster, in PEM.
        tls_cert: Certificate to show to the cluster.
        tls_key: Its key.
        record: Keep so many of the worst episodes as sessions, for replay, review and report.
        scaling: Measure the rates of one worker and of all, in turns.
        overwrite: Begin anew in a folder that holds a campaign.
        quiet: Print neither progress nor table.
    """
    from app.campaign.cluster import Cluster
    from app.campaign.command import Job, execute

    cluster = Cluster(address, workers, tls_ca, tls_cert, tls_key)
    if execute(Job(file, out, episodes, cluster, record, scaling, overwrite, quiet)):
        raise SystemExit(130)


@commands.command
def soak(hours: float = 1.0, out: Path | None = None, json: Annotated[Path | None, arg(metavar="FILE")] = None, seed: int = 0,
         rotate: float = 5.0, browsers: int = 2) -> None:
    """Serve the page to visitors who come, push, stall and leave at random, and see whether it stays as it was.

    Memory, descriptors, threads, real-time factor and dropped images over time; exit code 1 if they do not hold.

    Args:
        hours: How long.
        out: Folder for the recording, of which the last three files stay; a temporary one by default.
        json: File for all samples.
        seed: Seed of the cell's noise, and of what the visitors do.
        rotate: Minutes that one file of the recording holds, at most 5 and a sixth of the time.
        browsers: Chromiums that watch.
    """
    from app.endurance.soak import Job
    from app.endurance.soak import soak as endure

    if endure(Job(hours, out, json, seed, rotate, browsers)):
        raise SystemExit(1)


@commands.command
def tour(out: Path, film: FlagCreatePairsOff[bool] = False, results: Path | None = None) -> None:
    """Take a picture of every main screen of the page in a headless Chromium, to look at after a change.

    Args:
        out: Folder to write; it must not exist.
        film: Also take an animation of the guided demo, which takes minutes.
        results: Folder of a campaign, for a picture of what it has found.
    """
    from app.tour import tour as take

    take(out, film=film, results=results)


@commands.command
def localize(folder: Annotated[Positional[Path], arg(metavar="FOLDER")], out: Path | None = None, settings: Settings = (),
             device: str = "cpu", overwrite: FlagCreatePairsOff[bool] = False) -> None:
    """Find the contacts in depth images of a real camera, from files; docs/depth_images.md says which.

    Args:
        folder: Folder with camera.toml, joints.csv and the images in depth/.
        out: Table to write, as contacts.csv.
        settings: Parameters of the eye to change, as vision.margin=0.04.
        device: Compute device of the vision, cpu or cuda:0.
        overwrite: Replace the table if it exists.
    """
    from app.localize import Job, execute

    execute(Job(folder, out, _flat(settings), device, overwrite))


@commands.command
def calibrate(out: Path = Path("calibrated.toml"), minutes: float = 20.0, false_alarms_per_hour: float = 0.01, seed: int = 0,
              preset: str = "default", robots: int = 5, plot: Annotated[Path | None, arg(metavar="FILE")] = None) -> None:
    """Move freely, and find the sensors' friction and the thresholds of contact for a rate of false alarms.

    Args:
        out: TOML file to write, for --settings of run and serve.
        minutes: Simulated minutes of free motion, all robots together.
        false_alarms_per_hour: How often free motion may be taken for a contact.
        seed: Seed of the first robot's model error and noise; the others have the next ones.
        preset: Values to start from.
        robots: Robots to move, each with another model error; the thresholds hold for all.
        plot: PNG with the delay of detection against false alarms, for three K_I.
    """
    from app.calibrate import Job, execute

    execute(Job(out, minutes, false_alarms_per_hour, seed, preset, robots, plot=plot))


@commands.command
def scenarios() -> None:
    """List the scenarios."""
    from hrc.cell import scenario

    for name in scenario.names():
        found = scenario.load(name)
        print(f"{name:<12} {found.duration:6.1f} s  {found.title}: {' '.join(found.description.split())}")


@commands.command
def parameters(preset: str = "default") -> None:
    """List every parameter: key, default, range, unit, meaning.

    Args:
        preset: Whose values to list.
    """
    from app.settings import configured, table

    print(table(configured(preset)))


def _flat(settings: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    return tuple(setting for group in settings for setting in group)


def main(args: Sequence[str] | None = None) -> None:
    """Run a command; what the user can put right is one line on stderr and exit code 2."""
    args = list(sys.argv[1:] if args is None else args)
    if not args or (args[0].startswith("-") and args[0] not in ("-h", "--help")):
        args.insert(0, "serve")
    try:
        commands.cli(prog="elbowroom", args=args,
                     description="A robot arm that yields to people. Without a command: serve.")
    except HrcError as error:
        print(f"elbowroom: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(2) from None
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        print(f'elbowroom: this needs {package}; install "elbowroom[{EXTRAS[package]}]"', file=sys.stderr)
        raise SystemExit(2) from None
    except BrokenPipeError:  # whoever read the output has had enough, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        print("elbowroom: interrupted", file=sys.stderr)
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
