"""What a replay made of a session, as a recording that the viewer lays over the session's own: it has the same id."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from app.record import blueprint, entities
from app.record.signals import Columns
from app.record.writer import APPLICATION, PLOTTED, force_curves, force_styles, series, states

GIVEN = ("q", "dq", "tau", "force_true", "contact_point_true", "contact_link_true", "contact_visible", "silent_cameras")
"""Signals that are in the session already."""


def write(path: Path, recording: Path, ticks: NDArray[np.int64], columns: Columns, parameters: Mapping[str, Any], *,
          tick_ns: int, cameras: Sequence[str]) -> None:
    """Write the replayed signals and modes to `path` (.rrd), for the session recorded in `recording`.

    ticks: of the rows on the recording's clock, shape (n,). parameters: the replay's, by key. tick_ns: length of a tick of the
    base rate. cameras: by name, for the layout.
    """
    own = next(entry for entry in RrdReader(os.fspath(recording)).recordings())
    stream = rr.RecordingStream(APPLICATION, recording_id=own.recording_id, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_sinks(rr.FileSink(os.fspath(path)))
    stream.send_blueprint(blueprint.review(cameras, replayed=True))  # a default would not take the place of the session's own
    index = [rr.TimeColumn("sim_time", duration=(ticks * tick_ns).astype("timedelta64[ns]")),
             rr.TimeColumn("step", sequence=ticks.copy())]
    for signal in PLOTTED:
        if signal.name not in GIVEN:
            entity, values = f"{entities.REPLAY}/{signal.name}", columns[signal.name].astype(np.float64)
            stream.log(entity, series(signal.name, signal.width, suffix=" replayed"), static=True)
            stream.send_columns(entity, index, rr.Scalars.columns(scalars=np.where(np.isinf(values), np.nan, values)))
    truth = np.full_like(columns["force_est"], np.nan)  # it is in the session's own plot
    stream.log(entities.REPLAYED_FORCE_PLOT, force_styles("|F| replayed", "", suffix=" replayed"), static=True)
    stream.send_columns(entities.REPLAYED_FORCE_PLOT, index, rr.Scalars.columns(
        scalars=force_curves(columns["force_est"], truth, parameters)))
    stream.log(entities.REPLAYED_STATE, states({mode.value: colour for mode, colour in entities.MODES.items()}), static=True)
    mode = columns["state"]
    for i in np.flatnonzero(np.r_[True, mode[1:] != mode[:-1]]):
        stream.set_time("sim_time", duration=np.timedelta64(int(ticks[i]) * tick_ns, "ns"))
        stream.set_time("step", sequence=int(ticks[i]))
        stream.log(entities.REPLAYED_STATE, rr.StateChange(state=str(mode[i])))
    stream.flush(timeout_sec=60.0)
    stream.disconnect()
