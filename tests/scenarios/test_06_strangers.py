"""Strangers on the bus: whatever they say and ask, the daemon measures on."""

from __future__ import annotations

from pathlib import Path

import pytest
from bus_actors import stage, until
from scene import ID, scene


@pytest.mark.parametrize("count", [5_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_20_random_messages_and_questions(tmp_path: Path, count: int) -> None:
    """On its own keys and others, and bytes that are no Zenoh at all at its very port."""
    with scene(tmp_path, seed=20) as play, stage() as start:
        if count > 100_000:
            play.calm(more=1200)  # the record is no longer young: memory must stand still
        before = play.calm()
        stranger = start("stranger", connect=play.daemon.endpoint, id=ID, count=count, seed=20)
        told = until(lambda: stranger.said and stranger.said[-1].get("put"), timeout=150)
        assert told == count
        after = play.calm()
        assert after.report.session.missing == 0
        assert set(play.daemon.viewer.reports()) == play.daemon.viewer.alive() == {ID}
        assert play.daemon.viewer.malformed == 0
        play.end(before, after)
