"""Laws of the convergence: bounded, the same for any chunking, saved with the state; its end is what is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from blocks_at_rest import DELTAS, report_of
from blocks_at_rest import block as six_axes

from imumon.model.coefficients import Estimate
from imumon.model.report import Report, from_json
from imumon.model.report_json import to_json
from imumon.model.samples import SampleBlock, selected
from imumon.model.units import YEAR
from imumon.noise.fit import ChannelFit
from imumon.noise.fit.statement import pending_fit
from imumon.record import Record, RecordOptions
from imumon.record.convergence import FIRST_DUE_S, MOST_POINTS, StatementLog, next_due_s

RATE = 100
WITH_CONVERGENCE = RecordOptions(convergence=True)


def block(n: int, start: int = 0) -> SampleBlock:
    """Return samples of two axes: each axis more costs as much as all else."""
    whole = six_axes(n, start)
    return replace(whole, stream=replace(DELTAS, channels=("gyro/x", "gyro/y")), values=whole.values[:, :2])


def fed(samples: SampleBlock, chunk: int, monitor: Record | None = None) -> Record:
    monitor = monitor or Record()
    for start in range(0, len(samples), chunk):
        monitor.feed(selected(samples, slice(start, start + chunk)))
    return monitor


def stated(value: float) -> ChannelFit:
    part = Estimate(value=value, low=0.9 * value, high=1.1 * value, status="measured")
    return replace(pending_fit(0, "too short"), coefficients={"N": part, "B": Estimate(), "K": Estimate()})


def test_the_points_are_bounded_and_each_is_the_last_one_of_its_cell() -> None:
    convergence, lengths = StatementLog(1), np.geomspace(0.01, 1000.0 * YEAR, 5000)
    for number, length in enumerate(lengths.tolist()):
        convergence.add(length, [stated(float(number))])
    part = convergence.of_channel(0)
    assert len(part.elapsed_s) == MOST_POINTS <= 64
    assert part.elapsed_s[-1] == lengths[-1]
    assert part.coefficients["N"].value[-1] == len(lengths) - 1
    assert set(part.coefficients["B"].status) == {"pending"}
    assert "M" not in part.coefficients


def test_the_last_point_is_what_is_stated_now() -> None:
    monitor = fed(block(30 * RATE), 777)
    report_of(monitor)
    fed(block(20 * RATE, 30 * RATE), 777, monitor)
    for state in ("running", "stopped"):
        for channel in report_of(monitor, state).channels.values():  # type: ignore[arg-type]
            for letter, series in channel.convergence.coefficients.items():
                now = channel.estimates[letter]
                last = (series.value[-1], series.low[-1], series.high[-1], series.status[-1])
                assert last == (now.value, now.low, now.high, now.status)
    assert channel.convergence.elapsed_s == (30.0, 50.0)
    current = report_of(monitor)
    assert from_json(Report, to_json(current)) == current


def test_a_record_for_a_document_has_a_point_at_each_doubling_for_any_chunking() -> None:
    samples = block(150 * RATE)
    one, other = (fed(samples, chunk, Record(WITH_CONVERGENCE)) for chunk in (97, 50_000))
    for monitor in (one, other):
        monitor.flush()
    first, second = report_of(one, "stopped"), report_of(other, "stopped")
    part = first.channels["gyro/x"].convergence
    assert part.elapsed_s == (60.0, 120.0, 150.0)
    for name, channel in first.channels.items():
        mine, twin = channel.convergence, second.channels[name].convergence
        assert mine.elapsed_s == twin.elapsed_s
        for letter, series in mine.coefficients.items():
            same = twin.coefficients[letter]
            assert series.status == same.status
            for numbers in ("value", "low", "high"):
                pair = [np.array(getattr(each, numbers), dtype=float) for each in (series, same)]
                # the kurtosis, which widens N at the last point, adds up chunk by chunk
                np.testing.assert_allclose(*pair, rtol=1e-12)


def test_the_next_length_is_a_doubling_and_beyond_the_present_one() -> None:
    for length in np.geomspace(1.0, YEAR, 50).tolist():
        due = next_due_s(length)
        assert due == FIRST_DUE_S or length < due <= 2.0 * length
        assert np.log2(due / FIRST_DUE_S) % 1.0 == 0.0
