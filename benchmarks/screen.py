"""Cost of the screen: CPU share and resident memory with a new report every half second or second.

    python benchmarks/screen.py [SECONDS]

It runs the screen on a pseudo-terminal of 150 x 40 (and 80 x 24, 220 x 60), drains what it writes, and
reads its CPU time and memory from /proc. Numbers and curve change with each report.
"""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

from document_tables import head, row

TESTS = Path(__file__).parents[1] / "tests"
TICK = os.sysconf("SC_CLK_TCK")
START_S = 120.0
PROGRAM = """
import sys, time
sys.path.insert(0, {tests!r})
import reports
from imumon.tui import run

RUN = reports.Run(700.0)
READY = [RUN.report_at(600.0 + 1.7 * k) for k in range(24)]
SIGNAL = RUN.monitor.signals()["gyro/x"]()

class Source:
    begin = time.monotonic()
    @property
    def version(self): return int({rate} * (time.monotonic() - self.begin))
    def reports(self): return {{reports.ID: (READY[self.version % 24], time.monotonic())}}
    def alive(self): return {{reports.ID}}
    def events(self, id): return reports.events()
    def watch(self, id, channel): pass
    def rivals(self): return {{}}
    def signal(self): return SIGNAL, time.monotonic()
    def watch_history(self, asked): pass
    def history_answer(self): return None
    def connected(self): return True

sys.exit(run(Source()))
"""


def spent(pid: int) -> float:
    """CPU seconds of a process and its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def resident(pid: int) -> float:
    """Resident memory, MB."""
    line = next(x for x in Path(f"/proc/{pid}/status").read_text().splitlines() if x.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def measure(size: tuple[int, int], rate: float, keys: bytes, seconds: float) -> tuple[float, float]:
    """CPU share in %, and resident memory in MB."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    program = PROGRAM.format(tests=str(TESTS), rate=rate)
    environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor", "LANG": "C.UTF-8"}
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    )
    os.close(theirs)

    drawn = threading.Event()

    def drain() -> None:
        while True:
            try:
                data = os.read(ours, 1 << 16)
            except OSError:
                return
            if not data:
                return
            if b"live" in data:
                drawn.set()

    threading.Thread(target=drain, daemon=True).start()
    if not drawn.wait(START_S):  # it makes its reports first, which takes long on a busy machine
        raise SystemExit(f"nothing was drawn within {START_S:g} s")
    time.sleep(2.0)
    os.write(ours, keys)
    time.sleep(2.0)
    begin, cpu = time.monotonic(), spent(process.pid)
    time.sleep(seconds)
    length = time.monotonic() - begin
    result = 100 * (spent(process.pid) - cpu) / length, resident(process.pid)
    process.terminate()
    process.wait(10)
    os.close(ours)
    return result


if __name__ == "__main__":
    span = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    print(head("screen", "size", "view", "reports a second", "share of a core, %", "memory, MB"))
    for size, view, key, rate in (
        ((150, 40), "overview", b"1", 0.0),
        ((150, 40), "overview", b"1", 1.0),
        ((150, 40), "overview", b"1", 2.0),
        ((150, 40), "signal", b"2", 1.0),
        ((150, 40), "signal", b"2", 2.0),
        ((80, 24), "overview", b"1", 2.0),
        ((220, 60), "overview", b"1", 2.0),
    ):
        cpu, memory = measure(size, rate, key, span)
        print(row([f"{size[0]} × {size[1]}", view, f"{rate:.0f}", f"{cpu:.1f}", f"{memory:.0f}"]))
