"""Device probe: observation of what a device sends in a few seconds, without changing it.

A device that a daemon reads is not opened: the counters in two reports of the daemon give the same facts.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields, replace

import numpy as np

from imumon.bus import Subscriber
from imumon.model.report import Report
from imumon.model.samples import DeviceInfo, Ints, RawBytes, SampleBlock, Stream
from imumon.sources.device import READ_S, Device, DeviceLost, Observation

DEVICE_CAVEATS = ("compensated", "unknown_compensation", "aliased")
"""Caveats of a report that describe the device, not the record."""


@dataclass(slots=True)
class _StreamStatistics:
    """Samples of one stream; `first_s` and `last_s` are the arrival of the first and last block."""

    stream: Stream
    count: int = 0
    first_count: int = 0  # samples of the first block
    first_s: float = 0.0
    last_s: float = 0.0
    lost: int = 0
    times: list[Ints] = field(default_factory=list)

    def add(self, block: SampleBlock, now: float) -> None:
        if not self.count:
            self.first_s, self.first_count = now, len(block)
        self.count += len(block)
        self.last_s = now
        self.lost += int(block.lost.sum())
        if block.time_ns is not None:
            self.times.append(block.time_ns)


def observe_device(device: Device, seconds: float) -> Observation:
    """Return what an open device sends in `seconds` seconds, from its first valid message on."""
    streams: dict[str, _StreamStatistics] = {}
    first, base = device.counters, None
    start = data_at = now = time.monotonic()
    longest_pause, lost = 0.0, None
    try:
        while now < start + seconds:
            items = device.read(min(READ_S, start + seconds - now))
            now = time.monotonic()
            if any(isinstance(item, SampleBlock | RawBytes) for item in items):
                longest_pause, data_at = max(longest_pause, now - data_at), now
            if base is None and device.counters.messages > first.messages:
                base = device.counters
            for item in items:
                if isinstance(item, SampleBlock):
                    streams.setdefault(item.stream.kind, _StreamStatistics(item.stream)).add(item, now)
    except DeviceLost as error:
        lost = error.message
    now, last, info = time.monotonic(), device.counters, device.info()
    base = base or first
    observation = Observation(
        info=info,
        seconds=now - start,
        bytes=last.received_bytes - base.received_bytes,
        messages=last.messages - base.messages,
        bad_checksums=last.bad_checksums - base.bad_checksums,
        discarded=last.discarded_bytes - base.discarded_bytes,
        longest_pause_s=max(longest_pause, now - data_at),
        lost=lost,
    )
    stream = streams.get(info.stream) if info.stream else next(iter(streams.values()), None)
    if stream is None:
        return observation
    if info.stream is None:  # the device leaves it to its samples
        info = replace(info, stream=stream.stream.kind, source=stream.stream.source)
    return _with_samples(replace(observation, info=info), stream)


def _with_samples(observation: Observation, stream: _StreamStatistics) -> Observation:
    """Return the observation with the rate, the losses and the clock of the samples."""
    span = stream.last_s - stream.first_s
    long_enough = span >= READ_S
    # the first block may hold samples from before: the rate is that of the samples after it
    rate = (stream.count - stream.first_count) / span if long_enough else None
    observation = replace(observation, samples=stream.count, rate_hz=rate, missing=stream.lost)
    if stream.stream.clock != "startup" or not stream.times:
        return observation
    steps = np.diff(np.concatenate(stream.times))
    jumps = (steps < 0) | (steps > round(1e9 * observation.seconds))  # no gap is longer than the observation
    observation = replace(observation, clock_jumps=int(jumps.sum()))
    regular = steps[~jumps & (steps > 0)]
    if not len(regular):
        return observation
    missing = int(np.maximum(np.rint(regular / np.median(regular)) - 1, 0).sum())
    later, jumped = steps[stream.first_count - 1 :], jumps[stream.first_count - 1 :]
    ratio = float(later[~jumped].sum()) / 1e9 / span if long_enough else None
    return replace(observation, missing=missing, clock_ratio=ratio)


def observe_daemon(subscriber: Subscriber, report: Report, seconds: float) -> Observation:
    """Return what the daemon that reads the device counts in `seconds` seconds."""
    start, last = time.monotonic(), report
    while (time.monotonic() < start + seconds or last is report) and time.monotonic() < start + 2 * seconds:
        time.sleep(READ_S)
        last, _ = subscriber.report(report.device.id) or (last, 0.0)
    a, b, device = report.session, last.session, last.device
    elapsed = b.elapsed_s - a.elapsed_s
    shared = {f.name: getattr(device, f.name) for f in fields(DeviceInfo) if hasattr(device, f.name)}
    info = DeviceInfo(**shared, caveats=tuple(c for c in last.caveats if c in DEVICE_CAVEATS))
    return Observation(
        info=info,
        seconds=last.host_s(elapsed) if elapsed > 0 else time.monotonic() - start,
        bytes=b.received_bytes - a.received_bytes,
        messages=b.samples - a.samples,
        bad_checksums=b.bad_checksums - a.bad_checksums,
        discarded=b.discarded_bytes - a.discarded_bytes,
        samples=b.samples - a.samples,
        missing=b.missing - a.missing,
        rate_hz=(b.samples - a.samples) / elapsed if elapsed > 0 else None,
        daemon=device.id,
        state=last.state,
    )
