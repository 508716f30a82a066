"""Every cure that a recording prints is run: it leads to the right numbers, or to another cure, in two steps."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tables import DEG, G, csv, truth

from imumon.cli import parsers
from imumon.cli.replay_command import replay_options
from imumon.cures import OPTIONS, option_text
from imumon.errors import ImumonError
from imumon.replay import ReplayOptions, replay
from imumon.report import Report

T, GYRO, ACCEL = truth(800)
NAMES = ["t", "gx", "gy", "gz", "ax", "ay", "az"]
MOST_STEPS = 2
"""Cures that a user follows at most."""


def _table(names: list[str], *columns: np.ndarray) -> Callable[[Path], Path]:
    return lambda folder: csv(folder / "a.csv", names, *columns)


def _without_header(folder: Path) -> Path:
    path = csv(folder / "a.csv", NAMES, T, GYRO, ACCEL)
    path.write_text("\n".join(path.read_text().splitlines()[1:]) + "\n")
    return path


def _by_row(folder: Path) -> Path:
    pairs = [row for g, a in zip(GYRO, ACCEL, strict=True) for row in ((1, *a), (4, *g))]
    return csv(folder / "a.csv", ["sensor", "t", "x", "y", "z"], *_by_row_columns(np.array(pairs)))


def _by_row_columns(pairs: np.ndarray) -> tuple[np.ndarray, ...]:
    return pairs[:, :1], np.repeat(T, 2) + 0.004 * (np.arange(2 * len(T)) % 2), pairs[:, 1:]


def _blank_cells(folder: Path) -> Path:
    path = csv(folder / "a.csv", NAMES, T, GYRO, ACCEL)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *(r if k % 4 == 0 else _cells(r) for k, r in enumerate(rows))]) + "\n")
    return path


def _cells(row: str) -> str:
    return ",".join([*row.split(",")[:4], "", "", ""])


def _arrays(folder: Path) -> Path:
    np.savez(folder / "a.npz", t=T, gyro=GYRO / DEG, accel=ACCEL / G)
    return folder / "a.npz"


CORPUS: dict[str, Callable[[Path], Path]] = {
    "accel in g": _table(NAMES, T, GYRO, ACCEL / G),
    "accel in mm/s2": _table(NAMES, T, GYRO, ACCEL * 1e3),
    "wrong unit in the header": _table([*NAMES[:4], "ax [g]", "ay [g]", "az [g]"], T, GYRO, ACCEL),
    "gyro in deg/s": _table(NAMES, T, GYRO / DEG, ACCEL),
    "both": _table(NAMES, T, GYRO / DEG, ACCEL / G * 1e3),
    "counts and brackets": _table(
        ["t", *(f"gyroADC[{k}]" for k in range(3)), *(f"accSmooth[{k}]" for k in range(3))],
        T, GYRO / DEG, np.rint(ACCEL / G * 16384),
    ),
    "names with blanks": _table(
        ["t", *(f"Gyro {a} axis" for a in "XYZ"), *(f"Acc {a} axis" for a in "XYZ")], T, GYRO / DEG, ACCEL / G
    ),
    "no names of a sensor": _table(["t", "x", "y", "z"], T, GYRO),
    "increments in g*s": _table(["t", *(f"Delta Vel {a}" for a in "XYZ")], T, ACCEL / G / 100.0),
    "time in steps of one": _table(["n_t", *NAMES[1:]], np.arange(800.0) * 1e-3 * 1e3, GYRO, ACCEL),
    "sensors by row": _by_row,
    "blank cells": _blank_cells,
    "no header": _without_header,
    "arrays": _arrays,
    "zero stamps": _table(NAMES, 0.0 * T, GYRO, ACCEL),
    "time in the wrong unit": _table(["t [ns]", *NAMES[1:]], T * 1e3, GYRO, ACCEL),
}  # fmt: skip


ASKED = {"no header", "zero stamps"}
"""Cures that ask for what only the user knows."""


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


def follow(path: Path, given: ReplayOptions, arguments: list[str]) -> ReplayOptions:
    """Return the options with those that a cure prints, as the command reads them."""
    cured = replay_options(parsers()[1]["replay"].parse_args([str(path), *arguments]), str(path))
    merged = {
        field: getattr(cured, field)
        for field in ("kind", "rate_hz", "sensor", "topic")
        if getattr(cured, field)
    }
    return replace(
        given,
        columns={**given.columns, **cured.columns},
        where={**(given.where or {}), **(cured.where or {})},
        **merged,
    )


def outcomes(path: Path, options: ReplayOptions, steps: int) -> Iterator[Report]:
    """Yield the report of each way through the cures."""
    error = None
    try:
        yield replay(options)
    except ImumonError as raised:
        error = raised
    if error is None:
        return
    assert steps, f"no number after {MOST_STEPS} cures: {error}"
    alternatives = list(printed_options(error.cure))
    # a rate, and the columns of a table without names, are known to the user alone
    assert alternatives or "--rate" in error.cure
    for arguments in alternatives:
        if "..." not in " ".join(arguments):
            yield from outcomes(path, follow(path, options, arguments), steps - 1)


@pytest.mark.parametrize("name", CORPUS)
def test_every_cure_works(tmp_path: Path, name: str) -> None:
    path = CORPUS[name](tmp_path)
    sizes = {"gyro": np.linalg.norm(GYRO.mean(axis=0)), "accel": np.linalg.norm(ACCEL.mean(axis=0))}
    reports = list(outcomes(path, ReplayOptions(path=str(path), guarded=False), MOST_STEPS))
    assert reports or name in ASKED
    for report in reports:
        for sensor, size in sizes.items():
            axes = [
                report.channels[f"{sensor}/{a}"].mean for a in "xyz" if f"{sensor}/{a}" in report.channels
            ]
            if axes and not (sensor == "accel" and name == "blank cells"):
                assert np.linalg.norm(np.array(axes)) == pytest.approx(size, rel=0.02)


def test_the_parser_takes_the_options_that_cures_are_printed_with() -> None:
    parser = parsers()[1]["replay"]
    for name in OPTIONS.values():
        assert any(name in action.option_strings for action in parser._actions)
    text = option_text(columns={"gyro/x": "w x:deg/s"}, where={"sensor": "it's"})
    arguments = parser.parse_args(["a.csv", *shlex.split(text)])
    assert (arguments.map, arguments.where) == ("gyro/x=w x:deg/s", "sensor=it's")
