"""Random damage to valid files: bits, cuts, repetition, and numbers that may be a length."""

from __future__ import annotations

import json
import random
import struct
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bags import BAGS, messages
from corpus_recordings import MARK, table
from logs import COMBINED, DataFlash, ulog
from tables import truth

from imumon.api.replay_options import ReplayOptions
from imumon.model.errors import ImumonError

LONGEST_S = 60.0
"""s for one file on a busy machine; most take a hundredth of one."""


def capture(place: Path) -> Path:
    """Write two parts of a raw capture with a pause between them."""
    header = {
        "run": "r",
        "part": 0,
        "base": "a.bin",
        "rate_hz": 100.0,
        "settings": {"a": "b"},
        "time": "2026-01-01",
    }
    sentence = b"$VNYMR,+006.380,+000.023,-001.953,+1.0640,-0.2531,+3.0614,+00.005,+00.344,-09.758,-0.001222,-0.000450,-0.001218*67\r\n"  # noqa: E501
    lines = sentence * 50
    path = place / "a.bin"
    path.write_bytes(MARK + json.dumps(header).encode() + b"\n" + lines + MARK + b'{"away_s": 3}\n' + lines)
    return path


def archive(place: Path) -> Path:
    t, gyro, accel = truth(300)
    np.savez_compressed(place / "a.npz", t=t, gyro=gyro, accel=accel)
    return place / "a.npz"


def matlab(place: Path) -> Path:
    from scipy.io import savemat

    t, gyro, accel = truth(300)
    savemat(place / "a.mat", {"t": t, "gyro": gyro, "accel": accel}, do_compression=True)
    return place / "a.mat"


def parquet(place: Path) -> Path:
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra parquet)")
    from pyarrow.parquet import write_table

    t, gyro, accel = truth(300)
    named = {f"{name}_{axis}": values[:, k] for name, values in (("gyro", gyro), ("accel", accel))
             for k, axis in enumerate("xyz")}  # fmt: skip
    write_table(pyarrow.table({"t": t, **named}), place / "a.parquet", write_page_checksum=True)
    return place / "a.parquet"


def bag(kind: str) -> Callable[[Path], Path]:
    def write(place: Path) -> Path:
        path = BAGS[kind](place / "bag", messages(40))
        return next(path.glob("*.db3")) if path.is_dir() else path

    return write


def px4(place: Path) -> Path:
    pytest.importorskip("pyulog", reason="pyulog is not installed (extra px4)")
    _, gyro, accel = truth(500)
    rows = [(10**7 + 4000 * k, *gyro[k], 4000, *accel[k], 4000) for k in range(500)]
    return ulog(place / "a.ulg", [("sensor_combined", 0, COMBINED, rows)])


def ardupilot(place: Path) -> Path:
    pytest.importorskip("pymavlink", reason="pymavlink is not installed (extra ardupilot)")
    _, gyro, accel = truth(500)
    log = DataFlash()
    log.imu(gyro, accel)
    return log.write(place / "a.BIN")


SAMPLES: dict[str, Callable[[Path], Path]] = {
    "csv": table,
    "gz": lambda place: table(place, "a.csv.gz"),
    "npz": archive,
    "mat": matlab,
    "parquet": parquet,
    "capture": capture,
    **{kind: bag(kind) for kind in BAGS},
    "px4": px4,
    "ardupilot": ardupilot,
}
"""What writes a small valid recording of each kind into a directory."""
OWN_PROCESS = {*BAGS, "px4", "ardupilot"}
"""Kinds that a process of their own reads, which takes a second."""


def damaged(rng: random.Random, data: bytes) -> bytes:
    """Flip bits, cut, repeat, or enlarge what may be a length."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        place = rng.randrange(len(out)) if out else 0
        match rng.randrange(6):
            case 0:
                out[place : place + 1] = bytes([rng.randrange(256)])
            case 1:
                del out[place : place + rng.choice((1, 8, 1000))]
            case 2:
                out[place : place + 4] = struct.pack("<I", rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**28)))
            case 3:
                out[place : place + 8] = struct.pack("<Q", rng.choice((0, 2**63 - 1, 2**64 - 1, 2**40)))
            case 4:
                out[place:place] = out[place : place + rng.choice((4, 64, 4096))]
            case _:
                out[place : place + 2] = rng.choice((b"\n\n", b"\x1b[", b',"', b"\0\0", b"\xff\xff", b"1e"))
    return bytes(out)


def read_damaged(path: Path, seeds: range) -> None:
    """Read a recording with many kinds of damage: an error that a user may see, or samples."""
    data = path.read_bytes()
    for seed in seeds:
        path.write_bytes(damaged(random.Random(seed), data))
        begin = time.monotonic()
        try:
            recording = ReplayOptions(path=str(path), accept=True).open()
            for _ in recording:
                pass
            recording.no_samples()
        except ImumonError as error:
            assert str(error).isprintable(), seed  # noqa: PT017
        except BaseException as error:
            raise AssertionError(seed) from error
        assert time.monotonic() - begin < LONGEST_S, seed
