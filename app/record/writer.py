"""The only caller of the Rerun SDK: writes one session file, from one thread, in blocks.

Blocks of rows go through `send_columns`, which costs a hundredth of a call per value. The SDK keeps references to the
arrays it is given: every array handed over here is fresh and never written again.
"""

import contextlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from app import palette
from app.record import blueprint, columns, entities, png
from app.record.signals import AT, SIGNALS
from hrc import figure, meshes
from hrc.geometry import quaternion_from_rotation
from hrc.messages import LINKS, Body, Clearance, Mode, Nearest
from hrc.scene import BodySpec, Scene
from hrc.vision.camera import Camera

Poses = NDArray[np.float64]
APPLICATION = "elbowroom"
PLOTTED = tuple(s for s in SIGNALS if s.name not in ("tick", "t", "state", "touch_links", "touch_points", "touch_sure"))
"""Signals as curves; the others have entities of their own."""


class SessionWriter:
    """A Rerun recording in a file. Times are ticks of the base rate; `tick_ns` is the length of one."""

    def __init__(self, path: Path, *, tick_ns: int, scene: Scene, cameras: Mapping[str, Camera], parameters: Mapping[str, Any],
                 about: Mapping[str, Any], footer: bool = True) -> None:
        self._tick_ns, self._footer = tick_ns, footer
        self._colours = {body.name: entities.bytes_of(body.rgb) for body in scene.bodies}
        self._present: dict[str, bool] = {}
        self._link = -1
        self._shown: dict[str, Body | BodySpec] = {body.name: body for body in scene.bodies}
        self._state: dict[str, str] = {}
        self._now = dict(parameters)
        # The batcher sees only what is logged singly: a slow tick makes fewer and larger chunks of it.
        batching = rr.ChunkBatcherConfig(flush_tick=0.25)
        self._stream = rr.RecordingStream(APPLICATION, batcher_config=batching)
        self._stream.set_log_time_enabled(False)
        self._about, self._parameters, self._scene, self._cameras = about, parameters, scene, dict(cameras)
        self._layout = blueprint.review(tuple(cameras))
        self._laid_out = b""
        self._stream.set_sinks(self._sink(path), default_blueprint=self._layout)
        self._begin(0)

    def turn_over(self, path: Path, tick: int) -> None:
        """Finish the file, and go on in another that can be looked at alone, or together with the others."""
        # As a file that was made once: of each blueprint that it is handed the SDK keeps 3 MB for good.
        with contextlib.suppress(OSError):  # without room for that the viewer has a layout of its own
            self._laid_out = self._laid_out or blueprint.saved(self._layout, APPLICATION)
        self._stream.set_sinks(self._sink(path))
        if self._laid_out:
            self._stream.log_file_from_contents(f"layout{blueprint.SUFFIX}", self._laid_out)
        self._begin(tick)
        for entity, state in self._state.items():
            self._stream.log(entity, rr.StateChange(state=state))

    def _sink(self, path: Path) -> rr.FileSink:
        return rr.FileSink(os.fspath(path), write_footer=self._footer)

    def _begin(self, tick: int) -> None:
        self._at(tick)
        self._log_session(self._parameters, self._about)
        self._log_scene(self._scene)
        for name, camera in self._cameras.items():
            self._log_camera(name, camera)
        self._log_styles()

    def set(self, key: str, value: Any) -> None:
        """A parameter has changed; None: all are again as at the start."""
        self._now = {**self._now, key: value} if value is not None else dict(self._parameters)

    def rows(self, rows: NDArray[np.float64], periods: NDArray[np.float64]) -> None:
        """Signals of consecutive control ticks, shape (n, WIDTH), and the contact they hold.

        periods: wall time from the control tick before to each [s], shape (n,).
        """
        ticks = rows[:, AT["tick"]][:, 0].astype(np.int64)
        index = self._index(ticks)
        curves = {f"{entities.SIGNALS}/{signal.name}": rows[:, AT[signal.name]] for signal in PLOTTED}
        ratio = np.abs(rows[:, AT["residual"]]) / np.asarray(self._now["observer.r_low"])
        curves |= {
            entities.FORCE_PLOT: force_curves(rows[:, AT["force_est"]], rows[:, AT["force_true"]], self._now),
            entities.PERIOD_PLOT: 1e3 * periods, entities.RESIDUAL_PLOT: np.column_stack([ratio, np.ones(len(ratio))])}
        # A curve has a gap where there is nothing.
        finite = [np.where(np.isinf(values), np.nan, values) for values in curves.values()]
        for entity, column in zip(curves, columns.scalars(finite), strict=True):
            self._stream.send_columns(entity, index, [column])
        self._point(entities.REFERENCE, index, rows[:, AT["ee_desired"]])
        for name, point, force in (("est", entities.POINT_EST, entities.FORCE_EST),
                                   ("true", entities.POINT_TRUE, entities.FORCE_TRUE)):
            points, forces = rows[:, AT[f"contact_point_{name}"]], rows[:, AT[f"force_{name}"]]
            self._point(point, index, points)
            self._arrow(force, index, points, forces)
        self._tint(ticks, rows[:, AT["contact_link_est"]][:, 0].astype(int))

    def poses(self, ticks: Sequence[int], T_world_link: Sequence[Poses], nearest: Sequence[Poses | None],
              pulls: Sequence[tuple[Poses, Poses] | None]) -> None:
        """Robot, nearest point and pull at some ticks: T_world_link (8, 4, 4) each, points (3,) [m] or None."""
        index = self._index(np.array(ticks, np.int64))
        T = np.array(T_world_link)
        self._transforms({f"{entities.ROBOT}/{name}": (index, T[:, link]) for link, name in enumerate(LINKS)})
        self._point(entities.NEAREST, index, np.array([np.full(3, np.nan) if p is None else p for p in nearest]))
        held = np.array([pull is not None for pull in pulls])
        strips = [np.array(pull, np.float32) for pull in pulls if pull is not None]
        self._stream.send_columns(entities.PULL, index,
                                  rr.LineStrips3D.columns(strips=strips).partition(held.astype(int)))

    def distances(self, ticks: Sequence[int], clearances: Sequence[tuple[Clearance, ...]],
                  touches: Sequence[tuple[Nearest, ...]]) -> None:
        """The lines from links to obstacles, and the places of touch, at the same ticks."""
        index = self._index(np.array(ticks, np.int64))
        every = [c for some in clearances for c in some]
        strips = np.array([(c.p_robot, c.p_obstacle) for c in every], np.float32).reshape(-1, 2, 3)
        lines = rr.LineStrips3D.columns(strips=list(strips), colors=palette.by_distance([c.distance for c in every]))
        self._stream.send_columns(entities.DISTANCES, index, lines.partition([len(some) for some in clearances]))
        found = [touch for some in touches for touch in some]
        points = np.array([touch.p_world for touch in found], np.float32).reshape(-1, 3)
        colours = np.array([palette.TOUCH if touch.sure else palette.UNSURE for touch in found], np.uint8).reshape(-1, 3)
        balls = rr.Points3D.columns(positions=points, colors=colours)
        self._stream.send_columns(entities.TOUCHES, index, balls.partition([len(some) for some in touches]))

    def bodies(self, ticks: Sequence[int], bodies: Sequence[tuple[Body, ...]]) -> None:
        """Obstacles at the same ticks; one that comes or goes is drawn or cleared."""
        seen: dict[str, list[tuple[int, Body]]] = {}
        for tick, some in zip(ticks, bodies, strict=True):
            for body in some:
                seen.setdefault(body.name, []).append((tick, body))
        self._transforms({
            f"{entities.OBSTACLES}/{name}": (self._index(np.array([tick for tick, _ in track], np.int64)),
                                             np.array([body.T_world_body for _, body in track]))
            for name, track in seen.items()})
        for name, track in seen.items():
            entity = f"{entities.OBSTACLES}/{name}"
            for tick, body in track:
                if self._present.get(name) is not body.present:
                    self._present[name], self._shown[name] = body.present, body
                    self._at(tick)
                    self._stream.log(entity, self._shape(body, shown=body.present))

    def image(self, camera: str, tick: int, depth: NDArray[np.float32], link: NDArray[np.uint8]) -> None:
        """A camera's depth image [m] with the link ids seen in it, at its exposure."""
        blob = png.encode(png.millimetres(depth))
        self._at(tick)
        self._stream.log(entities.depth(camera), rr.EncodedDepthImage.from_fields(blob=blob))
        self._stream.log(entities.link_ids(camera), rr.SegmentationImage(link))

    def camera(self, tick: int, camera: str, *, silent: bool) -> None:
        """A camera falls silent, or delivers images again."""
        state = entities.SILENT if silent else entities.DELIVERS
        self._at(tick)
        self._change(entities.camera_state(camera), state)
        self._stream.log(entities.EVENTS, rr.TextLog(f"camera {camera} {state}", level="WARN" if silent else "INFO"))

    def place(self, tick: int, camera: str, T_world_camera: Poses) -> None:
        """A camera stands elsewhere (4, 4) from this tick on, as perception knows it."""
        self._cameras[camera] = self._cameras[camera].moved(T_world_camera)
        self._at(tick)
        self._log_pose(camera)

    def mode(self, tick: int, mode: Mode, reason: str) -> None:
        """A transition of the reaction."""
        self._at(tick)
        self._change(entities.STATE, mode.value)
        text = f"-> {mode.value}" + (f": {reason}" if reason else "")
        self._stream.log(entities.EVENTS, rr.TextLog(text, level="WARN" if mode is Mode.STOP else "INFO"))

    def event(self, tick: int, text: str, *, refused: str = "") -> None:
        """An event that was applied, or refused with a reason."""
        self._at(tick)
        log = rr.TextLog(f"{text} refused: {refused}", level="WARN") if refused else rr.TextLog(text, level="DEBUG")
        self._stream.log(entities.EVENTS, log)

    def flush(self) -> None:
        """Block until everything is on the disk. Raises what the SDK raises if that fails."""
        self._stream.flush(timeout_sec=60.0)

    def close(self) -> None:
        """Finish the file."""
        self._stream.disconnect()

    def _change(self, entity: str, state: str) -> None:
        self._state[entity] = state
        self._stream.log(entity, rr.StateChange(state=state))

    def _at(self, tick: int) -> None:
        self._stream.set_time("sim_time", duration=np.timedelta64(tick * self._tick_ns, "ns"))
        self._stream.set_time("step", sequence=tick)

    def _index(self, ticks: NDArray[np.int64]) -> list[rr.TimeColumn]:
        # Whole nanoseconds: a TimeColumn truncates durations given as float seconds.
        return [rr.TimeColumn("sim_time", duration=(ticks * self._tick_ns).astype("timedelta64[ns]")),
                rr.TimeColumn("step", sequence=ticks.copy())]

    def _point(self, entity: str, index: list[rr.TimeColumn], points: Poses) -> None:
        points_there = columns.vectors(rr.Points3D.descriptor_positions(), points, _finite(points))
        self._stream.send_columns(entity, index, [points_there])

    def _arrow(self, entity: str, index: list[rr.TimeColumn], points: Poses, forces: Poses) -> None:
        there = _finite(np.concatenate([points, forces], axis=1))
        vectors = forces * entities.METRES_PER_NEWTON
        self._stream.send_columns(entity, index, [
            columns.vectors(rr.Arrows3D.descriptor_vectors(), vectors, there),
            columns.vectors(rr.Arrows3D.descriptor_origins(), points - vectors, there)])  # the tip touches the robot

    def _transforms(self, tracks: Mapping[str, tuple[list[rr.TimeColumn], Poses]]) -> None:
        if not tracks:
            return
        T = np.concatenate([poses for _, poses in tracks.values()])
        ends = np.cumsum([len(poses) for _, poses in tracks.values()])[:-1]
        # Quaternions: of matrices the SDK makes an object each.
        positions, turns = np.split(T[:, :3, 3], ends), np.split(Rotation.from_matrix(T[:, :3, :3]).as_quat(), ends)
        made = columns.transforms(list(zip(positions, turns, strict=True)))
        for (entity, (index, _)), pair in zip(tracks.items(), made, strict=True):
            self._stream.send_columns(entity, index, pair)

    def _tint(self, ticks: NDArray[np.int64], links: NDArray[np.int64]) -> None:
        for tick, link in zip(ticks.tolist(), links.tolist(), strict=True):
            if link == self._link:
                continue
            self._at(tick)
            for touched, colour in ((self._link, None), (link, entities.TOUCHED)):
                if touched >= 0:
                    self._colour_link(touched, colour)
            self._link = link

    def _colour_link(self, link: int, colour: tuple[int, ...] | None = None) -> None:
        rgb = colour or entities.bytes_of(meshes.COLOURS[link])
        self._stream.log(f"{entities.ROBOT}/{LINKS[link]}", rr.Mesh3D.from_fields(albedo_factor=[*rgb, 255]))

    def _shape(self, body: Body | BodySpec, *, shown: bool) -> rr.Boxes3D | rr.Ellipsoids3D | rr.Capsules3D:
        colour = [self._colours.get(body.name, (224, 172, 140))]
        if body.shape == "sphere":
            half = [(body.size[0],) * 3] if shown else []
            return rr.Ellipsoids3D(half_sizes=half, colors=colour, fill_mode="solid")
        if body.shape == "capsule":
            radius, half_length = body.size
            return rr.Capsules3D(lengths=[2.0 * half_length] if shown else [], radii=[radius] if shown else [],
                                 translations=[(0.0, 0.0, -half_length)] if shown else [], colors=colour, fill_mode="solid")
        if body.shape == "figure":
            return _capsules(figure.parts(*body.size) if shown else (), colour)
        return rr.Boxes3D(half_sizes=[body.size] if shown else [], colors=colour, fill_mode="solid")

    def _log_session(self, parameters: Mapping[str, Any], about: Mapping[str, Any]) -> None:
        self._stream.send_recording_name(" ".join(str(about[key]) for key in ("scenario", "seed") if key in about))
        values = {key: value if isinstance(value, (bool, int, float, str)) else json.dumps(value)
                  for key, value in {**about, **parameters}.items()}
        self._stream.send_property("session", rr.AnyValues(drop_untyped_nones=True, **values))
        lines = [f"| `{key}` | {value} |" for key, value in parameters.items()]
        text = "\n".join(["| parameter | at the start |", "|---|---|", *lines])
        self._log_static(entities.PARAMETERS, rr.TextDocument(text, media_type="text/markdown"))

    def _log_scene(self, scene: Scene) -> None:
        self._log_static(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for box in scene.environment:
            shape = rr.Boxes3D(centers=[box.centre], half_sizes=[box.half], colors=[entities.bytes_of(box.rgb)],
                               fill_mode="solid")
            self._log_static(f"{entities.ENVIRONMENT}/{box.name}", shape)
        for link, (name, mesh) in enumerate(zip(LINKS, meshes.robot("perception"), strict=True)):
            shape = rr.Mesh3D(vertex_positions=mesh.vertices, triangle_indices=mesh.faces, vertex_normals=mesh.normals)
            self._log_static(f"{entities.ROBOT}/{name}", shape)
            # Not static: static data would hide the red of a touched link.
            self._colour_link(link, entities.TOUCHED if link == self._link else None)
        for name, body in self._shown.items():
            self._stream.log(f"{entities.OBSTACLES}/{name}", self._shape(body, shown=self._present.get(name, False)))
        self._log_static(entities.CAMERAS, rr.AnnotationContext(list(entities.LINK_CLASSES)))

    def _log_camera(self, name: str, camera: Camera) -> None:
        c, entity = camera.config, entities.camera(name)
        self._log_pose(name)
        K = [[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]]
        self._log_static(entity, rr.Pinhole(
            image_from_camera=K, resolution=[c.width, c.height], camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.25))
        self._log_static(entities.depth(name), rr.EncodedDepthImage.from_fields(
            media_type="image/png", meter=1000.0, colormap="viridis", depth_range=[500.0, 4500.0],
            point_fill_ratio=0.5))
        self._log_static(entities.camera_state(name), states(entities.CAMERA_COLOURS))

    def _log_pose(self, camera: str) -> None:
        T = self._cameras[camera].T_world_camera
        # Not static: static data would hide where it is moved to.
        self._stream.log(entities.camera(camera), rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))

    def _log_styles(self) -> None:
        for entity, colour, radius in (
                (entities.POINT_EST, entities.ESTIMATE, 0.016), (entities.POINT_TRUE, entities.TRUTH, 0.012),
                (entities.NEAREST, entities.SIGHT, 0.010), (entities.REFERENCE, (255, 255, 255), 0.008)):
            self._log_static(entity, rr.Points3D.from_fields(colors=[colour], radii=[radius]))
        for entity, colour in ((entities.FORCE_EST, entities.ESTIMATE), (entities.FORCE_TRUE, entities.TRUTH)):
            self._log_static(entity, rr.Arrows3D.from_fields(colors=[colour], radii=[0.008]))
        self._log_static(entities.PULL, rr.LineStrips3D.from_fields(colors=[(255, 220, 80)], radii=[0.004]))
        self._log_static(entities.DISTANCES, rr.LineStrips3D.from_fields(radii=[0.0025]))
        self._log_static(entities.TOUCHES, rr.Points3D.from_fields(radii=[0.014]))
        for signal in PLOTTED:
            self._log_static(f"{entities.SIGNALS}/{signal.name}", series(signal.name, signal.width))
        self._log_static(entities.FORCE_PLOT, force_styles("|F| estimated", "|F| true"))
        self._log_static(entities.RESIDUAL_PLOT, rr.SeriesLines.from_fields(
            names=[*(f"joint {joint}" for joint in range(1, 8)), "detection"], colors=[*entities.JOINTS, entities.TOUCHED],
            widths=[1.2] * 8))
        period = rr.SeriesLines.from_fields(names=["period"], colors=[entities.SIGHT], widths=[1.2])
        self._log_static(entities.PERIOD_PLOT, period)
        self._log_static(entities.STATE, states({mode.value: colour for mode, colour in entities.MODES.items()}))

    def _log_static(self, entity: str, archetype: Any) -> None:
        self._stream.log(entity, archetype, static=True)


def _capsules(parts: Sequence[figure.Part], colour: Sequence[Any]) -> rr.Capsules3D:
    """A sphere is a capsule without length; each begins at its lower end."""
    lengths = [2.0 * sum(part.size[1:]) for part in parts]
    begins = [part.T_figure_part[:3, 3] - 0.5 * length * part.T_figure_part[:3, 2]
              for part, length in zip(parts, lengths, strict=True)]
    turns = [rr.Quaternion(xyzw=np.roll(quaternion_from_rotation(part.T_figure_part[:3, :3]), -1)) for part in parts]
    return rr.Capsules3D(lengths=lengths, radii=[part.size[0] for part in parts], translations=begins, quaternions=turns,
                         colors=colour, fill_mode="solid")


def _finite(rows: Poses) -> NDArray[np.bool_]:
    """Which rows are drawn: an empty one clears what was drawn before."""
    return np.logical_and.reduce(np.isfinite(rows), axis=1)


def states(colours: Mapping[str, palette.Colour]) -> rr.StateConfiguration:
    """How a state timeline looks."""
    names = list(colours)
    return rr.StateConfiguration(values=names, labels=names, colors=[(*colour, 255) for colour in colours.values()])


def force_curves(estimate: Poses, truth: Poses, parameters: Mapping[str, Any]) -> Poses:
    """|F| estimated and true, F_relax and F_abort [N], shape (n, 4)."""
    thresholds = [np.full(len(estimate), parameters[key]) for key in ("control.f_relax", "control.f_abort")]
    return np.column_stack([np.linalg.norm(estimate, axis=1), np.linalg.norm(truth, axis=1), *thresholds])


def force_styles(estimate: str, truth: str, suffix: str = "") -> rr.SeriesLines:
    """How these four look."""
    colours = [entities.ESTIMATE, entities.TRUTH, entities.F_RELAX, entities.F_ABORT]
    return rr.SeriesLines(names=[estimate, truth, "F_relax" + suffix, "F_abort" + suffix], widths=[1.6, 1.6, 1.0, 1.0],
                          colors=[entities.dimmed(colour) for colour in colours] if suffix else colours)


def series(name: str, width: int, suffix: str = "") -> rr.SeriesLines:
    """How the curves of a signal look; those with a suffix are fainter."""
    single = palette.LINKS[int(name[-1])] if name.startswith("clearance_") else entities.SIGHT
    curves = {7: entities.JOINTS, 3: entities.AXES, 1: (single,)}[width]
    axes = {7: [f" {joint}" for joint in range(1, 8)], 3: [" x", " y", " z"], 1: [""]}[width]
    secondary = bool(suffix) or name.endswith(("_true", "_desired", "_command"))
    colours = [entities.dimmed(colour) if secondary else colour for colour in curves]
    return rr.SeriesLines(names=[name + axis + suffix for axis in axes], colors=colours, widths=[1.2] * width)
