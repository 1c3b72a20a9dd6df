"""Depth images out of a recording, in the order in which they were taken, decoded ahead on a thread of their own."""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from app.record import entities, png
from app.record.folder import SessionError

_AHEAD = 8
MILLIMETRE = np.float32(0.001)
"""Depth is recorded in whole millimetres: without loss if the camera measures in these."""


class RecordedImages:
    """Gives the images of each camera one after another; use it as a context manager.

    paths: recordings (.rrd) of one session in their order.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        self._pool = ThreadPoolExecutor(1, "images")
        self._ahead: dict[str, deque[tuple[int, Future[NDArray[np.float32]]]]] = {}
        self._left: dict[str, Iterator[tuple[int, bytes]]] = {}

    def __enter__(self) -> "RecordedImages":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def __call__(self, camera: str, step: int) -> NDArray[np.float32]:
        """The depth image [m] (H, W) that was taken after this many steps. Raises SessionError if it was not kept."""
        if camera not in self._left:
            self._left[camera], self._ahead[camera] = blobs(self._paths, camera), deque()
        ahead = self._ahead[camera]
        while len(ahead) < _AHEAD and (following := next(self._left[camera], None)) is not None:
            ahead.append((following[0], self._pool.submit(metres, following[1])))
        while ahead and ahead[0][0] < step:
            ahead.popleft()
            if (following := next(self._left[camera], None)) is not None:
                ahead.append((following[0], self._pool.submit(metres, following[1])))
        if not ahead or ahead[0][0] != step:
            raise SessionError(f'the recording has no image of camera "{camera}" at step {step}; '
                               "it must have been made with --depth full")
        return ahead[0][1].result()


def blobs(paths: Sequence[Path], camera: str) -> Iterator[tuple[int, bytes]]:
    """The depth images of a camera in their order: (step, PNG)."""
    entity, component = entities.depth(camera), "EncodedDepthImage:blob"
    for path in paths:
        for chunk in RrdReader(str(path)).stream().filter(content=[entity]):
            if chunk.entity_path != entity or chunk.is_static:
                continue
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                found = batch.column(component).flatten()
                yield from sorted(zip(batch.column("step").to_pylist(),
                                      (blob.values.to_numpy().tobytes() for blob in found), strict=True))


def metres(blob: bytes) -> NDArray[np.float32]:
    """A recorded depth image [m] (H, W), +inf where nothing was measured."""
    image = png.decode(blob)
    return np.where(image > 0, image * MILLIMETRE, np.float32(np.inf))
