"""The 3D mirror of a snapshot: robot, environment, obstacles, and the path of the tool."""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from hrc import meshes
from hrc.geometry import Array, quaternion_from_rotation
from hrc.messages import LINKS, Body, Snapshot
from hrc.scene import Scene

EYE, TARGET = (1.9, 0.7, 1.1), (-0.2, 0.0, 0.45)
"""The first view, from the depth sensor's side: what the screen shows, the sensor can see."""
VIEWS = {"Sensor": (EYE, TARGET), "Side": ((-0.3, 2.3, 0.9), (-0.25, 0.0, 0.45)),
         "Top": ((-0.29, 0.0, 2.9), (-0.3, 0.0, 0.3))}
TRAIL_COLOUR = (255, 214, 102)
SKIN = (0.93, 0.72, 0.60)
TRAIL_POINTS, TRAIL_STEP, TRAIL_GAP = 160, 0.006, 0.2
"""Points of the drawn path of the tool; the least distance between two, and the largest that is joined [m]."""
SKY, GROUND = (255, 255, 255), (120, 120, 130)
"""Colours of the light from above and from below."""
DIM = 0.5
"""Brightness of the environment: what matters stands before it."""


class SceneView:
    """Scene nodes that follow the snapshots. `shown` holds the link poses (8, 4, 4) that browsers have now."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.shown: Array = np.tile(np.eye(4), (8, 1, 1))
        server.initial_camera.position, server.initial_camera.look_at = EYE, TARGET
        server.initial_camera.fov = 0.75
        server.scene.configure_default_lights(cast_shadow=False)
        # viser's picture of a warehouse as a light takes a browser without a GPU six seconds to prepare, and a third of each
        # picture thereafter.
        server.scene.configure_environment_map(hdri=None)
        server.scene.add_light_hemisphere("/sky", sky_color=SKY, ground_color=GROUND, intensity=2.5, position=(0.0, 0.0, 1.0))
        parts = [meshes.shaded(mesh) for mesh in meshes.robot("perception")]
        self.links = [
            server.scene.add_mesh_simple(f"/robot/{name}", mesh.vertices, mesh.faces, color=_rgb(colour))
            for name, mesh, colour in zip(LINKS, parts, meshes.COLOURS, strict=True)]
        self.trail = server.scene.add_line_segments(
            "/trail", np.zeros((1, 2, 3), np.float32), TRAIL_COLOUR, thickness=0.004, visible=False)
        self._path: deque[Array] = deque(maxlen=TRAIL_POINTS)
        self.bodies: dict[str, Any] = {}
        self._poses: dict[str, bytes] = {}
        self._environment: list[Any] = []
        self._colours: dict[str, Sequence[float]] = {}
        self.show_trail = True

    def begin(self, scene: Scene) -> None:
        """Another cell: its environment; obstacles are drawn when they are first seen; nothing left of the one before."""
        for node in (*self._environment, *self.bodies.values()):
            node.remove()
        self.bodies.clear()
        self._poses.clear()
        self._path.clear()
        self._colours = {spec.name: spec.rgb for spec in scene.bodies}
        self._environment = []
        for box in scene.environment:
            x, y, z = (2.0 * half for half in box.half)
            colour = _rgb([DIM * channel for channel in box.rgb])
            self._environment.append(
                self._server.scene.add_box(f"/environment/{box.name}", colour, (x, y, z), position=box.centre))

    def look(self, client: viser.ClientHandle, view: str) -> None:
        """Move one browser's view."""
        position, look_at = VIEWS[view]
        with client.atomic():
            client.camera.position, client.camera.look_at = position, look_at

    def update_poses(self, snapshot: Snapshot) -> None:
        """Robot and obstacles where they are."""
        self._create(snapshot.bodies)
        placed = [(node, T, True) for node, T in zip(self.links, snapshot.T_world_link, strict=True)]
        placed += [(self.bodies[body.name], body.T_world_body, body.present) for body in snapshot.bodies]
        with self._server.atomic():
            for node, T, present in placed:
                node.visible = present
                if present and self._poses.get(node.name) != (pose := T.tobytes()):  # most obstacles stand still
                    self._poses[node.name] = pose
                    node.position, node.wxyz = T[:3, 3], quaternion_from_rotation(T[:3, :3])
        self.shown = snapshot.T_world_link

    def follow(self, snapshot: Snapshot) -> None:
        """Remember where the tool is."""
        x = snapshot.command.x
        moved = float(np.linalg.norm(x - self._path[-1])) if self._path else np.inf
        if moved > TRAIL_GAP:  # nobody was looking for a while: do not draw a line across
            self._path.clear()
        if moved > TRAIL_STEP:
            self._path.append(x)

    def update_trail(self) -> None:
        """The path the tool took."""
        line = np.array(self._path, np.float32)
        with self._server.atomic():
            self.trail.visible = self.show_trail and len(line) > 1
            if self.trail.visible:
                self.trail.points = np.stack([line[:-1], line[1:]], axis=1)

    def forget_trail(self) -> None:
        """Start the path anew, after a jump in time."""
        self._path.clear()

    def _create(self, bodies: Sequence[Body]) -> None:
        for body in bodies:
            if body.name in self.bodies:
                continue
            name, colour = f"/obstacles/{body.name}", _rgb(self._colours.get(body.name, SKIN))
            if body.shape == "sphere":
                node = self._server.scene.add_icosphere(name, body.size[0], colour, opacity=0.85, visible=False)
            elif body.shape == "box":
                x, y, z = (2.0 * half for half in body.size)
                node = self._server.scene.add_box(name, colour, (x, y, z), opacity=0.85, visible=False)
            else:
                mesh = meshes.shape(body.shape, body.size)
                node = self._server.scene.add_mesh_simple(name, mesh.vertices, mesh.faces, color=colour, opacity=0.85,
                                                          visible=False)
            self.bodies[body.name] = node


def _rgb(colour: Sequence[float]) -> tuple[int, int, int]:
    r, g, b = (round(255 * c) for c in colour)
    return r, g, b
