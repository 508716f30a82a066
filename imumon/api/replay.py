"""Replay: a recording as samples of a record, as in the daemon.

Time is that of the recording; nothing waits unless a pace is given.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from imumon.api.replay_options import ReplayOptions
from imumon.api.replayed_record import ReplayedRecord
from imumon.model import report
from imumon.model.samples import SampleBlock

if TYPE_CHECKING:  # arrays need no bus
    from imumon.bus import Publisher


def replay(
    options: ReplayOptions,
    *,
    progress: Callable[[float | None, float], None] | None = None,
    bus: Publisher | None = None,
    remark: Callable[[str], None] = lambda text: None,
) -> report.Report:
    """Feed a record with a recording and return the final report.

    Parameters
    ----------
    progress : called after each block with the share of the file that is done and the s of the recording.
    bus : publishes a report every period.
    remark : called with one line each about what is doubtful in the recording, and why it ended early.

    Raises
    ------
    RecordingError : the file cannot be read, or has no samples. RateRequired : its stream has no clock.
    """
    recording = options.open()
    run = ReplayedRecord(options, recording)
    begun, due = time.monotonic(), 0.0
    for items in recording:
        for item in items:
            if isinstance(item, SampleBlock):
                run.record.feed(item)
            else:
                run.gap(item)
        if progress is not None:
            progress(recording.progress, run.elapsed_s)
        if bus is not None and time.monotonic() >= due:
            due = time.monotonic() + run.record.options.period_s
            run.publish(bus, "running")
        if options.pace is not None:
            ahead_s = options.pace.to_host_s(run.elapsed_s) - (time.monotonic() - begun)
            time.sleep(max(0.0, ahead_s))
    final = run.final()
    for text in final.device.remarks:
        remark(f"{options.name}: {text}")
    if recording.problem is not None:
        remark(recording.problem)
    if bus is not None:
        run.publish(bus, "stopped")
    return final
