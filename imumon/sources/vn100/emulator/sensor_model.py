"""Sensor model: the signals of the sensor elements, 800 times a second.

The model holds what an ideal 800 Hz converter would deliver: constants plus white noise, flicker noise and
random walk of the configured coefficients. It keeps running sums, because everything that a VN-100 derives
from them is a sum: moving averages (register 85) and increments (DeltaTheta, DeltaVel). At tick 0 the noise is already
stationary; only the warm-up begins there.

The magnetometer is read 250 times a second and holds its value between readings, so 69 % of its values at
800 Hz are repeats, as on the real device. Ticks count from the creation of the model, not from a reset.
"""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.noise.synthesis import NoiseStream
from imumon.sources.vn100.emulator.emulator_settings import EmulatorSettings, Noise
from imumon.sources.vn100.registers import LOOP_RATE

GYRO, ACCEL, MAG, TEMPERATURE, PRESSURE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 10), slice(10, 11)
MAG_RATE = 250
"""Hz, readings of the magnetometer."""
CONSTANT = np.array([0.0152, -0.0113, -0.0064, 0.012, -0.021, -9.793746, 0.21, 0.03, 0.44, 25.0, 101.2])
"""(11,) rad/s, m/s^2, gauss, degC, kPa: measurements without noise, level and at rest."""

PAST_TICKS = LOOP_RATE + 8
"""Ticks kept before the newest one: the longest window of register 85, and some."""

JITTER_S = 4.7e-6
"""s, standard deviation of a time stamp, as measured on a real device at 800 Hz."""


def _stream(noise: Noise, rate: float, seed: np.random.SeedSequence) -> NoiseStream:
    return NoiseStream(rate, noise.n, noise.b, noise.k, np.random.default_rng(seed))


class SensorModel:
    """Signals of the sensor elements at every tick, as running sums.

    Parameters
    ----------
    settings : coefficients and warm-up.

    Attributes
    ----------
    end : tick after the newest one.
    """

    def __init__(self, settings: EmulatorSettings) -> None:
        self._settings = settings
        seeds = np.random.SeedSequence(settings.seed).spawn(6)
        self._gyro = _stream(settings.gyro, LOOP_RATE, seeds[0])
        self._accel = _stream(settings.accel, LOOP_RATE, seeds[1])
        self._mag = _stream(settings.mag, MAG_RATE, seeds[2])
        self._thermometer, self._barometer, self._clock = (np.random.default_rng(seed) for seed in seeds[3:])
        self._held_mag = np.zeros((3, 1))
        self._sums = np.zeros((len(CONSTANT), PAST_TICKS + 1))
        self._jitter = np.zeros(PAST_TICKS)
        # begin in the past, so that the longest window is full at tick 0
        self._first, self.end = -2 * PAST_TICKS, -PAST_TICKS
        self.extend(PAST_TICKS)

    def extend(self, ticks: int) -> None:
        """Compute `ticks` more ticks; drop those before the history."""
        new_ticks = np.arange(self.end, self.end + ticks)
        new = np.empty((len(CONSTANT), ticks))
        warm = self._settings.warm_up * -np.exp(
            -np.maximum(new_ticks, 0) / (self._settings.warm_up_s * LOOP_RATE)
        )
        new[GYRO] = self._gyro.generate(ticks).T + self._settings.gyro_thermal * warm
        new[ACCEL] = self._accel.generate(ticks).T
        new[MAG] = self._magnetic(new_ticks)
        new[TEMPERATURE] = warm + 0.02 * self._thermometer.standard_normal(ticks)
        new[PRESSURE] = 0.003 * self._barometer.standard_normal(ticks)
        self._sums = np.concatenate((self._sums[:, -(PAST_TICKS + 1) :], new), axis=1)
        # from the last total on. Without the constants, which `integral` adds: the digits are those of the noise
        sums = self._sums[:, PAST_TICKS:]
        np.cumsum(sums, axis=1, out=sums)
        jitter = JITTER_S * self._clock.standard_normal(ticks)
        self._jitter = np.concatenate((self._jitter[-PAST_TICKS:], jitter))
        self._first = self.end - PAST_TICKS
        self.end += ticks

    def _magnetic(self, ticks: Ints) -> Floats:
        """Return the last magnetometer reading at each tick, (3, n) gauss."""
        reading = ticks * MAG_RATE // LOOP_RATE
        before = (ticks[0] - 1) * MAG_RATE // LOOP_RATE
        fresh = self._mag.generate(int(reading[-1] - before)).T
        readings = np.concatenate((self._held_mag, fresh), axis=1)
        self._held_mag = readings[:, -1:]
        return np.asarray(readings[:, reading - before])

    def integral(self, ticks: Ints, columns: slice) -> Floats:
        """Return the sum over all ticks before each of `ticks` divided by the rate, (n, k) channel unit * s."""
        total = self._sums[columns][:, ticks - self._first].T + CONSTANT[columns] * ticks[:, None]
        return np.asarray(total / LOOP_RATE)

    def mean(self, ticks: Ints, columns: slice, window: int) -> Floats:
        """Return the mean of the `window` newest values at each of `ticks`, (n, k) channel unit.

        Windows of 0 and 1 do not filter.
        """
        sums, width = self._sums[columns], max(1, window)
        end = ticks - self._first + 1
        return np.asarray((sums[:, end] - sums[:, end - width]).T / width + CONSTANT[columns])

    def jitter(self, ticks: Ints) -> Floats:
        """Return the error of the time stamp at each of `ticks`, (n,) s."""
        return self._jitter[ticks - self._first]
