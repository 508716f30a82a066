"""Measurement: the noise of a sensor as a program and a notebook read it.

`Measurement.report` has every number; what is beside it here is a view of the report: channels by name, tables,
figures, numbers for filters. pandas, xarray and matplotlib are imported by the methods that return their types.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imumon.api.curve_table import CurveTable, curve_table, frame_of
from imumon.files import replace_file
from imumon.model.errors import ImumonError
from imumon.model.filter_report import LONGEST_HORIZON_S, SHORTEST_HORIZON_S, FilterReport
from imumon.model.ledger import SAMPLES, with_received
from imumon.model.report import Channel, Event, Report, SensorGrade, from_json
from imumon.model.report_json import MAX_BYTES, to_json
from imumon.model.samples import ChannelName
from imumon.model.system_errors import not_read, not_written

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

    from imumon.model.filter_report import FilterReport

EXCLUDING = {"disturbance": "disturbance", "warmup": "warmup", "motion": "rest", "stuck": "stuck"}
"""Kinds of events that exclude samples, and the kind that ends each."""


@dataclass(frozen=True, slots=True)
class Exclusion:
    """Samples that do not count.

    Attributes
    ----------
    begin_s, end_s : s since the first sample; an end of None is that of the record.
    channel : that shows it; None: no single one.
    reason : in words.
    """

    begin_s: float
    end_s: float | None
    channel: str | None
    reason: str


@dataclass(frozen=True, repr=False)
class Measurement:
    """Result of `imumon.analyse`: channels by name, and everything else of the report.

    Attributes
    ----------
    report : everything that is known, the JSON of `imumon replay`.
    notes : remarks on the call, beside those of the report.

    Examples
    --------
    >>> import imumon
    >>> m = imumon.analyse(imumon.simulate(20_000, 200.0, N=6.1e-5, seed=1), rate_hz=200.0, kind="average")
    >>> list(m), m["gyro/x"].K.status
    (['gyro/x'], 'upper_bound')
    """

    report: Report
    notes: tuple[str, ...] = ()
    _by_horizon: dict[float, FilterReport] = field(default_factory=dict, compare=False)  # they take seconds

    # ------------------------------------------------------------------ channels

    def __getitem__(self, name: str) -> Channel:
        """Return a channel, such as ``gyro/x``; raise `ImumonError` if the record has none of this name."""
        channel = self.report.channels.get(ChannelName(name))
        if channel is None:
            known = ", ".join(self.report.channels) or "none"
            raise ImumonError("no_channel", f"the record has no channel {name!r}", f"there are {known}")
        return channel

    def __iter__(self) -> Iterator[str]:
        return iter(self.report.channels)

    def __len__(self) -> int:
        return len(self.report.channels)

    def __contains__(self, name: object) -> bool:
        return name in self.report.channels

    def keys(self) -> list[str]:
        """Return the names of the channels; with ``[]``, ``dict(m)`` has the channels by name."""
        return list(self.report.channels)

    @property
    def grade(self) -> Mapping[str, SensorGrade]:
        """Headline grades by sensor."""
        return self.report.grade

    @property
    def caveats(self) -> tuple[str, ...]:
        """What limits the meaning of numbers, one word each: those of the record, then those of single channels."""
        of_channels = (caveat for channel in self.report.channels.values() for caveat in channel.caveats)
        return tuple(dict.fromkeys((*self.report.caveats, *of_channels)))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was assumed, left out or is doubtful, one line each."""
        return (*self.report.device.remarks, *self.notes)

    @property
    def ledger(self) -> Mapping[str, int]:
        """What became of everything that was received; the numbers behind ``received`` add up to it."""
        session = self.report.session
        return dict(session.ledger) or with_received({SAMPLES: session.samples})

    @property
    def excluded(self) -> tuple[Exclusion, ...]:
        """What the guards left out, in order."""
        return tuple(_exclusions(self.report.events))

    # ------------------------------------------------------------------ tables

    def to_frame(self) -> pandas.DataFrame:
        """Return a DataFrame with a row for each channel and coefficient.

        `low` and `high` are the limits of statistics, `combined_low` and `combined_high` those with all that is
        known of the uncertainty, which documents print; all in `unit`.
        """
        frame = frame_of(list(self._coefficient_rows()))
        return frame.set_index(["channel", "coefficient"]) if len(frame) else frame

    def _coefficient_rows(self) -> Iterator[dict[str, Any]]:
        for name, channel in self.report.channels.items():
            for letter, estimate in channel.estimates.items():
                low, high = estimate.interval
                yield {
                    "channel": name, "coefficient": letter, "value": estimate.value,
                    "low": estimate.low, "high": estimate.high, "combined_low": low, "combined_high": high,
                    "status": estimate.status,
                    "unit": estimate.unit, "reason": estimate.reason,
                }  # fmt: skip

    def rows(self) -> list[dict[str, Any]]:
        """Return every number of the report as a dict: the rows of ``imumon report --format csv``."""
        from imumon.documents.csv_table import table_rows

        return list(table_rows(self.report))

    def allan(self, channel: str) -> CurveTable:
        """Return the Allan deviation of a channel with its limits, the drawn model, and its noise alone.

        Raises
        ------
        ImumonError : the record has no such channel, or the channel no such curve.
        """
        return curve_table(channel, self[channel])

    # ------------------------------------------------------------------ figures

    def plot(self, sensor: str = "gyro", *, ax: Axes | None = None) -> Axes:
        """Draw the Allan deviation of a sensor with limits, model and coefficients; return the axes.

        Parameters
        ----------
        ax : where to draw; None: a figure of its own.
        """
        from imumon.documents.figures import draw_allan

        return draw_allan(self.report, self._sensor(sensor), ax)

    def plot_spectrum(self, sensor: str = "gyro", *, ax: Axes | None = None) -> Axes:
        """Draw the root of the power spectral density of a sensor with N and the spectral lines; as `plot`."""
        from imumon.documents.spectrum_figure import draw_spectrum

        return draw_spectrum(self.report, self._sensor(sensor), ax)

    def plot_bias(self, sensor: str = "gyro", *, ax: Axes | None = None) -> Axes:
        """Draw the bias of a sensor against the temperature, with 95 % limits; as `plot`."""
        from imumon.documents.temperature_figure import draw_bias

        return draw_bias(self.report, self._sensor(sensor), ax)

    def _sensor(self, sensor: str) -> str:
        sensors = list(dict.fromkeys(name.sensor for name, c in self.report.channels.items() if c.allan))
        if sensor not in sensors:
            without = "none with a curve; a combination has none: plot its records"
            cure = f"there are {', '.join(sensors) or without}"
            raise ImumonError("unknown_sensor", f"the record has no sensor {sensor!r}", cure)
        return sensor

    # ------------------------------------------------------------------ filters and programs

    def filter(self, horizon_s: float = 600.0) -> FilterNumbers:
        """Return what keeps a Kalman filter consistent, by channel: ``white``, ``walk``, ``markov``, ``Q(dt_s)``.

        Parameters
        ----------
        horizon_s : s, longest time without a fix for which the numbers hold.
        """
        return FilterNumbers(self._filters(horizon_s).channels)

    def _filters(self, horizon_s: float) -> FilterReport:
        from imumon.record.filter_report_builder import filter_report

        if not SHORTEST_HORIZON_S <= horizon_s <= LONGEST_HORIZON_S:
            cure = f"give one from {SHORTEST_HORIZON_S:g} s to {LONGEST_HORIZON_S:g} s"
            raise ImumonError("horizon_invalid", f"horizon_s={horizon_s!r} is no horizon", cure)
        if horizon_s not in self._by_horizon:
            self._by_horizon[horizon_s] = filter_report(self.report, horizon_s)
        return self._by_horizon[horizon_s]

    def text(self, form: str, horizon_s: float = 600.0) -> str:
        """Return a document or a file of settings, as ``imumon report --format`` writes it.

        Raises
        ------
        ImumonError : there is no such format, or it is no text, or the report has not what it needs.
        """
        from imumon.documents import FORMS, document

        chosen = FORMS.get(form)
        if chosen is None or chosen.binary:
            cure = f"use one of {', '.join(name for name, some in FORMS.items() if not some.binary)}"
            raise ImumonError("unknown_format", f"no text is named {form!r}", cure)
        empty = FilterReport(time=self.report.time, device=self.report.device)
        filters = self._filters(horizon_s) if chosen.filters else empty
        return document(self.report, form, filters).decode()

    def settings(self, program: str, horizon_s: float = 600.0, *, bounds: bool = False) -> dict[str, float]:
        """Return the numbers of the settings of another program, by their names in its file.

        A number that the record does not show is left out; `text` says why.

        Parameters
        ----------
        bounds : with numbers of which only a bound is known, made for half of it.
        """
        from imumon.documents.program_settings import PROGRAMS, numbers_of, settings_document

        if program not in PROGRAMS:
            cure = f"use one of {', '.join(PROGRAMS)}"
            raise ImumonError("unknown_format", f"no settings are named {program!r}", cure)
        return numbers_of(settings_document(program, self.report, self._filters(horizon_s), bounds=bounds))

    # ------------------------------------------------------------------ text

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the report as JSON, which `imumon.load`, ``--baseline`` and ``imumon report`` read.

        Raises
        ------
        ImumonError : the name has the ending of another form, or the file cannot be written.
        """
        if os.path.splitext(path)[1].lower() not in ("", ".json"):
            cure = "name a file that ends with .json; m.text('html') is the datasheet"
            raise ImumonError("other_form", f"save writes JSON, and {os.fspath(path)} is not named so", cure)
        try:
            replace_file(os.fspath(path), (to_json(self.report, indent=1) + "\n").encode())
        except OSError as error:
            raise not_written(os.fspath(path), error, "name another file") from None

    def __repr__(self) -> str:
        from imumon.documents.summary import summary_text

        return summary_text(self.report, remarks=self.remarks)

    def _repr_html_(self) -> str:
        from imumon.documents.summary import summary_html

        return summary_html(self.report, self.remarks)


class FilterNumbers(dict[ChannelName, Any]):
    """Parameters for filters by channel, see `FilterChannel`."""

    def __repr__(self) -> str:
        lines = [f"{name}: white {c.white:.4e}, walk {c.walk:.4e} ({c.unit})" for name, c in self.items()]
        return "\n".join(lines) or "no channel whose N, B and K are known"


def load(path: str | os.PathLike[str]) -> Measurement:
    """Return a measurement from the JSON of `Measurement.save`, ``imumon replay --json`` or a daemon.

    Raises
    ------
    ImumonError : the file cannot be read, or is no report.
    """
    name = os.fspath(path)
    try:
        with Path(name).open("rb") as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise not_read(name, error) from None
    try:
        return Measurement(from_json(Report, text))
    except ValueError as error:
        cure = "save one with Measurement.save; a recording is for imumon.analyse"
        raise ImumonError("not_a_report", f"{name} is no report: {error}", cure) from None


def report_of(source: Measurement | Report | str | os.PathLike[str]) -> Report:
    """Return the report of a measurement, or of the file of one."""
    if isinstance(source, Report):
        return source
    return source.report if isinstance(source, Measurement) else load(source).report


def _exclusions(events: tuple[Event, ...]) -> Iterator[Exclusion]:
    """Yield what events say of excluded samples; an end without a length is the next event that ends it."""
    for k, event in enumerate(events):
        if event.kind not in EXCLUDING or event.elapsed_s is None:
            continue
        if event.length_s is not None:
            begin_s = 0.0 if event.kind == "warmup" else event.elapsed_s
            yield Exclusion(begin_s, begin_s + event.length_s, event.channel, event.text)
        elif event.kind in ("motion", "stuck") and event.level != "notice":
            ends = (later.elapsed_s for later in events[k + 1 :] if later.kind == EXCLUDING[event.kind])
            yield Exclusion(event.elapsed_s, next(ends, None), event.channel, event.text)
