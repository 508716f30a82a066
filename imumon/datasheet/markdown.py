"""Markdown of a datasheet: tables and text only, so that it reads well where it is not rendered too."""

from __future__ import annotations

from imumon.datasheet.blocks import (
    Block,
    Curves,
    Document,
    Heading,
    Snippet,
    Table,
    Text,
    Verdict,
    Warned,
)


def markdown(found: Document) -> str:
    """The whole datasheet."""
    parts = [f"# {_plain(found.title)}", _plain(found.subtitle)]
    for block in found.blocks:
        text = _block(block)
        if text:
            parts.append(text)
    return "\n\n".join(parts) + "\n"


def _block(block: Block) -> str:
    match block:
        case Heading(text):
            return f"## {text}"
        case Text(text):
            return text
        case Warned(name, text):
            return f"> **{_plain(name)}** {text}".rstrip()
        case Verdict(sensor, grade, text):
            return f"**{sensor}: {grade}** ({text.rstrip('.')})"
        case Table():
            return _table(block)
        case Curves(_, caption, numbers):
            return f"{_table(numbers)}\n\n{caption.partition(' with')[0]}."
        case Snippet(language, text):
            return f"```{language}\n{text}\n```"


def _table(table: Table) -> str:
    rows = [
        tuple(f"**{_plain(cell)}**" for cell in row) if i in table.strong else tuple(map(_plain, row))
        for i, row in enumerate(table.rows)
    ]
    head = tuple(map(_plain, table.head))
    widths = [max(3, *(len(row[k]) for row in (head, *rows))) for k in range(len(head))]

    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(f"{cell:<{wide}}" for cell, wide in zip(cells, widths, strict=True)) + " |"

    lines = [line(head), "|" + "|".join("-" * (wide + 2) for wide in widths) + "|", *map(line, rows)]
    return "\n".join(lines) + (f"\n\n{table.caption}" if table.caption else "")


def _plain(cell: str) -> str:
    """Cell without what would end it, begin a tag or set it in italics."""
    for character in "\\|<>*_`":
        cell = cell.replace(character, f"\\{character}")
    return cell.replace("\n", " ")
