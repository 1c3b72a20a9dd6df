"""The page over its wire protocol, with the real cell behind it: what a visitor does, and what comes back."""

import io
import re
from collections.abc import Iterator

import numpy as np
import pytest
import viser
from PIL import Image
from vclient import VClient, until

from app.serve import jpeg
from app.serve.access import Access
from app.serve.main import Page
from hrc.config import Config
from hrc.control.reaction import ReactionConfig
from hrc.errors import DeviceError

ELBOW = "/robot/link_4"


def elbow(client: VClient) -> np.ndarray:
    """A point on the elbow's surface, on the side of the camera [m] (3,)."""
    return client.position(ELBOW) + np.array([0.06, 0.0, 0.0])


def pull(client: VClient, distance: float) -> np.ndarray:
    """Grab the elbow and pull it sideways; the point that was grabbed."""
    point = elbow(client)
    client.drag(ELBOW, "start", point, point)
    client.drag(ELBOW, "update", point, point + np.array([0.0, distance, 0.0]))
    return point


def number(client: VClient, key: str) -> float:
    return float(client.banner()[key])


def test_arm_moves_and_time_passes(raw: VClient) -> None:
    before, time = raw.position("/robot/link_7"), number(raw, "time")
    until(lambda: number(raw, "time") > time + 0.5)
    until(lambda: np.linalg.norm(raw.position("/robot/link_7") - before) > 0.03)
    assert raw.banner()["mode"] == "idle"


def test_pulling_a_link_is_felt_and_answered(raw: VClient) -> None:
    point = pull(raw, 0.2)
    until(lambda: number(raw, "force") > 8.0 and number(raw, "truth") > 8.0)
    assert raw.banner()["mode"] in ("relax", "abort")
    until(lambda: raw.nodes["/forces/estimate"].get("visible") and raw.nodes["/forces/truth"].get("visible"))
    assert "N" in raw.nodes["/forces/estimate_label"]["text"]
    raw.drag(ELBOW, "end", point, point)
    until(lambda: number(raw, "truth") == 0.0 and number(raw, "force") == 0.0)
    until(lambda: raw.banner()["mode"] == "idle")


def test_hard_pull_aborts_and_the_arm_returns(raw: VClient) -> None:
    point = pull(raw, 0.6)
    until(lambda: raw.banner()["mode"] == "abort")
    raw.drag(ELBOW, "end", point, point)
    until(lambda: raw.banner()["mode"] == "idle")


def test_leaving_lets_go(served: Page, raw: VClient) -> None:
    visitor = VClient(served.server.get_port())
    until(visitor.ready.is_set)
    until(lambda: elbow(visitor) is not None)
    raw.hand_back()
    pull(visitor, 0.2)
    until(lambda: number(raw, "truth") > 8.0)
    visitor.close()
    until(lambda: number(raw, "truth") == 0.0)


def test_silent_browser_lets_go(served: Page, raw: VClient) -> None:
    visitor = VClient(served.server.get_port())
    until(visitor.ready.is_set)
    until(lambda: elbow(visitor) is not None)
    raw.hand_back()
    pull(visitor, 0.2)
    until(lambda: number(raw, "truth") > 8.0)
    time = number(raw, "time")
    until(lambda: number(raw, "time") > time + 2.0)
    assert number(raw, "truth") > 8.0, "a mouse held still keeps pulling while its browser answers"
    visitor.alive = False
    until(lambda: number(raw, "truth") == 0.0)
    until(lambda: "does not answer" in raw.text())
    visitor.close()


def test_stop_sticks_until_resume(raw: VClient) -> None:
    raw.click("STOP (Esc)")
    until(lambda: raw.banner()["mode"] == "stop")
    time = number(raw, "time")
    point = pull(raw, 0.2)
    raw.drag(ELBOW, "end", point, point)
    until(lambda: number(raw, "time") > time + 1.0)
    assert raw.banner()["mode"] == "stop"
    until(lambda: raw.gui[raw.widget("Resume")]["props"]["visible"])
    raw.click("Resume")
    until(lambda: raw.banner()["mode"] == "idle")


def test_stop_takes_hold_while_paused(raw: VClient) -> None:
    raw.set("Simulation", "Pause")
    until(lambda: raw.banner()["paused"] == "true")
    raw.click("STOP (Esc)")
    until(lambda: raw.banner()["mode"] == "stop")
    until(lambda: "Play" in raw.gui[raw.widget("Simulation")]["props"]["options"])
    raw.set("Simulation", "Play")
    until(lambda: raw.banner()["paused"] == "false")
    assert raw.banner()["mode"] == "stop"


def test_pause_step_and_reset(raw: VClient) -> None:
    raw.set("Simulation", "Pause")
    until(lambda: raw.banner()["paused"] == "true" and "Play" in raw.gui[raw.widget("Simulation")]["props"]["options"])
    beat = number(raw, "beat")
    until(lambda: number(raw, "beat") > beat + 2)
    time = number(raw, "time")
    raw.set("Simulation", "Step")
    until(lambda: abs(number(raw, "time") - time - 0.010) < 1e-9)
    raw.set("Simulation", "Reset")
    until(lambda: number(raw, "time") < 0.01)
    raw.set("Simulation", "Play")
    until(lambda: number(raw, "time") > 0.2)


def test_parameters_reach_the_cell_and_return_with_reset(raw: VClient) -> None:
    default = ReactionConfig().f_relax
    raw.set("F_relax [N]", default + 2.0)
    until(lambda: f"control.f_relax = {default + 2.0:g}" in raw.text())
    assert raw.value("F_relax [N]") == default + 2.0
    raw.set("Simulation", "Reset")
    until(lambda: raw.value("F_relax [N]") == default)


def test_sliders_carry_range_unit_and_help_of_their_parameters(raw: VClient) -> None:
    props = raw.gui[raw.widget("Push stiffness [N/m]")]["props"]
    assert (props["min"], props["max"]) == (20.0, 1000.0)
    assert props["hint"] == type(Config().push).docs()["stiffness"]


def test_obstacle_follows_its_gizmo_and_the_camera_sees_it(raw: VClient) -> None:
    until(lambda: raw.nodes["/obstacles/ball"].get("visible", True) and raw.position("/obstacles/ball")[1] > 0.5)
    target = np.array([-0.3, 0.65, 0.5])
    raw.gizmo("/gizmos/ball", target.tolist())
    until(lambda: np.linalg.norm(raw.position("/obstacles/ball") - target) < 0.02)

    def seen() -> bool:
        points = raw.nodes["/cloud"]["points"].reshape(-1, 3).astype(float)
        return len(points) > 100 and bool(np.linalg.norm(np.median(points, axis=0) - target) < 0.1)

    until(seen)
    assert raw.nodes["/cloud"]["points"].dtype == np.float16


def test_a_figure_comes_in_and_a_slab_is_turned(raw: VClient) -> None:
    until(lambda: "visible" in raw.nodes["/obstacles/figure"])
    assert not raw.nodes["/obstacles/figure"]["visible"]
    raw.set("Ball", False)
    raw.set("Figure", True)
    until(lambda: raw.nodes["/obstacles/figure"]["visible"])
    place = np.array(raw.position("/obstacles/figure"))

    def seen() -> bool:
        points = raw.nodes["/cloud"]["points"].reshape(-1, 3).astype(float)
        return len(points) > 100 and bool(np.linalg.norm(np.median(points, axis=0) - place) < 0.4)

    until(seen)
    raw.set("Slab", True)
    until(lambda: raw.nodes["/obstacles/slab"]["visible"])
    wxyz = [0.8, 0.0, 0.0, 0.6]
    raw.gizmo("/gizmos/slab", raw.position("/obstacles/slab").tolist(), wxyz)
    between = []
    until(lambda: between.append(raw.nodes["/obstacles/slab"]["wxyz"][0]) or 0.81 < between[-1] < 0.99)
    until(lambda: np.abs(np.asarray(raw.nodes["/obstacles/slab"]["wxyz"]) - wxyz).max() < 1e-3)
    until(lambda: "slab to (-0.25, -0.60, 0.35) m, turned 74 deg" in raw.text())
    raw.set("Slab", False)
    until(lambda: not raw.nodes["/obstacles/slab"]["visible"])
    raw.set("Slab", True)
    until(lambda: raw.nodes["/obstacles/slab"]["visible"] and raw.nodes["/obstacles/slab"]["wxyz"][0] > 0.999)


def image(client: VClient, name: str) -> bytes:
    """One of the camera images as it came; every arrival is another object."""
    return client.gui[client.widget(name)]["props"]["_data"]


def pixels(client: VClient, name: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(bytes(image(client, name)))).convert("RGB")).astype(int)


def test_camera_images_show_measured_expected_and_remaining(raw: VClient) -> None:
    def blue(name: str) -> int:
        red, _, blue = np.moveaxis(pixels(raw, name), -1, 0)
        return int((blue > red + 60).sum())

    raw.gizmo("/gizmos/ball", (-0.3, 0.45, 0.6))
    until(lambda: blue("What is left") > 50)
    grey = pixels(raw, "Depth image")
    assert np.abs(grey - grey.mean(axis=2, keepdims=True)).max() < 20, "depth in grey"
    assert np.ptp(pixels(raw, "Robot as expected"), axis=2).max() > 60, "links in colours"
    raw.set("Ball", False)
    until(lambda: blue("What is left") == 0)


def test_an_image_that_has_not_changed_is_not_sent_again(raw: VClient) -> None:
    names = ("Depth image", "Robot as expected", "What is left")
    until(lambda: raw.widget("Depth image"))  # without a frame it says that there is none yet
    raw.set("Ball", False)
    until(lambda: pixels(raw, "What is left").max() < 60)
    time, seen = number(raw, "time"), {name: image(raw, name) for name in names}
    until(lambda: number(raw, "time") > time + 0.5)
    assert image(raw, "Depth image") is not seen["Depth image"], "it has noise"
    assert image(raw, "What is left") is seen["What is left"], "nothing before, nothing now"
    raw.set("Simulation", "Pause")
    until(lambda: raw.banner()["paused"] == "true")
    beat = number(raw, "beat")
    until(lambda: number(raw, "beat") > beat + 3)
    seen, beat = {name: image(raw, name) for name in names}, number(raw, "beat")
    until(lambda: number(raw, "beat") > beat + 10)
    assert all(image(raw, name) is seen[name] for name in names)


def test_nothing_is_encoded_while_nobody_watches(served: Page, raw: VClient, monkeypatch: pytest.MonkeyPatch) -> None:
    encoded: list[object] = []
    stock = jpeg.show

    def counted(widget: viser.GuiImageHandle, picture: np.ndarray) -> None:
        encoded.append(picture)
        stock(widget, picture)

    monkeypatch.setattr(jpeg, "show", counted)
    until(lambda: len(encoded) > 5)
    raw.set("Camera images", False)
    until(lambda: not raw.gui[raw.widget("Depth image")]["props"]["visible"])
    off, beat = len(encoded), number(raw, "beat")
    until(lambda: number(raw, "beat") > beat + 10)
    assert len(encoded) <= off + 3, "what was being drawn at that moment"
    raw.set("Camera images", True)
    until(lambda: len(encoded) > off + 5)
    raw.close()
    until(lambda: not served.server.get_clients())
    left = len(encoded)
    with pytest.raises(TimeoutError):
        until(lambda: len(encoded) > left + 3, 1.0)


def test_lines_join_links_and_obstacle_and_stand_still_while_paused(raw: VClient) -> None:
    centre = np.array([-0.3, 0.45, 0.6])
    raw.gizmo("/gizmos/ball", centre.tolist())
    until(lambda: np.linalg.norm(raw.position("/obstacles/ball") - centre) < 0.02 and number(raw, "clearance") < 0.3)
    lines = raw.nodes["/distances/lines"]

    def ends() -> np.ndarray:
        return lines["points"].reshape(-1, 2, 3).astype(float)

    # The ball's surface, as one camera sees it: within 2 cm of a ball of 8 cm.
    until(lambda: lines["visible"] and bool((np.abs(np.linalg.norm(ends()[:, 1] - centre, axis=1) - 0.08) < 0.02).all()))
    assert lines["colors"].shape == lines["points"].shape
    raw.set("Simulation", "Pause")
    until(lambda: raw.banner()["paused"] == "true")
    beat = number(raw, "beat")
    until(lambda: number(raw, "beat") > beat + 3)
    shortest = np.linalg.norm(ends()[:, 0] - ends()[:, 1], axis=1).min()
    centimetres = re.fullmatch(r"(\d+) cm", raw.nodes["/distances/nearest"]["text"])
    assert centimetres is not None
    assert abs(int(centimetres[1]) - 100.0 * shortest) < 1.0
    assert abs(100.0 * number(raw, "clearance") - 100.0 * shortest) < 1.0
    still, beat = lines["points"], number(raw, "beat")
    until(lambda: number(raw, "beat") > beat + 10)
    assert lines["points"] is still
    raw.set("Distances and touches", False)
    until(lambda: not lines["visible"])
    raw.set("Distances and touches", True)
    until(lambda: lines["visible"])


def test_a_touch_is_drawn_where_the_camera_sees_it(raw: VClient) -> None:
    point = pull(raw, 0.2)
    until(lambda: raw.nodes["/touches/0"]["visible"] and np.linalg.norm(raw.position("/touches/0") - elbow(raw)) < 0.2)
    raw.drag(ELBOW, "end", point, point)
    until(lambda: not raw.nodes["/touches/0"]["visible"])


def crossed_out(image: np.ndarray) -> bool:
    """Whether a red cross is drawn over the image."""
    red, green, _ = np.moveaxis(image, -1, 0)
    return bool((red > green + 100).sum() > 100)


def test_unplugged_cameras_make_the_arm_halt_and_the_page_say_why(raw: VClient) -> None:
    raw.set("Unplug the cameras", True)
    until(lambda: raw.banner()["mode"] == "camera silent")
    assert "no camera delivers images" in raw.text()
    until(lambda: "SILENT" in raw.gui[raw.widget("Depth image: SILENT")]["props"]["label"])
    until(lambda: crossed_out(pixels(raw, "Depth image: SILENT")))
    raw.set("Unplug the cameras", False)
    until(lambda: raw.banner()["mode"] == "idle" and raw.banner()["silent"] == "")
    until(lambda: raw.widget("Depth image") is not None)


def test_obstacles_come_and_go(raw: VClient) -> None:
    raw.set("Block", True)
    until(lambda: raw.nodes["/obstacles/block"]["visible"] and raw.value("Block") is True)
    raw.set("Block", False)
    until(lambda: not raw.nodes["/obstacles/block"]["visible"])


def test_what_the_cell_refuses_is_in_the_log(raw: VClient) -> None:
    raw.drag(ELBOW, "start", (3.0, 3.0, 3.0), (3.0, 3.0, 3.0))
    until(lambda: "point must be" in raw.text())
    point = elbow(raw)
    raw.drag(ELBOW, "start", point, point)
    raw.drag(ELBOW, "update", point, (900.0, 0.0, 0.0))
    until(lambda: "target must be" in raw.text())
    raw.drag(ELBOW, "end", point, point)
    assert raw.banner()["mode"] != "failed"


def test_choosing_a_scenario_starts_another_cell(raw: VClient) -> None:
    raw.set("Scenario", "push")
    until(lambda: raw.banner()["mode"] == "relax")
    time = number(raw, "time")
    raw.set("Scenario", "free")
    until(lambda: number(raw, "time") < time and raw.banner()["mode"] == "idle")


def test_a_device_that_is_not_there_is_refused_before_anything_is_served() -> None:
    with pytest.raises(DeviceError, match="cuda:99"):
        Page("free", Access(port=0), device="cuda:99", say=lambda _: None)


@pytest.fixture
def broken() -> Iterator[Page]:
    page = Page("free", Access(port=0), settings={"task.centre": (1.2, 1.2, 1.2)}, say=lambda _: None)
    page.start()
    yield page
    page.close()


def test_cell_that_fails_leaves_the_page_standing(broken: Page) -> None:
    client = VClient(broken.server.get_port())
    until(client.ready.is_set)
    until(lambda: client.banner()["mode"] == "failed")
    assert "cannot reach" in client.text()
    client.click("STOP (Esc)")
    until(lambda: "not running" in client.text())
    client.set("Simulation", "Reset")
    until(lambda: client.banner()["mode"] == "failed")
    client.close()
