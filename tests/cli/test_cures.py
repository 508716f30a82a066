"""Cures: a command that an error prints works as it is printed, in the place where the error has occurred."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from cases import case
from commands import imumon, run_inside
from histories import period, write
from reports import warming_up

from imumon.model.report_json import to_json

HEADER = "t [ms],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]\n"
_SIZES = (0.002, 0.002, 0.002, 0.02, 0.02, 0.02)
_NOISE = np.random.default_rng(1).normal([0, 0, 0, 0, 0, 9.8], _SIZES, (400, 6)).tolist()
SAMPLES = "".join(f"{10 * k}," + ",".join(f"{x:.5f}" for x in row) + "\n" for k, row in enumerate(_NOISE))


def test_commands_in_cures_work_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "my files"  # a path that a shell would divide
    folder.mkdir()
    monkeypatch.chdir(tmp_path)
    log, table, report, settings = (
        folder / name for name in ("log", "table.csv", "report.json", "wrong.toml")
    )
    log.write_text(SAMPLES)
    table.write_text(HEADER + SAMPLES)
    report.write_text(to_json(warming_up()))
    settings.write_text("[device]\nqqqq = 1\n")
    history = write(folder, "lab", [period(0)])
    reports = shlex.quote(str(report))
    for wrong, code, printed, words in (
        (("replay", report), 1, f"imumon report {reports}", f"report {reports}"),
        (
            ("run", "--port", table),
            1,
            f"imumon replay {shlex.quote(str(table))}",
            f"replay {shlex.quote(str(table))}",
        ),
        (("replay", history), 1, "imumon history --state DIR", f"history --state {shlex.quote(str(folder))}"),
        (
            ("replay", log, "--accept", "--baseline", log),
            2,
            "imumon report --format json",
            f"report {reports} --format json",
        ),
        (("run", "--config", settings), 2, "imumon config show", "config show"),
        (("explain", "nothing at all"), 2, "imumon explain", "explain"),
    ):
        with case(wrong):
            assert printed in imumon(*wrong, code=code)
            returned, output, errors = run_inside(shlex.split(words))
            assert (returned, errors) == (0, "")
            assert output


def test_a_proposal_is_an_option_that_can_be_pasted(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    log.write_text(SAMPLES)
    returned, _, errors = run_inside(["replay", str(log)])
    assert returned == 2
    proposed = shlex.split(errors.splitlines()[-1].partition(": ")[2])
    for words in (proposed, ["--accept"]):
        assert run_inside(["replay", str(log), *words])[0] == 0
