"""What viser does with less work is what it did before."""

from dataclasses import dataclass

import numpy as np
import pytest
import viser._messages as messages
from viser import _scene_handles
from viser.infra._messages import Message

from app.serve import lean

stock = Message.as_serializable_dict


@dataclass
class Made:
    message: Message
    fresh: Message

    def ready(self, there=()):
        buffers = [memoryview(b"") for _ in there]
        return self.message.as_serializable_dict(buffers), buffers

    def by_viser(self, there=()):
        buffers = [memoryview(b"") for _ in there]
        return getattr(stock, "__wrapped__", stock)(self.fresh, buffers), buffers


def both(make):
    lean.install()
    return Made(make(), make())


def test_a_pose_is_made_ready_once():
    made = both(lambda: messages.SetPositionMessage("/robot/link_3", (0.1, np.float64(0.2), 0.3)))
    first, again = made.ready()[0], made.ready(there=range(3))[0]
    assert first == made.by_viser()[0]
    assert again is first


def test_arrays_are_numbered_anew_for_each_visitor():
    made = both(lambda: messages.SceneNodeUpdateMessage("/cloud", {"points": np.ones((4, 3), np.float32)}))
    for there in (range(0), range(2), range(1)):
        (found, buffers), (expected, theirs) = made.ready(there), made.by_viser(there)
        assert found == expected
        assert [bytes(b) for b in buffers] == [bytes(b) for b in theirs]
        assert len(buffers) == len(there) + 1


def test_what_creates_a_thing_is_as_the_thing_is_now():
    props = messages.FrameProps(True, 0.1, 0.01, 0.01, (1, 2, 3), 1.0)
    lean.install()
    message = messages.FrameMessage("/frame", props)
    message.as_serializable_dict([])
    props.axes_length = 0.2
    assert message.as_serializable_dict([])["props"]["axes_length"] == 0.2


def told(old: list[float], new: np.ndarray) -> list[tuple[float, float, float]]:
    """What is sent when a thing that is at one place is put at another."""
    current, sent = np.array(old), list[messages.SetPositionMessage]()
    _scene_handles._set_pose_vector(current, new, 3, sent.append,  # pyright: ignore
                                    lambda place: messages.SetPositionMessage("/x", place))  # pyright: ignore
    if sent:
        np.testing.assert_array_equal(current, new)
    return [message.position for message in sent]


@pytest.mark.parametrize("change", [0.0, 5e-9, 2e-8, 1e-6, 4e-6, 6e-6, -1e-3, 1.0, np.nan])
@pytest.mark.parametrize("old", [[0.5, -0.2, 0.6], [0.0, 0.0, 0.0]])
def test_a_pose_is_told_where_numpy_says_that_it_is_another(old, change):
    lean.install()
    new = np.array(old)
    new[2] += change
    assert told(old, new) == ([] if np.allclose(new, old) else [pytest.approx(new, nan_ok=True)])


def test_a_pose_of_the_wrong_length_is_refused():
    lean.install()
    with pytest.raises(ValueError, match="Expected vector"):
        told([0.0, 0.0, 0.0], np.zeros(4))
