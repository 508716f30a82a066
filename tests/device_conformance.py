"""Conformance of devices: what the daemon may expect of every device, as tests for pytest.

The author of a device derives a class from `DeviceConformance` and gives it a bench, a device that can be unplugged::

    from device_conformance import Bench, DeviceConformance

    class TestMyDevice(DeviceConformance):
        @pytest.fixture
        def bench(self, tmp_path):
            ...
            yield Bench(driver=MyDriver(), url="my:...", state=tmp_path, unplug=..., replug=...)

Then pytest runs the cases. What a bench cannot do is None, and its cases are skipped. Nothing else is needed beside
imumon and pytest: this file can be copied.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from imumon.config import Settings
from imumon.grid.sample_clock import SampleClock
from imumon.model.samples import DeviceInfo, Item, SampleBlock
from imumon.sources.device import (
    Device,
    DeviceDriver,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceOptions,
    Interrupted,
    sample_blocks,
)
from imumon.sources.device_reader import DeviceReader, Disconnected, EndOfStream, Items, Opened, Started

PATIENCE_S = 30.0
"""s for which a case waits: a busy machine must not fail it."""
GARBAGE_BYTES = 20_000


@dataclass(kw_only=True)
class Bench:
    """A device that can be unplugged.

    Attributes
    ----------
    driver, url : what makes the device. It sends at least 20 samples a second.
    state : a directory that is empty.
    missing_url : of a device that is not there; None: there is no such URL.
    unplug, replug : let the device go and come back; None: it cannot go.
    lose_samples : lets some samples be lost, or does nothing where some always are; None: it cannot lose any.
    """

    driver: DeviceDriver
    url: str
    state: Path
    missing_url: str | None = None
    unplug: Callable[[], object] | None = None
    replug: Callable[[], object] | None = None
    lose_samples: Callable[[], object] | None = None

    def device(self, url: str | None = None) -> Device:
        """Return a new device of the bench, or of another URL."""
        options = DeviceOptions(url=url or self.url, settings=Settings().device, state_directory=self.state)
        return self.driver.create(options)

    def opened(self, device: Device) -> DeviceInfo:
        """Open a device; a bench may override it, such as for a sensor that now and then is too slow to reply."""
        return device.open()


def read_for(device: Device, seconds: float, enough: int = 10**9) -> list[Item]:
    """Read a device for some seconds, or until it has sent enough samples."""
    items: list[Item] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and sum(map(len, sample_blocks(items))) < enough:
        items += device.read(0.1)
    return items


def lost_samples(blocks: Sequence[SampleBlock], rate_hz: float | None) -> int:
    """Return how many samples the clock of a stream shows as lost, or the device itself where there is no clock."""
    if not blocks or blocks[0].time_ns is None:
        return sum(int(block.lost.sum()) for block in blocks)
    clock = SampleClock(blocks[0].stream.clock, 1.0 / rate_hz if rate_hz else None, blocks[0].stream.tick_s)
    return sum(int(np.maximum(p.steps - 1, 0).sum()) for block in blocks for p in clock.place(block))


class DeviceConformance:
    """The cases. A derived class has a fixture ``bench`` that gives a `Bench`."""

    @pytest.fixture
    def device(self, bench: Bench) -> Iterator[Device]:
        device = bench.device()
        yield device
        device.interrupted.clear()
        assert device.restore()
        device.close()
        device.close()  # the reader closes after a failure, and again at the end

    def test_it_opens_identifies_itself_and_streams(self, bench: Bench, device: Device) -> None:
        info = bench.opened(device)
        assert info.id
        assert info.port
        assert device.start().id == info.id
        blocks = sample_blocks(read_for(device, PATIENCE_S, enough=100))
        for block in blocks:
            inertial = [name.startswith(("gyro/", "accel/")) for name in block.stream.channels]
            assert block.values.shape == (len(block), len(block.stream.channels))
            assert np.isfinite(block.values[:, inertial]).all()
            assert block.lost.shape == (len(block),)
            assert block.stream.clock == "none" or block.time_ns is not None
        assert sum(map(len, blocks)) >= 100
        assert device.info().id == info.id

    def test_reading_works_without_start(self, device: Device) -> None:
        """`imumon doctor` changes nothing."""
        device.open()
        assert read_for(device, PATIENCE_S, enough=1)

    def test_a_device_that_is_not_there_is_an_error_with_a_cure(self, bench: Bench) -> None:
        if bench.missing_url is None:
            pytest.skip("the bench has no URL of a device that is not there")
        device = bench.device(bench.missing_url)
        with pytest.raises(DeviceNotFound) as missing:
            device.open()
        assert missing.value.code
        assert missing.value.cure
        device.close()

    def test_lost_samples_show_in_the_clock(self, bench: Bench, device: Device) -> None:
        if bench.lose_samples is None:
            pytest.skip("the bench loses no samples")
        device.open()
        device.start()
        blocks = sample_blocks(read_for(device, PATIENCE_S, enough=50))
        bench.lose_samples()  # when the clock knows the interval
        end = time.monotonic() + PATIENCE_S
        while not lost_samples(blocks, device.info().sample_rate_hz):
            assert time.monotonic() < end, "no lost sample shows"
            blocks += sample_blocks(read_for(device, 0.2))

    def test_a_lost_device_is_an_error_and_comes_back_as_the_same(self, bench: Bench, device: Device) -> None:
        if bench.unplug is None or bench.replug is None:
            pytest.skip("the bench cannot unplug the device")
        info = bench.opened(device)
        device.start()
        read_for(device, PATIENCE_S, enough=20)
        before = device.counters
        bench.unplug()
        with pytest.raises(DeviceLost):
            read_for(device, PATIENCE_S)
        device.close()
        with pytest.raises(DeviceError):  # not another device, such as the next port
            device.open()
        bench.replug()
        assert bench.opened(device).id == info.id
        device.start()
        assert sample_blocks(read_for(device, PATIENCE_S, enough=20))
        assert device.counters.received_bytes >= before.received_bytes

    def test_an_interrupt_ends_a_wait(self, device: Device) -> None:
        device.open()
        device.start()
        device.interrupt()
        begin = time.monotonic()
        with pytest.raises(Interrupted):
            read_for(device, 2.0 * PATIENCE_S)
        assert time.monotonic() - begin < PATIENCE_S

    def test_the_reader_runs_it_from_open_to_close(self, bench: Bench) -> None:
        reader = DeviceReader(bench.device())
        events: list[object] = []

        def read_to(kind: type) -> None:
            end = time.monotonic() + 2.0 * PATIENCE_S
            while time.monotonic() < end:
                if (event := reader.get(0.1)) is not None:
                    events.append(event)
                    if isinstance(event, kind):
                        return
            raise AssertionError(f"no {kind.__name__} among {[type(event).__name__ for event in events]}")

        reader.start()
        read_to(Opened)
        assert not any(isinstance(event, Started) for event in events)
        reader.begin()
        read_to(Started)
        read_to(Items)
        if bench.unplug is not None and bench.replug is not None:
            bench.unplug()
            read_to(Disconnected)
            bench.replug()
            read_to(Started)
            read_to(Items)
        reader.stop()
        read_to(EndOfStream)
        assert isinstance(events[-1], EndOfStream)
        assert events[-1].error is None
        assert reader.join(10.0)
        assert reader.restored is True

    @pytest.mark.parametrize("chunk", [1, 13, 100_000])
    def test_a_decoder_discards_garbage_to_the_byte(self, bench: Bench, chunk: int) -> None:
        decoder = bench.driver.decoder()
        if decoder is None:
            pytest.skip("this device has no bytes")
        data = np.random.default_rng(11).integers(0, 256, GARBAGE_BYTES, np.uint8).tobytes()
        items: list[object] = []
        for start in range(0, len(data), chunk):
            items += decoder.feed(data[start : start + chunk])
            assert decoder.fed == decoder.message_bytes + decoder.discarded + decoder.pending
            assert decoder.pending < GARBAGE_BYTES // 2
        items += decoder.finish()
        assert not sample_blocks(items)
        assert (decoder.fed, decoder.messages, decoder.discarded, decoder.pending) == (
            len(data),
            0,
            len(data),
            0,
        )
