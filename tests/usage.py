"""Memory and processor time of a process."""

from __future__ import annotations

import psutil


def resident_kb(pid: int) -> int:
    """Return the resident memory, kB."""
    return int(psutil.Process(pid).memory_info().rss // 1024)


def cpu_s(pid: int) -> float:
    """Return the processor time so far, s, user and system."""
    return float(sum(psutil.Process(pid).cpu_times()[:2]))
