"""Device reader: one device in a thread of its own, and its items in one bounded queue.

The thread opens the device, waits for `begin`, starts it, reads it, finds it again after a loss, and at the end
restores and closes it. Its only connection to the daemon is the queue, so a device that waits for an answer
delays nothing else. The queue blocks when it is full: the device then waits, or drops and counts.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeAlias

from imumon.model.errors import ImumonError
from imumon.model.samples import DeviceCounters, DeviceInfo, Item, SampleBlock
from imumon.sources.device import (
    READ_S,
    Device,
    DeviceDriver,
    DeviceEnded,
    DeviceError,
    DeviceNotFound,
    DeviceOptions,
    Interrupted,
)

log = logging.getLogger(__name__)

BATCHES = 4
"""Batches in the queue; one holds what one `Device.read` returned. They are a second of a live stream; behind them, a
port has a queue of bytes for more than a minute. Of a sensor in time-lapse, each has thousands of numbers and their
bytes: 32 of them kept 5 MB more."""
RETRY_S = 0.5
"""s between two attempts to open a device that was lost, and at least from one opening to the next."""
LONGEST_RETRY_S = 16.0
"""s to which that grows while a device opens and is lost again without a sample: the log must not fill."""
FIRST_RETRY_S = 2.0
"""s between two attempts to open a device that was never there."""
END_S = 1.0
"""s between the interrupt and the stop request, at most."""
REST_S = 0.1
"""s at the end in which samples that have arrived are still taken; more may arrive all the time."""


@dataclass(frozen=True, slots=True)
class Opened:
    """The device is identified for the first time; the reader waits for `DeviceReader.begin`."""

    info: DeviceInfo


@dataclass(frozen=True, slots=True)
class OpenFailed:
    """The device cannot be opened, or not started. It is tried again."""

    error: DeviceError
    again: bool  # after a loss
    expected: DeviceInfo | None = None  # of a device that is waited for


@dataclass(frozen=True, slots=True)
class Started:
    """The device sends samples, for the first time or again."""

    info: DeviceInfo
    again: bool


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The device was lost; the reader looks for it."""

    error: DeviceError


@dataclass(frozen=True, slots=True)
class Items:
    """What one read returned."""

    items: list[Item]


@dataclass(frozen=True, slots=True)
class Progress:
    """What the device is doing while it is opened or started."""

    text: str


@dataclass(frozen=True, slots=True)
class EndOfStream:
    """Nothing follows. `error` is what ended the reader if `stop` did not: `DeviceEnded`, or a failure."""

    error: BaseException | None = None


ReaderEvent: TypeAlias = Opened | OpenFailed | Started | Disconnected | Items | Progress | EndOfStream


class DeviceReader:
    """Reads one device.

    Parameters
    ----------
    device : not opened yet. From `start` on, only the reader calls it.

    Attributes
    ----------
    restored : after `join`: whether the device has its own settings back; None: it was never started.
    ended : `get` has returned `EndOfStream`.
    active_at : s, monotonic, when the thread last did something: it hangs if that is long ago.
    """

    def __init__(self, device: Device) -> None:
        self.restored: bool | None = None
        self.active_at = time.monotonic()
        self.ended = False
        self._device = device
        self._queue: queue.Queue[ReaderEvent] = queue.Queue(BATCHES)
        self._begin = threading.Event()
        self._stopping = threading.Event()
        self._discarding = False
        self._changed = False  # the device may have to be restored
        self._streaming = False
        self._sent: tuple[DeviceInfo | None, DeviceCounters | None] = (None, None)
        self._opened_s = 0.0  # monotonic
        self._retry_s = RETRY_S
        self._thread = threading.Thread(target=self._run, name="imumon-device", daemon=True)
        device.progress = lambda text: self._put(Progress(text))

    def start(self) -> None:
        """Open the device in the thread; the result is an event."""
        self._thread.start()

    def get(self, timeout_s: float) -> ReaderEvent | None:
        """Return the next event; None if there is none within `timeout_s`."""
        try:
            event = self._queue.get(timeout=timeout_s) if timeout_s > 0.0 else self._queue.get_nowait()
        except queue.Empty:
            return None
        self.ended |= isinstance(event, EndOfStream)
        return event

    def begin(self) -> None:
        """After `Opened`: let the device be started."""
        self._begin.set()

    def stop(self, *, discard: bool = False) -> None:
        """Ask the thread to end: it delivers what has arrived, then `EndOfStream`, then restores and closes.

        Parameters
        ----------
        discard : the events are not read any more.
        """
        self._discarding |= discard
        if not self._stopping.is_set():  # a second interrupt would end the restoring
            self._device.interrupt()
            self._stopping.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of the thread; return whether it has ended."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    # ------------------------------------------------------------------ in the thread

    def _run(self) -> None:
        """Run the device from its opening to its end, whatever fails; the last event is `EndOfStream`."""
        error: BaseException | None = None
        try:  # the inner one ends a run that was asked to stop, this one a run that cannot continue
            try:
                self._connect_first()
                while True:
                    lost = self._read_until_lost()
                    if isinstance(lost, DeviceEnded):
                        self._put_items(self._device.finish())
                        raise lost
                    self._streaming = False
                    self._device.close()
                    self._put(Disconnected(lost))
                    self._connect_again()
            except Interrupted:
                self._stopping.wait(END_S)  # `stop` is about to set it
                self._device.interrupted.clear()  # or the last reads would raise `Interrupted` again
                if self._streaming:
                    self._take_rest()
        except (DeviceError, MemoryError) as known:  # a lack of memory is no defect of the driver
            error = known
        except Exception as unexpected:
            error = device_failed(unexpected)
        self._stopping.set()  # from now on `stop` does not interrupt: that would end the restoring
        self._device.interrupted.clear()
        self._put(EndOfStream(error))
        self._leave()

    def _connect_first(self) -> None:
        """Open the device, wait for `begin` and start it; try again until that succeeds."""
        while True:
            try:
                info = self._device.open()
                self._begin.clear()
                self._put(Opened(info))
                self._wait(None)
                self._changed = True  # before `start`: one that fails may have written to the sensor
                self._started(again=False)
                return
            except DeviceError as error:
                self._leave()
                self._changed = False
                absent = isinstance(error, DeviceNotFound)
                self._put(
                    OpenFailed(error, again=False, expected=self._device.expected() if absent else None)
                )
            self._wait(FIRST_RETRY_S)

    def _connect_again(self) -> None:
        """Open and start the lost device; try again until it is back."""
        # from the last opening on: a device that ran for a while is looked for at once
        self._wait(max(0.0, self._opened_s + self._retry_s - time.monotonic()))
        while True:
            try:
                self._device.open()
                self._started(again=True)
                return
            except DeviceError as error:
                self._leave()
                self._put(OpenFailed(error, again=True))
            self._wait(RETRY_S)

    def _started(self, *, again: bool) -> None:
        info = self._device.start()
        self._sent = (info, self._sent[1])
        self._put(Started(info, again))
        self._streaming, self._opened_s = True, time.monotonic()
        self._retry_s = min(2.0 * self._retry_s, LONGEST_RETRY_S)

    def _put_items(self, items: list[Item]) -> None:
        """Put what the device returned, with the facts and the counters that have changed."""
        info, counters = self._sent
        self._sent = (self._device.info() if items else info, self._device.counters)
        facts: list[Item] = [self._sent[0]] if self._sent[0] is not None and self._sent[0] != info else []
        counts: list[Item] = (
            [self._sent[1]] if self._sent[1] is not None and self._sent[1] != counters else []
        )
        if any(isinstance(item, SampleBlock) for item in items):
            self._retry_s = RETRY_S
        if items := [*facts, *items, *counts]:
            self._put(Items(items))

    def _read_until_lost(self) -> DeviceError:
        try:
            while not self._stopping.is_set():
                self._put_items(self._device.read(READ_S))
                self.active_at = time.monotonic()
        except DeviceError as error:
            return error
        raise Interrupted

    def _wait(self, seconds: float | None) -> None:
        """Wait for some seconds, or for `begin` if None; raise `Interrupted` once a stop is requested."""
        self.active_at = time.monotonic()
        if seconds is None:
            while not self._begin.wait(0.2) and not self._stopping.is_set():
                pass
        else:
            self._stopping.wait(seconds)
        if self._stopping.is_set():
            raise Interrupted

    def _take_rest(self) -> None:
        """Deliver what has arrived, and what the device holds back."""
        end = time.monotonic() + REST_S
        with suppress(DeviceError):
            while time.monotonic() < end and (items := self._device.read(0.0)):
                before = time.monotonic()
                self._put_items(items)
                end += time.monotonic() - before  # a full queue takes no time from the device
        self._put_items(self._device.finish())

    def _leave(self) -> None:
        """Restore what `start` changed, and close the device; whatever happens, the thread continues."""
        try:
            if self._changed:
                self.restored = False
                self.restored = self._device.restore()
        except Exception as error:
            log.warning("the device cannot be restored (%s)", error)
        try:
            self._device.close()
        except Exception as error:
            log.warning("the device cannot be closed (%s)", error)

    def _put(self, event: ReaderEvent) -> None:
        """Put an event; wait while the queue is full."""
        self.active_at = time.monotonic()
        while not self._discarding:  # checked each time: a stop may mean that the queue is not read any more
            with suppress(queue.Full):
                self._queue.put(event, timeout=0.2)
                return


def device_failed(error: Exception) -> DeviceError:
    """Return the error of a device that raised something else than a `DeviceError`: a defect of its driver."""
    return DeviceError(
        "device_failed",
        f"the driver failed ({type(error).__name__}: {error})",
        "report it to the author of its driver",
    )


def create_device(driver: DeviceDriver, options: DeviceOptions) -> Device:
    """Return a device of a driver.

    Raises
    ------
    DeviceError : the URL is wrong, or the driver has a defect.
    """
    try:
        return driver.create(options)
    except ImumonError:
        raise
    except Exception as error:
        raise device_failed(error) from error
