"""HTML form of a datasheet: one file that needs nothing else, light or dark, on a screen or on paper."""

from __future__ import annotations

import html

from imumon.documents.elements import (
    AppendixSection,
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
  --soft: #f3f5f7; --warn: #8a5300; --warn-soft: #fff7e8; --x: #0b66b0; --y: #c4500a; --z: #0a8a62; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171b; --text: #e3e7eb; --muted: #9aa4af;
  --rule: #363d45; --soft: #1d2227; --warn: #f0b95b; --warn-soft: #2c2414; --x: #5cb3f2; --y: #f2965a;
  --z: #45cc9f; } }
@media print { :root { color-scheme: light; --ground: #fff; --text: #000; --muted: #444; --rule: #bbb;
  --soft: #f3f3f3; --warn: #6b4000; --warn-soft: #fff7e8; --x: #0b66b0; --y: #c4500a; --z: #0a8a62; } }
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
.caution { margin: .4rem 0; padding: .35rem .9rem; background: var(--warn-soft);
  border-left: 3px solid var(--warn); border-radius: 0 4px 4px 0; font-size: .9rem; }
.caution b { color: var(--warn); }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .3rem .9rem .3rem 0;
  border-bottom: 1px solid var(--rule); }
thead th { color: var(--muted); font-weight: 600; border-bottom-color: var(--muted); }
thead th:first-child { color: var(--text); font-size: 1rem; }
tbody th { font-weight: 400; } .one { white-space: nowrap; }
.limits { color: var(--muted); font-size: .92em; }
table.even { table-layout: fixed; } table.even th:first-child { width: 25%; }
table.facts { width: auto; } table.facts th { color: var(--muted); padding-right: 1.6rem; white-space: nowrap; }
table.facts td { overflow-wrap: anywhere; }
figure { margin: 1rem 0 1.6rem; }
svg.allan { width: 100%; height: auto; display: block; }
svg.allan text { font-family: system-ui, "Segoe UI", Arial, "DejaVu Sans", sans-serif; }
pre { background: var(--soft); border-radius: 6px; padding: .8rem 1rem; overflow-x: auto; font: 12.5px/1.45
  ui-monospace, "SF Mono", Consolas, "DejaVu Sans Mono", monospace; }
details { border-bottom: 1px solid var(--rule); padding: .55rem 0; }
summary { cursor: pointer; font-weight: 600; }
@media screen and (max-width: 36rem) { body { padding: 1.4rem .9rem 2rem; } figure { overflow-x: auto; }
  svg.allan { min-width: 34rem; } }
@media print { body { padding: 0; max-width: none; font-size: 9pt; line-height: 1.35; } h1 { font-size: 15pt; }
  h2 { break-after: avoid; margin-top: 1.1rem; font-size: 11pt; }
  .page, .appendix { break-before: page; margin-top: 0; }
  details::details-content { content-visibility: visible; display: block; height: auto; }
  summary { list-style: none; font-size: 10pt; break-after: avoid; }
  details { border: 0; padding: .3rem 0 .6rem; } .foot { display: none; }
  .grades { margin: .7rem 0 .5rem; } .grade { padding: .4rem .8rem .5rem; } .grade b { font-size: 11pt; }
  figure { margin: .4rem 0; text-align: center; } figcaption { text-align: left; }
  svg.allan { width: 84%; margin: 0 auto; } th, td { padding: .17rem .5rem .17rem 0; }
  .short, figure, tr, .caution, .grade, .note { break-inside: avoid; }
  .wide { overflow: visible; margin: .55rem 0; } .caution { margin: .2rem 0; padding: .15rem .6rem; }
  p { margin: .4rem 0; }
  table { font-size: 7.8pt; } thead th:first-child { font-size: 8.6pt; }
  .note, figcaption, .caution, .grade span { font-size: 7.8pt; }
  pre { white-space: pre-wrap; font-size: 7pt; line-height: 1.35; padding: .5rem .7rem; break-inside: avoid; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""


def html_page(document: Document) -> str:
    """Return the whole datasheet; the sections of its appendix are closed."""
    grades = "".join(_element(element) for element in document.sheet if isinstance(element, GradeSummary))
    rest = [_element(element) for element in document.sheet if not isinstance(element, GradeSummary)]
    title = html.escape(document.title)
    return "\n".join(
        [
            '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{title}: noise datasheet</title><style>{STYLE}{_page_style(document)}</style></head><body>",
            f'<h1>{title}</h1><p class="subtitle">{html.escape(document.subtitle)}</p>',
            f'<div class="grades">{grades}</div>' if grades else "",
            *rest,
            '<h2 class="appendix">Appendix</h2>' if document.appendix else "",
            *map(_section, document.appendix),
            f'<p class="note foot">{html.escape(document.foot)}</p></body></html>\n',
        ]
    )


def _section(section: AppendixSection) -> str:
    summary = f"<summary>{html.escape(section.title.capitalize())}</summary>"
    return f"<details>{summary}{''.join(map(_element, section.elements))}</details>"


def _page_style(document: Document) -> str:
    """Return the style of printed pages: each names the sensor, what wrote it, and its place."""
    title = document.title if len(document.title) <= RUNNING else f"{document.title[: RUNNING - 1]}…"
    head, foot = _css_text(f"{title} · {document.subtitle}"), _css_text(document.foot)
    return f"""@page {{ size: A4; margin: 17mm 15mm 15mm; font: 7.5pt "DejaVu Sans", sans-serif; color: #555;
  @top-left {{ content: {head}; width: 100%; }} @bottom-left {{ content: {foot}; width: 75%; }}
  @bottom-right {{ content: "page " counter(page) " of " counter(pages); }} }}
"""


def _css_text(text: str) -> str:
    """Return a text as a string of CSS in a page: all but plain characters as their numbers."""
    return '"' + "".join(c if c.isalnum() and c.isascii() else f"\\{ord(c):06x}" for c in text) + '"'


def _element(element: Element) -> str:
    """Return an element as HTML; empty if there is nothing to draw."""
    match element:
        case Heading(text, new_page):
            return f"<h2{' class=page' if new_page else ''}>{html.escape(text)}</h2>"
        case Paragraph(text):
            return f'<p class="note">{html.escape(text)}</p>'
        case Caution(name, text):
            return f'<p class="caution"><b>{html.escape(name)}</b> {html.escape(text)}</p>'
        case GradeSummary(sensor, grade, text):
            inner = f"{html.escape(sensor)}<b>{html.escape(grade)}</b><span>{html.escape(text)}</span>"
            return f'<div class="grade">{inner}</div>'
        case DataTable():
            return table_html(element)
        case Figure(caption, _, svg, legend):
            drawn, text = svg(), html.escape(f"{caption} {legend}".rstrip())
            return f"<figure>{drawn}<figcaption>{text}</figcaption></figure>" if drawn else ""
        case Listing(_, text):
            return f"<pre>{html.escape(text)}</pre>"


def table_html(table: DataTable) -> str:
    """Return a table as HTML; one without heads is a list of facts."""
    rows = []
    for first, *rest in table.rows:
        cells = "".join(f"<td>{_cell(cell)}</td>" for cell in rest)
        rows.append(f'<tr><th scope="row">{_title(first)}</th>{cells}</tr>')
    facts = not any(table.head)
    kind = " class=facts" if facts else " class=even" if table.even else ""
    head = "".join(f'<th scope="col">{_title(cell)}</th>' for cell in table.head)
    short = " short" if len(table.rows) <= SHORT else ""
    return (
        f'<div class="wide{short}"><table{kind}>'
        + ("" if facts else f"<thead><tr>{head}</tr></thead>")
        + f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _title(text: str) -> str:
    """Return the title of a row or a column, whose unit stays on one line."""
    name, comma, unit = html.escape(text).rpartition(", ")
    return f'{name}, <span class="one">{unit}</span>' if comma else unit


def _cell(text: str) -> str:
    """Return a cell; a value stays on one line, and its limits on the same or the next."""
    if len(text) > UNBROKEN:
        return html.escape(text)
    value, parenthesis, limits = html.escape(text).partition(" (")
    whole = f'<span class="one">{value}</span>'
    return f'{whole} <span class="one limits">({limits}</span>' if parenthesis else whole
