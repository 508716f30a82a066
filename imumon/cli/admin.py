"""Commands that check and configure an installation: doctor, config."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from imumon.cli import options
from imumon.cli.exit_codes import FAILURE, SUCCESS
from imumon.cli.options import Parser
from imumon.cli.output import print_json, print_status
from imumon.model.report import stamp
from imumon.model.report_json import plain
from imumon.sources.registry import driver


def add_doctor(parser: Parser) -> None:
    parser.add_argument(
        "--port", metavar="PORT", help="device path, URL, or sim; default: the only sensor found"
    )
    parser.add_argument("--json", action="store_true", help="print the checks as JSON")


def doctor(arguments: argparse.Namespace) -> int:
    """Run all checks and print one line each; fail if one has failed."""
    from imumon.config import ConfigError, Settings
    from imumon.doctor import NAMES, Case, examine

    faults: tuple[str, ...] = ()
    settings = Settings()
    try:
        settings = options.settings(arguments)
    except ConfigError as error:
        faults = tuple(map(str, error.faults))
    port = arguments.port or settings.device.port or None
    emulator: Any = driver().emulator() if port == "sim" else nullcontext(port)
    state, connect = options.state_directory(settings), tuple(arguments.connect or ())
    width = 1 + max(map(len, NAMES))
    with emulator as port:
        own_devices = () if faults else tuple(options.own_devices(arguments))
        case = Case(
            settings=settings,
            faults=faults,
            port=port,
            state_directory=state,
            connect=connect,
            own_devices=own_devices,
        )
        checks = []
        for check in examine(case, print_status):
            print_status("")
            checks.append(check)
            if not arguments.json:
                cure = f" -> {check.cure}" if check.cure else ""
                line = f"{check.status:<8}{check.name:<{width}}{check.text}{cure}"
                print(plain(line), flush=True)
    if arguments.json:
        _print_checks(checks)
    return FAILURE if any(check.status == "failed" for check in checks) else SUCCESS


def _print_checks(checks: Sequence[Any]) -> None:

    counts = {kind: sum(check.status == kind for check in checks) for kind in ("ok", "warning", "failed")}
    summary = {"schema": "imumon.doctor/1", "time": stamp(datetime.now(UTC)), **counts}
    document = summary | {"checks": [asdict(check) for check in checks]}
    print_json(json.dumps(document, ensure_ascii=False, indent=1))


def add_config(parser: Parser) -> None:
    text = "show: every setting with its origin; check: all faults of the file"
    # the metavar makes the error name the choices if the action is missing
    parser.add_argument("action", choices=("show", "check"), metavar="{show,check}", help=text)


def config(arguments: argparse.Namespace) -> int:
    """Show or check the settings."""
    settings = options.settings(arguments)

    path = plain(str(settings.path)) if settings.path else ""
    if arguments.action == "check":
        print(f"{path}: no faults" if path else "no file, the defaults apply")
        return SUCCESS
    from imumon.config import origin_lines

    print(f"# {path or 'no file, the defaults apply'}", *origin_lines(settings), sep="\n")
    return SUCCESS
