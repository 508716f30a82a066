"""Every cure that a recording prints is run: it leads to the right numbers, or to another cure, in two steps."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from followed_cures import outcomes
from tables import DEG, G, csv, truth

import imumon
from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.cli import parsers
from imumon.model.cures import OPTIONS, option_text
from imumon.model.errors import ImumonError

T, GYRO, ACCEL = truth(800)
NAMES = ["t", "gx", "gy", "gz", "ax", "ay", "az"]


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


ASKED = {"zero stamps"}
"""Cures that ask for what only the user knows."""


@pytest.mark.parametrize("name", CORPUS)
def test_every_cure_works(tmp_path: Path, name: str) -> None:
    path = CORPUS[name](tmp_path)
    sizes = {"gyro": np.linalg.norm(GYRO.mean(axis=0)), "accel": np.linalg.norm(ACCEL.mean(axis=0))}
    reports = list(outcomes(path, ReplayOptions(path=str(path), guarded=False)))
    assert reports or name in ASKED
    for report in reports:
        for sensor, size in sizes.items():
            axes = [
                report.channels[f"{sensor}/{a}"].mean for a in "xyz" if f"{sensor}/{a}" in report.channels
            ]
            if axes and not (sensor == "accel" and name == "blank cells"):
                assert np.linalg.norm(np.array(axes)) == pytest.approx(size, rel=0.02)


@pytest.mark.parametrize("name", CORPUS)
def test_a_program_reads_arguments_and_no_options(tmp_path: Path, name: str) -> None:
    """Its errors and remarks have the arguments of a call."""
    path = CORPUS[name](tmp_path)
    with pytest.raises(ImumonError) as of_command:
        replay(ReplayOptions(path=str(path)))
    with pytest.raises(ImumonError) as of_program:
        imumon.analyse(path)
    assert of_program.value.code == of_command.value.code
    assert "--" not in str(of_program.value)


def test_the_parser_takes_the_options_that_cures_are_printed_with() -> None:
    parser = parsers()[1]["replay"]
    for name in OPTIONS.values():
        assert any(name in action.option_strings for action in parser._actions)
    text = option_text(columns={"gyro/x": "w x:deg/s"}, where={"sensor": "it's"})
    arguments = parser.parse_args(["a.csv", *shlex.split(text)])
    assert (arguments.map, arguments.where) == ("gyro/x=w x:deg/s", "sensor=it's")
