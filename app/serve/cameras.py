"""The depth cameras in the 3D scene: where each one stands, and the points that they leave of what they see."""

from collections.abc import Sequence

import numpy as np
import viser

from app.serve.sight import MAX_POINTS, Sight, field_of_view, standing
from hrc.cell.eyes import CameraSetup
from hrc.geometry import Array, quaternion_from_rotation
from hrc.messages import Snapshot, View
from hrc.vision.camera import Camera

CLOUD_COLOUR = (64, 196, 255)
LOOKING, SILENT = (120, 130, 140), (255, 59, 48)


class CameraView:
    """A frustum for each camera of the rig, red while it is silent, and one cloud for all of them."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.cloud = server.scene.add_point_cloud(
            "/cloud", np.zeros((1, 3), np.float32), CLOUD_COLOUR, point_size=0.004, point_shape="circle",
            point_shading="flat", visible=False)
        self.show_cloud = self.show_cameras = True
        self._frustums: dict[str, viser.CameraFrustumHandle] = {}
        self._cameras: dict[str, Camera] = {}
        self._stand: dict[str, Array | None] = {}
        self._sights: dict[str, Sight] = {}
        self._drawn: tuple[tuple[str, int], ...] = ()

    def begin(self, rig: Sequence[CameraSetup]) -> None:
        """Draw another rig."""
        for frustum in self._frustums.values():
            frustum.remove()
        self._frustums, self._sights, self._drawn = {}, {}, ()
        self._cameras = {setup.name: Camera(setup.camera) for setup in rig}
        self._stand = dict.fromkeys(self._cameras)
        for i, setup in enumerate(rig):  # numbered: a name may hold a slash, which would nest the node
            camera = self._cameras[setup.name]
            fov, aspect, T = field_of_view(camera)
            self._sights[setup.name] = Sight(camera)
            self._frustums[setup.name] = self._server.scene.add_camera_frustum(
                f"/cameras/{i}", fov=fov, aspect=aspect, scale=0.12, color=LOOKING, thickness=0.003,
                wxyz=quaternion_from_rotation(T[:3, :3]), position=T[:3, 3])
            if len(rig) > 1:
                self._server.scene.add_label(f"/cameras/{i}/name", setup.name, font_screen_scale=0.8)

    def _move(self, frustum: viser.CameraFrustumHandle, view: View) -> None:
        camera = standing(self._cameras[view.camera], view)
        self._sights[view.camera] = Sight(camera)
        frustum.position = camera.T_world_camera[:3, 3]
        frustum.wxyz = quaternion_from_rotation(camera.T_world_camera[:3, :3])

    def update(self, snapshot: Snapshot) -> None:
        """Frustums, and the foreground as perception got it: robot and environment are already taken out."""
        for view in snapshot.views:
            frustum = self._frustums.get(view.camera)
            if frustum is not None:
                frustum.visible, frustum.color = self.show_cameras, SILENT if view.silent else LOOKING
                if self._stand[view.camera] is not view.T_world_camera:
                    self._stand[view.camera] = view.T_world_camera
                    self._move(frustum, view)
        fresh = {view.camera: view.foreground for view in snapshot.views
                 if view.foreground is not None and not view.silent and view.camera in self._sights and self.show_cloud}
        drawn = tuple((camera, foreground.tick) for camera, foreground in fresh.items())
        if drawn == self._drawn:
            return
        self._drawn = drawn
        clouds = [self._sights[camera].points(foreground, MAX_POINTS // len(fresh)) for camera, foreground in fresh.items()]
        points = np.concatenate(clouds) if clouds else np.zeros((0, 3), np.float32)
        with self._server.atomic():
            if len(points):
                self.cloud.points = points
            self.cloud.visible = bool(len(points))
