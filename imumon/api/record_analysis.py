"""Analysis of a record: `analyse`, the one way from samples to numbers.

A path, arrays, a DataFrame and the commands `imumon replay` and `imumon report` go this way:

1. A source becomes a recording: `sensor_arrays` names arrays, `recordings` reads files.
2. `replay` places the samples on the grid of their clock, leaves disturbances and warm-up out, and fits.
3. `document_report` adds the values of the data sheet.

Equal samples give equal reports, whichever way they come.

>>> import imumon
>>> gyro = imumon.simulate(60_000, 200.0, N=6.1e-5, seed=1)
>>> m = imumon.analyse(gyro, rate_hz=200.0, kind="average")
>>> f"{m['gyro/x'].N.value:.2e} {m['gyro/x'].N.status}"
'6.07e-05 measured'
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from imumon.api.document_report import document_report
from imumon.api.measurement import Measurement, report_of
from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions, SensorFilter
from imumon.api.sensor_arrays import checked_rate, columns_of_arrays, has_time, named_source, units_of_arrays
from imumon.documents.references import read_sheet
from imumon.model.coefficients import NOISE, default_precision
from imumon.model.cures import python_caller
from imumon.model.errors import ImumonError
from imumon.model.report import Report
from imumon.model.samples import INERTIAL
from imumon.record import RecordOptions
from imumon.sources.files.base import OptionError, ReadOptions, Samples
from imumon.sources.files.columns import KINDS, check_meaning, parse_map

if TYPE_CHECKING:
    import os

    from imumon.bus import Publisher

POINT_REMARK = (
    "point samples are assumed: if a sample is the mean over its interval, kind='average'; if it is the angle or the "
    "velocity of its interval, kind='increment'"
)
"""Remark on arrays of which nothing says what a sample is."""


def analyse(
    source: Any = None,
    *,
    gyro: Any = None,
    accel: Any = None,
    mag: Any = None,
    temperature: Any = None,
    time_s: Any = None,
    rate_hz: float | None = None,
    kind: Samples | None = None,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | str | None = None,
    topic: str | None = None,
    sensor: str | None = None,
    stream: str | None = None,
    where: Mapping[str, str] | None = None,
    msg: str | os.PathLike[str] | None = None,
    accept: bool = False,
    guards: bool = True,
    filter: str | None = None,
    precision: Mapping[str, float] | None = None,
    baseline: Measurement | Report | str | os.PathLike[str] | None = None,
    datasheet: str | os.PathLike[str] | None = None,
    convergence: bool = False,
) -> Measurement:
    """Return the noise of a sensor from a record of it at rest.

    Parameters
    ----------
    source : path of a recording of any format that `imumon replay` reads; (n, 3) or (n,) array of a gyroscope;
        DataFrame, or mapping of arrays, whose names say what they are (``gyro_x [deg/s]``, ``t_ms``).
    gyro, accel, mag : (n, 3) or (n,), rad/s, m/s^2 and gauss unless `units` has another. Masked values, NaN and
        None are missing samples.
    temperature : (n,) degC.
    time_s : (n,) s, or dates, of each sample; without it the samples follow one another at `rate_hz`.
    rate_hz : Hz, sample rate.
    kind : what a sample is: ``point`` (the output at an instant), ``average`` (mean of the rate over its interval) or
        ``increment`` (angle or velocity of its interval). None: by the names of columns, else point samples.
    units : by sensor, ``{"gyro": "deg/s", "accel": "g", "time": "ms"}``.
    columns : by channel, ``{"gyro/x": "wx:deg/s", "t": "stamp:ns"}``, of a table whose names do not say it.
    topic, sensor, stream : which topic of a log, which sensor of a table, and which of several streams.
    where : by column of a table, the value of the rows that are read, ``{"sensor": "4"}``.
    msg : path of a ``.msg`` file, or of a directory of them, with types of messages that a bag does not define.
    accept : take what is proposed for columns whose names and units do not say what they are.
    guards : exclude disturbances, motion and warm-up.
    filter : of the sensor, where the record does not say: ``none``, ``factory``, ``8`` samples, ``8@1000`` Hz.
    precision : requested half-width of the 95 % limits by letter, as a share of the value.
    baseline : an earlier measurement of the sensor to compare with, or the path of its report.
    datasheet : file with limits of a data sheet, or the name of one that imumon has.
    convergence : also state what a shorter record would have shown, at each doubling of its length.

    Raises
    ------
    ColumnsUnclear : what columns are is not certain; `proposal` is the text for `columns`, `accept` takes it.
    ImumonError : with code, message and cure, if the record cannot be read or cannot be that of a sensor.
    """
    with python_caller(), one_thread():
        sensors = {"gyro": gyro, "accel": accel, "mag": mag, "temperature": temperature}
        path, arrays = named_source(source, sensors, time_s)
        given_units = units_of_arrays(source, kind) | dict(units or {})
        check_meaning(given_units, kind)
        of_arrays = columns_of_arrays(arrays or {}, given_units) if units_of_arrays(source, kind) else {}
        options = ReplayOptions(
            path=path,
            arrays=arrays,
            read=ReadOptions(
                rate_hz=checked_rate(
                    rate_hz, alone=arrays is not None and not has_time(arrays) and not columns
                ),
                kind=_stream(stream),
                columns=of_arrays | (parse_map(columns) if isinstance(columns, str) else dict(columns or {})),
                topic=topic,
                sensor=sensor,
                where=where,
                definitions=None if msg is None else os.fspath(msg),
                units=given_units,
                samples=kind,
                accept=accept,
            ),
            record=RecordOptions(
                guarded=guards,
                precision=checked_precision(precision),
                baseline=None if baseline is None else report_of(baseline),
                convergence=convergence,
            ),
            filter=None if filter is None else SensorFilter.parse(filter),
        )
        sheet = None
        if datasheet is not None:
            sheet = read_sheet(str(datasheet))
        measurement = measured(options, sheet)
        notes = (*measurement.notes, *array_remarks(options, measurement.report))
        return replace(measurement, notes=notes)


def measured(
    options: ReplayOptions,
    sheet: Any = None,
    *,
    progress: Callable[[float | None, float], None] | None = None,
    bus: Publisher | None = None,
) -> Measurement:
    """Return the measurement of a record, as the commands do; see `analyse`.

    Parameters
    ----------
    sheet : reference sheet to check against; None: that of the model, if it is known.
    progress, bus : as of `replay`.
    """
    remarks: list[str] = []
    report = replay(options, progress=progress, bus=bus, remark=remarks.append)
    require_noise(options, report)
    # those of the device are in the report; what is left says why the recording ended early
    return Measurement(document_report(report, sheet), tuple(remarks[len(report.device.remarks) :]))


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which linear algebra takes one thread; the settings of the caller hold again after it.

    The matrices of a fit are small: more threads wait for one another and take the processor from others.
    """
    from threadpoolctl import threadpool_limits

    limits: Any = threadpool_limits
    context: AbstractContextManager[Any] = limits(1, user_api="blas")
    return context


def checked_precision(precision: Mapping[str, float] | None) -> dict[str, float]:
    """Return the requested half-widths by letter; raise `OptionError` if one of them has no meaning."""
    chosen = dict(precision or {})
    unknown = [letter for letter in chosen if letter not in NOISE]
    if unknown or any(not 0.0 < share < 1.0 for share in chosen.values()):
        cure = f"give shares by letter, such as {{'B': 0.2}}; the letters are {', '.join(NOISE)}"
        raise OptionError("precision_invalid", f"precision={chosen!r} has no meaning", cure)
    return default_precision() | chosen


def _stream(name: str | None) -> Any:
    if name is not None and name not in KINDS:
        raise OptionError("stream_invalid", f"stream={name!r} is no stream", f"use one of {', '.join(KINDS)}")
    return name


def array_remarks(options: ReplayOptions, report: Report) -> tuple[str, ...]:
    """Return remarks on what a call leaves open."""
    open_kind = (
        options.arrays is not None and options.read.samples is None and report.device.stream == "unknown"
    )
    return (POINT_REMARK,) if open_kind else ()


def require_noise(options: ReplayOptions, report: Report) -> None:
    """Raise an error if no axis of a record has noise: it is not one of a sensor that is on."""
    axes = {name: c for name, c in report.channels.items() if name.sensor in INERTIAL}
    if axes and all("constant" in c.caveats or (c.count > 1 and c.min == c.max) for c in axes.values()):
        text = f"every value of {', '.join(axes)} is the same: there is no noise"
        text = f"{options.name}: {text}" if options.arrays is None else text
        raise ImumonError("all_constant", text, "pass samples of a sensor that is on, with all their digits")
