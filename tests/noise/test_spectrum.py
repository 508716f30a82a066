"""Welch sums: their expectation and scatter, the displayed density, and lines only where the signal has some."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from imumon.model.samples import Bools, Floats
from imumon.noise.fit.model import FLICKER, WALK, WHITE
from imumon.noise.fit.observations import expected_bins
from imumon.noise.spectrum import PowerSpectrum, SpectrumAccumulator
from imumon.noise.spectrum.expectation import degrees_of_freedom
from imumon.noise.spectrum.level_sums import FIRST_BIN, HOP, LevelSums, last_bin, sub_bands
from imumon.noise.spectrum.spectral_lines import mains
from imumon.noise.spectrum.spectrum_accumulator import LONG_GAP
from imumon.noise.synthesis import synthesise

RATE = 40.0


def feed(spectrum: SpectrumAccumulator, values: Floats, valid: Bools | None = None) -> None:
    """Add (n, c) values with their validity (n, g), n a multiple of a hop."""
    if valid is None:
        spectrum.update(np.ascontiguousarray(values.T))
    else:
        known = np.where(valid[:, spectrum._groups], values, 0.0)
        spectrum.update(np.ascontiguousarray(known.T), np.ascontiguousarray(valid.T, dtype=np.float64))


def density(values: Floats, chunk: int = 32 * HOP, rate: float = RATE) -> PowerSpectrum:
    spectrum = SpectrumAccumulator((0,) * values.shape[1], rate)
    for i in range(0, len(values), chunk):
        feed(spectrum, values[i : i + chunk])
    return spectrum.result()


def same_sums(one: list[LevelSums], other: list[LevelSums]) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        for name in LevelSums.__slots__:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


# --- expectation and scatter -------------------------------------------------------------------------------


def holes_of(length: int, every: int) -> Callable[[int], np.ndarray]:
    """Return a pattern of holes of one length, at random places, one in `every` samples on the average."""

    def valid(samples: int) -> np.ndarray:
        rng, out = np.random.default_rng(8), np.ones((samples, 1), dtype=bool)
        for begin in rng.integers(0, samples, samples // every):
            out[begin : begin + length] = False
        return out

    return valid


LOSSES: dict[str, Callable[[int], np.ndarray] | None] = {
    "none": None,
    "scattered": lambda samples: np.random.default_rng(7).random((samples, 1)) >= 0.3,
    "short holes": holes_of(10, 400),
    "long holes": holes_of(440, 8192),
}


@pytest.mark.few(9)  # every noise without losses, of averages and of points, and with scattered ones
@pytest.mark.parametrize("kind", ["white", "flicker", "walk"])
@pytest.mark.parametrize("averaged", [True, False])
@pytest.mark.parametrize("pattern", LOSSES)
def test_sums_agree_with_their_expectation(kind: str, averaged: bool, pattern: str) -> None:
    """Levels of 20 segments and more; all bins of a level together scatter as the degrees of freedom say."""
    missing, loss = LOSSES[pattern], pattern != "none"
    count, term = 24, {"white": WHITE, "flicker": FLICKER, "walk": WALK}[kind]
    sizes = [float(kind == each) for each in ("white", "flicker", "walk")]
    values = synthesise(1 << 16, 1.0, [sizes[0]] * count, *sizes[1:], seed=3, averaged=averaged)
    values -= np.median(values[:256], axis=0)
    spectrum = SpectrumAccumulator([0] * count, 1.0)
    feed(spectrum, values, None if missing is None else missing(len(values)))
    compared = 0
    levels = spectrum.sums()
    for level, sums in enumerate(levels):
        segments = int(sums.averages[0])
        if segments < 20:
            continue
        (expected,) = expected_bins(levels, level, 0, averaged=averaged, window=1, terms=(term,))
        ratio = (sums.power * 2.0**level / segments / expected).mean(axis=1)
        error = np.sqrt(2.0 / degrees_of_freedom(np.arange(FIRST_BIN, last_bin(level)), segments))
        scatter = float(ratio.std(ddof=1)) / error
        # half a per cent: images behind the half-band filters; the waves of a walk are not known where samples are lost
        tolerance = 0.005 if kind != "walk" or not loss else 0.03 if "holes" in pattern else 0.015
        assert abs(ratio.mean() - 1.0) < 4.0 * error / np.sqrt(count) + tolerance, level
        # of 24 values, three standard errors; the slow waves of a walk that are left leak into all bins alike
        assert 0.5 < scatter < (2.5 if kind == "walk" and loss else 1.5), level
        compared += 1
    assert compared >= (5 if not loss else 3)


def test_levels_above_the_losses_have_no_segments_and_those_below_have() -> None:
    values, valid = white(40 * 1024), np.arange(40 * 1024)[:, None] % 2 == 0
    spectrum = SpectrumAccumulator([0], RATE)
    feed(spectrum, values, valid)
    averages = [int(sums.averages[0]) for sums in spectrum.sums()]
    assert averages[0] == 0
    assert averages[2] >= 0.9 * len(values) / 4 / HOP
    level = spectrum.sums()[2]
    assert level.white[0] / level.averages[0] == pytest.approx(2.0, rel=0.01)  # half of the samples
    ratio = level.power.mean() * 4.0 / level.averages[0] / (2.0 * 1e-6 * RATE)
    assert ratio == pytest.approx(1.0, rel=0.05)


# --- the stream --------------------------------------------------------------------------------------------


def test_the_sums_between_marks_add_up() -> None:
    """A segment counts once; one that begins before a mark and ends behind it belongs to what lies before."""
    values = np.random.default_rng(6).standard_normal((400 * HOP, 2))
    one = SpectrumAccumulator((0, 0), RATE)
    marks = []
    for i in range(0, 400, 50):
        if i == 200:
            one.break_()
        marks.append(one.add_mark())
        feed(one, values[i * HOP : (i + 50) * HOP])
    parts = [one.sums_between(a, b) for a, b in zip(marks, [*marks[1:], None], strict=True)]
    for level, whole in enumerate(one.sums()):
        pooled = np.add.reduceat(whole.power, sub_bands(level) - FIRST_BIN, axis=1)
        np.testing.assert_allclose(sum(part[level].power for part in parts), pooled, rtol=1e-9)
        assert sum(int(part[level].averages[0]) for part in parts) == whole.averages[0]
    alone = SpectrumAccumulator((0, 0), RATE)
    feed(alone, values[200 * HOP : 250 * HOP])  # begins at the break, as part 4 does
    for own, other in zip(alone.sums()[:3], parts[4][:3], strict=True):
        assert 0 <= other.averages[0] - own.averages[0] <= 2  # segments that end behind the mark


def test_a_long_gap_ends_the_segments_and_a_short_one_is_missing() -> None:
    values = np.random.default_rng(9).standard_normal((100 * HOP, 1))
    for gap in (LONG_GAP, LONG_GAP + HOP):
        skipped, sent, broken = (SpectrumAccumulator((0,), RATE) for _ in range(3))
        for spectrum in (skipped, sent, broken):
            feed(spectrum, values)
        skipped.skip(gap)
        broken.break_()
        feed(sent, np.zeros((gap, 1)), np.zeros((gap, 1), dtype=bool))
        for spectrum in (skipped, sent, broken):
            feed(spectrum, values)
        same_sums(skipped.sums(), (sent if gap == LONG_GAP else broken).sums())


# --- display -----------------------------------------------------------------------------------------------


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


def test_the_lowest_frequencies_are_shown_beside_missing_samples() -> None:
    """The fit is without slow waves beside holes; the spectrum that people see has them."""
    values = white(400 * 8 * HOP)
    gapped = SpectrumAccumulator((0,), RATE)
    feed(gapped, values, (np.arange(len(values)) % 4001 > 0)[:, None])
    whole, shown = density(values), gapped.result()
    lowest = whole.frequency_hz < 2.0 * whole.frequency_hz[0]
    np.testing.assert_allclose(shown.density[lowest], whole.density[lowest], rtol=0.1)


@pytest.mark.few
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


@pytest.mark.few
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
