"""Several records: those of one sensor as one measurement, or those of several sensors side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from imumon.api.curve_table import frame_of
from imumon.api.measurement import Measurement
from imumon.model.coefficients import Estimate, coefficient_ratio
from imumon.model.errors import ImumonError
from imumon.model.samples import ChannelName
from imumon.record.record_combination import combined_report

if TYPE_CHECKING:
    import pandas


def combine(measurements: Sequence[Measurement]) -> Measurement:
    """Return N, B, K and M of one sensor from several of its records, of any rate, length and day.

    The limits hold the scatter between the records: they are for the sensor, and not for the hours of one record.

    Raises
    ------
    ImumonError : there are fewer than two, they are of different sensors, or have no channel in common.
    """
    records = list(measurements)
    wrong = next((record for record in records if not isinstance(record, Measurement)), None)
    if wrong is not None:
        text = f"{type(wrong).__name__} is no measurement"
        raise ImumonError("no_measurement", text, "combine results of imumon.analyse or imumon.load")
    report = combined_report([record.report for record in records], datetime.now(UTC))
    notes = dict.fromkeys(note for record in records for note in record.notes)
    return Measurement(report, tuple(notes))


def compare(measurements: Mapping[str, Measurement]) -> pandas.DataFrame:
    """Return the coefficients of several measurements side by side, a row for each channel and coefficient.

    Columns have two levels: the name of the measurement, and `value`, `low` and `high` (the limits that documents
    print), `status`, and behind the first one `ratio` to it and `differs`, whether the 95 % limits rule out that both
    are equal.

    Raises
    ------
    ImumonError : there is none, or pandas is not installed.
    """
    if not measurements or not all(isinstance(m, Measurement) for m in measurements.values()):
        cure = "give measurements by name, such as {'A': a, 'B': b}"
        raise ImumonError("no_measurement", "there is no measurement to compare", cure)
    keys = dict.fromkeys(
        (channel, letter)
        for m in measurements.values()
        for channel, part in m.report.channels.items()
        for letter in part.estimates
    )
    rows = [_compared(measurements, channel, letter) for channel, letter in keys]
    frame = frame_of([{str(k): value for k, value in enumerate(row.values())} for row in rows])
    if rows:
        import pandas

        frame.columns = pandas.MultiIndex.from_tuples(list(rows[0]))
        frame = frame.set_index([("", "channel"), ("", "coefficient")]).rename_axis(
            ["channel", "coefficient"]
        )
    return frame


def _compared(
    measurements: Mapping[str, Measurement], channel: str, letter: str
) -> dict[tuple[str, str], object]:
    """Return the row of a coefficient, which at least one measurement has, by the two levels of its columns."""
    parts = {name: _estimate(m, channel, letter) for name, m in measurements.items()}
    unit = next(part.unit for part in parts.values() if part is not None)
    row: dict[tuple[str, str], object] = {
        ("", "channel"): channel,
        ("", "coefficient"): letter,
        ("", "unit"): unit,
    }
    first = next(iter(parts))
    for name, part in parts.items():
        low, high = (None, None) if part is None else part.interval
        row |= {(name, "value"): part and part.value, (name, "low"): low, (name, "high"): high}
        row[name, "status"] = part and part.status
        if name != first:
            row[name, "ratio"], row[name, "differs"] = _ratio_and_difference(parts[first], part)
    return row


def _ratio_and_difference(
    reference: Estimate | None, part: Estimate | None
) -> tuple[float | None, bool | None]:
    """Return the ratio of a coefficient to the reference, and whether they differ; None: unknown, or only a limit."""
    ratio = None if part is None or reference is None else coefficient_ratio(reference, part)
    if ratio is None:
        return None, None
    return ratio.value if ratio.relation == "=" else None, ratio.differs


def _estimate(measurement: Measurement, channel: str, letter: str) -> Estimate | None:
    part = measurement.report.channels.get(ChannelName(channel))
    return None if part is None else part.estimates.get(letter)
