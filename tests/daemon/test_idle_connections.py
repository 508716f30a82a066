"""Connections that say nothing: the measurement goes on, and viewers are answered while they stay open."""

from __future__ import annotations

from pathlib import Path

import pytest
from idle_connections import SAVE_S, cost


@pytest.mark.slow
@pytest.mark.parametrize("count", [2000])
def test_idle_connections_cost_no_sample_and_keep_no_viewer_out(tmp_path: Path, count: int) -> None:
    figures = cost(tmp_path, count)
    assert figures.lost == 0
    assert figures.save_s < 2.0 * SAVE_S + 1.0  # a save that is due takes its time
    assert max(figures.viewer_s, figures.metrics_s) < 15.0, figures
    assert figures.end_s < 10.0
    assert figures.memory_mb < 40.0
