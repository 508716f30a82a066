"""Documents of a report: complete, correct and usable for every report."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from documents import AGES, FIGURES, SETTINGS, aged, filters, text
from reports import report as make_report

from imumon.documents import FORMS
from imumon.documents.csv_table import COLUMNS as CSV_COLUMNS
from imumon.documents.elements import DataTable
from imumon.documents.report_texts import excluded_sentence
from imumon.documents.sheet import datasheet
from imumon.documents.summary import LINES, summary_text
from imumon.model.messages import CAVEATS, FILTER_NOT_KNOWN


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
def test_every_form_of_every_age_is_complete(age: str) -> None:
    shown = {form: text(aged(age), form) for form in FORMS if form not in FIGURES}
    assert not [form for form, page in shown.items() if not page.endswith("\n")]
    unknown_without_a_text = re.compile(r"\bnan\b|\binf\b|\bNone\b")
    assert not [form for form, page in shown.items() if unknown_without_a_text.search(page)]


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
def test_tables_have_a_cell_for_each_column(age: str) -> None:
    report = aged(age)
    sheet = datasheet(report, filters(report), "kalibr")
    for element in (*sheet.sheet, *(e for section in sheet.appendix for e in section.elements)):
        if isinstance(element, DataTable):
            assert {len(row) for row in element.rows} <= {len(element.head)}
    lines = text(report, "md").splitlines()
    for k, line in enumerate(lines):
        if line.startswith("|--"):
            width = len(re.findall(r"(?<!\\)\|", line))
            for row in (lines[k - 1], *lines[k + 1 : k + 4]):
                if row.startswith("|"):
                    assert len(re.findall(r"(?<!\\)\|", row)) == width


class Balance(HTMLParser):
    """Open elements, and the resources that a browser would fetch."""

    VOID = ("meta", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        links = [str(v) for k, v in attrs if k in ("src", "href")]
        self.fetched += [v for v in links if not v.startswith("#")] + ([tag] if tag == "script" else [])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
def test_the_page_is_well_formed_and_fetches_nothing(age: str) -> None:
    page = text(aged(age), "html")
    parser = Balance()
    parser.feed(page)
    assert parser.open == []
    assert parser.fetched == []
    assert "url(#" in page or age in ("nothing", "seconds")
    assert not re.search(r"url\((?!#)|@import|https?:", page)


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
def test_csv_is_one_tidy_table(age: str) -> None:
    """Every row has the columns of the header, and a reader without options finds every point and coefficient."""
    report = aged(age)
    shown = text(report, "csv")
    table = list(csv.DictReader(io.StringIO(shown)))
    assert {len(row) for row in csv.reader(io.StringIO(shown))} == {len(CSV_COLUMNS)}
    points = [row for row in table if row["kind"] == "allan"]
    assert len(points) == sum(len(c.allan.tau_s) for c in report.channels.values() if c.allan)
    parts = [row for row in table if row["kind"] == "coefficient"]
    shown_parts = [(row["channel"], row["name"]) for row in parts]
    assert shown_parts == [(n, k) for n, c in report.channels.items() for k in c.estimates]
    assert not [row for row in table if row["value"] and not row["unit"]]
    counters = {row["name"]: row["unit"] for row in table if row["kind"] == "record"}
    assert [counters[name] for name in ("elapsed_s", "discarded_bytes", "samples")] == ["s", "byte", "1"]
    for row in points[:3]:
        at = [f"{tau}" for tau in report.channels["gyro/x"].allan.tau_s].index(row["tau_s"])
        assert float(row["value"]) == report.channels["gyro/x"].allan.sigma[at]
        noise = report.channels["gyro/x"].allan.noise[at]
        assert row["noise"] == ("" if noise is None else str(noise))
    for row in parts:
        part = report.channels[row["channel"]].estimates[row["name"]]
        assert (row["value"] or None) == (None if part.value is None else str(part.value))
        assert (row["unit"], row["status"]) == (part.unit, part.status)


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
@pytest.mark.parametrize("width", [80, 120])
def test_the_summary_is_one_screen_of_whole_lines(age: str, width: int) -> None:
    report = aged(age)
    remarks, last = ["a remark that is longer than a line of the terminal " * 3] * 9, ["who has the rest"]
    lines = summary_text(report, width, late="no sample", remarks=remarks, last=last).splitlines()
    assert len(lines) <= LINES < 24
    assert max(map(len, lines)) <= width
    assert lines[-1:] == last
    assert "…" not in "".join(lines)
    for name, channel in report.channels.items():
        assert sum(line.startswith(f"{name} ") for line in lines) == bool(channel.estimates)


def test_the_summary_names_its_caveats_and_counts_in_the_singular() -> None:
    report = replace(make_report(), caveats=("aliased",))
    report = replace(report, session=replace(report.session, gaps=1))
    shown = summary_text(report, 200)
    assert "caveats: aliased, " in shown
    assert "vibration (accel y)" in shown
    assert f"\n{CAVEATS['aliased'].line}" in shown
    assert "in 1 gap," in shown


@pytest.mark.few
@pytest.mark.parametrize("form", [*SETTINGS, "md"])
def test_every_form_warns_of_an_unknown_filter(form: str) -> None:
    """N of a stream in listen-only mode is too high by a factor that depends on its rate."""
    report = make_report(200.0)

    def shown(**known: object) -> str:
        changed = replace(report, caveats=(), device=replace(report.device, **known))
        return text(changed, form)

    unknown = shown(alias_factor=None, stream="compensated", sample_rate_hz=40.0)
    assert FILTER_NOT_KNOWN in unknown
    assert "2.24" in unknown
    other = shown(
        alias_factor=None, stream="unknown", sample_rate_hz=40.0, model=None, driver=None, id="replay"
    )
    assert FILTER_NOT_KNOWN in other
    assert "VN-100" not in other
    assert FILTER_NOT_KNOWN not in shown(alias_factor=1.0, stream="compensated", sample_rate_hz=40.0)
    assert FILTER_NOT_KNOWN not in shown(alias_factor=None, stream="deltas", sample_rate_hz=40.0)


def test_excluded_seconds_add_up() -> None:
    """Seconds of the magnetometer alone are no part of those that are excluded from all channels."""
    report = make_report()

    def shown(seconds: float, **by: float) -> str:
        session = replace(report.session, excluded_s=seconds, excluded_by=by, warmup_s=0.0)
        return excluded_sentence(replace(report, session=session))

    alone, knock = "6.5 s of the magnetometer alone as disturbed", "5.0 s (knock 5.0 s) as disturbed"
    assert shown(0.0, magnetic=6.5) == f"Excluded: {alone}."
    assert shown(5.0, knock=5.0) == f"Excluded: {knock}."
    assert shown(5.0, knock=5.0, magnetic=6.5) == f"Excluded: {knock}; {alone}."


def test_the_summary_has_the_time_to_the_configured_precision_and_the_loss() -> None:
    report = replace(make_report(), precision={"N": 0.001, "B": 0.15, "K": 0.5})
    ahead = {"N": 0.0, "B": 7200.0, "K": 259_200.0}
    channels = {n: replace(c, time_to=ahead) if c.grade else c for n, c in report.channels.items()}
    lossy = replace(report.session, recent_loss=0.201)
    lines = summary_text(replace(report, channels=channels, session=lossy)).splitlines()
    assert "still to come: B within ±15 % in 2 h, K within ±50 % in 3 d" in lines
    assert "20 % of the samples of the last minute are missing" in lines


def test_axes_move_together_only_beyond_chance() -> None:
    """A few samples, or two random walks, correlate by chance; each pair is listed once."""

    def lines(independent: float | None) -> list[str]:
        report = make_report(200.0)
        channels = dict(report.channels)
        for name, other in (("gyro/x", "gyro/y"), ("gyro/y", "gyro/x")):
            shape = channels[name].distribution
            assert shape is not None
            shape = replace(shape, correlation={other: 0.76}, effective_samples=independent)
            channels[name] = replace(channels[name], distribution=shape)
        shown = text(replace(report, channels=channels), "md").splitlines()
        return [line for line in shown if line.startswith("gyro") and "moves together" in line]

    for independent in (None, 4.0, 20.0):
        assert lines(independent) == []
    assert lines(400.0) == ["gyro/x: moves together with gyro/y (+0.76)."]
