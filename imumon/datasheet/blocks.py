"""Blocks: the parts of a datasheet before they have a form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Heading:
    text: str


@dataclass(frozen=True, slots=True)
class Text:
    text: str


@dataclass(frozen=True, slots=True)
class Warned:
    """Something a reader must know before the numbers."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """The grade of one sensor: its name, the grade, and what is to be said of it."""

    sensor: str
    grade: str
    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of cells; the first column names the row. `strong` rows are those a reader looks for."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    strong: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class Curves:
    """Allan curves of a sensor: drawn where that can be, else their numbers."""

    sensor: str
    caption: str
    numbers: Table


@dataclass(frozen=True, slots=True)
class Snippet:
    language: str
    text: str


Block: TypeAlias = Heading | Text | Warned | Verdict | Table | Curves | Snippet


@dataclass(frozen=True, slots=True)
class Document:
    title: str
    subtitle: str
    blocks: tuple[Block, ...]
