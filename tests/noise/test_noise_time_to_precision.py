"""Laws of the time to a precision: 0 when it is reached, less as the record grows, none without a value."""

from __future__ import annotations

import numpy as np
import pytest
from term_powers import powers_of

from imumon.noise import Estimator, OctaveCascade, fit_curve, synthesise
from imumon.noise.fit.time_to_precision import seconds_to

N, B, RATE = 6.1e-5, 2.4e-5, 40.0
POWERS = powers_of({"N": N, "B": B, "K": 0.0}, tau0=1.0 / RATE)


def seconds(widths: list[float], samples: float = 72_000.0, precision: float = 0.1) -> list[float | None]:
    by_letter = dict(zip("NBK", widths, strict=True))
    times = seconds_to(POWERS, by_letter, samples, 1.0 / RATE, 0.5, dict.fromkeys("NBK", precision))
    return list(times.values())


def test_what_is_reached_takes_no_time_and_what_has_no_value_takes_none() -> None:
    assert seconds([0.05, 0.1, np.inf]) == [0.0, 0.0, None]
    n, b, _ = seconds([0.11, 0.2, np.inf])
    assert 0.0 < n < b


@pytest.mark.few
@pytest.mark.parametrize("factor", [1.5, 3.0, 20.0])
def test_the_time_of_white_noise_grows_with_the_square_of_the_precision(factor: float) -> None:
    (found, *_) = seconds([0.1 * factor, np.inf, np.inf])
    assert found == pytest.approx((factor**2 - 1.0) * 1800.0, rel=0.1)


def test_the_time_falls_as_the_record_grows() -> None:
    """By the Cramér-Rao bound a half-width of 1 % of N takes 9 min at 40 Hz."""
    values = synthesise(72_000, RATE, N=[N] * 8, B=B, seed=3)
    cascade, estimator, times = OctaveCascade(8, tau0=1.0 / RATE), Estimator(averaged=True), []
    for part in np.split(values, [4_000, 8_000, 16_000]):
        cascade.update(part)
        times.append([fit.time_to["N"] for fit in estimator.fit(cascade.result(), renew=True)])
    found = np.array(times, dtype=np.float64)
    ends = np.array([4_000, 8_000, 16_000])[:, None] / RATE + found[:3]
    assert np.median(ends) == pytest.approx(np.median(ends[2]), rel=0.5)
    assert (np.diff(np.median(found, axis=1)) < 0.0).all()
    assert not found[3].any()


@pytest.mark.slow
def test_a_stated_time_is_that_of_the_fit_of_a_longer_record() -> None:
    values = synthesise(288_000, RATE, N=[N] * 6, B=B, seed=4)
    first = OctaveCascade(6, tau0=1.0 / RATE)
    first.update(values[:30_000])
    times = [fit.time_to["B"] for fit in Estimator(averaged=True, precision={"B": 0.2}).fit(first.result())]
    known = [each for each in times if each is not None]
    assert len(known) >= 4
    assert min(known) > 0.0
    end = round((750.0 + float(np.median(known))) * RATE)
    assert end < len(values)
    longer = OctaveCascade(6, tau0=1.0 / RATE)
    longer.update(values[:end])
    reached = [0.5 * (fit.B.high - fit.B.low) / B for fit in fit_curve(longer.result(), averaged=True)]  # type: ignore[operator]
    assert 0.1 < float(np.median(reached)) < 0.3  # the limits of B scatter by a third


def test_an_absent_coefficient_has_no_time() -> None:
    """White noise alone: B and K are bounded at best, and no longer record measures them."""
    cascade = OctaveCascade(40, tau0=1.0 / RATE)
    cascade.update(np.random.default_rng(5).standard_normal((20_000, 40)))
    measured = 0
    for fit in fit_curve(cascade.result(), averaged=True):
        for name in ("B", "K"):
            is_measured = getattr(fit, name).status == "measured"
            measured += is_measured
            assert is_measured or fit.time_to[name] is None
        assert fit.time_to["N"] is not None
    assert measured <= 6  # of 80, at 1.4 % each: more once in 2,000 times
