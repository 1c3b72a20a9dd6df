"""Virtual depth images of the robot as one gets them elsewhere: from MuJoCo's renderer, and from Open3D's ray caster."""

import ctypes
import importlib
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from app.bench.window import corners, rectangle
from hrc import meshes
from hrc.errors import HrcError
from hrc.geometry import Array
from hrc.vision.camera import Camera

NEAR, CLIP = 0.05, 10.0
"""Between these depths [m] MuJoCo draws."""
FAR = 9.9
"""Depth [m] from which on a pixel shows nothing: MuJoCo gives the clipping plane there, to within rounding."""
GL_RENDERER = 0x1F01


class UnavailableError(HrcError):
    """This renderer cannot be had on this machine."""


class Images(NamedTuple):
    """cover, robot: depth [m] (H, W) of the expanded and of the true robot; link: its part at each pixel, -1 off it."""

    cover: NDArray[np.float32]
    robot: NDArray[np.float32]
    link: NDArray[np.integer] | None


class MujocoImages:
    """Through `mujoco.Renderer`: depth of the expanded robot, and, with `ids`, depth and segmentation of the true one.

    Without `ids` the expanded robot stands for the true one. samples: of the antialiasing, which depth has no use for;
    MuJoCo's own default is 4. Raises UnavailableError where MuJoCo cannot draw.
    """

    def __init__(self, camera: Camera, margin: float, *, ids: bool, samples: int = 0) -> None:
        self._cover = _Rendered(camera, margin, samples)
        self._robot = _Rendered(camera, 0.0, samples) if ids else None

    def render(self, T_world_link: Array) -> Images:
        """With the links at these poses (8, 4, 4); the images are overwritten by the next call."""
        cover = self._cover.place(T_world_link).depth()
        if self._robot is None:
            return Images(cover, cover, None)
        return Images(cover, self._robot.place(T_world_link).depth(), self._robot.link())

    def close(self) -> None:
        """Free the graphics contexts."""
        for robot in (self._cover, self._robot):
            if robot is not None:
                robot.renderer.close()


class MujocoDirect:
    """Through MuJoCo's own drawing functions: depth and link ids of the true robot in one pass, conversions only where needed.

    Raises UnavailableError where MuJoCo cannot draw.
    """

    def __init__(self, camera: Camera, margin: float, reach: float) -> None:
        rows, columns = camera.shape
        self._camera, self._reach, self._corners = camera, reach, corners(margin)
        self._all = mujoco.MjrRect(0, 0, columns, rows)
        self._gl = _made(lambda: mujoco.GLContext(columns, rows))  # the very name is missing where MuJoCo may not draw
        self._gl.make_current()
        self._bodies = [_Bodies(camera, grown, 0) for grown in (margin, 0.0)]
        self._contexts = [_made(mujoco.MjrContext, bodies.model, 150) for bodies in self._bodies]
        self._scenes = [mujoco.MjvScene(bodies.model, 16) for bodies in self._bodies]
        self._view = mujoco.MjvCamera()
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
        self._options = mujoco.MjvOption()
        self._raw = np.empty((2, rows, columns), np.float32)
        self._colours = np.empty((rows, columns, 3), np.uint8)
        self._depths, self._link = np.empty_like(self._raw), np.empty((rows, columns), np.int8)
        for scene, context in zip(self._scenes, self._contexts, strict=True):
            for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
                scene.flags[flag] = 1
            context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def render(self, T_world_link: Array) -> Images:
        """With the links at these poses (8, 4, 4); valid around them, and overwritten by the next call."""
        self._gl.make_current()
        window = rectangle(self._camera, self._camera.T_camera_world @ T_world_link, self._corners, self._reach)
        for i, (bodies, scene, context) in enumerate(zip(self._bodies, self._scenes, self._contexts, strict=True)):
            bodies.place(T_world_link)
            mujoco.mjv_updateScene(bodies.model, bodies.data, self._options, None, self._view,
                                   mujoco.mjtCatBit.mjCAT_ALL, scene)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
            mujoco.mjr_render(self._all, scene, context)
            mujoco.mjr_readPixels(self._colours if i == 1 else None, self._raw[i], self._all, context)
            # Rows come from the bottom up; the raw depth is 1 at NEAR, 0 at CLIP, and linear in 1/z.
            self._depths[i][window] = (NEAR * CLIP) / (NEAR + self._raw[i, ::-1][window] * np.float32(CLIP - NEAR))
        self._link[window] = self._colours[::-1, :, 0][window].astype(np.int8) - 1
        return Images(self._depths[0], self._depths[1], self._link)

    def close(self) -> None:
        """Free the graphics context."""
        self._gl.make_current()
        for context in self._contexts:
            context.free()
        self._gl.free()


class _Rendered:
    """The robot in `mujoco.Renderer`, with the images it draws into."""

    def __init__(self, camera: Camera, margin: float, samples: int) -> None:
        rows, columns = camera.shape
        self._bodies = _Bodies(camera, margin, samples)
        self.renderer = _made(mujoco.Renderer, self._bodies.model, rows, columns)
        self._depth = np.empty(camera.shape, np.float32)
        self._segments = np.empty((rows, columns, 2), np.int32)

    def place(self, T_world_link: Array) -> "_Rendered":
        self._bodies.place(T_world_link)
        self.renderer.update_scene(self._bodies.data, "camera")
        return self

    def depth(self) -> NDArray[np.float32]:
        self.renderer.enable_depth_rendering()
        return self.renderer.render(out=self._depth)

    def link(self) -> NDArray[np.int32]:
        self.renderer.enable_segmentation_rendering()
        return self.renderer.render(out=self._segments)[..., 0]


class _Bodies:
    """Eight free-standing links in MuJoCo."""

    def __init__(self, camera: Camera, margin: float, samples: int) -> None:
        self.model = _model(camera, margin, samples)
        self.data = mujoco.MjData(self.model)

    def place(self, T_world_link: Array) -> None:
        self.data.mocap_pos[:] = T_world_link[:, :3, 3]
        for quat, T in zip(self.data.mocap_quat, T_world_link, strict=True):
            mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)  # or the camera's pose is that of the last frame


def graphics() -> str:
    """What draws in the current graphics context: "llvmpipe" is software. Empty where nothing says so."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return ""
    egl.eglGetCurrentContext.restype = egl.eglGetProcAddress.restype = ctypes.c_void_p
    address = egl.eglGetProcAddress(b"glGetString")
    if not egl.eglGetCurrentContext() or not address:
        return ""
    said = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_uint)(address)(GL_RENDERER)
    return said.decode(errors="replace") if said else ""


def _model(camera: Camera, margin: float, samples: int) -> mujoco.MjModel:
    """Eight mocap bodies, one mesh each, before a camera with these intrinsics; no light, no shadow, no sky."""
    rows, columns = camera.shape
    c, spec = camera.config, mujoco.MjSpec()
    spec.stat.extent, spec.visual.map.znear, spec.visual.map.zfar = 1.0, NEAR, CLIP
    spec.visual.global_.offwidth, spec.visual.global_.offheight = columns, rows
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = samples, 0
    spec.visual.headlight.active = 0
    for i, mesh in enumerate(meshes.robot("perception")):
        asset = spec.add_mesh(name=f"mesh_{i}")
        asset.uservert, asset.userface = mesh.offset(margin).vertices.ravel(), mesh.faces.ravel()
        body = spec.worldbody.add_body(name=f"link_{i}", mocap=True)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=asset.name, contype=0, conaffinity=0)
    # MuJoCo looks along -z with y up, and counts the principal point from the middle of the image.
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, (camera.T_world_camera[:3, :3] * [1.0, -1.0, -1.0]).ravel())
    spec.worldbody.add_camera(
        name="camera", pos=camera.T_world_camera[:3, 3], quat=quat, resolution=[columns, rows],
        sensor_size=[1e-5 * columns, 1e-5 * rows], focal_pixel=[c.fx, c.fy],
        principal_pixel=[(columns - 1) / 2 - c.cx, (rows - 1) / 2 - c.cy])
    return spec.compile()


class Open3dImages:
    """Rays cast by Open3D at static scenes, one for each link: rays move into the link's frame, so nothing is ever rebuilt.

    Only the pixels of the rectangle around each link are cast. Raises UnavailableError without Open3D.
    """

    def __init__(self, camera: Camera, margin: float) -> None:
        open3d = _made(importlib.import_module, "open3d")
        self._camera, self._tensor = camera, open3d.core.Tensor.from_numpy
        self._rays = camera.rays().astype(np.float32)
        self._robot, self._cover = ([self._scene(open3d, mesh.offset(grown)) for mesh in meshes.robot("perception")]
                                    for grown in (0.0, margin))
        self._corners = corners(margin)
        self._link = np.empty(camera.shape, np.int8)
        self._depths = np.empty((2, *camera.shape), np.float32)

    def _scene(self, open3d: Any, mesh: meshes.Mesh) -> Any:
        scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(self._tensor(mesh.vertices.astype(np.float32)), self._tensor(mesh.faces.astype(np.uint32)))
        return scene

    def render(self, T_world_link: Array) -> Images:
        """With the links at these poses (8, 4, 4); the images are overwritten by the next call."""
        self._depths.fill(np.inf)
        self._link.fill(-1)
        cover, robot = self._depths
        T_camera_link = self._camera.T_camera_world @ T_world_link
        for i, T in enumerate(T_camera_link):
            window = rectangle(self._camera, T_camera_link[i : i + 1], self._corners[i : i + 1], 0.0)
            rays = np.empty((*self._rays[window].shape[:2], 6), np.float32)
            R = T[:3, :3].astype(np.float32)
            rays[..., :3] = -R.T @ T[:3, 3].astype(np.float32)
            np.matmul(self._rays[window], R, out=rays[..., 3:])  # at depth 1, so that the ray's parameter is the depth
            cast = self._tensor(rays)
            np.minimum(cover[window], self._hit(self._cover[i], cast), out=cover[window])
            hit = self._hit(self._robot[i], cast)
            self._link[window][hit < robot[window]] = i
            np.minimum(robot[window], hit, out=robot[window])
        return Images(cover, robot, self._link)

    @staticmethod
    def _hit(scene: Any, rays: Any) -> NDArray[np.float32]:
        return scene.cast_rays(rays, nthreads=1)["t_hit"].numpy()

    def close(self) -> None:
        """There is nothing to free."""


def _made(make: Any, *args: Any) -> Any:
    """make(*args), with whatever a graphics driver that is not there may raise in one type and one line."""
    try:
        return make(*args)
    except Exception as error:
        raise UnavailableError(" ".join(f"{type(error).__name__}: {error}".split())) from error
