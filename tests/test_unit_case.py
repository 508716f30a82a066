"""Units keep their case wherever they are written: M/s^2 is another unit than m/s^2."""

from __future__ import annotations

import re
from collections.abc import Iterator

from documents import aged, bare, text
from paths import ROOT

from imumon.cli import parsers
from imumon.model.coefficients import COEFFICIENTS
from imumon.model.samples import UNITS
from imumon.model.units import pretty


def units() -> Iterator[str]:
    """Yield every unit of a channel, a coefficient and a slope that has a sign in it, as in JSON and as on a screen."""
    spelled = {
        unit for row in COEFFICIENTS.values() for both in row.units.values() for unit in (both.si, both.unit)
    }
    spelled |= {f"{unit}{per}" for unit in UNITS.values() for per in ("", "/s", "/degC")}
    spelled |= {pretty(unit) for unit in spelled}
    yield from (unit for unit in spelled if re.search(r"[/^*²·√]", unit) and unit[0].isascii())


def wrong_spellings() -> set[str]:
    """Return what capitalising, lowering or raising a unit gives, unless it is a unit itself."""
    known = set(units())
    forms = {
        form
        for unit in known
        for form in (f"{unit[0].upper()}{unit[1:]}", unit.upper(), unit.lower(), unit.title())
    }
    return forms - known


SPELLINGS = sorted(wrong_spellings())
FIRST = re.escape("".join(sorted({unit[0] for unit in SPELLINGS})))
# the first letters before the spellings: most places of a text need no look at hundreds of them
WRONG = re.compile(rf"(?<![\w/])(?=[{FIRST}])(?:{'|'.join(map(re.escape, SPELLINGS))})(?!\w)")


def wrong(content: str) -> list[str]:
    return [content[max(0, hit.start() - 30) : hit.end() + 10] for hit in WRONG.finditer(content)]


def test_the_pattern_matches() -> None:
    assert len(wrong("M/s^2, Rad/s and rad/s/sqrt(hz)")) == 3
    assert not wrong("m/s^2, rad/s and rad/s/sqrt(Hz); HTTP/s of pads/second")


def test_modules_and_documents() -> None:
    paths = [*(ROOT / "imumon").rglob("*.py"), *(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    assert not [f"{path.name}: {hit}" for path in paths for hit in wrong(path.read_text("utf-8"))]


def test_the_help() -> None:
    main, commands = parsers()
    assert not [hit for parser in (main, *commands.values()) for hit in wrong(parser.format_help())]


def test_what_a_report_prints() -> None:
    report = bare(aged("minutes"))
    for form in ("md", "csv", "json", "filter", "ros", "kalibr"):
        assert not wrong(text(report, form)), form
