"""Commands that read a sensor, real or emulated: run, demo, sim."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any

from imumon.cli.options import (
    DONE,
    INTERRUPTED,
    NOT_IN_TIME,
    NOTHING_THERE,
    USAGE,
    CommandError,
    Parser,
    add_endpoints,
    add_look,
    baseline,
    bus_stop,
    positive,
    print_report,
    state_directory,
)
from imumon.cli.options import (
    settings as load_settings,
)


def add_run(parser: Parser) -> None:
    from imumon.devices.registry import driver

    add = parser.add_argument
    add("--port", metavar="PORT", help="device path, pyserial URL, sim, or NAME:... of another device")
    driver().add_run_options(parser)
    add("--id", metavar="NAME", help="name in the keys; default vn100-<serial number>")
    add(
        "--state",
        metavar="DIR",
        help="directory of the accumulated statistics; --port sim keeps nothing without it",
    )
    add("--fresh", action="store_true", help="start a new record; the old state is kept under another name")
    add("--record", metavar="FILE", help="also save the raw bytes, for replay")
    add("--config", metavar="FILE", help="settings file; options override it")
    add("--duration", type=positive, metavar="S", help="stop after S seconds and print the final report")
    add("--json", action="store_true", help="print the final report as JSON")
    add("--no-guards", action="store_true", default=None, help="exclude nothing")
    add("--baseline", metavar="FILE", help="an earlier report of this sensor (JSON): report what changed")
    add("--speed", type=positive, default=1.0, metavar="X", help="time-lapse, with --port sim only")
    add("--seed", type=int, metavar="N", help="noise of the emulator, with --port sim only")
    add_endpoints(parser, listen=True)


def add_demo(parser: Parser) -> None:
    parser.add_argument("--speed", type=positive, default=60.0, metavar="X", help="time-lapse; default 60")
    parser.add_argument("--seed", type=int, metavar="N", help="noise of the emulator")
    add_look(parser)


def add_sim(parser: Parser) -> None:
    from imumon.devices.registry import driver

    driver().add_emulator_options(parser)


def run(arguments: argparse.Namespace) -> int:
    settings = _settings(arguments)
    if settings.device.port == "sim":
        return _run_emulated(arguments, settings)
    if arguments.speed != 1.0 or arguments.seed is not None:
        raise CommandError("--speed and --seed are for --port sim", USAGE)
    return _run_daemon(arguments, settings, settings.device.port, state_directory(settings))


def _run_emulated(arguments: argparse.Namespace, settings: Any) -> int:
    """Run on an emulator, with a temporary state unless a directory is given."""
    from pathlib import Path

    with _emulator(arguments.speed, arguments.seed) as path, _scratch() as scratch:
        directory = Path(settings.state.directory or scratch)
        return _run_daemon(arguments, settings, path, directory)


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


def _settings(arguments: argparse.Namespace) -> Any:
    """Return the settings with the options of `run` on top."""
    from imumon.devices.registry import driver

    return load_settings(
        arguments,
        {
            "device.port": arguments.port,
            **driver().run_overrides(arguments),
            "device.id": arguments.id,
            "zenoh.listen": arguments.listen,
            "zenoh.connect": arguments.connect,
            "state.directory": arguments.state,
            "record.file": arguments.record,
            "guards.enabled": False if arguments.no_guards else None,
        },
    )


def _run_daemon(arguments: argparse.Namespace, settings: Any, url: str, directory: Any) -> int:
    import signal

    from imumon.bus import BusError
    from imumon.checkpoint import StateError
    from imumon.daemon import Daemon, RunOptions
    from imumon.daemon.log import configure_logging
    from imumon.devices.base import DeviceError, DeviceNotFound
    from imumon.errors import RateRequired
    from imumon.pipeline import RateRequired as PipelineRateRequired
    from imumon.recordings import SourceError

    options = RunOptions(
        url=url,
        state_directory=directory,
        duration_s=arguments.duration,
        fresh=arguments.fresh,
        speed=arguments.speed,
        baseline=baseline(arguments.baseline),
    )
    configure_logging(settings.log)
    try:
        result = Daemon(settings, options).run()
    except (RateRequired, PipelineRateRequired) as error:
        raise CommandError(f"{error}; imumon doctor counts it", USAGE) from None
    except DeviceNotFound as error:
        raise CommandError(str(error), NOTHING_THERE) from None
    except DeviceError as error:
        raise CommandError(str(error)) from None
    except SourceError as error:
        raise CommandError(str(error)) from None
    except BusError as error:
        raise bus_stop(error, settings) from None
    except StateError as error:
        raise CommandError(str(error)) from None
    if result.report is None and result.signal is None:
        raise CommandError(
            f"no sensor within {arguments.duration:g} s: give it a longer --duration", NOT_IN_TIME
        )
    if result.report is not None and (arguments.duration or arguments.json):
        print_report(result.report, arguments.json, options.baseline)
    return INTERRUPTED if result.signal == signal.SIGINT else DONE


def _emulator(speed: float, seed: int | None) -> Any:
    """Return a running emulator as a context that gives its port."""
    from imumon.devices.base import InvalidOption
    from imumon.devices.registry import driver

    try:
        return driver().emulator(speed=speed, seed=seed)
    except InvalidOption as error:
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
    """Run the emulator alone."""
    from imumon.devices.base import InvalidOption
    from imumon.devices.registry import driver

    try:
        return driver().run_emulator(words)
    except InvalidOption as error:
        raise CommandError(str(error), USAGE) from None
