"""Faults that come again and again, or in each phase: kills, an unplugged cable, a full disk at every write."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from laws import ON_THE_WAY, Fault, adds_up, is_kept, nothing_invented
from scene import ID, Scene, scene
from test_03_disk import NAMESPACE, mounts
from test_05_signals import first_samples, reconnecting, running, saving, shaking_hands, starting, stopping
from test_07_history import kept

from imumon.checkpoint import decode
from imumon.history.store import SUFFIX
from imumon.report import Report, from_json
from imumon.report_json import to_json

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
            record = decode((play.state / f"{ID}.state").read_bytes()).meta["monitor"]["record"]
            assert record["samples"] >= saved
            saved = record["samples"]
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


PHASES = (starting, shaking_hands, first_samples, running, saving, reconnecting, stopping)
UNSTARTED = (starting, shaking_hands)


@pytest.mark.parametrize("phase", PHASES, ids=lambda phase: phase.__name__)
def test_27_unplugged_while(tmp_path: Path, phase: Callable[[Scene], None]) -> None:
    """A start without the sensor is an error of one line; whoever has measured waits for it, and goes on."""
    with scene(tmp_path, seed=27, start=False) as play:
        phase(play)
        if phase is not reconnecting:
            play.sensor.ask("unplug")
        time.sleep(2.0)
        if phase in UNSTARTED or phase is stopping:
            out, said = play.daemon.ended()
            assert "Traceback" not in said
            assert play.daemon.process.returncode in ((0,) if phase is stopping else (1, 3)), said
            if phase is stopping:
                final = from_json(Report, out)
                adds_up(final)
                is_kept(play.state / f"{ID}.state", final)
            else:
                error = json.loads(said.splitlines()[-1])["error"]
                assert error["code"] in ("port_not_found", "device_lost")
                assert error["cure"]
            return
        play.daemon.wait(lambda r: r.state == "waiting")
        play.sensor.ask("replug")
        report = play.calm().report
        assert report.session.gaps >= 1
        final = play.stop()
        adds_up(final)
        told = play.sensor.ask("counters")
        nothing_invented(final, told["sent"] - told["replies"])


def test_28_state_and_history_are_no_files(tmp_path: Path) -> None:
    """A pipe and a device without an end, in the place of each: set aside, and the daemon measures and saves."""
    with scene(tmp_path, seed=28, start=False) as play:
        play.state.mkdir()
        os.mkfifo(play.state / f"{ID}.state")
        (play.state / f"{ID}.state.1").symlink_to("/dev/zero")
        (play.state / f"{ID}{SUFFIX}").symlink_to("/dev/zero")
        play.start()
        before = play.calm()
        play.end(before, play.calm())
        assert (play.state / f"{ID}.state").is_file()
        assert kept(play.state / f"{ID}{SUFFIX}") > 0
        assert play.said.count("kept as") == 3, play.said


DOCUMENTS = ("json", "csv", "html")


@mounts
@pytest.mark.timeout(600)
def test_29_documents_on_a_full_disk(tmp_path: Path) -> None:
    """Whatever is free, a document is written whole, or its place is as before, with one line and a cure."""
    source, disk = tmp_path / "r.json", tmp_path / "disk"
    disk.mkdir()
    with scene(tmp_path / "scene", seed=29) as play:
        play.calm()
        final = play.stop()
    source.write_text(to_json(final))
    program = (
        "import pathlib, sys\n"
        "disk, source = pathlib.Path(sys.argv[1]), sys.argv[2]\n"
        "filler = disk / 'filler'\n"
        "from imumon.cli import main\n"
        "for name in sys.argv[3:]:\n"
        "    path, free = disk / f'a.{name}', 4\n"
        "    path.write_text('before')\n"
        "    while True:\n"
        "        size = (8 << 20) - (free << 10)\n"
        "        with filler.open('wb') as file:\n"
        "            try:\n"
        "                for _ in range(size >> 12): file.write(bytes(4096)); file.flush()\n"
        "            except OSError: pass\n"
        "        code = main(['report', source, '-o', str(path)])\n"
        "        rest = sorted(p.name for p in disk.iterdir() if p != filler and p.name[2:] not in sys.argv[3:])\n"
        "        print(name, free, code, path.read_bytes() == b'before', path.stat().st_size, rest, flush=True)\n"
        "        if code == 0 or free > 4096: break\n"
        "        free *= 8\n"
        "    path.unlink()\n"
    )
    mount = f'mount -t tmpfs -o size=8m none {disk} && exec "$@"'
    command = [*NAMESPACE, "sh", "-c", mount, "sh", sys.executable, "-c", program]
    done = subprocess.run(
        [*command, str(disk), str(source), *DOCUMENTS], capture_output=True, text=True, check=False
    )
    assert "Traceback" not in done.stderr, done.stderr
    lines = [line.split(maxsplit=5) for line in done.stdout.splitlines()]
    written = {line[0] for line in lines if line[2] == "0"}
    refused = [line for line in lines if line[2] != "0"]
    assert written == set(DOCUMENTS), done.stdout + done.stderr
    assert refused
    for line in refused:
        assert (line[2], line[3], line[5]) == ("1", "True", "[]"), done.stdout
    complaints = [line for line in done.stderr.splitlines() if "space" in line.lower()]
    assert len(complaints) == len(refused)
