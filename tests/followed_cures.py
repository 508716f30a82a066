"""Cures as a user follows them: the options that an error prints, run, until there is a report."""

from __future__ import annotations

import re
import shlex
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.cli import parsers
from imumon.cli.replay_command import replay_options
from imumon.model.cures import OPTIONS
from imumon.model.errors import ImumonError
from imumon.model.report import Report

MOST_STEPS = 2
"""Cures that a user follows at most."""


def printed_options(cure: str) -> Iterator[list[str]]:
    """Yield the arguments that a cure prints: each of its alternatives."""
    for text in re.split(r" or | and (?=--)", cure):
        begin = text.find("--")
        if begin < 0:
            continue
        words = shlex.split(text[begin:].replace(";", " ; "))
        arguments: list[str] = []
        while words and words[0] in OPTIONS.values() and len(words) > 1:
            arguments += [words[0], words[1].rstrip(",")]
            words = words[2:]
        if arguments:
            yield arguments


def converted(cure: str, folder: Path) -> Path | None:
    """Return the file that the command of a cure writes; None: the cure has no command."""
    command = re.search(r"(?:grep|cut|iconv|mavlogdump\.py) .*?> imu\.csv", cure)
    if command is None:
        return None
    subprocess.run(command[0], shell=True, cwd=folder, check=True, timeout=60)
    return folder / "imu.csv"


def follow(path: Path, given: ReplayOptions, arguments: list[str]) -> ReplayOptions:
    """Return the options with those that a cure prints, as the command reads them."""
    cured = replay_options(parsers()[1]["replay"].parse_args([str(path), *arguments]), str(path))
    merged = {
        field: getattr(cured, field)
        for field in ("kind", "rate_hz", "sensor", "topic", "definitions")
        if getattr(cured, field)
    }
    return replace(
        given,
        columns={**given.columns, **cured.columns},
        where={**(given.where or {}), **(cured.where or {})},
        **merged,
    )


def outcomes(
    path: Path, options: ReplayOptions, steps: int = MOST_STEPS, known: Mapping[str, str] | None = None
) -> Iterator[Report]:
    """Yield the report of each way through the cures.

    Parameters
    ----------
    steps : cures that may be followed.
    known : what only the user knows, by the words in place of it; ``--rate`` is the option alone. A way on which a cure
        asks for more ends without a report.
    """
    error = None
    try:
        yield replay(options)
    except ImumonError as raised:
        error = raised
    if error is None:
        return
    cure = error.cure
    for word, answer in (known or {}).items():
        cure = re.sub(rf"{re.escape(word)}(?! \d)(?!\w)", answer, cure)
    with tempfile.TemporaryDirectory() as folder:
        if (table := converted(cure, Path(folder))) is not None:
            path, options = table, replace(options, path=str(table))
            if not list(printed_options(cure.partition("imu.csv")[2])):
                yield from outcomes(path, options, steps - 1, known)
                return
        yield from _ways(path, options, steps, known, error, cure)


def _ways(
    path: Path,
    options: ReplayOptions,
    steps: int,
    known: Mapping[str, str] | None,
    error: ImumonError,
    cure: str,
) -> Iterator[Report]:
    """Yield the report of each way that begins with one of the options of a cure."""
    alternatives = list(printed_options(cure))
    # what only the user knows, such as a rate, is no step of a way
    asked = cure != error.cure
    assert asked or steps, f"no number after {MOST_STEPS} cures: {error}"
    # a rate, and the columns of a table without names, are known to the user alone
    assert alternatives or "--rate" in cure, error
    for arguments in alternatives:
        if "..." not in " ".join(arguments):
            followed = follow(path, options, arguments)
            assert followed != options, f"a cure that is followed already: {error}"
            yield from outcomes(path, followed, steps - (not asked), known)
