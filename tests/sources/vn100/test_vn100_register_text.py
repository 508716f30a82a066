"""Descriptions of settings: every register that changes the data has one, and no value makes it fail."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.sources.vn100.register_text import describe_setting
from imumon.sources.vn100.registers import DATA_REGISTERS, REGISTERS


def named(number: int) -> str:
    return f"{number} {REGISTERS[number].name}"


@pytest.mark.parametrize(
    ("number", "value", "expected"),
    [
        (85, "0,20,20,4,0,0,3,3,3,0", "accel and gyro averaged over 20 samples (25 ms); temperature"),
        (85, "0,1,0,0,0,0,3,3,3,0", "no averages"),
        (85, "0,0,8,0,0,0,0,2,0,0", "gyro averaged over 8 samples (10 ms), compensated outputs only"),
        (82, "0,1,0,0,0", "bias of gyro removed"),
    ],
)
def test_a_description_says_what_the_setting_does(number: int, value: str, expected: str) -> None:
    assert expected in (describe_setting(named(number), value) or "")


def test_an_unknown_setting_has_no_description() -> None:
    for name, text in (
        ("", ""),
        ("VPE", "on"),
        ("999 what", "1"),
        ("85 IMU filtering", "x"),
        ("6 type", "14"),
        ("35 VPE basic control", "1,1,1,1"),
    ):
        assert describe_setting(name, text) is None


@given(number=st.sampled_from(DATA_REGISTERS), text=st.text("0123456789,.-+AFx", max_size=40))
def test_no_value_makes_the_description_fail(number: int, text: str) -> None:
    description = describe_setting(named(number), text)
    assert description is None or description
