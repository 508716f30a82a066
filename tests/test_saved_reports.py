"""The saved reports, which tests draw and print, are those of the present pipeline."""

from __future__ import annotations

import gzip
import json
from typing import Any

import pytest
import report_runs
import reports

from imumon.model.report_json import to_json


def same(part: Any, other: Any) -> bool:
    """Return whether JSON is the same, but for what another processor rounds otherwise."""
    if isinstance(part, dict) and isinstance(other, dict):
        return part.keys() == other.keys() and all(same(part[key], other[key]) for key in part)
    if isinstance(part, list) and isinstance(other, list):
        return len(part) == len(other) and all(map(same, part, other))
    if isinstance(part, float) and isinstance(other, float):
        return part == pytest.approx(other, rel=1e-3, abs=1e-12)
    return part == other


@pytest.mark.slow
def test_the_saved_reports_are_those_of_the_present_pipeline() -> None:
    made = report_runs.saved()
    assert {path.name.partition(".")[0] for path in reports.FOLDER.iterdir()} == set(made)
    for name, part in made.items():
        text = gzip.decompress((reports.FOLDER / f"{name}.json.gz").read_bytes())
        assert same(json.loads(to_json(part)), json.loads(text)), f"{name}: run python tests/report_runs.py"
