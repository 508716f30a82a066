"""PDF form of a datasheet: the page of `html` as a browser prints it, by WeasyPrint, with its fonts embedded.

Figures stay vectors. The fonts are those of matplotlib, so that every sign has a shape on a computer without fonts.
"""

from __future__ import annotations

from pathlib import Path

from imumon.datasheet.elements import Document
from imumon.datasheet.html import html_page
from imumon.datasheet.plotting import COLOURS
from imumon.errors import ImumonError

FACES = {
    "DejaVuSans.ttf": ("DejaVu Sans", "normal"),
    "DejaVuSans-Bold.ttf": ("DejaVu Sans", "bold"),
    "DejaVuSansMono.ttf": ("DejaVu Sans Mono", "normal"),
}
"""Family and weight of the fonts of matplotlib that a page uses."""


class PdfNotAvailable(ImumonError):
    """What writes PDF is not installed."""


def pdf_pages(document: Document) -> bytes:
    """Return the whole datasheet as PDF.

    Raises
    ------
    PdfNotAvailable : the extra or the libraries of the system that it needs are not installed.
    """
    cure = "or print the page: -o FILE.html"
    try:
        from weasyprint import HTML
    except ModuleNotFoundError:
        message = "a datasheet as PDF needs the package weasyprint"
        raise PdfNotAvailable("pdf_not_installed", message, f"pip install '.[pdf]', {cure}") from None
    except OSError:
        message = "a datasheet as PDF needs the library Pango"
        raise PdfNotAvailable(
            "pango_not_installed", message, f"apt install libpangoft2-1.0-0, {cure}"
        ) from None
    page = html_page(document)
    for role, colour in COLOURS.items():  # a figure cannot use the variables of its page
        page = page.replace(f"var(--{role})", colour)
    page = page.replace("</head>", f"<style>{_faces()}</style></head>")
    pages: bytes = HTML(string=page).write_pdf()  # type: ignore[no-untyped-call]
    return pages


def _faces() -> str:
    """Return the rules that name the fonts."""
    import matplotlib

    directory = Path(matplotlib.get_data_path(), "fonts", "ttf")
    rules = [
        f'@font-face {{ font-family: "{family}"; font-weight: {weight}; src: url("{(directory / name).as_uri()}"); }}'
        for name, (family, weight) in FACES.items()
    ]
    rules += [
        'body, svg text { font-family: "DejaVu Sans", sans-serif !important; } '
        'pre { font-family: "DejaVu Sans Mono", monospace !important; }'
    ]
    return "".join(rules)
