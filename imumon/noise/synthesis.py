"""White, flicker and random-walk noise of given N, B and K, as a record or as an endless stream.

Two-sided power spectral densities of the rate y (IEEE Std 952, annex C), and their Allan deviations:

    N^2                 white           sigma(tau) = N / sqrt(tau)
    B^2 / (2 pi f)      flicker         sigma(tau) = sqrt(2 ln 2 / pi) B = 0.664 B
    K^2 / (2 pi f)^2    random walk     sigma(tau) = K sqrt(tau / 3)

Samples: with ``averaged`` a sample is the mean of the continuous process over its interval (like a delta
angle divided by its time), so that these formulas hold at every octave. Without it a sample is a value at an
instant: of the walk, with K^2 tau/3 (1 + 1/(2 m^2)), and of the discrete 1/f filter (1 - z^-1)^(-1/2) of
Kasdin & Walter (IEEE Frequency Control Symposium 1992), with 1.44, 1.15, 1.05 times the flat variance at
m = 1, 2, 4. White noise of unlimited bandwidth has no values at instants: its samples are averages in both
cases.

Exactness: a record (`synthesise`) is exact to the rounding of a Fourier transform. In a stream
(`NoiseStream`) white noise and walk are exact, and the spectrum of flicker is within 0.3 % from 1e-7 Hz up to
the Nyquist frequency. In both, flicker and walk begin at zero, and their increments are stationary from the
first sample on: there is no transient at the start.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Floats
from imumon.noise.markov_law import average_autocovariance

Seed: TypeAlias = int | np.random.Generator | None
Strength: TypeAlias = float | npt.ArrayLike

LOWEST_POLE_HZ = 1e-10
"""Hz, frequency below which streamed flicker is no longer flicker: 300 years."""

POLE_STEP = 1.25
"""1, distance of the poles in log frequency: the spectrum ripples by 4 exp(-pi^2 / 1.25) = 0.15 %."""

STEP_SAMPLES = 64
"""Samples of flicker computed by one product of matrices."""

BLOCK_STEPS = 32
"""Such steps in one block."""

# Averaged flicker is the discrete 1/f noise behind a short filter: the root of minimum phase of the ratio of
# their spectra, sin^2(pi f) sum_k |f + k|^-3 / (2 pi^3) to 1 / (2 sin(pi f)) at f cycles per sample.
AVERAGING = np.array(
    [8.67217e-01, 1.31352e-01, 1.04096e-03, 2.42683e-04, 7.74477e-05, 3.16001e-05, 1.51567e-05, 8.13913e-06]
)
AVERAGING /= AVERAGING.sum()


def synthesise(
    n: int,
    rate_hz: float,
    N: Strength = 0.0,
    B: Strength = 0.0,
    K: Strength = 0.0,
    seed: Seed = None,
    *,
    averaged: bool = True,
) -> Floats:
    """Return noise of given coefficients.

    Parameters
    ----------
    n : samples.
    rate_hz : Hz, sample rate.
    N, B, K : scalar or (c,); channel unit/sqrt(Hz), channel unit, channel unit*sqrt(Hz).
    seed : of the generator, or the generator.
    averaged : samples are means over their intervals, else values at instants.

    Returns
    -------
    (n, c) channel unit.

    Examples
    --------
    >>> synthesise(4, 100.0, N=[1e-3, 2e-3], seed=1).shape
    (4, 2)
    """
    white, flicker, walk = _strengths(rate_hz, N, B, K)
    rng = np.random.default_rng(seed)
    y = np.empty((len(white), n))
    for c in range(len(white)):
        y[c] = _independent(white[c], walk[c], rate_hz, averaged) * rng.standard_normal(n)
        if walk[c]:
            step = walk[c] / math.sqrt(rate_hz) * rng.standard_normal(n)
            y[c] += np.cumsum(step)
            y[c] -= step / 2.0 if averaged else step
        if flicker[c]:
            y[c] += flicker[c] * _flicker(n, rng, averaged)
    return np.ascontiguousarray(y.T)


def markov_noise(
    n: int, rate_hz: float, time_constant_s: float, seed: Seed = None, *, averaged: bool = True
) -> Floats:
    """Return (n,) first-order Gauss–Markov noise of standard deviation 1, stationary from the first sample on.

    With the time constant T in intervals and a = exp(-1/T), a step takes the state x to a x + w, and its average is
    T (1 - a) x + v. The covariances of w and v follow from that of the process (`markov_law`).

    Parameters
    ----------
    rate_hz : Hz, sample rate.
    time_constant_s : s, after which it has forgotten its value.
    seed : of the generator, or the generator.
    averaged : samples are means over their intervals, else values at instants.

    Examples
    --------
    >>> y = markov_noise(200_000, 10.0, 5.0, seed=1)
    >>> round(float(y.std()), 1), round(float(np.corrcoef(y[50:], y[:-50])[0, 1]), 1)
    (1.0, 0.4)
    """
    import scipy.signal

    signal: Any = scipy.signal
    rng = np.random.default_rng(seed)
    time = time_constant_s * rate_hz
    a, fall = math.exp(-1.0 / time), -math.expm1(-1.0 / time)
    drive = math.sqrt(-math.expm1(-2.0 / time)) * rng.standard_normal(n)
    states = np.empty(n)
    states[0] = rng.standard_normal()
    if n > 1:
        states[1:] = signal.lfilter([1.0], [1.0, -a], drive[: n - 1], zi=[a * states[0]])[0]
    if not averaged:
        return states
    gain = time * fall
    across = time * fall**2 / -math.expm1(-2.0 / time)  # regression of v on w
    spread = average_autocovariance(time)[0] - gain**2 - across**2 * -math.expm1(-2.0 / time)
    return np.asarray(gain * states + across * drive + math.sqrt(max(spread, 0.0)) * rng.standard_normal(n))


def _strengths(rate_hz: float, *strengths: Strength) -> tuple[Floats, ...]:
    """Return N, B, K of every channel, (c,) each."""
    arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(s, dtype=np.float64)) for s in strengths))
    if arrays[0].ndim != 1 or any(not np.all((a >= 0.0) & (a < math.inf)) for a in arrays):
        raise ValueError("N, B and K must be numbers, or one number for each channel, and not negative")
    if not 0.0 < rate_hz < math.inf:
        raise ValueError(f"the sample rate must be positive, not {rate_hz} Hz")
    return arrays


def _independent(white: Floats, walk: Floats, rate_hz: float, averaged: bool) -> Floats:
    """Return the standard deviation of the part that is independent from sample to sample, channel unit.

    White noise and, when averaged, the deviation of the walk from its chord: the mean of a Wiener process
    over an interval is half the sum of its ends and an independent remainder, of variance K^2 tau0 / 12.
    """
    return np.asarray(np.sqrt(white**2 * rate_hz + averaged * walk**2 / (12.0 * rate_hz)))


def _flicker(n: int, rng: np.random.Generator, averaged: bool) -> Floats:
    """Return (n,) flicker of B = 1 that begins at zero.

    Its increments are stationary and drawn by circulant embedding (Davies & Harte, Biometrika 74, 1987). All
    their covariances but the variance are negative and the sum of all is zero, hence the eigenvalues of the
    embedding are positive and the draw is exact.
    """
    y = np.zeros(n)
    if n < 2:
        return y
    half = _fast_length(n)
    lags = np.arange(half + 1)
    r = _averaged_increments(lags) if averaged else _discrete_increments(lags)
    power = np.fft.rfft(np.concatenate((r, r[-2:0:-1]))).real
    z = rng.standard_normal(half + 1) + 1j * rng.standard_normal(half + 1)
    z[[0, -1]] = z[[0, -1]].real * math.sqrt(2.0)
    z *= np.sqrt(np.maximum(power, 0.0) * half)
    np.cumsum(np.fft.irfft(z, 2 * half)[: n - 1], out=y[1:])
    return y


def _fast_length(n: int) -> int:
    """Return a length of at least n whose Fourier transform is fast."""
    return min(odd << max(0, math.ceil(math.log2(n / odd))) for odd in (1, 3, 5, 9, 15))


def _averaged_increments(lags: npt.NDArray[np.int64]) -> Floats:
    """Return the covariance of ybar[k+1] - ybar[k], flicker of B = 1.

    Fourth difference of the phase's generalised covariance t^2 ln|t| / (2 pi); beyond lag 32, where it would
    lose digits, from the derivatives.
    """
    near = np.arange(-2.0, 35.0)
    g = near**2 * np.log(np.maximum(np.abs(near), 1.0))
    r = np.zeros(len(lags))
    exact = min(len(lags), 33)
    r[:exact] = np.convolve(g, [1.0, -4.0, 6.0, -4.0, 1.0], mode="valid")[:exact]
    t2 = lags[exact:].astype(np.float64) ** -2.0
    r[exact:] = -t2 * (2.0 + t2 * (2.0 + t2 * (3.0 + t2 * 17.0 / 3.0)))
    return r / (2.0 * math.pi)


def _discrete_increments(lags: npt.NDArray[np.int64]) -> Floats:
    """Return the covariance of the increments of discrete 1/f noise, white noise through (1 - z^-1)^(1/2).

    Fractional noise of order -1/2 (Hosking, Biometrika 68, 1981): r[k] = r[k-1] (k - 3/2) / (k + 1/2).
    """
    k = lags[1:].astype(np.float64)
    return 4.0 / math.pi * np.concatenate(([1.0], np.cumprod((k - 1.5) / (k + 0.5))))


class _DiscreteFlicker:
    """Endless discrete 1/f noise of B = 1: a bank of first-order filters driven by the same white noise.

    The impulse response of (1 - z^-1)^(-1/2) consists of the moments of the arcsine distribution,
    h_k = 1/pi int_0^1 x^k / sqrt(x (1 - x)) dx, so it is a mixture of first-order filters with poles x. In
    v = logit x the trapezoidal rule converges exponentially; its poles are evenly spaced in log frequency.

    Parameters
    ----------
    channels : c.
    rate_hz : Hz.
    rng : draws the stationary state at the start.
    """

    def __init__(self, channels: int, rate_hz: float, rng: np.random.Generator) -> None:
        v = np.arange(-5.0, math.log(rate_hz / (2.0 * math.pi * LOWEST_POLE_HZ)) + POLE_STEP, POLE_STEP)
        self.poles = 1.0 / (1.0 + np.exp(-v))
        complement = 1.0 / (1.0 + np.exp(v))  # 1 - x, to all digits
        self.weights = POLE_STEP / math.pi * np.sqrt(self.poles * complement)
        self.weights[-1] /= -math.expm1(-POLE_STEP / 2.0)  # including those of all slower poles
        self.direct = 1.0 - self.weights.sum()  # the poles next to zero; h_0 = 1
        # The state of one filter is sum_k x^k u[-1-k]; the states share the u.
        covariance = 1.0 / (complement[:, None] + self.poles[:, None] * complement)
        scale = np.sqrt(np.diagonal(covariance))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        self._state = rng.standard_normal((channels, len(v))) @ root.T
        powers = np.exp(np.log1p(-complement)[:, None] * np.arange(STEP_SAMPLES + 1))  # (p, T + 1), x^k
        response = self.weights @ powers[:, :STEP_SAMPLES]
        response[0] = 1.0
        lag = np.arange(STEP_SAMPLES) - np.arange(STEP_SAMPLES)[:, None]  # of output j behind drive i
        self._forced = np.where(lag >= 0, response[np.abs(lag)], 0.0)
        self._free = self.weights[:, None] * powers[:, 1:]
        self._gather = powers[:, STEP_SAMPLES - 1 :: -1].T
        self._decay = powers[:, STEP_SAMPLES]

    def respond(self, drive: Floats) -> Floats:
        """Return the noise (c, b, T) that white noise (c, b, T) of unit variance drives."""
        gathered = drive @ self._gather
        states = np.empty_like(gathered)
        for b in range(drive.shape[1]):
            states[:, b] = self._state
            self._state = self._state * self._decay + gathered[:, b]
        return np.asarray(drive @ self._forced + states @ self._free)


class NoiseStream:
    """Endless noise of given coefficients in bounded memory; the series does not depend on the chunk sizes.

    Parameters
    ----------
    rate_hz : Hz, sample rate.
    N, B, K : scalar or (c,); channel unit/sqrt(Hz), channel unit, channel unit*sqrt(Hz).
    seed : of the generator, or the generator.
    averaged : samples are means over their intervals, else values at instants.

    Examples
    --------
    >>> one, two = (NoiseStream(40.0, N=6.1e-5, B=2.4e-5, K=1e-6, seed=7) for _ in range(2))
    >>> bool(np.array_equal(one.generate(5)[3:], (two.generate(3), two.generate(2))[1]))
    True
    """

    def __init__(
        self,
        rate_hz: float,
        N: Strength = 0.0,
        B: Strength = 0.0,
        K: Strength = 0.0,
        seed: Seed = None,
        *,
        averaged: bool = True,
    ) -> None:
        white, flicker, walk = _strengths(rate_hz, N, B, K)
        self._rng = np.random.default_rng(seed)
        self._averaged = averaged
        self._independent = _independent(white, walk, rate_hz, averaged)[:, None]
        self._step = (walk / math.sqrt(rate_hz))[:, None]
        self._walk = np.zeros((len(walk), 1))
        self._strength = flicker[:, None]
        self._flicker = _DiscreteFlicker(len(flicker), rate_hz, self._rng) if flicker.any() else None
        self._before: Floats | None = None  # discrete 1/f noise before this block
        self._origin = np.zeros((len(flicker), 1))  # flicker at the first sample
        self._ready = np.empty((0, len(white)))

    def generate(self, n: int) -> Floats:
        """Return the next `n` samples, (n, c) channel unit."""
        parts = [self._ready[:n]]
        self._ready = self._ready[n:]
        have = len(parts[0])
        while have < n:
            block = self._block()
            parts.append(block[: n - have])
            self._ready = block[n - have :]
            have += len(parts[-1])
        return np.concatenate(parts)

    def _block(self) -> Floats:
        """Return the next STEP_SAMPLES * BLOCK_STEPS samples."""
        c, n = len(self._independent), STEP_SAMPLES * BLOCK_STEPS
        y = self._independent * self._rng.standard_normal((c, n))
        if self._step.any():
            step = self._step * self._rng.standard_normal((c, n))
            walk = np.cumsum(step, axis=1)
            walk += self._walk
            self._walk = walk[:, -1:]
            y += walk
            step *= 0.5 if self._averaged else 1.0
            y -= step
        if self._flicker is not None:
            y += self._strength * self._next_flicker(self._flicker)
        return np.ascontiguousarray(y.T)

    def _next_flicker(self, bank: _DiscreteFlicker) -> Floats:
        """Return (c, n) flicker of B = 1 that begins at zero."""
        keep, n = len(AVERAGING) - 1 if self._averaged else 0, STEP_SAMPLES * BLOCK_STEPS
        first = self._before is None
        before = self._draw(bank)[:, n - keep :] if self._before is None else self._before
        y = x = np.concatenate((before, self._draw(bank)), axis=1)
        self._before = x[:, n:]
        if self._averaged:
            y = AVERAGING[0] * x[:, keep:]
            for lag, weight in enumerate(AVERAGING[1:], start=1):
                y += weight * x[:, keep - lag : keep - lag + n]
        if first:
            self._origin = y[:, :1]
        return np.asarray(y - self._origin)

    def _draw(self, bank: _DiscreteFlicker) -> Floats:
        """Return the next discrete 1/f noise, (c, n)."""
        c = len(self._independent)
        return bank.respond(self._rng.standard_normal((c, BLOCK_STEPS, STEP_SAMPLES))).reshape(c, -1)
