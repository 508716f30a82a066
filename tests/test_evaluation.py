"""Evaluation of a report for a document: data sheet, uncertainty, exact curve, filter, traceability."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import forked
import numpy as np
import pytest
from paths import RECORDINGS, needs_recordings
from reports import RATE, with_coefficients
from reports import report as report_at

from imumon.api.traceability import evaluated, with_provenance
from imumon.cli.main import main
from imumon.cli.wait_condition import WaitCondition
from imumon.coefficients import COEFFICIENTS, Estimate, Excess, coefficient_ratio
from imumon.datasheet import document
from imumon.datasheet.evidence import excluding_events
from imumon.datasheet.tables import channel_rows, coefficient_text
from imumon.evaluation import UncertaintyBudget
from imumon.filter_report import FilterReport
from imumon.noise.allan.overlapping import SampleStore, averaging_lengths, overlapping_deviation
from imumon.noise.synthesis import synthesise
from imumon.noise.uncertainty import probability_at_most, verdict
from imumon.pipeline.uncertainty_budgets import uncertainty_budgets
from imumon.references import SheetError, published, read_sheet, sheet_of_model
from imumon.references.limit_checks import conformity
from imumon.report import Event, Report, from_json
from imumon.report_json import to_json
from imumon.tui.formatting import Notation
from imumon.units import figures

HZ = 40.0

SHEET = """
title = "Acme A1"
models = ["A1"]
document = "A1 data sheet"
edition = "Rev. C, 2026"

[[limit]]
channels = ["gyro"]
quantity = "N"
at_most = {gyro}
unit = "deg/sqrt(h)"

[[limit]]
channels = ["accel/x", "accel/y"]
quantity = "floor"
at_most = 1000.0
unit = "mg"
basis = "typical"
"""


def imumon(*words: object, code: int = 0) -> str:
    """Run a command in this process; return its output, or its messages if it is to fail with `code`."""
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert main([str(word) for word in words]) == code, err.getvalue()
        out.flush()
    return err.getvalue() if code else out.buffer.getvalue().decode()


def make_report() -> Report:
    """Return the report of a quarter of an hour."""
    return report_at(900.0, scale=2.0)


def shown(report: Report, form: str = "md") -> str:
    return document(report, form, FilterReport(time=report.time, device=report.device)).decode()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return 50 s at rest as CSV, N known, without a device or a filter."""
    path = tmp_path_factory.mktemp("recording") / "rest.csv"
    noise = synthesise(2000, HZ, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    noise[:, 5] -= 9.8
    names = "t [s],wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]"
    rows = np.column_stack([np.arange(2000) / HZ, noise])
    np.savetxt(path, rows, delimiter=",", header=names, comments="", fmt="%.12g")
    return path


@pytest.fixture(scope="module")
def gyroscope(recording: Path) -> Path:
    """Return the gyroscope of the recording alone: an analysis takes half the time."""
    path = recording.with_name("gyro.csv")
    rows = (line.split(",")[:4] for line in recording.read_text().splitlines())
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


@pytest.fixture(scope="module")
def saved(recording: Path) -> Path:
    """Return the saved report of the recording."""
    path = recording.with_name("saved.json")
    imumon("report", recording, "-o", path)
    return path


def sheet_file(tmp_path: Path, *, gyro: float) -> Path:
    path = tmp_path / "sheet.toml"
    path.write_text(SHEET.format(gyro=gyro))
    return path


def replayed(*words: object) -> Report:
    return from_json(Report, imumon("replay", *words, "--json"))


# ---------------------------------------------------------------- exact curve


@pytest.mark.parametrize("octaves", [True, False])
def test_the_exact_deviation_is_that_of_allantools(octaves: bool) -> None:
    import allantools  # it imports all of scipy

    values = 9.8 + synthesise(5000, HZ, N=[1e-3], B=[1e-4], K=[1e-4], seed=2)[:, 0]
    lengths = averaging_lengths(len(values), octaves=octaves)
    sigma, terms = overlapping_deviation(values, np.ones(len(values), dtype=int), lengths)
    _, expected, _, counts = allantools.oadev(values, rate=HZ, data_type="freq", taus=np.array(lengths) / HZ)
    np.testing.assert_allclose(sigma[: len(expected)], expected, rtol=1e-9)
    np.testing.assert_array_equal(terms[: len(counts)], counts)
    assert len(expected) >= len(lengths) - 1


def test_no_difference_spans_a_gap() -> None:
    values = np.random.default_rng(1).normal(size=(100, 2))
    store = SampleStore([0, 0])
    store.update(values[:60])
    store.break_()
    store.update(values[60:], (np.arange(40) != 20)[:, None])
    kept, valid = store.result()
    sigma, terms = overlapping_deviation(kept[:, 0], valid[:, 0], [1, 8])
    pieces = [values[:60, 0], values[60:80, 0], values[81:, 0]]
    for k, m in enumerate((1, 8)):
        squares = [
            (piece[i + m : i + 2 * m].mean() - piece[i : i + m].mean()) ** 2 / 2.0
            for piece in pieces
            for i in range(len(piece) - 2 * m + 1)
        ]
        assert terms[k] == len(squares)
        assert sigma[k] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-12)


def test_exact_on_the_command_line_equals_allantools_at_every_octave(recording: Path) -> None:
    import allantools  # it imports all of scipy

    report = replayed(recording, "--exact", "--no-guards")
    assert report.evaluation is not None
    data = np.loadtxt(recording, delimiter=",", skiprows=1)
    for column, name in enumerate(("gyro/x", "gyro/y", "gyro/z", "accel/x", "accel/y", "accel/z"), 1):
        curve = report.evaluation.exact[name]
        _, expected, _, _ = allantools.oadev(data[:, column], rate=HZ, data_type="freq", taus=curve.tau_s)
        np.testing.assert_allclose(curve.sigma[: len(expected)], expected, rtol=1e-9)
        allan = report.channels[name].allan
        assert [tau for tau in allan.tau_s if tau not in curve.tau_s] == []
        for sigma, difference, own in zip(curve.sigma, curve.difference, allan.sigma, strict=True):
            assert difference == pytest.approx(own / sigma - 1.0)
        assert max(abs(d) for d in curve.difference[:4] if d is not None) < 0.02
        assert all(lo < s < hi for lo, s, hi in zip(curve.low, curve.sigma, curve.high, strict=True))


def test_ten_averaging_times_per_decade(gyroscope: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.json"
    imumon("report", gyroscope, "--exact", "--taus", "decade", "-o", out)
    report = from_json(Report, out.read_text())
    taus = np.array(report.evaluation.exact["gyro/x"].tau_s)
    decade = taus[(taus > 0.99) & (taus < 9.9)]
    assert len(decade) == 10
    assert "Exact Allan deviation" in shown(report)
    allan = report.channels["gyro/x"].allan
    shared = sum(any(abs(tau - t) < 1e-9 for t in taus) for tau in allan.tau_s)
    assert 0 < shared < len(allan.tau_s)
    assert f"| {shared} of {len(allan.tau_s)} " in shown(report)  # the rest of the octaves is not compared
    octaves = replayed(gyroscope, "--exact")
    assert f"| {len(allan.tau_s)} of {len(allan.tau_s)} " in shown(octaves)
    assert "fully overlapping, exact" in shown(report, "svg")
    imumon("report", out, "-o", tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_text().count("\nexact,") == 3 * len(taus)


def test_taus_need_exact_and_exact_needs_samples(recording: Path, tmp_path: Path) -> None:
    imumon("replay", recording, "--taus", "decade", code=2)
    (tmp_path / "x.json").write_text(to_json(make_report()))
    for words in (("--exact",), ("--filter", "none"), ("--taus", "octave", "--exact")):
        assert "needs a recording" in imumon("report", tmp_path / "x.json", *words, code=2)


@needs_recordings
def test_a_real_recording_agrees_with_another_tool() -> None:
    """The figures of kiran_stat5min, computed by allantools from the sentences."""
    report = replayed(RECORDINGS / "kiran_stat5min.vnymr.txt.gz", "--rate", "40", "--exact", "--no-guards")
    sigma = report.evaluation.exact["gyro/x"].sigma
    for octave, expected in ((1, 0.0004636), (4, 0.0001679), (6, 8.573e-05)):
        assert sigma[octave] == pytest.approx(expected, rel=1e-3)


# ---------------------------------------------------------------- filter


def test_a_named_filter_answers_what_the_recording_does_not_say(gyroscope: Path) -> None:
    for words, factor in (
        ((), None),
        (("--filter", "factory"), np.sqrt(5.0)),
        (("--filter", "20"), 1.0),
        (("--filter", "10@1000"), np.sqrt(1000.0 / (10 * HZ))),
    ):
        device, caveats = (report := replayed(gyroscope, *words)).device, report.caveats
        assert device.alias_factor == (factor if factor is None else pytest.approx(factor, rel=1e-6))
        assert ("aliased" in caveats) == (factor is not None and factor > 1.0)
        assert ("filter" in device.settings) == bool(words)
    for wrong in ("boxcar", "0.5", "-4", "4@0", "factory@100", "@800"):
        imumon("replay", gyroscope, f"--filter={wrong}", code=2)


def test_what_a_filter_assumes_of_an_unknown_device_is_in_the_report(gyroscope: Path) -> None:
    """The window of a VN-100 averages samples of 800 Hz; a table may be of another sensor."""
    for words, assumed in (
        ("4", "rate before the filter"),
        ("factory", "filter"),
        ("none", "rate before the filter"),
    ):
        text = imumon("report", gyroscope, "--filter", words)
        stated = f"the recording names no device: its {assumed} is assumed to be "
        assert f"{words}, as given with --filter; {stated}" in text
        assert f"--filter {words}: {stated}" in text  # the remark, with what to do
        assert "give window and rate, such as 8@1000" in text
    assert "is assumed to be" not in imumon("report", gyroscope, "--filter", "8@1000")


@needs_recordings
def test_the_format_of_a_recording_names_the_device_for_the_filter() -> None:
    report = replayed(RECORDINGS / "kiran_stat5min.vnymr.txt.gz", "--rate", "40", "--filter", "factory")
    assert report.device.alias_factor == pytest.approx(np.sqrt(5.0))
    assert report.device.settings["filter"] == "factory, as given with --filter"
    assert not any("--filter" in remark for remark in report.device.remarks)


def test_a_filter_is_not_used_for_deltas(tmp_path: Path) -> None:
    noise = synthesise(2000, HZ, N=[6e-5] * 3 + [1.4e-3] * 3, seed=1)
    np.savez(tmp_path / "d.npz", t=np.arange(2000) / HZ, dt=np.full(2000, 1 / HZ),
             DeltaTheta=noise[:, :3] / HZ, DeltaVel=noise[:, 3:] / HZ)  # fmt: skip
    report = replayed(tmp_path / "d.npz", "--filter", "none")
    if report.device.stream == "deltas":
        assert report.device.alias_factor == 1.0
        assert any("--filter is not used" in remark for remark in report.device.remarks)
        assert "--filter is not used" in shown(report)


# ---------------------------------------------------------------- data sheets


def test_a_verdict_is_guarded_by_the_limits() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        low, value, high = sorted(rng.uniform(1.0, 2.0, 3))
        limit = rng.uniform(0.8, 2.2)
        chance = probability_at_most(limit, value, low, high)
        assert chance is not None
        found = verdict(limit, low, high)
        assert (found == "pass") == (chance >= 0.9749999)
        assert (found == "fail") == (chance < 0.0250001)


@pytest.mark.parametrize("name", sorted(published()))
def test_a_published_sheet_names_its_source_and_edition(name: str) -> None:
    sheet = published()[name]
    assert sheet.models
    assert sheet.edition
    assert sheet.source
    assert read_sheet(name) == sheet


def test_limits_are_converted_from_the_units_of_the_sheet() -> None:
    """0.0035 °/s/√Hz is 0.21 °/√h; a one-sided density is √2 N; in-run stability is 0.664 B."""
    report = make_report()
    n, b = report.channels["gyro/x"].coefficients["N"], report.channels["gyro/x"].coefficients["B"]
    assert n.value is not None
    checks = {(c.channel, c.quantity): c for c in conformity(report, published()["vn-100"]).checks}
    found = checks["gyro/x", "N"]
    assert found.value == pytest.approx(np.degrees(n.value))
    assert found.limit * 60.0 == pytest.approx(0.21)
    other = {(c.channel, c.quantity): c for c in conformity(report, published()["adis16405"]).checks}
    assert other["gyro/x", "density"].value == pytest.approx(np.sqrt(2.0) * np.degrees(n.value))
    assert b.high is not None
    assert other["gyro/x", "floor"].high == pytest.approx(0.664 * np.degrees(b.high), rel=1e-3)


def test_only_the_data_sheet_of_the_measured_model_is_used() -> None:
    report = make_report()
    titles = {
        "VN-100T-CR": "VectorNav VN-100",
        "ADIS16470": "Analog Devices ADIS16470",
        "VN-200": None,
        None: None,
    }
    for model, title in titles.items():
        made = evaluated(replace(report, device=replace(report.device, model=model))).evaluation
        assert (made.conformity.title if made.conformity else None) == title
        text = shown(
            evaluated(replace(report, device=replace(report.device, model=model, id="a", setting_texts={})))
        )
        assert ("## Data sheet: VectorNav VN-100" in text) == (title == "VectorNav VN-100")
        assert "laboratory" not in text
    assert sheet_of_model(None) is None


def test_what_the_stream_does_not_show_is_undecided() -> None:
    report = make_report()
    sheet = published()["vn-100"]

    def verdicts(changed: Report, letter: str) -> set[str]:
        return {
            c.verdict
            for c in conformity(changed, sheet).checks
            if c.quantity == letter and c.channel[:4] == "gyro"
        }

    high = {
        n: with_coefficients(c, N=c.coefficients["N"].scaled(10.0, "rad/s/sqrt(Hz)"))
        for n, c in report.channels.items()
        if n[:4] == "gyro"
    }
    worse = replace(report, channels=report.channels | high)
    assert verdicts(replace(worse, device=replace(report.device, alias_factor=1.0)), "N") == {"fail"}
    assert verdicts(worse, "N") == {"undecided"}
    assert "undecided" in verdicts(replace(report, caveats=("compensated",)), "floor")
    assert "pass" not in verdicts(replace(report, caveats=("compensated",)), "floor")


def test_a_data_sheet_on_the_command_line(recording: Path, tmp_path: Path) -> None:
    n = 6e-5 * COEFFICIENTS["N"].units["gyro"].factor
    for limit, expected in ((2.0 * n, "pass"), (0.5 * n, "fail")):
        sheet = sheet_file(tmp_path, gyro=limit)
        report = replayed(recording, "--datasheet", sheet, "--filter", "20")
        checks = {(c.channel, c.quantity): c for c in report.evaluation.conformity.checks}
        of_gyro = {(f"gyro/{axis}", "N") for axis in "xyz"}
        assert set(checks) == of_gyro | {("accel/x", "floor"), ("accel/y", "floor")}
        assert checks["gyro/x", "N"].verdict == expected
        assert checks["accel/x", "floor"].verdict in ("pass", "undecided")
        page = shown(report)
        assert "Rev. C, 2026" in page
        assert f"| {expected} " in page
    printed = imumon("replay", recording, "--datasheet", sheet)  # a fail that the unknown filter may cause
    assert "data sheet: Acme A1 (A1 data sheet)" in printed
    assert "undecided (the filter of the sensor is unknown: aliasing may raise N)" in printed


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("title = 3", "title is not a text"),
        ("= 1", "sheet"),
        ('title = "a"', "'document' is missing"),
        ('title = "a"\ndocument = "b"', "no [[limit]]"),
        (SHEET.format(gyro=-1.0), "at_most is not a positive number"),
        (SHEET.format(gyro=1.0).replace("deg/sqrt(h)", "deg/h"), "unit of N of gyro is not one of"),
        (SHEET.format(gyro=1.0).replace('"floor"', '"sigma"'), "quantity is not one of"),
        (SHEET.format(gyro=1.0).replace("accel/x", "accel/w"), "is no channel"),
        (SHEET.format(gyro=1.0).replace("typical", "guess"), "basis is not one of"),
        (SHEET.format(gyro=1.0).replace("edition", "edtion"), "unknown field 'edtion'"),
    ],
)
def test_a_fault_of_a_sheet_is_one_line(text: str, fault: str, recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "sheet.toml"
    path.write_text(text)
    with pytest.raises(SheetError) as raised:
        read_sheet(path)
    assert raised.value.code == "datasheet_invalid"
    assert fault in raised.value.message
    assert len(raised.value.message.splitlines()) == 1


def test_a_sheet_that_is_not_of_this_sensor_is_refused(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "x.json"
    saved.write_text(to_json(make_report()))
    assert "VN-100T-CR" in imumon("report", saved, "--datasheet", "adis16405", code=2)
    assert "vn-100" in imumon("report", saved, "--datasheet", tmp_path / "nothing.toml", code=2)


# ---------------------------------------------------------------- uncertainty


def test_a_budget_adds_up() -> None:
    report = make_report()
    budgets = uncertainty_budgets(report)
    measured = {
        (name, letter)
        for name, channel in report.channels.items()
        for letter, part in channel.coefficients.items()
        if part.status == "measured"
    }
    assert {(name, letter) for name, each in budgets.items() for letter in each} == measured
    for name, letter in measured:
        budget, part = budgets[name][letter], report.channels[name].coefficients.get(letter)
        known = [c.standard for c in budget.components if c.standard is not None]
        assert budget.combined == pytest.approx(np.sqrt(np.sum(np.square(known))))
        assert budget.coverage >= 1.95
        assert budget.low <= part.low < budget.value < part.high <= budget.high
        assert budget.expanded == pytest.approx((budget.high - budget.low) / 2.0)
        relative = budget.coverage * budget.combined / budget.value
        assert np.log(budget.high / budget.low) / 2.0 == pytest.approx(relative, rel=0.05)
        assert budget.expanded >= 0.99 * (part.high - part.low) / 2.0
        assert {c.source for c in budget.components} >= {"statistics", "scatter", "resolution", "time base"}
        assert ("aliasing" in {c.source for c in budget.components}) == (letter == "N")


def test_a_budget_that_cannot_be_is_rejected() -> None:
    """N, B and K are above 0, a bias may be negative, an uncertainty is not."""
    report = evaluated(make_report())
    made = report.evaluation.budgets["gyro/x"]["N"]
    part = made.components[0]

    def read(budgets: dict[str, Any], bias: dict[str, Any]) -> Report:
        evaluation = replace(report.evaluation, budgets=budgets, bias_budgets=bias)
        return from_json(Report, to_json(replace(report, evaluation=evaluation)))

    read({}, {"gyro/x": replace(made, value=-1e-3)})
    for value in (0.0, -made.value):
        with pytest.raises(ValueError, match="a budget"):
            read({"gyro/x": {"N": replace(made, value=value)}}, {})
    wrong = (
        replace(made, combined=-1.0), replace(made, expanded=-1.0), replace(made, coverage=-1.0),
        replace(made, components=(replace(part, standard=-1.0),)),
    )  # fmt: skip
    for each in (replace(made, value=0.0), *wrong):
        with pytest.raises(ValueError, match="a budget of 0, or a negative"):
            read({}, {"gyro/x": each})


def test_the_alias_factor_of_deltas_is_not_that_of_the_magnetometer() -> None:
    """The magnetometer has point samples beside deltas; its filter is not that of the gyroscope."""
    report = make_report()
    report = replace(report, device=replace(report.device, alias_factor=1.0))
    mag = {"mag/x": replace(report.channels["accel/x"], unit="gauss")}
    budgets = uncertainty_budgets(replace(report, channels=report.channels | mag))
    for name, standard in (("gyro/x", 0.0), ("mag/x", None)):
        (part,) = (c for c in budgets[name]["N"].components if c.source == "aliasing")
        assert part.standard == standard
    assert "filter of mag is unknown" in part.basis


def with_excess(excess: Excess | None) -> tuple[Report, UncertaintyBudget]:
    """Return a report of one channel whose N has this excess, evaluated, and its budget."""
    report = make_report()
    channel = report.channels["gyro/x"]
    moved = with_coefficients(channel, N=replace(channel.coefficients["N"], excess=excess))
    device = replace(report.device, model="A1")
    made = evaluated(replace(report, channels={"gyro/x": moved}, device=device))
    return made, made.evaluation.budgets["gyro/x"]["N"]


def test_scatter_that_shows_has_three_degrees_of_freedom() -> None:
    shown_, budget = with_excess(Excess(value=0.1, low=0.05, high=0.4, p_value=1e-4))
    (part,) = (c for c in budget.components if c.source == "scatter")
    assert part.standard == pytest.approx(0.05 * budget.value)  # of the mean of four quarters
    assert budget.dof == pytest.approx(3.0, rel=1e-3)
    assert budget.coverage == pytest.approx(3.18, abs=0.01)  # Student's t
    n = shown_.channels["gyro/x"].coefficients["N"]
    assert (n.combined_low, n.combined_high) == (budget.low, budget.high)
    assert np.log(budget.high / budget.value) == pytest.approx(3.18 * 0.05, rel=0.05)


def test_scatter_that_does_not_show_is_a_bound_and_not_combined() -> None:
    made, budget = with_excess(Excess(low=0.0, high=0.1, p_value=0.6))
    (part,) = (c for c in budget.components if c.source == "scatter")
    assert part.standard is None
    assert part.bound == pytest.approx(0.05 * budget.value)
    assert budget.coverage == pytest.approx(1.96, abs=0.001)
    assert budget.combined == with_excess(None)[1].combined
    assert "(\\< 5.0 %)" in shown(made)


def test_one_interval_is_in_all_tables_of_a_document_and_decides_the_verdict(tmp_path: Path) -> None:
    """The limits of the fit pass, the combined ones do not."""
    made, budget = with_excess(Excess(value=0.1, low=0.05, high=0.4, p_value=1e-4))
    n = made.channels["gyro/x"].coefficients["N"]
    factor = COEFFICIENTS["N"].units["gyro"].factor
    sheet = sheet_file(tmp_path, gyro=0.5 * (n.high + n.combined_high) * factor)
    text = coefficient_text(n)
    page = shown(evaluated(made, read_sheet(sheet)))
    assert page.count(text) == 3  # the coefficients, the check, the budget
    assert f"{n.high * factor:.4g}" not in text
    (check,) = evaluated(made, read_sheet(sheet)).evaluation.conformity.checks
    assert (check.verdict, check.high) == ("undecided", pytest.approx(budget.high * factor))
    assert 0.9 < check.probability < 0.975


def test_rounding_is_a_component_of_n() -> None:
    report = make_report()
    channel = report.channels["gyro/x"]
    assert channel.std is not None
    for step, known in ((channel.std, True), (3.0 * channel.std, False)):
        coarse = replace(channel, resolution=step)
        budget = uncertainty_budgets(replace(report, channels={"gyro/x": coarse}))["gyro/x"]["N"]
        part = next(c for c in budget.components if c.source == "resolution")
        assert (part.standard is not None) == known
        if part.standard is not None:
            assert part.standard == pytest.approx(
                step**2 / (24.0 * RATE * budget.value) / np.sqrt(12.0), rel=0.1
            )


def test_the_resolution_of_rounded_values_is_reported(tmp_path: Path) -> None:
    noise = np.round(synthesise(4000, HZ, N=[6e-4] * 3 + [1.4e-2] * 3, seed=4) / 1e-3) * 1e-3
    np.savez(
        tmp_path / "r.npz", t=np.arange(4000) / HZ, gyro=noise[:, :3], accel=noise[:, 3:] + [0.0, 0.0, 9.8]
    )
    report = replayed(tmp_path / "r.npz")
    assert report.channels["gyro/x"].resolution == pytest.approx(1e-3, rel=1e-3)
    assert make_report().channels["gyro/x"].resolution is None


def test_the_sheet_names_what_the_budget_does_not_cover() -> None:
    text = shown(evaluated(make_report()))
    assert "Not covered: temperatures outside" in text
    assert "moves away and does not return: its limits hold its mean over this record" in text
    assert "turn-on" in text
    bare = replace(
        make_report(), channels={n: c for n, c in make_report().channels.items() if n != "temperature"}
    )
    assert "the temperature: it is not in the record" in shown(evaluated(bare))


# ---------------------------------------------------------------- traceability


def test_a_report_names_program_input_and_options(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.json"
    imumon("report", recording, "--no-guards", "--stream", "uncompensated", "-o", saved)
    made = from_json(Report, saved.read_text()).evaluation
    origin = made.provenance
    assert origin.software.startswith("imumon ")
    assert origin.commit
    assert (origin.input, origin.input_bytes) == ("rest.csv", recording.stat().st_size)
    assert origin.input_sha256 == hashlib.sha256(recording.read_bytes()).hexdigest()
    assert origin.options == {"--stream": "uncompensated", "--no-guards": ""}
    assert origin.guards is False
    page = imumon(
        "report", saved, "--format", "md"
    )  # from the saved report: the origin stays that of the numbers
    for text in (origin.input_sha256, origin.commit, "imumon.report/1", "--no-guards", origin.host or "-"):
        assert text in page


def test_standard_input_has_no_digest(recording: Path) -> None:
    done = forked.run("replay", "-", "--json", text=recording.read_bytes())
    origin = json.loads(done.stdout)["evaluation"]["provenance"]
    assert (origin["input_sha256"], origin["input_reason"]) == (None, "read from standard input")


def test_the_digest_of_a_directory_is_of_all_its_files(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for name, data in (("b.db3", b"two"), ("a.yaml", b"one")):
        (bag / name).write_bytes(data)
    made = with_provenance(make_report(), str(bag), {}, None).evaluation
    assert made.provenance.input_sha256 == hashlib.sha256(b"onetwo").hexdigest()
    assert made.provenance.input == "bag"


def test_excluded_intervals_have_begin_and_end() -> None:
    report = replace(make_report(), events=_events())
    text = shown(with_provenance(report, None, {}, True))
    rows = ("| 0.00 s     | 594.00 s   | 2026-03-01T08:00:00.000Z | a warm-up",
            "| 400.13 s   | 400.14 s   | 2026-03-01T08:06:40.130Z | glitch",
            "| 1,000.00 s | 1,002.00 s | 2026-03-01T08:16:40.000Z | knock")  # fmt: skip
    at = [text.find(row) for row in rows]
    assert -1 not in at
    assert at == sorted(at)
    assert len(excluding_events(report)) == 3  # the first warm-up is part of the second


def _events() -> tuple[Event, ...]:
    rows = (
        ("disturbance", 400.13, 0.01, "glitch on gyro/x: 0.01 s excluded"),
        ("disturbance", 1000.0, 2.0, "knock on gyro/x: 2 s excluded"),
        ("warmup", 1500.0, 300.0, "a warm-up of 5 min is over and excluded"),
        ("warmup", 1638.0, 594.0, "a warm-up of 9 min 54 s is over and excluded"),
    )
    return tuple(
        Event(time=make_report().time, kind=kind, text=text, device="a", elapsed_s=at, length_s=length)
        for kind, at, length, text in rows
    )


# ---------------------------------------------------------------- what a customer reads


@needs_recordings
@pytest.mark.slow
def test_nothing_refers_to_a_device_that_was_not_measured(tmp_path: Path) -> None:
    for name, words, wrong in (
        ("adis16405_1.npz", (), ("VN-100", "laboratory")),
        ("kiran_stat5min.vnymr.txt.gz", ("--rate", "40"), ("ADIS", "laboratory")),
    ):
        saved = tmp_path / "saved.json"
        imumon("report", RECORDINGS / name, *words, "-o", saved)
        for form in ("md", "html", "csv", "svg"):
            text = imumon("report", saved, "--format", form)
            assert not [word for word in wrong if word in text], (name, form)


# ---------------------------------------------------------------- item


def test_the_item_is_in_every_document(recording: Path, tmp_path: Path) -> None:
    item = tmp_path / "item.toml"
    item.write_text('operator = "A. Person"\nambient = "23.1 °C, 45 %"\nplace = "room 3"\n')
    out = tmp_path / "x.json"
    imumon("report", recording, "--item", item, "--item", "serial=S-17", "--item", "place=room 4", "-o", out)
    report = from_json(Report, out.read_text())
    assert (report.item.operator, report.item.place, report.device.serial) == ("A. Person", "room 4", "S-17")
    for form in ("md", "html"):
        page = imumon("report", out, "--format", form, "--item", "note=<script>x</script>")
        for text in ("A. Person", "23.1 °C, 45 %", "room 4", "S-17", "not stated"):
            assert text in page
        assert "<script>" not in page
    assert "Item and measurement" not in imumon("report", recording)


@pytest.mark.parametrize(
    "word",
    [
        "colour=red", "operator=", "note=" + "x" * 1_000_000, "nothing.toml", "=", "operator",
        "FILE:operator = 3\n[place]\n", "FILE:= 1", "FILE:colour = 'red'", "FILE:note = '" + "x" * 200_000,
        "note=a\nb", "note=a\tb", "note=\x1b[2J", "note=a\u202eb", 'FILE:note = "a\\nb"',
    ],
)  # fmt: skip
def test_a_wrong_item_is_one_line(word: str, saved: Path, tmp_path: Path) -> None:
    if word.startswith("FILE:"):
        (tmp_path / "item.toml").write_text(word[5:])
        word = str(tmp_path / "item.toml")
    message = imumon("report", saved, "--item", word, code=2)
    assert message.startswith("imumon: --item: ")
    assert len(message.splitlines()) == 1
    assert len(message) < 400


def test_the_date_of_a_record_is_known_where_its_clock_shows_it(recording: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(recording, delimiter=",", skiprows=1)
    np.savez(tmp_path / "unix.npz", t=rows[:, 0] + 1.75e9, gyro=rows[:, 1:4], accel=rows[:, 4:])
    assert replayed(tmp_path / "unix.npz").session.started == "2025-06-15T15:06:40.000Z"
    assert replayed(recording).session.started is None
    assert "| Start | 2025-06-15T15:06:40.000Z |" in " ".join(imumon("report", tmp_path / "unix.npz").split())


def test_strict_settings_rest_on_measured_numbers_only(saved: Path, tmp_path: Path) -> None:
    out = tmp_path / "imu.yaml"
    message = imumon("report", saved, "--strict", "-o", out, code=1)
    assert message.startswith("imumon: --strict: not measured, but at most bounded: gyro/x B, gyro/x K")
    assert not out.exists()
    assert "--strict is for settings" in imumon(
        "report", saved, "--strict", "-o", tmp_path / "x.html", code=2
    )
    assert "linear_acceleration_covariance" in imumon("report", saved, "--strict", "--format", "ros")
    assert "# " in imumon("report", saved, "--format", "kalibr")


def test_the_exact_curve_has_the_samples_of_the_other_with_guards(recording: Path, tmp_path: Path) -> None:
    """A knock is excluded from both; the difference stays that of the overlap."""
    rows = np.loadtxt(recording, delimiter=",", skiprows=1)
    rows = np.vstack([rows + np.eye(7)[0] * later for later in (0.0, 50.0, 100.0)])
    rows[4000:4040, 1:4] += np.sin(np.arange(40))[:, None]
    np.savez(tmp_path / "k.npz", t=rows[:, 0], gyro=rows[:, 1:4], accel=rows[:, 4:])
    report = replayed(tmp_path / "k.npz", "--exact")
    assert report.session.excluded_s > 0.5
    curve = report.evaluation.exact["gyro/x"]
    assert curve.tau_s[-1] > 10.0
    assert max(abs(d) for d, tau in zip(curve.difference, curve.tau_s, strict=True) if d and tau < 5.0) < 0.05
    assert ">exact<" in shown(report, "svg")


# ---------------------------------------------------------------- words and the table of numbers


def table_of(report: Report) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(shown(report, "csv"))))


def test_each_row_of_the_table_has_its_device_caveats_and_origin(recording: Path) -> None:
    report = replayed(recording, "--filter", "factory", "--no-guards")
    rows = table_of(report)
    digest = hashlib.sha256(recording.read_bytes()).hexdigest()
    assert {row["sha256"] for row in rows} == {digest}
    assert {row["device"] for row in rows} == {"rest.csv"}
    assert all(row["unit"] for row in rows if row["value"])
    n = report.channels["gyro/x"].coefficients["N"]
    (own,) = (r for r in rows if (r["kind"], r["channel"], r["name"]) == ("coefficient", "gyro/x", "N"))
    assert [float(own[key]) for key in ("low", "combined_low", "combined_high", "k")] == pytest.approx(
        [n.low, n.combined_low, n.combined_high, report.evaluation.budgets["gyro/x"]["N"].coverage]
    )
    assert set(own["caveats"].split()) == set(report.channels["gyro/x"].caveats)
    (corrected,) = (r for r in rows if (r["kind"], r["channel"]) == ("corrected", "gyro/x"))
    assert float(own["value"]) / float(corrected["value"]) == pytest.approx(np.sqrt(5.0))


def test_n_without_aliasing_stands_beside_the_read_one(recording: Path) -> None:
    page = imumon("report", recording, "--filter", "factory")
    assert page.count("N without aliasing (read N / 2.24, nominal)") == 2
    assert "without aliasing" not in imumon("report", recording, "--filter", "20")


def test_words_are_explained_where_they_are_printed(recording: Path, saved: Path) -> None:
    for text in (imumon("replay", recording), imumon("report", saved)):
        assert "best one whose limits all N and B allow" in " ".join(text.split())
    for form in ("filter", "kalibr", "px4", "ros"):
        text = " ".join(imumon("report", saved, "--format", form).replace("#", "").split())
        assert ("A fix is a measurement" in text) == ("fix" in text.replace("prefix", "")), form
    page = imumon("report", saved).partition("## For Kalibr")[0]
    assert page.count("noise folds") == 1
    assert "--filter names it" in page


def test_a_table_whose_spectrum_shows_a_filter_has_no_warning_that_noise_folds(tmp_path: Path) -> None:
    noise = synthesise(20_000, HZ, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    smooth = sum(noise[k : k + 19_990] for k in range(8)) / 8.0
    smooth[:, 5] += 9.8
    np.savez(tmp_path / "s.npz", t=np.arange(len(smooth)) / HZ, gyro=smooth[:, :3], accel=smooth[:, 3:])
    report = replayed(tmp_path / "s.npz")
    assert all("correlated" in channel.caveats for channel in report.channels.values())
    assert "noise folds" not in shown(report)


def test_readings_with_a_vibration_and_misfits_are_marked() -> None:
    report = evaluated(report_at(7200.0))
    page = shown(report)
    (row,) = [line for line in page.partition("## The fit")[2].splitlines() if line.startswith("| accel/y")]
    assert "\\*" in row
    assert "has a line, a vibration or an oscillation in it" in page
    worse = replace(report.channels["gyro/z"], caveats=("misfit",))
    page = shown(replace(report, channels={**report.channels, "gyro/z": worse}))
    assert "Caution: misfit (z); see above." in page


def _misfits_are_caveats(report: Report) -> int:
    """Check every channel; return how many have the caveat."""
    known = [c for c in report.channels.values() if c.fit is not None and c.fit.p_value is not None]
    for channel in known:
        # one record in a hundred, whatever the number of its channels
        assert ("misfit" in channel.caveats) == (channel.fit.p_value < 0.01 / len(known))
    return sum("misfit" in channel.caveats for channel in known)


@pytest.mark.parametrize("age", [200.0, 900.0, 7200.0])
def test_a_model_that_does_not_fit_has_a_caveat(age: float) -> None:
    _misfits_are_caveats(report_at(age))


@needs_recordings
@pytest.mark.parametrize("name", ["instinct_vn310_static.npz", "rob_static2.npz"])
def test_a_real_record_that_does_not_fit_has_a_caveat(name: str) -> None:
    # one of them at least: Gauss–Markov noise describes others
    assert _misfits_are_caveats(replayed(RECORDINGS / name)) >= 1


def test_every_command_and_the_screen_state_the_combined_limits() -> None:
    report = make_report()
    channel = report.channels["gyro/x"]
    low, value, high = 1e-5, 4e-5, 9e-5
    part = Estimate(
        value=value,
        low=0.99 * value,
        high=1.01 * value,
        combined_low=low,
        combined_high=high,
        status="measured",
        unit="rad/s/sqrt(Hz)",
    )
    made = replace(
        report, channels={"gyro/x": replace(channel, coefficients={**channel.coefficients, "N": part})}
    )
    factor = part.readable.value / value
    assert Notation(si=True).limits(part) == (value, low, high)
    assert Notation().limits(part) == pytest.approx((factor * value, factor * low, factor * high))
    assert figures(factor * high) in "\n".join(channel_rows(made, None))
    condition = WaitCondition(channels=("gyro/x",), coefficient="N", precision=0.05)
    assert "known to 1.0" in (condition.unmet(made) or "")
    assert not coefficient_ratio(part, replace(part, value=1.1 * value)).differs
