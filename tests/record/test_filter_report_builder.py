"""Parameters for filters of a report: what counts as the noise of a channel, and that it is consistent."""

from __future__ import annotations

from dataclasses import replace

import pytest
from paths import ROOT
from reports import LONG_S, correlated, with_coefficients
from reports import report as make_report

from imumon.model.coefficients import Estimate
from imumon.model.filter_report import DEFAULT_HORIZON_S
from imumon.model.report import Report
from imumon.model.samples import GYRO
from imumon.noise.filter_parameters import MOST_NEES
from imumon.record.filter_report_builder import assumed_noise, filter_report


def with_bounds(report: Report) -> Report:
    """Return the report with a K of gyro/x that is only bounded."""
    channel = report.channels["gyro/x"]
    bounded = replace(channel.coefficients["K"], status="upper_bound", value=None, low=0.0, high=2e-6)
    return replace(report, channels=report.channels | {GYRO[0]: with_coefficients(channel, K=bounded)})


def test_a_bounded_coefficient_counts_with_half_its_bound() -> None:
    report = with_bounds(make_report(LONG_S))
    channel = report.channels["gyro/x"]
    assumed = assumed_noise(channel)
    assert assumed is not None
    assert assumed.K == 1e-6
    assert channel.coefficients["N"].value == assumed.N
    filters = filter_report(report, DEFAULT_HORIZON_S).channels
    assert filters["gyro/x"].walk_factor is None
    assert "bounded_K" in filters["gyro/x"].caveats
    y = filters["gyro/y"]
    assert y.walk_factor == pytest.approx(y.walk / y.assumed.K)
    assert "bounded_K" not in y.caveats


def test_terms_that_do_not_hold_are_a_caveat() -> None:
    report = make_report(LONG_S)
    channel = report.channels["gyro/x"]
    flicker = replace(channel.coefficients["B"], value=0.95, low=0.9, high=1.0, status="measured")
    channels = report.channels | {GYRO[0]: with_coefficients(channel, B=flicker)}
    filters = filter_report(replace(report, channels=channels), 86400.0).channels
    assert [name for name, each in filters.items() if "inconsistent_terms" in each.caveats] == ["gyro/x"]


def test_an_unknown_coefficient_gives_no_numbers() -> None:
    report = make_report(LONG_S)
    channel = report.channels["gyro/x"]
    unknown = with_coefficients(channel, B=Estimate())
    assert assumed_noise(unknown) is None
    filters = filter_report(replace(report, channels={GYRO[0]: unknown}), 600.0)
    assert filters.channels == {}


def test_every_axis_of_gyroscope_and_accelerometer_has_consistent_numbers() -> None:
    report = make_report(LONG_S)
    filters = filter_report(report, 600.0)
    assert set(filters.channels) == {f"{sensor}/{axis}" for sensor in ("gyro", "accel") for axis in "xyz"}
    for channel in filters.channels.values():
        assert channel.white == channel.white_gm == channel.assumed.N
        assert channel.walk_gm == channel.assumed.K
        assert channel.walk > 0.0
        assert max(channel.nees.white_walk) <= MOST_NEES
        assert (
            1.0 / MOST_NEES <= min(channel.nees.gauss_markov) <= max(channel.nees.gauss_markov) <= MOST_NEES
        )
        assert len(channel.gauss_markov) <= 5 + (channel.markov is not None)
        assert channel.nees.horizon_s == channel.std.horizon_s
        assert channel.nees.horizon_s[-1] == 600.0


def test_correlated_noise_is_a_state_of_the_filter() -> None:
    report = correlated()
    filters = filter_report(report, 600.0).channels
    shown, open_, flicker = (filters[f"gyro/{axis}"] for axis in "xyz")
    m = report.channels["gyro/x"].M
    assert m is not None
    assert shown.markov is not None
    assert (shown.markov.sigma, shown.markov.time_constant_s) == (m.sigma.value, m.time_constant_s.value)
    assert shown.markov.drive == pytest.approx(
        shown.markov.sigma * (2.0 / shown.markov.time_constant_s) ** 0.5
    )
    assert shown.markov.sigma in [term.sigma for term in shown.gauss_markov]
    assert [term.tau_s for term in shown.gauss_markov] == sorted(term.tau_s for term in shown.gauss_markov)
    assert open_.markov is not None
    high = report.channels["gyro/y"].estimates["M"].high or 0.0
    assert pytest.approx(high / 2.0) == open_.assumed.M
    assert {"bounded_B", "bounded_K", "bounded_M"} <= set(open_.caveats)
    assert flicker.markov is None
    for channel in filters.values():
        assert max(channel.nees.white_walk) <= MOST_NEES
        assert (
            1.0 / MOST_NEES <= min(channel.nees.gauss_markov) <= max(channel.nees.gauss_markov) <= MOST_NEES
        )


# ---------------------------------------------------------------- another program


@pytest.mark.slow
def test_gtsam_with_the_exported_parameters_is_consistent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Preintegrated rotation and velocity after 300 s of fixes; N and K alone are overconfident."""
    pytest.importorskip("gtsam", reason="gtsam is not installed (extra peers)")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import gtsam_filters

    report = gtsam_filters.report_of_record()
    alone, exported = (
        gtsam_filters.nees_of(make(report, 600.0), 20, 0.0, 300, (10, 60)).mean(axis=0)
        for make in (gtsam_filters.plain, gtsam_filters.exported)
    )
    assert (exported < 1.8).all()
    assert (exported > 0.3).all()
    assert (alone > 1.2 * exported).all()
