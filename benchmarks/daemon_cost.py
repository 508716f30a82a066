"""Cost of the pipeline of a running daemon: share of a core, time of a fit, size of the state.

    python benchmarks/daemon_cost.py                     a table, about a minute
    python benchmarks/daemon_cost.py --profile FILE      also the 25 costliest functions of both parts
    python benchmarks/daemon_cost.py --temperature       with the temperature as a tenth channel

Nine channels at 100 Hz in the blocks of a serial port, without pauses. Once a second the record makes a report and the
periods in progress, as in a daemon that keeps a history. Processor time over time of the record is the share of a core.
It is taken in minutes 1 to 3, in which a record doubles often, and in minutes 10 to 20, in which it doubles once. The
documents of the bus and the saved state are counted apart. The time of a fixed numpy loop in the same run compares
machines.
"""

from __future__ import annotations

import argparse
import cProfile
import io
import os
import pstats
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program does

import numpy as np
from document_tables import Figure, at_most, show

from imumon.bus.publisher import ReportDocuments
from imumon.checkpoint import encode
from imumon.model.report import DeviceDescription, SessionCounters
from imumon.model.samples import ACCEL, GYRO, MAG, Floats, SampleBlock, Stream
from imumon.model.saved_state import pack
from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.record import Record, RecordOptions
from imumon.sources.device import BATCH_S

RATE, SAVE_S = 100.0, 30
"""Hz; s between two saved states."""
BLOCK, PER_REPORT = round(BATCH_S * RATE), round(1.0 / BATCH_S)
"""Samples a block; blocks a report."""
YOUNG, OLD = "minutes 1 to 3", "minutes 10 to 20"
PARTS = {YOUNG: (60, 180, 2.0), OLD: (600, 1200, 0.8)}
"""Begin and end, s, and goal, % of a core."""
N = np.repeat([6.1e-5, 1.4e-3, 2e-8], 3)
B = np.repeat([2.4e-5, 4e-4, 1e-8], 3)
K = np.repeat([1e-6, 2e-5, 1e-10], 3)
MEAN = np.array([0.0, 0.0, 0.0, 0.1, -0.2, 9.8, 2e-5, 1e-6, 4e-5])
FIT_MS, STATE_MB = 5.0, 0.35
SHOWN = 25
NOW = datetime(2026, 1, 1, tzinfo=UTC)


def samples(length_s: int, temperature: bool) -> Floats:
    """Samples of nine or ten channels at rest, (n, c) SI."""
    n = round(length_s * RATE)
    noise = MEAN + synthesise(n, RATE, N=N.tolist(), B=B.tolist(), K=K.tolist(), seed=1, averaged=False)
    if not temperature:
        return noise
    rng, at = np.random.default_rng(2), np.arange(n) / RATE
    return np.column_stack((noise, 25.0 + 8.0 * (1.0 - np.exp(-at / 300.0)) + 0.02 * rng.standard_normal(n)))


def reference() -> float:
    """Return the processor time of a fixed loop of small and large array operations, s: the least of three."""
    x = np.linspace(0.0, 1.0, 1 << 16)
    times = []
    for _ in range(3):
        begin = time.process_time()
        for _ in range(200):
            np.fft.rfft(x)
        for _ in range(10_000):
            np.add(x[:64], x[64:128]).sum()
        times.append(time.process_time() - begin)
    return min(times)


class Run:
    """A monitor that is fed without pauses, and where its processor time goes.

    Attributes
    ----------
    spent : s by kind of work, since the last call of `until`.
    """

    def __init__(self, values: Floats) -> None:
        names = (*GYRO, *ACCEL, *MAG, "temperature")[: values.shape[1]]
        self._stream = Stream("uncompensated", names, "made", "startup")
        self._values, self._at = values, 0
        self.monitor = Record(RecordOptions(periods=True))
        self._documents = ReportDocuments()
        self.spent: dict[str, float] = defaultdict(float)

    def until(self, end_s: int) -> None:
        """Feed the samples up to a time."""
        self.spent.clear()
        while self._at < round(end_s * RATE):
            self._timed("samples", self._feed)
            made = self._timed("report", self.report)
            self._timed("history", self._history)
            self._timed("JSON", lambda made=made: self._documents.of(made))
            if self._at % round(SAVE_S * RATE) == 0:
                self._timed("state", self.state)

    def _feed(self) -> None:
        for _ in range(PER_REPORT):
            at, self._at = self._at, self._at + BLOCK
            tick = 10**9 + (np.arange(at, at + BLOCK) * round(1e9 / RATE)).astype(np.int64)
            part, flags = self._values[at : at + BLOCK], np.zeros(BLOCK, dtype=np.int64)
            self.monitor.feed(SampleBlock(self._stream, part, tick, flags))

    def report(self) -> Any:
        return self.monitor.report(NOW, DeviceDescription(id="made"), "running", SessionCounters())

    def _history(self) -> None:
        self.monitor.periods()
        self.monitor.periods_in_progress()

    def state(self) -> int:
        """Return the bytes of the saved state."""
        return len(encode(pack(self.monitor.save())))

    def _timed(self, kind: str, work: Callable[[], Any]) -> Any:
        begin = time.process_time()
        result = work()
        self.spent[kind] += time.process_time() - begin
        return result


PIPELINE = ("samples", "report", "history")


def measure(temperature: bool = False) -> Iterator[Figure]:
    """Both parts of a record, the fit alone and the state."""
    yield Figure("fixed numpy loop, for comparison", f"{1e3 * reference():.0f} ms")
    values = samples(PARTS[OLD][1], temperature)
    run = Run(values)
    for name, (begin, end, goal) in PARTS.items():
        run.until(begin)
        run.until(end)
        share = {kind: 100.0 * spent / (end - begin) for kind, spent in run.spent.items()}
        text = ", ".join(f"{kind} {share[kind]:.2f}" for kind in share)
        yield at_most(f"pipeline, {name}", sum(share[k] for k in PIPELINE), goal, "% of a core", text)
    yield at_most("saved state of 20 minutes, compressed", run.state() / 1e6, STATE_MB, "MB")
    yield from fits(values[:, : len(MEAN)])


def fits(values: Floats) -> Iterator[Figure]:
    """Time of a fit of one channel, first and with what is known from the last one."""
    for minutes in (2, 10):
        own = values[: round(60.0 * minutes * RATE)]
        cascade = OctaveCascade(own.shape[1], 1.0 / RATE)
        cascade.update(own)
        curve = cascade.result()
        first = _least(lambda curve=curve: Estimator(averaged=False).fit(curve))
        known = Estimator(averaged=False)
        known.fit(curve)
        again = _least(lambda curve=curve, known=known: known.fit(curve, renew=True))
        kept = _least(lambda curve=curve, known=known: known.fit(curve))
        for name, spent in (("first", first), ("again", again), ("between two", kept)):
            each = 1e3 * spent / own.shape[1]
            yield at_most(f"fit of a channel, {minutes} min, {name}", each, FIT_MS, "ms")


def _least(work: Callable[[], object]) -> float:
    """Return the processor time of a call, s: the least of five."""
    times = []
    for _ in range(5):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def profile(temperature: bool) -> str:
    """Return the costliest functions of both parts, by cumulative and by own time."""
    run = Run(samples(PARTS[OLD][1], temperature))
    text = io.StringIO()
    for name, (begin, end, _) in PARTS.items():
        run.until(begin)
        profiler = cProfile.Profile()
        profiler.runcall(run.until, end)
        with redirect_stdout(text):
            print(f"===== {name}: {end - begin} s of the record\n")
            shown = pstats.Stats(profiler).strip_dirs()
            for order in ("cumulative", "tottime"):
                shown.sort_stats(order).print_stats(SHOWN)
    return text.getvalue()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--profile", type=Path, metavar="FILE", help="write the costliest functions")
    parser.add_argument("--temperature", action="store_true", help="with the temperature as a tenth channel")
    words = parser.parse_args()
    show("daemon-cost", measure(words.temperature))
    if words.profile:
        words.profile.write_text(profile(words.temperature))
