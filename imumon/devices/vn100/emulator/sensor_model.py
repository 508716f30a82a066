"""Signals of the sensor: what its elements feel, 800 times a second.

The tape holds what a perfect 800 Hz converter would give: constant parts, and on them white noise,
flicker and random walk of the coefficients that are asked for. It is kept as running sums, since all that
a VN-100 makes of it are sums: boxcar means (register 85) and increments (DeltaTheta, DeltaVel). The
elements' own bandwidth, 256 Hz for the gyro and 260 Hz for the accelerometer, is a symmetric filter of three
taps with its -3 dB point there; increments are taken before it. The tape has a past when it starts: tick 0
is no beginning of anything but the warm-up.

The magnetometer is read 250 times a second and holds its value between readings, so 69 % of its values
at 800 Hz are repeats, as on the real part. Ticks are counted from the first one ever made; what the
sensor calls its start is the device's matter.
"""

from __future__ import annotations

from math import cos, pi, sqrt

import numpy as np

from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings, Noise
from imumon.devices.vn100.registers import LOOP_RATE
from imumon.noise.synthesis import NoiseStream
from imumon.samples import Floats, Ints

GYRO, ACCEL, MAG, TEMPERATURE, PRESSURE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 10), slice(10, 11)
MAG_RATE = 250
CONSTANT = np.array([0.0152, -0.0113, -0.0064, 0.012, -0.021, -9.793746, 0.21, 0.03, 0.44, 25.0, 101.2])
"""(11,) rad/s, m/s^2, gauss, degC, kPa: what is measured without noise, level and at rest."""

HISTORY = LOOP_RATE + 8
"""Ticks that are kept behind the present: the longest window of register 85, and the filter's taps."""

JITTER_S = 4.7e-6
"""Standard deviation of a time stamp, as measured on a real unit at 800 Hz."""


def _tap(bandwidth: float) -> float:
    """Outer tap a of [a, 1 - 2a, a], whose gain 1 - 2a (1 - cos w) is 1/sqrt(2) at the bandwidth in Hz."""
    return (1.0 - sqrt(0.5)) / (2.0 * (1.0 - cos(2.0 * pi * bandwidth / LOOP_RATE)))


_TAPS = {GYRO.start: _tap(256.0), ACCEL.start: _tap(260.0)}


def _stream(noise: Noise, rate: float, seed: np.random.SeedSequence) -> NoiseStream:
    return NoiseStream(rate, noise.n, noise.b, noise.k, np.random.default_rng(seed))


class SensorModel:
    """The sensor's elements at every tick, as running sums.

    Parameters
    ----------
    settings : coefficients, hum and warm-up.
    """

    def __init__(self, settings: EmulatorSettings) -> None:
        self._settings = settings
        seeds = np.random.SeedSequence(settings.seed).spawn(6)
        self._gyro = _stream(settings.gyro, LOOP_RATE, seeds[0])
        self._accel = _stream(settings.accel, LOOP_RATE, seeds[1])
        self._mag = _stream(settings.mag, MAG_RATE, seeds[2])
        self._thermometer, self._barometer, self._stamps = (np.random.default_rng(seed) for seed in seeds[3:])
        self._held = np.zeros((3, 1))
        self._sums = np.zeros((len(CONSTANT), HISTORY + 1))
        self._jitter = np.zeros(HISTORY)
        self._first, self.end = -2 * HISTORY, -HISTORY
        self.extend(HISTORY)

    def extend(self, ticks: int) -> None:
        """Make so many ticks more, and forget what no output can reach any more."""
        at = np.arange(self.end, self.end + ticks)
        new = np.empty((len(CONSTANT), ticks))
        warm = self._settings.warm_up * -np.exp(-np.maximum(at, 0) / (self._settings.warm_up_s * LOOP_RATE))
        new[GYRO] = self._gyro.generate(ticks).T + self._settings.gyro_thermal * warm
        new[ACCEL] = self._accel.generate(ticks).T
        new[MAG] = self._magnetic(at)
        new[TEMPERATURE] = warm + 0.02 * self._thermometer.standard_normal(ticks)
        new[PRESSURE] = 0.003 * self._barometer.standard_normal(ticks)
        keep = self._sums[:, -(HISTORY + 1) :]
        self._sums = np.concatenate((keep, new), axis=1)
        sums = self._sums[:, HISTORY:]
        np.cumsum(sums, axis=1, out=sums)
        self._jitter = np.concatenate(
            (self._jitter[-HISTORY:], JITTER_S * self._stamps.standard_normal(ticks))
        )
        self._first = self.end - HISTORY
        self.end += ticks

    def _magnetic(self, at: Ints) -> Floats:
        """Magnetometer at each tick, (3, n) gauss: the reading that was last taken."""
        reading = at * MAG_RATE // LOOP_RATE
        before = (at[0] - 1) * MAG_RATE // LOOP_RATE
        fresh = self._mag.generate(int(reading[-1] - before)).T
        if self._settings.hum:
            when = np.arange(before + 1, reading[-1] + 1) / MAG_RATE
            phase = 2.0 * pi * self._settings.hum_hz * when
            fresh = fresh + self._settings.hum * np.sin(phase + np.array([[0.0], [1.0], [2.0]]))
        known = np.concatenate((self._held, fresh), axis=1)
        self._held = known[:, -1:]
        return np.asarray(known[:, reading - before])

    def integral(self, ticks: Ints, columns: slice) -> Floats:
        """Sum over every tick before each of `ticks`, divided by the rate, (n, k) channel unit * s."""
        total = self._sums[columns][:, ticks - self._first].T + CONSTANT[columns] * ticks[:, None]
        return np.asarray(total / LOOP_RATE)

    def mean(self, ticks: Ints, columns: slice, window: int) -> Floats:
        """What the sensor reads at each of `ticks`, (n, k) channel unit.

        Behind the element's bandwidth, the mean of the `window` newest values; 0 and 1 filter nothing.
        """
        sums = self._sums[columns]
        width = max(1, window)
        end = ticks - self._first + 1

        def box(delay: int) -> Floats:
            return np.asarray(sums[:, end - delay] - sums[:, end - delay - width])

        tap = _TAPS.get(columns.start)
        total = box(0) if tap is None else tap * (box(0) + box(2)) + (1.0 - 2.0 * tap) * box(1)
        return np.asarray(total.T / width + CONSTANT[columns])

    def jitter(self, ticks: Ints) -> Floats:
        """Error of the time stamp at each of `ticks`, (n,) s."""
        return self._jitter[ticks - self._first]
