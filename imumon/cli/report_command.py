"""Command that writes documents made from a report: `imumon report`."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from imumon.cli.options import (
    DONE,
    USAGE,
    CommandError,
    Parser,
    add_endpoints,
    first_report,
    mention,
    viewer,
)
from imumon.cli.replay_command import FILES, add_reading, task_of

STATE_MAGIC = b"imumon-state "
DAEMON_TIMEOUT_S = 2.0
"""Longest wait for the answer of a daemon, s."""


def add_report(parser: Parser) -> None:
    """Add the arguments of the command."""
    from imumon.datasheet import FORMS

    forms = "; ".join(f"{name}: {what}" for name, (_, what) in FORMS.items())
    add = parser.add_argument
    add(
        "file",
        nargs="?",
        metavar="FILE",
        help=f"saved report or state, or a recording ({FILES}); default: ask a daemon",
    )
    add("--id", metavar="NAME", help="device of the daemon; default: the first that answers")
    add("--format", choices=FORMS, metavar="FORM", help=f"{forms}. Default: by the extension of OUT, else md")
    add("-o", "--output", metavar="OUT", help="file to write; default: stdout")
    add_reading(parser.add_argument_group("of a recording"))
    add("--config", metavar="FILE", help="settings file; options override it")
    add_endpoints(parser)


def report(arguments: argparse.Namespace) -> int:
    """Write a document of a running daemon, a recording, a state or a saved report."""
    from imumon.datasheet import NoCurve, document

    form = _format(arguments)
    if form == "png" and arguments.output is None and sys.stdout.isatty():
        raise CommandError("a PNG cannot be shown on a terminal: name a file with -o", USAGE)
    if arguments.file and arguments.id:
        raise CommandError("FILE and --id exclude each other: give one of them", USAGE)
    if arguments.output:
        _check_output(arguments.output, arguments.file, arguments.config)
    made = _report_of_file(arguments) if arguments.file else _report_of_daemon(arguments)
    try:
        data = document(made, form)
    except NoCurve as error:
        raise CommandError(str(error)) from None
    if arguments.output is None or arguments.output == "-":
        sys.stdout.buffer.write(data)
        return DONE
    try:
        Path(arguments.output).write_bytes(data)
    except OSError as error:
        raise CommandError(f"cannot write {arguments.output}: {_reason(error)}") from None
    return DONE


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()


def _format(arguments: argparse.Namespace) -> str:
    """Return the name of the format: the option, else the extension of the output, else Markdown."""
    from imumon.datasheet import FORMS

    if arguments.format:
        return str(arguments.format)
    suffix = Path(arguments.output).suffix[1:].lower() if arguments.output else ""
    form = {"": "md", "htm": "html", "markdown": "md"}.get(suffix, suffix)
    if form not in FORMS:
        known = " | ".join(FORMS)
        raise CommandError(f"-o {arguments.output}: unknown format {suffix}: give --format {known}", USAGE)
    return form


def _check_output(output: str, *inputs: str | None) -> None:
    """Refuse to overwrite a file that the document is made of, also through links."""
    if not os.path.isfile(output):
        return
    for path in filter(None, inputs):
        source = Path(path)
        parts = list(source.iterdir()) if source.is_dir() else [0 if path == "-" else source]
        for part in parts:
            with suppress(OSError):  # an unreadable input fails where it is read
                if os.path.samefile(output, part):
                    raise CommandError(f"-o {output} is an input of this command: name another file", USAGE)


def _report_of_daemon(arguments: argparse.Namespace) -> Any:
    with viewer(arguments) as subscriber:
        return first_report(subscriber, arguments.id, DAEMON_TIMEOUT_S, "give a FILE (imumon report --help)")


def _report_of_file(arguments: argparse.Namespace) -> Any:
    """Return the report of a file by its content, not by its name."""
    start = b""
    if arguments.file != "-":
        try:
            with open(arguments.file, "rb") as file:
                start = file.read(64)
        except IsADirectoryError:
            pass  # a bag of several files
        except OSError as error:
            raise CommandError(f"cannot read {arguments.file}: {_reason(error)}") from None
    if start.startswith(STATE_MAGIC):
        return _report_of_state(Path(arguments.file))
    if start.lstrip().startswith(b"{"):
        return _saved_report(Path(arguments.file))
    return _report_of_recording(arguments)


def _saved_report(path: Path) -> Any:
    from imumon.report import Report, from_json

    try:
        return from_json(Report, path.read_bytes())
    except ValueError as error:
        raise CommandError(f"{path} is not a saved report: {error}") from None


def _report_of_state(path: Path) -> Any:
    """Return the report of a saved state at the time when it was saved."""
    from datetime import datetime

    from imumon.checkpoint import StateError, decode
    from imumon.devices import registry
    from imumon.pipeline import Monitor, MonitorOptions
    from imumon.report import DeviceDescription, SessionCounters

    try:
        state = decode(path.read_bytes())
        meta = state.meta
        monitor = Monitor(MonitorOptions(guarded=bool(meta["monitor"]["guarded"])))
        monitor.resume(meta["monitor"], state.arrays, 0.0)
        monitor.take_up()
        known = {"serial": meta.get("serial")} | meta.get("device", {})
        caveats = tuple(known.pop("caveats", ()))
        id, settings = path.name.partition(".state")[0], meta.get("settings", {})
        driver = registry.driver_of_record(known.get("driver"), known.get("model"), id)
        texts = registry.setting_texts(driver, settings)
        device = DeviceDescription(**(known | {"id": id, "settings": settings, "setting_texts": texts}))
        session = SessionCounters(started=meta.get("started"), **meta["session"])
        if monitor.stream is not None and monitor.stream.kind == "compensated":
            caveats = tuple(dict.fromkeys((*caveats, "compensated")))
        saved = datetime.fromisoformat(meta["saved"])
        return monitor.report(saved, device, "stopped", session, device_caveats=caveats)
    except StateError as error:
        raise CommandError(f"the state {path} is {error}") from None
    except (KeyError, ValueError, TypeError, AttributeError, AssertionError):
        raise CommandError(f"the state {path} is of another version of imumon") from None


def _report_of_recording(arguments: argparse.Namespace) -> Any:
    from imumon.pipeline import RateRequired
    from imumon.recordings import OptionNotApplicable, SourceError
    from imumon.replay.replay import bar, replay

    try:
        return replay(task_of(arguments), progress=bar(), tell=mention)
    except (RateRequired, OptionNotApplicable) as error:
        raise CommandError(str(error), USAGE) from None
    except SourceError as error:
        raise CommandError(str(error)) from None
