"""Mistakes of users and of other programs are one line and the right exit code, never a traceback."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import imumon, run_inside
from waiting import until


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


@pytest.mark.few
@pytest.mark.parametrize("command", [("run", "--port", "sim"), ("demo",)])
def test_a_signal_during_the_start_leaves_no_temporary_directory(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    terminal, other = pty.openpty()
    environment = {**os.environ, "TMPDIR": str(tmp_path), "TERM": "xterm"}
    run = subprocess.Popen(
        [sys.executable, "-m", "imumon", *command], env=environment, stdin=other, stdout=other, stderr=other
    )
    end = time.monotonic() + 20
    while not list(tmp_path.glob("imumon-*")) and time.monotonic() < end:
        time.sleep(0.005)
    run.terminate()
    assert run.wait(60) in (0, -signal.SIGTERM, 128 + signal.SIGTERM)
    os.close(terminal)
    os.close(other)
    assert list(tmp_path.iterdir()) == []


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
    done = subprocess.run(
        [*arguments[:3], "√"], env=environment, capture_output=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert done.stderr.decode(encoding).startswith("imumon: no command ")


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

    def running() -> list[str]:
        """Return the processes of the demo: they inherit its directory for temporary files."""
        commands = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):  # it has ended, or belongs to somebody else
                if f"TMPDIR={tmp_path}".encode() in (process / "environ").read_bytes().split(b"\0"):
                    commands.append((process / "cmdline").read_text())
        return commands

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
