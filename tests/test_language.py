"""Plain language: words that must not appear in documents, help, messages, docstrings and comments."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from paths import ROOT

from imumon.cli import parsers

MODULES = sorted((ROOT / "imumon").rglob("*.py"))
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "config.toml",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "systemd").iterdir()),
]

PLAIN = {
    r"(is|was|are|be|been|being) told|told|tells?": "configured, set, given; reports, shows, prints",
    r"the room'?s( own)? clock|the sensor'?s own time": "host clock, sample clock",
    r"cut (out|away)": "excluded",
    r"kept from the record": "dropped samples",
    r"spoil|spoils|spoilt": "invalid row, corrupt file",
    r"strangers?|nobody('?s)?": "unknown device, unrelated bytes; no process",
    r"anew": "again, restart",
    r"shut in": "sandboxed",
    r"mend(s|ed)?": "fixed",
    r"and says so": "95 % upper bound",
    r"in vain|a vain|for ever|of its own accord|so many|let go|to the letter|it wants": "say it plainly",
    r"goes on|went on": "continues",
    r"whatever comes|what came|what (it|he) had to complain of|to be rid of": "say it plainly",
}
"""Pattern → what to write instead."""
PATTERN = re.compile("|".join(rf"\b({pattern})\b" for pattern in PLAIN), re.IGNORECASE)


def found(text: str) -> list[str]:
    """Return the words to avoid, with what precedes and follows them."""
    flat = " ".join(text.split())
    return [flat[max(0, match.start() - 30) : match.end() + 30] for match in PATTERN.finditer(flat)]


def prose(path: Path) -> Iterator[str]:
    """Yield string constants of several words and comments of a module."""
    source = path.read_text("utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string


def test_documents() -> None:
    assert not [f"{path.name}: {words}" for path in DOCUMENTS for words in found(path.read_text("utf-8"))]


def test_the_help() -> None:
    main, commands = parsers()
    for parser in (main, *commands.values()):
        assert not found(parser.format_help()), parser.prog


def test_texts_of_the_modules() -> None:
    assert not [
        f"{path.relative_to(ROOT)}: {words}"
        for path in MODULES
        for text in prose(path)
        for words in found(text)
    ]


def test_no_percentage_is_a_power_of_ten() -> None:
    """`share_text` and `measured` write percentages; a format with two digits would write 130 % as 1.3e+02 %."""
    power = re.compile(r"(\.\d[ge]|:[+]?e)\} ?%")
    texts = {path: path.read_text("utf-8") for path in MODULES}
    assert [path.name for path, text in texts.items() if power.search(text)] == ["units.py"]
