"""Sensors without a unit: the unit that the length, the noise, or the counts of three columns suggest.

An accelerometer at rest has the length of one g. A gyroscope at rest has only its noise, so that its unit is a
proposal, which the reason says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imumon.model.samples import Kind
from imumon.sources.files.column_names import Triple, _kind_of_words
from imumon.sources.files.columns import Use
from imumon.sources.files.sizes_at_rest import counts_of_gravity, sample_noise
from imumon.sources.files.unit_grammar import known_unit


def in_counts(triple: Triple, key: str) -> Use:
    """Return a sensor whose numbers are counts."""
    counts = counts_of_gravity(triple.size) if key == "accel" else 0.0
    if counts:
        reason = f"{triple.label} are counts, of which 1 g has about {counts:g}"
        return Use(
            key,
            triple.indices,
            triple.axes,
            "g",
            known_unit("g"),
            False,
            reason,
            scale=1.0 / counts,
            kind=kind_of(triple),
        )
    reason = f"{triple.label} are counts: how many a unit has is in the data sheet"
    return Use(
        key,
        triple.indices,
        triple.axes,
        "deg/s" if key == "gyro" else "g",
        None,
        False,
        reason,
        scale=0.0,
        kind=kind_of(triple),
    )


def by_gravity(triple: Triple, of_gravity: Sequence[str], *, named: bool) -> Use:
    """Return an accelerometer without a unit."""
    size = triple.size
    whole = triple.counts
    kind = kind_of(triple)
    if of_gravity and not whole:
        certain = len(of_gravity) == 1 and bool(triple.stem.strip() or named)
        reason = f"the length of {triple.label} is {size:.4g}, which is 1 g in {' or '.join(of_gravity)}"
        return Use(
            "accel",
            triple.indices,
            triple.axes,
            of_gravity[0],
            known_unit(of_gravity[0]),
            certain,
            reason,
            "assumed_unit" if named else "assumed_columns",
            kind=kind,
        )
    if whole and (counts_of_gravity(size) or not of_gravity):
        return in_counts(triple, "accel")
    if of_gravity:
        reason = f"the length of {triple.label} is {size:.4g}: 1 g in {' or '.join(of_gravity)}, or in counts"
        return Use(
            "accel",
            triple.indices,
            triple.axes,
            of_gravity[0],
            known_unit(of_gravity[0]),
            False,
            reason,
            kind=kind,
        )
    reason = f"{triple.label} have no unit, and their length of {size:.4g} is 1 g in none"
    return Use("accel", triple.indices, triple.axes, "", None, False, reason, kind=kind)


def by_noise(triple: Triple, key: str, unit: str, *, named: bool = True) -> Use:
    """Return a sensor whose unit only its noise suggests."""
    if not unit and key == "gyro":
        return in_counts(triple, key)
    noise = sample_noise(triple.rows)
    known, rad, deg = known_unit(unit), known_unit("rad/s"), known_unit("deg/s")
    assert known is not None
    assert rad is not None
    assert deg is not None
    other, factor = (
        ("rad/s", rad.factor / known.factor) if unit != "rad/s" else ("deg/s", deg.factor / known.factor)
    )
    what = "have no unit" if named else "have no name and no unit"
    reason = (
        f"{triple.label} {what}: their noise of {noise:.2g} is usual in {unit}; in {other}, N would be "
        f"{_times(factor)}"
    )
    return Use(
        key,
        triple.indices,
        triple.axes,
        unit,
        known,
        False,
        reason,
        "assumed_unit" if named else "assumed_columns",
        kind=kind_of(triple),
    )


def increments_without_unit(triple: Triple, key: str) -> Use:
    """Return increments without a unit; their interval may show it, see `ClockReader`."""
    unit = "rad" if key == "gyro" else "m/s"
    reason = f"{triple.label} have the name of increments and no unit"
    if key == "gyro":
        reason += f"; in deg, N would be {_times(math.radians(1.0))}"
    return Use(key, triple.indices, triple.axes, unit, known_unit(unit), False, reason, kind="deltas")


def _times(factor: float) -> str:
    """Return a factor of N for people.

    >>> _times(57.2958), _times(0.0175)
    ('57 times larger', '57 times smaller')
    """
    return f"{factor:.2g} times larger" if factor >= 1.0 else f"{1.0 / factor:.2g} times smaller"


def kind_of(triple: Triple) -> Kind:
    """Return whether the words of a triple say that its numbers are compensated."""
    return _kind_of_words(triple.words)
