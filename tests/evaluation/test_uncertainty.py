"""Uncertainty budgets, and their combined limits in everything that states a coefficient."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluations import HZ, make_report, replayed, sheet_file, shown
from reports import RATE, with_coefficients

from imumon.api.traceability import evaluated
from imumon.cli.wait_condition import WaitCondition
from imumon.coefficients import COEFFICIENTS, Estimate, Excess, coefficient_ratio
from imumon.datasheet.tables import channel_rows, coefficient_text
from imumon.evaluation import UncertaintyBudget
from imumon.noise.synthesis import synthesise
from imumon.pipeline.uncertainty_budgets import uncertainty_budgets
from imumon.references import read_sheet
from imumon.report import Report, from_json
from imumon.report_json import to_json
from imumon.tui.formatting import Notation
from imumon.units import figures


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
