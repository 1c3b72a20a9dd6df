"""Forces as arrows: estimated and true contact force with their newtons, the contact point, and the mouse's pull."""

import math
from typing import Literal

import numpy as np
import viser

from hrc.geometry import Array
from hrc.messages import Snapshot

METRES_PER_NEWTON = 0.01
VISIBLE_FORCE = 1.0
"""A force below this is not drawn [N]."""
ESTIMATE, TRUTH, PULL = (255, 59, 48), (52, 199, 89), (255, 204, 0)


class Arrow:
    """An arrow with a label at its outer end. anchor: the corner of the label that stands there."""

    def __init__(self, server: viser.ViserServer, name: str, colour: tuple[int, int, int], radius: float,
                 anchor: Literal["bottom-center", "top-center", "center-left"]) -> None:
        self._arrow = server.scene.add_arrows(
            f"/forces/{name}", np.zeros((1, 2, 3), np.float32), colour, shaft_radius=radius, head_radius=2.6 * radius,
            head_length=6.0 * radius, visible=False)
        self._label = server.scene.add_label(f"/forces/{name}_label", "", visible=False, font_screen_scale=0.9,
                                             anchor=anchor)

    def show(self, tail: Array, head: Array, text: str, text_at: Array) -> None:
        """Draw it from tail to head [m] (3,)."""
        self._arrow.points = np.stack([tail, head])[None].astype(np.float32)
        self._label.text, self._label.position = text, text_at
        self._arrow.visible = self._label.visible = True

    def hide(self) -> None:
        """Draw nothing."""
        self._arrow.visible = self._label.visible = False


class ForceView:
    """The scene nodes of all forces. stiffness, cap: of the mouse's spring [N/m], [N], to write a pull in newtons."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._estimate = Arrow(server, "estimate", ESTIMATE, 0.009, "bottom-center")
        self._truth = Arrow(server, "truth", TRUTH, 0.006, "top-center")
        self._pull = Arrow(server, "pull", PULL, 0.004, "center-left")
        self._contact = server.scene.add_icosphere("/forces/contact", radius=0.014, color=ESTIMATE, visible=False)
        self.show_forces = True
        self.stiffness, self.cap = 0.0, math.inf

    def update(self, snapshot: Snapshot) -> None:
        """Arrows, labels and marker for this snapshot."""
        pull = snapshot.pull
        # A push is drawn from outside onto the surface; a pull leads away from it: else the robot would hide it.
        outward = pull is not None
        with self._server.atomic():
            contact = snapshot.contact
            self._contact.visible = contact is not None and self.show_forces
            if contact is None:
                self._estimate.hide()
            else:
                self._contact.position = contact.p_world
                name = "estimate" if contact.seen else "felt, not seen,"
                self._draw(self._estimate, contact.p_world, contact.F_world, name, outward)
            self._draw(self._truth, snapshot.truth.p_world, snapshot.truth.F_world, "true", outward)
            if pull is None or not self.show_forces:
                self._pull.hide()
            else:
                point, target = pull
                force = min(self.cap, self.stiffness * float(np.linalg.norm(target - point)))
                self._pull.show(point, target, f"pull {force:.0f} N", point)  # apart from the labels of the forces

    def _draw(self, arrow: Arrow, point: Array, F_world: Array, name: str, outward: bool) -> None:
        force = math.hypot(*F_world)
        if force < VISIBLE_FORCE or not self.show_forces or not np.isfinite(point).all():
            arrow.hide()
            return
        along = METRES_PER_NEWTON * F_world
        tail, head = (point, point + along) if outward else (point - along, point)
        arrow.show(tail, head, f"{name} {force:.0f} N", head if outward else tail)
