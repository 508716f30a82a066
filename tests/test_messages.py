"""Texts for caveats, clocks and grades."""

from __future__ import annotations

from dataclasses import replace

import reports

from imumon.model import messages
from imumon.model.messages import CAVEATS
from imumon.model.report import NoiseModel
from imumon.model.samples import GYRO


def test_a_caveat_has_a_line_and_advice() -> None:
    made = reports.report()
    for caveat, meaning in CAVEATS.items():
        assert 0 < len(meaning.line) <= 80
        assert not meaning.line.endswith(".")
        assert messages.advice(made, caveat).endswith(".")


def test_an_oscillation_is_named_with_its_period() -> None:
    made = reports.report()
    channel = replace(
        made.channels["gyro/x"], model=NoiseModel(oscillations_s=(312.0,)), caveats=("oscillation",)
    )
    text = messages.advice(replace(made, channels={GYRO[0]: channel}), "oscillation")
    assert "period 5 min 12 s" in text


def test_caveats_of_the_whole_record_name_no_channel() -> None:
    made = reports.report(caveats=("aliased",))
    assert messages.caveats(made) == {"aliased": [], "vibration": ["accel/y"]}
    aliased, vibration = messages.caveat_lines(made)
    assert aliased == CAVEATS["aliased"].line
    assert vibration == f"accel y: {CAVEATS['vibration'].line}"
