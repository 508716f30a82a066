"""Command `imumon explain`: what a word on the screen or in a document means, and what the code of an error means.

The codes are in one table, docs/ERRORS.md. A built package has a copy of it; a checkout has the table itself.
"""

from __future__ import annotations

import argparse
import difflib
import re
import shutil
import textwrap
from collections.abc import Iterator
from pathlib import Path

from imumon.cli.exit_codes import SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser
from imumon.model import glossary


def add_explain(parser: Parser) -> None:
    text = "a caveat, a status, a coefficient, the code of an error or another word, such as misfit, open, K, walk, "
    text += "port_busy; without one: list the words"
    parser.add_argument("word", nargs="*", metavar="WORD", help=text)


def explain(arguments: argparse.Namespace) -> int:
    """Print what a word means, and the page that has more; without a word, all of them."""

    word = " ".join(arguments.word)
    if not word:
        print(textwrap.fill(", ".join(glossary.names()), _width(), break_on_hyphens=False))
        return SUCCESS
    entry = glossary.explain(word)
    errors = [] if entry is not None else [row for row in errors_listed() if word.strip().lower() in row[0]]
    for codes, cause, cure in errors:
        print(textwrap.fill(f"{', '.join(codes)}: {cause}. What to do: {cure}.", _width()))
    if errors:
        print("More: docs/ERRORS.md")
        return SUCCESS
    if entry is None:
        words = glossary.names() + [code for codes, _, _ in errors_listed() for code in codes]
        close = difflib.get_close_matches(word.lower().replace(" ", "_"), words, 1, 0.6)
        cure = f"did you mean {close[0]}?" if close else "imumon explain lists the words"
        raise CommandError("unknown_word", f"{word!r} is no word of the glossary", cure, USAGE)
    if word in glossary.OTHER_NAMES:  # the screen has this one
        entry = entry._replace(word=f"{word} ({entry.word})")
    print(textwrap.fill(entry.sentence, _width()))
    print(f"More: {entry.page}")
    return SUCCESS


def errors_listed() -> Iterator[tuple[tuple[str, ...], str, str]]:
    """Yield the codes of each row of the table of errors, the cause and what to do."""
    package = Path(__file__).parents[1]
    for path in (package / "ERRORS.md", package.parent / "docs" / "ERRORS.md"):
        if path.is_file():
            lines = path.read_text("utf-8").splitlines()
            break
    else:
        return
    for line in lines:
        if line.startswith("| `") and len(cells := re.split(r"(?<!\\)\|", line)[1:-1]) == 3:
            cause, cure = (_plain(cell) for cell in cells[1:])
            yield tuple(re.findall(r"`(\w+)`", cells[0])), cause, cure


def _plain(cell: str) -> str:
    """Return a cell of a table as text of a terminal: without the marks of code, and links by their names."""
    return re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", cell).replace("`", "").replace("\\|", "|").strip()


def _width() -> int:
    return min(shutil.get_terminal_size().columns, 100)
