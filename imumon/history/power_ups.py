"""Power-ups of a sensor: when its clock restarted, and its bias once it had settled.

A gyroscope wakes up with another bias each time; data sheets call the standard deviation the turn-on bias
repeatability. A restart of the daemon is no power-up: the clock of the sensor shows which it was. The clock of the
same power-up has advanced by as much as that of the host; one that restarted is behind.

The settled bias is the mean of the first whole hour that begins half an hour after the power-up, of a sensor that is
not warming up any more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imumon.history.store import PowerUp, TimedPeriod
from imumon.model.report import WARM_S, Distribution, Report
from imumon.noise.statistics.moments import deviation_limits

SAME_S, SAME_SHARE = 60.0, 1e-3
"""s, and share of the time that passed, by which the clock of the sensor may lag behind that of the host in one
power-up: delays of the line, and clocks of 1000 ppm."""
LEAST_POWER_UPS = 5
"""Power-ups from which the repeatability is given: from fewer, its upper limit is over three times its value."""
LEAST_COUNTED = 0.5
"""Share of its samples that a period must have, and not excluded, to give a settled bias."""


class PowerUps:
    """The power-ups of one sensor.

    Parameters
    ----------
    known : from the file, oldest first.
    real_time : whether the clock of the sensor runs as fast as that of the host; not in time-lapse.
    """

    def __init__(self, known: list[PowerUp], *, real_time: bool = True) -> None:
        self._all = list(known)
        self._real_time = real_time
        self._confirmed = False

    @property
    def newest(self) -> PowerUp | None:
        """The power-up in progress; None before the clock was seen."""
        return self._all[-1] if self._confirmed else None

    def biases(self, channel: str) -> list[float]:
        """Return the settled biases of a channel, channel unit, one per power-up, oldest first."""
        return [power_up.means[channel] for power_up in self._all if channel in power_up.means]

    def described(self, distribution: Distribution, channel: str) -> Distribution:
        """Return the shape of a channel with the repeatability of its turn-on bias."""
        biases = self.biases(channel)
        if not biases:
            return distribution
        std = low = high = None
        if len(biases) >= LEAST_POWER_UPS:
            std = float(np.std(biases, ddof=1))
            low, high = deviation_limits(std, len(biases) - 1)
        counted = replace(distribution, turn_on_count=len(biases))
        return replace(counted, turn_on_std=std, turn_on_low=low, turn_on_high=high)

    def annotated(self, report: Report) -> Report:
        """Return a report with the repeatability of the turn-on bias of each channel."""
        channels = {
            name: replace(channel, distribution=self.described(channel.distribution or Distribution(), name))
            if self.biases(name)
            else channel
            for name, channel in report.channels.items()
        }
        return replace(report, channels=channels)

    def update(self, clock_s: float, now: float) -> None:
        """Note the clock of the sensor.

        Parameters
        ----------
        clock_s : s since its power-up.
        now : s since 1970, when that was.
        """
        last = self._all[-1] if self._all else None
        if last is None or self._restarted(last, clock_s, now):
            self._all.append(PowerUp(time=now - clock_s, clock_s=clock_s, seen=now, means={}))
        else:
            self._all[-1] = replace(last, clock_s=clock_s, seen=now)
        self._confirmed = True

    def _restarted(self, last: PowerUp, clock_s: float, now: float) -> bool:
        passed = now - last.seen
        lag = passed - (clock_s - last.clock_s)
        behind = self._real_time and lag > SAME_S + SAME_SHARE * max(passed, 0.0)
        return clock_s < last.clock_s or behind

    def settle(self, timed: TimedPeriod, clock_s: float) -> bool:
        """Take the settled bias from a period that has ended, if it is the first that shows it.

        Parameters
        ----------
        clock_s : s since the power-up, at the beginning of the period.
        """
        period, newest = timed.period, self.newest
        counted = period.samples / max(period.samples + period.missing, 1)
        length_s = max(timed.end - timed.begin, 1e-9)
        excluded = min(period.excluded_s / min(length_s, period.step_s), 1.0)
        if newest is None or newest.means or not period.complete or period.warming_up or clock_s < WARM_S:
            return False
        if counted * (1.0 - excluded) < LEAST_COUNTED:
            return False
        means = {
            str(name): channel.mean
            for name, channel in period.channels.items()
            if channel.mean is not None and name.sensor in ("gyro", "accel")
        }
        self._all[-1] = replace(newest, means=means)
        return bool(means)
