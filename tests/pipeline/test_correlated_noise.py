"""Laws of Gauss–Markov noise M in a report: its JSON, its shares, and everything that goes through the table."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import reports

from imumon.api import analyse
from imumon.documents import document
from imumon.documents.appendix import _notes
from imumon.documents.csv_table import csv_table
from imumon.documents.references.comparison import compared
from imumon.documents.references.reference_sheet import Limit, ReferenceSheet
from imumon.documents.summary import summary_text
from imumon.history import HistoryStore
from imumon.history.metrics import _gauges
from imumon.history.rows import rows
from imumon.history.selection import Selection
from imumon.history.store import TimedPeriod
from imumon.model.coefficients import (
    COEFFICIENTS,
    MARKOV,
    Estimate,
    MarkovEstimate,
    by_letter,
    markov_deviation,
)
from imumon.model.history_report import HistoryPeriod, PeriodChannel, history_rows
from imumon.model.report import Report, from_json
from imumon.model.report_json import to_json
from imumon.noise import markov_law, synthesise
from imumon.record.filter_report_builder import filter_report
from imumon.ros2.diagnostics import _axes


@pytest.fixture(scope="module")
def report() -> Report:
    return reports.correlated()


# ---------------------------------------------------------------------- the table


@pytest.mark.few
@pytest.mark.parametrize("time_s", [0.3, 57.0, 4000.0])
def test_the_allan_deviation_of_the_table_is_that_of_the_model(time_s: float) -> None:
    tau = 2.0 ** np.arange(-4.0, 16.0)
    drawn = [COEFFICIENTS["M"].deviation(tau_s, time_s) for tau_s in tau.tolist()]
    # in units of a sixteenth of a second, so that the shortest cluster is one sample
    law = markov_law.allan_variances((tau * 16.0).astype(np.int64), time_s * 16.0, averaged=True)
    assert drawn == pytest.approx(np.sqrt(law), rel=1e-4)


def test_the_hump_is_the_largest_deviation() -> None:
    tau_s = np.geomspace(1.0, 1e4, 20_001)
    sigma = [markov_deviation(t, 57.0) for t in tau_s.tolist()]
    row = COEFFICIENTS["M"]
    assert tau_s[int(np.argmax(sigma))] == pytest.approx(row.mark_s(1.0, 57.0), rel=1e-3)
    assert max(sigma) == pytest.approx(row.mark_height, rel=1e-4)
    assert (row.mark_s(1.0, None), COEFFICIENTS["T"].mark_s(1.0, 57.0)) == (None, None)


def test_a_time_constant_is_a_coefficient_only_where_it_is_measured() -> None:
    known, bound = (
        Estimate(value=1.0, low=0.5, high=2.0, status="measured"),
        Estimate(status="indistinct", high=3.0),
    )
    assert list(by_letter({"Q": known, "N": known}, MarkovEstimate(sigma=known, time_constant_s=known))) == [
        "N", "M", "T", "Q",
    ]  # fmt: skip
    assert list(by_letter({"N": known}, MarkovEstimate(sigma=bound, time_constant_s=bound))) == ["N", "M"]
    assert list(by_letter({"N": known}, None)) == ["N"]


# ---------------------------------------------------------------------- the report


def test_a_report_has_what_shows_and_bounds_what_is_not_separable(report: Report) -> None:
    shown, open_, flicker = (report.channels[f"gyro/{axis}"] for axis in "xyz")
    assert shown.M is not None
    assert open_.M is not None
    assert flicker.M is None
    for part, truth in ((shown.M.sigma, 4e-4), (shown.M.time_constant_s, 30.0)):
        assert part.status == "measured"
        assert (part.low or 0.0) <= truth <= (part.high or 0.0)
    assert (shown.M.sigma.unit, shown.M.time_constant_s.unit) == ("rad/s", "s")
    assert {open_.estimates[letter].status for letter in "BKM"} == {"indistinct"}
    assert all((open_.estimates[letter].high or 0.0) > 0.0 for letter in "BKM")
    assert (open_.M.sigma.high or 0.0) > 0.6e-4
    assert "T" not in open_.estimates


def test_the_json_has_sigma_and_time_constant_together(report: Report) -> None:
    data = json.loads(to_json(report))["channels"]
    assert set(data["gyro/x"]["M"]) == {"sigma", "time_constant_s"}
    assert data["gyro/x"]["M"]["sigma"]["readable"]["unit"] == "deg/h"
    assert data["gyro/z"]["M"] is None
    assert "T" not in data["gyro/x"]
    assert from_json(Report, to_json(report)) == report


@pytest.mark.few
@pytest.mark.parametrize("make", [reports.correlated, reports.report, reports.long_report])
def test_the_shares_add_up_to_the_drawn_model(make: object) -> None:
    drawn = 0
    for channel in make().channels.values():  # type: ignore[operator]
        if channel.model is None or channel.allan is None:
            continue
        variances = np.sum(list(channel.model.shares.values()), axis=0)
        assert variances == pytest.approx(np.square(channel.allan.model), rel=1e-5)
        assert {"N", "B", "K"} <= set(channel.model.shares) <= {*"NBKMQ", "filter", "lines", "columns"}
        drawn += 1
    assert drawn


def test_the_share_of_m_is_its_allan_deviation(report: Report) -> None:
    channel = report.channels["gyro/x"]
    assert channel.M is not None
    assert channel.model is not None
    assert channel.allan is not None
    sigma, time_s = channel.M.sigma.value or 0.0, channel.M.time_constant_s.value
    at_long = [k for k, tau_s in enumerate(channel.allan.tau_s) if tau_s > 1.0]
    drawn = [sigma * COEFFICIENTS["M"].deviation(channel.allan.tau_s[k], time_s) for k in at_long]
    # the drawn model is the likeliest one, and sigma and T are medians of what is likely
    assert np.sqrt([channel.model.shares["M"][k] for k in at_long]) == pytest.approx(drawn, rel=0.25)


# ---------------------------------------------------------------------- where people and programs see it


def test_the_tables_have_columns_for_both_and_a_word_for_what_is_open(report: Report) -> None:
    text = summary_text(report, 120)
    head = next(line for line in text.splitlines() if line.startswith("in °/s"))
    assert head.index(" M ") < head.index(" T s")
    row = next(line for line in text.splitlines() if line.startswith("gyro/y"))
    assert row.count(" open") == 3
    assert "open: it is B, K or M." in text
    other = summary_text(reports.report(200.0), 120)
    assert ("open:" in other) == (" open" in other.partition("±:")[0])


def test_a_table_has_a_row_for_each(report: Report) -> None:
    table = list(csv.DictReader(io.StringIO(csv_table(report))))
    found = {
        (row["channel"], row["name"]): row
        for row in table
        if row["kind"] == "coefficient" and row["name"] in MARKOV
    }
    assert set(found) == {("gyro/x", "M"), ("gyro/x", "T"), ("gyro/y", "M")}
    assert found["gyro/x", "T"]["unit"] == "s"
    assert (found["gyro/y", "M"]["status"], found["gyro/y", "M"]["value"]) == ("indistinct", "")


def test_metrics_and_diagnostics_have_both(report: Report) -> None:
    noise = next(samples for name, _, _, samples in _gauges(report, 0.0) if name == "imumon_noise")
    assert {("gyro/x", letter, "value") for letter in MARKOV} <= {sample[:3] for sample in noise}
    assert ("gyro/y", "M", "value") not in {sample[:3] for sample in noise}
    assert ("gyro/y", "M", "high") in {sample[:3] for sample in noise}
    texts = dict(_axes({"gyro/x": report.channels["gyro/x"], "gyro/y": report.channels["gyro/y"]}))
    assert texts["T x"].endswith(" s")
    assert texts["M y"].startswith("< ")
    assert texts["M y"].endswith(" open")


def test_a_data_sheet_may_have_m_and_t(report: Report) -> None:
    def limit(quantity: str, at_most: float, unit: str) -> Limit:
        return Limit(
            channels=("gyro/x", "gyro/y"), quantity=quantity, at_most=at_most, unit=unit, basis="maximum"
        )

    sheet = ReferenceSheet(title="a", document="b", limits=(limit("M", 50.0, "deg/h"), limit("T", 90.0, "s")))
    values = [(value.channel, value.quantity, value.above) for value in compared(report, sheet).values]
    assert values == [("gyro/x", "M", True), ("gyro/y", "M", False), ("gyro/x", "T", False)]


def test_the_history_keeps_both_and_the_statuses(report: Report, tmp_path: Path) -> None:
    channels = {
        name: PeriodChannel(coefficients=report.channels[name].estimates) for name in ("gyro/x", "gyro/y")
    }
    period = HistoryPeriod(
        step_s=86400, number=0, begin_age_s=0.0, end_age_s=0.0, complete=True, samples=9, missing=0,
        excluded_s=0.0, temperature=None, warming_up=False, channels=channels,
    )  # fmt: skip
    path = tmp_path / "imu.history.sqlite"
    with HistoryStore(path, write=True) as store:
        store.add([TimedPeriod(record="r", begin=0.0, end=86400.0, period=period)])
    ever = Selection(since=-1.0, until=1e12, step="1d")
    with HistoryStore(path) as store:
        stored = [row for timed in store.periods(ever) for row in rows(timed, "imu", ever)]
    x, y = history_rows(json.loads(json.dumps(stored)))
    for letter in MARKOV:
        assert x.coefficients[letter].value == pytest.approx(
            report.channels["gyro/x"].estimates[letter].value
        )
    assert [y.coefficients[letter].status for letter in "BKM"] == ["indistinct"] * 3
    assert x.coefficients["K"].status == report.channels["gyro/x"].coefficients["K"].status
    assert x.begin == datetime(1970, 1, 1, tzinfo=UTC)


def test_m_of_a_sensor_that_warms_up_is_a_bound(report: Report) -> None:
    from imumon.noise.fit import ChannelFit
    from imumon.record.analysis import _without_slow_values

    channel, zeros = report.channels["gyro/x"], np.zeros(1)
    fit = ChannelFit(
        coefficients=channel.coefficients, markov=channel.M, model=zeros, noise=zeros, used=zeros > 0.0,
        low=zeros, high=zeros, edf=zeros,
    )  # fmt: skip
    bounded = _without_slow_values(replace(fit))
    assert bounded.markov is not None
    assert bounded.markov.sigma.status == "upper_bound"


def test_the_datasheet_and_the_settings_explain_it(report: Report) -> None:
    filters = filter_report(report, 600.0)
    page = document(report, "md", filters).decode()
    assert "Correlated noise (Gauss–Markov) M, °/h" in page
    assert "open: the record shows correlated noise" in page
    assert "dashed: correlated noise" in document(report, "html", filters).decode()
    settings = document(report, "kalibr", filters).decode()
    assert "from N, B, K and M: the smallest" in settings
    assert "; with M " in settings
    lines = [line for line in settings.splitlines() if "gyroscope_random_walk: " in line]
    assert float(lines[0].removeprefix("# ").split()[1]) == pytest.approx(
        max(filters.channels[f"gyro/{axis}"].walk for axis in "xyz"), rel=1e-5
    )


# ---------------------------------------------------------------------- popcorn noise


def test_popcorn_noise_is_named_by_its_levels() -> None:
    rate_hz, samples, size, dwell_s = 10.0, 108_000, 8e-5, 120.0
    rng = np.random.default_rng(5)
    noise = synthesise(samples, rate_hz, N=[6e-5], B=[2.4e-5], seed=5, averaged=False)
    upper = np.cumsum(rng.random(samples) < 1.0 / (dwell_s * rate_hz)) % 2
    report = analyse(noise[:, 0] + size * (2.0 * upper - 1.0), rate_hz=rate_hz).report
    channel = report.channels["gyro/x"]
    assert "popcorn" in channel.caveats
    assert channel.model is not None
    jumps = channel.model.jumps
    assert jumps is not None
    assert jumps.high - jumps.low == pytest.approx(2.0 * size, rel=0.1)
    assert dwell_s / 2.0 < jumps.low_s < 2.0 * dwell_s
    assert dwell_s / 2.0 < jumps.high_s < 2.0 * dwell_s
    assert any(note.startswith("jumps between -") for note in _notes("gyro/x", channel, report))


# ---------------------------------------------------------------------- noise that the model does not have


@pytest.mark.slow
def test_what_the_model_does_not_explain_has_bounds() -> None:
    """Density 1/f^0.5: no sum of N, B, K and M. With `misfit`, none of B, K and M has a value."""
    n, columns = 144_000, 6
    k = np.arange(1, n)
    response = np.concatenate(([1.0], np.cumprod((k - 0.75) / k)))
    white = np.random.default_rng(3).standard_normal((2 * n, columns))
    transform = np.fft.rfft(response, 4 * n)[:, None] * np.fft.rfft(white, 4 * n, axis=0)
    values = 1e-4 * np.fft.irfft(transform, 4 * n, axis=0)[n : 2 * n]
    channels = analyse(gyro=values[:, :3], accel=values[:, 3:], rate_hz=40.0).report.channels.values()
    misfits = [channel for channel in channels if "misfit" in channel.caveats]
    assert misfits
    for channel in misfits:
        assert all(channel.estimates[letter].status != "measured" for letter in "BK")
        if channel.M is not None:
            assert channel.M.sigma.status != "measured"
            assert channel.M.time_constant_s.status != "measured"
            assert channel.M.time_constant_s.reason == channel.M.sigma.reason


# ---------------------------------------------------------------------- halves


@pytest.mark.slow
def test_k_is_a_bound_where_the_halves_contradict_each_other() -> None:
    """A mean that walks in the first third and rests then: the walk is no property of the sensor."""
    rate, n = 5.0, 36_000
    values = synthesise(n, rate, N=[6.1e-5] * 3, B=2.4e-5, seed=3, averaged=False)
    steps = np.random.default_rng(3).standard_normal(n // 3)
    values[:, 0] += np.pad(1e-5 / np.sqrt(rate) * np.cumsum(steps), (0, n - n // 3), mode="edge")
    values[:, 1] += synthesise(n, rate, K=1e-5, seed=4, averaged=False)[:, 0]  # a walk that goes on
    measurement = analyse(gyro=values, rate_hz=rate)
    moved, walks, rests = (measurement.report.channels[f"gyro/{axis}"] for axis in "xyz")
    assert "halves" in moved.caveats
    assert moved.K is not None
    assert (moved.K.status, moved.K.reason) == (
        "upper_bound",
        "the halves of the record contradict each other",
    )
    assert moved.K.high is not None
    assert moved.K.high > 8e-6
    assert "halves" not in walks.caveats + rests.caveats
    assert walks.K is not None
    assert walks.K.status == "measured"
