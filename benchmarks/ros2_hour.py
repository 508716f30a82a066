"""Benchmark of a ROS 2 topic: an hour at 1 kHz through `ros2:` must lose no message and take little time.

    python benchmarks/ros2_hour.py [--minutes 60] [--rate 1000]

A router and a publisher of `sensor_msgs/msg/Imu` in processes of their own (`tests/ros2_actors.py`), and a real
daemon. The publisher catches up when the machine is busy, so that it sends `rate * time` messages. Its sequence
number and the counters of the daemon are compared when nothing is in transit. Memory is taken every ten seconds;
its growth is from the second tenth of the run to the last, each a median. Exit code 1 if a message was lost or a goal
is missed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import ros2_actors
from bus_actors import until
from daemons import Daemon
from figures import Figure, at_most, show
from soak import growth_kb
from usage import cpu_s, resident_kb

GOAL_SHARE, GOAL_KB, GOAL_GROWTH_KB = 10.0, 120_000.0, 8_000.0
FIRST_SAMPLES = 5000
"""Samples before the measurement begins: rate and columns are known by then."""
LOOK_S = 10.0


def settled(daemon: Daemon, sent: int, timeout_s: float = 30.0) -> tuple[int, int]:
    """Return samples and missing samples once every message that was sent has been counted."""
    end = time.monotonic() + timeout_s
    while True:
        session = daemon.wait(lambda r: True).session
        if session.samples + session.missing >= sent or time.monotonic() > end:
            return session.samples, session.missing
        time.sleep(0.5)


def measure(minutes: float, rate_hz: float) -> Iterator[Figure]:
    """Yield the figures of one run."""
    endpoint = ros2_actors.free_router()
    with (
        tempfile.TemporaryDirectory() as scratch,
        ros2_actors.router(endpoint),
        ros2_actors.publisher(endpoint, "/imu/data", rate_hz, paused="yes") as driver,
        Daemon(f"ros2:/imu/data?router={endpoint}", Path(scratch)) as daemon,
    ):
        pid = daemon.process.pid
        until(lambda: driver.ask("heard") == "1", 60.0)
        driver.ask("replug")
        daemon.samples(FIRST_SAMPLES)
        begin, cpu, load, memory = time.monotonic(), cpu_s(pid), [], []
        while (left := begin + 60.0 * minutes - time.monotonic()) > 0.0 and daemon.process.poll() is None:
            time.sleep(min(LOOK_S, left))
            memory.append(resident_kb(pid))
            load.append(os.getloadavg()[0])
        share = 100.0 * (cpu_s(pid) - cpu) / (time.monotonic() - begin)
        sent = int(driver.ask("pause"))
        samples, missing = settled(daemon, sent)
        session = daemon.wait(lambda r: True).session
        _, _, log = daemon.stop()
    print(log, file=sys.stderr)
    yield Figure("messages sent, received", f"{sent}, {samples}")
    lost = sent - samples
    yield Figure("messages lost", str(lost), f"missing {missing}", "0", lost == 0 and missing == 0)
    clean = session.overruns == session.bad_checksums == session.gaps == 0
    counts = f"{session.overruns}, {session.bad_checksums}, {session.gaps}"
    yield Figure("losses noticed, invalid messages, gaps", counts, "", "0, 0, 0", clean)
    busy = f"load of the machine {sum(load) / len(load):.1f} of {os.cpu_count()}" if load else ""
    yield at_most("processor time of the daemon", share, GOAL_SHARE, "% of a core", busy)
    yield at_most("memory, most", max(memory) / 1e3, GOAL_KB / 1e3, "MB")
    growth = growth_kb(memory)
    if growth is not None:
        yield at_most("memory, growth", growth / 1e3, GOAL_GROWTH_KB / 1e3, "MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz")
    words = parser.parse_args()
    figures = list(measure(words.minutes, words.rate))
    show("ros2-hour", figures)
    sys.exit(any(each.met is False for each in figures))


if __name__ == "__main__":
    main()
