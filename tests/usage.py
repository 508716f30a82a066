"""Use of the machine by a process, as its kernel tells."""

from __future__ import annotations

import os
import re
from pathlib import Path


def resident_kb(pid: int) -> int:
    """Resident memory, kB."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) if found else 0


def cpu_s(pid: int) -> float:
    """Processor time used so far, s, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
