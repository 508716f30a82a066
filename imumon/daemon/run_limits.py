"""Run: what to run, what ends it, how long a device may be silent, and when a duty is due."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from imumon.model.report import Report
from imumon.sources.clock import REAL_TIME, HostClock

ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end the run in order; others end the process, and the next run restores the device."""

TIMEOUT_S = 2.0
"""s without data after which a device counts as silent."""
TIMEOUT_SAMPLES = 5.0
"""Sample intervals without data that are needed as well, for slow streams."""
START_TIMEOUT_S = 30.0
"""s in which bytes must become samples at the start; a service manager waits longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """What to run, beside the settings.

    Attributes
    ----------
    url : of the device, see `imumon.sources.registry.driver_of`; empty: the only one that is found.
    state_directory : of the accumulated statistics.
    duration_s : s of the host clock; None: unlimited.
    fresh : start a new record; the old state is kept under another name.
    temporary : the state directory is deleted after the run.
    clock : of the host; in time-lapse for an emulator that is.
    baseline : an earlier report of the same sensor, to compare with.
    """

    url: str
    state_directory: Path
    duration_s: float | None = None
    fresh: bool = False
    temporary: bool = False
    clock: HostClock = REAL_TIME
    baseline: Report | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended.

    Attributes
    ----------
    report : the final one; None if no device was ever there.
    signal : that ended it; None: none did.
    ended : the stream of the device was complete.
    unsaved : why the last state is not saved; None: it is, or there is none.
    unrecorded : why the recording is not complete; None: it is, or there is none.
    """

    report: Report | None
    signal: int | None
    ended: bool
    unsaved: str | None = None
    unrecorded: str | None = None


class Shutdown:
    """The end of one run: a signal, or the end of its duration.

    Parameters
    ----------
    duration_s : s of the host clock, from now on; None: unlimited.
    clock : of the host.

    Attributes
    ----------
    signal : the last signal that was received, None before.
    """

    def __init__(self, duration_s: float | None, clock: HostClock) -> None:
        self._clock = clock
        self.signal: int | None = None
        self._deadline = clock.monotonic_s() + duration_s if duration_s else None

    @property
    def requested(self) -> bool:
        """Whether the daemon has to stop."""
        over = self._deadline is not None and self._clock.monotonic_s() >= self._deadline
        return over or self.signal is not None

    @contextmanager
    def handling_signals(self) -> Iterator[None]:
        """Let signals end the run instead of the process.

        Once SIGINT has ended the run, it stays ignored: a second ^C must not interrupt the end of the interpreter.
        """

        def handle(number: int, frame: FrameType | None) -> None:
            self.signal = number

        # what was started with nohup ignores that its terminal closes
        handled = [n for n in ENDING if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
        before = {number: signal.signal(number, handle) for number in handled}
        try:
            yield
        finally:
            if self.signal == signal.SIGINT:
                before[signal.SIGINT] = signal.SIG_IGN
            for number, handler in before.items():
                signal.signal(number, handler)


class DataTimeout:
    """Whether a device is silent: no data, or no samples, for longer than either may take.

    Bytes without samples are no sign of life, except at the start. The clock is an argument, and it is looked at
    only when the device was read: a busy daemon is no silence.
    """

    def __init__(self) -> None:
        self._no_data_since: float | None = None
        self._no_samples_since: float | None = None

    def update(
        self, now: float, *, data: bool, samples: bool, rate_hz: float | None, starting: bool
    ) -> str | None:
        """Return what is missing, one line; None while all is well.

        Parameters
        ----------
        now : s, monotonic.
        data, samples : whether data, and samples in them, arrived just now.
        rate_hz : Hz, of the samples if it is known.
        starting : no sample has arrived yet.
        """
        timeout = timeout_s(rate_hz)
        self._no_data_since = None if data else self._no_data_since or now
        self._no_samples_since = None if samples else self._no_samples_since or now
        if now - (self._no_data_since or now) > timeout:
            return "nothing arrives from the sensor"
        if now - (self._no_samples_since or now) > (START_TIMEOUT_S if starting else timeout):
            return "data arrive, but no samples of the stream"
        return None


class Timer:
    """A duty that is due once per period. One that is late is not repeated at once.

    Parameters
    ----------
    period_s : s between two times; the first is due at once.

    Attributes
    ----------
    next_s : s, monotonic, from which it is due again.

    Examples
    --------
    >>> timer = Timer(1.0)
    >>> [timer.is_due(now) for now in (10.0, 10.5, 11.1, 12.0, 15.0, 15.5)]
    [True, False, True, True, True, False]
    """

    def __init__(self, period_s: float) -> None:
        self._period_s, self.next_s = period_s, 0.0

    def is_due(self, now: float) -> bool:
        """Return whether the duty is due at `now`, s, monotonic; if so, the next one is a period later."""
        if now < self.next_s:
            return False
        self.next_s += self._period_s
        if self.next_s <= now:
            self.restart(now)
        return True

    def restart(self, now: float) -> None:
        """Let the duty be due a period after `now`, s, monotonic."""
        self.next_s = now + self._period_s

    def expire(self) -> None:
        """Let the duty be due at once."""
        self.next_s = 0.0


def timeout_s(rate_hz: float | None) -> float:
    """Return the silence that is longer than any sample takes.

    >>> timeout_s(100.0), timeout_s(None), timeout_s(0.5)
    (2.0, 5.0, 10.0)
    """
    return max(TIMEOUT_S, TIMEOUT_SAMPLES / (rate_hz or 1.0))
