"""Commands that look after an installation: doctor, config, completion."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from imumon.cli.options import DONE, FAILED, Parser, add_endpoints, settings, state_directory

COLUMN = 13


def add_doctor(parser: Parser) -> None:
    parser.add_argument("--port", metavar="PORT", help="device path, URL, or sim; default: the one found")
    parser.add_argument("--config", metavar="FILE", help="settings; flags win over the file")
    parser.add_argument("--json", action="store_true", help="the checks as JSON")
    add_endpoints(parser)


def doctor(words: argparse.Namespace) -> int:
    """One line a check; failed when one has failed."""
    from contextlib import nullcontext
    from pathlib import Path

    from imumon.config import ConfigError, Settings, load
    from imumon.devices.registry import driver
    from imumon.doctor import Case, examine

    faults: tuple[str, ...] = ()
    made = Settings()
    try:
        made = load(words.config)
    except ConfigError as error:
        faults = tuple(map(str, error.faults))
    port = words.port or made.device.port or None
    emulator: Any = driver().emulator() if port == "sim" else nullcontext(port)
    with emulator as port:
        case = Case(
            settings=made,
            faults=faults,
            port=port,
            state_directory=Path(state_directory(made)),
            connect=tuple(words.connect or ()),
        )
        found = []
        for check in examine(case, _progress):
            _progress("")
            found.append(check)
            if not words.json:
                cure = f" -> {check.cure}" if check.cure else ""
                print(f"{check.status:<8}{check.name:<{COLUMN}}{check.text}{cure}", flush=True)
    if words.json:
        _print_json(found)
    return FAILED if any(check.status == "failed" for check in found) else DONE


def _progress(text: str) -> None:
    """What takes long, on a line of the terminal that is written over; nothing elsewhere."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


def _print_json(checks: list[Any]) -> None:
    import json
    from dataclasses import asdict
    from datetime import UTC, datetime

    from imumon.cli.encoding import print_json
    from imumon.report import stamp

    counts = {kind: sum(check.status == kind for check in checks) for kind in ("ok", "warning", "failed")}
    told = {"schema": "imumon.doctor/1", "time": stamp(datetime.now(UTC)), **counts}
    whole = told | {"checks": [asdict(check) for check in checks]}
    print_json(json.dumps(whole, ensure_ascii=False, indent=1))


def add_config(parser: Parser) -> None:
    parser.add_argument(
        "what",
        choices=("show", "check"),
        metavar="{show,check}",  # so it is named where it is missing
        help="show: every setting with its origin; check: all faults of the file",
    )
    parser.add_argument("--config", metavar="FILE", help="file to read instead of the first that is found")


def config(words: argparse.Namespace) -> int:
    """Show or check the settings."""
    made = settings(words)
    if words.what == "check":
        print(f"{made.path}: no faults" if made.path else "no file, the defaults hold")
        return DONE
    from imumon.config import render

    print(f"# {made.path or 'no file, the defaults hold'}\n{render(made, origins=True)}", end="")
    return DONE


def add_completion(parser: Parser) -> None:
    parser.add_argument(
        "shell",
        choices=("bash", "zsh", "fish"),
        metavar="{bash,zsh,fish}",
        help="the shell to print the script for",
    )


def completion(words: argparse.Namespace) -> int:
    """The script that lets a shell complete our command line."""
    from imumon.cli import parsers
    from imumon.cli.shells import script

    print(script(words.shell, parsers()[1]), end="")
    return DONE
