"""Parser of imumon for argparse-manpage, which makes the manual page when a wheel is built.

The build runs in an environment without imumon, so the source tree is put on the path.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path.cwd()))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the program with the options of all commands."""
    from imumon.cli import parsers

    return parsers()[0]
