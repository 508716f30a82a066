"""The words for caveats, clocks and grades: one home, for the screen, the datasheet and the table."""

from __future__ import annotations

import reports

from imumon import words
from imumon.words import CAVEATS


def test_a_caveat_has_a_line_and_a_paragraph() -> None:
    for meaning in CAVEATS.values():
        assert 0 < len(meaning.line) <= 80
        assert not meaning.line.endswith(".")
        assert meaning.advice.endswith(".")


def test_caveats_of_the_whole_record_name_no_channel() -> None:
    made = reports.report(caveats=("aliased",))
    assert words.caveats(made) == {"aliased": [], "vibration": ["accel/y"]}
    aliased, vibration = words.told(made)
    assert aliased == CAVEATS["aliased"].line
    assert vibration == f"accel y: {CAVEATS['vibration'].line}"
