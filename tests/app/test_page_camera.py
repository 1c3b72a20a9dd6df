"""Carrying the depth camera about from the page, over the wire."""

import numpy as np
from vclient import VClient, until

from app.serve.main import Page
from hrc.config import Config
from hrc.geometry import look_at, quaternion_from_rotation

BOX, FRUSTUM = "Move the depth sensor", "/cameras/0"
EYE, TARGET = "/gizmos/cameras/0/eye", "/gizmos/cameras/0/target"
HOME = Config().camera


def stands(client: VClient, eye: tuple[float, ...], target: tuple[float, ...]) -> bool:
    """Whether the frustum is drawn there."""
    node, wxyz = client.nodes[FRUSTUM], quaternion_from_rotation(look_at(eye, target)[:3, :3])
    return np.allclose(node["position"], eye, atol=1e-6) and abs(np.dot(node["wxyz"], wxyz)) > 1.0 - 1e-9


def shown(client: VClient) -> bool:
    return bool(client.nodes[EYE].get("visible") and client.nodes[TARGET].get("visible"))


def test_a_gizmo_moves_the_camera_and_another_what_it_looks_at(raw: VClient) -> None:
    assert not shown(raw)
    assert stands(raw, HOME.eye, HOME.target)
    raw.set(BOX, True)
    until(lambda: shown(raw))
    np.testing.assert_allclose(raw.position(EYE), HOME.eye, atol=1e-6)
    np.testing.assert_allclose(raw.position(TARGET), HOME.target, atol=1e-6)
    eye, target = (-0.4, 1.9, 0.9), (-0.3, 0.1, 0.4)
    for part in np.linspace(0.0, 1.0, 20):
        raw.gizmo(EYE, ((1.0 - part) * np.array(HOME.eye) + part * np.array(eye)).tolist())
    until(lambda: stands(raw, eye, HOME.target))
    raw.gizmo(TARGET, target)
    until(lambda: stands(raw, eye, target))
    until(lambda: "camera camera to (-0.40, 1.90, 0.90) m, looks at (-0.30, 0.10, 0.40) m" in raw.text())
    assert raw.banner()["mode"] == "idle"
    raw.set(BOX, False)
    until(lambda: not shown(raw))
    raw.set("Simulation", "Reset")
    until(lambda: stands(raw, HOME.eye, HOME.target))
    until(lambda: np.allclose(raw.position(EYE), HOME.eye, atol=1e-6))


def test_where_it_cannot_stand_the_gizmo_goes_back(raw: VClient) -> None:
    raw.set(BOX, True)
    until(lambda: shown(raw))
    for height in (0.5, 0.6):
        raw.gizmo(EYE, (*HOME.target[:2], height))
    until(lambda: "camera cannot stand there" in raw.text())
    until(lambda: np.allclose(raw.position(EYE), HOME.eye, atol=1e-6))
    raw.gizmo(EYE, (50.0, 1.0, -9.0))
    until(lambda: stands(raw, (3.0, 1.0, 0.05), HOME.target))
    raw.set(BOX, False)


def test_it_stays_where_whoever_has_gone_left_it_and_is_the_operators_alone(served: Page, raw: VClient) -> None:
    raw.set(BOX, True)
    until(lambda: shown(raw))
    visitor = VClient(served.server.get_port())
    until(visitor.ready.is_set)
    until(lambda: shown(visitor))
    visitor.gizmo(EYE, (0.0, 2.0, 1.0))
    raw.gizmo(EYE, (-0.4, 1.9, 0.9))
    until(lambda: stands(visitor, (-0.4, 1.9, 0.9), HOME.target))
    raw.close()
    until(lambda: visitor.seat()["operator"] == "")
    time = float(visitor.banner()["time"])
    until(lambda: float(visitor.banner()["time"]) > time + 1.0)
    assert stands(visitor, (-0.4, 1.9, 0.9), HOME.target)
    visitor.set(BOX, False)
    until(lambda: not shown(visitor))
    visitor.close()
