"""Times that jump by any length, at every door: bounded memory, an orderly end, and what came before is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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
from imumon.model.samples import SampleBlock
from imumon.model.saved_state import pack, unpack
from imumon.record import Record, RecordOptions
from imumon.ros2.node import Received
from imumon.ros2.topic_url import parse_url
from imumon.sources.device import sample_blocks
from imumon.sources.lines.line_decoder import LineDecoder
from imumon.sources.ros2.imu_assembler import ImuAssembler
from imumon.sources.vn100.binary import BinaryLayout, Group
from imumon.sources.vn100.decoder import Vn100Decoder

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


def within(times: Iterable[int], low: int, high: int) -> list[int]:
    """Times as a field of a message holds them."""
    return [max(low, min(int(time), high)) for time in times]


@contextmanager
def bounded_memory() -> Iterator[None]:
    """The most that was ever resident grows by no more than libraries take."""
    before = getrusage(RUSAGE_SELF).ru_maxrss  # kB
    yield
    assert getrusage(RUSAGE_SELF).ru_maxrss - before < MOST_KB


def lines(form: str, divisor: int) -> Callable[[list[int]], Iterator[SampleBlock]]:
    def blocks(times: list[int]) -> Iterator[SampleBlock]:
        decoder = LineDecoder({"accept": ""})
        for time, row in zip(times, VALUES, strict=False):
            whole, rest = divmod(abs(time), divisor)
            digits = f"{'-' * (time < 0)}{whole}.{rest:0{len(str(divisor)) - 1}d}"
            yield from decoder.feed(f"{form.format(digits, *row)}\n".encode())
        yield from decoder.finish()

    return blocks


def vn100(times: list[int]) -> Iterator[SampleBlock]:
    decoder, layout = Vn100Decoder(), BinaryLayout.of({Group.COMMON: 0x0001, Group.IMU: 0x000C})
    for time, row in zip(within(times, 0, 2**64 - 1), VALUES, strict=False):
        message = {"timeStartup": [time], "uncompAccel": [row[3:]], "uncompGyro": [row[:3]]}
        yield from sample_blocks(decoder.feed(layout.encode(message)))
    yield from sample_blocks(decoder.finish())


def ros2(times: list[int]) -> Iterator[SampleBlock]:
    assembler = ImuAssembler(parse_url("ros2:/imu"))
    stamped = within(times, -(2**31) * 10**9, (2**31 - 1) * 10**9)
    for k, (time, row) in enumerate(zip(stamped, VALUES, strict=False)):
        payload = imu_payload(time, row[:3].tolist(), row[3:].tolist())
        message = Received(payload, k + 1, int(times[k]), b"a")
        items = assembler.add([message], {}, START_NS + k * STEP_NS)
        yield from (item for item in items if isinstance(item, SampleBlock))
    yield from (item for item in assembler.finish() if isinstance(item, SampleBlock))


LABELLED = "t={} gx={} gy={} gz={} ax={} ay={} az={}"
DOORS = {
    "labelled s": lines(LABELLED, 10**9),
    "labelled ms": lines(LABELLED, 10**6),
    "us": lines("{},{},{},{},{},{},{}", 10**3),
    "vn100": vn100,
    "ros2": ros2,
}


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
