"""Benchmark of reading under load: an hour at 800 Hz and 921600 baud must lose no sample.

    python benchmarks/stall.py [--minutes 60]

A real emulator (`sim --baud`), a real daemon (`run --set-baud 921600`) and at the same time
- fits: ten reports per second, with the limits computed as usual;
- a slow disk under the state (saved every 5 s) and the recording: a write takes 50 ms, an fsync or a rename
  two seconds, and once a minute the disk does not respond for ten seconds (`slow_disk.c`, preloaded into the
  daemon);
- a stopped subscriber (SIGSTOP for 20 s of every 25), so that its link fills up and is closed repeatedly,
  beside a running one.

The counters of the emulator, which include every message it made, are the reference; at the start and at the
end it pauses for a moment, so that both sides count the same. Exit code 1 if a sample was lost.
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
from faulty_sensor import FaultySensorProcess, spawn
from usage import cpu_s, resident_kb

from imumon.devices.vn100.emulator import EmulatorSettings
from imumon.replay import ReplayOptions, replay
from imumon.report import Report, from_json, stamp

BAUD = 921600
WRITE_MS, SYNC_MS = 50, 2000
HANG_S, HANG_EVERY_S = 10.0, 60.0
STOPPED_S, STUCK_EVERY_S = 20.0, 25.0
CONFIG = "[report]\nperiod_s = 0.1\n[state]\nsave_period_s = 5\n"


@contextmanager
def slow_disk(scratch: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    """Yield a directory on a slow disk, and the environment of a process for which it is slow."""
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


class Pause(NamedTuple):
    """Both sides while no message is in transit.

    Attributes
    ----------
    counted : by the emulator.
    report : of the daemon.
    resident_kb : memory of the daemon, kB.
    """

    counted: dict[str, Any]
    report: Report
    resident_kb: int


def pause(sensor: FaultySensorProcess, daemon: Daemon, command: str) -> Pause:
    """Pause the output of the emulator and return the counters of both sides.

    With ``silence`` its output during the pause is lost; with ``stall`` it waits, and so do its replies.
    """
    start = stamp(datetime.now(UTC) + timedelta(seconds=0.5))
    replies = sensor.ask(f"{command} 600")["replies"]
    reports: list[Report] = []

    def newer(report: Report) -> bool:
        return report.time > (reports[-1].time if reports else start)

    while len(reports) < 2 or reports[-1].session.samples != reports[-2].session.samples:
        reports.append(daemon.wait(newer))
    counted = sensor.ask("counters")
    time.sleep(0.1)  # the memory of the report is freed
    memory = resident_kb(daemon.process.pid)
    sensor.ask(f"{command} 0")
    return Pause(counted | {"replies": replies}, reports[-1], memory)


class Faults:
    """The disk and the subscriber, each of which is stopped periodically."""

    def __init__(self, directory: Path, stuck: Actor) -> None:
        self._hang = Path(f"{directory}.hang")
        self._stuck = stuck
        self._begun = time.monotonic()
        self.hangs = self.stops = 0
        self._stopped = False

    def update(self) -> None:
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


def watch(daemon: Daemon, faults: Faults, until: float) -> float:
    """Return the longest time between two reports at the running subscriber, s."""
    longest, arrived, version = 0.0, time.monotonic(), -1
    while (now := time.monotonic()) < until and daemon.process.poll() is None:
        faults.update()
        if daemon.viewer.version != version:
            version = daemon.viewer.version
            newest = max(at for _, at in daemon.viewer.reports().values())
            longest, arrived = max(longest, newest - arrived), max(newest, arrived)
        time.sleep(0.01)
    return max(longest, now - arrived)


def run(minutes: float, scratch: Path) -> dict[str, Any]:
    """Return the results by their names."""
    (scratch / "config.toml").write_text(CONFIG)
    with spawn(EmulatorSettings(seed=1, baud=BAUD)) as sensor, slow_disk(scratch) as (disk, environment):
        config, recording = str(scratch / "config.toml"), str(disk / "run.bin")
        options = ["--set-baud", str(BAUD), "--config", config, "--record", recording]
        options += ["--json", "--duration", "1e6"]
        with Daemon(sensor.path, disk / "state", *options, environment=environment) as daemon:
            daemon.samples(2000)
            first, at_first, _ = pause(sensor, daemon, "silence")
            daemon.wait(lambda r: r.session.samples > at_first.session.samples + 800)
            stuck = Actor("viewer", connect=[daemon.endpoint]).ready()
            faults = Faults(disk, stuck)
            pid, begun = daemon.process.pid, time.monotonic()
            used, resident = cpu_s(pid), resident_kb(pid)
            longest = watch(daemon, faults, begun + 60.0 * minutes)
            cpu = 100.0 * (cpu_s(pid) - used) / (time.monotonic() - begun)
            ended = resident_kb(pid)
            faults.end()
            last, at_last, _ = pause(sensor, daemon, "stall")
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
        "missing, by the sensor clock": session.missing - last["lost"],
        "dropped at a full terminal": last["dropped"],
        "overruns of the queue": session.overruns - (session.kernel_overruns or 0),
        "overruns of the kernel": session.kernel_overruns,
        "most bytes queued": session.most_queued_bytes,
        "longest gap between reports, s": round(longest, 2),
        "disk stopped, times": faults.hangs,
        "subscriber stopped, times": faults.stops,
        "samples at the end": final.session.samples,
        "samples in the recording": again.session.samples,
        "CPU, percent of a core": round(cpu, 1),
        "resident at first, MB": round(resident / 1024, 1),
        "resident at the end, MB": round(ended / 1024, 1),
        "load average of the machine": " ".join(f"{load:.1f}" for load in os.getloadavg()),
        "messages": [line for line in err.splitlines() if "error" in line or "warning" in line],
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="imumon-stall-") as scratch:
        results = run(arguments.minutes, Path(scratch))
    if arguments.json:
        print(json.dumps(results, indent=1))
    else:
        results["overruns of the kernel"] = results["overruns of the kernel"] or (
            0 if results["overruns of the kernel"] == 0 else "None: a pseudo-terminal has no TIOCGICOUNT"
        )
        for name, value in results.items():
            print(f"{name:32} {value:,}" if isinstance(value, int) else f"{name:32} {value}")
    lost = results["samples sent by the emulator"] - results["samples received"]
    lost += results["missing, by the sensor clock"]
    whole = results["samples in the recording"] == results["samples at the end"]
    print(f"{lost} samples lost{'' if whole else '; the recording is incomplete'}", file=sys.stderr)
    return 0 if lost == 0 and whole else 1


if __name__ == "__main__":
    raise SystemExit(main())
