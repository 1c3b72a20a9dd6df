"""The images of one camera at a time in the right dock: measured, expected, remaining, with the contacts marked in them."""

from collections.abc import Sequence

import viser

from app import palette
from app.palette import Colour
from app.serve import jpeg, pictures
from app.serve.pictures import Picture, Pictures
from app.serve.sight import standing
from hrc.cell.eyes import CameraSetup
from hrc.geometry import Array, apply
from hrc.messages import Snapshot, View
from hrc.vision.camera import Camera

MEASURED, EXPECTED, REMAINING = "Depth image", "Robot as expected", "What is left"
CONTACT: Colour = (255, 59, 48)
NO_CAMERA: Sequence[str] = ("",)
INNER, OUTER = 0.045, 0.065
"""Radii of the rings around a touch and around the contact, over the side of the picture."""
Mark = tuple[tuple[int, int], Colour, float]
"""Pixel (u, v) of the depth image, colour and radius of a ring."""


class CameraImages:
    """Three images and, where there are several cameras, the choice among them. Made in the present container."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._cameras: dict[str, Camera] = {}
        self._pictures: dict[str, tuple[Array | None, Camera, Pictures]] = {}
        self._choice = server.gui.add_dropdown("Camera", NO_CAMERA, visible=False, hint="Whose images are shown below")
        blank = Pictures(Camera()).blank
        names = MEASURED, EXPECTED, REMAINING
        self._images = {name: server.gui.add_image(blank, label=name, format="jpeg") for name in names}
        self._sent = dict.fromkeys(self._images, (blank.shape, blank.tobytes()))
        self._key = server.gui.add_html(_legend())
        self._drawn: object = None
        self._shown = True

    @property
    def show_images(self) -> bool:
        """Whether they are drawn and sent at all."""
        return self._shown

    @show_images.setter
    def show_images(self, shown: bool) -> None:
        self._shown = shown
        for widget in (*self._images.values(), self._key):
            widget.visible = shown
        self._choice.visible = shown and len(self._cameras) > 1

    def begin(self, rig: Sequence[CameraSetup]) -> None:
        """Offer another rig's cameras."""
        self._cameras, self._drawn = {setup.name: Camera(setup.camera) for setup in rig}, None
        self._pictures = {name: (None, camera, Pictures(camera)) for name, camera in self._cameras.items()}
        self._choice.options = tuple(self._cameras)
        self.show_images = self._shown

    def update(self, snapshot: Snapshot) -> None:
        """The newest frame of the chosen camera, if it is not on the screen yet; an image that is the same is not sent."""
        view = next((view for view in snapshot.views if view.camera == self._choice.value), None)
        if view is None or not self._shown:
            return
        camera, show = self._at(view)
        marks = () if view.silent else contacts(snapshot, view.camera, camera)
        drawn = (view.camera, None if view.frame is None else view.frame.tick, view.silent, marks)
        if drawn == self._drawn:
            return
        self._drawn = drawn
        state = "" if view.frame is not None else ": none yet"
        self._images[MEASURED].label = MEASURED + (": SILENT" if view.silent else state)
        for name, picture in draw(view, show, marks).items():
            if (sent := (picture.shape, picture.tobytes())) != self._sent[name]:
                self._sent[name] = sent
                jpeg.show(self._images[name], picture)

    def _at(self, view: View) -> tuple[Camera, Pictures]:
        """The camera where it took the frame of the view, and what draws that."""
        stood, camera, show = self._pictures[view.camera]
        if stood is not view.T_world_camera:
            camera = standing(self._cameras[view.camera], view)
            show = Pictures(camera)
            self._pictures[view.camera] = view.T_world_camera, camera, show
        return camera, show


def contacts(snapshot: Snapshot, name: str, camera: Camera) -> tuple[Mark, ...]:
    """What is to be marked in a camera's images: the places where it sees a touch, and the contact, if it is in view."""
    marks: list[Mark] = [(touch.pixel, palette.TOUCH if touch.sure else palette.UNSURE, INNER)
                         for touch in snapshot.touches if touch.camera == name]
    if snapshot.contact is not None:
        u, v, z = camera.project(apply(camera.T_camera_world, snapshot.contact.p_world))
        rows, columns = camera.shape
        if z > 0.0 and 0.0 <= u < columns and 0.0 <= v < rows:
            marks.append(((round(float(u)), round(float(v))), CONTACT, OUTER))
    return tuple(marks)


def draw(view: View, camera: Pictures, marks: Sequence[Mark]) -> dict[str, Picture]:
    """The three pictures by their names; crossed out while the camera is silent."""
    drawn = {
        MEASURED: camera.blank if view.frame is None else camera.measured(view.frame),
        EXPECTED: camera.blank if view.robot_image is None else camera.expected(view.robot_image),
        REMAINING: camera.blank if view.foreground is None else camera.remaining(view.foreground)}
    for pixel, colour, radius in marks:
        drawn = {name: camera.marked(picture, pixel, colour, radius) for name, picture in drawn.items()}
    return {name: pictures.crossed(picture) for name, picture in drawn.items()} if view.silent else drawn


def _legend() -> str:
    rows = (("ring", palette.TOUCH, "touch"), ("ring", palette.UNSURE, "touch, perhaps hidden"), ("ring", CONTACT, "contact"),
            ("dot", pictures.OBSTACLE, "obstacle"))
    entries = (f'<span><i class="{kind}" style="--c:#{bytes(colour).hex()}"></i>{text}</span>' for kind, colour, text in rows)
    return f'<div class="eb-legend">{"".join(entries)}</div>'
