"""Steering the end effector from the page: over the wire, and with the mouse and the keys in a real Chromium."""

from typing import Any

import numpy as np
import pytest
from mouse import ON_SCREEN
from playwright.sync_api import expect
from vclient import VClient, until

from app.serve.main import Page
from app.serve.steering import NUDGE, direction
from hrc.geometry import look_at, quaternion_from_rotation

GIZMO = "/gizmos/target"
AFTER_TWO_FRAMES = """(name) => new Promise((found) => requestAnimationFrame(() => requestAnimationFrame(
  () => found(window.__viserMutable.nodePoseData[name].position))))"""
IN_A_BURST = """(keys) => {
  for (const key of keys) document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
}"""


def follow(client: VClient) -> np.ndarray:
    """Choose the task "follow" and wait until the arm stands; where its target is [m] (3,)."""
    client.set("Task", "follow")
    until(lambda: client.banner()["task"] == "follow" and client.nodes[GIZMO].get("visible"))
    until(lambda: "at its target" in client.text() and client.position(GIZMO) is not None)
    until(lambda: off(client) < 0.004)  # it is said to be there while it still comes nearer
    return client.position(GIZMO)


def off(client: VClient) -> float:
    return float(client.banner()["off"])


def test_the_arm_follows_its_target_and_stays_there_when_the_visitor_has_gone(served: Page, raw: VClient) -> None:
    target = follow(raw) + np.array([0.0, 0.15, 0.05])
    raw.hand_back()
    visitor = VClient(served.server.get_port())
    until(visitor.ready.is_set)
    until(lambda: visitor.nodes[GIZMO].get("visible"))
    visitor.gizmo(GIZMO, (target - np.array([0.0, 0.1, 0.0])).tolist())
    visitor.gizmo(GIZMO, target.tolist())
    until(lambda: off(raw) > 0.01)
    visitor.close()
    until(lambda: off(raw) < 0.004)
    time = float(raw.banner()["time"])
    until(lambda: float(raw.banner()["time"]) > time + 1.5)
    assert off(raw) < 0.005
    np.testing.assert_allclose(raw.position(GIZMO), target, atol=2e-3)


def test_tasks_are_exchanged_from_the_page(raw: VClient) -> None:
    assert raw.gui[raw.widget("Task")]["props"]["options"] == ["hexagon", "circle", "hold", "follow"]
    raw.set("Task", "circle")
    until(lambda: raw.banner()["task"] == "circle" and "task: circle" in raw.text())
    follow(raw)
    raw.set("Task", "hexagon")
    until(lambda: raw.banner()["task"] == "hexagon" and not raw.nodes[GIZMO].get("visible"))
    until(lambda: "following the path" in raw.text())


def test_a_nudge_moves_the_target_by_a_centimetre(raw: VClient) -> None:
    before = follow(raw)
    raw.set("Up, down", "Up")
    until(lambda: np.abs(raw.position(GIZMO) - before - [0.0, 0.0, NUDGE]).max() < 1e-6)
    raw.set("Nudge 1 cm", "Right")
    raw.set("Nudge 1 cm", "Right")
    until(lambda: np.linalg.norm((raw.position(GIZMO) - before)[:2]) > 1.99 * NUDGE)
    until(lambda: off(raw) < 0.005 and "at its target" in raw.text())


def test_nudges_of_a_cell_that_stands_still_add_up(raw: VClient) -> None:
    before = follow(raw)
    raw.set("Simulation", "Pause")
    until(lambda: raw.banner()["paused"] == "true")
    for count in (1, 2):
        raw.set("Up, down", "Up")
        beat = int(raw.banner()["beat"])
        until(lambda: int(raw.banner()["beat"]) > beat + 8)  # noqa: B023 (called at once)
        np.testing.assert_allclose(raw.position(GIZMO) - before, [0.0, 0.0, count * NUDGE], atol=1e-6)
    raw.set("Simulation", "Play")
    until(lambda: off(raw) < 0.005 and "at its target" in raw.text())
    np.testing.assert_allclose(raw.position(GIZMO) - before, [0.0, 0.0, 2 * NUDGE], atol=1e-6)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_nudge_that_comes_to_nothing_leaves_the_target(served: Page, raw: VClient) -> None:
    before = follow(raw)
    camera = next(iter(served.server.get_clients().values())).camera._state
    turned, camera.wxyz = camera.wxyz, np.zeros(4)
    raw.set("Nudge 1 cm", "Right")
    beat = int(raw.banner()["beat"])
    until(lambda: int(raw.banner()["beat"]) > beat + 2)
    camera.wxyz = turned
    raw.set("Up, down", "Up")
    until(lambda: np.abs(raw.position(GIZMO) - before - [0.0, 0.0, NUDGE]).max() < 1e-6)


@pytest.mark.parametrize(("eye", "at", "away", "right"), [
    ((1.9, 0.7, 1.1), (-0.2, 0.0, 0.45), (-1, 0, 0), (0, 1, 0)),
    ((-0.3, 2.3, 0.9), (-0.25, 0.0, 0.45), (0, -1, 0), (-1, 0, 0)),
    ((-0.6, -2.0, 0.5), (-0.5, 0.0, 0.5), (0, 1, 0), (1, 0, 0)),
])
def test_a_nudge_is_what_it_looks_like(eye: Any, at: Any, away: Any, right: Any) -> None:
    wxyz = quaternion_from_rotation(look_at(np.array(eye), np.array(at))[:3, :3])
    np.testing.assert_allclose(direction("Away", wxyz), away)
    np.testing.assert_allclose(direction("Right", wxyz), right)
    np.testing.assert_allclose(direction("Near", wxyz) + direction("Away", wxyz), 0.0)
    np.testing.assert_allclose(direction("Left", wxyz) + direction("Right", wxyz), 0.0)
    np.testing.assert_allclose(direction("Up", wxyz), [0, 0, 1])


def test_a_target_out_of_reach_is_one_line_of_the_log_and_the_gizmo_comes_back(raw: VClient) -> None:
    before = follow(raw)
    for x in (0.9, 0.92, 0.94):
        raw.gizmo(GIZMO, [x, 0.9, 0.9])
    until(lambda: "m from the shoulder" in raw.text())
    until(lambda: np.abs(raw.position(GIZMO) - before).max() < 1e-3)
    assert raw.text().count("m from the shoulder") == 1
    assert off(raw) < 0.005


@pytest.mark.parametrize("position", [
    [float("nan"), 0.0, 0.5], [float("inf"), 0.0, 0.5], [-0.5, 0.1], [-0.5, 0.1, 0.5, 0.0], ["a", "b", "c"], [1e9, 0.0, 0.5],
    [True, 0.0, 0.5], [None, 0.0, 0.5]])
def test_a_target_that_is_none_is_not_let_in(served: Page, raw: VClient, position: list[Any]) -> None:
    before, refused = follow(raw), served.guard.refused.total()
    raw.gizmo(GIZMO, position)
    until(lambda: served.guard.refused.total() > refused)
    np.testing.assert_array_equal(raw.position(GIZMO), before)
    assert off(raw) < 0.005


@pytest.mark.parametrize(("label", "value"), [
    ("Task", "hexagone"), ("Task", 3), ("Task", ["follow"]), ("Task", "waypoints"), ("Nudge 1 cm", "Up"), ("Up, down", True),
    ("Joint 4 [deg]", 121.0), ("Joint 4 [deg]", float("nan")), ("Joint 1 [deg]", "0"), ("Joint 1 [deg]", [0.0] * 7)])
def test_a_choice_that_is_not_offered_is_not_let_in(served: Page, raw: VClient, label: str, value: Any) -> None:
    follow(raw)
    uuid, refused = raw.widget(label), served.guard.refused.total()
    raw.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})
    until(lambda: served.guard.refused.total() > refused)
    assert raw.banner()["task"] == "follow"
    assert off(raw) < 0.005


def test_nudges_are_not_let_in_while_nothing_is_followed(served: Page, raw: VClient) -> None:
    refused = served.guard.refused.total()
    raw.set("Nudge 1 cm", "Left")
    until(lambda: served.guard.refused.total() > refused)


def test_a_posture_is_taken_from_the_sliders_and_the_tool_stays(raw: VClient) -> None:
    follow(raw)
    link_4 = raw.position("/robot/link_4")
    raw.set("Joint 1 [deg]", 25.0)
    raw.set("Joint 3 [deg]", -25.0)
    raw.click("Make this the posture")
    until(lambda: "posture: 25," in raw.text())
    until(lambda: np.linalg.norm(raw.position("/robot/link_4") - link_4) > 0.02)
    assert off(raw) < 0.005
    assert raw.value("Joint 3 [deg]") == -25.0
    raw.set("Simulation", "Reset")
    until(lambda: raw.value("Joint 1 [deg]") == 0.0)


@pytest.mark.browser
def test_dragging_the_gizmo_and_pressing_arrow_keys_bring_the_arm_to_its_target(tab: Any, raw: VClient) -> None:
    banner = tab.locator("#eb-banner")
    expect(banner).to_have_attribute("data-mode", "idle")
    tab.locator("label", has_text="Task").locator("xpath=ancestor::div[contains(@class,'Flex-root')][1]").locator(
        "input:not([type=hidden])").click()
    tab.get_by_role("option", name="follow").click()
    expect(banner).to_have_attribute("data-task", "follow")
    expect(banner).to_contain_text("at its target")
    tab.wait_for_function(f"() => window.__viserMutable.nodeRefFromName['{GIZMO}']")
    before = raw.position(GIZMO)
    x, y = tab.evaluate(ON_SCREEN, [GIZMO, [0.0, 0.25, 0.0]])
    tab.mouse.move(x, y)
    tab.mouse.down()
    for pixels in range(4, 44, 4):
        tab.mouse.move(x + pixels, y)
    tab.mouse.up()
    dragged = np.array(tab.evaluate(AFTER_TWO_FRAMES, GIZMO))
    assert dragged[1] - before[1] > 0.03
    until(lambda: np.abs(raw.position(GIZMO) - dragged).max() < 1e-6)  # the last of the drag has come through
    at_target = "() => Number(document.querySelector('#eb-banner').dataset.off) < 0.005"
    tab.wait_for_function(at_target)
    np.testing.assert_allclose(dragged[[0, 2]], before[[0, 2]], atol=1e-3)
    camera = tab.evaluate("() => window.__viserMutable.camera.position.toArray()")
    tab.evaluate(IN_A_BURST, ["ArrowRight", "ArrowRight", "PageUp"])
    until(lambda: np.abs(raw.position(GIZMO) - dragged - [0.0, 2 * NUDGE, NUDGE]).max() < 1e-3)
    tab.wait_for_function(at_target)
    assert tab.evaluate("() => window.__viserMutable.camera.position.toArray()") == camera, "the keys were not the camera's"
