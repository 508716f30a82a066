"""The exact Allan deviation, which a recording allows beside that of the octaves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evaluations import HZ, imumon, make_report, replayed, shown
from paths import RECORDINGS, needs_recordings

from imumon.noise.allan.overlapping import SampleStore, averaging_lengths, overlapping_deviation
from imumon.noise.synthesis import synthesise
from imumon.report import Report, from_json
from imumon.report_json import to_json


@pytest.mark.parametrize("octaves", [True, False])
def test_the_exact_deviation_is_that_of_allantools(octaves: bool) -> None:
    import allantools  # it imports all of scipy

    values = 9.8 + synthesise(5000, HZ, N=[1e-3], B=[1e-4], K=[1e-4], seed=2)[:, 0]
    lengths = averaging_lengths(len(values), octaves=octaves)
    sigma, terms = overlapping_deviation(values, np.ones(len(values), dtype=int), lengths)
    _, expected, _, counts = allantools.oadev(values, rate=HZ, data_type="freq", taus=np.array(lengths) / HZ)
    np.testing.assert_allclose(sigma[: len(expected)], expected, rtol=1e-9)
    np.testing.assert_array_equal(terms[: len(counts)], counts)
    assert len(expected) >= len(lengths) - 1


def test_no_difference_spans_a_gap() -> None:
    values = np.random.default_rng(1).normal(size=(100, 2))
    store = SampleStore([0, 0])
    store.update(values[:60])
    store.break_()
    store.update(values[60:], (np.arange(40) != 20)[:, None])
    kept, valid = store.result()
    sigma, terms = overlapping_deviation(kept[:, 0], valid[:, 0], [1, 8])
    pieces = [values[:60, 0], values[60:80, 0], values[81:, 0]]
    for k, m in enumerate((1, 8)):
        squares = [
            (piece[i + m : i + 2 * m].mean() - piece[i : i + m].mean()) ** 2 / 2.0
            for piece in pieces
            for i in range(len(piece) - 2 * m + 1)
        ]
        assert terms[k] == len(squares)
        assert sigma[k] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-12)


def test_exact_on_the_command_line_equals_allantools_at_every_octave(recording: Path) -> None:
    import allantools  # it imports all of scipy

    report = replayed(recording, "--exact", "--no-guards")
    data = np.loadtxt(recording, delimiter=",", skiprows=1)
    for column, name in enumerate(("gyro/x", "gyro/y", "gyro/z", "accel/x", "accel/y", "accel/z"), 1):
        curve = report.exact[name]
        _, expected, _, _ = allantools.oadev(data[:, column], rate=HZ, data_type="freq", taus=curve.tau_s)
        np.testing.assert_allclose(curve.sigma[: len(expected)], expected, rtol=1e-9)
        allan = report.channels[name].allan
        assert [tau for tau in allan.tau_s if tau not in curve.tau_s] == []
        for sigma, difference, own in zip(curve.sigma, curve.difference, allan.sigma, strict=True):
            assert difference == pytest.approx(own / sigma - 1.0)
        assert max(abs(d) for d in curve.difference[:4] if d is not None) < 0.02
        assert all(lo < s < hi for lo, s, hi in zip(curve.low, curve.sigma, curve.high, strict=True))


def test_ten_averaging_times_per_decade(gyroscope: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.json"
    imumon("report", gyroscope, "--exact", "--taus", "decade", "-o", out)
    report = from_json(Report, out.read_text())
    taus = np.array(report.exact["gyro/x"].tau_s)
    decade = taus[(taus > 0.99) & (taus < 9.9)]
    assert len(decade) == 10
    allan = report.channels["gyro/x"].allan
    shared = sum(any(abs(tau - t) < 1e-9 for t in taus) for tau in allan.tau_s)
    assert 0 < shared < len(allan.tau_s)
    # the rest of the octaves is not compared
    assert f"({shared} octaves)" in imumon("replay", gyroscope, "--exact", "--taus", "decade")
    assert "fully overlapping, exact" in shown(report, "svg")
    imumon("report", out, "-o", tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_text().count("\nexact,") == 3 * len(taus)


def test_taus_need_exact_and_exact_needs_samples(recording: Path, tmp_path: Path) -> None:
    imumon("replay", recording, "--taus", "decade", code=2)
    (tmp_path / "x.json").write_text(to_json(make_report()))
    for words in (("--exact",), ("--filter", "none"), ("--taus", "octave", "--exact")):
        assert "needs a recording" in imumon("report", tmp_path / "x.json", *words, code=2)


@needs_recordings
def test_a_real_recording_agrees_with_another_tool() -> None:
    """The figures of kiran_stat5min, computed by allantools from the sentences."""
    report = replayed(RECORDINGS / "kiran_stat5min.vnymr.txt.gz", "--rate", "40", "--exact", "--no-guards")
    sigma = report.exact["gyro/x"].sigma
    for octave, expected in ((1, 0.0004636), (4, 0.0001679), (6, 8.573e-05)):
        assert sigma[octave] == pytest.approx(expected, rel=1e-3)


def test_the_exact_curve_has_the_samples_of_the_other_with_guards(recording: Path, tmp_path: Path) -> None:
    """A knock is excluded from both; the difference stays that of the overlap."""
    rows = np.loadtxt(recording, delimiter=",", skiprows=1)
    rows = np.vstack([rows + np.eye(7)[0] * later for later in (0.0, 50.0, 100.0)])
    rows[4000:4040, 1:4] += np.sin(np.arange(40))[:, None]
    np.savez(tmp_path / "k.npz", t=rows[:, 0], gyro=rows[:, 1:4], accel=rows[:, 4:])
    report = replayed(tmp_path / "k.npz", "--exact")
    assert report.session.excluded_s > 0.5
    curve = report.exact["gyro/x"]
    assert curve.tau_s[-1] > 10.0
    assert max(abs(d) for d, tau in zip(curve.difference, curve.tau_s, strict=True) if d and tau < 5.0) < 0.05
    assert ">exact<" in shown(report, "svg")
