"""HTML form of a datasheet: one file that needs nothing else, light or dark, on a screen or on paper."""

from __future__ import annotations

import html

from imumon.datasheet.elements import (
    Caution,
    DataTable,
    Document,
    Element,
    Figure,
    GradeSummary,
    Heading,
    Listing,
    Paragraph,
)

SHORT = 14  # rows up to which a table is not broken between two printed pages
RUNNING = 300  # characters of a title that fit into the margin of a page
UNBROKEN = 36  # characters up to which a cell is broken before a parenthesis only

STYLE = """
:root { color-scheme: light dark; --ground: #fff; --text: #1b1f24; --muted: #5b6470; --rule: #d5dae0;
  --soft: #f3f5f7; --warn: #8a5300; --warn-soft: #fff4df; --x: #0b66b0; --y: #c4500a; --z: #0a8a62; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171b; --text: #e3e7eb; --muted: #9aa4af;
  --rule: #363d45; --soft: #1d2227; --warn: #f0b95b; --warn-soft: #2c2414; --x: #5cb3f2; --y: #f2965a;
  --z: #45cc9f; } }
@media print { :root { color-scheme: light; --ground: #fff; --text: #000; --muted: #444; --rule: #bbb;
  --soft: #f3f3f3; --warn: #6b4000; --warn-soft: #fff4df; --x: #0b66b0; --y: #c4500a; --z: #0a8a62; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.2rem 1.4rem 3rem; max-width: 62rem; background: var(--ground);
  color: var(--text); font: 15px/1.5 system-ui, "Segoe UI", "Helvetica Neue", Arial, "DejaVu Sans",
  sans-serif; }
h1 { margin: 0; font-size: 1.7rem; line-height: 1.2; overflow-wrap: anywhere; }
h2 { margin: 2.2rem 0 .6rem; font-size: 1.12rem; border-bottom: 1px solid var(--rule);
  padding-bottom: .25rem; }
p { margin: .6rem 0; } p, figcaption { overflow-wrap: anywhere; }
.subtitle, .note, figcaption { color: var(--muted); }
.note, figcaption { font-size: .87rem; }
.grades { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.3rem 0 1rem; }
.grade { flex: 1 1 18rem; background: var(--soft); border-radius: 6px; padding: .7rem 1rem .8rem; }
.grade b { display: block; font-size: 1.2rem; line-height: 1.3; }
.grade b::first-letter { text-transform: uppercase; }
.grade span { font-size: .87rem; color: var(--muted); }
.caution { margin: .5rem 0; padding: .5rem .9rem; max-width: none; background: var(--warn-soft);
  border-left: 4px solid var(--warn); border-radius: 0 4px 4px 0; font-size: .92rem; }
.caution b { color: var(--warn); }
.wide { overflow-x: auto; margin: .7rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; font-variant-numeric: tabular-nums; }
caption { caption-side: bottom; text-align: left; color: var(--warn); padding-top: .3rem; }
table.facts td { overflow-wrap: anywhere; }
th, td { text-align: left; vertical-align: top; padding: .3rem .9rem .3rem 0;
  border-bottom: 1px solid var(--rule); }
thead th { color: var(--muted); font-weight: 600; vertical-align: bottom; }
tbody th { font-weight: 600; } tbody th, .one { white-space: nowrap; }
tr.strong td, tr.strong th { background: var(--soft); font-weight: 700; }
table.facts { width: auto; } table.facts th { font-weight: 400; color: var(--muted); padding-right: 1.6rem; }
figure { margin: 1rem 0 1.6rem; }
svg.allan { width: 100%; height: auto; display: block; }
svg.allan text { font-family: system-ui, "Segoe UI", Arial, "DejaVu Sans", sans-serif; }
@media screen and (max-width: 36rem) { body { padding: 1.4rem .9rem 2rem; } figure { overflow-x: auto; }
  svg.allan { min-width: 34rem; } }
pre { background: var(--soft); border-radius: 6px; padding: .8rem 1rem; overflow-x: auto; font: 12.5px/1.45
  ui-monospace, "SF Mono", Consolas, "DejaVu Sans Mono", monospace; }
table.tall { table-layout: fixed; } table.tall td, table.tall tbody th { height: 2.6rem; vertical-align: bottom; }
@media print { body { padding: 0; max-width: none; font-size: 9pt; } h1 { font-size: 15pt; }
  h2 { break-after: avoid; margin-top: 1.4rem; font-size: 11pt; }
  figure { margin: .5rem 0; text-align: center; }
  svg.allan { width: 78%; margin: 0 auto; } th, td { padding: .18rem .36rem .18rem 0; }
  .short, figure, tr, .caution, .grade, .note { break-inside: avoid; }
  .joined { break-before: avoid; }
  .wide { overflow: visible; margin: .5rem 0; }
  table { font-size: 7.8pt; } .note, figcaption, .caution, .grade span { font-size: 8pt; }
  pre { white-space: pre-wrap; font-size: 7.4pt; orphans: 6; widows: 6; } .note:has(+ pre) { break-after: avoid; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""


def html_page(document: Document) -> str:
    """Return the whole datasheet."""
    grades = "".join(_element(element) for element in document.elements if isinstance(element, GradeSummary))
    rest = [_element(element) for element in document.elements if not isinstance(element, GradeSummary)]
    title = html.escape(document.title)
    return "\n".join(
        [
            '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{title}: noise datasheet</title><style>{STYLE}{_page(document)}</style></head><body>",
            f'<h1>{title}</h1><p class="subtitle">{html.escape(document.subtitle)}</p>',
            f'<div class="grades">{grades}</div>' if grades else "",
            *rest,
            "</body></html>\n",
        ]
    )


def _page(document: Document) -> str:
    """Return the style of printed pages: each has item, date, number, revision and its place."""
    title = document.title if len(document.title) <= RUNNING else f"{document.title[: RUNNING - 1]}…"
    head, foot = (_css_text(text) for text in (f"{title} · {document.subtitle}", document.running))
    return f"""@page {{ size: A4; margin: 20mm 15mm 18mm; font: 7.5pt "DejaVu Sans", sans-serif; color: #444;
  @top-left {{ content: {head}; width: 100%; }} @bottom-left {{ content: {foot}; width: 75%; }}
  @bottom-right {{ content: "page " counter(page) " of " counter(pages); }} }}
"""


def _css_text(text: str) -> str:
    """Return a text as a string of CSS in a page: all but plain characters as their numbers."""
    return '"' + "".join(c if c.isalnum() and c.isascii() else f"\\{ord(c):06x}" for c in text) + '"'


def _element(element: Element) -> str:
    """Return an element as HTML; empty if there is nothing to draw."""
    match element:
        case Heading(text, joined):
            return f"<h2{' class=joined' if joined else ''}>{html.escape(text)}</h2>"
        case Paragraph(text):
            return f'<p class="note">{html.escape(text)}</p>'
        case Caution(name, text):
            return f'<p class="caution"><b>{html.escape(name)}</b> {html.escape(text)}</p>'
        case GradeSummary(sensor, grade, text):
            inner = f"{html.escape(sensor)}<b>{html.escape(grade)}</b><span>{html.escape(text)}</span>"
            return f'<div class="grade">{inner}</div>'
        case DataTable():
            return _table(element)
        case Figure(caption, _, svg, legend):
            drawn, text = svg(), html.escape(f"{caption} {legend}".rstrip())
            return f"<figure>{drawn}<figcaption>{text}</figcaption></figure>" if drawn else ""
        case Listing(_, text):
            return f"<pre>{html.escape(text)}</pre>"


def _table(table: DataTable) -> str:
    """Return a table as HTML; one without heads is a list of facts."""
    out, short = [], len(table.rows) <= SHORT
    for k, row in enumerate(table.rows):
        first, *rest = map(_cell, row)
        mark = ' class="strong"' if k in table.strong else ""
        cells = "".join(f"<td>{cell}</td>" for cell in rest)
        out.append(f'<tr{mark}><th scope="row">{first}</th>{cells}</tr>')
    facts = not any(table.head)
    kind = " class=facts" if facts else " class=tall" if table.tall else ""
    head = "".join(f'<th scope="col">{_title(cell)}</th>' for cell in table.head)
    return (
        f'<div class="wide{" short" if short else ""}"><table{kind}>'
        + (f"<caption>{html.escape(table.caption)}</caption>" if table.caption else "")
        + ("" if facts else f"<thead><tr>{head}</tr></thead>")
        + f"<tbody>{''.join(out)}</tbody></table></div>"
    )


def _cell(text: str) -> str:
    """Return a cell; short ones stay on one line, or have their limits on the next."""
    if len(text) > UNBROKEN:
        return html.escape(text)
    first, *limits = html.escape(text).split(" (")
    return " ".join(
        f'<span class="one">{part}</span>' for part in (first, *(f"({limit}" for limit in limits))
    )


def _title(text: str) -> str:
    """Return the title of a column with its unit on a line of its own."""
    name, comma, unit = text.rpartition(", ")
    if not comma:
        return html.escape(text)
    return f"{html.escape(name)},<br>{html.escape(unit).replace(' ', '&nbsp;')}"
