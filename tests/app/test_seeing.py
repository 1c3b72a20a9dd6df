"""Scripted scenes for what cameras see together, and what they do not."""

import numpy as np
import pytest

from hrc.cell import scenario
from hrc.cell.cell import Cell
from hrc.cell.pace import FreeRun
from hrc.cell.run import Inbox, run
from hrc.config import PRESETS
from hrc.messages import Mode, Snapshot
from hrc.parameters import replaced

FIRM = 8.0


class Watch:
    """Keeps the control ticks with a contact worth the name."""

    def __init__(self) -> None:
        self.firm: list[Snapshot] = []

    def on_step(self, snapshot: Snapshot) -> None:
        if snapshot.fresh_control and snapshot.detected and np.linalg.norm(snapshot.truth.F_world) > FIRM:
            self.firm.append(snapshot)


def watched(name: str, preset: str, **settings: float) -> list[Snapshot]:
    script = scenario.load(name)
    config = script.configured(PRESETS[preset]())
    for key, value in settings.items():
        config = replaced(config, key.replace("__", "."), value)
    watch = Watch()
    run(Cell(config), FreeRun(), Inbox(script), [watch], until=round(1000 * script.duration))
    assert len(watch.firm) > 200
    return watch.firm


def off(s: Snapshot) -> float:
    assert s.contact is not None
    return float(np.linalg.norm(s.contact.p_world - s.truth.p_world))


def test_a_contact_hidden_from_the_camera_is_said_to_be_not_seen():
    """It may be felt where it is, in the joints; a camera's word is never given for it."""
    firm = watched("hidden", "default")
    assert not any(s.truth.visible for s in firm)
    assert not any(s.contact.seen for s in firm if s.contact is not None)
    assert not any(touch.sure for s in firm for touch in s.touches)


def test_what_is_neither_seen_nor_felt_at_a_place_is_the_state_not_seen():
    firm = watched("hidden", "default", tracker__felt_radius=0.0)
    assert all(s.contact is None for s in firm)
    assert np.mean([s.command.mode is Mode.UNSEEN for s in firm]) > 0.8


def test_a_second_camera_finds_the_contact_that_is_hidden_from_the_first():
    firm = watched("hidden", "two_cameras")
    found = [s for s in firm if s.contact is not None]
    assert len(found) > 0.95 * len(firm)
    assert all(s.contact.seen for s in found)
    assert {s.nearest.camera for s in found} == {"before"}
    assert np.median([off(s) for s in found]) < 0.03
    assert np.mean([s.contact.link == s.truth.link for s in found]) > 0.98


@pytest.mark.parametrize("seed", [0, 1])
def test_two_hands_are_two_touches_on_their_links(seed):
    script = scenario.load("two_hands")
    cell = Cell(script.configured(PRESETS["default"]()).replace(seed=seed))
    seen = []

    class Frames:
        def on_step(self, snapshot: Snapshot) -> None:
            if snapshot.fresh_frame and pressing() == {4, 6}:
                seen.append(sorted(touch.link for touch in snapshot.touches))

    def pressing() -> set[int]:
        """The links with a contact force of more than 1 N, from the plant's contacts."""
        return cell._robot.touched(1.0)

    run(cell, FreeRun(), Inbox(script), [Frames()], until=round(1000 * script.duration))
    assert len(seen) > 60
    assert np.mean([links == [4, 6] for links in seen]) >= 0.95
