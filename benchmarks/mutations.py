"""Mutated files: what becomes of a thousand damaged ones of each kind that imumon reads.

    python benchmarks/mutations.py [--count 1000] [--minutes M] [KIND ...]

Each file is a valid one with some bytes changed, removed, repeated or made a length (`tests/hostile/damage.py`). A
process of its own reads it and must end within `LONGEST_S`, with an error in one line or with samples, and take at most
`MOST_MB`. Of those that are read, ``silent`` ones have fewer samples than the whole file, or other numbers, and neither
a remark nor a count of invalid rows: of a kind without checksums, a changed digit cannot show. The process that reads
bags and logs is here a copy of this one, with the limits of the real one, and has imported its packages already: to
start Python takes a second of each file. Exit code 1 if a file crashes the program, raises something else than an error
with a cure, or takes too long or too much.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))

import damage
import numpy as np
from histories import BEGIN, RECORD, period

from imumon.checkpoint import Checkpoint, encode
from imumon.errors import ImumonError
from imumon.history.selection import Selection
from imumon.history.store import HistoryStore
from imumon.recordings import log_file
from imumon.recordings.log_process import __main__ as log_program
from imumon.replay import ReplayOptions
from imumon.report import Event
from imumon.samples import SampleBlock
from imumon.saved_state import pack

LONGEST_S = 30
MOST_MB = 300.0
CODES = ("read", "error", "silent", "raised", "late", "crashed", "memory")
BAD = CODES[3:]

Outcome = tuple[int, float, tuple[object, ...]]
"""Samples, sum of their numbers, and what is remarked."""


def recording(path: Path) -> Outcome:
    """Read a recording to its end."""
    opened = ReplayOptions(path=str(path)).open()
    count, total = 0, 0.0
    for block in (item for items in opened for item in items if isinstance(item, SampleBlock)):
        count += len(block)
        total += float(np.nansum(np.abs(block.values)))
    if not count:
        raise opened.no_samples()
    return count, total, (*opened.remarks, opened.problem, opened.bad_checksums, opened.discarded)


def state(path: Path) -> Outcome:
    """Load a state as a daemon does."""
    loaded, messages = Checkpoint(path.parent, "a").load()
    return int(loaded is not None), float(loaded.arrays["sum"].sum()) if loaded else 0.0, tuple(messages)


def history(path: Path) -> Outcome:
    """Read a history, and write to it as a daemon does."""
    with HistoryStore(path) as store:
        periods = list(store.periods(Selection(since=0.0, until=2e9, step="10m")))
        events = store.events(0.0, 2e9)
        numbers = float(zlib.crc32(repr((periods, events)).encode()))
        return len(periods) + len(events), numbers, (store.damaged_rows,)


def a_state(place: Path) -> Path:
    (place / "a.state").write_bytes(encode(pack({"sum": np.arange(2000.0)})))
    return place / "a.state"


def a_history(place: Path) -> Path:
    path = place / "a.history.sqlite"
    with HistoryStore(path, write=True) as store:
        store.add([period(number) for number in range(100)])
        store.add_events([(BEGIN, Event(device="a", time=RECORD, level="warning", kind="loss", text="lost"))])
    return path


KINDS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], Outcome]]] = {
    **{name: (write, recording) for name, write in damage.SAMPLES.items()},
    "state": (a_state, state),
    "history": (a_history, history),
}


class CopiedLogProcess:
    """The log process as a copy of this one, with the limits of the real one; takes the place of ``Popen``."""

    def __init__(self, command: Sequence[str], **_: object) -> None:
        kind, path, descriptor = command[-3:]
        self._child = os.fork()
        if self._child == 0:
            try:
                with open(os.devnull, "w") as nothing:  # the packages print what they skip
                    os.dup2(nothing.fileno(), 1)
                    os.dup2(nothing.fileno(), 2)
                pages = int(Path("/proc/self/statm").read_text().split()[0])
                log_program.BASE_BYTES += pages * resource.getpagesize()  # the real one begins with little
                log_program.limit(Path(path))
                log_program.serve(kind, Path(path), Connection(int(descriptor)))
            finally:
                os._exit(0)

    def kill(self) -> None:
        os.kill(self._child, signal.SIGKILL)

    def wait(self) -> None:
        os.waitpid(self._child, 0)


def outcome(path: Path, read: Callable[[Path], Outcome], whole: Outcome) -> str:
    """Return what becomes of one file, in a process of its own."""
    child = os.fork()
    if child == 0:
        os.setsid()
        code = "raised"
        try:
            count, total, remarks = read(path)
            same = count == whole[0] and np.isclose(total, whole[1], rtol=1e-9)
            code = "read" if same or remarks != whole[2] else "silent"
            if code == "silent" and os.environ.get("DETAILS"):
                print(
                    f"{path.name}: {count} samples of {whole[0]}, sum {total:g} of {whole[1]:g}",
                    file=sys.stderr,
                )
        except ImumonError as error:
            code = "error" if str(error).isprintable() else "raised"
        except BaseException as error:
            print(f"{path.name}: {type(error).__name__}: {error}", file=sys.stderr)
        used = max(
            resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        os._exit(CODES.index("memory" if used > 1e3 * MOST_MB and code not in BAD else code))
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return CODES[os.WEXITSTATUS(status)] if os.WIFEXITED(status) else "crashed"
        time.sleep(0.002)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "late"


def read_by_packages(kind: str, path: Path) -> None:
    """Import what reads a log here, so that its copies have it."""
    program = {"px4": "px4", "ardupilot": "ardupilot"}.get(kind, "bag" if kind in damage.BAGS else None)
    if program is not None:
        folder = path.parent if (path.parent / "metadata.yaml").exists() else path
        log = log_program.opened(program, folder)
        list(log.blocks(0, log.topics[0].columns[:1]))


def tried(kind: str, count: int, end: float) -> Counter[str]:
    """Return how many files of a kind became what."""
    write, read = KINDS[kind]
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder))
        data, whole = path.read_bytes(), read(path)
        log_file.Popen = CopiedLogProcess  # type: ignore[misc, assignment]
        read_by_packages(kind, path)
        for seed in range(count):
            if time.monotonic() > end:
                break
            for other in path.parent.iterdir():  # such as a state that was set aside, or a journal
                if other.is_file() and other != path:
                    other.unlink()
            path.write_bytes(damage.damaged(random.Random(seed), data))
            became = outcome(path, read, whole)
            outcomes[became] += 1
            if became in BAD:
                print(f"{kind}: seed {seed} {became}", file=sys.stderr, flush=True)
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1000, help="files of each kind")
    parser.add_argument("--minutes", type=float, default=60.0, help="that each kind may take")
    parser.add_argument("kind", nargs="*", metavar="KIND", help=", ".join(KINDS))
    arguments = parser.parse_args()
    print(f"| kind | files | {' | '.join(CODES)} |\n|---|---:|{'---:|' * len(CODES)}")
    failed = False
    for kind in arguments.kind or KINDS:
        outcomes = tried(kind, arguments.count, time.monotonic() + 60.0 * arguments.minutes)
        failed |= any(outcomes[code] for code in BAD)
        numbers = " | ".join(str(outcomes[code]) for code in CODES)
        print(f"| {kind} | {sum(outcomes.values())} | {numbers} |", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
