"""Power spectrum: the right density at every frequency, and lines only where the signal has some."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.statistics.psd import PowerSpectrum, SpectrumAccumulator
from imumon.noise.statistics.spectral_lines import mains
from imumon.noise.synthesis import synthesise
from imumon.samples import Floats

RATE = 40.0


def density(values: Floats, chunk: int = 4000, rate: float = RATE) -> PowerSpectrum:
    spectrum = SpectrumAccumulator((0,) * values.shape[1], rate)
    for i in range(0, len(values), chunk):
        spectrum.update(values[i : i + chunk])
    return spectrum.result()


def white(n: int, c: int = 1, seed: int = 1) -> Floats:
    """Return (n, c) white noise of N = 1e-3."""
    return np.asarray(1e-3 * np.sqrt(RATE) * np.random.default_rng(seed).standard_normal((n, c)))


def test_white_noise_is_flat_at_twice_n_squared() -> None:
    result = density(white(400_000, 4) + 9.8)
    assert (np.diff(result.frequency_hz) > 0).all()
    assert result.frequency_hz[0] < 0.01
    assert result.frequency_hz[-1] == RATE / 2
    level = result.density[:-1] / 2e-6
    scatter = 1.0 / np.sqrt(result.averages[:-1] * 0.94)
    z = (level - 1.0) / scatter
    assert np.abs(z).max() < 6.0
    assert abs(z.mean()) < 0.2
    assert z.std() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(result.white, 1e-3, rtol=0.01)


def test_flicker_and_random_walk_have_their_slopes() -> None:
    """Flicker: B^2 / (2 pi f) two-sided; random walk: K^2 / (2 pi f)^2."""
    n = 600_000
    noise = np.concatenate(
        (synthesise(n, RATE, B=[1e-4] * 3, seed=2), synthesise(n, RATE, K=[1e-5] * 3, seed=3)), axis=1
    )
    result = density(noise)
    f = result.frequency_hz[:, None]
    use = ((result.frequency_hz > 0.005) & (result.frequency_hz < 3.0))[:, None] & (result.averages >= 8)
    for expected, columns in (
        (2e-8 / (2 * np.pi * f), slice(0, 3)),
        (2e-10 / (2 * np.pi * f) ** 2, slice(3, 6)),
    ):
        ratio = (result.density[:, columns] / expected)[use[:, columns]]
        assert ratio.mean() == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("frequency", [0.037, 0.37, 3.7, 7.3, 14.9, 19.9])
def test_a_line_is_detected_with_frequency_and_amplitude(frequency: float) -> None:
    n = 400_000
    values = white(n, 2)
    amplitude = 2e-3 if frequency > 0.1 else 1e-3
    values[:, 1] += amplitude * np.sin(2 * np.pi * frequency * np.arange(n) / RATE)
    result = density(values)
    assert result.lines[0] == ()
    assert len(result.lines[1]) == 1
    line = result.lines[1][0]
    assert line.frequency_hz == pytest.approx(frequency, rel=0.01, abs=1e-3)
    assert line.amplitude == pytest.approx(amplitude, rel=0.15)
    assert result.white[1] == pytest.approx(1e-3, rel=0.02)


def test_mains_is_named_at_the_frequency_it_folds_to() -> None:
    n = 100_000
    values = white(n)
    values[:, 0] += 2e-3 * np.sin(2 * np.pi * 50.02 * np.arange(n) / RATE)
    (line,) = density(values).lines[0]
    assert line.frequency_hz == pytest.approx(10.02, abs=0.05)
    assert line.name == "50 Hz mains"
    assert 50.0 in line.aliases_hz
    assert mains(20.0, 40.0, 0.1)[1] == "60 Hz mains"
    assert mains(60.0, 200.0, 0.1)[1] == "60 Hz mains"
    assert mains(33.3, 200.0, 0.1) == ((), None)
    assert mains(0.03, 40.0, 0.1) == ((120.0,), None)  # where any drift is


@pytest.mark.parametrize("level", [0.0, 9.8, -1.8562e-3])
def test_rounding_has_no_lines(level: float) -> None:
    """Rounding of a constant, and of a few repeated numbers."""
    assert density(np.full((20_000, 1), level)).lines == ((),)
    repeated = density(level + np.tile([0.1, 0.3, -0.2, 0.7], 5000)[:, None])
    assert {round(line.frequency_hz) for line in repeated.lines[0]} == {10, 20}


def test_noise_has_no_lines() -> None:
    """White, flicker, random walk and boxcar noise, evaluated at many lengths."""
    reports = lines = 0
    for seed in range(6):
        values = np.concatenate(
            (
                white(60_000, 3, seed),
                synthesise(60_000, RATE, N=[1e-4] * 2, B=1e-4, K=[1e-5, 1e-3], seed=seed),
            ),
            axis=1,
        )
        values[4:, 0] = sum(values[i : len(values) - 4 + i, 0] for i in range(4)) / 4
        spectrum = SpectrumAccumulator((0,) * 5, RATE)
        for i in range(0, len(values), 2000):
            spectrum.update(values[i : i + 2000])
            reports += 1
            lines += sum(len(each) for each in spectrum.result().lines)
    assert reports == 180
    assert lines == 0


def test_any_chunking_gives_the_same() -> None:
    values = white(30_000, 2)
    valid = np.ones((len(values), 2), dtype=bool)
    valid[5000:5100, 1] = False
    results = []
    for chunk in (30_000, 1000, 37):
        spectrum = SpectrumAccumulator((0, 1), RATE)
        for i in range(0, len(values), chunk):
            spectrum.update(values[i : i + chunk], valid[i : i + chunk])
            if i % 5000 < chunk:
                spectrum.result()  # a request changes nothing
        results.append(spectrum.result())
    for other in results[1:]:
        np.testing.assert_allclose(other.density, results[0].density, rtol=1e-9)
        np.testing.assert_array_equal(other.averages, results[0].averages)
    assert results[0].averages[-1, 1] < results[0].averages[-1, 0]


def test_a_gap_costs_a_segment_and_keeps_the_level() -> None:
    values = white(200_000) + 9.8
    whole, gapped = SpectrumAccumulator((0,), RATE), SpectrumAccumulator((0,), RATE)
    whole.update(values)
    for i in range(0, len(values), 10_000):
        gapped.update(values[i : i + 9_980])
        gapped.skip(20)
    a, b = whole.result(), gapped.result()
    assert b.averages[-1, 0] > 0.9 * a.averages[-1, 0]
    assert b.averages[0, 0] == a.averages[0, 0]
    assert b.white[0] == pytest.approx(a.white[0], rel=0.02)
    low = a.frequency_hz < 0.05
    assert b.density[low].mean() == pytest.approx(a.density[low].mean(), rel=0.25)
    gapped.skip(10**9)
    gapped.break_()
    gapped.update(values[:1000])
    assert np.isfinite(gapped.result().density).all()


def test_memory_grows_with_the_logarithm() -> None:
    spectrum = SpectrumAccumulator((0, 0, 0), RATE)
    values = white(100_000, 3)
    sizes = []
    for _ in range(8):
        spectrum.update(values)
        sizes.append(sum(a.nbytes for a in spectrum.save().values()))
    assert sizes[-1] - sizes[0] < 4 * 20_000
    averages = spectrum.result().averages[-1, 0]
    assert 1024 < averages < 5000


def test_save_and_restore_continue_identically() -> None:
    values = white(20_000, 2)
    whole = SpectrumAccumulator((0, 0), RATE)
    whole.update(values)
    first = SpectrumAccumulator((0, 0), RATE)
    first.update(values[:7777])
    second = SpectrumAccumulator.restore(first.save())
    second.update(values[7777:])
    np.testing.assert_allclose(second.result().density, whole.result().density, rtol=1e-9)


def test_an_empty_spectrum() -> None:
    result = SpectrumAccumulator((0, 1), RATE).result()
    assert result.density.shape == (0, 2)
    assert result.lines == ((), ())
    assert np.isnan(result.white).all()


def test_unsaved_short_hops_cost_a_segment_or_two() -> None:
    values = white(40_000, 1)
    first = SpectrumAccumulator((0,), RATE)
    first.update(values[:17_777])
    whole, brief = (SpectrumAccumulator.restore(first.save(least_s=s)) for s in (0.0, 1e9))
    for spectrum in (whole, brief):
        spectrum.update(values[17_777:])
    a, b = whole.result(), brief.result()
    assert (a.frequency_hz == b.frequency_hz).all()
    assert (a.averages - b.averages <= 3).all()
    assert (a.averages - b.averages >= 0).all()
    assert np.isfinite(b.density).all()
    np.testing.assert_allclose(b.white, a.white, rtol=0.02)
