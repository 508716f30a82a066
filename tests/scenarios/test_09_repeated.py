"""Faults that come again and again, or in each phase: kills, an unplugged cable, a full disk at every write."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest
from laws import ON_THE_WAY, Fault
from scene import ID, scene
from test_07_history import kept

from imumon.checkpoint import decode
from imumon.history.store import SUFFIX

pytestmark = pytest.mark.slow

KILLS = 30


@pytest.mark.timeout(900)
def test_26_killed_thirty_times(tmp_path: Path) -> None:
    """At any moment, also within a save: each start goes on with what was saved, at most a second before."""
    moments = random.Random(26)
    with scene(tmp_path, seed=26) as play:
        before = play.calm()
        play.daemon.wait(lambda r: (play.state / f"{ID}.state").exists())
        saved = 0
        for _ in range(KILLS):
            play.daemon.samples(saved + 1)
            time.sleep(moments.uniform(0.0, 1.5))
            play.kill()
            left = time.monotonic()
            record = decode((play.state / f"{ID}.state").read_bytes()).record
            assert record.samples >= saved
            saved = record.samples
            play.start()
            assert play.daemon.samples(saved + 1).session.restarts
            # the save period, and what it takes to save
            play.away_s += time.monotonic() - left + 2.0
        play._left = None
        after = play.calm()
        # a start that is killed before its first save leaves no trace
        restarts = after.report.session.restarts
        assert 1 <= restarts <= KILLS
        final = play.end(before, after, Fault(restarts=restarts, on_the_way=KILLS * ON_THE_WAY))
        # the period in progress is complete in the state alone; nothing is in the history twice
        assert 0 < kept(play.state / f"{ID}{SUFFIX}") <= final.session.samples
        assert not [
            path.name for path in play.state.iterdir() if "damaged" in path.name or ".new" in path.name
        ]


DOCUMENTS = ("json", "csv", "html")


CALLS_OF_A_SAVE, CALLS_OF_A_DAEMON = 24, 8
"""Calls that write of one save of state and history, with some more; the log has a message ten times an hour."""


DAYS, STEP_S, PERIOD_S = 30, 10, 3600
SAMPLES = DAYS * 86400 // STEP_S
