"""Program that sends the topics of a log and the rows of one of them; see the package."""

from __future__ import annotations

import json
import resource
import sys
from contextlib import suppress
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from imumon.sources.files.log_process.base import Log

BASE_BYTES = 1 << 30
"""Memory of the process beside a multiple of the size of the log."""

SIZE_FACTOR = 4
"""Bytes of memory per byte of the log."""

BASE_S = 20.0
"""s of processor time beside a share of the size of the log."""

BYTES_PER_S = 100e3
"""Bytes of the log for which there is a second of processor time: an IMU has 10 MB/s."""


def limit(path: Path) -> None:
    """Limit memory, processor time and the size of temporary files, by the size of the log."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files)
    memory, seconds = BASE_BYTES + SIZE_FACTOR * size, int(BASE_S + size / BYTES_PER_S)
    wanted = ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_FSIZE, memory))
    for name, value in (*wanted, (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(name)
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(name, (value, value))


def opened(kind: str, path: Path, definitions: Path | None) -> Log:
    """Return the log of a kind: ``bag``, ``px4`` or ``ardupilot``.

    Parameters
    ----------
    definitions : file or directory with definitions of messages that a bag lacks; None: none are given.
    """
    if kind == "px4":
        from imumon.sources.files.log_process.ulog_reader import ULogLog

        return ULogLog(path)
    if kind == "ardupilot":
        from imumon.sources.files.log_process.dataflash_reader import DataFlashLog

        return DataFlashLog(path)
    from imumon.sources.files.log_process.mcap_reader import McapLog, is_without_ros

    if is_without_ros(path):
        return McapLog(path)
    from imumon.sources.files.log_process.bag_reader import BagLog

    return BagLog(path, definitions)


def serve(kind: str, path: Path, pipe: Connection, definitions: Path | None = None) -> None:
    """Send the topics of a log, receive which is wanted, and send its rows."""

    def send(fields: dict[str, Any]) -> None:
        pipe.send_bytes(json.dumps(fields).encode())

    with suppress(EOFError, OSError):  # the parent has enough
        try:
            log = opened(kind, path, definitions)
            topics = [asdict(topic) for topic in log.topics]
            notes = {"remarks": log.remarks, "problem": log.problem}
            send({"topics": topics, "facts": log.facts, **notes})
            while wanted := json.loads(pipe.recv_bytes()):
                for rows, size in log.blocks(wanted["topic"], wanted["columns"]):
                    send({"bytes": size})
                    pipe.send_bytes(rows.astype("<f8").tobytes())
                    if wanted.get("head"):
                        break
                else:
                    send({"end": True})
        except (BrokenPipeError, EOFError):
            raise
        except Exception as error:  # the packages have many of their own
            greedy = isinstance(error, MemoryError)
            text = "it needs far more memory than its size allows" if greedy else str(error)
            send({"error": text.replace("\n", " ")[:500] or type(error).__name__})


if __name__ == "__main__":
    limit(Path(sys.argv[2]))
    serve(sys.argv[1], Path(sys.argv[2]), Connection(int(sys.argv[3])), *map(Path, sys.argv[4:5]))
