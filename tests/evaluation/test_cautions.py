"""What a document says beside a number: words that it explains, caveats, and what is not measured."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from evaluations import replayed, shown
from paths import RECORDINGS, needs_recordings

from imumon.model.report import Report


def table_of(report: Report) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(shown(report, "csv"))))


def test_each_row_of_the_table_has_its_device_and_caveats(recording: Path) -> None:
    report = replayed(recording, "--filter", "factory", "--no-guards")
    rows = table_of(report)
    assert {row["device"] for row in rows} == {"rest.csv"}
    assert all(row["unit"] for row in rows if row["value"])
    n = report.channels["gyro/x"].coefficients["N"]
    (own,) = (r for r in rows if (r["kind"], r["channel"], r["name"]) == ("coefficient", "gyro/x", "N"))
    assert [float(own[key]) for key in ("low", "combined_low", "combined_high")] == pytest.approx(
        [n.low, n.combined_low, n.combined_high]
    )
    assert set(own["caveats"].split()) == set(report.channels["gyro/x"].caveats)
    (corrected,) = (r for r in rows if (r["kind"], r["channel"]) == ("corrected", "gyro/x"))
    assert float(own["value"]) / float(corrected["value"]) == pytest.approx(np.sqrt(5.0))


def test_words_are_explained_where_they_are_printed(recording: Path, saved: Path) -> None:
    for text in (imumon("replay", recording, "--verbose"), imumon("report", saved)):
        assert "best one whose limits no N and no B exceeds" in " ".join(text.split())
    for form in ("filter", "kalibr", "px4", "ros"):
        text = " ".join(imumon("report", saved, "--format", form).replace("#", "").split())
        assert ("A fix is a measurement" in text) == ("fix" in text.replace("prefix", "")), form
    page = imumon("report", saved).partition("## Settings")[0]
    assert page.count("noise folds") == 1
    assert "--filter names it" in page


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
