"""The datasheet as PDF: pages that a metrologist signs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pypdfium2
import pytest
from documents import bare
from pypdfium2 import raw
from reports import of_sensors, report

from imumon.api.traceability import evaluated, with_provenance
from imumon.datasheet import document
from imumon.datasheet.content import datasheet_content
from imumon.datasheet.pdf import PdfNotAvailable
from imumon.errors import ImumonError
from imumon.evaluation import Item
from imumon.filter_report import FilterReport
from imumon.report import Report

MARGIN = 40.0
"""pt, of a page: 15 mm are 42.5."""
FOOT, HEAD = 51.0, 785.0
"""pt from below, between which a page of A4 has its text: margins of 18 and 20 mm."""
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def sheet() -> Report:
    made = with_provenance(of_sensors(report(7200.0), "gyro", "temperature"), None, {}, True)
    item = Item(operator="A. Person", note='<b>bold</b> } @page { content: none; } "quoted"')
    return evaluated(replace(made, item=item))


@pytest.fixture(scope="module")
def pdf(sheet: Report) -> pypdfium2.PdfDocument:
    return pypdfium2.PdfDocument(document(sheet, "pdf", FilterReport(time=sheet.time, device=sheet.device)))


def test_each_page_has_number_revision_item_and_date(sheet: Report, pdf: pypdfium2.PdfDocument) -> None:
    texts = [page.get_textpage().get_text_range() for page in pdf]
    content = datasheet_content(sheet, FilterReport(time=sheet.time, device=sheet.device))
    number = content.running.partition(" · ")[0]
    assert len(texts) >= 3
    for k, text in enumerate(texts, 1):
        for part in (f"page {k} of {len(texts)}", number, "imumon", "revision", "VN-100T-CR", sheet.time):
            assert part in text, (k, part)
    whole = "".join(texts)
    for part in ("Signatures", "A. Person", "<b>bold</b>", "Uncertainty budget", "0.001", "√h"):
        assert part in whole


def test_figures_are_vectors_and_fonts_are_embedded(pdf: pypdfium2.PdfDocument) -> None:
    pages = list(pdf)
    objects = [item for page in pages for item in page.get_objects(max_depth=5)]
    kinds = [item.type for item in objects]
    assert raw.FPDF_PAGEOBJ_IMAGE not in kinds
    assert kinds.count(raw.FPDF_PAGEOBJ_PATH) > 300
    fonts = [raw.FPDFTextObj_GetFont(item) for item in objects if item.type == raw.FPDF_PAGEOBJ_TEXT]
    assert fonts
    assert all(raw.FPDFFont_GetIsEmbedded(font) == 1 for font in fonts)


def test_without_the_extra_it_says_what_to_install(sheet: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(PdfNotAvailable) as raised:
        document(sheet, "pdf", FilterReport(time=sheet.time, device=sheet.device))
    assert isinstance(raised.value, ImumonError)
    assert raised.value.code == "pdf_not_installed"
    assert ".[pdf]" in raised.value.cure


def test_nothing_is_beyond_the_margins(pdf: pypdfium2.PdfDocument) -> None:
    for page in pdf:
        width, text = page.get_width(), page.get_textpage()
        boxes = [text.get_charbox(k) for k in range(text.count_chars())]
        assert min(box[0] for box in boxes) > MARGIN
        assert max(box[2] for box in boxes) < width - MARGIN


def test_no_page_is_a_third_empty_and_none_has_signatures_alone(pdf: pypdfium2.PdfDocument) -> None:
    for page in list(pdf)[:-1]:
        text = page.get_textpage()
        boxes = [text.get_charbox(k) for k in range(text.count_chars())]
        lowest = min(box[1] for box in boxes if box[1] > FOOT)
        assert HEAD - lowest > 2.0 / 3.0 * (HEAD - FOOT), page.get_textpage().get_text_range()[:200]
    last = pdf[len(pdf) - 1].get_textpage().get_text_range()
    assert "Signatures" in last
    assert "Traceability" in last


def test_no_sentence_is_there_twice(pdf: pypdfium2.PdfDocument) -> None:
    lines = " ".join(" ".join(page.get_textpage().get_text_range().split()) for page in pdf)
    sentences = [s.strip() for s in lines.split(". ") if len(s.split()) > 6 and not s.startswith("#")]
    assert not [s for s in set(sentences) if sentences.count(s) > 1]


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser")
def test_a_browser_prints_the_same_pages(sheet: Report, pdf: pypdfium2.PdfDocument, tmp_path: Path) -> None:
    page, printed = tmp_path / "sheet.html", tmp_path / "printed.pdf"
    page.write_bytes(document(sheet, "html", FilterReport(time=sheet.time, device=sheet.device)))
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--print-to-pdf={printed}", str(page)]
    subprocess.run([str(BROWSER), *words], check=True, capture_output=True, timeout=120.0)
    other = pypdfium2.PdfDocument(printed)
    assert len(other) == len(pdf)
    for one, two in zip(pdf, other, strict=True):
        own, same = (
            "".join(sorted("".join(each.get_textpage().get_text_range().split()))) for each in (one, two)
        )
        assert own == same


def test_a_long_name_does_not_fill_the_page(sheet: Report) -> None:
    long = replace(sheet, device=replace(sheet.device, model="M" * 500, serial="S" * 500))
    page = document(bare(long), "html", FilterReport(time=sheet.time, device=sheet.device)).decode()
    (head,) = [line for line in page.splitlines() if "@top-left" in line]
    assert head.count("M") < 300
    assert "S" * 500 in page
