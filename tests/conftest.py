"""Settings of every test run."""

import atexit
import gc
import os
import shutil
import sys
import tempfile
import threading
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import HealthCheck, settings

# Tests start hundreds of commands. Without compiled modules each one compiles the package again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# As the program itself does, before numpy is loaded: threads of OpenBLAS wait for each other on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The modules of a test run are a million objects. Python would look for garbage among them again and again.
gc.freeze()
gc.set_threshold(100_000, 20)

# What the processes of a test run share (tests/reports.py); the first of them makes and removes it.
if "IMUMON_TEST_RUN" not in os.environ:
    os.environ["IMUMON_TEST_RUN"] = tempfile.mkdtemp(prefix="imumon-tests-")
    atexit.register(shutil.rmtree, os.environ["IMUMON_TEST_RUN"], ignore_errors=True)

# A busy machine makes an example slow, and no law depends on it.
settings.register_profile(
    "busy", deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("busy")


@pytest.fixture(scope="session", autouse=True)
def _fork_emulators() -> None:
    """Fork the process of each emulator: to start Python and to import numpy takes longer than most tests."""
    import forked

    from imumon.sources.vn100.emulator import process

    process.start_process = forked.ForkedEmulator


@pytest.fixture(scope="session", autouse=True)
def _balance_every_ledger() -> None:
    """Check of each report that a test makes in its process that what was received is what became of it."""
    from imumon.model.ledger import imbalance
    from imumon.model.report import SessionCounters
    from imumon.record import Record

    counted = Record._counted

    def balanced(self: Record, link: SessionCounters) -> SessionCounters:
        session = counted(self, link)
        assert imbalance(session.ledger) == 0, f"the ledger does not add up: {dict(session.ledger)}"
        assert all(count >= 0 for count in session.ledger.values()), dict(session.ledger)
        return session

    Record._counted = balanced  # type: ignore[method-assign]


class LogThread:
    """The process that reads a log, as a thread: to start Python takes longer than most tests of a log."""

    def __init__(self, command: list[str], **_: object) -> None:
        from imumon.sources.files.log_process.__main__ import serve

        words = command[command.index("imumon.sources.files.log_process") + 1 :]
        kind, path, end, *definitions = words
        pipe = Connection(os.dup(int(end)))

        def run() -> None:
            with pipe:
                serve(kind, Path(path), pipe, *map(Path, definitions))

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def kill(self) -> None:
        pass

    def wait(self) -> None:
        self._thread.join()


@pytest.fixture
def log_in_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read logs in a thread; tests of the command and of hostile files have the real process."""
    monkeypatch.setattr("imumon.sources.files.log_file.Popen", LogThread)


@pytest.hookimpl(tryfirst=True)  # before pytest leaves out what is slow
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Make slow what `few` leaves to the night, and put the tests in their order."""
    cases: Counter[str] = Counter()
    for item in items:
        if (few := item.get_closest_marker("few")) is not None:
            name = item.nodeid.partition("[")[0]
            cases[name] += 1
            if cases[name] > next(iter(few.args), 1):
                item.add_marker(pytest.mark.slow)
    _mix(items)


LONG = (
    "docs evaluation row_selection record daemon history datasheet lines_device replay tui devices likelihood"
)
"""Files that take longest, without `test_`."""


def _mix(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that no process works alone at the end, and mix the others.

    In the order of the alphabet, all processes would wait for daemons at one time and compute at another.
    """
    items.sort(key=lambda item: (item.path.stem[5:] not in LONG.split(), crc32(item.path.name.encode())))
