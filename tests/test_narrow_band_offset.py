"""Strong lines: the octaves that they dominate come from the spectrum without its bands."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.noise.fit.narrow_band_offset import quiet_octaves
from imumon.noise.fit.results import ChannelFit
from imumon.noise.statistics.psd import PowerSpectrum, SpectrumAccumulator
from imumon.samples import Floats

N, B, RATE, CHANNELS, LENGTH = 6.1e-5, 2.4e-5, 40.0, 12, 200_000
SIGMA = N * np.sqrt(RATE)


@pytest.fixture(scope="module")
def quiet() -> Floats:
    return synthesise(LENGTH, RATE, N=[N] * CHANNELS, B=B, K=0.0, seed=8, averaged=False)


def line(frequency_hz: float, size: float, *, wander: float, change: float, seed: int = 3) -> Floats:
    """Return (n, c) a line of some standard deviations of the noise whose frequency and size change over a minute."""
    rng, pole = np.random.default_rng(seed), np.exp(-1.0 / 60.0)
    seconds = round(LENGTH / RATE) + 2
    steps = rng.standard_normal((2, seconds, CHANNELS)) * np.sqrt(1.0 - pole * pole)
    for at in range(1, seconds):
        steps[:, at] += pole * steps[:, at - 1]
    time = np.arange(LENGTH) / RATE
    slow = np.array([[np.interp(time, np.arange(seconds), column) for column in each.T] for each in steps])
    phase = 2.0 * np.pi * np.cumsum(frequency_hz * (1.0 + wander * slow[0]), axis=1) / RATE
    return np.asarray((size * SIGMA * (1.0 + change * slow[1]) * np.sin(phase)).T)


def spectrum_of(values: Floats) -> PowerSpectrum:
    spectrum = SpectrumAccumulator([0] * values.shape[1], RATE)
    spectrum.update(values)
    return spectrum.result()


def fitted(values: Floats) -> tuple[ChannelFit, ...]:
    cascade, spectrum = OctaveCascade(values.shape[1], tau0=1.0 / RATE), spectrum_of(values)
    cascade.update(values)
    estimator = Estimator(averaged=False, time_to=False)
    return estimator.fit(cascade.result(), bands=spectrum.bands, quiet=spectrum.quiet)


@pytest.mark.parametrize("frequency_hz", [4.3, 12.6])
@pytest.mark.parametrize(
    ("size", "wander", "change"), [(3.0, 0.01, 0.2), (10.0, 0.01, 0.0), (3.0, 0.02, 0.0)]
)
def test_a_strong_line_costs_n_little(
    quiet: Floats, frequency_hz: float, size: float, wander: float, change: float
) -> None:
    values = quiet + line(frequency_hz, size, wander=wander, change=change)
    fits = fitted(values)
    assert sum(fit.N.low <= N <= fit.N.high for fit in fits) >= CHANNELS - 2
    own, without = (np.median([fit.N.high - fit.N.low for fit in each]) for each in (fits, fitted(quiet)))
    assert own <= 1.5 * without
    assert all("vibration" in fit.caveats for fit in fits)
    cascade = OctaveCascade(CHANNELS, tau0=1.0 / RATE)
    cascade.update(values)
    for fit, sigma in zip(
        fits, cascade.result().sigma.T, strict=True
    ):  # the model has the line, as the samples have
        np.testing.assert_allclose(fit.model[:6], sigma[:6], rtol=0.05)


def test_the_density_without_bands_has_the_octaves_of_the_noise(quiet: Floats) -> None:
    values = quiet + line(9.0, 3.0, wander=0.01, change=0.2)
    m = 2 ** np.arange(6)
    cascade = OctaveCascade(CHANNELS, tau0=1.0 / RATE)
    cascade.update(quiet)
    expected = cascade.result().avar[:4]
    for channel, density in enumerate(spectrum_of(values).quiet):
        assert density is not None
        variance, error = quiet_octaves(density, m, LENGTH, LENGTH)
        assert np.all(np.abs(variance - expected[:, channel]) < 4.0 * np.sqrt(np.diag(error)))
        assert np.all(np.sqrt(np.diag(error)) < 0.01 * variance)
    assert spectrum_of(quiet[:, :1]).quiet == (None,)


def test_a_broad_line_is_one_band(quiet: Floats) -> None:
    """In the middle of a broad line the density beside it is unknown, and comes from both sides."""
    values = quiet + line(9.0, 3.0, wander=0.03, change=0.0)
    for bands in spectrum_of(values).bands:
        assert bands[0].power == pytest.approx(4.5 * SIGMA**2, rel=0.03)
        assert sum(band.power for band in bands[1:]) < 0.05 * bands[0].power


def test_missing_samples_make_the_density_less_certain(quiet: Floats) -> None:
    density = spectrum_of(quiet + line(9.0, 3.0, wander=0.01, change=0.0)).quiet[0]
    assert density is not None
    whole, some = (quiet_octaves(density, 2 ** np.arange(4), n, LENGTH)[1] for n in (LENGTH, LENGTH - 4000))
    assert np.all(np.diag(some) > np.diag(whole))


@pytest.mark.parametrize(("frequency_hz", "wander"), [(18.5, 0.02), (18.5, 0.005), (12.0, 0.02)])
def test_n_has_a_value_in_short_records_beside_a_line_that_comes_and_goes(
    frequency_hz: float, wander: float
) -> None:
    """Without N, the errors of the line explain the whole curve: the test of N at zero must not stop there."""
    n, columns, rng = 13_000, 10, np.random.default_rng(1)
    values = synthesise(n, RATE, N=[N] * columns, B=1e-6, K=0.0, seed=3, averaged=False)
    time, seconds = np.arange(n) / RATE, np.arange(n // RATE + 2)
    for c in range(columns):
        shift, size = (np.interp(time, seconds, rng.standard_normal(len(seconds))) for _ in range(2))
        phase = 2.0 * np.pi * np.cumsum(frequency_hz * (1.0 + wander * shift)) / RATE
        values[:, c] += 10.0 * SIGMA * (1.0 + size) * np.sin(phase)
    fits = fitted(values)
    assert {fit.N.status for fit in fits} == {"measured"}
    assert sum(fit.N.low <= N <= fit.N.high for fit in fits) >= 8


@pytest.mark.parametrize("frequency_hz", [1.4, 1.6, 1.8, 19.9, 20.0])
def test_a_line_at_the_ends_of_the_spectrum_keeps_n(quiet: Floats, frequency_hz: float) -> None:
    """Below the twelfth bin a line is not removed whole; at half the sampling rate the density is halved."""
    values = quiet + line(frequency_hz, 10.0, wander=0.0, change=0.0)
    fits = fitted(values)
    assert {fit.N.status for fit in fits} == {"measured"}
    assert sum(fit.N.low <= N <= fit.N.high for fit in fits) >= CHANNELS - 2
    own, without = (np.median([fit.N.high - fit.N.low for fit in each]) for each in (fits, fitted(quiet)))
    assert own <= 3.0 * without


@pytest.mark.parametrize(("pole", "size"), [(0.995, 5.0), (0.999, 5.0), (0.99, 3.0)])
def test_a_resonance_keeps_n(quiet: Floats, pole: float, size: float) -> None:
    """Its tails reach beyond the band; where the octaves from the spectrum do not fit, those of the samples count."""
    turn = 2.0 * pole * np.cos(2.0 * np.pi * 8.0 / RATE)
    noise = np.random.default_rng(1).standard_normal((LENGTH, CHANNELS))
    shaken = lfilter([1.0], [1.0, -turn, pole**2], noise, axis=0)
    gain = size * SIGMA / shaken.std()
    truth = np.sqrt(N**2 + (gain / (1.0 - turn + pole**2)) ** 2 / RATE)
    fits = fitted(quiet + gain * shaken)
    assert {fit.N.status for fit in fits} == {"measured"}
    assert sum(fit.N.low <= truth <= fit.N.high for fit in fits) >= CHANNELS - 2


def test_only_the_full_rate_has_a_quiet_density(quiet: Floats) -> None:
    """With gaps in each segment the full rate has no averages, but the rate below may have some."""
    values = quiet[:60_000] + line(9.0, 3.0, wander=0.01, change=0.0)[:60_000]
    valid = np.ones((len(values), 1), dtype=bool)
    valid[np.arange(len(values)) % 128 < 14] = False
    spectrum = SpectrumAccumulator([0] * CHANNELS, RATE)
    spectrum.update(values, valid)
    for density in spectrum.result().quiet:
        assert density is None or density.rate_hz == RATE
