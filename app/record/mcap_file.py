"""`elbowroom export`: a session as an MCAP file with Foxglove's messages, made of signals.parquet and what stands beside it."""

import heapq
import os
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.output import OutputError
from app.record import foxglove as fox
from app.record.clock import Clock
from app.record.folder import Session, files
from app.record.tape import ROBOT, read_tape
from hrc import meshes
from hrc.cell.eyes import rig
from hrc.events import MoveCamera, Reset, SetParameter, to_dict
from hrc.geometry import look_at
from hrc.messages import LINKS, Body
from hrc.model import Dynamics, load_spec, pinocchio_model
from hrc.scene import load_scene
from hrc.vision.camera import Camera

TF, SCENE, OBSTACLES, CONTACT, LOG, SIGNALS, CAMERA = (
    "/tf", "/scene", "/obstacles", "/contact", "/log", "/signals", "/cameras/{}")
POSE_EVERY = 4
"""Poses and contacts are given at every fourth control tick (50 Hz), signals at each."""
ESTIMATE, TRUTH = (1.0, 0.35, 0.24), (0.31, 0.86, 0.47)
METRES_PER_NEWTON = 0.01
Said = tuple[int, str, str, dict[str, Any]]
"""Time [ns], topic, schema, message."""


def export(session: Session, path: Path) -> int:
    """Write the session to `path`; how many messages. Raises OutputError if that cannot be."""
    from mcap.writer import Writer  # here, because it is an extra

    if path.exists():
        raise OutputError(f"{path} exists; choose another")
    partial, count = path.with_name(f".{path.name}.partial"), 0
    try:
        with partial.open("wb") as file:
            writer, channels = Writer(file), dict[str, int]()
            writer.start()
            writer.add_metadata("session", {key: str(value) for key, value in session.about.items()})
            known = {name: writer.register_schema(name, "jsonschema", fox.encoded({"title": name, **schema}))
                     for name, schema in fox.SCHEMAS.items()}
            for ns, topic, schema, message in messages(session):
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "json", known[schema])
                writer.add_message(channels[topic], ns, fox.encoded(message), ns)
                count += 1
            writer.finish()
        os.replace(partial, path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from None
    finally:
        partial.unlink(missing_ok=True)
    return count


def messages(session: Session) -> Iterator[Said]:
    """Everything that the session has, in order of time."""
    clock, ns = Clock(session), 1_000_000_000 // session.config.rates.base_hz
    scene = load_scene(session.config.scene)
    cameras = {setup.name: Camera(setup.camera) for setup in rig(session.config, scene)}
    begin = int(clock.rows[0]) * ns
    still = [
        (begin, SCENE, "foxglove.SceneUpdate", fox.scene([
            *(fox.entity(begin, box.name, cubes=fox.solid(_at(box.centre), 2.0 * np.array(box.half), box.rgb))
              for box in scene.environment),
            *(fox.entity(begin, name, name, triangles=fox.triangles(mesh, rgb))
              for name, mesh, rgb in zip(LINKS, meshes.robot("perception"), meshes.COLOURS, strict=True))]))]
    streams = [still, _cameras(clock, cameras, ns), _signals(session, clock, ns), _robot(session, clock, ns),
               _contact(session, clock, ns), _log(session, clock, ns), _obstacles(session, ns)]
    streams += [_images(session, name, camera, ns) for name, camera in cameras.items()]
    return heapq.merge(*streams, key=itemgetter(0))


def _cameras(clock: Clock, cameras: dict[str, Camera], ns: int) -> Iterator[Said]:
    """Where they stand: at the beginning, and whenever one is moved."""
    home = {name: camera.T_world_camera for name, camera in cameras.items()}
    poses, begin = dict(home), int(clock.rows[0])
    for _, event in clock.before:
        poses |= _moved(event, home)
    yield begin * ns, TF, "foxglove.FrameTransforms", fox.transforms(begin * ns, poses)
    last = begin * ns
    for tick, event in clock.events:
        if moved := {name: T for name, T in _moved(event, home).items() if T is not poses[name]}:
            at = max(tick, begin) * ns
            # The old pose again just before: between two of them, readers interpolate.
            if at > last:
                yield at - 1, TF, "foxglove.FrameTransforms", fox.transforms(at - 1, {name: poses[name] for name in moved})
            yield at, TF, "foxglove.FrameTransforms", fox.transforms(at, moved)
            poses, last = poses | moved, at


def _moved(event: Any, home: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """The poses that an event gives to cameras."""
    if isinstance(event, MoveCamera):
        return {event.name: look_at(event.eye, event.target)}
    return home if isinstance(event, Reset) else {}


def _signals(session: Session, clock: Clock, ns: int) -> Iterator[Said]:
    for row, tick in enumerate(clock.rows.tolist()):
        yield tick * ns, SIGNALS, "elbowroom.Signals", fox.signals(session.columns, row)


def _robot(session: Session, clock: Clock, ns: int) -> Iterator[Said]:
    robot = Dynamics(pinocchio_model(load_spec().compile(), armature=False))
    for tick, q in zip(clock.rows[::POSE_EVERY].tolist(), session.columns["q"][::POSE_EVERY], strict=True):
        poses = dict[str, NDArray[np.float64]](zip(LINKS, robot.kinematics(q)[0], strict=True))
        yield tick * ns, TF, "foxglove.FrameTransforms", fox.transforms(tick * ns, poses)


def _contact(session: Session, clock: Clock, ns: int) -> Iterator[Said]:
    c, there = session.columns, set[str]()
    for row in range(0, len(clock.rows), POSE_EVERY):
        time = int(clock.rows[row]) * ns
        forces = {name: (c[f"contact_point_{name}"][row], c[f"force_{name}"][row], rgb)
                  for name, rgb in (("est", ESTIMATE), ("true", TRUTH))}
        seen = {name: fox.entity(time, name, arrows=fox.arrow(point, METRES_PER_NEWTON * force, rgb))
                for name, (point, force, rgb) in forces.items() if np.isfinite([*point, *force]).all()}
        if seen or there:
            yield time, CONTACT, "foxglove.SceneUpdate", fox.scene(list(seen.values()), time, sorted(there - set(seen)))
        there = set(seen)


def _log(session: Session, clock: Clock, ns: int) -> Iterator[Said]:
    mode = session.columns["state"]
    changed = np.flatnonzero(np.r_[True, mode[1:] != mode[:-1]])
    lines = [(int(clock.rows[i]), fox.WARNING if mode[i] == "stop" else fox.INFO, f"-> {mode[i]}") for i in changed]
    lines += [(max(tick, int(clock.rows[0])), fox.INFO if isinstance(event, (SetParameter, Reset)) else fox.DEBUG,
               " ".join(f"{value}" if key == "type" else f"{key}={value}" for key, value in to_dict(event).items()
                        if value is not None)) for tick, event in clock.events]
    for tick, level, text in sorted(lines, key=itemgetter(0)):
        yield tick * ns, LOG, "foxglove.Log", fox.log(tick * ns, level, text)


def _obstacles(session: Session, ns: int) -> Iterator[Said]:
    """As they stood before the cameras; only a run keeps them."""
    if not (session.folder / ROBOT).is_file():
        return
    scene, there = load_scene(session.config.scene), set[str]()
    colours = {body.name: body.rgb for body in scene.bodies}
    for step, (_, bodies) in read_tape(session.folder, session.columns, scene).exposed.items():
        time = (step + 1) * ns
        seen = {body.name: fox.entity(time, body.name, **_shape(body, colours.get(body.name, (0.93, 0.72, 0.60))))
                for body in bodies if body.present}
        if seen or there:
            yield time, OBSTACLES, "foxglove.SceneUpdate", fox.scene(list(seen.values()), time, sorted(there - set(seen)))
        there = set(seen)


def _shape(body: Body, rgb: tuple[float, ...]) -> dict[str, Any]:
    if body.shape == "box":
        return {"cubes": fox.solid(body.T_world_body, 2.0 * np.array(body.size), rgb)}
    if body.shape == "sphere":
        return {"spheres": fox.solid(body.T_world_body, [2.0 * body.size[0]] * 3, rgb)}
    return {"triangles": fox.triangles(meshes.shape(body.shape, body.size), rgb, body.T_world_body)}


def _images(session: Session, name: str, camera: Camera, ns: int) -> Iterator[Said]:
    if not (recordings := files(session.folder)):
        return
    from app.record import png
    from app.record.images import blobs  # here, because rerun takes half a second and is an extra

    topic = CAMERA.format(name)
    for step, blob in blobs(recordings, name):
        yield step * ns, f"{topic}/calibration", "foxglove.CameraCalibration", fox.calibration(step * ns, name, camera)
        yield step * ns, f"{topic}/depth", "foxglove.RawImage", fox.image(step * ns, name, png.decode(blob))


def _at(centre: Any) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, 3] = centre
    return T
