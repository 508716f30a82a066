"""Laws of the host clock: one factor between its seconds and those of the record, and an uptime on every system."""

from __future__ import annotations

import time

import pytest

from imumon.sources.clock import HostClock


@pytest.mark.parametrize("factor", [0.5, 1.0, 60.0, 5000.0])
def test_a_length_of_the_record_and_back_is_the_same(factor: float) -> None:
    clock = HostClock(factor)
    assert clock.to_host_s(clock.to_sample_s(3.0)) == pytest.approx(3.0, rel=1e-15)
    assert clock.is_real_time == (factor == 1.0)


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan")])
def test_a_factor_that_is_none_is_refused(factor: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        HostClock(factor)


def test_a_system_that_does_not_count_its_sleep_has_an_uptime_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(time, "CLOCK_BOOTTIME", raising=False)
    before = HostClock().uptime_s()
    assert before <= HostClock().uptime_s() < before + 60.0
