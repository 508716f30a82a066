"""Commands that read a sensor, real or emulated: run, demo, sim."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

from imumon.cli.options import (
    DONE,
    FAILED,
    INTERRUPTED,
    NOT_IN_TIME,
    NOTHING_THERE,
    USAGE,
    CommandError,
    Parser,
    add_endpoints,
    add_look,
    baseline,
    baud,
    bus_stop,
    positive,
    print_report,
    rate,
    settings_apart,
    state_directory,
)


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
    add_look(parser)


def add_sim(parser: Parser) -> None:
    from imumon.devices.vn100.emulator import add_arguments

    add_arguments(parser)


def run(words: argparse.Namespace) -> int:
    made = _settings(words)
    if made.device.port == "sim":
        return _run_emulated(words, made)
    if words.speed != 1.0 or words.seed is not None:
        raise CommandError("--speed and --seed are for --port sim", USAGE)
    return _daemon(words, made, made.device.port or None, state_directory(made))


def _run_emulated(words: argparse.Namespace, made: Any) -> int:
    """`run --port sim`: an emulator of its own, and a state that is thrown away unless one is asked for."""
    from pathlib import Path

    with _emulator(words.speed, words.seed) as sensor, _scratch() as scratch:
        directory = Path(made.state.directory or scratch)
        return _daemon(words, made, sensor.path, directory)


def _scratch() -> Any:
    """A folder that goes with us, a context; those of runs that were killed go now."""
    import re
    import shutil
    import tempfile
    from pathlib import Path

    for left in Path(tempfile.gettempdir()).glob("imumon-[0-9]*-*"):
        owner = re.match(r"imumon-(\d+)-", left.name)
        if owner and not _lives(int(owner[1])):
            shutil.rmtree(left, ignore_errors=True)
    return tempfile.TemporaryDirectory(prefix=f"imumon-{os.getpid()}-", ignore_cleanup_errors=True)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)  # a signal that is none
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass  # it is another user's
    return True


def _settings(words: argparse.Namespace) -> Any:
    """Settings with the flags of `run` on top."""
    speed = words.baud
    return settings_apart(
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
    from imumon.checkpoint import StateError
    from imumon.daemon import Daemon, RunOptions
    from imumon.daemon.connection import NoDevice
    from imumon.devices.vn100.vn100_session import SessionError
    from imumon.errors import RateRequired
    from imumon.recordings import PortError, SourceError

    task = RunOptions(
        path=path,
        state_directory=directory,
        duration_s=words.duration,
        fresh=words.fresh,
        speed=words.speed,
        baseline=baseline(words.baseline),
    )
    try:
        outcome = Daemon(settings, task).run()
    except RateRequired as error:
        raise CommandError(f"{error}; imumon doctor counts it", USAGE) from None
    except (NoDevice, SessionError) as error:
        raise CommandError(str(error), NOTHING_THERE) from None
    except PortError as error:
        there = path is None or os.path.exists(path)
        raise CommandError(str(error), FAILED if there else NOTHING_THERE) from None
    except SourceError as error:
        raise CommandError(str(error)) from None
    except BusError as error:
        raise bus_stop(error, settings) from None
    except StateError as error:
        raise CommandError(str(error)) from None
    if outcome.report is None and outcome.signal is None:
        raise CommandError(f"no sensor within {words.duration:g} s: give it a longer --duration", NOT_IN_TIME)
    if outcome.report is not None and (words.duration or words.json):
        print_report(outcome.report, words.json, task.baseline)
    return INTERRUPTED if outcome.signal == signal.SIGINT else DONE


def _emulator(speed: float, seed: int | None) -> Any:
    """Emulator in a process of its own, a context that gives it."""
    from dataclasses import replace

    from imumon.devices.vn100.emulator import EmulatorSettings, spawn

    try:
        settings = EmulatorSettings(speed=speed)
        return spawn(settings if seed is None else replace(settings, seed=seed))
    except ValueError as error:
        raise CommandError(str(error), USAGE) from None


def demo(words: argparse.Namespace) -> int:
    """Daemon on the emulator in a process of its own, and the screen here; quitting ends all three."""
    import subprocess

    from imumon.cli.query import show

    with _scratch() as scratch:
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
                return show(words, "The emulated sensor is starting.", ended)
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
        raise CommandError(str(error), USAGE) from None
    if settings.rate == 0:
        raise CommandError("--rate 0: a sensor that sends nothing; give a rate, such as 40", USAGE)
    return emulator.run(settings)
