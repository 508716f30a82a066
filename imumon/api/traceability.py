"""Evaluation of a report for a document: where it comes from, its uncertainty, and the check against a data sheet.

It happens once per document, here, because it reads what the lower packages must not: the input file again, the
name of the host, and the revision of the program.
"""

from __future__ import annotations

import hashlib
import os
import socket
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from imumon import __version__
from imumon.errors import why
from imumon.evaluation import Evaluation, Provenance
from imumon.history_report import HistoryRow
from imumon.messages import one_warmup
from imumon.report import Report
from imumon.report_json import plain

COMPUTING = ("numpy", "scipy")
"""Packages whose version is recorded."""


def evaluated(report: Report, sheet: Any = None, rows: Sequence[HistoryRow] = ()) -> Report:
    """Return a report with the budget of its values and their check against a data sheet.

    A saved report keeps its budgets: the history that they rest on is not in it.

    Parameters
    ----------
    sheet : reference sheet that the user names; None: that of the model, if it is known.
    rows : of the history of the sensor; empty: none is known.

    Raises
    ------
    SheetError : the sheet is of another device.
    """
    report = replace(report, events=one_warmup(report.events))
    evaluation = report.evaluation or Evaluation()
    parts = [budget for budgets in evaluation.budgets.values() for budget in budgets.values()]
    if not evaluation.not_covered or any(
        budget.low is None for budget in parts
    ):  # an earlier version has no limits
        from imumon.history.repeatability import day_scatter
        from imumon.pipeline.uncertainty_budgets import (
            bias_budgets,
            not_covered,
            uncertainty_budgets,
            with_combined,
        )

        evaluation = replace(
            evaluation,
            budgets=uncertainty_budgets(report, day_scatter(rows)),
            bias_budgets=bias_budgets(report),
            not_covered=not_covered(report),
        )
        report = replace(report, channels=with_combined(report, evaluation.budgets))
    report = replace(report, evaluation=evaluation)
    limits = _checked(report, sheet) or _sheet_of_model(report)
    if limits is not None:
        from imumon.references.limit_checks import conformity

        report = replace(report, evaluation=replace(evaluation, conformity=conformity(report, limits)))
    return report


def _checked(report: Report, sheet: Any) -> Any:
    from imumon.references import SheetError

    model = report.device.model
    if sheet is not None and sheet.models and model and not sheet.is_of(model):
        message = f"--datasheet: it is of {', '.join(sheet.models)}, and the record is of a {model}"
        raise SheetError("datasheet_of_other_device", message, "name the data sheet of this sensor")
    return sheet


def _sheet_of_model(report: Report) -> Any:
    """Return the sheet of the model, of its driver or of imumon; None if the model is unknown or has none."""
    from imumon.devices import registry
    from imumon.references import read_sheet, sheet_of_model

    device = report.device
    driver = registry.installed(device.driver)
    path = driver.reference_sheet(device.model) if driver is not None and device.model else None
    return read_sheet(path) if path is not None else sheet_of_model(device.model)


def with_provenance(
    report: Report,
    path: str | None,
    options: Mapping[str, str],
    guards: bool | None,
    reason: str = "read from a running daemon",
) -> Report:
    """Return a report with where its numbers come from.

    A report that says so itself, of a daemon or a file, keeps that; what writes the document is named if it is another.

    Parameters
    ----------
    path : of the input; None: it is no file.
    options : options that were given, by name.
    guards : whether disturbances were excluded; None: unknown.
    reason : what the input is where it is no file.
    """
    before = report.evaluation or Evaluation()
    if (origin := before.provenance) is None:
        origin = replace(provenance(path, options, guards, reason), made=report.time)
    elif (origin.software, origin.commit) != (writer := (_software(), commit())):
        origin = replace(origin, written_by=", revision ".join(filter(None, writer)))
    return replace(report, evaluation=replace(before, provenance=origin))


def provenance(path: str | None, options: Mapping[str, str], guards: bool | None, reason: str) -> Provenance:
    """Return program, host and input, or the reason why there is none; see `with_provenance`."""
    size, digest, why = (None, None, reason) if path is None else _digest(path)
    return Provenance(
        software=_software(),
        commit=commit(),
        libraries={name: version(name) for name in COMPUTING},
        host=plain(socket.gethostname()),
        input=None if path is None else plain(os.path.basename(os.path.normpath(path))),
        input_bytes=size,
        input_sha256=digest,
        input_reason=why,
        options=options,
        guards=guards,
    )


def _software() -> str:
    return f"imumon {__version__}"


def _digest(path: str) -> tuple[int | None, str | None, str | None]:
    """Return size and SHA-256 of a file, or of the files of a directory in the order of their names.

    Without one, return the reason as the third.
    """
    if path == "-":
        return None, None, "read from standard input"
    source, digest, size = Path(path), hashlib.sha256(), 0
    try:
        files = sorted(file for file in source.rglob("*") if file.is_file()) if source.is_dir() else [source]
        if not all(file.is_file() for file in files):
            return None, None, "not a regular file"
        for file in files:
            with file.open("rb") as opened:
                while piece := opened.read(1 << 20):
                    digest.update(piece)
                    size += len(piece)
    except OSError as error:
        return None, None, why(error)
    several = f"of {len(files)} files in the order of their names, joined" if source.is_dir() else None
    return size, digest.hexdigest(), several


def commit() -> str | None:
    """Return the revision of the program: recorded when it was built, or of the source checkout; None: unknown."""
    package = Path(__file__).parents[1]
    recorded = package / "commit.txt"
    if recorded.is_file():
        return plain(recorded.read_text().strip())[:60] or None
    if not (package.parent / ".git").exists():
        return None
    words = [
        "git",
        "-C",
        str(package.parent),
        "describe",
        "--always",
        "--abbrev=40",
        "--dirty",
        "--exclude=*",
    ]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=5.0)
    except (OSError, subprocess.SubprocessError):
        return None
    return plain(done.stdout.strip()) or None if done.returncode == 0 else None
