"""Frames before they are asked for: a tape tells what each camera will see next, so a second core renders it meanwhile."""

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hrc.cell.clock import Rate
from hrc.errors import SensorError
from hrc.executor import Executor, Pending
from hrc.messages import Body, DepthFrame
from hrc.sim.depth_camera import DepthCamera, SensorConfig

Array = NDArray[np.float64]
Scene = tuple[Array, tuple[Body, ...]]
"""Poses of the links (8, 4, 4), and the obstacles."""
Image = NDArray[np.float32]


class ForeseenCamera:
    """A simulated camera whose scenes are known beforehand; its frames have the bits that they have without this.

    scenes: by step, of whichever camera takes a frame there. rate: at which this one does. step: tells the number of the one
    being taken. executor: does the rendering, for all cameras of a cell. While it is at work, nobody else may launch or capture
    what touches a camera's buffers; Warp runs kernels of two threads on a CPU at the same time as long as none of them uses its
    tiles, which share one buffer.
    """

    def __init__(self, camera: DepthCamera, scenes: Mapping[int, Scene], rate: Rate, step: Callable[[], int],
                 executor: Executor) -> None:
        self._camera, self._scenes, self._rate, self._step, self._executor = camera, scenes, rate, step, executor
        steps = sorted(scenes)
        self._after = dict(itertools.pairwise(steps))
        self._number = 0
        self._coming: tuple[int, Pending[Image]] | None = None

    def configure(self, config: SensorConfig) -> None:
        """Take changed live parameters; what was rendered with the others is dropped."""
        self._executor.idle()
        self._coming = None
        self._camera.configure(config)

    def move(self, T_world_camera: Array) -> None:
        """Stand elsewhere; what was rendered from where it stood is dropped."""
        self._executor.idle()
        self._coming = None
        self._camera.move(T_world_camera)

    def expose(self, tick: int, T_world_link: Array, bodies: Sequence[Body]) -> bool:
        """Take a frame; whether it will come. Raises SensorError as the camera does."""
        step, coming = self._step(), self._coming
        if coming is not None and coming[0] == step:
            image = coming[1]()
        else:
            self._executor.idle()
            image = self._camera.render(self._number, T_world_link, bodies)
        self._number += 1
        then = self._after.get(step)
        while then is not None and not self._rate.due(tick + then - step):
            then = self._after.get(then)
        if then is not None:
            number, scene = self._number, self._scenes[then]
            self._coming = then, self._executor.do(lambda: self._camera.render(number, *scene))
        return self._camera.keep(tick, image)

    def latest(self, tick: int) -> DepthFrame | None:
        """The newest frame that has arrived."""
        return self._camera.latest(tick)

    def sees(self, _p_world: Array) -> bool:
        """Unknown here, where another frame may be half drawn; the tape holds what there is."""
        raise SensorError("a camera that renders ahead knows nothing of the present truth")
