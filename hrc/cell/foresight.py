"""Frames before they are asked for: a tape tells what each camera will see next, so a second core renders it meanwhile."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for

import numpy as np
from numpy.typing import NDArray

from hrc.cell.clock import Rate
from hrc.errors import SensorError
from hrc.messages import Body, DepthFrame
from hrc.sim.depth_camera import DepthCamera, SensorConfig

Array = NDArray[np.float64]
Scene = tuple[Array, tuple[Body, ...]]
"""Poses of the links (8, 4, 4), and the obstacles."""
Image = NDArray[np.float32]


class Ahead:
    """The thread that renders, one for all cameras of a cell.

    Warp runs kernels of two threads on a CPU at the same time as long as none of them uses its tiles, which share one buffer.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "ahead")
        self._running: list[Future[Image]] = []

    def begin(self, render: Callable[[], Image]) -> "Future[Image]":
        """Render as soon as what was begun before is done."""
        self._running = [image for image in self._running if not image.done()]
        self._running.append(self._pool.submit(render))
        return self._running[-1]

    def wait(self) -> None:
        """Until nothing is being rendered: nobody else may launch or capture what touches a camera's buffers before."""
        wait_for(self._running)


class ForeseenCamera:
    """A simulated camera whose scenes are known beforehand; its frames have the bits that they have without this.

    scenes: by step, of whichever camera takes a frame there. rate: at which this one does. step: tells the number of the one
    being taken.
    """

    def __init__(self, camera: DepthCamera, scenes: Mapping[int, Scene], rate: Rate, step: Callable[[], int],
                 ahead: Ahead) -> None:
        self._camera, self._scenes, self._rate, self._step, self._ahead = camera, scenes, rate, step, ahead
        steps = sorted(scenes)
        self._after = dict(itertools.pairwise(steps))
        self._number = 0
        self._coming: tuple[int, Future[Image]] | None = None

    def configure(self, config: SensorConfig) -> None:
        """Take changed live parameters; what was rendered with the others is dropped."""
        self._ahead.wait()
        self._coming = None
        self._camera.configure(config)

    def move(self, T_world_camera: Array) -> None:
        """Stand elsewhere; what was rendered from where it stood is dropped."""
        self._ahead.wait()
        self._coming = None
        self._camera.move(T_world_camera)

    def expose(self, tick: int, T_world_link: Array, bodies: Sequence[Body]) -> bool:
        """Take a frame; whether it will come. Raises SensorError as the camera does."""
        step, coming = self._step(), self._coming
        if coming is not None and coming[0] == step:
            image = coming[1].result()
        else:
            self._ahead.wait()
            image = self._camera.render(self._number, T_world_link, bodies)
        self._number += 1
        then = self._after.get(step)
        while then is not None and not self._rate.due(tick + then - step):
            then = self._after.get(then)
        if then is not None:
            number, scene = self._number, self._scenes[then]
            self._coming = then, self._ahead.begin(lambda: self._camera.render(number, *scene))
        return self._camera.keep(tick, image)

    def latest(self, tick: int) -> DepthFrame | None:
        """The newest frame that has arrived."""
        return self._camera.latest(tick)

    def sees(self, _p_world: Array) -> bool:
        """Unknown here, where another frame may be half drawn; the tape holds what there is."""
        raise SensorError("a camera that renders ahead knows nothing of the present truth")
