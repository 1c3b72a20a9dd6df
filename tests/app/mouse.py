"""The mouse of a real browser on the page."""

import re
from typing import Any

ON_SCREEN = """([name, offset]) => {
  const scene = window.__viserMutable, node = scene.nodeRefFromName[name];
  node.updateWorldMatrix(true, false);
  const p = node.position.clone().set(...offset).applyMatrix4(node.matrixWorld).project(scene.camera);
  const box = scene.canvas.getBoundingClientRect();
  return [box.left + (p.x + 1) / 2 * box.width, box.top + (1 - p.y) / 2 * box.height];
}"""


COVERED = """([x, y]) => {
  const top = document.elementFromPoint(x, y);
  return top?.tagName === "CANVAS" ? "" : `<${top?.tagName.toLowerCase()} class="${top?.className}">`;
}"""

NEXT_BANNER = """(beat) => {
  const now = document.querySelector("#eb-banner")?.dataset.beat;
  return now !== undefined && now !== beat;
}"""


def grab(tab: Any, node: str, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[float]:
    """Press the button on a point of what is drawn, given in the frame of its node [m]; where that is on the screen.

    Raises AssertionError if something of the page lies over that point: there the mouse would do something else.
    """
    tab.mouse.up()
    for _ in range(2):  # the page finds out what the mouse rests on in one of its next pictures
        x, y = tab.evaluate(ON_SCREEN, [node, list(offset)])
        tab.mouse.move(x, y)
        next_banner(tab)
        next_banner(tab)
    over = tab.evaluate(COVERED, [x, y])
    assert not over, f"{node} is on the screen at {x:.0f}, {y:.0f}, where {over} lies over it"
    tab.mouse.down()
    return [x, y]


def pull(tab: Any, at: list[float], step: tuple[float, float], condition: str, most: int = 60) -> bool:
    """Move the mouse on by a step [pixels] with each banner until the data `b` of one meet a condition: whether one did."""
    for _ in range(most):
        at[:] = at[0] + step[0], at[1] + step[1]
        tab.mouse.move(*at)
        next_banner(tab)
        if tab.evaluate(f"() => {{ const b = document.querySelector('#eb-banner').dataset; return {condition}; }}"):
            return True
    return False


def next_banner(tab: Any) -> None:
    """Wait for it: the page is alive, and shows what has come of what the mouse did."""
    tab.wait_for_function(NEXT_BANNER, arg=tab.locator("#eb-banner").get_attribute("data-beat"))


def pushed(tab: Any) -> bool:
    """Grab the elbow, pull it sideways and keep the mouse moving; whether the banner shows that the arm reacts."""
    tab.mouse.up()
    x, y = tab.evaluate(ON_SCREEN, ["/robot/link_4", [0.0, 0.0, 0.0]])
    tab.mouse.move(x, y)
    tab.mouse.down()
    for pixels in (*range(4, 64, 4), *(60 + i % 2 for i in range(40))):
        tab.mouse.move(x + pixels, y)
        if re.match("RELAX|ABORT", tab.locator("#eb-banner .eb-mode").inner_text()):
            return True
    return False
