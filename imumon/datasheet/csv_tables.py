"""Curves as CSV: every point of every channel, then every coefficient; SI units, one header line each."""

from __future__ import annotations

import csv
import io

from imumon.report import COEFFICIENTS, Coefficient, Report


def table(made: Report) -> str:
    """Two tables with an empty line between them."""
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n").writerow
    write(("channel", "unit", "tau_s", "sigma", "low", "high", "edf", "model", "used"))
    for name, channel in made.channels.items():
        if (a := channel.allan) is not None:
            for row in zip(a.tau_s, a.sigma, a.low, a.high, a.edf, a.model, a.used, strict=True):
                write((name, channel.unit, *row[:-1], int(row[-1])))
    write(())
    write(("channel", "coefficient", "unit", "value", "low", "high", "status"))
    for name, channel in made.channels.items():
        for letter in COEFFICIENTS:
            found: Coefficient | None = getattr(channel, letter)
            if found is not None:
                write((name, letter, found.unit, found.value, found.low, found.high, found.status))
    return out.getvalue()
