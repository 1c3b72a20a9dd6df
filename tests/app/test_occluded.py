"""Pushes from behind, by a hand that only force stops: the reflex, and where the joints alone say that it is."""

from collections.abc import Iterator

import numpy as np
import pytest

from hrc import meshes
from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.errors import EventError
from hrc.events import Press
from hrc.messages import Snapshot
from hrc.parameters import replaced

NOTHING_SEEN = replaced(Config(), "tracker.reach", 0.0)
"""What vision sees gives a contact no place; the residual may."""
REFLEX_ALONE = replaced(NOTHING_SEEN, "tracker.felt_radius", 0.0)
BEGIN, FIRM = 300, 8.0
"""Tick at which a hand sets out; force [N] above which a contact is judged."""


def presses(config: Config, links: tuple[int, ...], seed: int) -> Iterator[tuple[Press, float]]:
    """Pushes along the normal at random points of the surface that faces away from the camera: 0.25 m/s, 10 cm deep,
    1000 N/m, at most 200 N; and the part 0..1 of such a force that the joints feel with more than 0.2 m of lever."""
    rng = np.random.default_rng(seed)
    cell = Cell(config)
    for _ in range(BEGIN + 600):
        snapshot = cell.step()
    terms = cell._dynamics.terms(snapshot.state.q, snapshot.state.dq)
    while True:
        for link in links:
            mesh, T = meshes.robot("perception")[link], terms.T_world_link[link]
            corners = mesh.vertices[mesh.faces]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = np.linalg.norm(normals, axis=1)
            k = int(rng.choice(len(area), p=area / area.sum()))
            point, inward = corners[k].mean(axis=0), -normals[k] / area[k]
            p, d = T[:3, :3] @ point + T[:3, 3], T[:3, :3] @ inward
            if d @ (np.array(config.camera.eye) - p) < 0.2:  # it faces the camera
                continue
            U, S, _ = np.linalg.svd(terms.J_contact(link, p))
            x, y, z = (point + 0.03 * inward).tolist()
            u, v, w = (d / np.linalg.norm(d)).tolist()
            yield (Press("hand", link, (x, y, z), (u, v, w), 0.25, 0.10, 0.5, 1000.0, 200.0, approach=0.6),
                   float(np.linalg.norm(U[:, S > 0.2].T @ d)))


def pushed(config: Config, press: Press) -> list[Snapshot]:
    """Control ticks of the push with a firm force; none where the hand has no room to begin."""
    cell = Cell(config)
    for _ in range(BEGIN):
        cell.step()
    try:
        cell.apply(press)
    except EventError:
        return []
    steps = (cell.step() for _ in range(1600))
    return [s for s in steps if s.fresh_control and np.linalg.norm(s.truth.F_world) > FIRM]


@pytest.mark.parametrize("seed", [0, 1])
def test_the_reflex_keeps_an_unseen_push_on_the_forearm_below_80_n(seed):
    """Where the joints feel the push; along the unobservable direction of the elbow no reflex can."""
    judged = 0
    for press, felt in presses(REFLEX_ALONE, (4,), seed):
        ticks = pushed(REFLEX_ALONE, press) if felt > 0.9 else []
        if not ticks or any(s.truth.visible for s in ticks):
            continue
        assert all(s.contact is None for s in ticks)
        assert max(float(np.linalg.norm(s.truth.F_world)) for s in ticks) <= 80.0
        judged += 1
        if judged == 3:
            return


def test_the_joints_tell_link_and_place_of_what_is_not_seen():
    right, errors = [], []
    for press, _ in presses(NOTHING_SEEN, (4, 5, 6), 0):
        ticks = pushed(NOTHING_SEEN, press)
        if not ticks or any(s.truth.visible for s in ticks):
            continue
        found = [s for s in ticks if s.contact is not None]
        right.append(np.mean([s.contact.link == s.truth.link for s in found]) > 0.5 if found else False)
        errors.append(np.median([np.linalg.norm(s.contact.p_world - s.truth.p_world) for s in found]) if found else np.inf)
        if len(right) == 15:
            break
    assert np.mean(right) >= 0.8
    assert np.median(errors) <= 0.06
