"""Options of a replay: what is read, how, and what is computed of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from imumon.model import report
from imumon.model.coefficients import default_precision
from imumon.model.cures import option_text
from imumon.model.errors import ImumonError
from imumon.model.samples import Kind
from imumon.sources import registry
from imumon.sources.clock import HostClock
from imumon.sources.device import DeviceDriver
from imumon.sources.files import ReadOptions, Recording, open_recording
from imumon.sources.files.array_table import INPUT, ArrayTable
from imumon.sources.files.base import BLOCK_BYTES, OptionError, Samples
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
    rate_hz : Hz, configured sample rate; None: not configured.
    pace : clock beside which the recording passes, as from a sensor; None: as fast as possible.
    guarded : exclude disturbances, motion and warm-up.
    precision : 95 % half-width to reach by coefficient, as a share of its value.
    max_loss : share of missing samples in a minute from which there is an alarm.
    baseline : an earlier report of the same sensor, to compare with.
    convergence : also state what a shorter record would have shown, at each doubling of its length.
    kind : stream of a table that has several; None: the best.
    columns : channel to ``COLUMN:UNIT`` of a table; empty: by its header.
    topic : of a bag or log.
    sensor : of a table or log, ``gyro`` or ``accel``, the only one that is read; None: all.
    where : by column of a table, the value of the rows that are read; None: all rows.
    filter : of the sensor; used where the recording does not say. None: not known.
    units : unit by sensor, also of ``time``; others are found by the names of columns.
    samples : ``point``, ``average`` or ``increment``; None: by the names of columns.
    definitions : path of a ``.msg`` file, or of a directory of them, for messages that a bag does not define.
    accept : take what is proposed for columns that are not certain.
    """

    path: str = ""
    arrays: Mapping[str, Any] | None = None
    rate_hz: float | None = None
    pace: HostClock | None = None
    guarded: bool = True
    max_loss: float = report.MAX_LOSS
    precision: Mapping[str, float] = field(default_factory=default_precision)
    baseline: report.Report | None = None
    convergence: bool = False
    kind: Kind | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    topic: str | None = None
    sensor: str | None = None
    where: Mapping[str, str] | None = None
    filter: SensorFilter | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    samples: Samples | None = None
    definitions: str | None = None
    accept: bool = False

    @property
    def name(self) -> str:
        """What messages call the recording."""
        return self.path if self.arrays is None else INPUT

    def open(self) -> Recording:
        """Open the recording; see `open_recording` and `ArrayTable`."""
        check_meaning(self.units, self.samples)
        options = ReadOptions(
            self.kind,
            self.columns,
            self.rate_hz,
            self.topic,
            self.sensor,
            self.where,
            BLOCK_BYTES if self.pace is None else PACED_BLOCK_BYTES,
            self.units,
            self.samples,
            self.definitions,
            self.accept,
        )
        if self.arrays is not None:
            return ArrayTable(self.arrays, options)
        return open_recording(self.path, options)
