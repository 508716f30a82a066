"""Xsens MTi: recorded packets, laws of the decoder, and the device on its emulator."""

from __future__ import annotations

import json
import math
import signal
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemons import Daemon
from device_conformance import Bench, DeviceConformance, read_for
from hypothesis import given, settings
from hypothesis import strategies as st
from mt_emulator import ACCEL_N, FACTORY, GYRO_N, MtEmulator
from waiting import until

from imumon.config import DeviceSettings
from imumon.sources.device import (
    Device,
    DeviceLost,
    DeviceOptions,
    sample_blocks,
)
from imumon.sources.registry import driver
from imumon.sources.xsens.mt_decoder import MtDecoder, clipped_sensors
from imumon.sources.xsens.mt_messages import DataId, Message, MessageId, encode, fields, outputs

GOLDEN = bytes.fromhex(
    "102002A655 106004 0057472E 201010 3F7F7DC4BC10107D3BA15770BD7EC656 40200C BDA21AF8BE2A8E96411D27A2"
    "40100C B94FC800B9DA24003CC92880 40300C 3C02C89C3C35F6C83CDB0C00 80200C BBB17D81BB9632003C01E841"
    "803010 3F800000B6E33001B6C0400037264800 C0200C BE999C243FB61B563F166AEB 301004 000186DE E02004 00400003"
)
"""A packet of an MTi-300 at 400 Hz, recorded with the program of the manufacturer, which gives the numbers below."""
SHAKEN = bytes.fromhex(
    "102002FB85 106004 01A498DE 40200C C1F246C3C1ECE076C28F853F 80200C 40854D6DC125559EC0908E1F"
    "E02004 00481401"
)
"""Another one, of a sensor that is shaken beyond the ranges of its z accelerometer and y gyroscope."""


def test_recorded_packets_have_the_numbers_that_the_manufacturer_shows() -> None:
    found = fields(GOLDEN)
    assert found[DataId.PACKET_COUNTER] == (42581,)
    assert found[DataId.SAMPLE_TIME_FINE] == (5719854,)
    assert found[DataId.ACCELERATION] == pytest.approx((-0.07915300, -0.16655955, 9.82217598))
    assert found[DataId.DELTA_V] == pytest.approx((-0.00019816, -0.00041607, 0.02455544), abs=5e-9)
    assert found[DataId.RATE_OF_TURN] == pytest.approx((-0.00541657, -0.00458360, 0.00792891), abs=5e-9)
    assert found[DataId.DELTA_Q] == pytest.approx((1.0, -0.00000677, -0.00000573, 0.00000991), abs=5e-9)
    assert found[DataId.STATUS_WORD] == (0x00400003,)
    assert 0xC020 not in found  # the magnetic field has no unit


def test_a_range_that_is_exceeded_is_marked() -> None:
    decoder = MtDecoder()
    (block,) = sample_blocks(decoder.feed(encode(MessageId.DATA, SHAKEN) * 2))
    assert (
        block.saturated.tolist() == [[True, True, False]] * 2
    )  # gyroscope, accelerometer; no bit for temperature
    assert block.stream.kind == "unknown"
    for bit in range(
        32
    ):  # of the status word (MT Low-Level Documentation): bits 8 to 10 accelerometer, 11 to 13 gyroscope
        marked = clipped_sensors({DataId.STATUS_WORD: (1 << bit,)})
        assert marked[0, :2].tolist() == [bit in (11, 12, 13), bit in (8, 9, 10)], bit


@pytest.mark.parametrize(
    ("message_id", "data", "frame"),
    [
        (MessageId.GO_TO_CONFIG, "", "FAFF3000D1"),
        (MessageId.GO_TO_MEASUREMENT, "", "FAFF1000F1"),
        (MessageId.REQUEST_FIRMWARE, "", "FAFF1200EF"),
        (0x03, "037003F8", "FAFF0304037003F88C"),
        (0x13, "0108020000002500011534", "FAFF130B010802000000250001153469"),
        (
            MessageId.OUTPUT_CONFIGURATION,
            "1020FFFF1060FFFF201001904020019040100190403001908020019080300190C0200064"
            "0810000A30100032E020FFFF",
            "FAFFC0301020FFFF1060FFFF201001904020019040100190403001908020019080300190C0200064"
            "0810000A30100032E020FFFF99",
        ),
        (0xC1, "1020FFFF1060FFFF", "FAFFC1081020FFFF1060FFFF9C"),
    ],
)
def test_recorded_messages_are_encoded_and_decoded_byte_for_byte(
    message_id: int, data: str, frame: str
) -> None:
    assert encode(message_id, bytes.fromhex(data)).hex().upper() == frame
    decoder = MtDecoder()
    assert decoder.feed(bytes.fromhex(frame)) == [Message(message_id, bytes.fromhex(data))]


def packet(k: int, *, kind: str = "deltas", start: int = 0) -> bytes:
    values = {
        "deltas": struct.pack(">HB4f", 0x8030, 16, 1.0, 5e-4, 0.0, 0.0)
        + struct.pack(">HB3f", 0x4010, 12, 0, 0, 0.1),
        "points": struct.pack(">HB3f", 0x8020, 12, 0.1, 0, 0) + struct.pack(">HB3d", 0x4023, 24, 0, 0, 10),
    }[kind]
    ticks = (start + 100 * k) % (1 << 32)
    return encode(MessageId.DATA, struct.pack(">HBHHBI", 0x1020, 2, k % (1 << 16), 0x1060, 4, ticks) + values)


@pytest.mark.parametrize("kind", ["deltas", "points"])
@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 1e38])
def test_a_valid_message_with_an_impossible_number_is_counted_and_lost(kind: str, number: float) -> None:
    """Its checksum is right, and its number would be in the sums for ever."""
    name = struct.pack(">HB", 0x4010 if kind == "deltas" else 0x8020, 12)
    good = packet(150, kind=kind)
    body = good[4:-1].replace(name + good[4:-1].partition(name)[2][:4], name + struct.pack(">f", number))
    bad = encode(MessageId.DATA, body)
    assert bad != good
    decoder = MtDecoder()
    packets = [bad if k == 150 else packet(k, kind=kind) for k in range(300)]
    blocks = sample_blocks(decoder.feed(b"".join(packets)))
    assert sum(map(len, blocks)) == 299 - (kind == "deltas")
    assert all(np.abs(block.values[:, :6]).max() < 11.0 for block in blocks)
    assert sum(int(block.lost.sum()) for block in blocks) == decoder.bad_checksums == 1


@pytest.mark.parametrize("kind", ["deltas", "points"])
def test_samples_are_rates_and_both_counters_wrap(kind: str) -> None:
    decoder = MtDecoder()
    numbers = [*range(65_400, 65_600), *range(65_603, 65_800), *range(105_800, 105_900)]
    start = (1 << 32) - 100 * 65_500
    blocks = sample_blocks(decoder.feed(b"".join(packet(k, kind=kind, start=start) for k in numbers)))
    values = np.concatenate([block.values for block in blocks])
    assert len(values) == len(numbers) - (kind == "deltas")  # the first delta has no interval yet
    assert values[:, :6] == pytest.approx(np.tile([0.1, 0, 0, 0, 0, 10.0], (len(values), 1)), rel=1e-6)
    assert np.isnan(values[:, 6]).all()
    steps = np.diff(np.concatenate([block.time_ns for block in blocks if block.time_ns is not None]))
    assert sorted(set(steps.tolist())) == [10_000_000, 40_000_000, 40_001 * 10_000_000]
    assert sum(int(block.lost.sum()) for block in blocks) == 40_003


def test_a_restart_is_no_gap_of_known_length() -> None:
    decoder = MtDecoder()
    blocks = sample_blocks(decoder.feed(b"".join(packet(k, start=10**7) for k in range(50))))
    blocks += sample_blocks(decoder.feed(b"".join(packet(k) for k in range(50))))
    times = np.concatenate([block.time_ns for block in blocks if block.time_ns is not None])
    assert (np.diff(times) < 0).sum() == 1


NOISE = st.lists(
    st.one_of(
        st.binary(max_size=30), st.builds(packet, st.integers(0, 99)), st.sampled_from([b"\xfa\xff", b"\xfa"])
    ),
    max_size=12,
)


@given(NOISE, st.integers(1, 50))
@settings(deadline=None, max_examples=80)
def test_bytes_are_conserved_for_any_chunks(parts: list[bytes], size: int) -> None:
    data, counts = b"".join(parts), []
    for step in (size, len(data) + 1):
        decoder, samples = MtDecoder(), 0
        for at in range(0, len(data), step):
            samples += sum(map(len, sample_blocks(decoder.feed(data[at : at + step]))))
            assert decoder.fed == decoder.message_bytes + decoder.discarded + decoder.pending
        samples += sum(map(len, sample_blocks(decoder.finish())))
        counts.append((samples, decoder.messages, decoder.discarded, decoder.bad_checksums))
    assert counts[0] == counts[1]


class TestMti(DeviceConformance):
    """The contract, on the emulator."""

    @pytest.fixture
    def bench(self, tmp_path: Path) -> Iterator[Bench]:
        with MtEmulator(link=tmp_path / "mti", seed=1) as sensor:
            yield Bench(
                driver=driver("xsens"), state=tmp_path, url=f"xsens:{sensor.path}", missing_url="xsens:/dev/missing",
                unplug=sensor.unplug, replug=sensor.replug, lose_samples=sensor.lose_samples,
            )  # fmt: skip


def device_of(sensor: MtEmulator, state: Path | None = None, **given: Any) -> Device:
    options = DeviceOptions(
        url=f"xsens:{sensor.path}", settings=DeviceSettings(**given), state_directory=state
    )
    return driver("xsens").create(options)


@contextmanager
def started(sensor: MtEmulator, state: Path, **given: Any) -> Iterator[Device]:
    """Yield a device that is open and has begun; restore the sensor and close it."""
    device = device_of(sensor, state, **given)
    device.open()
    device.start()
    yield device
    assert device.restore()
    device.close()


def test_it_is_identified_configured_and_restored(tmp_path: Path) -> None:
    with MtEmulator(link=tmp_path / "mti", seed=1) as sensor:
        device = device_of(sensor, tmp_path)
        info = device.open()
        assert (info.id, info.model, info.firmware) == ("mti-037003f8", "MTi-300-2A5G4", "1.8.2")
        assert sensor.configuration == FACTORY  # nothing is changed
        assert sensor.measuring
        info = device.start()
        assert (info.stream, info.sample_rate_hz) == ("deltas", 100.0)
        assert DataId.DELTA_Q in dict(outputs(sensor.configuration))
        assert list(tmp_path.glob("*.found.json"))
        values = np.concatenate([b.values for b in sample_blocks(read_for(device, 20.0, enough=300))])
        assert values[:, :3].std(axis=0) == pytest.approx([GYRO_N * 10.0] * 3, rel=0.15)
        assert values[:, 3:6].std(axis=0) == pytest.approx([ACCEL_N * 10.0] * 3, rel=0.15)
        assert np.nanmean(values[:, 6]) == pytest.approx(31.5)
        assert device.restore()
        device.close()
        assert sensor.configuration == FACTORY
        assert sensor.measuring
        assert not list(tmp_path.glob("*.found.json"))


def test_what_a_killed_run_left_behind_is_restored(tmp_path: Path) -> None:
    with MtEmulator(link=tmp_path / "mti") as sensor:
        killed = device_of(sensor, tmp_path)
        killed.open()
        killed.start()
        killed.close()  # without restore
        assert sensor.configuration != FACTORY
        with started(sensor, tmp_path):
            pass
        assert sensor.configuration == FACTORY


def test_a_sensor_that_stops_is_started_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.sources.xsens.mt_session.MtSession.quiet_s", 0.5)
    with MtEmulator(link=tmp_path / "mti") as sensor, started(sensor, tmp_path) as device:
        read_for(device, 20.0, enough=20)
        sensor.measuring, sensor.configuration = False, FACTORY
        with pytest.raises(DeviceLost):
            read_for(device, 20.0, enough=10**6)
        device.close()
        device.open()
        device.start()
        assert sample_blocks(read_for(device, 20.0, enough=20))
        assert sensor.configuration != FACTORY


def test_listen_only_writes_nothing(tmp_path: Path) -> None:
    with MtEmulator(link=tmp_path / "mti") as sensor:
        device = device_of(sensor, tmp_path, listen_only=True)
        info = device.open()
        assert info.serial is None
        device.start()
        blocks = sample_blocks(read_for(device, 20.0, enough=50))
        assert blocks[0].stream.kind == "unknown"
        assert device.restore()
        device.close()
        assert sensor.configuration == FACTORY
        assert sensor._received.fed == 0


def test_a_daemon_measures_an_mti_and_replays_its_recording(tmp_path: Path) -> None:
    capture = tmp_path / "capture"
    with MtEmulator(link=tmp_path / "mti", seed=2) as sensor:
        with Daemon(f"xsens:{sensor.path}", tmp_path / "state", "--record", str(capture)) as daemon:
            made = daemon.wait(lambda made: made.session.samples > 500)
            assert made.device.model == "MTi-300-2A5G4"
            assert made.session.missing == 0
            assert made.channels["gyro/x"].coefficients["N"].value == pytest.approx(GYRO_N, rel=0.2)
            daemon.stop(signal.SIGTERM)
        until(lambda: sensor.configuration == FACTORY)
    header = json.loads(capture.read_bytes().split(b"\n")[0].removeprefix(b"#imumon-recording "))
    assert header["driver"] == "xsens"
    decoder = driver("xsens").decoder(header["settings"])
    blocks = sample_blocks(decoder.feed(capture.read_bytes().split(b"\n", 1)[1]))
    assert sum(map(len, blocks)) > 500
