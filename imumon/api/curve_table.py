"""Curve table: the Allan deviation of a channel as arrays, a DataFrame or a Dataset of xarray."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from imumon.model.errors import ImumonError
from imumon.model.report import Channel
from imumon.model.samples import Bools, Floats

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(frozen=True, repr=False, eq=False)
class CurveTable:
    """Allan deviation of a channel; NaN is unknown.

    Attributes
    ----------
    channel, unit : of the channel.
    tau_s : (k,) s, averaging times.
    sigma, low, high : (k,) channel unit, deviation and its 95 % limits.
    edf : (k,) 1, equivalent degrees of freedom.
    model, noise : (k,) channel unit, all that the report states, and its noise alone.
    used : (k,) whether the fit uses the octave.
    """

    channel: str
    unit: str
    tau_s: Floats
    sigma: Floats
    low: Floats
    high: Floats
    edf: Floats
    model: Floats
    noise: Floats
    used: Bools

    def __len__(self) -> int:
        return len(self.tau_s)

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays by name."""
        names = [field.name for field in fields(self)][2:]
        return {name: getattr(self, name) for name in names}

    def to_frame(self) -> pandas.DataFrame:
        """Return a DataFrame with a row for each averaging time."""
        frame = frame_of(
            [dict(zip(self.arrays(), row, strict=True)) for row in zip(*self.arrays().values(), strict=True)]
        )
        return frame.set_index("tau_s") if len(frame) else frame

    def to_xarray(self) -> xarray.Dataset:
        """Return a Dataset over ``tau_s``; raise `ImumonError` if xarray is not installed."""
        try:
            import xarray
        except ModuleNotFoundError:
            text = "a Dataset needs xarray, which is not installed"
            raise ImumonError("package_missing", text, "pip install 'imumon[frames]'") from None
        arrays = self.arrays()
        facts = {"channel": self.channel, "unit": self.unit}
        taus = arrays.pop("tau_s")
        return xarray.Dataset({name: ("tau_s", a) for name, a in arrays.items()}, {"tau_s": taus}, facts)

    def __repr__(self) -> str:
        lines = [f"Allan deviation of {self.channel}, {self.unit}: {len(self)} averaging times, 95 % limits"]
        lines += [f"{'tau, s':>12} {'sigma':>11} {'low':>11} {'high':>11} {'model':>11}"]
        for row in zip(self.tau_s, self.sigma, self.low, self.high, self.model, strict=True):
            lines.append(f"{row[0]:12.6g} " + " ".join(f"{number:11.4e}" for number in row[1:]))
        shown = lines if len(lines) <= 34 else [*lines[:32], f"... {len(lines) - 32} more"]
        return "\n".join(shown)


def frame_of(rows: list[dict[str, Any]]) -> pandas.DataFrame:
    """Return rows as a DataFrame; raise `ImumonError` if pandas is not installed."""
    try:
        import pandas
    except ModuleNotFoundError:
        raise ImumonError(
            "package_missing",
            "a DataFrame needs pandas, which is not installed",
            "pip install 'imumon[frames]'",
        ) from None
    return pandas.DataFrame(rows)


def curve_table(name: str, channel: Channel) -> CurveTable:
    """Return the curve of a channel; raise `ImumonError` if it has none."""
    if channel.allan is None or not channel.allan.tau_s:
        raise ImumonError(
            "no_curve",
            f"{name} has no Allan deviation",
            "name a channel of a sensor, or record longer; a combination has none: take those of its records",
        )
    curve = channel.allan
    return CurveTable(
        name,
        channel.unit,
        np.array(curve.tau_s),
        np.array(curve.sigma),
        _floats(curve.low),
        _floats(curve.high),
        _floats(curve.edf),
        _floats(curve.model) if curve.model else np.full(len(curve.tau_s), np.nan),
        _floats(curve.noise) if curve.noise else np.full(len(curve.tau_s), np.nan),
        np.array(curve.used, bool),
    )


def _floats(values: tuple[float | None, ...]) -> Floats:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
