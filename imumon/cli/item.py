"""Identity of the measured item and of the measurement: ``--item FILE.toml`` and ``--item KEY=VALUE``.

What the user states is text for people. It has bounded length and no control characters; documents escape it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from imumon.cli.exit_codes import USAGE, CommandError
from imumon.errors import why
from imumon.evaluation import Item
from imumon.files import SMALL_BYTES
from imumon.report import MOST_CHARACTERS, Report
from imumon.report_json import plain
from imumon.system_errors import cure_of_reading

KEYS = tuple(field.name for field in fields(Item))


def with_item(report: Report, words: Sequence[str]) -> Report:
    """Return a report with what ``--item`` states; a later word takes precedence, and all over a saved report.

    Model and serial number also become those of the device, so that its data sheet is found.
    """
    if not words:
        return report
    stated: dict[str, str] = {}
    for word in words:
        stated |= _texts(word)
    device: dict[str, Any] = {key: text for key, text in stated.items() if key in ("model", "serial")}
    return replace(
        report, item=replace(report.item or Item(), **stated), device=replace(report.device, **device)
    )


def _texts(word: str) -> dict[str, str]:
    """Return what one word states, by key."""
    key, equals, text = word.partition("=")
    if equals and key.strip() in KEYS:
        return {key.strip(): _text(key.strip(), text)}
    if equals and not Path(word).is_file():
        raise _error(f"no key {plain(key)[:40]!r}", f"the keys are {', '.join(KEYS)}")
    given = _read(Path(word))
    unknown = [key for key in given if key not in KEYS]
    if unknown:
        raise _error(f"{word} has a key {plain(unknown[0])[:40]!r}", f"the keys are {', '.join(KEYS)}")
    return {key: _text(key, value) for key, value in given.items()}


def _read(path: Path) -> Mapping[str, Any]:
    cure = 'give KEY=VALUE, or a TOML file with a line like operator = "name"'
    try:
        with path.open("rb") as file:
            data = file.read(SMALL_BYTES + 1)
        if len(data) > SMALL_BYTES:
            raise _error(f"{path} has more than {SMALL_BYTES:,} bytes", cure)
        return tomllib.loads(data.decode())
    except OSError as error:
        raise _error(f"cannot read {path}: {why(error)}", cure_of_reading(error)) from None
    except ValueError as error:
        raise _error(f"{path} is no TOML file: {plain(str(error))}", cure) from None


def _text(key: str, value: Any) -> str:
    """Return a value as one line of text."""
    if not isinstance(value, str | int | float):
        raise _error(f"{key} is not a text", f'write {key} = "..."')
    text = str(value).strip()
    if plain(text) != text:
        raise _error(f"{key} has a line break or another control character", "write one line of plain text")
    if not text or len(text) > MOST_CHARACTERS:
        size = f"{len(text):,} characters" if text else "no text"
        raise _error(f"{key} has {size}", f"give it 1 to {MOST_CHARACTERS} characters")
    return text


def _error(message: str, cure: str) -> CommandError:
    return CommandError("item_invalid", f"--item: {message}", cure, USAGE)
