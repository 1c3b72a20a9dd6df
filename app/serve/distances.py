"""How near obstacles are: a line from each link to the nearest one, and the places where something touches the robot."""

from collections.abc import Sequence

import numpy as np
import viser
from numpy.typing import NDArray

from app import palette
from hrc.cell.eyes import MOST_TOUCHES
from hrc.messages import Clearance, Snapshot


def lines(clearances: Sequence[Clearance]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """End points [m] (n, 2, 3) and their colours (n, 2, 3), of those that are not too far to be seen."""
    drawn = [c for c in clearances if c.distance < palette.FAR]
    points = np.array([(c.p_robot, c.p_obstacle) for c in drawn], np.float32).reshape(-1, 2, 3)
    colour = palette.by_distance([c.distance for c in drawn])
    return points, np.repeat(colour[:, None], 2, axis=1)


class DistanceView:
    """The lines as one node, the nearest with its length in cm; a ball at each touch, an empty one where it is not sure."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        # From the start a colour for each end: a material that was made for one colour alone would draw later ones white.
        nothing = np.zeros((1, 2, 3), np.float32)
        self._lines = server.scene.add_line_segments(
            "/distances/lines", nothing, nothing.astype(np.uint8), thickness=0.004, visible=False)
        self._label = server.scene.add_label("/distances/nearest", "", visible=False, font_screen_scale=0.8,
                                             anchor="center-left")
        self._touches = [
            server.scene.add_icosphere(f"/touches/{i}", radius=0.012, subdivisions=2, color=palette.TOUCH, visible=False)
            for i in range(MOST_TOUCHES)]
        self.show_distances = True

    def update(self, snapshot: Snapshot) -> None:
        """Lines, label and balls for this snapshot."""
        points, colour = lines(snapshot.clearances) if self.show_distances else lines(())
        nearest = min(snapshot.clearances, key=lambda c: c.distance, default=None)
        with self._server.atomic():
            self._lines.visible = len(points) > 0
            self._label.visible = self._lines.visible and snapshot.contact is None  # there, newtons matter more
            if len(points) and nearest is not None:
                self._lines.points, self._lines.colors = points, colour
                self._label.text = f"{100.0 * nearest.distance:.0f} cm"
                self._label.position = 0.5 * (nearest.p_robot + nearest.p_obstacle)
            for i, ball in enumerate(self._touches):
                ball.visible = i < len(snapshot.touches) and self.show_distances
                if ball.visible:
                    touch = snapshot.touches[i]
                    ball.position = touch.p_world
                    ball.color, ball.wireframe = (palette.TOUCH, False) if touch.sure else (palette.UNSURE, True)
