"""Faults of the disk: full, read-only, half a state behind a power cut. The reading goes on."""

from __future__ import annotations

import os
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from laws import Fault
from scene import ID, Scene, scene

from imumon.checkpoint import decode

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


def remount(play: Scene, options: str) -> None:
    """Mount the daemon's state directory otherwise, in its own view."""
    command = [
        "nsenter",
        "-t",
        str(play.daemon.process.pid),
        *(word[:2] for word in NAMESPACE[1:] if word == "-m"),
    ]
    if os.geteuid() != 0:
        command += ["-U", "--preserve-credentials"]
    subprocess.run([*command, "mount", "-o", f"remount,{options}", str(play.state)], check=True)


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


@mounts
def test_11_state_directory_is_read_only(tmp_path: Path) -> None:
    """What is kept is taken up; nothing is written, and that is said; once it may be written, it is."""
    with scene(tmp_path, seed=11) as play:
        first = play.calm()
        play.stop()
        play.start(before=within('mount --bind "$0" "$0" && mount -o remount,ro,bind "$0"', play.state))
        kept = (play.state / f"{ID}.state").read_bytes()
        before = play.calm()
        assert before.report.session.samples > first.report.session.samples
        play.daemon.wait(lambda r: told(play, "state", "Read-only file system"))
        assert (play.state / f"{ID}.state").read_bytes() == kept
        remount(play, "rw,bind")
        play.daemon.wait(lambda r: told(play, "state", "saved again"))
        play.end(before, play.calm())
        assert play.said.count("cannot be saved") == 1


def test_12_killed(tmp_path: Path) -> None:
    """Of the record is lost what came since the last save, a second here; the hole is as long as it was."""
    with scene(tmp_path, seed=12) as play:
        before = play.calm(more=220)
        play.kill()
        kept = decode((play.state / f"{ID}.state").read_bytes()).record.samples
        assert kept >= before.report.session.samples - 200
        play.start()
        after = play.calm()
        assert after.report.session.gaps == 1
        play.away_s += 2.0  # the save period, and what it takes to save
        play.end(before, after, Fault(restarts=1))
        # what was killed left its stream behind; the second has put the sensor's own back
        play.start("--listen-only", "--rate", "40", "--id", "look")
        assert play.daemon.samples(10).device.source == "$VNYMR"


@pytest.mark.parametrize(
    ("damage", "serves"),
    [("cut", True), ("empty", True), ("both", False)],
)
def test_13_power_cut_in_the_middle_of_a_save(tmp_path: Path, damage: str, serves: bool) -> None:
    """Half a file is never taken for a whole one: the one before serves, or a new record begins."""
    with scene(tmp_path, seed=13) as play:
        before = play.calm(more=320)
        play.daemon.wait(lambda r: (play.state / f"{ID}.state.1").exists())
        play.kill()
        newest, older = play.state / f"{ID}.state", play.state / f"{ID}.state.1"
        (play.state / f"{ID}.state.new").write_bytes(newest.read_bytes()[:999])
        for path in (newest, older) if damage == "both" else (newest,):
            path.write_bytes(b"" if damage == "empty" else path.read_bytes()[:-1000])
        play.start()
        after = play.calm()
        assert len(list(play.state.glob("*.damaged-*.state"))) == (2 if damage == "both" else 1)
        assert told(play, "state", "set aside") or told(play, "state", "kept as")
        if serves:
            play.away_s += 3.0  # two save periods, and what it takes to save
            play.end(before, after, Fault(restarts=1))
        else:
            assert after.report.session.restarts == 0
            play.end(after, play.calm())
