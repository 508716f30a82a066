"""Ratio of two coefficients: it differs only if the 95 % limits show it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import reports
from hypothesis import given
from hypothesis import strategies as st

from imumon.coefficients import Estimate, coefficient_ratio
from imumon.tui.compare import comparison, ratio_text
from imumon.tui.view_state import ViewState


def known(value: float, spread: float) -> Estimate:
    """Return a coefficient with a relative half-width of `spread`: measured, bounded or pending."""
    if spread < 0.9:
        low, high = value * (1 - 0.95 * spread), value * (1 + 1.05 * spread)
        return Estimate(value=value, low=low, high=high, status="measured")
    return Estimate(low=0.0, high=value * (1 + spread), status="upper_bound") if spread < 6.0 else Estimate()


def test_a_ratio_differs_beyond_the_limits_of_both() -> None:
    assert ratio_text(known(1.0, 0.05), known(2.0, 0.05)) == ("2.00 differs", "warn")
    assert ratio_text(known(2.0, 0.05), known(1.0, 0.05)) == ("0.500 differs", "warn")
    assert ratio_text(known(1.0, 0.05), known(1.06, 0.05)) == ("1.06  within", "muted")


def test_values_with_overlapping_limits_can_differ() -> None:
    """Half-widths add by their squares: two values can differ although their limits overlap."""
    one, two = known(1.0, 0.1), known(1.17, 0.1)
    assert one.high is not None
    assert two.low is not None
    assert one.high > two.low
    assert ratio_text(one, two)[0] == "1.17 differs"


def test_a_bound_differs_only_from_a_value_beyond_it() -> None:
    bound, pending = known(1.0, 1.5), known(1.0, 9.0)
    assert (bound.status, pending.status) == ("upper_bound", "pending")
    assert ratio_text(known(10.0, 0.05), bound) == ("< 0.250 differs", "warn")
    assert ratio_text(bound, known(10.0, 0.05)) == ("> 4.00 differs", "warn")
    for other in (known(1.0, 0.05), bound, pending):
        assert ratio_text(bound, other) == ("–", "faint")
        assert ratio_text(pending, other) == ("–", "faint")
    assert ratio_text(None, bound) == ("", "faint")


@given(
    value=st.floats(1e-12, 1e12),
    factor=st.floats(1e-3, 1e3),
    low=st.none() | st.floats(0.0, 0.9),
    spread=st.sampled_from([0.01, 0.2, 0.8, 1.5, 9.0]),
)
def test_the_order_of_the_two_does_not_matter(
    value: float, factor: float, low: float | None, spread: float
) -> None:
    one, two = known(value, spread), known(value * factor, 0.1)
    two = replace(two, low=None if low is None or two.value is None else two.value * low)
    forward, backward = ratio_text(one, two), ratio_text(two, one)
    assert forward[1] == backward[1]
    assert len(forward[0]) <= 15
    assert "differs" not in forward[0] or factor != 1.0


@pytest.mark.slow
def test_equal_sensors_differ_in_one_pair_of_twenty() -> None:
    """Estimates with log-normal scatter and their own 95 % limits: `differs` is wrong for 5 % of them."""
    rng, wrong, pairs = np.random.default_rng(3), 0, 2000
    for _ in range(pairs):
        spread = rng.uniform(0.02, 0.4, 2)
        one, two = (_estimate(float(s), float(rng.standard_normal())) for s in spread)
        wrong += coefficient_ratio(one, two).differs
    assert abs(wrong / pairs - 0.05) < 3 * math.sqrt(0.05 * 0.95 / pairs)


def _estimate(spread: float, deviation: float) -> Estimate:
    value = math.exp(spread * deviation)
    wide = math.exp(1.96 * spread)
    return replace(known(1.0, 0.1), value=value, low=value / wide, high=value * wide)


def test_no_number_is_truncated_on_a_narrow_screen() -> None:
    one, two = reports.report(), reports.report(900.0, id="vn100-0100056799", scale=2.0)
    state = ViewState(reports={reports.ID: one, two.device.id: two}, id=reports.ID, compared_id=two.device.id)
    wide, narrow = ([[text for text, _ in line] for line in comparison(state, cells)] for cells in (74, 59))
    assert len(wide) == len(narrow)
    for row, small in zip(wide[2:], narrow[2:], strict=True):
        assert sum(map(len, small)) <= 58
        assert row[-3:] == small[-3:]
