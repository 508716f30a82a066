"""Command that makes documents of a report: report."""

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
from imumon.cli.replay_command import FILES, add_read_options, reading, replay_options

STATE_MARK = b"imumon-state "


def add_report(parser: Parser) -> None:
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
    add("--format", choices=FORMS, metavar="FORM", help=f"{forms}. Default: by the name of OUT, else md")
    add("-o", "--output", metavar="OUT", help="file to write; default: stdout")
    add_read_options(parser.add_argument_group("of a recording"))
    add("--config", metavar="FILE", help="settings; flags win over the file")
    add_endpoints(parser)


def report(words: argparse.Namespace) -> int:
    """A document of a running daemon, a recording, a state or a saved report."""
    from imumon.datasheet import CannotDraw, document

    form = _form(words)
    if form == "png" and words.output is None and sys.stdout.isatty():
        raise CommandError("a PNG is not for a terminal: name a file with -o", USAGE)
    if words.file and words.id:
        raise CommandError("give a FILE or the --id of a daemon's device, not both", USAGE)
    if words.output:
        _refuse_what_is_read(words.output, words.file, words.config)
    made = _of_file(words) if words.file else _of_daemon(words)
    try:
        data = document(made, form)
    except CannotDraw as error:
        raise CommandError(str(error)) from None
    if words.output is None or words.output == "-":
        sys.stdout.buffer.write(data)
        return DONE
    try:
        Path(words.output).write_bytes(data)
    except OSError as error:
        raise CommandError(f"cannot write {words.output}: {(error.strerror or str(error)).lower()}") from None
    return DONE


def _form(words: argparse.Namespace) -> str:
    from imumon.datasheet import FORMS

    if words.format:
        return str(words.format)
    suffix = Path(words.output).suffix[1:].lower() if words.output else ""
    form = {"": "md", "htm": "html", "markdown": "md"}.get(suffix, suffix)
    if form not in FORMS:
        raise CommandError(
            f"-o {words.output}: no form is called {suffix}; give --format {' | '.join(FORMS)}", USAGE
        )
    return form


def _refuse_what_is_read(out: str, *read: str | None) -> None:
    """Stop where a document would take the place of what it is made of; links lead to the same file."""
    for path in filter(None, read):
        there = Path(path)
        parts = list(there.iterdir()) if there.is_dir() else [0 if path == "-" else there]
        for part in parts if os.path.isfile(out) else ():
            with suppress(OSError):  # what cannot be read is told where it is read
                if os.path.samefile(out, part):
                    raise CommandError(f"-o {out} is read to make it: name another file", USAGE)


def _of_daemon(words: argparse.Namespace) -> Any:
    with viewer(words) as feed:
        return first_report(feed, words.id, 2.0, "give a FILE (imumon report --help)")


def _of_file(words: argparse.Namespace) -> Any:
    """By what the file holds, not by its name."""
    head = b""
    if words.file != "-":
        try:
            with open(words.file, "rb") as file:
                head = file.read(64)
        except IsADirectoryError:
            pass  # a bag of two or more files
        except OSError as error:
            raise CommandError(
                f"cannot read {words.file}: {(error.strerror or str(error)).lower()}"
            ) from None
    if head.startswith(STATE_MARK):
        return _of_state(Path(words.file))
    if head.lstrip().startswith(b"{"):
        return _of_report(Path(words.file))
    return _of_recording(words)


def _of_report(path: Path) -> Any:
    from imumon.report import Report, from_json

    try:
        return from_json(Report, path.read_bytes())
    except ValueError as error:
        raise CommandError(f"{path} is no saved report: {error}") from None


def _of_state(path: Path) -> Any:
    """Report of a saved state, as it was when it was saved."""
    from datetime import datetime

    from imumon.checkpoint import StateError, decode
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
        name = path.name.partition(".state")[0]
        device = DeviceDescription(**(known | {"id": name, "settings": meta.get("settings", {})}))
        session = SessionCounters(started=meta.get("started"), **meta["session"])
        if monitor.stream is not None and monitor.stream.kind == "compensated":
            caveats = tuple(dict.fromkeys((*caveats, "compensated")))
        saved = datetime.fromisoformat(meta["saved"])
        return monitor.report(saved, device, "stopped", session, device_caveats=caveats)
    except StateError as error:
        raise CommandError(f"the state {path} is {error}") from None
    except (KeyError, ValueError, TypeError, AttributeError, AssertionError):
        raise CommandError(f"the state {path} is of another version of imumon") from None


def _of_recording(words: argparse.Namespace) -> Any:
    from imumon.replay import progress_bar, replay

    with reading():
        return replay(replay_options(words), progress=progress_bar(), remark=mention)
