"""Command `imumon explain`: what a word on the screen or in a document means."""

from __future__ import annotations

import argparse
import shutil
import textwrap

from imumon.cli.exit_codes import SUCCESS, USAGE, CommandError
from imumon.cli.options import Parser


def add_explain(parser: Parser) -> None:
    text = "a caveat, a status, a coefficient or another word, such as misfit, open, K, walk; without one: list them"
    parser.add_argument("word", nargs="*", metavar="WORD", help=text)


def explain(arguments: argparse.Namespace) -> int:
    """Print what a word means, and the page that has more; without a word, all of them."""
    from imumon import glossary

    word = " ".join(arguments.word)
    if not word:
        print(textwrap.fill(", ".join(entry.word for entry in glossary.explanations()), _width()))
        return SUCCESS
    if (entry := glossary.explain(word)) is None:
        import difflib

        words = [entry.word for entry in glossary.explanations()]
        close = difflib.get_close_matches(word.lower().replace(" ", "_"), words, 1, 0.6)
        cure = (
            f"did you mean {close[0]}?"
            if close
            else "imumon explain lists the words; codes are in docs/ERRORS.md"
        )
        raise CommandError("unknown_word", f"{word!r} is no word of the glossary", cure, USAGE)
    print(textwrap.fill(f"{entry.word}: {entry.text}", _width()))
    print(f"More: {entry.page}")
    return SUCCESS


def _width() -> int:
    return min(shutil.get_terminal_size().columns, 100)
