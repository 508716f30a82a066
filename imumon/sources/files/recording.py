"""Recordings of any format: opening one by its contents, and decoding raw captures."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from imumon.checkpoint import is_state
from imumon.files import open_regular
from imumon.model.cures import option, option_text
from imumon.model.samples import AXES, Gap, SampleBlock
from imumon.sources.column_names import parse_names, triples
from imumon.sources.device import DeviceError, sample_blocks
from imumon.sources.files.array_file import ArrayFile, array_kind
from imumon.sources.files.base import (
    HEAD_BYTES,
    HEAD_LINES,
    OptionNotApplicable,
    ReadOptions,
    Recording,
    RecordingError,
)
from imumon.sources.files.column_meaning import check_nothing_stated
from imumon.sources.files.columns import SENSORS
from imumon.sources.files.csv import CsvFile
from imumon.sources.files.log_file import LogFile, log_kind
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.sentence_table import sentence_table
from imumon.sources.files.table_header import (
    below_header,
    header_line,
    is_echoed,
    is_number,
    separator_of,
    split,
    tagged_headers,
)
from imumon.sources.files.text_records import record_text
from imumon.sources.files.unit_checks import SINCE_1970_S
from imumon.sources.registry import DEFAULT_SCHEME, driver, scheme_of_bytes


class DecodedCapture(Recording):
    """Samples of a raw capture, decoded by the decoder of its device.

    Parameters
    ----------
    capture : its header names the driver; without one, the driver that finds messages is used.
    block_bytes : bytes that are decoded at once.

    Raises
    ------
    RecordingError : there is no such driver, or it decodes no bytes.
    """

    def __init__(self, capture: RawCapture, block_bytes: int) -> None:
        self.header = capture.header
        self._capture = capture
        self._block_bytes = block_bytes
        header = capture.header or {}
        recognised = header.get("driver") or scheme_of_bytes(capture.head[:HEAD_BYTES])
        scheme = recognised or DEFAULT_SCHEME
        try:
            self._driver = driver(scheme)
        except DeviceError as error:
            cure = "install the package that adds this device"
            raise RecordingError(error.code, f"{capture.path}: {error.message}", cure) from None
        decoder = self._driver.decoder(header.get("settings", {}) if capture.header else None)
        if decoder is None:
            raise RecordingError(
                "no_decoder",
                f"{capture.path}: the driver {scheme!r} reads no recordings",
                "use its own program",
            )
        self.driver, self._decoder = scheme, decoder
        self._title = self._driver.title if recognised else "known sensor"

    def __iter__(self) -> Iterator[Sequence[SampleBlock | Gap]]:
        for item in _in_blocks(self._capture.items(), self._block_bytes):
            items = [item] if isinstance(item, Gap) else sample_blocks(self._decoder.feed(item))
            self._update_counters()
            yield items
        items = sample_blocks(self._decoder.finish())
        self._update_counters()
        yield items

    def _update_counters(self) -> None:
        decoder, capture = self._decoder, self._capture
        self.fed, self.discarded, self.bad_checksums = decoder.fed, decoder.discarded, decoder.bad_checksums
        self.ledger = decoder.ledger
        self.problem, self.progress = capture.problem, capture.progress

    def no_samples(self) -> RecordingError:
        path, decoder = self._capture.path, self._decoder
        if decoder.messages:
            text = f"{path} has {decoder.messages} valid messages but none with gyroscope or accelerometer"
            return RecordingError("no_inertial_messages", text, "let the sensor send one of them")
        text = f"{path} has no valid message of a {self._title} in {decoder.fed} bytes"
        return RecordingError("no_messages", text, "check that it is a recording of a sensor")


def _in_blocks(items: Iterable[bytes | Gap], size: int) -> Iterator[bytes | Gap]:
    """Yield the same bytes in blocks of about a size, none across a gap."""
    waiting: list[bytes] = []
    length = 0
    for item in items:
        if isinstance(item, Gap):
            yield b"".join(waiting)
            yield item
            waiting, length = [], 0
            continue
        for first in range(0, len(item), size):
            waiting.append(item[first : first + size])
            length += len(waiting[-1])
            if length >= size:
                yield b"".join(waiting)
                waiting, length = [], 0
    yield b"".join(waiting)


HEAD_OF_KIND = 256
"""First bytes of a file by which its kind is known."""


def _first_bytes(path: str) -> bytes:
    """Return the first bytes of a file; none of standard input, and of a bag that is a directory."""
    if os.path.isdir(path) and log_kind(path, b"") is None:
        cure = "name a file in it, or let ros2 bag reindex make the metadata.yaml of a bag"
        raise RecordingError("is_directory", f"{path} is a directory and no bag", cure)
    if path != "-":  # a pipe can be read only once
        with contextlib.suppress(OSError), open(open_regular(path, follow=True), "rb") as file:
            return file.read(HEAD_OF_KIND)
    return b""


def open_recording(path: str, options: ReadOptions) -> Recording:
    """Open a recording of any format: its contents decide, and the name only where they do not.

    Raises
    ------
    RecordingError : it cannot be read, or is something else.
    OptionNotApplicable : a topic was given, and it has no topics.
    """
    head = _first_bytes(path)
    _check_not_kept(path, head)
    # the first bytes of logs and arrays are certain; text comes last, as everything may look like it
    if (kind := log_kind(path, head)) is not None:
        _refuse_where(path, options)
        return LogFile(path, kind, options)
    if options.definitions is not None:
        text = f"{option('definitions')} is for bags of ROS, and {path} is none"
        raise OptionNotApplicable("msg_not_applicable", text, "leave it out")
    arrays = array_kind(path, head)
    opened = RawCapture(path) if arrays is None else ArrayFile(path, arrays, options)
    if options.topic is not None:
        text = f"{option('topic')} is for bags and logs of autopilots, and {path} is none"
        raise OptionNotApplicable("topic_not_applicable", text, "leave it out")
    if isinstance(opened, ArrayFile):
        _refuse_where(path, options)
        return opened
    if opened.header is None and is_telemetry(opened.head):
        text = f"{path} is a telemetry log of MAVLink (.tlog)"
        raise RecordingError("format_tlog", text, _with_name(_tlog_cure(), path))
    text_file = _text_file(opened, options) if opened.header is None else None
    if text_file is not None:
        return text_file
    if options.sensor is not None:
        text = f"{option('sensor')} is for tables and logs, and {path} is neither"
        raise OptionNotApplicable("sensor_not_applicable", text, "leave it out")
    _refuse_where(path, options)
    if options.columns:
        text = f"{option('columns')} is for tables and logs, and {path} has messages of a sensor"
        raise OptionNotApplicable("map_not_applicable", text, "leave it out")
    check_nothing_stated(path, options)
    if opened.header is None and (advice := _text_cure(opened.head[:HEAD_BYTES])) is not None:
        raise RecordingError("no_messages", f"{path} is {advice[0]}", _with_name(advice[1], path))
    return DecodedCapture(opened, options.block_bytes)


_REPORT = re.compile(rb'\s*\{\s*"schema"\s*:\s*"imumon\.report/')
"""Begin of a saved report."""


def _check_not_kept(path: str, head: bytes) -> None:
    """Raise `RecordingError` if imumon itself has saved a file as a state or a report: neither has samples."""
    cure = f"imumon report {shlex.quote(path)} prints its numbers"
    if is_state(head):
        raise RecordingError("is_state", f"{path} is a saved state, which has no samples", cure)
    if _REPORT.match(head):
        raise RecordingError("is_report", f"{path} is a saved report, which has no samples", cure)


def _with_name(cure: str, path: str) -> str:
    """Return a cure whose commands name the file; standard input has no name."""
    return cure if path == "-" else cure.replace(" FILE ", f" {shlex.quote(path)} ")


MAVLINK = (0xFD, 0xFE)
"""First bytes of messages of MAVLink 2 and 1."""


def _tlog_cure() -> str:
    """Return how to make a table of a telemetry log.

    The program is a part of pymavlink (extra ``ardupilot``); SCALED_IMU2 has mrad/s and mg (MAVLink common.xml).
    """
    command = "mavlogdump.py --types SCALED_IMU2 --format csv FILE > imu.csv"
    columns = {
        "t": "SCALED_IMU2.time_boot_ms:ms",
        **{f"gyro/{axis}": f"SCALED_IMU2.{axis}gyro:mrad/s" for axis in AXES},
        **{f"accel/{axis}": f"SCALED_IMU2.{axis}acc:mg" for axis in AXES},
    }
    return f"write one of its messages as CSV, {command}, then {option_text(columns=columns)}"


def is_telemetry(head: bytes) -> bool:
    """Return whether bytes begin as a telemetry log: us since 1970, big-endian, before each message of MAVLink.

    >>> is_telemetry((1_700_000_000_000_000).to_bytes(8, "big") + bytes([0xFD])), is_telemetry(b"$VNYMR,+1")
    (True, False)
    """
    seconds = int.from_bytes(head[:8], "big") * 1e-6
    return len(head) > 8 and head[8] in MAVLINK and SINCE_1970_S[0] < seconds < SINCE_1970_S[1]


def _refuse_where(path: str, options: ReadOptions) -> None:
    """Raise `OptionNotApplicable` if rows are chosen by a column."""
    if options.where:
        text = f"{option('where')} is for tables of text, and {path} is none"
        raise OptionNotApplicable("where_not_applicable", text, "leave it out")


def _text_file(capture: RawCapture, options: ReadOptions) -> Recording | None:
    """Return the recording that the text of a file without a header of imumon is; None: it is no table."""
    if (encoding := _utf_16(capture.head)) is not None:
        cure = f"save it as UTF-8: iconv -f {encoding} -t UTF-8 FILE > imu.csv"
        raise RecordingError("utf_16", f"{capture.path} is text in UTF-16", _with_name(cure, capture.path))
    # one sentence has all sensors at one rate: there is nothing to select
    if options.sensor is None and (decoder := driver().decoder()) is not None:
        table = sentence_table(capture, options, decoder, DEFAULT_SCHEME)
        if table is not None:
            return table
    records = None if capture.path.lower().endswith((".csv", ".tsv")) else record_text(capture)
    if records is not None:
        return CsvFile(records, options)
    return CsvFile(capture, options) if _is_csv(capture, options) else None


NOVATEL = "a log of NovAtel in ASCII, whose increments have the scales of the IMU"


def _novatel_cure(log: str, time: int) -> str:
    """Return how to convert a log of NovAtel, by the number of its field with the seconds of the week.

    Behind it are a status, and the increments in the order z, -y, x of accelerometer and gyroscope (OEM7 Commands and
    Logs Reference Manual, RAWIMU, RAWIMUSX).
    """
    axes = {"accel": ("z=2*", "y=3*-", "x=4*"), "gyro": ("z=5*", "y=6*-", "x=7*")}
    scaled = {
        f"{sensor}/{axis[0]}": f"{axis[2:]}{sensor.upper()}_SCALE:{unit}"
        for (sensor, of_sensor), unit in zip(axes.items(), ("m/s", "rad"), strict=True)
        for axis in of_sensor
    }
    given = option_text(kind="deltas", columns={"t": "1:s", **scaled})
    return (
        f"write its numbers as CSV: grep {log} FILE | cut -d ';' -f 2 | tr '*' ',' | cut -d , -f "
        f"{time},{time + 2}-{time + 7} > imu.csv, then {given}"
        "; the scales of the IMU are in the manual"
    )


JUDGED_BYTES = 40
"""Bytes by which UTF-16 is recognised; a file with less than half of them is not judged."""


def _utf_16(head: bytes) -> str | None:
    """Return the name of an encoding in which every second byte of a Latin text is 0; None: it is not so.

    >>> _utf_16("t,gx,gy,gz,ax,ay,az".encode("utf-16-le")), _utf_16(b"t,gx,gy"), _utf_16(bytes(40))
    ('UTF-16LE', None, None)
    """
    few = head[:JUDGED_BYTES]
    if head.startswith((b"\xff\xfe", b"\xfe\xff")) and b"\0" in few:
        return "UTF-16"
    even, odd = few[::2], few[1::2]
    if len(few) < JUDGED_BYTES // 2 or any(even) == any(odd):
        return None
    return "UTF-16LE" if any(even) and all(even) else "UTF-16BE" if all(odd) else None


KNOWN_TEXTS: tuple[tuple[re.Pattern[str], str, Callable[[], str]], ...] = (
    (re.compile(r"^[#%]RAWIMUS?XA?,", re.MULTILINE), NOVATEL, partial(_novatel_cure, "'^[#%]RAWIMUS*X'", 4)),
    (re.compile(r"^[#%]RAWIMUS?A?,", re.MULTILINE), NOVATEL, partial(_novatel_cure, "'^[#%]RAWIMU'", 2)),
    (
        re.compile(r"^[#%](IMURATE|INSPVA|CORRIMU)\w*,", re.MULTILINE),
        "a log of NovAtel in ASCII that has no raw increments",
        lambda: "log RAWIMUSXA instead",
    ),
)
"""Texts of known programs that are not read: how one begins, what it is, and how to convert it."""


def _text_cure(head: bytes) -> tuple[str, str] | None:
    """Return what text is that has no sentences of a sensor, and how to make a table of it; None: something else."""
    text = head.decode("utf-8-sig", "ignore")
    if not text.strip() or b"$" in head or not all(c.isprintable() or c in "\t\r\n" for c in text):
        return None
    for begin, noun, cure in KNOWN_TEXTS:
        if begin.search(text):
            return noun, cure()
    noun = "text, but no table with a line that names its columns"
    return noun, "write one line of names and one line of numbers per sample, with one separator"


def _is_numbers(lines: Sequence[str]) -> bool:
    """Return whether the first lines are rows of as many numbers: a table without a header."""
    rows = [split(line, separator_of(line)) for line in lines[:HEAD_LINES] if line.strip()]
    rows = rows[:-1] if len(rows) > 1 else rows  # the last one may end elsewhere
    return bool(rows) and all(len(row) == len(rows[0]) and all(map(is_number, row)) for row in rows)


def _is_csv(capture: RawCapture, options: ReadOptions) -> bool:
    """Return whether text is a table: its name says so, or its header names an inertial sensor."""
    head = capture.head[:HEAD_BYTES]
    if _has_messages(head):
        return False
    # the name counts only now: a capture of sentences may be called .csv
    name = capture.path.lower().removesuffix(".gz")
    if name.endswith((".csv", ".tsv")) or options.columns:
        return True
    if b"\0" in capture.head:
        return False
    lines = head.decode("utf-8-sig", "replace").splitlines()
    if tagged_headers(lines):
        return True
    header = header_line(lines)
    if header is None:
        return _is_numbers(lines) or any(map(is_echoed, lines))
    # text between numbers, or JSON, is no header
    if re.search(r"[:=]\s*[-+]?[\d.\[{]", lines[header]):
        return False
    names, begin, separator = below_header(lines, header)
    return _may_have_sensor(names, lines[begin:HEAD_LINES], separator)


def _has_messages(head: bytes) -> bool:
    """Return whether bytes have messages of the device that is the default."""
    if (decoder := driver().decoder()) is None:
        return False
    decoder.feed(head)
    return bool(decoder.messages)


def _may_have_sensor(names: Sequence[str], lines: Sequence[str], separator: str | None) -> bool:
    """Return whether a header names a sensor, or three columns of the lines behind it have numbers and may be one."""
    if any(column.quantity in SENSORS for column in parse_names(names)):
        return True
    rows = [split(row, separator) for row in lines if row.strip()]
    rows = [row for row in rows[:-1] if len(row) >= len(names) - 1]
    threes = [triple.indices for triple in triples(names)]
    return bool(rows) and any(all(is_number(row[k]) for row in rows for k in three) for three in threes)
