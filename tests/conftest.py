"""Settings of every test run."""

import atexit
import gc
import os
import shutil
import sys
import tempfile
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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that no process works alone at the end, and mix the others.

    In the order of the alphabet, all processes would wait for daemons at one time and compute at another.
    """
    long = [
        "docs",
        "daemon",
        "devices",
        "evaluation",
        "tui",
        "monitor",
        "doctor",
        "mistakes",
        "wait",
        "recording",
        "likelihood",
    ]
    items.sort(key=lambda item: (item.path.stem[5:] not in long, crc32(item.path.name.encode())))
