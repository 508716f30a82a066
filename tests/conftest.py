"""Settings of every test run."""

import atexit
import os
import shutil
import sys
import tempfile

# Tests start hundreds of commands. Without compiled modules each one compiles the package again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# As the program itself does, before numpy is loaded: threads of OpenBLAS wait for each other on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if (
    "IMUMON_TEST_RUN" not in os.environ
):  # the first process of a test run: what its processes share (tests/reports.py)
    os.environ["IMUMON_TEST_RUN"] = tempfile.mkdtemp(prefix="imumon-tests-")
    atexit.register(shutil.rmtree, os.environ["IMUMON_TEST_RUN"], ignore_errors=True)
