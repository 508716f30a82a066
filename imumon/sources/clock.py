"""Host clock: what time it is, and how long a part of the record takes on this machine.

Two clocks run side by side. The *sample clock* counts the seconds of the record: intervals, lengths of gaps, ages of
periods. The *host clock* counts the seconds of the machine: deadlines, duties, stamps. With a real sensor, a second of
one is a second of the other. An emulator in time-lapse runs its sample clock several times as fast, so a length must be
converted when it crosses from one clock to the other. `HostClock` is the only place that knows the factor.

The host has three ways to read its clock, and none replaces another:

============  ================  ======================  =====================================================
reading       may be set back   runs while it sleeps    for
============  ================  ======================  =====================================================
`now`,        yes               yes                     stamps, which people and files compare
`time_s`
`monotonic_s` no                no                      deadlines and periods of duties
`uptime_s`    no                yes, on Linux           gaps of a stream: the sensor does not sleep with the host
============  ================  ======================  =====================================================

Who needs the time gets the clock as an argument, so a test can give another one. Standard library only.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime


@dataclass(frozen=True, slots=True)
class HostClock:
    """Clock of the machine beside the sample clock of one sensor.

    Attributes
    ----------
    time_lapse : seconds of the sample clock per second of the host clock. Other than 1 for an emulator only.

    Raises
    ------
    ValueError : the factor is not above 0.

    Examples
    --------
    >>> clock = HostClock(time_lapse=60.0)
    >>> clock.to_sample_s(2.0), clock.to_host_s(600.0), clock.is_real_time
    (120.0, 10.0, False)
    """

    time_lapse: float = 1.0

    def __post_init__(self) -> None:
        if not self.time_lapse > 0.0:  # NaN too
            raise ValueError(f"the factor of a time-lapse must be above 0, not {self.time_lapse}")

    @property
    def is_real_time(self) -> bool:
        """Whether a second of the host clock is a second of the sample clock.

        In time-lapse it is only so on the average: the emulator waits for its reader. The host clock then proves
        nothing about a jump of the sample clock.
        """
        return self.time_lapse == 1.0

    def to_sample_s(self, host_s: float) -> float:
        """Return the s of the sample clock in a length of time by the host clock, s."""
        return host_s * self.time_lapse

    def to_host_s(self, sample_s: float) -> float:
        """Return the s of the host clock in a length of time by the sample clock, s."""
        return sample_s / self.time_lapse

    def now(self) -> datetime:
        """Return the date and time, UTC."""
        return datetime.now(UTC)

    def time_s(self) -> float:
        """Return the s since 1970, as of `now`."""
        return time.time()

    def monotonic_s(self) -> float:
        """Return the s of a clock that is never set, since an unknown moment."""
        return time.monotonic()

    def uptime_s(self) -> float:
        """Return the s since the boot, with those in which the machine slept if the system counts them."""
        return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


REAL_TIME = HostClock()
"""Clock beside that of any real sensor."""
