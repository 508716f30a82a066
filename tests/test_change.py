"""Changes: an hour that differs is reported, an ordinary one is not."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import Estimator
from imumon.noise.nonstationarity.change import NoiseSummary, detect_changes
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.synthesis import synthesise
from imumon.report import Change
from imumon.samples import Floats

RATE = 10.0
HOUR = 36_000


class Limited(NamedTuple):
    value: float | None
    low: float | None
    high: float | None


def summaries(values: Floats) -> list[NoiseSummary]:
    """Return the noise of each channel over a stretch."""
    cascade = OctaveCascade(values.shape[1], 1 / RATE)
    cascade.update(values)
    fits = Estimator(averaged=True).fit(cascade.result())
    means = values.mean(axis=0).tolist()
    return [NoiseSummary.of(fit, mean, len(values) / RATE) for fit, mean in zip(fits, means, strict=True)]


def changes_of_last_hour(values: Floats) -> list[list[Change]]:
    """Return the changes of each channel in the last hour."""
    before, last = summaries(values[:-HOUR]), summaries(values[-HOUR:])
    return [detect_changes(old, new, "hours before") for old, new in zip(before, last, strict=True)]


@pytest.mark.parametrize("seed", range(4))
def test_an_ordinary_hour_is_no_change(seed: int) -> None:
    values = synthesise(
        6 * HOUR, RATE, N=[1e-4] * 4, B=[2e-5, 5e-6, 2e-5, 0.0], K=[1e-7, 1e-6, 0, 0], seed=seed
    )
    assert changes_of_last_hour(values) == [[], [], [], []]


def test_changes_of_noise_and_bias_are_detected() -> None:
    values = synthesise(6 * HOUR, RATE, N=[1e-4] * 4, B=1e-5, K=1e-8, seed=9)
    values[5 * HOUR :, 1] *= 1.4
    values[5 * HOUR :, 2] += 5e-4
    same, noisier, shifted, also_same = changes_of_last_hour(values)
    assert same == also_same == []
    (change,) = [c for c in noisier if c.quantity == "N"]
    assert change.ratio == pytest.approx(1.4, rel=0.03)
    (change,) = shifted
    assert change.quantity == "bias"
    assert change.now - change.before == pytest.approx(5e-4, rel=0.2)


def test_a_saved_baseline_is_compared_by_noise_only() -> None:
    def summary(n: float, mean: float) -> NoiseSummary:
        noise = MeanCovariance(n, 1e-5, 1e-7)
        return NoiseSummary(Limited(n, n * 0.99, n * 1.01), Limited(None, None, 2e-5), mean, noise, 3600.0)

    assert detect_changes(summary(1e-4, 0.0), summary(1.01e-4, 0.1), "baseline", None) == []
    (change,) = detect_changes(summary(1e-4, 0.0), summary(1.4e-4, 0.1), "baseline", None)
    assert (change.quantity, change.ratio) == ("N", pytest.approx(1.4))
    assert detect_changes(summary(1e-4, 0.0), summary(1e-4, 0.1), "baseline", 0.0)[0].quantity == "bias"
