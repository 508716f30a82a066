"""Options of a replay: what is read, how, and what is computed of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

from imumon.model.cures import option_text
from imumon.model.errors import ImumonError
from imumon.record import RecordOptions
from imumon.sources import registry
from imumon.sources.clock import HostClock
from imumon.sources.device import DeviceDriver
from imumon.sources.files import ReadOptions, Recording, open_recording
from imumon.sources.files.array_table import INPUT, ArrayTable
from imumon.sources.files.base import OptionError
from imumon.sources.files.columns import check_meaning

PACED_BLOCK_BYTES = 1 << 12
"""Bytes that are decoded at once if a pace is kept: a second of samples or less."""


class FilterUnknown(ImumonError):
    """The effect of the filter that a user names is unknown for this device."""


@dataclass(frozen=True, slots=True)
class SensorFilter:
    """The filter of the sensor, as a user names it for a recording that does not say.

    Attributes
    ----------
    window : samples that it averages, 1: none; None: with the factory settings of the device.
    loop_hz : Hz, rate of the samples that it averages; None: that of the device.
    text : as it was given.
    """

    window: int | None
    loop_hz: float | None
    text: str

    @classmethod
    def parse(cls, text: str) -> SensorFilter:
        """Return the filter that a text names: ``none``, ``factory``, ``8`` samples, or ``8@1000`` at their rate.

        Raises
        ------
        OptionError : it names none.
        """
        name, separator, rate = text.partition("@")
        if name == "factory" and not separator:
            return cls(None, None, text)
        with suppress(ValueError):
            loop_hz = float(rate) if separator else None
            window = 1 if name == "none" else max(1, int(name)) if name.isdigit() and len(name) < 7 else 0
            if window and (loop_hz is None or 0.0 < loop_hz < math.inf):
                return cls(window, loop_hz, text)
        cure = "write none, factory, or how many samples it averages, such as 4 or 8@1000"
        raise OptionError("filter_invalid", f"{text!r} is no filter", cure)

    def alias_factor(self, driver: DeviceDriver | None, rate_hz: float) -> float:
        """Return the nominal factor by which aliasing inflates N of point samples.

        Raises
        ------
        FilterUnknown : the device has no known filter, and no rate is given.
        """
        if self.loop_hz is not None and self.window is not None:
            return max(1.0, math.sqrt(self.loop_hz / (self.window * rate_hz)))
        factor = (driver or registry.driver()).alias_factor(self.window, rate_hz)
        if factor is None:
            message = f"{option_text(filter=self.text)}: the filter of this device is not known"
            raise FilterUnknown("filter_unknown", message, "give its samples and their rate, such as 8@1000")
        return factor

    def assumption(self, driver: DeviceDriver | None) -> str | None:
        """Return what is assumed of a device that the recording does not name; None: nothing."""
        if driver is not None or self.loop_hz is not None:
            return None
        unknown = "filter is" if self.window is None else "rate before the filter is"
        assumed = "the factory setting" if self.window is None else "that"
        return f"the recording names no device: its {unknown} assumed to be {assumed} of a {registry.driver().title}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """How to replay a recording.

    Attributes
    ----------
    path : of the recording; empty: `arrays` are given.
    arrays : (n,), (n, 1) or (n, 3) by name, in memory; None: a file is given.
    read : how to read it.
    record : what is computed of it.
    filter : of the sensor; used where the recording does not say. None: not known.
    pace : clock beside which the recording passes, as from a sensor; None: as fast as possible.
    """

    path: str = ""
    arrays: Mapping[str, Any] | None = None
    read: ReadOptions = field(default_factory=ReadOptions)
    record: RecordOptions = field(default_factory=RecordOptions)
    filter: SensorFilter | None = None
    pace: HostClock | None = None

    @property
    def name(self) -> str:
        """What messages call the recording."""
        return self.path if self.arrays is None else INPUT

    def open(self) -> Recording:
        """Open the recording; see `open_recording` and `ArrayTable`."""
        read = self.read
        check_meaning(read.units, read.samples)
        if self.pace is not None:
            read = replace(read, block_bytes=PACED_BLOCK_BYTES)
        if self.arrays is not None:
            return ArrayTable(self.arrays, read)
        return open_recording(self.path, read)
