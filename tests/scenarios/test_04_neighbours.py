"""Faults of the surroundings: what others hold, what was written wrongly, what there is too little of."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

import pytest
from commands import imumon
from daemons import free_endpoint
from laws import Fault
from scene import ID, scene

pytestmark = pytest.mark.slow


def test_15_two_daemons(tmp_path: Path) -> None:
    """The same port, endpoint or state: each is refused in one line; the first notices nothing."""
    with scene(tmp_path, seed=15) as play:
        before = play.calm()
        elsewhere = ("--listen", free_endpoint())
        said = imumon("run", "--port", play.port, "--state", tmp_path / "b", *elsewhere, code=1)
        assert play.port in said
        with scene(tmp_path / "b", seed=16, start=False) as other:
            quiet = tmp_path / "quiet.toml"  # where it searches is in the log, too
            quiet.write_text("[log]\nlevel = 'warning'\n")
            words = ("run", "--config", quiet, "--port", other.port, "--duration", "20", "--state")
            said = imumon(*words, tmp_path / "c", "--listen", play.daemon.endpoint, code=1)
            assert play.daemon.endpoint.rpartition(":")[2] in said
            said = imumon(*words, play.state, *elsewhere, code=1)
            assert str(play.state) in said
            assert "another imumon" in said
        after = play.calm()
        assert after.report.session.missing == 0
        play.end(before, after)


def test_18_memory_runs_out(tmp_path: Path) -> None:
    """It ends in one line, or is ended by a library, and the next one goes on with what was saved."""
    with scene(tmp_path, seed=18) as play:
        before = play.calm()
        play.daemon.wait(lambda r: (play.state / f"{ID}.state").exists())
        resource.prlimit(play.daemon.process.pid, resource.RLIMIT_DATA, (1 << 20, 1 << 20))
        code = play.daemon.process.wait(20)
        play.kill()
        # Zenoh and the C libraries do not all survive a refused page: they abort, or worse
        assert code in (1, -signal.SIGABRT, -signal.SIGSEGV), play.said
        assert code != 1 or "out_of_memory" in play.said.strip().splitlines()[-1]
        play.start()
        play.away_s += 3.0  # the save period, and what it takes to save
        play.end(before, play.calm(), Fault(restarts=1))
