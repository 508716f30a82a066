"""Line: what the sensor itself tells in a few seconds; its registers are read and none is written.

Where a daemon of ours has the port it is asked instead: the differences of its counters tell the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from imumon.devices.vn100.device_info import Vn100Info
from imumon.devices.vn100.vn100_session import SessionError, StreamRequest, Vn100Session
from imumon.doctor.observations import Heard, PortLook
from imumon.doctor.probe_host import with_latency
from imumon.recordings import PortError, PortGone, SerialPort
from imumon.report import Report
from imumon.samples import Ints, SampleBlock

FIRST_BAUD = 115200
LEAP_NS = 10_000_000_000
BEAT_S = 0.2
OF_THE_SENSOR = ("compensated", "unknown_compensation", "aliased")
"""Caveats that stand for the sensor's settings and not for what happened to the record."""


class Unheard(Exception):
    """The sensor cannot be heard; the text says why and how to mend it."""


@dataclass(slots=True)
class _Taken:
    """Samples of one stream while listening; `first` and `last` are when they arrived, s of the room."""

    stream: Any
    count: int = 0
    first: float = 0.0
    last: float = 0.0
    lost: int = 0
    times: list[Ints] = field(default_factory=list)

    def add(self, block: SampleBlock, now: float) -> None:
        if not self.count:
            self.first = now
        self.count += len(block)
        self.last = now
        self.lost += int(block.lost.sum())
        if block.time_ns is not None:
            self.times.append(block.time_ns)


def listen(
    look: PortLook, listen_only: bool, seconds: float, progress: Callable[[str], None] = lambda text: None
) -> tuple[Heard, PortLook]:
    """Open the port, know the sensor and hear what it sends; the look comes back with the latency timer.

    Raises
    ------
    Unheard : the port does not open, or nothing on it answers like a sensor.
    """
    try:
        with SerialPort(look.path, FIRST_BAUD) as port:
            look = with_latency(look)
            wanted = StreamRequest(listen_only=listen_only)
            session = Vn100Session(port, wanted, time.monotonic, progress=progress)
            facts = session.connect()
            progress(f"listening for {seconds:g} s")
            return _hear(session, facts, seconds), look
    except (PortError, PortGone, SessionError) as error:
        raise Unheard(str(error)) from None


def _hear(session: Vn100Session, facts: Vn100Info, seconds: float) -> Heard:
    """Listen for a while; what came before the first valid message does not count."""
    decoder, taken = session.decoder, dict[str, _Taken]()
    start = heard_at = time.monotonic()
    before: tuple[int, int, int, int] | None = None
    pause, gone = 0.0, None
    try:
        while (now := time.monotonic()) < start + seconds:
            data = session.read(min(BEAT_S, start + seconds - now))
            items, now = session.decode(data), time.monotonic()
            counters = (decoder.fed, decoder.messages, decoder.bad_checksums, decoder.discarded)
            if data:
                pause, heard_at = max(pause, now - heard_at), now
            if decoder.messages and before is None:
                before = counters
            for item in items:
                if isinstance(item, SampleBlock):
                    taken.setdefault(item.stream.kind, _Taken(item.stream)).add(item, now)
    except PortGone as error:
        gone = str(error)
    pause = max(pause, time.monotonic() - heard_at)
    now_counters = (decoder.fed, decoder.messages, decoder.bad_checksums, decoder.discarded)
    since = tuple(a - b for a, b in zip(now_counters, before or now_counters, strict=True))
    facts = session.facts()
    heard = Heard(
        facts=facts,
        seconds=time.monotonic() - start,
        bytes=since[0],
        messages=since[1],
        bad_checksums=since[2],
        discarded=since[3],
        longest_pause_s=pause,
        gone=gone,
    )
    stream = facts.stream and taken.get(facts.stream)
    return _with_samples(heard, stream) if stream else heard


def _with_samples(heard: Heard, taken: _Taken) -> Heard:
    """Rate, losses and clock of the samples that came."""
    span = taken.last - taken.first
    # the first block came at once and may hold several samples: what came behind it is the rate
    rate = None if span < 0.5 else taken.count / (span + span / max(taken.count, 1))
    heard = replace(heard, samples=taken.count, rate_hz=rate, missing=taken.lost)
    if taken.stream.clock != "startup" or not taken.times:
        return heard
    steps = np.diff(np.concatenate(taken.times))
    leaps = (steps < 0) | (steps > LEAP_NS)
    steady = steps[~leaps & (steps > 0)]
    if not len(steady):
        return replace(heard, leaps=int(leaps.sum()))
    tick = float(np.median(steady))
    missing = int(np.maximum(np.rint(steady / tick) - 1, 0).sum())
    ratio = float(steady.sum()) / 1e9 / span if span >= 0.5 else None
    return replace(heard, missing=missing, clock_ratio=ratio, leaps=int(leaps.sum()))


def ask_daemon(feed: Any, made: Report, seconds: float) -> Heard:
    """What the daemon that reads the sensor counts in a few seconds."""
    start, first, last = time.monotonic(), made, made
    while (time.monotonic() < start + seconds or last is made) and time.monotonic() < start + 2 * seconds:
        time.sleep(BEAT_S)
        last = feed.reports()[made.device.id][0]
    a, b, device = first.session, last.session, last.device
    passed = b.elapsed_s - a.elapsed_s
    facts = Vn100Info(
        id=device.id,
        model=device.model,
        serial=device.serial,
        firmware=device.firmware,
        port=device.port,
        baud=device.baud,
        stream=device.stream,  # type: ignore[arg-type]
        source=device.source,
        clock=device.clock,
        sample_rate_hz=device.sample_rate_hz,
        alias_factor=device.alias_factor,
        settings=device.settings,
        caveats=tuple(word for word in last.caveats if word in OF_THE_SENSOR),
    )
    return Heard(
        facts=facts,
        seconds=passed / last.speed if passed > 0 else time.monotonic() - start,
        bytes=b.received_bytes - a.received_bytes,
        messages=b.samples - a.samples,
        bad_checksums=b.bad_checksums - a.bad_checksums,
        discarded=b.discarded_bytes - a.discarded_bytes,
        samples=b.samples - a.samples,
        missing=b.missing - a.missing,
        rate_hz=(b.samples - a.samples) / passed if passed > 0 else None,
        daemon=device.id,
        state=last.state,
    )
