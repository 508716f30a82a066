"""Mistakes of users and of other programs are one line and the right exit code, never a traceback."""

from __future__ import annotations

import json
import os
import pty
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import forked
import numpy as np
import psutil
import pytest
from cases import case
from commands import imumon, run_inside
from histories import period, write
from reports import warming_up
from waiting import until

from imumon.model.report_json import to_json


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("run", "--port", "sim", "--speed", "1e300"), "--speed 1e+300"),
        (("run", "--port", "sim", "--seed", "-1"), "--seed -1"),
        (("replay", ""), "the name of the file is empty"),
        (("report", " "), "the name of the file is empty"),
        (("sim", "--rate", "0"), "--rate 0"),
        (("sim", "--gyro", "abc"), "'abc': give N,B,K"),
        (("sim", "--seed", "x"), "'x' is not a whole number"),
        (
            ("replay", "x.txt", "--speed", "-1"),
            "--speed: '-1' is not a positive number: give one, such as 60",
        ),
        (("replay", "x.txt", "--rate", "1e300"), "from 0.0001 to 100000"),
        (("status", "--id", "////"), "use letters and digits"),
        (("config",), "{show,check}"),
        (("config", "chekc"), "'show', 'check'"),
        (("run", "--conect", "x"), "did you mean --connect?"),
        (("run", "--nonsense"), "--nonsense: imumon run --help"),
        (("wait", "--precision", "0.1"), "--coefficient"),
        (("wait", "--grade", "splendid"), "splendid"),
        (("wait", "--timeout", "soon"), "soon"),
        (("wait", "--timeout", "0"), "--timeout"),
    ],
)
def test_invalid_options(arguments: tuple[str, ...], text: str) -> None:
    assert text in imumon(*arguments, code=2)


@pytest.mark.parametrize("command", ["status", "check", "wait", "history", "report", "doctor", "run"])
def test_options_of_the_program_may_stand_before_any_command(command: str) -> None:
    for before in (["--connect", "tcp/127.0.0.1:1"], ["--config=x.toml"]):
        code, output, errors = run_inside([*before, command, "--nonsense"])
        assert code == (3 if command == "check" else 2)
        assert "unknown argument --nonsense" in output + errors


@pytest.mark.parametrize("state", ["/dev/null", "/dev/null/state"])
def test_a_state_directory_that_cannot_be_one_is_refused_at_the_start(state: str) -> None:
    message = imumon("run", "--port", "sim", "--state", state, "--duration", "1", code=1)
    assert "/dev/null is not a directory: give a directory with --state" in message


@pytest.mark.parametrize(
    ("redirected", "code", "text"),
    [
        (
            ">/dev/full",
            1,
            "imumon: cannot write the output: no space left on device: free space, or write elsewhere\n",
        ),
        (">&-", 0, ""),
        ("<&- 2>&-", 0, ""),
    ],
)
def test_standard_streams_may_be_full_or_closed(redirected: str, code: int, text: str) -> None:
    command = f"{sys.executable} -m imumon config show {redirected}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (code, text)


@pytest.mark.few
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_output_in_an_encoding_that_lacks_characters(encoding: str, tmp_path: Path) -> None:
    """Missing characters are replaced; JSON loses nothing."""
    file = tmp_path / "µ-rest.csv"
    rows = (f"{n / 40},{n * 7919 % 13},{n * 104729 % 17},{n * 31 % 11}" for n in range(800))
    file.write_text("\n".join(["t [s],wx [deg/s],wy [deg/s],wz [deg/s]", *rows, ""]))
    arguments = [sys.executable, "-m", "imumon", "replay", str(file)]
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    for more in (["--verbose"], ["--json"]):
        done = subprocess.run(
            [*arguments, *more], env=environment, capture_output=True, timeout=60, check=False
        )
        assert done.returncode == 0
        # one remark, whose name of the file has the replaced character: this noise is no sensor at rest
        (remark,) = done.stderr.decode(encoding).splitlines()
        assert remark.endswith("-rest.csv: no value of N: most of the record is excluded")
        text = done.stdout.decode(encoding)
        if "--json" in more:
            assert json.loads(text)["device"]["port"] == str(file)
        else:
            assert {"ascii": "N, deg/sqrt h", "latin-1": "N, °/sqrt h"}[encoding] in text


@pytest.mark.parametrize(
    ("arguments", "exit_code", "code"),
    [
        (("status", "--connect", "tcp/127.0.0.1:9"), 3, "no_daemon"),
        (("status", "--id", "////"), 2, None),
        (("run", "--port", "/dev/nothing"), 3, None),
        (("replay", "nothing.bin"), 1, None),
        (("run", "--config", "nothing.toml"), 2, "invalid_settings"),
    ],
)
def test_commands_with_json_print_errors_as_json(
    arguments: tuple[str, ...],
    exit_code: int,
    code: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    returned, output, errors = run_inside([*arguments, "--json"])
    assert (returned, output) == (exit_code, "")
    error = json.loads(errors)["error"]
    assert set(error) >= {"code", "message", "cure"}
    assert code in (None, error["code"])


def test_nothing_of_the_demo_outlives_it(tmp_path: Path) -> None:
    """Also if it is killed: its daemon stops when the pipe from the demo ends, and deletes the directory."""
    environment = {**os.environ, "TMPDIR": str(tmp_path)}

    def running() -> list[psutil.Process]:
        """Return the processes of the demo: they inherit its directory for temporary files."""
        every = psutil.process_iter(["environ"])  # None: it belongs to somebody else
        return [one for one in every if (one.info["environ"] or {}).get("TMPDIR") == str(tmp_path)]

    screen, terminal = os.openpty()
    command = [sys.executable, "-m", "imumon", "demo"]
    demo = subprocess.Popen(command, env=environment, stdin=terminal, stdout=terminal, stderr=terminal)
    os.close(terminal)
    until(lambda: len(running()) == 3)  # demo, daemon and emulator
    demo.kill()
    demo.wait(60)
    until(lambda: not running())
    os.close(screen)
    assert list(tmp_path.iterdir()) == []


# ---------- cures: a command that an error prints works as it is printed, in the place where the error has oc


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


@pytest.mark.parametrize(
    ("typed", "code"), [("y\n", 0), ("\n", 0), ("n\n", 2), ("e\n\n", 0), ("e\n\x7f\x7fus\n", 0)]
)
def test_a_question_on_a_terminal_has_an_answer(typed: str, code: int, tmp_path: Path) -> None:
    """Yes, no, or the proposal as an editor of lines has it: backspaces delete its end."""
    (tmp_path / "log.txt").write_text(SAMPLES)
    master, slave = pty.openpty()
    process = forked.Forked(["replay", "log.txt"], (slave, slave, slave), tmp_path, {"TERM": "xterm"})
    os.close(slave)
    shown = b""
    try:
        for line in typed.splitlines(keepends=True):
            while not shown.endswith((b"n/e] ", b":ms")):
                shown += os.read(master, 65536)
            os.write(master, line.encode())
            shown += b"\n"
        with suppress(OSError):  # the end of a terminal
            while part := os.read(master, 65536):
                shown += part
        assert process.wait(60) == code
    finally:
        process.kill()
        os.close(master)
    assert b"Traceback" not in shown
    assert (b"at 100 Hz" in shown) == (code == 0 and "us" not in typed)
    assert (b"at 100000 Hz" in shown) == ("us" in typed)
