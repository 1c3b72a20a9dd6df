"""The link that a visitor has clicked: lit up in the scene, and the one whose numbers are shown."""

from collections.abc import Callable
from typing import Any

import viser

from app.serve.scene import SceneView

FIRST = 4
"""The link whose numbers are shown before anybody clicks: the elbow."""
LIGHT = 0.45
"""How far the colour of the chosen link is moved towards white."""


class Selection:
    """link: 1 to 7. A click selects; a drag still pushes, because a click is only what moved less than three pixels."""

    def __init__(self, view: SceneView) -> None:
        self.link = FIRST
        self._links = view.links
        self._colours = [node.color for node in view.links]
        for link, node in enumerate(view.links[1:], start=1):
            node.on_click(self._handler(link))

    def _handler(self, link: int) -> Callable[[Any], Any]:
        async def on_click(_: viser.SceneNodePointerEvent[Any]) -> None:
            self._links[self.link].color = self._colours[self.link]
            self.link = link
            r, g, b = (round(c + LIGHT * (255 - c)) for c in self._colours[link])
            self._links[link].color = (r, g, b)

        return on_click
