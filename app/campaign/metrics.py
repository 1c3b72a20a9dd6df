"""The columns that an episode's record has."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A column. unit: "" for a share or a number, "bool" for yes or no. worse: whether more of it is worse."""

    unit: str
    meaning: str
    worse: bool = True


METRICS: Mapping[str, Metric] = {
    "missed": Metric("bool", "a contact that was not detected while it lasted"),
    "delay_s": Metric("s", "from the beginning of the contact until it was detected"),
    "felt_before": Metric("bool", "something was detected when the contact began, so that it has no delay"),
    "false_contacts": Metric("", "detections with nothing touching"),
    "residual_ratio": Metric("", "the most that a residual came to of its threshold, with nothing touching"),
    "located": Metric("", "share of the judged time in which the contact has a place", worse=False),
    "right_link": Metric("", "share of the time with a place in which it is on the right link", worse=False),
    "seen": Metric("", "share of the time with a place in which a camera sees it, says the cell", worse=False),
    "in_view": Metric("bool", "a camera would see the place if nothing touched it", worse=False),
    "contacts_found": Metric("", "places at the same time, in the mean over the judged time", worse=False),
    "point_error_m": Metric("m", "distance of the place from the true one, median"),
    "force_error_N": Metric("N", "length of the error of the net force, median, while there is a place"),
    "force_error_share": Metric("", "length of that error as a part of the true force"),
    "force_observable_N": Metric("N", "error of the force in the directions that the joints feel"),
    "force_blind_N": Metric("N", "error of the force in the directions that the joints do not feel"),
    "force_at_point_N": Metric("N", "error of Eq. (5) at the true point, median: what it would be if the place were known"),
    "sigma_min_m": Metric("m", "smallest singular value of the true contact Jacobian, median", worse=False),
    "force_mean_N": Metric("N", "true force, mean over the contact"),
    "force_peak_N": Metric("N", "true force, the most"),
    "relaxed": Metric("bool", "the arm gave way in its null space", worse=False),
    "aborted": Metric("bool", "the task was abandoned"),
    "reflex": Metric("bool", "the arm answered a contact without a place"),
    "mode_changes": Metric("", "changes of mode"),
    "ee_error_m": Metric("m", "largest error of the end effector while the task goes on"),
    "yield_m": Metric("m", "how far the point went along the force while it was pushed", worse=False),
    "ddq_max": Metric("rad/s2", "largest commanded joint acceleration"),
}
