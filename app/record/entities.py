"""The entities of a recorded session: their paths, colours and styles. docs/recording.md lists them for readers."""

from hrc.messages import LINKS, Mode

WORLD = "/world"
ENVIRONMENT = "/world/environment"
ROBOT = "/world/robot"
OBSTACLES = "/world/obstacles"
PULL = "/world/pull"
REFERENCE = "/world/ee_desired"
CAMERA = "/world/camera"
DEPTH = "/world/camera/depth"
LINK_IDS = "/world/camera/links"
NEAREST = "/world/contact/nearest"
POINT_EST, FORCE_EST = "/world/contact/point_est", "/world/contact/force_est"
POINT_TRUE, FORCE_TRUE = "/world/contact/point_true", "/world/contact/force_true"
SIGNALS = "/signals"
STATE = "/state/mode"
EVENTS = "/events"
PARAMETERS = "/session/parameters"

METRES_PER_NEWTON = 0.01
"""Length of a force arrow."""

ESTIMATE, TRUTH, SIGHT = (255, 90, 60), (80, 220, 120), (90, 180, 255)
TOUCHED = (230, 40, 40)
AXES = ((240, 80, 80), (90, 210, 90), (90, 150, 255))
JOINTS = ((94, 174, 255), (255, 160, 64), (110, 210, 110), (240, 90, 90), (180, 130, 255), (200, 160, 120),
          (255, 140, 200))
MODES = {
    Mode.IDLE: (96, 125, 139), Mode.RELAX: (67, 160, 71), Mode.ABORT: (229, 57, 53), Mode.UNSEEN: (251, 140, 0),
    Mode.STOP: (183, 28, 28),
}
LINK_CLASSES = (
    (0, LINKS[0], (130, 130, 130, 255)),
    *((link, LINKS[link], (*JOINTS[link - 1], 255)) for link in range(1, 8)),
    (255, "no robot", (0, 0, 0, 0)),
)


def dimmed(colour: tuple[int, int, int]) -> tuple[int, int, int]:
    """The darker twin of a colour, for the truth beside an estimate or a reference beside a measurement."""
    red, green, blue = colour
    return red // 2 + 20, green // 2 + 20, blue // 2 + 20


def bytes_of(rgb: tuple[float, ...]) -> tuple[int, ...]:
    """A colour 0..255 from a colour 0..1."""
    return tuple(round(255 * channel) for channel in rgb)
