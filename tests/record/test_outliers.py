"""Outliers: single samples are excluded on their sensor, and many of them are noise."""

from __future__ import annotations

import numpy as np
import pytest
from blocks_at_rest import report_of

import imumon
from imumon.documents.summary import summary_text
from imumon.model.messages import caveat_lines
from imumon.model.samples import ACCEL, GYRO, Bools, Floats, SampleBlock, Stream
from imumon.noise.detection import Guard
from imumon.record import Record

SENSORS = ("gyro",) * 3 + ("accel",) * 3
SIGMA = np.array([4e-4] * 3 + [1e-2] * 3)
RATE = 100.0


def quiet(n: int, seed: int = 1) -> Floats:
    """Return (n, 6) white noise."""
    return np.asarray(SIGMA * np.random.default_rng(seed).standard_normal((n, 6)))


def guarded(values: Floats, sensors: tuple[str, ...] = SENSORS, rate: float = RATE) -> tuple[Guard, Bools]:
    """Return the guard and (n, g) the samples that remain valid."""
    guard = Guard(sensors, rate)
    items = [item for at in range(0, len(values), 5000) for item in guard.update(values[at : at + 5000])]
    return guard, np.concatenate([item.valid for item in items + guard.flush()])


def contaminated(n: int, share: float, columns: list[int], seed: int = 2) -> Floats:
    """Return noise of which a share, in these columns, has ten times the deviation."""
    values, rng = quiet(n, seed), np.random.default_rng(seed)
    values[:, columns] *= np.where(rng.random((n, len(columns))) < share, 10.0, 1.0)
    return values


def test_rare_outliers_cost_only_themselves() -> None:
    """Of a coarse axis with noise of one step too: no motion, no margin, no other sensor."""
    values = quiet(60_000)
    values[:, 4] = np.rint(values[:, 4] / 1e-2) * 1e-2
    at = np.random.default_rng(3).choice(60_000, 120, replace=False)
    values[at, 4] += 9e-2 * np.where(at % 2, 1.0, -1.0)
    guard, valid = guarded(values)
    assert valid[:, 0].all()
    removed = np.flatnonzero(~valid[:, 1])
    assert 100 <= len(removed) <= 120
    assert set(removed) <= set(at)
    assert guard.at_rest
    assert guard.excluded == {"glitch": len(removed)}
    assert guard.disturbances <= 10
    assert sum(event.length for event in guard.events()) == len(removed)
    assert not guard.noisy_outliers.any()


def with_spikes(n: int, share: float, columns: list[int], seed: int = 2) -> Floats:
    """Return noise of which a share, in these columns, is thirty deviations off after a quiet beginning."""
    values, rng = quiet(n, seed), np.random.default_rng(seed)
    values[3000:, columns] += 30.0 * SIGMA[columns] * (rng.random((n - 3000, len(columns))) < share)
    return values


def test_a_burst_is_excluded_with_what_is_not_far_in_it() -> None:
    """Bursts of five deviations for 0.1 to 0.5 s; 4.5 % of what they add stays with their tallest samples excluded."""
    rng, rate, values = np.random.default_rng(6), 40.0, quiet(72_000)[:, :3]
    added = np.zeros(72_000, dtype=bool)
    for begin in range(1000, 71_000, 1000):
        rows = slice(begin, begin + int(rng.integers(4, 20)))
        added[rows] = True
        values[rows] += 5.0 * SIGMA[:3] * rng.standard_normal(values[rows].shape)
    guard, valid = guarded(values, SENSORS[:3], rate)
    valid = valid[:, 0]
    excess = np.square(values[added] / SIGMA[:3]) - 1.0
    assert excess[valid[added]].sum() < 0.03 * excess.sum()
    assert guard.at_rest


@pytest.mark.few
@pytest.mark.parametrize("columns", [[0], [0, 1, 2], [0, 1, 2, 3, 4, 5]])
def test_many_outliers_and_heavy_tails_are_noise_and_stay(columns: list[int]) -> None:
    """Tails are it from the beginning, and outliers that are not there at first soon after it."""
    for values, learned, kept in (
        (with_spikes(60_000, 0.03, columns), 20_000, 0.99),
        (contaminated(60_000, 0.05, columns), 0, 0.95),
    ):
        guard, valid = guarded(values)
        assert np.flatnonzero(guard.noisy_outliers).tolist() == columns
        assert guard.at_rest
        assert valid[learned:].mean() > kept
    assert guard.excluded["glitch"] < 0.005 * 60_000  # of the tails


@pytest.mark.slow
def test_the_upper_limit_of_n_holds_the_excluded_end_of_heavy_tails() -> None:
    """What the guards take from noise before they know it is noise of the sensor; glitches are not."""
    random = np.random.default_rng(4)
    tails = 1e-3 * random.standard_t(3.0, (48_000, 3)) / np.sqrt(3.0)
    errors = 1e-3 * random.standard_normal((48_000, 3))
    errors[random.random(48_000) < 1e-3, 1] += 0.02
    for gyro, kept_as_noise in ((tails, True), (errors, False)):
        record = imumon.analyse(gyro=gyro, rate_hz=40.0)
        white = record.report.channels["gyro/y"].N
        assert record.report.session.excluded_s > 0.0
        of_all_samples = float(gyro[:, 1].std()) / np.sqrt(40.0)
        assert (white.high > of_all_samples) == kept_as_noise
        assert white.high < 1.1 * of_all_samples


def test_rare_outliers_of_any_size_are_no_tail() -> None:
    """Half a per cent of them, with ten times the noise: some end just short of far, as the samples of a tail do."""
    values, rng = quiet(120_000), np.random.default_rng(9)
    hit = rng.random(len(values)) < 0.005
    values[hit, 1] += 10.0 * SIGMA[1] * rng.standard_normal(hit.sum())
    assert not guarded(values)[0].noisy_outliers.any()


def test_outliers_become_rare_again() -> None:
    values = np.concatenate((with_spikes(60_000, 0.03, [1]), quiet(240_000, 5)))
    values[250_000, 1] += 1.0
    guard, valid = guarded(values)
    assert not guard.noisy_outliers.any()
    assert not valid[250_000, 0]


def test_motion_takes_more_than_one_axis_or_another_mean() -> None:
    for columns, offset, reason in (([0], 0.0, "knock"), ([0, 1], 0.0, "motion"), ([0], 3e-3, "motion")):
        values = quiet(20_000)
        values[10_000:, columns] *= 3.0
        values[10_000:, columns] += offset
        guard, valid = guarded(values)
        assert reason in guard.excluded
        assert ("motion" in guard.excluded) == (reason == "motion")
        assert guard.at_rest  # the new noise is the baseline
        assert valid[-4_000:].all()


def test_the_report_gives_the_size_of_what_outliers_add() -> None:
    """5 % outliers of ten deviations: N is 2.4 times that of the core, and the report says so."""
    monitor = Record(rate_hz=RATE)
    stream = Stream("uncompensated", GYRO + ACCEL, "table", "none")
    values = contaminated(60_000, 0.05, [0])
    monitor.feed(SampleBlock(stream, values, None, np.zeros(len(values), dtype=np.int64)))
    monitor.flush()
    report = report_of(monitor)
    assert "outliers" in report.channels["gyro/x"].caveats
    assert "outliers" not in report.channels["gyro/y"].caveats
    robust = report.channels["gyro/x"].robust
    assert robust.ratio > 1.9
    assert any(f"{robust.ratio:.2f} times" in text for text in caveat_lines(report))
    assert any(f"{robust.ratio:.2f} times" in text for text in summary_text(report).splitlines())


def test_a_clipped_axis_is_named_with_its_range_and_its_sensor_has_no_grade() -> None:
    gyro = quiet(30_000)[:, :3]
    gyro[:, 1] = np.clip(gyro[:, 1], -8e-4, 8e-4)
    report = imumon.analyse(gyro=gyro, rate_hz=RATE, guards=False).report
    caveats = {axis: "clipped" in report.channels[f"gyro/{axis}"].caveats for axis in "xyz"}
    assert caveats == {"x": False, "y": True, "z": False}
    assert report.grade["gyro"].meets is None
    assert "y is clipped at -0.0008 and 0.0008 rad/s" in (report.grade["gyro"].reason or "")


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("degrees", "100 % excluded as motion: keep it still, or check its unit (deg/s?)"),
        ("knocks", "% excluded as knock: put it where nothing touches it"),
        ("clipped", "excluded as clipped: "),
    ],
)
def test_a_record_that_is_mostly_excluded_says_why_and_what_to_try(kind: str, says: str) -> None:
    """Noise of 0.06 deg/s and a bias of 0.66 deg/s read as rad/s, knock after knock, and an exceeded range."""
    values, row = quiet(12_000) * 2.5 - np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8]), np.arange(12_000)
    if kind == "degrees":
        values[:, :3] = np.degrees(values[:, :3] + np.array([0.005, -0.01, 0.003]))
    elif kind == "knocks":
        values[:, :3] += np.where(row % 250 < 20, 0.1, 0.0)[:, None]
    monitor, stream = Record(), Stream("deltas", GYRO + ACCEL, "table", "startup")
    flags, lost = (row % 150 < 10 if kind == "clipped" else None), np.zeros(len(row), dtype=np.int64)
    monitor.feed(SampleBlock(stream, values, row * round(1e9 / RATE), lost, saturated=flags))
    monitor.flush()
    report = report_of(monitor)
    assert all(grade.meets is None for grade in report.grade.values())
    (reason,) = {grade.reason for grade in report.grade.values()}
    assert says in reason
    assert ("not_at_rest" in report.caveats) == (kind == "degrees")
