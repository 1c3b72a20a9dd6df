"""Every parameter in one tree, and the presets. `F_abort = 25 N` stands once, in the class that uses it."""

from collections.abc import Callable
from dataclasses import dataclass, field

from hrc.cell.clock import RatesConfig
from hrc.contact.estimate import TrackerConfig
from hrc.contact.exposure import ExposureConfig
from hrc.contact.force import ForceConfig
from hrc.contact.friction import FrictionConfig
from hrc.contact.pair import PairConfig
from hrc.contact.proprioception import ProprioceptionConfig
from hrc.contact.residual import ObserverConfig
from hrc.contact.zero import ZeroConfig
from hrc.control.reaction import ReactionConfig
from hrc.control.reference import TaskConfig
from hrc.model import ModelConfig
from hrc.parameters import Parameters, param
from hrc.sim.depth_camera import SensorConfig
from hrc.sim.faults import FaultConfig
from hrc.sim.obstacles import ObstacleConfig
from hrc.sim.push import PushConfig
from hrc.sim.robot import PlantConfig
from hrc.vision.camera import CameraConfig
from hrc.vision.localize import VisionConfig


@dataclass(frozen=True)
class Config(Parameters):
    """The whole cell: one group for each part."""

    seed: int = param(0, low=0, high=2**31 - 1, live=False)
    """Every random number of a run comes from this seed."""
    scene: str = param("cell", live=False)
    """The scene, by its name or the path of its file: environment, obstacles, cameras."""
    rates: RatesConfig = field(default_factory=RatesConfig)
    plant: PlantConfig = field(default_factory=PlantConfig)
    fault: FaultConfig = field(default_factory=FaultConfig)
    push: PushConfig = field(default_factory=PushConfig)
    obstacle: ObstacleConfig = field(default_factory=ObstacleConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    vision: VisionConfig = field(default_factory=VisionConfig)
    observer: ObserverConfig = field(default_factory=ObserverConfig)
    zero: ZeroConfig = field(default_factory=ZeroConfig)
    friction: FrictionConfig = field(default_factory=FrictionConfig)
    proprioception: ProprioceptionConfig = field(default_factory=ProprioceptionConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    pair: PairConfig = field(default_factory=PairConfig)
    force: ForceConfig = field(default_factory=ForceConfig)
    exposure: ExposureConfig = field(default_factory=ExposureConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    control: ReactionConfig = field(default_factory=ReactionConfig)


def paper() -> Config:
    """The paper's numbers and forms where they can be run as printed.

    K_f = 0.05 m/s/N and the printed relax direction; the printed occlusion rule and window of the distance; K_a = 0.5 and
    K_e = 3.5 are read in centimetres (0.005 m/s/N, 350 N/m), which is also the default. docs/paper.md explains each.
    """
    base = Config()
    return base.replace(
        control=base.control.replace(k_f=0.05, relax_form="printed"),
        vision=base.vision.replace(mode="paper", margin=0.03),
    )


def literal() -> Config:
    """Eq. (13) and (15) to the letter, gains in SI: it chatters in every contact, which is what it is for."""
    base = paper()
    return base.replace(control=base.control.replace(
        law="printed", k_a=0.5, k_e=3.5, v_contact=50.0, ddq_max=2000.0, f_release=5.0))


def ideal() -> Config:
    """A perfect robot: no torque noise, no friction left, an exact model. The camera stays what it is."""
    base = Config()
    return base.replace(plant=base.plant.replace(torque_noise=0.0, friction_left=0.0),
                        model=base.model.replace(inertial_error=0.0))


def harsh() -> Config:
    """A robot in a bad state: half of the friction and offset left, three times the torque noise, a model 10 % off, an unknown
    payload, coarse encoders, commands up to 3 ms late, a camera three frames late and off by 0.5 deg and 1 cm.
    """
    base = Config()
    return base.replace(
        plant=base.plant.replace(torque_noise=0.01, friction_left=0.5, payload=0.3, encoder_step=5e-5, jitter=3),
        model=base.model.replace(inertial_error=0.1),
        sensor=base.sensor.replace(latency=3, extrinsic_rotation_deg=0.5, extrinsic_translation=0.01))


def two_cameras() -> Config:
    """A second depth camera, before the robot: what is hidden from the one may be seen by the other."""
    return Config(scene="two_cameras")


PRESETS: dict[str, Callable[[], Config]] = {
    "default": Config, "realistic": Config, "ideal": ideal, "harsh": harsh, "paper": paper, "literal": literal,
    "two_cameras": two_cameras}
