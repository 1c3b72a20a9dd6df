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
