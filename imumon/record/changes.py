"""Changes of a sensor as fields of a report: against the hours before, and against a saved report."""

from __future__ import annotations

from collections.abc import Mapping

from imumon.model.report import Against, Change, Channel, Report
from imumon.model.samples import ChannelName
from imumon.noise.fit import ChannelFit
from imumon.noise.stretches.change import LEAST_CHANGE, CoefficientChange, detect_changes

HOURS_BEFORE: Against = "hours before"
FIRST_HALF: Against = "first half"
BASELINE: Against = "baseline"


def changes_by_column(
    changes: Mapping[int, tuple[CoefficientChange, ...]], against: Against
) -> dict[int, tuple[Change, ...]]:
    """Return the changes of an hour, or of the second half, against what was before it."""
    return {
        column: tuple(_reported(change, against) for change in of_column)
        for column, of_column in changes.items()
    }


def compare_with_report(baseline: Report, name: ChannelName, now: ChannelFit | Channel) -> list[Change]:
    """Return what differs between a channel of a saved report and the present noise of the same channel."""
    channel = baseline.channels.get(name)
    if channel is None:  # the saved report is of a stream without it: nothing is compared
        return []
    pairs = len(baseline.channels) * len(LEAST_CHANGE)
    changes = detect_changes(channel.coefficients, now.coefficients, pairs=pairs)
    return [_reported(change, BASELINE) for change in changes]


def _reported(change: CoefficientChange, against: Against) -> Change:
    return Change(
        against=against,
        quantity=change.letter,
        before=change.before,
        now=change.now,
        ratio=change.ratio,
        sigma=change.sigma,
        p_value=change.p_value,
    )
