"""Settings of every test run."""

import os
import sys

# Tests start hundreds of commands. Without compiled modules each one compiles the package again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# As the program itself does, before numpy is loaded: threads of OpenBLAS wait for each other on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
