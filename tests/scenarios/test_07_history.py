"""Faults of the history: no room for it, a corrupt file. The reading and the record go on without it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from scene import ID, Scene, scene
from test_03_disk import mounts, told, within

from imumon.history import HistoryStore, Selection
from imumon.history.store import SUFFIX

pytestmark = pytest.mark.slow

EVER = Selection(since=0.0, until=1e12)


def kept(path: Path) -> int:
    """Samples in the hours of a file."""
    copy = (
        Path(tempfile.mkdtemp()) / path.name
    )  # SQLite cannot follow the path into the view of another process
    for suffix in ("", "-wal"):
        if Path(f"{path}{suffix}").exists():
            Path(f"{copy}{suffix}").write_bytes(Path(f"{path}{suffix}").read_bytes())
    with HistoryStore(copy) as store:
        return sum(timed.period.samples for timed in store.periods(EVER))


def wait_for(play: Scene, text: str) -> None:
    play.daemon.wait(lambda r: told(play, "history", text))


@mounts
def test_22_history_on_a_full_disk(tmp_path: Path) -> None:
    """One message when nothing can be written and one when it can be; what happened between is in the file."""
    with scene(tmp_path, seed=22, start=False) as play:
        play.start(before=within('mount -t tmpfs -o size=2m none "$0"', play.state))
        before = play.calm()
        seen = Path(f"/proc/{play.daemon.process.pid}/root") / play.state.relative_to("/")
        with pytest.raises(OSError, match="No space"):
            (seen / "filler").write_bytes(b"\0" * (4 << 20))
        wait_for(play, "cannot be written")
        (seen / "filler").unlink()
        wait_for(play, "written again")
        after = play.calm()
        assert after.report.session.missing == 0
        play.daemon.wait(lambda r: kept(seen / f"{ID}{SUFFIX}") >= after.report.session.samples)
        play.end(before, after)
        assert play.said.count("the history cannot be written") == 1


def test_23_history_file_is_corrupt(tmp_path: Path) -> None:
    """It is set aside with its name, a new one begins, and the record of the state continues."""
    with scene(tmp_path, seed=23) as play:
        play.calm()
        play.stop()
        path = play.state / f"{ID}{SUFFIX}"
        data = path.read_bytes()
        damage = data[:4096] + b"\xa5" * (len(data) - 4096)
        path.write_bytes(damage)
        play.start()
        before = play.calm()
        wait_for(play, "a new history begins")
        assert (play.state / f"{ID}.damaged-1{SUFFIX}").read_bytes() == damage
        after = play.calm()
        play.end(before, after)
        assert kept(path) > 0
