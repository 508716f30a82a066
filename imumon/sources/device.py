"""The device contract: what the daemon and the other packages need of a live source of samples.

A `Device` is one live source, whatever the transport: a serial port, a Zenoh topic, a socket. A `DeviceDriver`
makes devices of one kind and says what else is known of them. A driver registers under a URL scheme
(see `registry`); it may live in another distribution (docs/DEVICES.md).

Life of a device: `open` (find and identify, change nothing), `start` (make it send), then `read` until it is
lost or the run ends, `restore` (undo what `start` changed), `close`. After a loss the same object is closed
and opened again: it must find the same device, and its counters continue. After the end of its stream the run
ends. `DeviceReader` runs all of this in one thread. Only `interrupt` is called from another thread.
"""

from __future__ import annotations

import argparse
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, TypeAlias

from imumon.model.errors import ImumonError
from imumon.model.samples import DeviceCounters, DeviceInfo, Item, SampleBlock
from imumon.sources.clock import REAL_TIME, HostClock

RESTART_NS = 1_000_000_000
"""ns by which the clock of a restarted sensor goes back at least; less is a wrong order."""
READ_S = 0.2
"""s that one `Device.read` may wait for data."""
BATCH_S = 0.5
"""s for which bytes or messages are collected: each batch has a fixed cost. A report is at most this much behind."""
ARRIVAL_SAMPLES = 3.0
"""Samples by which a rate may differ from the host clock beside `READ_S` and `RATE_TOLERANCE`: it sees batches."""


class DeviceError(ImumonError):
    """The device cannot be used."""


class DeviceNotFound(DeviceError):
    """There is no such device, or none of the kind."""


class DeviceLost(DeviceError):
    """The device was there and is gone."""


class DeviceEnded(DeviceLost):
    """The stream is complete, and nothing will follow: the run ends with its report."""


class InvalidOption(DeviceError):
    """An option has a value that the device, or its emulator, cannot have."""


class Interrupted(Exception):
    """`Device.interrupt` was called: the call ends early.

    It is no `DeviceError`: what catches those to try again must not catch this.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceOptions:
    """What a driver creates a device from.

    Attributes
    ----------
    url : value of ``--port``: scheme and parameters; empty: the one device that is found.
    settings : the table ``[device]``, with attributes of the names in `imumon.config.DeviceSettings`: options of
        the command line and the settings file. A driver lists those that it uses in `DeviceDriver.settings`.
    table : the table that has the name of the scheme, such as ``[ros2]``, in the same way; None: there is none.
    state_directory : for what must survive a crash, such as settings to put back; None: keep nothing.
    time_lapse : the device is an emulator whose clock does not run as the host clock, and which waits for its reader.
    """

    url: str
    settings: Any = None
    table: Any = None
    state_directory: Path | None = None
    time_lapse: bool = False


class Device(ABC):
    """One live source of samples.

    Attributes
    ----------
    progress : called with a few words while `open` or `start` take long. Set by whoever wants to show them.
    """

    def __init__(self) -> None:
        self.progress: Callable[[str], None] = lambda text: None
        # an event and no flag: a port or a client of a network can wait for it together with its data
        self.interrupted = threading.Event()

    @abstractmethod
    def open(self) -> DeviceInfo:
        """Find the device and identify it, without changing it.

        Raises
        ------
        DeviceError : it is not there or cannot be used.
        """

    def start(self) -> DeviceInfo:
        """Make the device send samples, and remember what that changes, for `restore`.

        Raises
        ------
        DeviceError : it does not answer any more.
        """
        return self.info()

    def expected(self) -> DeviceInfo | None:
        """Return what is known of the device while it is absent; None: nothing.

        A device with a fixed name and place, such as a topic, is waited for; for others a run ends.
        """
        return None

    @abstractmethod
    def info(self) -> DeviceInfo:
        """Return what is known by now; it may grow with the samples. It is called after each read with items."""

    @abstractmethod
    def read(self, timeout_s: float) -> list[Item]:
        """Return what has arrived, in order; wait up to `timeout_s` for the first item.

        It also works without `start`: the device then sends what it sends. After `start` it includes health
        checks of the device: what they find is a `Notice`, and a `Gap` where the stream has no clock that shows
        its length. `RawBytes` come before the samples that were decoded from them. What `info` and `counters`
        return is looked at after each call.

        Raises
        ------
        DeviceLost : it is gone. What arrived before that has been returned.
        DeviceEnded : its stream is complete, such as a pipe whose writer has ended.
        """

    @property
    @abstractmethod
    def counters(self) -> DeviceCounters:
        """What was received and lost, over all connections."""

    def finish(self) -> list[Item]:
        """Return what is still held back, at the end of the stream."""
        return []

    def restore(self) -> bool:
        """Undo what `start` changed; return whether the device has confirmed all of it.

        It may be called at any moment between `open` and `close`, also after an interrupted `start`.
        """
        return True

    @abstractmethod
    def close(self) -> None:
        """Release the device; closing twice does no harm."""

    def interrupt(self) -> None:
        """Make a blocking `open`, `start` or `read` raise `Interrupted` soon. Called from another thread."""
        self.interrupted.set()

    def wait(self, seconds: float) -> None:
        """Sleep for `seconds`, or raise `Interrupted`: for devices that poll."""
        if self.interrupted.wait(seconds):
            raise Interrupted


class RawDecoder(Protocol):
    """Decoder of a raw capture: bytes in, items out, without I/O and clock.

    The counters add up: fed = bytes of valid messages + discarded + pending. Garbage never raises and never
    creates a sample.

    Attributes
    ----------
    fed : bytes fed so far.
    messages : valid messages of any type.
    message_bytes : bytes of these.
    discarded : bytes that belong to no valid message.
    bad_checksums : messages that were framed correctly and failed their check.
    pending : bytes held back until more come.
    ledger : what became of all messages but those that are samples (`imumon.model.ledger`).
    """

    @property
    def fed(self) -> int: ...
    @property
    def messages(self) -> int: ...
    @property
    def message_bytes(self) -> int: ...
    @property
    def discarded(self) -> int: ...
    @property
    def bad_checksums(self) -> int: ...
    @property
    def pending(self) -> int: ...
    @property
    def ledger(self) -> Mapping[str, int]: ...

    def feed(self, data: bytes) -> Sequence[object]:
        """Return the items that `data` completes, in the order in which they ended. Among them are
        `SampleBlock`; readers ignore what they do not know."""

    def finish(self) -> Sequence[object]:
        """Settle what is pending, at the end of the stream."""


def sample_blocks(items: Sequence[object]) -> list[SampleBlock]:
    """Return the sample blocks among the items of a decoder."""
    return [item for item in items if isinstance(item, SampleBlock)]


CheckStatus: TypeAlias = Literal["ok", "warning", "failed"]


@dataclass(frozen=True, slots=True)
class Check:
    """One line of `imumon doctor`: `name` is one word, `text` says what was seen, `cure` what to do."""

    name: str
    status: CheckStatus
    text: str
    cure: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What a few seconds of a stream showed.

    Attributes
    ----------
    info : what is known of the device and its stream.
    seconds : s of the host clock that were observed.
    bytes, messages, bad_checksums, discarded : since the first valid message; all 0 for devices without bytes.
    samples : of the stream that would be characterised.
    missing : lost samples as far as the sample clock or damaged messages show them; None: unknown.
    rate_hz : samples per second of the host clock; None with fewer than two.
    clock_ratio : seconds of the sample clock per second of the host clock; None without a clock.
    clock_jumps : times the sample clock went backwards or forwards by more than 10 s.
    longest_pause_s : s without data.
    lost : why the device was lost meanwhile; None: it was not.
    daemon : id of the daemon that was asked instead of the device.
    state : of that daemon.
    """

    info: DeviceInfo
    seconds: float
    bytes: int = 0
    messages: int = 0
    bad_checksums: int = 0
    discarded: int = 0
    samples: int = 0
    missing: int | None = None
    rate_hz: float | None = None
    clock_ratio: float | None = None
    clock_jumps: int = 0
    longest_pause_s: float = 0.0
    lost: str | None = None
    daemon: str | None = None
    state: str = "running"


class DeviceDriver(ABC):
    """What imumon knows of one kind of device. Only `scheme` and `create` are required.

    Attributes
    ----------
    scheme : URL scheme, the name of the entry point.
    title : name of the kind for people, such as "VectorNav VN-100".
    settings : names of the table ``[device]`` that have an effect on it; `imumon run` refuses others. ``rate_hz``
        gives samples without a clock their rate, whatever the device is.
    """

    scheme: ClassVar[str]
    title: ClassVar[str] = "device"
    settings: ClassVar[frozenset[str]] = frozenset({"rate_hz"})

    @abstractmethod
    def create(self, options: DeviceOptions) -> Device:
        """Return a device, not opened yet.

        Raises
        ------
        DeviceError : the URL is wrong.
        """

    # what other packages ask for, with answers for devices that have nothing to say

    def decoder(self, settings: Mapping[str, str] | None = None) -> RawDecoder | None:
        """Return a decoder of raw captures of this device; None if it has no bytes, which cannot be recorded.

        Parameters
        ----------
        settings : `DeviceInfo.settings` when the capture began; None: of a capture that does not say.
        """
        return None

    def checks(self, observation: Observation, settings: Any) -> Iterator[Check]:
        """Yield the checks of `imumon doctor` that only this kind of device has.

        A check replaces the generic one of the same name.

        Parameters
        ----------
        settings : the table ``[device]``, see `DeviceOptions`.
        """
        yield from ()

    def reference_sheet(self, model: str | None) -> Path | None:
        """Return a file with the published limits of this model (`imumon.documents.references`); None if there is none.

        The sensors that `imumon.documents.references` knows need none.
        """
        return None

    def alias_factor(self, window: int | None, rate_hz: float) -> float | None:
        """Return the factor by which aliasing inflates N of point samples; None if it is unknown.

        Parameters
        ----------
        window : samples that the filter of the sensor averages, 1: no filter; None: with its factory settings.
        rate_hz : Hz, output rate.
        """
        return None

    def filter_advice(self, rate_hz: float | None) -> Mapping[str, str]:
        """Return what is known of the sensor's filter, in sentences.

        Parameters
        ----------
        rate_hz : Hz, sample rate of the record.

        Returns
        -------
        ``aliased`` : how to configure the filter; ``unknown`` : its effect if the settings are unknown. Either may
        be missing.
        """
        return {}

    def setting_text(self, name: str, value: str) -> str | None:
        """Return what a setting of the device does, in a few words; None if that is unknown."""
        return None

    def emulator(
        self, *, clock: HostClock = REAL_TIME, seed: int | None = None
    ) -> AbstractContextManager[str]:
        """Return a running emulator as a context that gives its port.

        Raises
        ------
        DeviceError : there is no emulator.
        InvalidOption : the emulator cannot run in this time-lapse or with this seed.
        """
        raise DeviceError("no_emulator", f"there is no emulator of {self.title}", "use a real one")

    def add_emulator_options(self, parser: argparse.ArgumentParser) -> None:  # noqa: B027
        """Add the options of `imumon sim`."""

    def run_emulator(self, arguments: argparse.Namespace) -> int:
        """Run the emulator until a signal ends it; return the exit code.

        Raises
        ------
        DeviceError : there is no emulator.
        InvalidOption : an option has an invalid value.
        """
        raise DeviceError("no_emulator", f"there is no emulator of {self.title}", "use a real one")
