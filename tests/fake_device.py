"""A device without serial port, checksum and registers: a file that exists is a sensor that is plugged in.

Its clock runs at 101 Hz with jittered stamps, and every 50th sample is lost. ``fake:PATH`` is its URL. Each line of
the file is a remark.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from imumon.model.samples import ACCEL, GYRO, DeviceCounters, DeviceInfo, Item, SampleBlock, Stream
from imumon.sources.device import Device, DeviceDriver, DeviceLost, DeviceNotFound, DeviceOptions

RATE_HZ = 101.0
JITTER_S = 1e-3
STREAM = Stream("uncompensated", (*GYRO, *ACCEL), source="fake", clock="startup")


class FakeDevice(Device):
    """White noise while the file exists."""

    def __init__(self, options: DeviceOptions) -> None:
        super().__init__()
        self._path = Path(options.url.partition(":")[2])
        self._begin = time.monotonic()  # its clock continues while it is away
        self._next, self._random = 0, np.random.default_rng(1)

    def open(self) -> DeviceInfo:
        if not self._path.exists():
            raise DeviceNotFound("fake_missing", f"no file {self._path}", "create it")
        self._next = self._due()
        return self.info()

    def info(self) -> DeviceInfo:
        remarks = tuple(self._path.read_text().splitlines()) if self._path.exists() else ()
        return DeviceInfo(
            id="fake-1", kind="fake", model="Fake", serial="1", port=str(self._path), remarks=remarks
        )

    def _due(self) -> int:
        return int((time.monotonic() - self._begin) * RATE_HZ)

    def read(self, timeout_s: float) -> list[Item]:
        end = time.monotonic() + timeout_s
        while self._due() <= self._next and time.monotonic() < end:
            self.wait(0.01)
        if not self._path.exists():
            raise DeviceLost("fake_lost", f"{self._path} is gone", "create it again")
        index, self._next = np.arange(self._next, self._due()), self._due()
        index = index[index % 50 != 49]
        if not len(index):
            return []
        jitter = self._random.uniform(-JITTER_S, JITTER_S, len(index))
        time_ns = ((index / RATE_HZ + jitter) * 1e9).astype(np.int64)
        values = self._random.normal(0.0, 1e-3, (len(index), 6))
        return [SampleBlock(STREAM, values, time_ns, np.zeros(len(index), np.int64))]

    @property
    def counters(self) -> DeviceCounters:
        return DeviceCounters()

    def close(self) -> None:
        pass


class FakeDriver(DeviceDriver):
    """Driver of `FakeDevice`."""

    scheme = "fake"
    title = "fake device"

    def create(self, options: DeviceOptions) -> Device:
        return FakeDevice(options)


def install(site: Path, name: str, devices: Mapping[str, str]) -> None:
    """Install a distribution with these devices, without its modules, below `site`, for ``PYTHONPATH``."""
    info = site / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    points = (f"{scheme} = {driver}\n" for scheme, driver in devices.items())
    (info / "entry_points.txt").write_text(f"[imumon.devices]\n{''.join(points)}")
