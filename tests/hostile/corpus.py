"""Every hostile input of the tests: the door that it attacks, and what must happen there.

A door is a place where something of others enters imumon. `doors.py` takes an input through its door and returns the
outcome in the words of this table. It also holds every input to the laws of the door: what a person reads has no
control character and no traceback, and time and memory are bounded.

| door | an input is | outcomes |
|---|---|---|
| recording | a file for `imumon replay` | code of the error; `N samples`: it is read |
| settings | a file for `--config` | `faults`; `read` |
| report, signal | JSON of a message | `rejected`; `shown`: in every panel |
| device-name | a name | `rejected` |
| saved-report | a file for `imumon report` | `refused` |
| state | a directory of states with something that is no state | `set aside` |
| save | a directory with something in the way of a save | `replaced` |
| sensor-settings | a file of settings that a sensor had | `ignored`; `read` |
| query | a way to ask a daemon for the impossible, again and again | `bounded`: its memory; it measures on |
| waiting-query | options of one query | `no reply` |
| message | key and text on the bus | `ignored` by viewers, and counted |
| command | words of a command beside a daemon with hostile reports | exit code |

A new input is a row here. Its name is the id of its test: `pytest -k NAME` runs it.
"""

from __future__ import annotations

import gzip
import io
import json
import lzma
import os
import sqlite3
import struct
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import attackers
import numpy as np
import pytest
from bags import BAGS, messages, write_bag2
from bus_actors import event, report
from hostile_reports import FORBIDDEN, real_report
from tables import csv, truth

from imumon.checkpoint import FILE_BYTES, FORMAT, SavedState, encode
from imumon.report import MAX_CHANNELS
from imumon.report_json import to_json


@dataclass(frozen=True)
class Hostile:
    """An input, and what must happen.

    Attributes
    ----------
    door : where it enters.
    name : id of its test, unique within the door.
    make : returns the input; called with an empty directory.
    outcome : in the words of the door.
    says : part of what the command prints on it; empty: anything.
    seconds : of processor time that it may take.
    memory : bytes that the process may take for it.
    slow : whether only ``pytest -m slow`` runs it.
    """

    door: str
    name: str
    make: Callable[[Path], Any]
    outcome: str
    says: str = ""
    seconds: float = 5.0
    memory: int = 1 << 30
    slow: bool = False


def through(*doors: str) -> list[Any]:
    """Return the inputs of some doors as parameters of a test."""
    return [
        pytest.param(hostile, id=f"{hostile.door}-{hostile.name}", marks=[pytest.mark.slow] * hostile.slow)
        for hostile in CORPUS
        if hostile.door in doors
    ]


TITLE = "\x1b]0;owned\x07"
"""Sets the title of a terminal that obeys."""
ESCAPES = "\x1b]0;owned\x07\x1b[2J\x9b1m\u202e"
"""The same, a clean screen and bold letters, in 7 and 8 bits, and a right-to-left override."""

# ---------------------------------------------------------------------- recordings: tables

NAMES = ["time [s]", *(f"gyro_{a} [rad/s]" for a in "xyz"), *(f"accel_{a} [m/s2]" for a in "xyz")]
HEAD = (",".join(NAMES) + "\n").encode()


def file(name: str, content: Callable[[], bytes | str]) -> Callable[[Path], Path]:
    """Return what writes a file."""

    def write(place: Path) -> Path:
        data = content()
        (place / name).write_bytes(data.encode() if isinstance(data, str) else data)
        return place / name

    return write


def table(place: Path, name: str = "a.csv", rows: int = 300, header: list[str] = NAMES) -> Path:
    """Write a valid table of a sensor at rest."""
    t, gyro, accel = truth(rows)
    columns = [t, *gyro.T, *accel.T, t]
    return csv(place / name, header, *columns[: len(header)])


def with_long_lines(place: Path) -> Path:
    path = table(place, rows=400)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join((*lines[:200], bytes(700_000), b"\n", *lines[200:], bytes(1_000_000))))
    return path


def wide(name: str) -> Callable[[Path], Path]:
    """Return what writes a table of 7,000 columns, or of two with very long names."""
    names = [f"{name}gyro_x"] * (7000 if len(name) < 99 else 2)
    return file("wide.csv", lambda: ",".join(names) + "\n" + ",".join("1" * 7000) + "\n")


def named_by_escapes(place: Path) -> Path:
    np.savez(place / "d.npz", **{f"{ESCAPES}gyro_x": truth(300)[0]})
    return place / "d.npz"


TABLES = (
    Hostile("recording", "line-without-an-end", file("a.csv", lambda: HEAD + b"1," * (4 << 20)), "line_too_long"),
    Hostile("recording", "lines-that-are-too-long", with_long_lines, "400 samples", says="line 201 is too long"),
    Hostile("recording", "header-of-7000-columns", wide(""), "too_many_columns", seconds=2.0),
    Hostile("recording", "header-of-7000-escapes", wide(TITLE), "line_too_long", seconds=2.0),
    Hostile("recording", "header-of-long-names", wide("x" * 70_000), "line_too_long", seconds=2.0),
    Hostile(
        "recording", "escapes-in-an-unused-column", lambda place: table(place, header=[*NAMES, "mag\x1b\x9b_x"]),
        "300 samples", says="mag_x",
    ),
    Hostile(
        "recording", "escapes-in-all-columns",
        lambda place: table(place, header=[f"{ESCAPES}{n}" for n in ("a", "b", "c")]), "no_header",
    ),
    Hostile(
        "recording", "escapes-in-a-unit", lambda place: table(place, header=[f"gyro_x [{ESCAPES}]", "b", "c"]),
        "sensor_incomplete",
    ),
    Hostile(
        "recording", "escapes-as-the-time", lambda place: table(place, header=[ESCAPES, *NAMES[1:]]), "rate_required"
    ),
    Hostile("recording", "escapes-in-an-archive", named_by_escapes, "no_sensor"),
    Hostile(
        "recording", "escapes-in-the-file-name",
        lambda place: table(place, f"{ESCAPES}.csv", header=["a", "b"]), "no_sensor",
    ),
    Hostile("recording", "escapes-in-a-missing-file", lambda place: place / f"{ESCAPES}.csv", "not_readable"),
)  # fmt: skip


# ---------------------------------------------------------------------- recordings: kinds of files


def link(name: str, target: Callable[[Path], Path]) -> Callable[[Path], Path]:
    """Return what makes a symbolic link to a file."""

    def make(place: Path) -> Path:
        (place / name).symlink_to(target(place))
        return place / name

    return make


def capture(fields: bytes) -> Callable[[], bytes]:
    """Return what makes a raw capture with this header and no message."""
    return lambda: b"#imumon-recording " + fields + b"\nabc"


def pipe_beside_a_capture(place: Path) -> Path:
    """Lay a pipe where the second part of a capture would be: to open it would wait for a writer."""
    os.mkfifo(place / "a.0001.bin")
    return file("a.bin", capture(b'{"run": "r", "part": 0, "base": "a.bin"}'))(place)


def pipe_in_a_bag(place: Path) -> Path:
    bag = write_bag2(place / "bag", messages(3))
    os.mkfifo(bag / "more")
    return bag


KINDS_OF_FILES = (
    Hostile("recording", "endless-device", lambda place: Path("/dev/zero"), "not_readable"),
    Hostile(
        "recording", "link-to-an-endless-device", link("a.csv", lambda _: Path("/dev/zero")), "not_readable"
    ),
    Hostile("recording", "link-to-a-table", link("named.csv", table), "300 samples"),
    Hostile("recording", "pipe-beside-a-capture", pipe_beside_a_capture, "no_messages"),
    Hostile("recording", "pipe-in-a-bag", pipe_in_a_bag, "bag_corrupt"),
)

# ---------------------------------------------------------------------- recordings: more than a file holds


def npz_header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": kind, "fortran_order": False, "shape": shape})
    return out.getvalue()


def archive(content: Callable[[], bytes], compression: int = zipfile.ZIP_STORED) -> Callable[[Path], Path]:
    """Return what writes an archive of NumPy whose only array is these bytes."""

    def write(place: Path) -> Path:
        with zipfile.ZipFile(place / "a.npz", "w", compression, compresslevel=1) as out:
            out.writestr("gyro.npy", content())
        return place / "a.npz"

    return write


def gzip_bomb(name: str, piece: Callable[[], bytes]) -> Callable[[Path], Path]:
    """Return what writes 40 pieces of the same bytes, compressed."""

    def write(place: Path) -> Path:
        with gzip.open(place / name, "wb", 1) as out:
            for _ in range(40):
                out.write(piece())
        return place / name

    return write


SHAPES = {"10^15": (10**15,), "3·10^10": (10**10, 3), "2^124": (2**62, 2**62), "3·10^8": (3 * 10**8,)}
MORE_THAN_A_FILE_HOLDS = (
    *(
        Hostile(
            "recording", f"archive-that-claims-{name}-numbers",
            archive(lambda shape=shape: npz_header(shape) + bytes(24)), "npz_corrupt", says="is corrupt",
        )
        for name, shape in SHAPES.items()
    ),
    Hostile(
        "recording", "archive-of-288-MB-of-zeros",
        archive(lambda: npz_header((12 << 20, 3)) + bytes(288 << 20), zipfile.ZIP_DEFLATED), "npz_corrupt",
        memory=400 << 20,
    ),
    Hostile(
        "recording", "gzip-bomb-of-rows", gzip_bomb("a.csv.gz", lambda: b"1,1,1,1\n" * (1 << 17)), "no_header",
        memory=32 << 20,
    ),
    Hostile(
        "recording", "gzip-bomb-of-a-capture", gzip_bomb("b.bin.gz", lambda: bytes(1 << 20)), "no_messages",
        memory=32 << 20,
    ),
    Hostile(
        "recording", "gzip-bomb-of-one-line", gzip_bomb("c.csv.gz", lambda: bytes(1 << 20)), "line_too_long",
        memory=32 << 20,
    ),
    Hostile(
        "recording", "gzip-of-20000-empty-members",
        file("a.csv.gz", lambda: gzip.compress(b"") * 20_000 + gzip.compress(b"a,b\n")), "no_sensor", seconds=2.5,
    ),
)  # fmt: skip

# ---------------------------------------------------------------------- recordings: raw captures

MARK = b"#imumon-recording "
HEADERS = {
    "part-of-4200-digits": b'{"part": %s, "base": "a.bin"}' % (b"9" * 4200),
    "nested-60000-times": b"[" * 60_000,
    "infinite-rate": b'{"rate_hz": 1e400, "alias_factor": NaN}',
    "base-elsewhere": b'{"base": "/etc/passwd", "part": 0}',
    "base-with-a-nul": b'{"base": "a\\u0000", "part": 0}',
    "time-before-the-first-year": b'{"time": "0001-01-01T00:00+14:00"}',
    "wrong-types": b'{"caveats": {"a": 1}, "settings": [1], "id": {}}',
    "infinite-pause": b'{"away_s": 1e999}',
    "no-text": b"\xff\xfe",
}
CAPTURES = (
    Hostile(
        "recording", "capture-of-an-unknown-driver", file("a.bin", capture(b'{"driver": "\\u001b]0;owned"}')),
        "unknown_device_scheme",
    ),
    *(
        Hostile("recording", f"capture-{name}", file("a.bin", capture(fields)), "no_messages")
        for name, fields in HEADERS.items()
    ),
    *(
        Hostile("recording", f"capture-{name}", file("a.bin", content), "no_messages", seconds=2.5)
        for name, content in {
            "60000-marks": lambda: MARK * 60_000,
            "30000-headers": lambda: (MARK + b'{"run": "a"}\n') * 30_000,
            "30000-pieces": lambda: (MARK + b'{"run": "a"}\nx') * 30_000,
        }.items()
    ),
)  # fmt: skip

# ---------------------------------------------------------------------- recordings: bags


def mcap_bomb(place: Path) -> Path:
    """Write an MCAP file of one chunk of zstd data that expands to 600 MB."""
    zstd = (
        pytest.importorskip("backports.zstd", reason="backports.zstd is not installed: it makes the bomb")
        if sys.version_info < (3, 14)
        else __import__("compression.zstd").zstd
    )
    size = 600 << 20
    data = zstd.compress(bytes(size))

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    chunk = struct.pack("<QQQI", 0, 1, size, 0) + text(b"zstd") + struct.pack("<Q", len(data)) + data
    magic = b"\x89MCAP0\r\n"
    (place / "bag.mcap").write_bytes(
        magic + record(1, text(b"ros2") + text(b"")) + record(6, chunk) + record(2, bytes(20)) + magic
    )
    return place / "bag.mcap"


def yaml_bomb(place: Path) -> Path:
    """Write a bag whose description expands to 9^11 entries."""
    bag = write_bag2(place / "bag", messages(3))
    lines = ["a0: &a0 {x: 1, y: 2}"]
    lines += [f"a{k}: &a{k} {{<<: [{','.join([f'*a{k - 1}'] * 9)}]}}" for k in range(1, 12)]
    (bag / "metadata.yaml").write_text("\n".join(lines))
    return bag


def endless_view(place: Path) -> Path:
    """Write a bag whose table of definitions is a view without an end."""
    path = next(write_bag2(place / "bag", messages(3)).glob("*.db3"))
    with sqlite3.connect(path) as base:
        base.execute("DROP TABLE message_definitions")
        endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
        columns = "i AS id, 'a' AS topic_type, 'b' AS encoding, zeroblob(1000) AS encoded_message_definition"
        base.execute(
            f"CREATE VIEW message_definitions AS {endless} SELECT {columns}, '' AS type_description_hash FROM n"
        )
    return path


def other_definition(place: Path) -> Path:
    """Write a bag whose hash of the definition is not that of the type."""
    path = BAGS["rosbag 1"](place / "bag", messages(3))
    path.write_bytes(path.read_bytes().replace(b"6a62c6daae103f4ff57a132d6f95cec2", b"0" * 32))
    return path


EXPANDS = {"says": "cannot be read as a bag", "slow": True}
IN_BAGS = (
    Hostile("recording", "bag-of-another-definition", other_definition, "bag_corrupt"),
    Hostile("recording", "bag-of-expanding-yaml", yaml_bomb, "bag_corrupt", **EXPANDS),
    Hostile("recording", "bag-of-an-endless-view", endless_view, "bag_corrupt", **EXPANDS),
    Hostile("recording", "bag-of-expanding-chunks", mcap_bomb, "bag_corrupt", **EXPANDS),
)

# ---------------------------------------------------------------------- settings

FAULTY_SETTINGS = {
    "escapes-in-a-key": '"a\\u001b]0;x\\u0007" = 1',
    "escapes-in-a-section": '["\\u001b[2J"]\na = 1',
    "escapes-in-a-name": '[device]\n"\\u001b]0;x" = 2',
    "escapes-in-a-number": '[device]\nbaud = "\\u009b"',
    "escapes-in-a-value": '[device]\nport = "a\\u0000\\u001b"',
    "escapes-in-a-comment": "[device]\nid = 3 # \x9b",
    "escapes-without-quotes": "\x1b = 1",
    "dots": "a" + ".a" * 100_000 + " = 1",
    "dots-on-many-lines": "\n".join(f"x{k}" + ".a" * 480 + " = 1" for k in range(200)),
    "blanks": "[" + " " * 200_000,
    "many-blanks": ("[" + " " * 900 + "\n") * 200,
    "nested": "a = " + "[" * 900,
    "many-sections": "\n".join(f"[s{k}]" for k in range(20_000)),
    "many-settings": "[device]\n" + "\n".join(f"s{k} = 1" for k in range(20_000)),
    "large": "#\n" * 1_000_000,
    "long-number": "[device]\nrate_hz = " + "9" * 900,
    "long-list": "[zenoh]\nconnect = [" + "1,\n" * 60_000 + "]",
}
SETTINGS = (
    *(
        Hostile("settings", name, file("config.toml", lambda text=text: text), "faults", seconds=3.0)
        for name, text in FAULTY_SETTINGS.items()
    ),
    Hostile("settings", "endless-device", lambda place: Path("/dev/zero"), "faults", says="larger"),
    Hostile("settings", "empty-device", lambda place: Path("/dev/null"), "read"),
)

# ---------------------------------------------------------------------- saved states

STATE = SavedState({"serial": "7", "samples": 7}, {"sum": np.arange(5.0)})
FOREIGN = b"of somebody"
"""Content of a file that links point to, which a save must not change."""


def forged(
    *entries: tuple[str, bytes],
    text: str = f'{{"format": {FORMAT}, "meta": {{}}}}',
    kind: int = zipfile.ZIP_STORED,
) -> bytes:
    """Return a state file with right checksums and any entries.

    Parameters
    ----------
    entries : name and content of each array.
    text : the description.
    kind : compression inside the archive.
    """
    described = io.BytesIO()
    np.save(described, np.array(text))
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", kind) as out:
        for name, content in (("imumon.state", described.getvalue()), *entries):
            out.writestr(f"{name}.npy", content)
    return lzma.compress(archive.getvalue(), preset=0)


def array(kind: str, *shape: int, content: bytes = b"") -> tuple[str, bytes]:
    """Return an entry whose header says anything."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": kind, "fortran_order": False, "shape": shape})
    return "a", header.getvalue() + content


@cache
def bomb(kind: int) -> bytes:
    """Return a small file with an array larger than any state."""
    return forged(array("|u1", 260 << 20, content=bytes(260 << 20)), kind=kind)


def target_link(path: Path) -> None:
    path.symlink_to(path.with_name("target"))


def huge_state(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(FILE_BYTES + 1)


OBSTACLES: dict[str, Callable[[Path], Any]] = {
    "link": target_link,
    "dangling-link": lambda path: path.symlink_to(path.with_name("nothing")),
    "endless-device": lambda path: path.symlink_to("/dev/zero"),
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "larger-than-any-state": huge_state,
    "nested": lambda path: path.write_bytes(forged(text="[" * 100_000 + "]" * 100_000)),
    "bomb": lambda path: path.write_bytes(bomb(zipfile.ZIP_STORED)),
    "bomb-in-the-archive": lambda path: path.write_bytes(bomb(zipfile.ZIP_DEFLATED)),
    "no-archive": lambda path: path.write_bytes(lzma.compress(b"imumon.state.npy" + bytes(999))),
    "no-text": lambda path: path.write_bytes(forged(text="")),
    "no-object": lambda path: path.write_bytes(forged(text='{"format": 4, "meta": []}')),
    "no-format": lambda path: path.write_bytes(forged(text='{"meta": {}}')),
    "no-array": lambda path: path.write_bytes(forged(("a", b"12345678"))),
    "huge-array": lambda path: path.write_bytes(forged(array("<f8", 10**6, 10**13))),
    "large-array": lambda path: path.write_bytes(forged(array("<f8", 10**9))),
    "empty-items": lambda path: path.write_bytes(forged(array("<U0", 10**6, 10**13))),
    "objects": lambda path: path.write_bytes(forged(array("|O", 1, content=bytes(8)))),
    "negative": lambda path: path.write_bytes(forged(array("<f8", -1, -1))),
    "escapes": lambda path: path.write_bytes(forged(array("\x1b]0;x\x07", 1))),
}


def obstacle(kind: str, name: str, target: bytes) -> Callable[[Path], Path]:
    """Return what lays an obstacle under a name into a directory, beside the file that its links point to."""

    def lay(place: Path) -> Path:
        (place / "target").write_bytes(target)
        OBSTACLES[kind](place / name)
        return place

    return lay


SENSOR_SETTINGS = {
    "value-with-a-command": b'{"75": "2,8,01,0001\\r\\n$VNWNV*57"}',
    "register-in-superscript": b'{"\xc2\xb2": "1"}',
    "value-of-no-text": b'{"5": 115200}',
    "escapes": b'{"5": "\\u001b"}',
    "nested": b"[" * 60_000,
    "long": b'{"5": "1"' + b" " * 70_000 + b"}",
    "no-object": b"[]",
    "no-text": b"\xff",
}
VALID_SETTINGS = b'{"5": "9600", "75": "2,8,01,0001", "new baud": "115200"}'


def settings_pipe(place: Path) -> Path:
    os.mkfifo(place / "found.json")
    return place / "found.json"


STATES = (
    *(
        Hostile(
            "state", f"{kind}-as-{name}", obstacle(kind, name, encode(STATE)), "set aside", memory=2 << 30, seconds=20.0
        )
        for kind in OBSTACLES
        for name in ("d.state", "d.state.1")
    ),
    *(
        Hostile("save", f"{kind}-as-{name}", obstacle(kind, name, FOREIGN), "replaced")
        for kind in ("link", "dangling-link", "endless-device", "pipe", "larger-than-any-state")
        for name in ("d.state.new", "d.state", "d.state.1", "d.lock")
    ),
    *(
        Hostile("sensor-settings", name, file("found.json", lambda data=data: data), "ignored")
        for name, data in SENSOR_SETTINGS.items()
    ),
    Hostile("sensor-settings", "pipe", settings_pipe, "ignored"),
    Hostile(
        "sensor-settings", "link",
        link("found.json", lambda place: file("target", lambda: b'{"5": "9600"}')(place)), "ignored",
    ),
    Hostile("sensor-settings", "endless-device", link("found.json", lambda _: Path("/dev/zero")), "ignored"),
    Hostile("sensor-settings", "valid", file("found.json", lambda: VALID_SETTINGS), "read"),
)  # fmt: skip

# ---------------------------------------------------------------------- reports, signals and names


def changed(*path: str | int, to: Any) -> str:
    """Return the real report as JSON with one value exchanged or added."""
    data = json.loads(to_json(real_report()))
    *way, last = path
    part = data
    for key in way:
        part = part[key]
    part[last] = to
    return json.dumps(data)


def written(number: float) -> str:
    """Return a number, or a power of ten that is no float, as a part of a name."""
    return f"1e{len(str(number)) - 1}" if isinstance(number, int) else str(number)


ALLAN = ("channels", "gyro/x", "allan")
NUMBERS: tuple[tuple[str | int, ...], ...] = (
    ("channels", "gyro/x", "mean"),
    ("channels", "gyro/x", "count"),
    ("channels", "gyro/x", "N", "value"),
    ("session", "elapsed_s"),
    ("session", "samples"),
    (*ALLAN, "sigma", 0),
    ("limits", "gyro", "N", "tactical"),
    ("device", "sample_rate_hz"),
)
"""Numbers of a report, each of which must not be infinite, missing or beyond the largest that is computed with."""
VALUES: dict[str, tuple[tuple[str | int, ...], Any]] = {
    "channel-without-a-name": (("channels", ""), {"unit": "V"}),
    "channel-without-an-axis": (("channels", "gyro/"), {"unit": "V"}),
    "channel-of-three-parts": (("channels", "a/b/c"), {"unit": "V"}),
    "channel-with-a-wildcard": (("channels", "gyro/*"), {"unit": "V"}),
    "channel-with-escapes": (("channels", "\x1b]0;x\x07"), {"unit": "V"}),
    "grade-by-an-unknown-axis": (("grade", "gyro", "decided_by"), {"axis": "w", "coefficient": "N"}),
    "grade-by-an-unknown-coefficient": (("grade", "gyro", "decided_by"), {"axis": "x", "coefficient": "Z"}),
    "unknown-grade": (("grade", "gyro", "nearest"), "splendid"),
    "grade-of-nothing": (("grade", ""), {}),
    "unknown-state": (("state",), "asleep"),
    "unknown-status": (("channels", "gyro/x", "N", "status"), "guessed"),
    "negative-limit": (("channels", "gyro/x", "N", "low"), -1.0),
    "histogram-of-width-0": (("channels", "gyro/x", "histogram", "width"), 0.0),
    "histogram-of-negative-width": (("channels", "gyro/x", "histogram", "width"), -1.0),
    "unequal-histogram": (("channels", "gyro/x", "histogram", "gaussian"), []),
    "unequal-curve": ((*ALLAN, "used"), []),
    "unequal-degrees-of-freedom": ((*ALLAN, "edf"), [1.0]),
    "cluster-time-0": ((*ALLAN, "tau_s", 0), 0.0),
    "negative-count": (("session", "samples"), -1),
    "period-0": (("period_s",), 0.0),
    "speed-0": (("speed",), 0.0),
    "empty-limit-curve": (("limit_curves", "gyro", "tactical"), {"tau_s": [], "sigma": []}),
    "limit-curve-of-0": (("limit_curves", "gyro", "tactical"), {"tau_s": [1.0], "sigma": [0.0]}),
    "10000-caveats": (("caveats",), ["x"] * 10_000),
    "model-of-100000-letters": (("device", "model"), "x" * 100_000),
    "10000-settings": (("device", "settings"), {str(k): "" for k in range(10_000)}),
}
STRIP = {"start_s": 0.0, "column_s": 0.0, "low": [1.0], "high": [1.0]}
SIGNALS: dict[str, dict[str, Any]] = {
    "column-of-0-s": {"minute": STRIP},
    "channel-with-a-wildcard": {"channel": "gyro/*"},
    "without-a-channel": {"channel": ""},
}
DEVICE_NAMES = {
    "escapes": "a\x1b]0;x\x07", "empty": "", "capital": "A", "long": "x" * 65, "umlaut": "ä", "blank": "a b",
    "line-end": "a\n", "slash": "a/b", "at": "@a",
}  # fmt: skip


def channels(count: int) -> str:
    """Return a report with so many channels, real ones if they are few."""
    real = json.loads(to_json(real_report()))["channels"]["gyro/x"]
    entry = real if count < 100 else {"unit": "V"}
    return changed("channels", to={f"gyro/x{k}": entry for k in range(count)})


def sparse(place: Path) -> Path:
    """Write a file of 1 TB that takes no place on the disk."""
    path = place / "report.json"
    with path.open("wb") as out:
        out.write(b"{")
        out.truncate(1 << 40)
    return path


MESSAGES = (
    *(
        Hostile(
            "report", f"{'.'.join(map(str, path))}={written(number)}",
            lambda _, path=path, number=number: changed(*path, to=number), "rejected", says="not a report",
        )
        for path in NUMBERS
        for number in FORBIDDEN
    ),
    *(
        Hostile(
            "report", name, lambda _, path=path, value=value: changed(*path, to=value), "rejected", says="not a report"
        )
        for name, (path, value) in VALUES.items()
    ),
    Hostile("report", "64-channels", lambda _: channels(MAX_CHANNELS), "shown", seconds=10.0),
    Hostile("report", "65-channels", lambda _: channels(MAX_CHANNELS + 1), "rejected"),
    Hostile("report", "100000-channels", lambda _: channels(100_000), "rejected"),
    Hostile("report", "5-MB", lambda _: " " * 5_000_000, "rejected", says="more than"),
    *(
        Hostile(
            "signal", name, lambda _, change=change: json.dumps({"channel": "gyro/x", "unit": "V"} | change),
            "rejected", says="not a signal",
        )
        for name, change in SIGNALS.items()
    ),
    *(Hostile("device-name", name, lambda _, text=text: text, "rejected") for name, text in DEVICE_NAMES.items()),
    Hostile("saved-report", "escapes", file("a\x1b]0;owned\x07.json", lambda: '{"\x1b]0;owned\x07": 1}'), "refused"),
    Hostile("saved-report", "escapes-in-a-missing-file", lambda place: place / "none\x1b[2J", "refused"),
    Hostile("saved-report", "1-TB", sparse, "refused", says="not a saved report"),
)  # fmt: skip

# ---------------------------------------------------------------------- the bus

GOOD = to_json(report("b", 5))
CRAFTED = {
    TITLE: GOOD,
    "x": GOOD,  # the id of another device
    "y": GOOD.replace('"mean":0.5', f'"mean":1{"0" * 400}'),
    "z": GOOD.replace('"mean":0.5', '"mean":1e308'),
    "b": GOOD.replace('"model":null', f'"model":{json.dumps(TITLE)}', 1),  # that of the device
}
"""Reports beside which every command is tried, by the name in their keys."""
BAD_NAMES = {"escapes": TITLE, "capital": "A", "long": "x" * 65, "umlaut": "ä", "blank": "a b"}
BUS = (
    *(
        Hostile(
            "query", way.__name__.replace("_", "-"), lambda _, way=way: way, "bounded",
            slow=way is not attackers.payload,
        )
        for way in (
            attackers.payload, attackers.attachment, attackers.parameters, attackers.small_payload, attackers.names,
            attackers.many, attackers.forge,
        )
    ),
    Hostile("waiting-query", "payload", lambda _: ("", {"payload": b"x"}), "no reply"),
    Hostile("waiting-query", "attachment", lambda _: ("", {"attachment": b"x"}), "no reply"),
    Hostile("waiting-query", "long-selector", lambda _: (f"?{'x' * 2000}", {}), "no reply"),
    *(
        Hostile("message", f"{kind}-of-{name}", lambda _, key=f"{text}/{kind}", data=data: (key, data), "ignored")
        for name, text in BAD_NAMES.items()
        for kind, data in (("report", to_json(report("a", 1))), ("event", to_json(event("a", 1))), ("alive", None))
    ),
    Hostile("message", "report-of-another-device", lambda _: ("b/report", to_json(report("c", 6))), "ignored"),
    Hostile("message", "report-of-1-MB", lambda _: ("b/report", to_json(report("b", 7)) + " " * 1_000_000), "ignored"),
    Hostile("message", "event-of-another-device", lambda _: ("b/event", to_json(event("c", 1))), "ignored"),
    Hostile("message", "event-of-100-kB", lambda _: ("b/event", to_json(event("b", 1)) + " " * 100_000), "ignored"),
    Hostile("command", "status", lambda _: ("status",), "0"),
    *(
        Hostile("command", "-".join(words).replace("--", ""), lambda _, words=words: words, code, slow=True)
        for *words, code in (
            ("status", "--json", "0"),
            ("report", "0"),
            ("wait", "--timeout", "5s", "0"),
            ("status", "--id", "x", "3"),
            ("status", "--id", "y", "3"),
            ("status", "--id", "z", "3"),
        )
    ),
    Hostile("command", "doctor", lambda _: ("doctor", "--port", "/dev/null"), "1", says="running: b;", slow=True),
)  # fmt: skip

CORPUS = (
    *TABLES,
    *KINDS_OF_FILES,
    *MORE_THAN_A_FILE_HOLDS,
    *CAPTURES,
    *IN_BAGS,
    *SETTINGS,
    *STATES,
    *MESSAGES,
    *BUS,
)
