"""The entities of a recorded session: their paths, colours and styles. docs/recording.md lists them for readers."""

import rerun as rr

from app import palette
from hrc.messages import LINKS, Mode

WORLD = "/world"
ENVIRONMENT = "/world/environment"
ROBOT = "/world/robot"
OBSTACLES = "/world/obstacles"
PULL = "/world/pull"
REFERENCE = "/world/ee_desired"
DISTANCES = "/world/distances"
CAMERAS = "/world/cameras"
NEAREST = "/world/contact/nearest"
TOUCHES = "/world/contact/touches"
POINT_EST, FORCE_EST = "/world/contact/point_est", "/world/contact/force_est"
POINT_TRUE, FORCE_TRUE = "/world/contact/point_true", "/world/contact/force_true"
SIGNALS = "/signals"
FORCE_PLOT, RESIDUAL_PLOT, PERIOD_PLOT = "/plots/force", "/plots/residual", "/plots/period"
REPLAY = "/replay"
REPLAYED_FORCE_PLOT = "/replay/plots/force"
REPLAYED_STATE = "/state/replayed"
STATE = "/state/mode"
CAMERA_STATES = "/state/cameras"
EVENTS = "/events"
PARAMETERS = "/session/parameters"

METRES_PER_NEWTON = 0.01
"""Length of a force arrow."""

ESTIMATE, TRUTH, SIGHT = (255, 90, 60), (80, 220, 120), (90, 180, 255)
F_RELAX, F_ABORT = (204, 133, 14), (160, 95, 220)
TOUCHED = (230, 40, 40)
AXES = ((240, 80, 80), (90, 210, 90), (90, 150, 255))
JOINTS = palette.LINKS[1:]
MODES = {
    Mode.IDLE: (96, 125, 139), Mode.RELAX: (67, 160, 71), Mode.ABORT: (229, 57, 53), Mode.UNSEEN: (251, 140, 0),
    Mode.BLIND: (47, 93, 138), Mode.STOP: (183, 28, 28),
}
DELIVERS, SILENT = "delivers", "silent"
CAMERA_COLOURS = {DELIVERS: (67, 160, 71), SILENT: (47, 93, 138)}
LINK_CLASSES = (
    *((link, name, (*palette.LINKS[link], 255)) for link, name in enumerate(LINKS)),
    (255, "no robot", (0, 0, 0, 0)),
)


def camera(name: str) -> str:
    """The pinhole of a camera; its depth image and its link ids stand below it."""
    return f"{CAMERAS}/{rr.escape_entity_path_part(name)}"


def depth(name: str) -> str:
    """The depth image of a camera."""
    return f"{camera(name)}/depth"


def link_ids(name: str) -> str:
    """The links that a camera sees."""
    return f"{camera(name)}/links"


def camera_state(name: str) -> str:
    """Whether a camera delivers images."""
    return f"{CAMERA_STATES}/{rr.escape_entity_path_part(name)}"


def dimmed(colour: tuple[int, int, int]) -> tuple[int, int, int]:
    """The darker twin of a colour, for the truth beside an estimate or a reference beside a measurement."""
    red, green, blue = colour
    return red // 2 + 20, green // 2 + 20, blue // 2 + 20


def bytes_of(rgb: tuple[float, ...]) -> tuple[int, ...]:
    """A colour 0..255 from a colour 0..1."""
    return tuple(round(255 * channel) for channel in rgb)
