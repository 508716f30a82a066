"""Report: the published data model as frozen dataclasses, with the rules of its JSON (`report_json`).

Standard library only: any tool can read a report with this file, `coefficients`, `report_json` and
`units`. The fields are the contract (docs/ZENOH.md): they are extended, but never changed. An unknown value is None
with a reason, never 0 or NaN. SI units.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any, Literal, TypeAlias, TypeVar

from imumon.model.coefficients import (
    CONVERGING,
    LIMIT_95,
    NOISE,
    SCALE,
    SINGLE,
    Estimate,
    GradeName,
    MarkovEstimate,
    Status,
    by_letter,
)
from imumon.model.ledger import ColumnUse
from imumon.model.report_json import JsonReader, entries, plain
from imumon.model.report_json import check as _check
from imumon.model.samples import ChannelName

SCHEMA = "imumon.report/1"

State: TypeAlias = Literal["starting", "running", "waiting", "stopped"]
Axis: TypeAlias = Literal["x", "y", "z"]
Against: TypeAlias = Literal["hours before", "time before", "first half", "history", "baseline"]
"""What a change is against: the hours before, the time before a step of the bias, the first half of the record, days of
the history, a baseline."""

MAX_DEGC = 1e3
"""degC, beyond which a number in a message is no temperature."""
MAX_CHANNELS = 64  # channels of a report; a sensor has about 11
MOST_CHARACTERS = 500  # of a text that a user or a file gives: a paragraph of a page
MAX_LOSS = 0.01
"""Share of missing samples in the last minute from which there is an alarm, where the setting says nothing else."""
UNGRADED_SHARE = 0.5
"""Share of the samples excluded or stuck above which nothing is graded: the rest is not representative."""
WARM_S = 1800.0
"""s after a power-up before which no sensor counts as warm, and its bias not as settled."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceDescription:
    """The device and the stream that the numbers describe."""

    id: str  # name of the device, as in the keys
    model: str | None = None  # as the sensor reports it
    serial: str | None = None  # serial number, as the sensor reports it
    firmware: str | None = None  # version, as the sensor reports it
    port: str | None = None  # path or URL; for a recording its file
    baud: int | None = None  # bit/s
    stream: str | None = None  # what the samples are: "deltas", "uncompensated", "compensated" or "unknown"
    sample_rate_hz: float | None = None  # Hz, by the sample clock; before that is known, from the settings
    alias_factor: float | None = None  # factor by which the sensor's filter inflates N; null: unknown
    source: str | None = None  # message that the samples are taken from
    clock: str | None = None  # where the time of the samples comes from: "startup", "counter", "dt" or "none"
    settings: Mapping[str, str] = field(default_factory=dict)  # registers that change the data, as text
    remarks: tuple[str, ...] = ()  # what is unknown or not as it should be, one line each
    driver: str | None = None  # URL scheme of the device driver, such as vn100; null: unknown
    setting_texts: Mapping[str, str] = field(default_factory=dict)  # effect of those settings that are known
    topic: str | None = None  # topic in ROS that supplies the samples; null: none, or unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingDescription:
    """What the numbers are taken from, where that has columns: a file, or lines."""

    columns: tuple[ColumnUse, ...] = ()  # each with its use, or why it is not used; at most 256

    @property
    def times(self) -> tuple[str, ...]:
        """Names of the columns that are the time."""
        return tuple(column.name for column in self.columns if column.use == "time")


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionCounters:
    """What was received, lost and excluded since the first sample; the counts add up."""

    started: str | None = None  # ISO 8601 in UTC; null: no sample yet, or a recording without a date
    elapsed_s: float = 0.0  # s of the sample clock, samples and missing ones together
    samples: int = 0  # received, excluded ones included
    missing: int = 0  # samples that the sample clock proves and that did not arrive valid
    gaps: int = 0  # gaps, those of unknown length included
    discarded_bytes: int = 0  # bytes that belong to no valid message
    bad_checksums: int = 0  # messages that failed their checksum; for tables: invalid rows
    disturbances: int = 0  # excluded disturbances, a running one included
    excluded_s: float = 0.0  # s of received samples that the guards excluded
    warmup_s: float = 0.0  # s of received samples excluded as a detected warm-up
    restarts: int = 0  # restarts of the daemon, the sample clock or the record
    duplicates: int = 0  # samples that arrived twice and count once
    received_bytes: int = 0  # bytes read
    overruns: int = 0  # times that the kernel or the queue dropped bytes
    kernel_overruns: int | None = None  # of these, in the kernel, in this run; null: not counted
    most_queued_bytes: int | None = None  # most bytes that waited for the daemon at once, in this run
    # s by reason; `magnetic` is not part of excluded_s of a stream with gyro or accel
    excluded_by: Mapping[str, float] = field(default_factory=dict)
    recent_loss: float | None = None  # missing samples, share of the last 60 s or of a shorter record
    # by code (docs/REPORTS.md): "received", and what became of it, "samples" included: the sum of the others is it
    ledger: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelGrade:
    """Grade of a channel."""

    meets: GradeName | None = None  # best grade whose limits N and B, or their bounds, do not exceed


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidedBy:
    """The coefficient that decides a headline."""

    axis: Axis  # axis of the sensor
    coefficient: Literal["N", "B"]  # coefficient of that axis


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorGrade:
    """Grade of a sensor: the best one whose limits no N and no B of its axes exceeds."""

    meets: GradeName | None = None  # the grade; a coefficient that is only bounded counts with its bound
    best: GradeName | None = None  # the grade if each coefficient is at its lower 95 % limit
    worst: GradeName | None = None  # the grade at the upper 95 % limits; a pending coefficient may have any
    decided_by: DecidedBy | None = None  # coefficient that decides the grade
    provisional: bool = True  # whether it may still change: best and worst differ
    reason: str | None = None  # why there is no grade, or why it is provisional

    def compared_with(self, required: GradeName) -> Literal["reached", "open", "missed"]:
        """Return whether the grade is certainly at least the required one, perhaps, or certainly worse.

        >>> one = SensorGrade(meets="consumer", best="industrial", worst="consumer")
        >>> [one.compared_with(required) for required in ("tactical", "industrial", "consumer")]
        ['missed', 'open', 'reached']
        """
        if self.best is None or self.worst is None:
            return "open"
        if SCALE.index(self.best) > SCALE.index(required):
            return "missed"
        return "reached" if SCALE.index(self.worst) <= SCALE.index(required) else "open"


@dataclass(frozen=True, slots=True, kw_only=True)
class FitQuality:
    """Test of the description against the powers of its bands; None while there is nothing to test."""

    chi2: float | None = None  # 1, deviance of the bands, beside an error of the model of 1 %
    dof: int | None = None  # its degrees of freedom
    p_value: float | None = None  # probability of a larger one if this description holds; after selection


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Allan:
    """The curve, one entry per octave: measured points, their limits, and the fitted model."""

    tau_s: tuple[float, ...] = ()  # s, averaging times
    sigma: tuple[float, ...] = ()  # channel unit, Allan deviation
    low: tuple[float | None, ...] = ()  # channel unit, lower 95 % limit of the deviation
    high: tuple[float | None, ...] = ()  # channel unit, upper 95 % limit
    edf: tuple[float | None, ...] = ()  # 1, equivalent degrees of freedom
    model: tuple[float | None, ...] = ()  # channel unit, of all that the report states; null without a fit
    noise: tuple[float | None, ...] = ()  # channel unit, of N, B, K and M alone; null without a fit
    used: tuple[bool, ...] = ()  # octaves in the range of frequencies that the fit uses

    def __repr__(self) -> str:
        span = f", {self.tau_s[0]:g} to {self.tau_s[-1]:g} s" if self.tau_s else ""
        return f"Allan({len(self.tau_s)} averaging times{span})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """Counts in equal bins from `start`, with the Gaussian of the same mean and deviation."""

    start: float  # channel unit, lower edge of the first bin
    width: float  # channel unit, of each bin
    counts: tuple[int, ...]  # samples in each bin
    gaussian: tuple[float, ...]  # expected counts of the Gaussian


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """Shape of the values: verdict as text, and the last minute."""

    verdict: str | None = None  # "Gaussian", "not Gaussian: heavy tails", "constant", "too few samples"
    gaussian: bool | None = None  # whether it is Gaussian; null: too few samples, or constant
    recent_mean: float | None = None  # channel unit, of the last minute, excluded samples included
    recent_std: float | None = None  # channel unit, of the last minute, excluded samples included
    bias: float | None = None  # channel unit, mean minus the reading of a sensor at rest
    bias_low: float | None = None  # channel unit, lower 95 % limit of the bias
    bias_high: float | None = None  # channel unit, upper 95 % limit of the bias
    bias_reason: str | None = None  # why there is no bias
    turn_on_count: int | None = None  # power-ups of which the settled bias is known; null: no history
    turn_on_std: float | None = None  # channel unit, their standard deviation; null: fewer than five
    turn_on_low: float | None = None  # channel unit, lower 95 % limit of that deviation
    turn_on_high: float | None = None  # channel unit, upper 95 % limit
    correlation: Mapping[str, float] = field(default_factory=dict)  # -1 to 1, by the sensor's other channels
    effective_samples: float | None = None  # independent samples that give the mean the same variance


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A spectral line: amplitude is that of the sinusoid, in the channel's unit."""

    frequency_hz: float  # Hz, as it appears
    amplitude: float  # channel unit, of the sinusoid
    aliases_hz: tuple[float, ...] = ()  # Hz, mains and harmonics that fold to it
    name: str | None = None  # "50 Hz mains", if one fits; magnetometers only


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """One-sided power spectral density, unit^2/Hz, with the number of averages of each bin."""

    frequency_hz: tuple[float, ...]  # Hz, rising
    density: tuple[float, ...]  # (channel unit)^2/Hz
    averages: tuple[int, ...]  # periodograms averaged in each
    lines: tuple[Line, ...] = ()  # spectral lines, strongest first
    white: float | None = None  # N from the white level, in the unit of the channel's N


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Slope of the mean against time and temperature, estimated beside N, B and K."""

    per_hour: float | None = None  # channel unit per hour
    per_hour_low: float | None = None  # channel unit per hour, lower 95 % limit
    per_hour_high: float | None = None  # channel unit per hour, upper 95 % limit
    significant: bool | None = None  # whether per_hour is beyond 3.9 standard errors; null: collinear
    begin_s: float | None = None  # s since the first sample, end of the warm-up: only later samples count
    # channel unit per degC at the mean temperature, estimated together with per_hour; null: see reason
    per_degC: float | None = None
    per_degC_low: float | None = None  # channel unit per degC, lower 95 % limit
    per_degC_high: float | None = None  # channel unit per degC, upper 95 % limit
    # why per_degC is null: "no_temperature", "small_range", "collinear", "implausible", "jumps"
    reason: str | None = None
    temperature_min: float | None = None  # degC, least temperature that the means cover
    temperature_max: float | None = None  # degC, greatest temperature that the means cover
    explained: float | None = None  # share of the slow variance that temperature explains, 0 to 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelColumn:
    """A regressor of the fit: what moves the mean and is not noise."""

    # "drift", "temperature", "temperature_2" (its square), "temperature_3", "settling" or "step"
    name: str
    value: float  # in `unit`
    low: float  # in `unit`, lower 95 % limit
    high: float  # in `unit`, upper 95 % limit
    unit: str = ""  # such as rad/s/s, rad/s/degC or rad/s
    time_constant_s: float | None = None  # s, of a settling

    @property
    def error(self) -> float:
        """Standard error, in `unit`."""
        return (self.high - self.low) / (2.0 * LIMIT_95)

    def limits(self, factor: float = 1.0) -> tuple[float, float, float]:
        """Return value and limits times a factor."""
        return self.value * factor, self.low * factor, self.high * factor

    @property
    def sigma(self) -> float:
        """Standard errors by which it differs from zero."""
        return abs(self.value) / self.error if self.error > 0.0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasCurve:
    """Bias against the temperature: a straight line, of the whole record with its warm-up."""

    # why there are no terms: "no_temperature", "small_range", "collinear", "too_short", "implausible", "jumps"
    reason: str | None = None
    reference_degC: float | None = None  # degC, middle of the temperatures that the record covers
    terms: tuple[ModelColumn, ...] = ()  # "degree 0" (the bias at the reference), "degree 1" (the slope)
    degC: tuple[float, ...] = ()  # degC, temperatures of the line; it does not hold beyond
    bias: tuple[float, ...] = ()  # channel unit, the line
    low: tuple[float, ...] = ()  # channel unit, lower 95 % limits
    high: tuple[float, ...] = ()  # channel unit, upper 95 % limits
    # channel unit, standard deviation of the means over blocks about their drift
    std_without: float | None = None
    std_with: float | None = None  # channel unit, the same about drift and line

    @property
    def is_known(self) -> bool:
        """Whether there is a curve: of degree 1 to 3, over a span of temperatures."""
        if not 2 <= len(self.terms) <= 4 or self.reference_degC is None or len(self.degC) < 2:
            return False
        return -MAX_DEGC < self.degC[0] <= self.reference_degC <= self.degC[-1] < MAX_DEGC


@dataclass(frozen=True, slots=True, kw_only=True)
class Jumps:
    """Two levels between which the mean of a channel jumps (popcorn noise)."""

    low: float  # channel unit, lower level
    high: float  # channel unit, upper level
    low_s: float  # s, mean time in the lower level
    high_s: float  # s, mean time in the upper level


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """What describes the slow and the fast part of a channel besides its coefficients, and what each adds to the curve.

    `shares` has the parts that the model has: its coefficients by letter, ``filter`` (what a filter in the sensor
    takes: negative), ``lines``, and ``columns`` (what moves the mean), each at the taus of `allan`.
    """

    columns: tuple[ModelColumn, ...] = ()  # regressors in use
    lines_hz: tuple[float, ...] = ()  # Hz, lines that are no part of the noise
    vibration_hz: tuple[float, ...] = ()  # Hz, both ends of a hum, which is no noise; empty: there is none
    vibration_mains_hz: tuple[float, ...] = ()  # Hz, mains and harmonics that fold to it
    oscillations_s: tuple[float, ...] = ()  # s, periods of slow oscillations that are no part of the noise
    jumps: Jumps | None = None  # levels of popcorn noise; null: the channel does not show two
    highest_hz: float | None = None  # Hz, highest frequency in use
    # (channel unit)^2 by part (N, B, K, M, Q, filter, lines, columns): Allan variances that add up to the model's
    shares: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedSeries:
    """What was stated of one coefficient, one entry for each length of the record in `Convergence`."""

    value: tuple[float | None, ...] = ()  # SI; null unless measured
    low: tuple[float | None, ...] = ()  # SI, lower 95 % limit of statistics; 0 of a bound, null while pending
    high: tuple[float | None, ...] = ()  # SI, upper 95 % limit of statistics, or bound; null while pending
    status: tuple[Status | None, ...] = ()  # as of an estimate; null: the channel did not have it


@dataclass(frozen=True, slots=True, kw_only=True)
class Convergence:
    """What was stated when the record was shorter, at most 62 times; the last entry is what is stated now."""

    elapsed_s: tuple[float, ...] = ()  # s, lengths of the record, rising
    # at these lengths; null: the channel never had it
    coefficients: Mapping[str, StatedSeries] = field(default_factory=dict, metadata=entries(CONVERGING))


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """Change of N, B or bias against the hours before, the first half, the time before a step, or a baseline."""

    # "hours before", "first half", "time before" (a step of the bias), "history" (days) or "baseline"
    against: Against
    quantity: str  # "N", "B", "bias" or "slope" (against the temperature, per degC)
    before: float  # in the channel's unit of the quantity
    now: float  # in the channel's unit of the quantity
    ratio: float | None  # now over before; null for the bias and the slope
    sigma: float  # standard errors by which they differ
    since: str | None = None  # ISO 8601 in UTC, first day after the change; null: not against the history
    p_value: float | None = None  # probability of it by chance, over all comparisons; null: a step


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """Minimum and maximum in equal columns of time, oldest first; None without a sample."""

    start_s: float  # s since the first sample
    column_s: float  # s, length of a column
    low: tuple[float | None, ...]  # channel unit, minimum
    high: tuple[float | None, ...]  # channel unit, maximum


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """Signal view of one channel, published on its own key."""

    channel: ChannelName  # such as gyro/x
    unit: str  # channel unit
    minute: Strip | None = None  # the last 60 s
    hour: Strip | None = None  # the last hour
    everything: Strip | None = None  # all since the first sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Robust:
    """Deviation at the sampling interval that outliers hardly raise, from the median of the differences."""

    sigma: float  # channel unit, comparable with the Allan deviation at the shortest tau
    ratio: float  # Allan deviation of the same differences over sigma: 1 for Gaussian noise


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Channel:
    """One channel; temperature and pressure have no curve. Its own key omits the curves.

    These are allan, histogram, spectrum and convergence.
    """

    unit: str  # channel unit: rad/s, m/s^2, gauss, degC or kPa
    count: int = 0  # samples that count: not excluded, after the warm-up
    mean: float | None = None  # channel unit, of these samples, like std to last
    std: float | None = None  # channel unit, with n - 1
    min: float | None = None  # channel unit, minimum
    max: float | None = None  # channel unit, maximum
    skewness: float | None = None  # 1; null without spread
    excess_kurtosis: float | None = None  # 1; null without spread
    last: float | None = None  # channel unit, the newest of them
    # null: no curve, or it does not show
    coefficients: Mapping[str, Estimate] = field(default_factory=dict, metadata=entries(SINGLE))
    M: MarkovEstimate | None = None  # correlated noise (Gauss–Markov); null: the record does not ask for it
    model: NoiseModel | None = None  # what else describes the channel; null: no fit
    grade: ChannelGrade | None = None  # of N and B; null: neither gyro nor accel
    # in the unit of each: classical slope readings of the curve, for comparison; null: the curve has none
    readings: Mapping[str, float | None] | None = field(default=None, metadata={"keys": NOISE})
    # s of the sample clock until each has the configured precision; null: not measured for long, or over a year
    time_to: Mapping[str, float | None] | None = field(default=None, metadata={"keys": NOISE})
    convergence: Convergence | None = None  # what was stated of a shorter record; null: no curve
    fit: FitQuality | None = None  # how well the model describes the spectrum
    caveats: tuple[str, ...] = ()  # one word each, those of the record included; none without a curve
    allan: Allan | None = None  # Allan deviation; null: no curve
    distribution: Distribution | None = None  # shape of the values, and the bias
    histogram: Histogram | None = None  # at most 64 bins, warm-up included
    spectrum: Spectrum | None = None  # at most 24 points a decade, warm-up included; null: no curve
    resolution: float | None = None  # channel unit, step of the values; null: none seen
    robust: Robust | None = None  # white noise without outliers; null: no curve, too coarse, or too short
    drift: Drift | None = None  # slope of the mean; null: no fit
    bias_curve: BiasCurve | None = None  # bias against the temperature; null: no fit
    changes: tuple[Change, ...] = ()  # changes beyond chance

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Every coefficient by letter, in the order of the table; of correlated noise M and, where measured, T."""
        return by_letter(self.coefficients, self.M)

    @property
    def time_constant_s(self) -> float | None:
        """Measured time constant of the correlated noise, s; None: it is not known."""
        return self.M.time_constant_s.value if self.M is not None else None

    @property
    def N(self) -> Estimate | None:
        """White noise; None: the channel has no curve."""
        return self.coefficients.get("N")

    @property
    def B(self) -> Estimate | None:
        """Flicker; None: the channel has no curve."""
        return self.coefficients.get("B")

    @property
    def K(self) -> Estimate | None:
        """Random walk; None: the channel has no curve."""
        return self.coefficients.get("K")

    @property
    def Q(self) -> Estimate | None:
        """Quantisation; None: it does not show."""
        return self.coefficients.get("Q")

    @property
    def R(self) -> Estimate | None:
        """Rate ramp; None: it does not show."""
        return self.coefficients.get("R")

    def __repr__(self) -> str:
        parts = [f"{letter} {estimate}" for letter, estimate in self.estimates.items()]
        caveats = [f"caveats {', '.join(self.caveats)}"] if self.caveats else []
        return f"Channel({self.unit}, {self.count:,} samples; {'; '.join([*parts, *caveats])})"


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCurve:
    """Allan deviation at the limits of a grade for N and B; straight between the points on log-log axes."""

    tau_s: tuple[float, ...]  # s, averaging times
    sigma: tuple[float, ...]  # channel unit, Allan deviation


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened: `kind` is one word, `text` one line of text."""

    time: str  # ISO 8601 in UTC, when it was reported
    kind: str  # such as connect, gap, disturbance, grade
    text: str  # what happened, in one line
    device: str  # id of the device
    elapsed_s: float | None = None  # s of the record, of a disturbance its begin; null: no record
    channel: str | None = None  # such as gyro/x; null: no single one
    length_s: float | None = None  # s, of what was excluded or is missing
    size: float | None = None  # channel unit, greatest distance of a disturbance from the level
    level: Literal["debug", "info", "notice", "warning", "error"] = "info"  # how much it matters to a user


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetValue:
    """One value of a data sheet for one channel, beside what was measured."""

    channel: ChannelName  # such as gyro/x
    quantity: str  # a coefficient, or floor: 0.664 B, or density: sqrt(2) N
    coefficient: str  # that it is a value of, such as N
    printed: float  # in `printed_unit`, of `quantity`, as the data sheet has it
    printed_unit: str  # of the data sheet
    basis: str  # "maximum", or "typical": about half of the devices exceed a typical value
    value: float  # in `unit`, of `coefficient`
    unit: str  # of the coefficient, such as rad/s/sqrt(Hz)
    above: bool | None  # whether the whole combined interval is above; null: unknown
    reason: str | None = None  # why a measured one is not said to be above


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSheet:
    """Published values of the sensor."""

    title: str  # device
    document: str  # data sheet
    edition: str | None = None  # of the data sheet
    source: str | None = None  # where the values were read
    note: str | None = None  # what must be known to compare
    values: tuple[SheetValue, ...] = ()  # one per channel and value


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Report:
    """Everything known about one device at one moment."""

    schema: str = SCHEMA  # imumon.report/1
    time: str  # ISO 8601 in UTC, when it was made
    device: DeviceDescription  # device that the numbers describe
    state: State  # "starting": no sample yet; "waiting": disconnected or silent; "stopped": last report
    session: SessionCounters  # what was received, lost and excluded
    recording: RecordingDescription | None = None  # columns of a file or of lines; null: it has none
    grade: Mapping[str, SensorGrade] = field(default_factory=dict)  # headlines: gyro, accel
    channels: Mapping[ChannelName, Channel] = field(default_factory=dict)  # gyro/x ... mag/z, then others
    caveats: tuple[str, ...] = ()  # those that hold for the whole record
    period_s: float = 1.0  # s between two reports
    speed: float = 1.0  # device seconds per second of the host clock; not 1 in time-lapse
    # SI, by gyro and accel, N and B, and grade: largest value that each grade allows
    limits: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    limit_curves: Mapping[str, Mapping[str, LimitCurve]] = field(default_factory=dict)  # by sensor and grade
    precision: Mapping[str, float] = field(default_factory=dict)  # 1, configured half-width of N, B and K
    alarm_limits: Mapping[str, float] = field(default_factory=dict)  # 1, configured, by alarm: loss
    events: tuple[Event, ...] = ()  # of the record, at most 256; only in a report of `replay` or `report`
    data_sheet: DataSheet | None = None  # of the sensor, in a document; null: none of this device is known

    def __repr__(self) -> str:
        lines = [f"  {name}: {channel!r}" for name, channel in self.channels.items()]
        head = f"Report({self.device.id}, {self.state}, {self.session.elapsed_s:g} s"
        return "\n".join([f"{head}, {len(lines)} channels)", *lines[:20]])

    @property
    def time_lapse(self) -> float | None:
        """Factor by which the emulator runs faster than real time; None: it is real time."""
        return None if self.speed == 1.0 else self.speed

    @property
    def max_loss(self) -> float:
        """Share of missing samples in the last minute from which there is an alarm, as its daemon has it configured."""
        return self.alarm_limits.get("loss", MAX_LOSS)

    @property
    def is_lossy(self) -> bool:
        """Whether more samples of the last minute are missing than `max_loss` allows."""
        return self.session.recent_loss is not None and self.session.recent_loss > self.max_loss

    def host_s(self, elapsed_s: float) -> float:
        """Return the s of the host clock in which the record grew by `elapsed_s`, s of the sample clock."""
        return elapsed_s / self.speed

    @property
    def late_s(self) -> float:
        """Age from which a report is late, s: three periods of at least one second."""
        return 3.0 * max(self.period_s, 1.0)


def stamp(moment: datetime) -> str:
    """Return the time in ISO 8601, UTC, with Z.

    >>> stamp(datetime(2026, 1, 2, 3, 4, 5, 678000, tzinfo=UTC))
    '2026-01-02T03:04:05.678Z'
    """
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


T = TypeVar("T")
_DEVICE_NAME = re.compile("[a-z0-9_-]{1,64}")
_CHANNEL_NAME = re.compile("[A-Za-z0-9_-]{1,32}(/[A-Za-z0-9_-]{1,32})?")


def is_device_name(text: str) -> bool:
    """Return whether a text can be the name of a device in a key, such as ``vn100-0100056785``."""
    return _DEVICE_NAME.fullmatch(text) is not None


def is_channel_name(text: str) -> bool:
    """Return whether a text can be the name of a channel, such as ``gyro/x``."""
    return _CHANNEL_NAME.fullmatch(text) is not None


def _check_channels(names: Collection[str]) -> None:
    """Raise TypeError if there are too many channels, or names that are no names of channels."""
    _check(len(names) <= MAX_CHANNELS, f"{len(names)} channels, more than {MAX_CHANNELS}")
    _check(all(map(is_channel_name, names)), "a name that is no name of a channel")


def _check_estimate(part: Estimate) -> None:
    sizes = (part.value, part.low, part.high, part.combined_low, part.combined_high)
    _check(all(size is None or size >= 0.0 for size in sizes), "a negative size")


def _check_curve(curve: Allan | LimitCurve) -> None:
    _check(all(tau > 0.0 for tau in curve.tau_s), "an averaging time that is not positive")
    if isinstance(curve, LimitCurve):
        _check(bool(curve.tau_s) and all(sigma > 0.0 for sigma in curve.sigma), "a limit not above 0")


def _check_convergence(part: Convergence) -> None:
    lengths = part.elapsed_s
    _check(all(b >= a > 0.0 for a, b in pairwise(lengths)), "lengths that fall")
    for series in part.coefficients.values():
        columns = (series.value, series.low, series.high, series.status)
        _check(all(len(column) == len(lengths) for column in columns), "a statement without its length")
        known = (size for column in columns[:3] for size in column)
        _check(all(size is None or size >= 0.0 for size in known), "a negative size")


def _check_session(session: SessionCounters) -> None:
    words = ("started", "excluded_by", "ledger")
    counts = [getattr(session, f.name) for f in fields(session) if f.name not in words]
    counts += session.ledger.values()
    _check(all(count is None or count >= 0 for count in counts), "a negative count")


def _check_report(report: Report) -> None:
    _check(report.period_s > 0.0 and report.speed > 0.0, "a period or speed that is not positive")
    for names in (report.channels, report.grade, report.limits, report.limit_curves):
        _check_channels(names)


_CHECKS: Mapping[Any, Callable[[Any], None]] = {
    Report: _check_report,
    SheetValue: lambda part: _check(part.value > 0.0 < part.printed, "a value of a data sheet not above 0"),
    SessionCounters: _check_session,
    Estimate: _check_estimate,
    Allan: _check_curve,
    LimitCurve: _check_curve,
    Convergence: _check_convergence,
    Histogram: lambda histogram: _check(histogram.width > 0.0, "a bin without width"),
    Strip: lambda strip: _check(strip.column_s > 0.0, "a column without length"),
    Signal: lambda signal: _check_channels([signal.channel]),
    Event: lambda event: _check_channels([event.channel] if event.channel is not None else []),
}  # beside the checks of the types
_READER = JsonReader(_CHECKS, lists=(NoiseModel,))


def from_json(cls: type[T], text: str | bytes) -> T:
    """Read JSON as `cls`, such as `Report`; raise ValueError if it is something else."""
    try:
        return _READER.read(cls, text)
    except (TypeError, AttributeError, KeyError, RecursionError) as error:
        raise ValueError(f"not a {cls.__name__.lower()} of {SCHEMA}: {plain(str(error))}") from None
