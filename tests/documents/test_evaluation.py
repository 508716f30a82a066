"""Evaluation: combined limits, data sheets, a filter that is named, and what a document says beside a number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from paths import RECORDINGS, needs_recordings
from reports import RATE, with_coefficients
from reports import report as report_at

from imumon.api.document_report import document_report
from imumon.api.replay_options import SensorFilter
from imumon.cli.wait_condition import WaitCondition
from imumon.documents import document
from imumon.documents.references import SheetError, published, read_sheet, sheet_of_model
from imumon.documents.references.comparison import compared
from imumon.documents.report_texts import coefficient_text
from imumon.model.coefficients import COEFFICIENTS, Estimate, Excess, coefficient_ratio
from imumon.model.filter_report import FilterReport
from imumon.model.history_report import DayScatter
from imumon.model.report import Report, from_json
from imumon.model.samples import GYRO
from imumon.model.units import figures
from imumon.record.combined_limits import shared_share, with_combined
from imumon.sources.files.base import OptionError
from imumon.tui.formatting import Notation

SHOWN = Excess(value=0.1, low=0.05, high=0.4, p_value=1e-4)
"""Quarters that scatter by 10 % beyond their statistics."""


def width(part: Estimate) -> float:
    """Return the width of the combined limits, as the half-width of the logarithm."""
    return 0.5 * np.log(part.combined_high / part.combined_low)


def n_of(channel: dict[str, object]) -> Estimate:
    return channel["gyro/x"].coefficients["N"]


def with_excess(excess: Excess | None) -> Report:
    """Return a report of one channel whose N has this excess."""
    report = make_report()
    channel = report.channels["gyro/x"]
    moved = with_coefficients(channel, N=replace(channel.coefficients["N"], excess=excess))
    changed = replace(report, channels={GYRO[0]: moved}, device=replace(report.device, model="A1"))
    return replace(changed, channels=with_combined(changed))


def test_the_combined_limits_hold_those_of_statistics_and_a_bound_is_its_own() -> None:
    report = make_report()
    for channel in with_combined(report).values():
        for part in channel.estimates.values():
            if part.status == "measured":
                assert part.combined_low <= part.low < part.value < part.high <= part.combined_high
            else:
                assert (part.combined_low, part.combined_high, part.dof) == (part.low, part.high, None)
    assert with_combined(replace(report, channels=with_combined(report))) == with_combined(report)


def test_scatter_that_shows_has_three_degrees_of_freedom() -> None:
    n = n_of(with_excess(SHOWN).channels)
    assert n.dof == pytest.approx(3.0, rel=1e-3)
    # Student's t, of the mean of four quarters
    assert np.log(n.combined_high / n.value) == pytest.approx(3.18 * 0.05, rel=0.05)
    unseen = n_of(with_excess(Excess(low=0.0, high=0.1, p_value=0.6)).channels)
    assert (unseen.combined_low, unseen.combined_high) == n_of(with_excess(None).channels).interval


def test_days_of_the_history_widen_the_limits() -> None:
    report = make_report()
    alone = n_of(with_combined(report))
    days = DayScatter(days=20, std=0.1 * alone.value, statistics=0.01 * alone.value)
    known = n_of(with_combined(report, {GYRO[0]: {"N": days}}))
    assert width(known) > np.sqrt(0.1**2 - 0.01**2) * 1.95
    agreeing = replace(days, std=0.005 * alone.value)
    assert width(n_of(with_combined(report, {GYRO[0]: {"N": agreeing}}))) == pytest.approx(width(alone))


def test_rounding_counts_where_the_noise_is_not_finer_than_the_steps() -> None:
    report = make_report()
    channel = report.channels["gyro/x"]
    n = channel.coefficients["N"].value
    shares = {}
    for step in (None, channel.std, 3.0 * channel.std):
        coarse = replace(channel, resolution=step)
        shares[step] = shared_share(replace(report, channels={GYRO[0]: coarse}), GYRO[0], "N")
    rounding = channel.std**2 / (24.0 * RATE * n**2) / np.sqrt(12.0)
    assert np.sqrt(shares[channel.std] ** 2 - shares[None] ** 2) == pytest.approx(rounding, rel=0.1)
    assert shares[3.0 * channel.std] == shares[None]  # nothing is known of it


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
        report, channels={GYRO[0]: replace(channel, coefficients={**channel.coefficients, "N": part})}
    )
    factor = part.readable.value / value
    assert Notation(si=True).limits(part) == (value, low, high)
    assert Notation().limits(part) == pytest.approx((factor * value, factor * low, factor * high))
    assert figures(factor * high) in coefficient_text(part)
    condition = WaitCondition(channels=(GYRO[0],), coefficient="N", precision=0.05)
    assert "known to 1.0" in (condition.unmet(made) or "")
    assert not coefficient_ratio(part, replace(part, value=1.1 * value)).differs


# ---------------------------------------- reports, documents and recordings


HZ = 40.0
"""Rate of the recordings that the tests make."""


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


def make_report() -> Report:
    """Return the report of a quarter of an hour."""
    return report_at(900.0)


def shown(report: Report, form: str = "md") -> str:
    return document(report, form, FilterReport(time=report.time, device=report.device)).decode()


def replayed(*words: object) -> Report:
    return from_json(Report, imumon("replay", *words, "--json"))


def sheet_file(tmp_path: Path, *, gyro: float) -> Path:
    path = tmp_path / "sheet.toml"
    path.write_text(SHEET.format(gyro=gyro))
    return path


# ---------------------------------------- a sensor beside its data sheet


def test_limits_are_converted_from_the_units_of_the_sheet() -> None:
    """0.0035 °/s/√Hz is 0.21 °/√h; a one-sided density is √2 N; in-run stability is 0.664 B."""
    report = make_report()
    values = {(v.channel, v.quantity): v for v in compared(report, read_sheet("vn-100")).values}
    found = values["gyro/x", "N"]
    assert (found.printed, found.printed_unit, found.unit) == (0.0035, "deg/s/sqrt(Hz)", "rad/s/sqrt(Hz)")
    assert found.value == pytest.approx(np.radians(0.0035))
    other = {(v.channel, v.quantity): v for v in compared(report, published()["adis16405"]).values}
    density, floor = other["gyro/x", "density"], other["gyro/x", "floor"]
    assert density.value == pytest.approx(np.radians(density.printed) / np.sqrt(2.0))
    assert floor.value == pytest.approx(np.radians(floor.printed) / 0.664, rel=1e-3)


def test_only_the_data_sheet_of_the_measured_model_is_used() -> None:
    report = make_report()
    titles = {
        "VN-100T-CR": "VectorNav VN-100",
        "ADIS16470": "Analog Devices ADIS16470",
        "VN-200": None,
        None: None,
    }
    for model, title in titles.items():
        device = replace(report.device, model=model, id="a", setting_texts={})
        made = document_report(replace(report, device=device))
        assert (made.data_sheet.title if made.data_sheet else None) == title
        text = shown(made)
        assert ("data sheet of VectorNav" in text) == (title == "VectorNav VN-100")
        assert ("data sheet" in text) == (title is not None)
        assert "laboratory" not in text
    assert sheet_of_model(None) is None
    assert "250 times a second, unfiltered" in (published()["vn-100"].note or "")  # two lines of the file


def test_n_that_aliasing_raises_is_not_said_to_be_above() -> None:
    report, sheet = make_report(), published()["vn-100"]
    high = {
        n: with_coefficients(c, N=c.coefficients["N"].scaled(10.0, "rad/s/sqrt(Hz)"))
        for n, c in report.channels.items()
        if n[:4] == "gyro"
    }

    def gyro_n(alias_factor: float | None) -> set[tuple[bool | None, bool]]:
        device = replace(report.device, alias_factor=alias_factor, stream="uncompensated")
        worse = replace(report, channels=report.channels | high, device=device)
        values = compared(worse, sheet).values
        return {(v.above, v.reason is None) for v in values if v.quantity == "N" and v.channel[:4] == "gyro"}

    assert gyro_n(1.0) == {(True, True)}
    assert gyro_n(2.0) == gyro_n(None) == {(None, False)}


def test_a_data_sheet_on_the_command_line(recording: Path, tmp_path: Path) -> None:
    n = 6e-5 * COEFFICIENTS["N"].units["gyro"].factor
    for limit, above in ((2.0 * n, False), (0.5 * n, True)):
        sheet = sheet_file(tmp_path, gyro=limit)
        report = replayed(recording, "--datasheet", sheet, "--filter", "20")
        values = {(v.channel, v.quantity): v for v in report.data_sheet.values}
        of_gyro = {(f"gyro/{axis}", "N") for axis in "xyz"}
        assert set(values) == of_gyro | {("accel/x", "floor"), ("accel/y", "floor")}
        assert values["gyro/x", "N"].above == above
        page = shown(report)
        assert "Rev. C, 2026" in page
        assert "Above: the whole interval is above" in page
        assert ("; above " in page) == above
    assert "above the data sheet " in imumon("replay", recording, "--datasheet", sheet)
    printed = imumon(
        "replay", recording, "--datasheet", sheet, "--verbose"
    )  # N may be raised: the filter is unknown
    assert "Rev. C, 2026" in printed
    assert "aliasing" in printed


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('title = 3\ndocument = "b"', "'int' instead of str"),
        ("= 1", "sheet"),
        ('title = "a"', "without document"),
        ('title = "a"\ndocument = "b"', "no [[limit]]"),
        (SHEET.format(gyro=-1.0), "is not positive"),
        (SHEET.format(gyro=1.0).replace("deg/sqrt(h)", "deg/h"), "unit of N of gyro is not one of"),
        (SHEET.format(gyro=1.0).replace('"floor"', '"sigma"'), "quantity is not one of"),
        (SHEET.format(gyro=1.0).replace("accel/x", "accel/w"), "is no channel"),
        (SHEET.format(gyro=1.0).replace("typical", "guess"), "'guess' is not one of maximum, typical"),
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


# ---------------------------------------- the filter before the samples


@pytest.mark.parametrize(
    ("text", "factor", "assumed"),
    [
        ("none", np.sqrt(800.0 / HZ), "rate before the filter"),
        ("4", np.sqrt(800.0 / (4 * HZ)), "rate before the filter"),
        ("factory", np.sqrt(5.0), "filter"),
        ("20", 1.0, "rate before the filter"),
        ("10@1000", np.sqrt(1000.0 / (10 * HZ)), None),
    ],
)
def test_a_filter_that_is_named_has_a_factor_and_assumes_a_vn100(
    text: str, factor: float, assumed: str | None
) -> None:
    """The window of a VN-100 averages samples of 800 Hz; a table may be of another sensor."""
    named = SensorFilter.parse(text)
    assert named.alias_factor(None, HZ) == pytest.approx(factor, rel=1e-6)
    said = named.assumption(None) or ""
    assert (f"the recording names no device: its {assumed} is assumed to be " in said) == (
        assumed is not None
    )


@pytest.mark.parametrize("text", ["boxcar", "0.5", "-4", "4@0", "factory@100", "@800"])
def test_what_is_no_filter_is_refused(text: str) -> None:
    with pytest.raises(OptionError) as error:
        SensorFilter.parse(text)
    assert error.value.code == "filter_invalid"


def test_a_named_filter_answers_what_the_recording_does_not_say(recording: Path, saved: Path) -> None:
    unknown = from_json(Report, saved.read_text())
    assert (unknown.device.alias_factor, unknown.device.settings, "aliased" in unknown.caveats) == (
        None,
        {},
        False,
    )
    report = replayed(recording, "--filter", "factory")
    assert report.device.alias_factor == pytest.approx(np.sqrt(5.0))
    assert "aliased" in report.caveats
    text, stated = shown(report), "the recording names no device: its filter is assumed to be "
    assert f"factory, as given with --filter; {stated}" in text
    assert f"--filter factory: {stated}" in text  # the remark, with what to do
    assert "give window and rate, such as 8@1000" in text
    imumon("replay", recording, "--filter=boxcar", code=2)


# ---------------------------------------- what a document says beside a number


def test_words_are_explained_where_they_are_printed(recording: Path, saved: Path) -> None:
    page = imumon("report", saved)
    for text in (imumon("replay", recording, "--verbose"), page):
        assert "best one whose limits no N and no B exceeds" in " ".join(text.split())
    for form in ("filter", "ros"):
        text = " ".join(imumon("report", saved, "--format", form).replace("#", "").split())
        assert ("A fix is a measurement" in text) == ("fix" in text.replace("prefix", "")), form
    numbers = page.partition("## Settings")[0]
    assert numbers.count("noise folds") == 1
    assert "--filter names it" in numbers


def _misfits_are_caveats(report: Report) -> int:
    """Check every channel; return how many have the caveat."""
    known = [c for c in report.channels.values() if c.fit is not None and c.fit.p_value is not None]
    for channel in known:
        # one record in a hundred, whatever the number of its channels
        assert ("misfit" in channel.caveats) == (channel.fit.p_value < 0.01 / len(known))
    return sum("misfit" in channel.caveats for channel in known)


@pytest.mark.few
@needs_recordings
@pytest.mark.parametrize("name", ["instinct_vn310_static.npz"])
def test_a_real_record_that_does_not_fit_has_a_caveat(name: str) -> None:
    # one of them at least: Gauss–Markov noise describes others
    assert _misfits_are_caveats(replayed(RECORDINGS / name, "--accept")) >= 1
