"""Commands that read a device, real or emulated: run, demo, sim."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from imumon.cli import options
from imumon.cli.exit_codes import INTERRUPTED, NOT_FOUND, NOT_REACHED, SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.cli.output import print_report
from imumon.cli.query import require_terminal, tui
from imumon.model.units import duration
from imumon.sources.clock import HostClock
from imumon.sources.registry import driver, driver_of

STACK_BYTES = 2 << 20
"""Stack of each thread of the daemon. The 8 MB of Linux count as data of the process, used or not: with twenty threads
they are most of what a service may have."""

if TYPE_CHECKING:
    from imumon.daemon import RunResult


def add_run(parser: Parser) -> None:
    add = parser.add_argument
    text = "device path, pyserial URL, sim, or NAME:... of another kind of device; default: the only sensor found"
    add("--port", metavar="PORT", help=text)
    text = "baud rate; default auto: detect it and do not change it"
    add("--baud", type=_baud, metavar="auto|N", help=text)
    text = "change the baud rate of the sensor to N until its power-off"
    add("--set-baud", type=int, metavar="N", help=text)
    add("--rate", type=options.rate, metavar="HZ", help="sample rate of samples without time stamps")
    text = "write nothing to the sensor; a stream without a clock then needs --rate"
    add("--listen-only", action="store_true", default=None, help=text)
    text = "stream to request from the sensor; default deltas"
    add("--stream", choices=options.STREAMS, help=text)
    add(
        "--id",
        metavar="NAME",
        help="name in the Zenoh keys; default: kind and serial number of the sensor, or its topic or port",
    )
    text = "directory of the accumulated statistics; --port sim keeps nothing without it"
    add("--state", metavar="DIR", help=text)
    add("--fresh", action="store_true", help="start a new record; the old state is kept under another name")
    add("--record", metavar="FILE", help="also save the raw bytes, for replay")
    text = "stop after T (90, 90s, 10m, 2h, 7d) and print the final report"
    add("--duration", type=options.seconds, metavar="T", help=text)
    add("--json", action="store_true", help="print the final report as JSON")
    add("--verbose", action="store_true", help="print the final report as the whole datasheet")
    add("--no-guards", action="store_true", default=None, help="exclude no sample")
    add("--speed", type=options.speed, default=1.0, metavar="X", help="run the emulator X times faster")
    add("--seed", type=int, metavar="N", help="seed of the random noise of the emulator")
    add(options.STOP_WITH_STDIN, action="store_true", help=argparse.SUPPRESS)
    text = "publish reports on /diagnostics of ROS 2"
    add("--publish-diagnostics", action="store_true", default=None, help=text)
    options.add_listen(parser)


def add_demo(parser: Parser) -> None:
    parser.add_argument(
        "--speed",
        type=options.speed,
        default=60.0,
        metavar="X",
        help="run the emulator X times faster; default 60",
    )


def add_sim(parser: Parser) -> None:

    driver().add_emulator_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the daemon."""
    settings = _settings(arguments)
    if settings.device.port == "sim":
        return _run_emulated(arguments, settings)
    _check_settings(settings)
    if arguments.speed != 1.0 or arguments.seed is not None:
        message = "--speed and --seed are for --port sim"
        raise CommandError("option_needs_sim", message, "add --port sim, or leave them out", USAGE)
    return _run_daemon(arguments, settings, settings.device.port, options.state_directory(settings))


def _stop_with_stdin() -> None:
    """Stop this process when standard input ends: the program that started it has ended, however that was."""
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _baud(text: str) -> str | int:
    if text == "auto":
        return text
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is neither auto nor a number")
    return int(text)


def _check_settings(settings: Any) -> None:
    """Refuse settings and options that the device would ignore, such as --listen-only."""

    device, default = settings.device, type(settings.device)()
    used = driver_of(device.port).settings | {"port", "id"}
    for name in vars(device):
        origin = settings.origins.get(f"device.{name}", "default")
        changed = origin == "command line" or getattr(device, name) != getattr(default, name)
        if name in used or not changed:
            continue
        option = "--" + name.removesuffix("_hz").replace("_", "-")
        given = option if origin == "command line" else f"{name} in {origin}"
        message = f"{device.port or 'the sensor'} cannot use {given}"
        cure = "leave it out, or put parameters into the URL of the port"
        raise CommandError("option_not_for_device", message, cure, USAGE)


def _run_emulated(arguments: argparse.Namespace, settings: Any) -> int:
    """Run on an emulator, with a temporary state unless a directory is given.

    The directory of `demo` is deleted here, because this process outlives a terminal that is closed.
    """

    given = settings.state.directory
    with _temporary(given if arguments.stop_with_stdin else None) as temporary:
        if arguments.stop_with_stdin:
            threading.Thread(target=_stop_with_stdin, daemon=True).start()
        with driver().emulator(clock=HostClock(arguments.speed), seed=arguments.seed) as port:
            return _run_daemon(arguments, settings, port, Path(given or temporary), temporary=not given)


class _Terminated(BaseException):
    """A signal that ends the process."""


@contextmanager
def _temporary(directory: str | None = None) -> Iterator[str]:
    """Give a directory, by default a new one, and delete it at the end, also that by a signal."""
    received: list[int] = []
    interruptible = False

    def terminate(number: int, frame: FrameType | None) -> None:
        nonlocal interruptible
        received.append(number)
        if interruptible:  # not while the directory is made or deleted, and once: a terminal may send two
            interruptible = False
            raise _Terminated

    ending = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) == signal.SIG_DFL]
    before = {number: signal.signal(number, terminate) for number in ending}
    directory = directory or tempfile.mkdtemp(prefix=options.TEMPORARY)
    try:
        interruptible = True
        if not received:
            yield directory
    except _Terminated:
        pass
    finally:
        interruptible = False
        shutil.rmtree(directory, ignore_errors=True)
        for number, handler in before.items():
            signal.signal(number, handler)
    if received:
        os.kill(os.getpid(), received[0])


def _settings(arguments: argparse.Namespace) -> Any:
    """Return the settings with the options of `run` on top."""
    overrides = {
        "device.baud": arguments.baud,
        "device.set_baud": arguments.set_baud,
        "device.rate_hz": arguments.rate,
        "device.listen_only": arguments.listen_only,
        "device.stream": arguments.stream,
        "device.port": arguments.port,
        "device.id": arguments.id,
        "zenoh.listen": arguments.listen,
        "zenoh.connect": arguments.connect,
        "state.directory": arguments.state,
        "record.file": arguments.record,
        "guards.enabled": False if arguments.no_guards else None,
        "ros2.diagnostics": arguments.publish_diagnostics,
    }
    return options.settings(arguments, overrides)


def _run_daemon(
    arguments: argparse.Namespace, settings: Any, url: str, directory: Path, *, temporary: bool = False
) -> int:
    from imumon.bus import BusError
    from imumon.daemon import Daemon, RunOptions
    from imumon.daemon.log import configure_logging

    run_options = RunOptions(
        url=url,
        state_directory=directory,
        duration_s=arguments.duration,
        fresh=arguments.fresh,
        temporary=temporary,
        clock=HostClock(arguments.speed),
        baseline=options.baseline(settings.report.baseline or None),
    )
    close_log = configure_logging(settings.log.level, settings.log.format)
    try:
        threading.stack_size(STACK_BYTES)
        result = Daemon(settings, run_options).run()
    except BusError as error:
        raise options.with_origin(error, settings) from None
    finally:
        close_log()
    _check_found(result, url, arguments)
    interrupted = result.signal == signal.SIGINT  # by a person, who wants to see what was measured
    if result.report is not None and (arguments.duration or arguments.json or result.ended or interrupted):
        print_report(result.report, arguments.json, run_options.baseline, verbose=arguments.verbose)
    _check_complete(result, arguments)
    return INTERRUPTED if result.signal == signal.SIGINT else SUCCESS


def _check_found(result: RunResult, url: str, arguments: argparse.Namespace) -> None:
    """Raise an error if the run ended without anything to report: a stream without a sample, or no sensor."""
    if result.ended and not _sampled(result):
        cure = "check that the program that writes it prints samples"
        text = f"{url} ended without a sample{_causes(result)}"
        raise CommandError("stream_without_samples", text, cure, NOT_FOUND)
    if result.report is None and result.signal is None:
        message = f"no sensor within {duration(arguments.duration)}"
        raise CommandError("no_device_in_time", message, "give a longer --duration", NOT_REACHED)


def _check_complete(result: RunResult, arguments: argparse.Namespace) -> None:
    """Raise an error if the run had no sample in its time, or its state or its recording is not complete."""
    if not _sampled(result) and result.signal is None and arguments.duration is not None:
        text = f"no sample within {duration(arguments.duration)}{_causes(result)}"
        cure = "check the sensor with imumon doctor, or give a longer --duration"
        raise CommandError("no_samples_in_time", text, cure, NOT_REACHED)
    if result.unsaved is not None:
        raise CommandError("state_not_saved", "the state is not saved", result.unsaved)
    if result.unrecorded is not None:
        raise CommandError("recording_stopped", result.unrecorded, "what is in the file can be replayed")


def _sampled(result: RunResult) -> bool:
    return result.report is not None and result.report.session.samples > 0


def _causes(result: RunResult) -> str:
    """Return what the device says of what it received, behind a colon: why there is no sample, and how to get one."""
    causes = "; ".join(result.report.device.remarks if result.report is not None else ())
    return f": {causes}" if causes else ""


def demo(arguments: argparse.Namespace) -> int:
    """Run emulator and daemon in another process and the terminal UI here; quitting ends all three."""

    require_terminal("imumon run --port sim --duration 60")
    with _temporary() as directory, _demo_daemon(arguments, directory) as (endpoint, last_line):
        arguments.connect, arguments.id, arguments.baseline = [endpoint], "demo", None
        return tui(arguments, "The emulated sensor is starting.", last_line)


@contextmanager
def _demo_daemon(arguments: argparse.Namespace, directory: str) -> Iterator[tuple[str, Any]]:
    """Run the daemon of `demo`; give its endpoint, and what returns its last line once it has ended."""
    endpoint = f"unixsock-stream/{directory}/bus"
    # -P: a directory named imumon in the current directory is not the package
    command = [sys.executable, "-P", "-m", "imumon", "run", "--port", "sim"]
    command += ["--speed", f"{arguments.speed:g}", "--listen", endpoint, "--state", directory, "--id", "demo"]
    command += [options.STOP_WITH_STDIN]
    with tempfile.TemporaryFile("w+") as log:
        daemon = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True
        )

        def last_line() -> str | None:
            if daemon.poll() is None:
                return None
            log.seek(0)
            lines = log.read().strip().splitlines()
            return lines[-1] if lines else "it printed nothing"

        try:
            yield endpoint, last_line
        finally:
            daemon.terminate()
            try:
                daemon.wait(5)
            except subprocess.TimeoutExpired:
                daemon.kill()


def sim(arguments: argparse.Namespace) -> int:
    """Run the emulator alone."""

    return driver().run_emulator(arguments)
