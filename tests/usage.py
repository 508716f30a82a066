"""Memory and processor time of a process, from /proc."""

from __future__ import annotations

import os
import re
from pathlib import Path


def resident_kb(pid: int) -> int:
    """Return the resident memory, kB."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) if found else 0


def cpu_s(pid: int) -> float:
    """Return the processor time so far, s, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
