"""Laws that hold after every fault, in one place: each scenario is judged by these and by nothing looser.

The emulator tells what it made, sent and lost, and what noise it was given; the daemon's reports are held
against that. Its noise is white, of a known N, and nothing ever knocks at it, so the guards have nothing
to cut out: a sample that was invented, or came out of damaged bytes, is seen in the least and greatest
values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imumon.checkpoint import decode
from imumon.model.report import Channel, Report
from imumon.sources.vn100.emulator import Noise
from imumon.sources.vn100.emulator.sensor_model import CONSTANT

N = {"gyro": 6.1e-5, "accel": 1.37e-3, "mag": 1.4e-4}
"""Channel unit / sqrt(Hz): N of the emulated sensor, equal on the three axes; it has neither B nor K."""

WHITE = {name: Noise((n,) * 3, (0.0,) * 3, (0.0,) * 3) for name, n in N.items()}
MEAN = dict(zip([f"{s}/{a}" for s in N for a in "xyz"], CONSTANT, strict=False))
INERTIAL = [name for name in MEAN if not name.startswith("mag")]
PACKET = 64  # bytes of "binary 05:0001,00F2", which is what the daemon asks for at 115200 baud
ON_THE_WAY = 8192 // PACKET
"""Messages that a terminal takes along when it hangs up: what it held, and what waited for it."""
LOOP_HZ = 800.0
TAKEN = ("lost", "dropped", "unheard")
"""Counters of the emulator: messages that were made and that nobody was sent."""

SIGMAS = 5.0
"""Half-width of every band: once in two million."""
MOST_SIGMAS = 7.0
"""No value of a Gaussian noise lies farther out in a scenario's samples."""
CLOCK_S = 5.0
"""A report, and the answer of the emulator that belongs to it, are so far apart on a busy machine."""
MEMORY_KB = 8_000
"""kB, allowed growth of memory: what a week may add. Without a fault, a daemon grows by 6 MB from its 11th to its 90th
second, as its record gets octaves and fits; a million messages that leave 8 bytes each are more."""


@dataclass(frozen=True, slots=True)
class Moment:
    """What daemon and emulator said of one moment, and the daemon's resident memory, kB."""

    report: Report
    told: dict[str, Any]
    resident_kb: int

    def late_s(self) -> float:
        """By how much the report is older than the answer, beside a constant, s."""
        return float(self.told["ticks"]) / LOOP_HZ - self.report.session.elapsed_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What a fault may have cost between two moments, beside what the emulator says it did not send.

    Attributes
    ----------
    exposed, damaged : messages made while the fault lasted, and the probability that one comes damaged.
    on_the_way : messages that may have been lost between the two programs.
    lasting : it goes on until the daemon has stopped.
    restarts : times that the daemon was started anew.
    away_s : s, how long there was no daemon, and the sensor sent what it sends by itself.
    unknown : gaps whose length nobody can know: the sensor's clock began anew.
    beside : bytes of valid messages that are no samples.
    """

    exposed: int = 0
    damaged: float = 0.0
    on_the_way: int = 0
    lasting: bool = False
    restarts: int = 0
    away_s: float = 0.0
    unknown: int = 0
    beside: int = 0


GRADE_BY_N = {"gyro": "consumer", "accel": "industrial"}
"""Grade of the N that the emulator makes."""


def adds_up(report: Report) -> None:
    """The counts of one report."""
    session, rate = report.session, report.device.sample_rate_hz
    if rate is None:
        assert session.samples == session.missing == 0
        assert not report.channels
        return
    assert round(session.elapsed_s * rate) == session.samples + session.missing
    assert session.gaps <= session.missing + session.restarts
    assert (session.excluded_s, session.disturbances, session.warmup_s) == (0.0, 0, 0.0)
    assert session.overruns == 0


def bytes_add_up(report: Report, fault: Fault) -> None:
    """Every byte belongs to a sample, to another message, or is discarded; of an ended session."""
    session = report.session
    valid = PACKET * (session.samples + session.duplicates)
    beside = session.received_bytes - session.discarded_bytes - valid
    assert 0 <= beside <= fault.beside


def nothing_invented(report: Report, sent: int) -> None:
    """No more than was sent, every value where it must lie, and no claim that the record cannot carry."""
    session = report.session
    assert session.samples <= sent
    for name, channel in report.channels.items():
        assert channel.count <= session.samples
        if name in MEAN and channel.count > 50:
            _is_the_noise(name, channel, report.device.sample_rate_hz or 0.0)
    for sensor, grade in report.grade.items():
        # the N of a short record may be anything within its limits: its grade is provisional
        by = grade.decided_by and grade.decided_by.coefficient
        certain = not grade.provisional and by == "N"
        assert not certain or grade.meets == GRADE_BY_N[sensor], (sensor, grade)
    for letter in "BK":  # there is neither; a claim of one is allowed to be wrong in 1.4 % of all cases
        claims = [name for name in INERTIAL if _claims(report.channels.get(name), letter)]
        assert len(claims) <= 2, (letter, claims)


def _is_the_noise(name: str, channel: Channel, rate: float) -> None:
    n = channel.count
    if name in INERTIAL:  # the magnetometer is read more slowly than it is sent
        std = N[name.partition("/")[0]] * math.sqrt(rate)
        assert abs(channel.std / std - 1.0) < SIGMAS / math.sqrt(2 * n), (name, channel.std, std)
        assert abs(channel.mean - MEAN[name]) < SIGMAS * std / math.sqrt(n), (name, channel.mean)
        told = channel.coefficients.get("N")
        if told is not None and told.value is not None:
            truth = N[name.partition("/")[0]]
            # where B and K may not be negative, the value of a short record is not amid its limits
            beyond = (told.high / told.low) ** (0.5 * (SIGMAS / 1.96 - 1.0))
            assert told.low / beyond < truth < told.high * beyond, (name, told)
    assert channel.mean - channel.min < MOST_SIGMAS * channel.std, (name, channel)
    assert channel.max - channel.mean < MOST_SIGMAS * channel.std, (name, channel)


def _claims(channel: Channel | None, letter: str) -> bool:
    coefficient = channel.coefficients.get(letter) if channel is not None else None
    return coefficient is not None and coefficient.status == "measured"


def nothing_lost(before: Moment, after: Moment, fault: Fault) -> None:
    """No more is missing than the fault took, and the grid is as long as the time that passed."""
    missing = after.report.session.missing - before.report.session.missing
    taken = sum(after.told[name] - before.told[name] for name in TAKEN)
    spread = SIGMAS * math.sqrt(fault.exposed * fault.damaged * (1.0 - fault.damaged))
    expected = (
        taken + fault.exposed * fault.damaged + fault.away_s * (after.report.device.sample_rate_hz or 0.0)
    )
    assert missing <= expected + spread + fault.on_the_way, (missing, taken, fault)
    if not fault.unknown:
        assert abs(after.late_s() - before.late_s()) < CLOCK_S, (before.late_s(), after.late_s())
    restarts = after.report.session.restarts - before.report.session.restarts
    assert restarts == fault.unknown + fault.restarts


def is_kept(state: Path, report: Report) -> None:
    """What lies on disk is what was said last."""
    kept = decode(state.read_bytes()).record
    assert (kept.samples, kept.span - kept.samples) == (report.session.samples, report.session.missing)


def hold(before: Moment, after: Moment, final: Report, sent: int, fault: Fault) -> None:
    """All of them.

    Parameters
    ----------
    before, after : calm moments in front of the fault and behind it.
    final : the last report, of the stopped daemon.
    sent : messages that the emulator has sent in all, less its replies.
    """
    for report in (before.report, after.report, final):
        adds_up(report)
        nothing_invented(report, sent)
    nothing_lost(before, after, fault)
    bytes_add_up(final, fault)
    assert final.state == "stopped"
    assert fault.lasting or final.session.missing == after.report.session.missing  # the stop loses nothing
    assert all(channel.count == final.session.samples for channel in final.channels.values())
    grown = after.resident_kb - before.resident_kb
    assert grown < MEMORY_KB, grown
