"""The filter before the samples: named with ``--filter``, seen in the spectrum, or unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from evaluations import HZ, replayed


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
