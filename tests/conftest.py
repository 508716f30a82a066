"""Settings of every test run."""

import os
import sys

# Tests start hundreds of commands. Without compiled modules each one compiles the package again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
