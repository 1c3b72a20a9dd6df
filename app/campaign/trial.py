"""What an episode is made of: every parameter of the cell, and of the situation that it is put into."""

from dataclasses import dataclass, field, fields

from hrc.config import Config
from hrc.errors import ConfigError
from hrc.messages import LINKS
from hrc.parameters import Parameters, param

PROFILES = ("step", "ramp", "hold", "tap", "wiggle")
SHAPES = ("sphere", "capsule", "box")
ANY = "any"


@dataclass(frozen=True)
class SituationConfig(Parameters):
    """Who touches the robot where, in which direction, and how hard. Ranges are drawn from anew in each episode."""

    by: str = param("hand", options=("hand", "obstacle"))
    """hand: a force on one point, whatever the robot does. obstacle: a body of the scene that is pressed against it."""
    contacts: int = param(1, low=1, high=2)
    """Contacts at the same time, on different links; the second is always an obstacle."""
    surface: str = param("whole", options=("whole", "visible"))
    """Where: uniform by area over the whole free surface of the links, or over what a camera sees of it."""
    first_link: int = param(3, low=1, high=len(LINKS) - 1)
    """The first link that is touched."""
    last_link: int = param(7, low=1, high=len(LINKS) - 1)
    """The last one."""
    posture: str = param("task", options=("task", "random"))
    """task: as the task has it. random: standing still in a posture drawn within the joint limits, clear of everything."""
    spread: float = param(0.7, low=0.05, high=0.95)
    """Random postures are drawn uniformly from this part of each joint's range, around its middle."""
    force_low: float = param(10.0, low=1.0, high=150.0, unit="N")
    """The size of the force is drawn uniformly from here ..."""
    force_high: float = param(40.0, low=1.0, high=150.0, unit="N")
    """... to here; of an obstacle it is what its drive is limited to."""
    friction: float = param(0.58, low=0.0, high=2.0)
    """Coefficient of friction: the force's direction is drawn uniformly from the cone around the inward normal."""
    profile: str = param("hold", options=(*PROFILES, ANY))
    """How the force of a hand goes on: step, at once; ramp, linear until it ends; hold, full after 0.1 s; tap, 60 ms; wiggle,
    swelling and ebbing by a quarter at 2 Hz; any, one of these."""
    shape: str = param(ANY, options=(*SHAPES, ANY))
    """Which of the scene's obstacles; they keep their axes along the world's."""
    stiffness_low: float = param(500.0, low=1.0, high=5000.0, unit="N/m")
    """The stiffness of an obstacle's drive is drawn uniformly from here ..."""
    stiffness_high: float = param(3000.0, low=1.0, high=5000.0, unit="N/m")
    """... to here."""
    speed: float = param(0.2, low=0.01, high=1.0, unit="m/s")
    """How fast an obstacle presses."""
    settle: float = param(0.5, low=0.05, high=60.0, unit="s")
    """Time before the contact: the camera's first images come after 0.1 s."""
    held: float = param(0.7, low=0.02, high=60.0, unit="s")
    """How long the contact lasts; of an obstacle, after it has been pressed as far as it goes."""
    after: float = param(0.2, low=0.0, high=60.0, unit="s")
    """Time after it."""
    judged_from: float = param(0.3, low=0.0, high=60.0, unit="s")
    """Force and place are judged from so long after the beginning of the contact: 7.5 times the residual's memory."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for low, high in (("first_link", "last_link"), ("force_low", "force_high"), ("stiffness_low", "stiffness_high")):
            if getattr(self, low) > getattr(self, high):
                raise ConfigError(f"{low} must not be above {high}, {getattr(self, high):g}; it is {getattr(self, low):g}")
        if self.contacts == 2 and self.first_link == self.last_link:
            raise ConfigError("two contacts need two links; first_link and last_link are the same")


@dataclass(frozen=True)
class Trial(Config):
    """A config with a situation."""

    situation: SituationConfig = field(default_factory=SituationConfig)
    """What happens to the robot."""

    @property
    def config(self) -> Config:
        """Without the situation: what a cell is built from."""
        return Config(**{f.name: getattr(self, f.name) for f in fields(Config)})

    @classmethod
    def of(cls, config: Config) -> "Trial":
        """A config with the default situation."""
        return cls(**{f.name: getattr(config, f.name) for f in fields(Config)})
