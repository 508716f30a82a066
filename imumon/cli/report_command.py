"""Command `imumon report`: documents from a report, a state, a recording or a running daemon."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from imumon.api.document_report import document_report
from imumon.cli import options
from imumon.cli.exit_codes import SUCCESS, USAGE, CommandError
from imumon.cli.history_command import published_days, stored_days, with_turn_on
from imumon.cli.options import Parser
from imumon.cli.output import print_message
from imumon.cli.replay_command import (
    FILES,
    add_datasheet,
    add_read_options,
    reference_sheet,
    replay_options,
    replayed,
)
from imumon.documents import FORMS, PAGES, document, short_record_text
from imumon.files import check_replaceable, replace_file
from imumon.model.filter_report import DEFAULT_HORIZON_S, FilterReport
from imumon.model.system_errors import not_read, not_written
from imumon.sources import registry

REPORT_CURE = "make one with imumon report --format json"

EXTENSIONS = {"": "md", "htm": "html", "markdown": "md", "yaml": "kalibr", "yml": "kalibr"}
"""Forms by the extension of the output, where it is not the name of the form."""


def add_report(parser: Parser) -> None:

    add = parser.add_argument
    text = f"saved report or state, or a recording ({FILES}); default: ask a daemon"
    add("file", nargs="?", metavar="FILE", type=options.file_name, help=text)
    options.add_id(parser, "device of the daemon; needed if several answer")
    add(
        "--format",
        choices=FORMS,
        metavar="FORM",
        help=f"{_forms_text()}. Default: by the name of OUT, else md",
    )
    horizon = (
        "longest time without a fix for which numbers for filters hold; default 600 s. A camera at 20 Hz "
    )
    horizon += "that may lose its track for 10 s needs 10s, a car in a tunnel 2m"
    add("--horizon", type=options.horizon, metavar="S", help=horizon)
    add("-o", "--output", metavar="OUT", help="file to write; default: standard output")
    add_datasheet(parser)
    add_read_options(parser.add_argument_group("of a recording"))


def _forms_text() -> str:
    """Return the forms of a document by what they are for."""

    groups: dict[str, list[str]] = {}
    for name, form in FORMS.items():
        kind = "datasheet" if name in PAGES else "figure" if form.binary else "data"
        groups.setdefault("settings of other programs" if form.settings else kind, []).append(name)
    return "; ".join(f"{group}: {', '.join(names)}" for group, names in groups.items())


def report(arguments: argparse.Namespace) -> int:
    """Write a document from a running daemon, a recording, a state or a saved report."""

    form = _form(arguments)
    _check_options(arguments, form)
    to_file = arguments.output not in (None, "-")
    if to_file:
        with writing_to(arguments.output):
            check_replaceable(arguments.output)
    sheet = reference_sheet(arguments)
    source, rows = _source(arguments)
    source = document_report(source, sheet, rows)
    filter_numbers = FORMS[form].settings
    if filter_numbers and (warning := short_record_text(source)) is not None:
        print_message(warning)
    filters = _filters(source, arguments.horizon, FORMS[form].filters)
    if FORMS[form].settings:
        topic = arguments.topic or source.device.topic
        filters = replace(filters, device=replace(filters.device, topic=topic))
    data = document(source, form, filters, options.settings(arguments).report.program)
    if to_file:
        with writing_to(arguments.output):
            replace_file(arguments.output, data)
    else:
        sys.stdout.buffer.write(data)
    return SUCCESS


@contextmanager
def writing_to(output: str) -> Iterator[None]:
    """Turn an error of writing the output into an error of the command."""
    try:
        yield
    except OSError as error:
        raise not_written(output, error, "name another file with -o") from None


def _check_options(arguments: argparse.Namespace, form: str) -> None:
    """Raise an error if an option does not fit the form or another option."""
    _check_fits_form(arguments, form)
    if arguments.file and arguments.id:
        raise CommandError("two_sources", "FILE and --id are both given", "give only one of them", USAGE)
    if arguments.output:
        _check_output_is_no_input(arguments.output, arguments.file, arguments.config)


def _check_fits_form(arguments: argparse.Namespace, form: str) -> None:
    """Raise an error if an option, or a terminal as the output, does not fit the form."""

    if FORMS[form].binary and arguments.output is None and sys.stdout.isatty():
        message = f"a {form} file cannot be shown in a terminal"
        raise CommandError("binary_to_terminal", message, "name a file with -o", USAGE)


def _source(arguments: argparse.Namespace) -> tuple[Any, Any]:
    """Return the report of the file or the daemon, and the days of its history."""

    if arguments.file:
        return _from_file(arguments), stored_days(Path(arguments.file))
    _check_recording(arguments, "a running daemon")
    with options.subscriber(arguments) as subscriber:
        cure = "give a FILE (imumon report --help)"
        source = options.first_report(subscriber, arguments.id, options.ANSWER_S, cure, arguments)
        source = replace(source, events=tuple(subscriber.events(source.device.id)))
        rows = published_days(subscriber, source.device.id)
    return source, rows


def _filters(report: Any, horizon_s: float | None, needed: bool) -> Any:
    """Return the parameters for filters of a report; without channels where the form does not use them."""

    if not needed:
        return FilterReport(time=report.time, device=report.device)
    from imumon.record.filter_report_builder import filter_report

    return filter_report(report, horizon_s or DEFAULT_HORIZON_S)


def _form(arguments: argparse.Namespace) -> str:
    """Return the form of the document: of ``--format``, else by the extension of the output."""

    if arguments.format:
        return str(arguments.format)
    suffix = Path(arguments.output).suffix[1:].lower() if arguments.output else ""
    form = EXTENSIONS.get(suffix, suffix)
    if form not in FORMS:
        message = f"-o {arguments.output}: no format is named {suffix}"
        raise CommandError("unknown_format", message, f"give --format {' | '.join(FORMS)}", USAGE)
    return form


def _check_output_is_no_input(output: str, *inputs: str | None) -> None:
    """Raise an error if the output would overwrite a file that is read, also through links."""
    for path in filter(None, inputs):
        source = Path(path)
        files = list(source.iterdir()) if source.is_dir() else [0 if path == "-" else source]
        for file in files if os.path.isfile(output) else ():
            with suppress(OSError):  # an unreadable file is reported where it is read
                if os.path.samefile(output, file):
                    message = f"-o {output} is also read"
                    raise CommandError("output_is_input", message, "name another file", USAGE)


def _from_file(arguments: argparse.Namespace) -> Any:
    """Return the report of a file; its contents decide, not its name."""
    head = b""
    if arguments.file != "-":
        try:
            with open(arguments.file, "rb") as file:
                head = file.read(256)
        except IsADirectoryError:
            pass  # a bag of several files
        except OSError as error:
            raise not_read(arguments.file, error) from None
    if head.lstrip().startswith(b"{"):
        _check_recording(arguments, "a saved report")
        return _from_report(Path(arguments.file))
    from imumon.checkpoint import is_state

    if is_state(head):
        _check_recording(arguments, "a saved state")
        return with_turn_on(_from_state(Path(arguments.file)), Path(arguments.file))
    from imumon.sources.files import OptionNotApplicable

    wanted = replay_options(arguments, arguments.file, convergence=_form(arguments) in PAGES)
    try:
        return replayed(wanted).report
    except OptionNotApplicable as error:
        named = error.code == "topic_not_applicable" and FORMS[_form(arguments)].settings
        if not named or arguments.file == "-":
            raise
    return replayed(
        replace(wanted, read=replace(wanted.read, topic=None))
    ).report  # it names the topic in the settings


def _check_recording(arguments: argparse.Namespace, source: str) -> None:
    """Raise an error if an option needs the samples, and the source has none."""
    if arguments.filter:
        message = f"--filter needs a recording, and this is {source}"
        raise CommandError("recording_required", message, "name a recording", USAGE)


def _from_report(path: Path) -> Any:
    try:
        return options.saved_report(path)
    except ValueError as error:
        raise CommandError("not_a_report", f"{path} is not a saved report: {error}", REPORT_CURE) from None


def _from_state(path: Path) -> Any:
    """Return the report of a saved state, as of the time when it was saved."""

    from imumon.checkpoint import SavedState, decode
    from imumon.record import Record, RecordOptions

    state = decode(path.read_bytes(), f"the state {path}")
    if not isinstance(state, SavedState):
        raise CommandError(
            "state_invalid", f"{path} is the state of an imumon.Live", "load it with imumon.Live.load"
        )
    header = state.header
    record = Record(RecordOptions(guarded=state.record.guarded))
    record.restore(state.record, 0.0)
    record.accept_restored()
    info = replace(header.device, settings=header.settings)
    device = registry.description(info, path.name.partition(".state")[0])
    caveats = info.caveats
    if record.stream is not None and record.stream.kind == "compensated":
        caveats = tuple(dict.fromkeys((*caveats, "compensated")))
    moment = datetime.fromisoformat(header.saved)
    return record.report(moment, device, "stopped", header.session, device_caveats=caveats)
