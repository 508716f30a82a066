"""Faults of the disk and of the history, and kills again and again: the reading continues."""

from __future__ import annotations

import os
import random
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import pytest
from laws import ON_THE_WAY, Fault
from scene import ID, Scene, scene

from imumon.checkpoint import decode
from imumon.history import HistoryStore, Selection
from imumon.history.store import SUFFIX

pytestmark = pytest.mark.slow

NAMESPACE = ("unshare", "-m") if os.geteuid() == 0 else ("unshare", "-Urm")
"""A view of the file systems for one process; it goes with it."""


def possible() -> bool:
    """Whether a process may mount something of its own here."""
    trial = "mount -t tmpfs none /mnt && mount --bind /mnt /mnt && mount -o remount,ro,bind /mnt"
    try:
        return (
            subprocess.run([*NAMESPACE, "sh", "-c", trial], capture_output=True, check=False).returncode == 0
        )
    except OSError:
        return False


mounts = pytest.mark.skipif(not possible(), reason="nothing can be mounted here, not even for one process")


def within(command: str, place: Path) -> tuple[str, ...]:
    """Words in front of a daemon that mount something at `place` for it alone."""
    place.mkdir(exist_ok=True)
    return (*NAMESPACE, "sh", "-c", f'{command} && exec "$@"', str(place))


def told(play: Scene, kind: str, text: str) -> bool:
    return any(text in event.text for event in play.events(kind))


def fill(directory: Path) -> bool:
    """Take all room of a disk, also what a daemon has given up for its next save; always true."""
    with suppress(OSError), (directory / "filler").open("ab", buffering=0) as filler:
        while filler.write(bytes(1 << 12)):
            pass
    return True


@mounts
@pytest.mark.parametrize(("size", "records"), [("2m", True), ("700k", False)])
def test_09_disk_is_full_and_has_room_again(tmp_path: Path, size: str, records: bool) -> None:
    """State and recording on one small disk: the recording ends, the state waits, both are said once.

    The smaller disk has room for two states and a history, and no more. The state stays saved, and nothing else takes
    its room.
    """
    with scene(tmp_path, seed=9, start=False) as play:
        disk = within(f'mount -t tmpfs -o size={size} none "$0"', play.state)
        play.start(*(("--record", str(play.state / "raw.bin")) if records else ()), before=disk)
        before = play.calm()
        seen = Path(f"/proc/{play.daemon.process.pid}/root") / play.state.relative_to("/")
        play.daemon.wait(
            lambda r: (
                fill(seen)
                and told(play, "state", "kB are needed")
                and (not records or told(play, "recording", "ended"))
            )
        )
        (seen / "filler").unlink()
        play.daemon.wait(lambda r: told(play, "state", "saved again"))
        after = play.calm(more=300)
        assert after.report.session.missing == 0
        state = decode((seen / f"{ID}.state").read_bytes())
        assert state.record.samples > before.report.session.samples
        play.end(before, after, code=int(records))  # 1: the recording has ended before the record
        assert play.said.count("the state cannot be saved") == 1
        assert play.said.count(" error: recording to ") == int(records)


# ---------------------------------------- faults of the history


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


# ---------------------------------------- faults that come again and again, or in each phase


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
