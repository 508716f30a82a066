"""Evaluation of a record, as a part of the report: traceability, uncertainty, conformity, exact curve.

It is made once, for a document (`imumon replay`, `imumon report`); a report on the bus has only the program and the
host of the daemon (`provenance`).
Standard library only, as `report`. Rules are those of the report: SI units, an unknown value is None with a
reason, never 0, never NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

Verdict: TypeAlias = Literal["pass", "fail", "undecided"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """What was measured, by whom, where and how, as the user states it; null: not stated."""

    model: str | None = None  # of the sensor; it takes precedence over that of the device
    serial: str | None = None  # serial number; it takes precedence over that of the device
    operator: str | None = None  # who measured
    place: str | None = None  # where the record was made
    ambient: str | None = None  # temperature and humidity, with their units
    procedure: str | None = None  # document that the measurement follows
    note: str | None = None  # anything else


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Where the numbers come from: program, input, options, host."""

    software: str  # name and version
    commit: str | None = None  # revision of the source, as recorded when it was built; null: unknown
    libraries: Mapping[str, str] = field(default_factory=dict)  # version by name, of those that compute
    host: str | None = None  # name of the computer
    made: str | None = None  # ISO 8601 in UTC, when the numbers were computed
    input: str | None = None  # name of the file that was read; null: a running daemon, see `input_reason`
    input_bytes: int | None = None  # size of that file, compressed as it is
    input_sha256: str | None = None  # hexadecimal, of the bytes of that file
    input_reason: str | None = None  # why a digest is null
    options: Mapping[str, str] = field(default_factory=dict)  # those that were given, by name
    guards: bool | None = None  # whether disturbances and warm-up were excluded; null: unknown
    written_by: str | None = None  # name, version and revision of what wrote the document; null: the same


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyComponent:
    """One line of an uncertainty budget."""

    source: str  # statistics, scatter, repeatability, resolution, aliasing or time base
    kind: Literal["A", "B"]  # by statistics of observations, or by other means (JCGM 100)
    standard: float | None  # in the unit of the coefficient, standard uncertainty; null: not combined
    bound: float | None = None  # in the unit of the coefficient, 95 % bound of what does not show
    dof: float | None = None  # 1, degrees of freedom; null: infinite
    basis: str  # how it was obtained, or why it is unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyBudget:
    """Uncertainty of N, B, K or the bias of one channel, after JCGM 100 (GUM)."""

    unit: str  # such as rad/s/sqrt(Hz)
    value: float  # in `unit`
    components: tuple[UncertaintyComponent, ...] = ()  # what adds to it
    combined: float  # in `unit`, combined standard uncertainty of the components that are known
    dof: float | None = None  # 1, effective degrees of freedom (Welch-Satterthwaite); null: infinite
    coverage: float  # 1, factor for 95 %
    expanded: float  # in `unit`, expanded uncertainty: half the width of the limits
    low: float | None = None  # in `unit`, combined lower 95 % limit; null: made before there was one
    high: float | None = None  # in `unit`, combined upper 95 % limit; null: made before there was one

    def is_plausible(self) -> bool:
        """Return whether the value is not 0, and no uncertainty is negative. A bias may be negative, its spread not."""
        spreads = [part.standard for part in self.components if part.standard is not None]
        return self.value != 0.0 and min(self.combined, self.expanded, self.coverage, *spreads) >= 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCheck:
    """One value against one limit of a data sheet."""

    channel: str  # such as gyro/x
    quantity: str  # N, B, K, or floor: the lowest Allan deviation, 0.664 B
    unit: str  # of the data sheet
    limit: float  # in `unit`
    basis: str  # "maximum" or "typical"
    value: float | None  # in `unit`, measured; null: only bounded, or not known
    low: float | None  # in `unit`, combined lower 95 % limit
    high: float | None  # in `unit`, combined upper 95 % limit, or the upper bound
    verdict: Verdict  # whether the value is at most the limit
    probability: float | None  # 0 to 1, of being at most the limit; null: only bounded, or not known
    reason: str | None = None  # why it is undecided or without a probability


@dataclass(frozen=True, slots=True, kw_only=True)
class Conformity:
    """The values against the data sheet of the device."""

    title: str  # device
    document: str  # data sheet
    edition: str | None = None  # of the data sheet
    source: str | None = None  # where the limits were read
    note: str | None = None  # what must be known to compare
    checks: tuple[LimitCheck, ...] = ()  # one per channel and limit


@dataclass(frozen=True, slots=True, kw_only=True)
class ExactCurve:
    """Fully overlapping Allan deviation of one channel, computed from all samples."""

    tau_s: tuple[float, ...] = ()  # s, averaging times
    sigma: tuple[float, ...] = ()  # channel unit, Allan deviation
    low: tuple[float | None, ...] = ()  # channel unit, lower 95 % limit
    high: tuple[float | None, ...] = ()  # channel unit, upper 95 % limit
    terms: tuple[int, ...] = ()  # 1, differences that were averaged
    # 1, sigma of `allan` over this one, less 1; null: no such octave
    difference: tuple[float | None, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """What a document needs beside the numbers."""

    provenance: Provenance | None = None  # where they come from
    # by channel and letter
    budgets: Mapping[str, Mapping[str, UncertaintyBudget]] = field(default_factory=dict)
    # by channel, of the bias; only with a history that counts its power-ups
    bias_budgets: Mapping[str, UncertaintyBudget] = field(default_factory=dict)
    not_covered: tuple[str, ...] = ()  # what no budget includes, one line each
    conformity: Conformity | None = None  # against a data sheet; null: none of this device is known
    exact: Mapping[str, ExactCurve] = field(default_factory=dict)  # by channel; with --exact only

    def sizes_are_positive(self) -> bool:
        """Return whether every budget of a coefficient is of a value above 0."""
        return all(budget.value > 0.0 for budgets in self.budgets.values() for budget in budgets.values())
