"""Messages of ROS 2 become blocks of samples, whatever arrives."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ros2_actors import imu_payload
from ros2_messages import encode, header, samples

from imumon.model.samples import ACCEL, GYRO, Item, SampleBlock
from imumon.record import Record
from imumon.ros2.node import Received
from imumon.ros2.ros_messages import MAGNETIC_FIELD, TEMPERATURE
from imumon.ros2.topic_url import parse_url
from imumon.sources.ros2.imu_assembler import ImuAssembler

UNIX_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000


# ---------------------------------------------------------------------- messages to blocks


def received(
    index: int, *, sequence: int | None = None, publisher: bytes = b"a", payload: bytes | None = None
) -> Received:
    stamp = UNIX_NS + index * STEP_NS
    number = float(index + 1)
    made = payload if payload is not None else imu_payload(stamp, [number, 2.0, 3.0], [4.0, 5.0, number])
    return Received(made, index + 1 if sequence is None else sequence, stamp, publisher)


def assemble(url: str, messages: list[Received], **others: list[Received]) -> tuple[ImuAssembler, list[Item]]:
    """Everything that some messages become; 40 arrive at once."""
    made = ImuAssembler(parse_url(url))
    items: list[Item] = []
    for at in range(0, len(messages), 40):
        part = messages[at : at + 40]
        until = max(message.source_ns or 0 for message in part)
        now = {name: [m for m in others[name] if (m.source_ns or 0) <= until] for name in others}
        others = {name: [m for m in others[name] if (m.source_ns or 0) > until] for name in others}
        items += made.add(part, now, until)
    return made, items + made.finish()


def test_messages_become_samples_at_their_stamps() -> None:
    made, items = assemble("ros2:/imu", [received(k) for k in range(500)])
    assert made.stream.channels == (*GYRO, *ACCEL)
    assert made.stream.kind == "unknown"
    assert samples(items)[:, 0].tolist() == [float(k + 1) for k in range(500)]
    times = np.concatenate(
        [item.time_ns for item in items if isinstance(item, SampleBlock) and item.time_ns is not None]
    )
    assert times.tolist() == [UNIX_NS + k * STEP_NS for k in range(500)]
    assert (made.messages, made.invalid, made.lost, made.remarks) == (500, 0, 0, [])


def test_lost_messages_are_not_missing_samples() -> None:
    """What the driver never published is missing; what the network lost is missing and counted as lost."""
    rows = [received(k, sequence=k + 1 if k < 100 else k - 9) for k in range(500) if not 100 <= k < 110]
    made, _ = assemble("ros2:/imu", rows)
    assert made.lost == 0
    lossy = [received(k) for k in range(500) if k not in (200, 300, 301)]
    made, items = assemble("ros2:/imu", lossy)
    assert (made.lost, made.losses) == (3, 2)
    assert made.lost + len(samples(items)) == 500


def test_a_sensor_that_is_always_zero_is_left_out_with_a_remark() -> None:
    rows = [
        received(k, payload=imu_payload(UNIX_NS + k * STEP_NS, [0.0] * 3, [1.0, 2.0, k])) for k in range(300)
    ]
    made, _ = assemble("ros2:/imu", rows)
    assert made.stream.channels == ACCEL
    assert made.remarks == ["gyro is zero in all messages of /imu: left out"]


def test_invalid_messages_are_counted_and_their_samples_are_missing() -> None:
    rows = [received(k) for k in range(400)]
    rows[200] = received(200, payload=b"\0\1\0\0nonsense")
    rows[300] = received(
        300, payload=imu_payload(UNIX_NS + 300 * STEP_NS, [float("nan"), 0.0, 0.0], [0.0] * 3)
    )
    made, items = assemble("ros2:/imu", rows)
    assert made.invalid == 2
    assert len(samples(items)) == 398
    assert made.messages == len(samples(items)) + made.invalid


def test_two_publishers_are_not_mixed() -> None:
    other = [
        received(k, publisher=b"b", payload=imu_payload(UNIX_NS + k, [-1.0] * 3, [-1.0] * 3))
        for k in range(400)
    ]
    mixed = [each for pair in zip([received(k) for k in range(400)], other, strict=True) for each in pair]
    made, items = assemble("ros2:/imu", mixed)
    assert len(samples(items)) == 400
    assert made.invalid == 400
    assert (samples(items) > 0.0).all()
    assert made.other_sender == 400
    assert made.remarks == ["several nodes publish /imu: only the first is used"]


def test_a_publisher_that_restarts_is_followed_after_half_a_second() -> None:
    rows = [received(k) for k in range(400)]
    rows += [received(k, sequence=k - 599, publisher=b"b") for k in range(600, 1000)]
    made, items = assemble("ros2:/imu", rows)
    assert len(samples(items)) == 800
    assert (made.lost, made.invalid) == (0, 0)


@pytest.mark.parametrize("delay_ns", [0, 1_000_000])
def test_separate_topics_are_paired_by_their_stamps(delay_ns: int) -> None:
    gyro = [
        received(k, payload=imu_payload(UNIX_NS + k * STEP_NS, [1.0, 2.0, float(k)], [0.0] * 3))
        for k in range(600)
    ]
    accel = [
        received(k, payload=imu_payload(UNIX_NS + k * STEP_NS + delay_ns, [0.0] * 3, [float(k), 1.0, 9.81]))
        for k in range(600)
        if k != 450
    ]
    made, items = assemble("ros2:/gyro?accel=/accel", gyro, accel=accel)
    found = samples(items)
    assert made.stream.channels == (*GYRO, *ACCEL)
    assert len(found) == 599
    assert (found[:, 2] == found[:, 3]).all()
    assert made.invalid == 1


def magnetic(k: int) -> Received:
    stamp, zero = UNIX_NS + k * STEP_NS, [0.0] * 9
    value = {"x": 2e-5, "y": 0.0, "z": -4e-5}
    fields = {"header": header(stamp), "magnetic_field": value, "magnetic_field_covariance": zero}
    return Received(encode(MAGNETIC_FIELD, fields), k + 1, stamp, b"m")


def temperature(k: int) -> Received:
    """One a second."""
    fields = {"header": header(UNIX_NS), "temperature": 25.0 + k, "variance": 0.0}
    return Received(encode(TEMPERATURE, fields), k + 1, UNIX_NS + k * 10**9, b"t")


def test_magnetic_field_and_temperature_have_the_units_of_channels() -> None:
    rows = [received(k) for k in range(600)]
    field = [magnetic(k) for k in range(600)]
    warm = [temperature(k) for k in range(3)]
    made, items = assemble("ros2:/imu?mag=/mag&temperature=/temp", rows, mag=field, temperature=warm)
    assert made.stream.channels[-4:] == ("mag/x", "mag/y", "mag/z", "temperature")
    found = samples(items)
    assert found[0, 6:9].tolist() == pytest.approx([0.2, 0.0, -0.4])
    assert (found[0, -1], found[-1, -1]) == (25.0, 27.0)
    assert len(found) == 600


@settings(max_examples=30)
@given(st.data())
def test_hostile_messages_never_raise_and_counts_add_up(data: st.DataObject) -> None:
    """Any stamps, sequence numbers, publishers and bytes: a message is a sample, a duplicate, or invalid."""
    stamps = st.one_of(
        st.integers(-(2**31), 2**31 - 1).map(lambda s: s * 10**9),
        st.integers(0, 400).map(lambda k: UNIX_NS + k * STEP_NS),
        st.sampled_from([0, 1, UNIX_NS]),
    )
    shape = data.draw(st.sampled_from(["steady", "bunched", "random", "zero"]))
    many = data.draw(st.integers(0, 700))
    seed = data.draw(st.randoms(use_true_random=False))
    odd = data.draw(st.lists(st.tuples(st.integers(0, 700), stamps), max_size=30))
    index = np.arange(many)
    times = {
        "steady": UNIX_NS + index * STEP_NS,
        "bunched": UNIX_NS + index // 7 * 7 * STEP_NS,
        "random": UNIX_NS + np.array([seed.randrange(10**12) for _ in index], np.int64),
        "zero": index * 0,
    }[shape].tolist()
    for at, stamp in odd:
        if at < many:
            times[at] = stamp
    rows = []
    for k, stamp in enumerate(times):
        payload = struct.pack("<4siII4x", b"\0\1\0\0", stamp // 10**9, stamp % 10**9, 1)
        payload += (
            struct.pack("<37d", *[k * 7919 % 101 / 7.0] * 37) if seed.random() < 0.98 else b"\0\1\0\0rubbish"
        )
        sequence = seed.choice([None, k, 2**62, -5, k + 1]) if seed.random() < 0.1 else k + 1
        rows.append(Received(payload, sequence, UNIX_NS + k * STEP_NS, seed.choice([b"a", b"a", b"b"])))
    made, items = assemble("ros2:/imu", rows)
    blocks = [item for item in items if isinstance(item, SampleBlock)]
    assert made.messages == len(rows) == sum(map(len, blocks)) + made.invalid
    monitor = Record()
    for block in blocks:
        monitor.feed(block)
    monitor.flush()


def test_a_stream_continues_over_a_reconnection() -> None:
    """The temperature comes late after it: the stream is still the same, so the record can continue."""
    url = parse_url("ros2:/imu?temperature=/temp")
    first = ImuAssembler(url)
    first.add([received(k) for k in range(400)], {"temperature": [temperature(0)]}, UNIX_NS)
    first.finish()
    again = ImuAssembler(url, first)
    items = again.add([received(k) for k in range(400)], {"temperature": []}, UNIX_NS) + again.finish()
    assert first.stream is not None
    assert again.stream == first.stream
    assert (samples(items)[:, -1] == 25.0).all()
