"""Recordings of any format: opening one by its contents, and decoding raw captures."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
from collections.abc import Iterable, Iterator, Sequence

from imumon.checkpoint import is_state
from imumon.files import open_regular
from imumon.model.cures import option
from imumon.model.samples import Gap, SampleBlock
from imumon.sources.device import DeviceError, sample_blocks
from imumon.sources.files.array_file import read_arrays
from imumon.sources.files.array_table import ArrayTable
from imumon.sources.files.base import (
    HEAD_BYTES,
    OptionNotApplicable,
    ReadOptions,
    Recording,
    RecordingError,
)
from imumon.sources.files.columns import SINCE_1970_S
from imumon.sources.files.log_file import LogFile, log_kind
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.text_cells import decoded
from imumon.sources.files.text_file import TextFile, utf_16
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
    """Yield the same bytes in blocks of a size, none across a gap."""
    waiting = bytearray()
    for item in items:
        if isinstance(item, Gap):
            yield bytes(waiting)
            yield item
            waiting.clear()
            continue
        waiting += item
        while len(waiting) >= size:
            yield bytes(waiting[:size])
            del waiting[:size]
    yield bytes(waiting)


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
        _refuse(path, options, "where", *([] if kind == "bag" else ["definitions"]))
        return LogFile(path, kind, options)
    _refuse(path, options, "definitions")
    if (arrays := read_arrays(path, head)) is not None:
        _refuse(path, options, "topic", "where")
        form, by_name = arrays
        return ArrayTable(by_name, options, path, form)
    capture = RawCapture(path)
    _refuse(path, options, "topic")
    if capture.header is None:
        if is_telemetry(capture.head):
            text = f"{path} is a telemetry log of MAVLink (.tlog)"
            raise RecordingError("format_tlog", text, TELEMETRY_CURE)
        if _is_text(capture):
            return TextFile(capture, options)
    _refuse(path, options, "sensor", "where", "columns", "units", "samples")
    return DecodedCapture(capture, options.block_bytes)


NOT_APPLICABLE = {
    "definitions": ("msg_not_applicable", "bags of ROS"),
    "topic": ("topic_not_applicable", "bags and logs of autopilots"),
    "where": ("where_not_applicable", "tables of text"),
    "sensor": ("sensor_not_applicable", "tables and logs"),
    "columns": ("map_not_applicable", "tables and logs"),
    "units": ("units_not_applicable", "tables"),
    "samples": ("units_not_applicable", "tables"),
}
"""Code of the error if an option does not fit, and for what it is, by its field in `ReadOptions`."""


def _refuse(path: str, options: ReadOptions, *fields: str) -> None:
    """Raise `OptionNotApplicable` if one of these options is given: the recording has no use for it."""
    for field in fields:
        if getattr(options, field):
            code, what = NOT_APPLICABLE[field]
            text = f"{option(field)} is for {what}, and {path} is none"
            raise OptionNotApplicable(code, text, "leave it out")


_REPORT = re.compile(rb'\s*\{\s*"schema"\s*:\s*"imumon\.report/')
"""Begin of a saved report."""


def _check_not_kept(path: str, head: bytes) -> None:
    """Raise `RecordingError` if imumon itself has saved a file as a state or a report: neither has samples."""
    cure = f"imumon report {shlex.quote(path)} prints its numbers"
    if is_state(head):
        raise RecordingError("is_state", f"{path} is a saved state, which has no samples", cure)
    if _REPORT.match(head):
        raise RecordingError("is_report", f"{path} is a saved report, which has no samples", cure)


MAVLINK = (0xFD, 0xFE)
"""First bytes of messages of MAVLink 2 and 1."""


TELEMETRY_CURE = (
    "write one of its messages as CSV with mavlogdump.py of pymavlink: --types SCALED_IMU2 --format csv"
)


def is_telemetry(head: bytes) -> bool:
    """Return whether bytes begin as a telemetry log: us since 1970, big-endian, before each message of MAVLink.

    >>> is_telemetry((1_700_000_000_000_000).to_bytes(8, "big") + bytes([0xFD])), is_telemetry(b"$VNYMR,+1")
    (True, False)
    """
    seconds = int.from_bytes(head[:8], "big") * 1e-6
    return len(head) > 8 and head[8] in MAVLINK and SINCE_1970_S[0] < seconds < SINCE_1970_S[1]


def _is_text(capture: RawCapture) -> bool:
    """Return whether a file without a header of imumon is text, and no stream of messages."""
    if utf_16(capture.head) is not None:
        return True
    name = capture.path.lower().removesuffix(".gz")
    head = capture.head[:HEAD_BYTES]
    if (not name.endswith((".csv", ".tsv")) and b"\0" in head) or _is_stream_of_messages(head):
        return False
    text = decoded(head)
    printable = sum(character.isprintable() or character in "\t\r\n\v\f" for character in text)
    return printable > TEXT_SHARE * len(text)


TEXT_SHARE = 0.95
"""Share of the characters that can be printed in what is text; a file may have damaged bytes."""


def _is_stream_of_messages(head: bytes) -> bool:
    """Return whether bytes are messages of the device that is the default, and no table that has them beside a time."""
    if (decoder := driver().decoder()) is None:
        return False
    lines = [line for line in re.split(rb"\r\n?|\n", head) if b"$" in line]
    if lines and sum(not line.lstrip().startswith(b"$") for line in lines[1:]) > len(lines) / 2:
        return False
    decoder.feed(head)
    return bool(decoder.messages)
