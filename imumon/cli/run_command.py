"""Commands that read a sensor, real or emulated: run, demo, sim."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

from imumon.cli import options
from imumon.cli.exit_codes import (
    FAILURE,
    INTERRUPTED,
    NOT_FOUND,
    NOT_REACHED,
    SUCCESS,
    USAGE,
    CommandError,
)
from imumon.cli.options import Parser, add_appearance, add_endpoints, baud, positive, rate, state_directory
from imumon.cli.output import print_report


def add_run(parser: Parser) -> None:
    add = parser.add_argument
    add("--port", metavar="PORT", help="device path, pyserial URL, or sim; default: the one VN-100 found")
    add("--baud", type=baud, metavar="auto|N", help="default auto: find it, never raise it")
    add("--set-baud", type=int, metavar="N", help="change the sensor's baud to N (volatile)")
    add("--rate", type=rate, metavar="HZ", help="sample rate of a stream without a clock")
    add(
        "--listen-only",
        action="store_true",
        default=None,
        help="write nothing to the sensor; a stream without a clock then needs --rate",
    )
    add(
        "--stream",
        choices=("deltas", "uncompensated", "compensated"),
        help="what to ask the sensor for; default deltas",
    )
    add("--id", metavar="NAME", help="name in the keys; default vn100-<serial number>")
    add(
        "--state",
        metavar="DIR",
        help="where the accumulated statistics live; of --port sim nothing is kept without it",
    )
    add("--fresh", action="store_true", help="start anew; the old state is kept aside")
    add("--record", metavar="FILE", help="also keep the raw bytes, for replay")
    add("--config", metavar="FILE", help="settings; flags win over the file")
    add("--duration", type=positive, metavar="S", help="stop after S seconds with a final report on stdout")
    add("--json", action="store_true", help="final report as JSON")
    add("--no-guards", action="store_true", default=None, help="cut nothing out")
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): tell what has changed")
    add("--speed", type=positive, default=1.0, metavar="X", help="time-lapse, with --port sim only")
    add("--seed", type=int, metavar="N", help="noise of the emulator, with --port sim only")
    add_endpoints(parser, listen=True)


def add_demo(parser: Parser) -> None:
    parser.add_argument("--speed", type=positive, default=60.0, metavar="X", help="time-lapse; default 60")
    parser.add_argument("--seed", type=int, metavar="N", help="noise of the emulator")
    add_appearance(parser)


def add_sim(parser: Parser) -> None:
    from imumon.devices.vn100.emulator import add_arguments

    add_arguments(parser)


def run(words: argparse.Namespace) -> int:
    made = _settings(words)
    if made.device.port == "sim":
        return _run_emulated(words, made)
    if words.speed != 1.0 or words.seed is not None:
        raise CommandError("option_not_applicable", "--speed and --seed need --port sim", exit_code=USAGE)
    return _daemon(words, made, made.device.port or None, state_directory(made))


def _run_emulated(words: argparse.Namespace, made: Any) -> int:
    """`run --port sim`: an emulator of its own, and a state that is thrown away unless one is asked for."""
    from pathlib import Path

    with _emulator(words.speed, words.seed) as sensor, _temporary_directory() as scratch:
        directory = Path(made.state.directory or scratch)
        return _daemon(words, made, sensor.path, directory)


def _temporary_directory() -> Any:
    """Return a directory, as a context manager that deletes it."""
    import tempfile

    return tempfile.TemporaryDirectory(prefix="imumon-", ignore_cleanup_errors=True)


def _settings(words: argparse.Namespace) -> Any:
    """Settings with the flags of `run` on top."""
    speed = words.baud
    return options.settings(
        words,
        {
            "device.port": words.port,
            "device.baud": int(speed) if speed and speed != "auto" else speed,
            "device.set_baud": words.set_baud,
            "device.rate_hz": words.rate,
            "device.listen_only": words.listen_only,
            "device.stream": words.stream,
            "device.id": words.id,
            "zenoh.listen": words.listen,
            "zenoh.connect": words.connect,
            "state.directory": words.state,
            "record.file": words.record,
            "guards.enabled": False if words.no_guards else None,
        },
    )


def _daemon(words: argparse.Namespace, settings: Any, path: str | None, directory: Any) -> int:
    import signal

    from imumon.bus import BusError
    from imumon.daemon import Daemon, RunOptions
    from imumon.daemon.connection import NoDevice
    from imumon.devices.vn100.vn100_session import SessionError
    from imumon.pipeline import RateRequired
    from imumon.recordings import PortError

    task = RunOptions(
        path=path,
        state_directory=directory,
        duration_s=words.duration,
        fresh=words.fresh,
        speed=words.speed,
        baseline=options.baseline(words.baseline),
    )
    try:
        outcome = Daemon(settings, task).run()
    except RateRequired as error:
        raise CommandError("rate_required", str(error), "imumon doctor counts it", USAGE) from None
    except (NoDevice, SessionError) as error:
        raise CommandError("no_device", str(error), exit_code=NOT_FOUND) from None
    except PortError as error:
        there = path is None or os.path.exists(path)
        raise CommandError("port", str(error), exit_code=FAILURE if there else NOT_FOUND) from None
    except BusError as error:
        raise options.with_origin(error, settings) from None
    if outcome.report is None and outcome.signal is None:
        message = f"no device within {words.duration:g} s"
        raise CommandError("no_device_in_time", message, "give a longer --duration", NOT_REACHED)
    if outcome.report is not None and (words.duration or words.json):
        print_report(outcome.report, words.json, task.baseline)
    return INTERRUPTED if outcome.signal == signal.SIGINT else SUCCESS


def _emulator(speed: float, seed: int | None) -> Any:
    """Emulator in a process of its own, a context that gives it."""
    from dataclasses import replace

    from imumon.devices.vn100.emulator import EmulatorSettings, spawn

    try:
        settings = EmulatorSettings(speed=speed)
        return spawn(settings if seed is None else replace(settings, seed=seed))
    except ValueError as error:
        raise CommandError("invalid_option", str(error), exit_code=USAGE) from None


def demo(words: argparse.Namespace) -> int:
    """Daemon on the emulator in a process of its own, and the screen here; quitting ends all three."""
    import subprocess

    from imumon.cli.query import tui

    with _temporary_directory() as scratch:
        endpoint = f"unixsock-stream/{scratch}/bus"
        # -P: a folder of our name in the current directory is not the package
        command = [
            sys.executable,
            "-P",
            "-m",
            "imumon",
            "run",
            "--port",
            "sim",
            "--speed",
            f"{words.speed:g}",
        ]
        command += ["--listen", endpoint, "--state", scratch, "--id", "demo"]
        command += [] if words.seed is None else ["--seed", str(words.seed)]
        with open(f"{scratch}/log", "w+") as log:
            daemon = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )

            def ended() -> str | None:
                if daemon.poll() is None:
                    return None
                with open(log.name) as said:
                    return (said.read().strip().splitlines() or ["it said nothing"])[-1]

            try:
                words.connect, words.id, words.baseline = [endpoint], "demo", None
                return tui(words, "The emulated sensor is starting.", ended)
            finally:
                daemon.terminate()
                try:
                    daemon.wait(5)
                except subprocess.TimeoutExpired:
                    daemon.kill()


def sim(words: argparse.Namespace) -> int:
    from imumon.devices.vn100 import emulator

    try:
        settings = emulator.from_arguments(words)
    except ValueError as error:
        raise CommandError("invalid_option", str(error), exit_code=USAGE) from None
    if settings.rate == 0:
        raise CommandError("invalid_option", "--rate 0 is no output rate", "give one, such as 40", USAGE)
    return emulator.run(settings)
