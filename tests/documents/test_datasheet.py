"""Documents of a report, complete and correct for every report, and the command that writes them."""

from __future__ import annotations

import csv
import io
import json
import re
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import pytest
from commands import imumon, run_inside
from daemons import Daemon
from documents import AGES, FIGURES, SETTINGS, aged, bare, filters, text
from reports import LONG_S, with_channel
from reports import report as make_report

from imumon.documents import FORMS, short_record_text
from imumon.documents.csv_table import COLUMNS as CSV_COLUMNS
from imumon.documents.elements import DataTable, Figure, Heading
from imumon.documents.report_texts import excluded_sentence
from imumon.documents.sheet import datasheet
from imumon.documents.summary import LINES, summary_text
from imumon.model.filter_report import FilterReport
from imumon.model.messages import CAVEATS, FILTER_NOT_KNOWN
from imumon.model.report import Report, from_json
from imumon.model.report_json import to_json


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


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
@pytest.mark.parametrize("combined", [True, False])
def test_a_heading_has_something_below_it(age: str, *, combined: bool) -> None:
    report = aged(age)
    if combined:  # a combination of records has no curve
        channels = {name: replace(channel, allan=None) for name, channel in report.channels.items()}
        report = replace(report, channels=channels)
    sheet = datasheet(report, filters(report), "kalibr")
    sections = (sheet.sheet, *(section.elements for section in sheet.appendix))
    for elements in sections:
        assert elements
        for element, following in pairwise((*elements, Heading("end"))):
            assert not (isinstance(element, Heading) and isinstance(following, Heading)), element
            assert not isinstance(element, Figure) or element.svg(), element.caption


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
def test_the_page_is_well_formed_and_fetches_nothing(age: str) -> None:
    page = text(aged(age), "html")
    # as XML, which ends each element and has each value in quotes
    ended = re.sub(r"<(meta|br)([^>]*[^/])?>", r"<\1\2/>", page)
    elements = list(ElementTree.fromstring(re.sub(r"(\w+)=(\w+)(?=[\s>])", r'\1="\2"', ended)).iter())
    links = [value for each in elements for name, value in each.items() if name in ("src", "href")]
    assert not [link for link in links if not link.startswith("#")]
    assert "script" not in {each.tag for each in elements}
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
    assert lines[0].startswith(f"{report.state}: {report.device.id}")
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
    unknown = replace(report.device, alias_factor=None, stream="compensated")
    shown = summary_text(replace(report, device=unknown, caveats=()), 200)
    assert f"caveats: {FILTER_NOT_KNOWN}, " in shown
    assert "--filter names it" in shown


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


def test_axes_move_together_only_beyond_chance() -> None:
    """A few samples, or two random walks, correlate by chance; each pair is listed once."""

    def lines(independent: float | None) -> list[str]:
        report = make_report(200.0)
        for name, other in (("gyro/x", "gyro/y"), ("gyro/y", "gyro/x")):
            shape = report.channels[name].distribution
            shape = replace(shape, correlation={other: 0.76}, effective_samples=independent)
            report = with_channel(report, name, distribution=shape)
        shown = text(report, "md").splitlines()
        return [line for line in shown if line.startswith("gyro") and "moves together" in line]

    for independent in (None, 4.0, 20.0):
        assert lines(independent) == []
    assert lines(400.0) == ["gyro/x: moves together with gyro/y (+0.76)."]


# ---------------------------------------------------------------- `imumon report`


def test_recording_to_report_to_datasheet_and_baseline(recording: Path, saved: Path, tmp_path: Path) -> None:
    report = from_json(Report, saved.read_text())
    n = report.channels["gyro/x"].coefficients["N"]
    assert (n.low or 0.0) < 6e-5 < (n.high or 0.0)
    page = tmp_path / "sheet.html"
    imumon("report", saved, "-o", page)
    assert "rest.csv" in page.read_text()
    assert imumon("report", saved, "--format", "kalibr") == text(report, "kalibr")
    again = json.loads(imumon("replay", recording, "--json", "--baseline", saved))
    assert again["channels"]["gyro/x"]["changes"] == []
    printed = imumon("replay", recording, "--baseline", saved)
    assert "\nnothing changed against the baseline\n" in printed
    half = replace(n, value=6e-5 / 2, low=2.9e-5, high=3.1e-5)
    known = report.channels["gyro/x"].coefficients
    before = with_channel(report, "gyro/x", coefficients={**known, "N": half})
    (tmp_path / "before.json").write_text(to_json(before))
    printed = imumon("replay", recording, "--baseline", tmp_path / "before.json")
    grown = re.search(r"^gyro/x: N has grown by (\d+) % against the baseline$", printed, re.M)
    assert int(grown[1]) == pytest.approx(100.0 * ((n.value or 0.0) / 3e-5 - 1.0), abs=1.0)
    assert "nothing changed" not in printed


@pytest.mark.parametrize("source", ["recording", "saved"])
def test_filter_parameters_of_a_file(source: str, recording: Path, saved: Path) -> None:
    path = recording if source == "recording" else saved
    found = from_json(FilterReport, imumon("report", path, "--format", "filter", "--horizon", "1m"))
    report = from_json(Report, saved.read_text())
    assert found.schema == "imumon.filter/1"
    assert found.horizon_s == 60.0
    assert found.device == report.device
    assert found.channels == filters(report, 60.0).channels


def test_a_short_record_prints_a_warning(saved: Path) -> None:
    for form in ("filter", "kalibr"):
        code, _, errors = run_inside(["report", str(saved), "--format", form])
        assert code == 0
        assert re.fullmatch(
            r"imumon: recorded 2 min: what the record does not show is a comment; record at least 8 h\n",
            errors,
        )
    assert short_record_text(make_report(LONG_S)) is None or make_report(LONG_S).session.elapsed_s < 8 * 3600


def test_running_daemon_and_its_saved_state(tmp_path: Path) -> None:
    with Daemon("sim", tmp_path, "--speed", "10", "--seed", "3") as daemon:
        live = daemon.samples(1000)
        shown = imumon("report", "--connect", daemon.endpoint, "--format", "md")
        numbers = imumon("report", "--connect", daemon.endpoint, "--format", "filter")
        assert from_json(FilterReport, numbers).device.id == live.device.id
        assert live.device.serial is not None
        assert live.device.serial in shown
        code, _, _ = daemon.stop()
        assert code == 0
    (state,) = tmp_path.glob("*.state")
    report = from_json(Report, imumon("report", state, "--format", "json"))
    assert report.session.samples >= 1000
    assert report.device.model == live.device.model
    assert report.device.stream == "deltas"
    assert report.channels["gyro/x"].coefficients["N"].status == "measured"
    kept = tmp_path / "kept report.json"
    imumon("report", state, "-o", kept)
    for saved in (state, kept):
        command = re.search(r"which has no samples: imumon (.*) prints", imumon("replay", saved, code=1))
        assert "Noise at rest" in imumon(*shlex.split(command[1]))
    data = state.read_bytes()
    state.write_bytes(data[:-100])
    assert "damaged" in imumon("report", state, code=1)


def test_errors_are_one_line(tmp_path: Path, recording: Path, saved: Path) -> None:
    assert "no daemon answers" in imumon("report", "--connect", "tcp/127.0.0.1:1", code=3)
    assert "nowhere" in imumon("report", tmp_path / "nowhere", code=1)
    broken = tmp_path / "broken.json"
    broken.write_text('{"schema": 3')
    assert "broken.json" in imumon("report", broken, code=1)
    broken.write_text("{}")
    assert "imumon.report/1: Report without time, device, state, session: make" in imumon(
        "report", broken, code=1
    )
    imumon("report", recording, "--format", "docx", code=2)
    imumon("report", recording, "--id", "x", code=2)
    assert "cannot write" in imumon("report", saved, "-o", tmp_path / "no" / "a.md", code=1)


def test_the_output_never_overwrites_an_input(recording: Path, tmp_path: Path) -> None:
    own, bag = tmp_path / "own.csv", tmp_path / "bag"
    own.write_bytes(recording.read_bytes())
    bag.mkdir()
    (tmp_path / "linked.csv").symlink_to(own)
    (tmp_path / "same.csv").hardlink_to(own)
    (bag / "part.db3").write_bytes(b"part")
    for read, out in (
        (own, own),
        (own, tmp_path / "linked.csv"),
        (tmp_path / "linked.csv", own),
        (own, tmp_path / "same.csv"),
        (bag, bag / "part.db3"),
    ):
        imumon("report", read, "--format", "md", "-o", out, code=2)
    assert own.read_bytes() == recording.read_bytes()
    assert (bag / "part.db3").read_bytes() == b"part"


def test_the_extension_of_the_output_selects_the_form_or_is_refused(saved: Path, tmp_path: Path) -> None:
    report = from_json(Report, saved.read_text())
    one, no_curve = tmp_path / "one.json", tmp_path / "no_curve.json"
    first = replace(report, channels={"gyro/x": report.channels["gyro/x"]})
    one.write_text(to_json(first))
    no_curve.write_text(to_json(bare(first)))
    error = imumon("report", one, "-o", tmp_path / "x.foo", code=2)
    assert all(form in error for form in FORMS)
    assert not (tmp_path / "x.foo").exists()
    imumon("report", one, "-o", tmp_path / "x.foo", "--format", "csv")
    assert (tmp_path / "x.foo").read_text().startswith("kind,")
    for source, name, begin in (
        (one, "x.svg", b"<?xml"),
        (one, "x.PNG", b"\x89PNG"),
        (one, "imu.yaml", b"# "),
        (no_curve, "x.htm", b"<!DOCTYPE"),
    ):
        imumon("report", source, "-o", tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)
    assert "gyroscope_noise_density: " in (tmp_path / "imu.yaml").read_text()
    imumon("report", no_curve, "-o", tmp_path / "plain")
    assert (tmp_path / "plain").read_text().startswith("# ")
