"""Under a push that stays, an abandoned task ends where Eq. (6) says: the contact point has given way by F / K_e."""

import numpy as np
import pytest

from hrc.cell.cell import Cell
from hrc.config import Config
from hrc.events import Push
from hrc.messages import Mode


@pytest.mark.parametrize(("link", "point", "force"), [
    (4, (0.0, 0.0, 0.1), (0.0, 40.0, 0.0)), (5, (0.0, -0.03, -0.1), (0.0, -35.0, 0.0)), (6, (0.0, 0.0, 0.0), (0.0, 20.0, 40.0)),
])
def test_the_contact_point_gives_way_as_a_spring(link, point, force):
    """With the true force, on the realistic robot, whose estimate has friction and a wrong model in it: within 15 %."""
    cell = Cell(Config())
    for _ in range(1500):
        cell.step()
    cell.apply(Push(link, point, force))
    for _ in range(4000):
        s = cell.step()
    assert s.command.mode is Mode.ABORT
    expected = np.array(force) / cell.config.control.k_e
    assert np.linalg.norm(-s.command.admittance_error - expected) <= 0.15 * np.linalg.norm(expected)
