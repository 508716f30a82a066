"""A daemon on an emulator in time-lapse that somebody else holds, and can ask what it has sent.

    python benchmarks/lapse.py SPEED [NAME=VALUE ...] ... run --port PATH --state DIR --listen ENDPOINT

`imumon run --port sim --speed X` keeps its emulator to itself. This is the same daemon with the same options. Words
with ``=`` before ``run`` are settings, in JSON. The others are skipped, so that it can precede any command that starts
a daemon. With ``install_memory``, the port ``memory:`` is a sensor without a port.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from imumon.config import load
from imumon.daemon import Daemon, RunOptions
from imumon.model.samples import ACCEL, GYRO, MAG, DeviceCounters, DeviceInfo, Item, SampleBlock, Stream
from imumon.sources.clock import HostClock
from imumon.sources.device import Device, DeviceDriver, DeviceOptions

RATE_HZ = 100.0
BLOCK = 1024
"""Samples of a block: in time-lapse, a port has 700."""
STREAM = Stream("deltas", (*GYRO, *ACCEL, *MAG, "temperature", "pressure"), source="memory", clock="startup")
MEAN = np.array([0.0] * 5 + [9.8, 0.2, 0.0, 0.4, 25.0, 101.3])
SPREAD = np.array([6e-4] * 3 + [1.4e-2] * 3 + [1.4e-3] * 3 + [1e-3] * 2)


class MemoryDevice(Device):
    """White noise with an exact clock, as fast as the daemon takes it."""

    def __init__(self) -> None:
        super().__init__()
        self._sent, self._random = 0, np.random.default_rng(1)

    def open(self) -> DeviceInfo:
        return self.info()

    def info(self) -> DeviceInfo:
        return DeviceInfo(
            id="memory-1", kind="memory", model="Memory", serial="1", port="memory:", driver="memory"
        )

    def read(self, timeout_s: float) -> list[Item]:
        ticks = np.arange(self._sent, self._sent + BLOCK, dtype=np.int64)
        self._sent += BLOCK
        values = MEAN + SPREAD * self._random.standard_normal((BLOCK, MEAN.size))
        return [SampleBlock(STREAM, values, ticks * round(1e9 / RATE_HZ), np.zeros(BLOCK, dtype=np.int64))]

    @property
    def counters(self) -> DeviceCounters:
        return DeviceCounters()

    def close(self) -> None:
        pass


class MemoryDriver(DeviceDriver):
    """Driver of `MemoryDevice`."""

    scheme = "memory"
    title = "sensor without a port"

    def create(self, options: DeviceOptions) -> Device:
        return MemoryDevice()


def install_memory(site: Path) -> None:
    """Install a distribution with this device below `site`, for the daemons that are started from now on."""
    info = site / "imumon_memory-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: imumon-memory\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[imumon.devices]\nmemory = lapse:MemoryDriver\n")
    places = [str(site), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, places))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("--port", "--state", "--listen"):
        parser.add_argument(name, required=True)
    own, words = sys.argv[1 : (at := sys.argv.index("run"))], parser.parse_args(sys.argv[at + 1 :])
    speed, pairs = float(own[0]), (word.partition("=") for word in own if "=" in word)
    given = {name: json.loads(value) for name, _, value in pairs}
    settings = load(None, {"zenoh.listen": [words.listen], **given})
    Daemon(
        settings, RunOptions(url=words.port, state_directory=Path(words.state), clock=HostClock(speed))
    ).run()


if __name__ == "__main__":
    main()
