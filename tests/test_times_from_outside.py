"""Times that jump by any length, at every door: bounded memory, an orderly end, and what came before is kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import accumulate
from resource import RUSAGE_SELF, getrusage

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros2_actors import imu_payload

from imumon.model.report import DeviceDescription, SessionCounters
from imumon.model.samples import ACCEL, GYRO, SampleBlock, Stream
from imumon.model.saved_state import pack, unpack
from imumon.record import Record, RecordOptions
from imumon.ros2.node import Received
from imumon.ros2.topic_url import parse_url
from imumon.sources.device import sample_blocks
from imumon.sources.lines.line_decoder import LineDecoder
from imumon.sources.ros2.imu_assembler import ImuAssembler

BEFORE, BETWEEN = 300, 100  # samples before the first jump, and after each
STEP_NS, START_NS = 10_000_000, 10**12
MOST_KB = 250_000
VALUES = np.random.default_rng(1).normal([0, 0, 0, 0, 0, 9.81], 1e-3, (BEFORE + 3 * BETWEEN, 6))

JUMPS = st.lists(
    st.builds(lambda sign, exponent: sign * 10**exponent, st.sampled_from([-1, 1]), st.integers(0, 18)),
    min_size=1,
    max_size=3,
)


def stamps(jumps: list[int]) -> list[int]:
    """ns, of samples at 100 Hz with some jumps of the clock between them."""
    steps = [STEP_NS] * (BEFORE + BETWEEN * len(jumps) - 1)
    for k, jump in enumerate(jumps):
        steps[BEFORE + k * BETWEEN - 1] += jump
    return list(accumulate(steps, initial=START_NS))


@contextmanager
def bounded_memory() -> Iterator[None]:
    """The most that was ever resident grows by no more than libraries take."""
    before = getrusage(RUSAGE_SELF).ru_maxrss  # kB
    yield
    assert getrusage(RUSAGE_SELF).ru_maxrss - before < MOST_KB


def of_lines(times: list[int]) -> Iterator[SampleBlock]:
    decoder = LineDecoder({"accept": ""})
    for time, row in zip(times, VALUES, strict=False):
        seconds = f"{'-' * (time < 0)}{abs(time) // 10**9}.{abs(time) % 10**9:09d}"
        line = "t={} gx={} gy={} gz={} ax={} ay={} az={}\n".format(seconds, *row)
        yield from decoder.feed(line.encode())
    yield from decoder.finish()


def of_messages(times: list[int]) -> Iterator[SampleBlock]:
    """Times of a sample clock of 64 bits, as of a VN-100."""
    stream = Stream("uncompensated", (*GYRO, *ACCEL), "test", "startup")
    none_lost = np.zeros(1, np.int64)
    for time, row in zip(times, VALUES, strict=False):
        yield SampleBlock(stream, row[None], np.array([min(max(time, 0), 2**63 - 1)]), none_lost)


def of_hosts(times: list[int]) -> Iterator[SampleBlock]:
    """Stamps of ROS 2, whose seconds have 32 bits."""
    assembler = ImuAssembler(parse_url("ros2:/imu"))
    for k, (time, row) in enumerate(zip(times, VALUES, strict=False)):
        stamp = max(-(2**31) * 10**9, min(time, (2**31 - 1) * 10**9))
        message = Received(imu_payload(stamp, row[:3].tolist(), row[3:].tolist()), k + 1, time, b"a")
        yield from sample_blocks(assembler.add([message], {}, START_NS + k * STEP_NS))
    yield from sample_blocks(assembler.finish())


DOORS = {"lines": of_lines, "messages": of_messages, "hosts": of_hosts}


@pytest.mark.few
@pytest.mark.parametrize("door", DOORS)
@given(jumps=JUMPS)
@settings(deadline=None, max_examples=4, suppress_health_check=[HealthCheck.too_slow])
def test_live_times_that_jump(door: str, jumps: list[int]) -> None:
    times = stamps(jumps)
    monitor = Record(RecordOptions(periods=True))
    with bounded_memory():
        for block in DOORS[door](times):
            monitor.feed(block)
        monitor.flush()
        monitor.end()
        report = monitor.report(datetime.now(UTC), DeviceDescription(id="x"), "stopped", SessionCounters())
        saved = pack(monitor.save())
    assert report.session.samples == monitor.samples > 0
    kept = monitor.samples + monitor.left_out().get("earlier_record", 0)
    assert BEFORE <= kept <= len(times)
    restored = Record(RecordOptions(periods=True))
    restored.restore(unpack(saved), 0.0)
    restored.accept_restored()
    assert restored.samples == monitor.samples
