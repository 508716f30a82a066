"""Soak: the daemon for a long time, its memory, its state and its counters.

    python benchmarks/soak.py live --minutes 30             800 Hz, real time, a subscriber, a recording
    python benchmarks/soak.py days --days 7                 the whole pipeline, a sensor in time-lapse
    python benchmarks/soak.py days --days 7 --direct        blocks from memory to the daemon: no port
    python benchmarks/soak.py days --days 2 --no-history    a daemon that keeps no history

The pipeline is a real one: the emulator's bytes through a pseudo-terminal to the daemon, to its state on disk
and over the bus to a subscriber. Every law of the counters is checked at the end, against what the emulator
says that it sent; at the start and at the end it keeps still for a moment, so that both count the same.
Memory is taken from the kernel every few seconds; its growth is from the second tenth of the run to the last,
each a median. In time-lapse, where a second is minutes of the sensor and half a megabyte of it may be on its
way, it is also taken in moments of stillness. Exit code 1 where a law does not hold.
"""

from __future__ import annotations

import argparse
import json
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from daemons import Daemon
from document_tables import Figure, at_most
from faulty_sensor import FaultySensorProcess, spawn
from lapse import install_memory
from usage import cpu_s, resident_kb

from imumon.model.report import Report, stamp
from imumon.sources.vn100.emulator import EmulatorSettings

STILL_EVERY = 4  # looks at memory, in time-lapse
NEAR_A_DAY = 0.15  # d, on each side: looks at memory that count as those of a day


class Pause(NamedTuple):
    """Both sides while no message is in transit.

    Attributes
    ----------
    counted : by the emulator.
    report : of the daemon.
    resident_kb : memory of the daemon, kB.
    """

    counted: dict[str, Any]
    report: Report
    resident_kb: int


def pause(sensor: FaultySensorProcess, daemon: Daemon, command: str) -> Pause:
    """Pause the output of the emulator and return the counters of both sides.

    With ``silence`` its output during the pause is lost; with ``stall`` it waits, and so do its replies.
    """
    start = stamp(datetime.now(UTC) + timedelta(seconds=0.5))
    replies = sensor.ask(f"{command} 600")["replies"]
    reports: list[Report] = []

    def newer(report: Report) -> bool:
        return report.time > (reports[-1].time if reports else start)

    while len(reports) < 2 or reports[-1].session.samples != reports[-2].session.samples:
        reports.append(daemon.wait(newer))
    counted = sensor.ask("counters")
    time.sleep(0.1)  # the memory of the report is freed
    memory = resident_kb(daemon.process.pid)
    sensor.ask(f"{command} 0")
    return Pause(counted | {"replies": replies}, reports[-1], memory)


def growth_kb(taken: list[int]) -> float | None:
    """Median of the last tenth less that of the second, when all is in place; None of too few looks."""
    tenth = len(taken) // 10
    if tenth < 2:
        return None
    return statistics.median(taken[-tenth:]) - statistics.median(taken[tenth : 2 * tenth])


def by_tenth(taken: list[int]) -> list[int]:
    """Values at the tenths of the run."""
    return [taken[min(len(taken) - 1, len(taken) * k // 10)] for k in range(11)]


def laws(report: Report, sent: int, received: int, lost: int = 0, dropped: int = 0) -> dict[str, object]:
    """What must hold of the counters.

    Parameters
    ----------
    sent, received : samples on the line, and those of them in the record.
    lost, dropped : samples that the emulator was told to keep to itself, and for which the terminal, that the
        daemon is to empty, had no room.
    """
    session, rate = report.session, report.device.sample_rate_hz or 1.0
    return {
        "elapsed_s": round(session.elapsed_s, 2),
        "samples": session.samples,
        "missing": session.missing,
        "samples + missing = elapsed * rate": round(session.elapsed_s * rate)
        == session.samples + session.missing,
        "sent, received": [sent, received],
        "every sample that was sent is there": sent == received,
        "missing is what was not sent": session.missing == lost + dropped,
        "the terminal was never full": dropped == 0,
        "gaps": session.gaps,
        "overruns": session.overruns,
        "discarded_bytes": session.discarded_bytes,
        "bad_checksums": session.bad_checksums,
        "excluded_s": session.excluded_s,
        "octaves": max((len(c.allan.tau_s) for c in report.channels.values() if c.allan), default=0),
    }


def state_bytes(directory: Path) -> int:
    return max((path.stat().st_size for path in directory.glob("*.state")), default=0)


def through_the_pipeline(words: argparse.Namespace, scratch: Path) -> dict[str, object]:
    """A real emulator, a real daemon, a real subscriber."""
    live = words.mode == "live"
    baud, port = 921600 if live else words.baud, str(scratch / "port")
    settings = EmulatorSettings(seed=1, baud=baud, warm_up=0.0, speed=words.speed, link=port)
    until_s = words.minutes * 60.0 if live else words.days * 86400.0
    extra = ["--record", "/dev/null"] if live else []
    options = (f"{words.speed:g}", *(["history.enabled=false"] if words.no_history else []))
    lapse = () if live else (sys.executable, str(Path(__file__).with_name("lapse.py")), *options)
    taken: list[int] = []
    states: list[int] = []
    with ExitStack() as alive:
        sensor = alive.enter_context(spawn(settings))
        began, started = time.monotonic(), datetime.now(UTC)
        daemon = alive.enter_context(Daemon(port, scratch / "state", *extra, before=lapse))
        first = daemon.samples(1)
        seen_s = time.monotonic() - began
        first_s = (datetime.fromisoformat(first.time) - started).total_seconds()
        pid = daemon.process.pid
        first_counts, at_first, resident = pause(sensor, daemon, "silence" if live else "stall")
        at_rest, rested = [resident], np.zeros(2)

        def spent() -> np.ndarray:
            """Processor time of the daemon and host time, s, without the moments of stillness."""
            return np.array([cpu_s(pid), time.monotonic()]) - rested

        latest, steady = at_first, spent()
        while latest.session.elapsed_s < until_s and daemon.process.poll() is None:
            time.sleep(5.0)
            latest = daemon.wait(lambda r: True)
            taken.append(resident_kb(pid))
            states.append(state_bytes(scratch / "state"))
            if not live and len(taken) % STILL_EVERY == 0:
                begun = spent()
                _, latest, resident = pause(sensor, daemon, "stall")
                at_rest.append(resident)
                rested += spent() - begun
            if latest.session.elapsed_s < until_s / 4:
                steady = spent()
            if words.verbose and len(taken) % 12 == 0:
                done, memory = latest.session.elapsed_s / until_s, f"{taken[-1]} kB"
                memory += "" if live else f", at rest {at_rest[-1]} kB"
                print(f"{done:6.1%}  {memory}  state {states[-1]} B", file=sys.stderr, flush=True)
        worked = spent() - steady
        counted, latest, _ = pause(sensor, daemon, "stall")
        cost = {who: cpu_s(number) for who, number in (("emulator", sensor.pid), ("daemon", pid))}
        asked = time.monotonic()
        daemon.process.send_signal(signal.SIGTERM)
        daemon.process.wait(20)
        stop_s = time.monotonic() - asked
    sent = (counted["sent"] - counted["replies"]) - (first_counts["sent"] - first_counts["replies"])
    received = latest.session.samples - at_first.session.samples
    passed_s = time.monotonic() - began
    rest = {"resident_kb_at_rest_by_tenth": by_tenth(at_rest), "growth_at_rest_kb": growth_kb(at_rest)}
    return {
        "emulator": {name: counted[name] for name in ("made", "sent", "lost", "dropped", "unheard")},
        **laws(latest, sent, received, counted["lost"], counted["dropped"]),
        "first_report_s": round(first_s, 2),
        "first_report_seen_s": round(seen_s, 2),
        "stop_s": round(stop_s, 2),
        "cpu_percent_last_three_quarters": round(100.0 * worked[0] / worked[1], 2),
        "resident_kb_first_last_max": [taken[0], taken[-1], max(taken)],
        "resident_kb_by_tenth": by_tenth(taken),
        "growth_kb": growth_kb(taken),
        **({} if live else rest),
        "state_bytes_by_tenth": by_tenth(states),
        "times_as_fast_as_the_clock": round(latest.session.elapsed_s / (passed_s - rested[1]), 1),
        "cpu_s": cost,
        "room_s": round(passed_s, 1),
    }


def measure(minutes: float) -> Iterator[Figure]:
    """The daemon in real time at 800 Hz, nine channels, temperature, pressure, a subscriber, a recording."""
    words = argparse.Namespace(mode="live", minutes=minutes, speed=1.0, no_history=False, verbose=False)
    with tempfile.TemporaryDirectory(prefix="imumon-soak-") as scratch:
        made: dict[str, Any] = through_the_pipeline(words, Path(scratch))
    sent, received = made["sent, received"]
    lost = sent - received + made["emulator"]["dropped"]
    yield Figure(
        f"daemon at 800 Hz for {minutes:g} min: samples",
        f"{made['samples']:,}",
        f"lost {lost}",
        "none",
        not lost,
    )
    cpu, memory = made["cpu_percent_last_three_quarters"], made["resident_kb_first_last_max"][2] / 1024
    yield at_most("its share of a core, last three quarters", cpu, 3.0, "%")
    yield at_most("its resident memory, most", memory, 120.0, "MB")
    yield at_most("from its start to the first report, a baud scanned", made["first_report_s"], 1.5, "s")
    yield at_most("from SIGTERM to its end, settings put back", made["stop_s"], 1.0, "s")


def without_a_port(words: argparse.Namespace, scratch: Path) -> dict[str, object]:
    """A daemon with its state, history and a subscriber, on blocks from memory: days pass in minutes."""
    install_memory(scratch / "site")
    lapse = (sys.executable, str(Path(__file__).with_name("lapse.py")), f"{words.speed:g}")
    taken: list[tuple[float, int]] = []
    began = time.monotonic()
    with Daemon("memory:", scratch / "state", before=lapse) as daemon:
        latest = daemon.samples(1)
        while latest.session.elapsed_s < words.days * 86400.0 and daemon.process.poll() is None:
            time.sleep(5.0)
            latest = daemon.wait(lambda r: True)
            taken.append((latest.session.elapsed_s, resident_kb(daemon.process.pid)))
            if words.verbose:
                print(f"{taken[-1][0] / 86400.0:.2f} d  {taken[-1][1]} kB", file=sys.stderr, flush=True)
    by_day = {
        day: statistics.median(values)
        for day in range(1, int(words.days) + 1)
        if (values := [kb for elapsed, kb in taken if abs(elapsed / 86400.0 - day) < NEAR_A_DAY])
    }
    return {
        **laws(latest, latest.session.samples, latest.session.samples),
        "resident_kb_first_last_max": [taken[0][1], taken[-1][1], max(kb for _, kb in taken)],
        "resident_kb_by_day": by_day,
        "growth_from_day_1_kb": by_day[max(by_day)] - by_day[1] if by_day else None,
        "state_bytes": state_bytes(scratch / "state"),
        "times_as_fast_as_the_clock": round(latest.session.elapsed_s / (time.monotonic() - began), 1),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("mode", choices=("live", "days"))
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--days", type=float, default=7.0)
    parser.add_argument("--speed", type=float, default=5000.0, help="of the sensor in time-lapse")
    parser.add_argument("--baud", type=int, help="of a sensor in time-lapse; fewer samples at a lower one")
    parser.add_argument("--direct", action="store_true")
    parser.add_argument("--no-history", action="store_true", help="in time-lapse")
    parser.add_argument("--verbose", action="store_true")
    words = parser.parse_args()
    words.speed = 1.0 if words.mode == "live" else words.speed
    direct = words.direct and words.mode == "days"
    with tempfile.TemporaryDirectory(prefix="imumon-soak-") as scratch:
        made = without_a_port(words, Path(scratch)) if direct else through_the_pipeline(words, Path(scratch))
    print(json.dumps(made, indent=1))
    return 0 if all(value is not False for value in made.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
