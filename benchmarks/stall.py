"""Reading never stalls: an hour at 800 Hz and 921600 baud with everything against it, and no sample is lost.

    python benchmarks/stall.py [--minutes 60]

A real emulator (`sim --baud`), a real daemon (`run --set-baud 921600`) and at the same time
- a fit going on: a report is asked for ten times a second, and limits are renewed as they always are;
- a slow disk under the state (saved every 5 s) and the recording: a write takes 50 ms, an fsync or a rename
  two seconds, and once a minute the disk answers nothing for ten seconds (`slow_disk.c`, beneath the real
  daemon);
- a stuck subscriber: a viewer that is stopped (SIGSTOP) for 20 s of every 25, so that its link fills up and
  is cut again and again, beside a healthy one.

Counted against the emulator's own counters, which know every message it made; at the start and at the end it
keeps still for a moment, so that both sides count the same. Exit code 1 if a sample was lost.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from bus_actors import Actor
from daemons import Daemon
from usage import cpu_s, resident_kb

from imumon.devices.vn100.emulator import EmulatorSettings, spawn
from imumon.devices.vn100.emulator.process import EmulatorProcess
from imumon.replay.replay import ReplayOptions, replay
from imumon.report import Report, from_json, stamp

BAUD = 921600
WRITE_MS, SYNC_MS = 50, 2000
HANG_S, HANG_EVERY_S = 10.0, 60.0
STOPPED_S, STUCK_EVERY_S = 20.0, 25.0
CONFIG = "[report]\nperiod_s = 0.1\n[state]\nsave_period_s = 5\n"


@contextmanager
def slow_disk(scratch: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    """Directory on a slow disk, and the environment of a process that sees it so."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise SystemExit("stall.py makes a slow disk with a C compiler: install gcc")
    library, directory = scratch / "slow_disk.so", scratch / "disk"
    source = Path(__file__).with_name("slow_disk.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    directory.mkdir()
    slow = {"SLOW_DISK_WRITE_MS": str(WRITE_MS), "SLOW_DISK_SYNC_MS": str(SYNC_MS)}
    yield directory, {"LD_PRELOAD": str(library), "SLOW_DISK": str(directory), **slow}
    Path(f"{directory}.hang").unlink(missing_ok=True)


class Stillness(NamedTuple):
    """Both sides with nothing on the way.

    Attributes
    ----------
    counted : by the emulator.
    report : of the daemon.
    resident_kb : memory of the daemon, kB.
    """

    counted: dict[str, Any]
    report: Report
    resident_kb: int


def still(sensor: EmulatorProcess, daemon: Daemon, word: str) -> Stillness:
    """For a moment the sensor is told to keep still.

    With ``silence`` what it makes meanwhile is lost, with ``stall`` it waits, and so does what it answers.
    """
    begun = stamp(datetime.now(UTC) + timedelta(seconds=0.5))
    replies = sensor.ask(f"{word} 600")["replies"]
    said: list[Report] = []

    def newer(report: Report) -> bool:
        return report.time > (said[-1].time if said else begun)

    while len(said) < 2 or said[-1].session.samples != said[-2].session.samples:
        said.append(daemon.wait(newer))
    counted = sensor.ask("counters")
    time.sleep(0.1)  # what the report took is given back
    memory = resident_kb(daemon.process.pid)
    sensor.ask(f"{word} 0")
    return Stillness(counted | {"replies": replies}, said[-1], memory)


class Adversity:
    """The disk that hangs and the subscriber that is stuck, each at its times."""

    def __init__(self, directory: Path, stuck: Actor) -> None:
        self._hang = Path(f"{directory}.hang")
        self._stuck = stuck
        self._begun = time.monotonic()
        self.hangs = self.stops = 0
        self._stopped = False

    def go_on(self) -> None:
        passed = time.monotonic() - self._begun
        hangs = passed % HANG_EVERY_S > HANG_EVERY_S - HANG_S
        if hangs and not self._hang.exists():
            self._hang.touch()
            self.hangs += 1
        elif not hangs:
            self._hang.unlink(missing_ok=True)
        stops = passed % STUCK_EVERY_S < STOPPED_S
        if stops != self._stopped:
            self._stuck.kill(signal.SIGSTOP if stops else signal.SIGCONT)
            self._stopped = stops
            self.stops += stops

    def end(self) -> None:
        self._hang.unlink(missing_ok=True)
        self._stuck.kill(signal.SIGCONT)


def watch(daemon: Daemon, adversity: Adversity, until: float) -> float:
    """Longest time between two reports at the healthy subscriber, s."""
    longest, arrived, version = 0.0, time.monotonic(), -1
    while (now := time.monotonic()) < until and daemon.process.poll() is None:
        adversity.go_on()
        if daemon.viewer.version != version:
            version = daemon.viewer.version
            newest = max(at for _, at in daemon.viewer.reports().values())
            longest, arrived = max(longest, newest - arrived), max(newest, arrived)
        time.sleep(0.01)
    return max(longest, now - arrived)


def run(minutes: float, scratch: Path) -> dict[str, Any]:
    """What was counted, by what it is."""
    (scratch / "config.toml").write_text(CONFIG)
    with spawn(EmulatorSettings(seed=1, baud=BAUD)) as sensor, slow_disk(scratch) as (disk, environment):
        config, recording = str(scratch / "config.toml"), str(disk / "run.bin")
        words = ["--set-baud", str(BAUD), "--config", config, "--record", recording]
        words += ["--json", "--duration", "1e6"]
        with Daemon(sensor.path, disk / "state", *words, environment=environment) as daemon:
            daemon.samples(2000)
            first, at_first, _ = still(sensor, daemon, "silence")
            daemon.wait(lambda r: r.session.samples > at_first.session.samples + 800)
            stuck = Actor("subscriber", connect=[daemon.endpoint]).ready()
            adversity = Adversity(disk, stuck)
            pid, begun = daemon.process.pid, time.monotonic()
            used, resident = cpu_s(pid), resident_kb(pid)
            longest = watch(daemon, adversity, begun + 60.0 * minutes)
            cpu = 100.0 * (cpu_s(pid) - used) / (time.monotonic() - begun)
            ended = resident_kb(pid)
            adversity.end()
            last, at_last, _ = still(sensor, daemon, "stall")
            daemon.process.send_signal(signal.SIGTERM)
            out, err = daemon.ended(60)
            stuck.end()
        final = from_json(Report, out)
        again = replay(ReplayOptions(path=recording))
    sent = (last["sent"] - last["replies"]) - (first["sent"] - first["replies"])
    session = at_last.session
    received = session.samples - at_first.session.samples
    return {
        "minutes": minutes,
        "sample rate, Hz": at_last.device.sample_rate_hz,
        "baud": at_last.device.baud,
        "samples sent by the emulator": sent,
        "samples received": received,
        "missing, by the sensor's clock": session.missing - last["lost"],
        "dropped at a full terminal": last["dropped"] + last["overflowed"],
        "overruns of the queue": session.overruns - (session.kernel_overruns or 0),
        "overruns of the kernel": session.kernel_overruns,
        "queue's high water, bytes": session.most_queued_bytes,
        "longest gap between reports, s": round(longest, 2),
        "disk hung, times": adversity.hangs,
        "subscriber stuck, times": adversity.stops,
        "samples at the end": final.session.samples,
        "samples in the recording": again.session.samples,
        "CPU, percent of a core": round(cpu, 1),
        "resident at first, MB": round(resident / 1024, 1),
        "resident at the end, MB": round(ended / 1024, 1),
        "load average of the machine": " ".join(f"{load:.1f}" for load in os.getloadavg()),
        "said": [line for line in err.splitlines() if "error" in line or "warning" in line],
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--json", action="store_true")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="imumon-stall-") as scratch:
        found = run(words.minutes, Path(scratch))
    if words.json:
        print(json.dumps(found, indent=1))
    else:
        found["overruns of the kernel"] = found["overruns of the kernel"] or (
            0 if found["overruns of the kernel"] == 0 else "None: a pseudo-terminal has no TIOCGICOUNT"
        )
        for name, value in found.items():
            print(f"{name:32} {value:,}" if isinstance(value, int) else f"{name:32} {value}")
    lost = found["samples sent by the emulator"] - found["samples received"]
    lost += found["missing, by the sensor's clock"]
    whole = found["samples in the recording"] == found["samples at the end"]
    print(f"{lost} samples lost{'' if whole else '; the recording is not whole'}", file=sys.stderr)
    return 0 if lost == 0 and whole else 1


if __name__ == "__main__":
    raise SystemExit(main())
