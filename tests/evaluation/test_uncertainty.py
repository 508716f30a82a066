"""Combined limits: what they hold, and that everything that states a coefficient states them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluations import make_report, sheet_file, shown
from reports import RATE, with_coefficients

from imumon.api.document_report import document_report
from imumon.cli.wait_condition import WaitCondition
from imumon.documents.references import read_sheet
from imumon.documents.report_texts import coefficient_text
from imumon.model.coefficients import COEFFICIENTS, Estimate, Excess, coefficient_ratio
from imumon.model.history_report import DayScatter
from imumon.model.report import Report
from imumon.model.samples import GYRO
from imumon.model.units import figures
from imumon.record.combined_limits import shared_share, with_combined
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
    assert channel.std is not None
    n = channel.coefficients["N"].value
    shares = {}
    for step in (None, channel.std, 3.0 * channel.std):
        coarse = replace(channel, resolution=step)
        shares[step] = shared_share(replace(report, channels={GYRO[0]: coarse}), GYRO[0], "N")
    rounding = channel.std**2 / (24.0 * RATE * n**2) / np.sqrt(12.0)
    assert np.sqrt(shares[channel.std] ** 2 - shares[None] ** 2) == pytest.approx(rounding, rel=0.1)
    assert shares[3.0 * channel.std] == shares[None]  # nothing is known of it


def test_one_interval_is_in_all_tables_of_a_document_and_decides_what_is_above(tmp_path: Path) -> None:
    """The lower limit of the fit is above the data sheet, the combined one is not."""
    made = with_excess(SHOWN)
    made = replace(made, device=replace(made.device, alias_factor=1.0))
    n = n_of(made.channels)
    factor = COEFFICIENTS["N"].units["gyro"].factor
    page = shown(made)
    assert page.count(coefficient_text(n)) == 1
    for low, above in ((0.5 * (n.low + n.combined_low), False), (0.99 * n.combined_low, True)):
        sheet = read_sheet(sheet_file(tmp_path, gyro=low * factor))
        compared = document_report(made, sheet)
        (value,) = compared.data_sheet.values
        assert value.above == above
        assert ("; above " in shown(compared)) == above


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
