"""Elements of a datasheet, and their form in Markdown.

The Markdown form has tables and text only, so that it also reads well as plain text.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Heading:
    text: str
    new_page: bool = False  # whether a printed page begins with it


@dataclass(frozen=True, slots=True)
class Paragraph:
    text: str


@dataclass(frozen=True, slots=True)
class Caution:
    """A caveat, shown before the numbers."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class GradeSummary:
    """Grade of one sensor with its explanation."""

    sensor: str
    grade: str
    text: str


@dataclass(frozen=True, slots=True)
class DataTable:
    """Rows of cells; the first column names the row. Without heads it is a list of facts."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    even: bool = False  # whether its columns are as wide as those of other such tables


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure where the form has figures, else its numbers."""

    caption: str
    numbers: DataTable | None
    svg: Callable[[], str]  # the element of an HTML page; empty: there is nothing to draw
    legend: str = ""  # what the marks mean, for a figure


@dataclass(frozen=True, slots=True)
class Listing:
    language: str
    text: str


Element: TypeAlias = Heading | Paragraph | Caution | GradeSummary | DataTable | Figure | Listing


@dataclass(frozen=True, slots=True)
class AppendixSection:
    """A part of the appendix: closed on a screen, until somebody opens it."""

    title: str
    elements: tuple[Element, ...]


@dataclass(frozen=True, slots=True)
class Document:
    title: str
    subtitle: str
    sheet: tuple[Element, ...]
    appendix: tuple[AppendixSection, ...]
    foot: str  # what wrote it


def markdown(document: Document) -> str:
    """Return a document as Markdown."""
    parts = [f"# {_escaped(document.title)}", _escaped(document.subtitle)]
    parts += map(_markdown_element, document.sheet)
    for section in document.appendix:
        # a section of figures alone has no text
        if texts := list(filter(None, map(_markdown_element, section.elements))):
            parts += [f"## Appendix: {_escaped(section.title)}", *texts]
    return "\n\n".join([*filter(None, parts), _escaped(document.foot)]) + "\n"


def _markdown_element(element: Element) -> str:
    """Return an element as Markdown; empty if it has no text."""
    match element:
        case Heading(text):
            return f"## {_escaped(text)}"
        case Paragraph(text):
            return _escaped(text)
        case Caution(name, text):
            return f"> **{_escaped(name)}** {_escaped(text)}".rstrip()
        case GradeSummary(sensor, grade, text):
            return f"**{sensor}: {grade}** ({text.rstrip('.')})"
        case DataTable():
            return _markdown_table(element)
        case Figure(caption, numbers):
            return "" if numbers is None else f"{_markdown_table(numbers)}\n\n{_escaped(caption)}"
        case Listing(language, text):
            return f"```{language}\n{text}\n```"


def _markdown_table(table: DataTable) -> str:
    """Return a table with columns of even width, which also reads well as plain text."""
    rows = [tuple(map(_escaped, row)) for row in table.rows]
    head = tuple(map(_escaped, table.head))
    widths = [max(3, *(len(row[k]) for row in (head, *rows))) for k in range(len(head))]

    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(f"{c:<{width}}" for c, width in zip(cells, widths, strict=True)) + " |"

    return "\n".join(
        [line(head), "|" + "|".join("-" * (width + 2) for width in widths) + "|", *map(line, rows)]
    )


def _escaped(cell: str) -> str:
    """Return text without characters that end a cell, begin a tag or set italics."""
    for character in "\\|<>*_`":
        cell = cell.replace(character, f"\\{character}")
    return cell.replace("\n", " ")
