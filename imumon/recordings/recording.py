"""Recordings of any format: opening one by its contents, and decoding raw captures."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence

from imumon.devices.base import DeviceError, sample_blocks
from imumon.devices.registry import DEFAULT_SCHEME, driver, scheme_of_bytes
from imumon.files import open_regular
from imumon.recordings.array_file import ArrayFile, array_kind
from imumon.recordings.base import (
    HEAD_BYTES,
    HEAD_LINES,
    OptionNotApplicable,
    ReadOptions,
    Recording,
    RecordingError,
)
from imumon.recordings.columns import layout
from imumon.recordings.csv import CsvFile, header_line, is_echoed
from imumon.recordings.csv_rows import is_number, separator_of, split
from imumon.recordings.log_file import LogFile, log_kind
from imumon.recordings.raw_capture import RawCapture
from imumon.recordings.sentence_table import sentence_table
from imumon.samples import Gap, SampleBlock


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
        found = header.get("driver") or scheme_of_bytes(capture.head[:HEAD_BYTES])
        scheme = found or DEFAULT_SCHEME
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
        self._title = self._driver.title if found else "known sensor"

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
        for at in range(0, len(item), size):
            waiting.append(item[at : at + size])
            length += len(waiting[-1])
            if length >= size:
                yield b"".join(waiting)
                waiting, length = [], 0
    yield b"".join(waiting)


def open_recording(path: str, options: ReadOptions) -> Recording:
    """Open a recording of any format: its contents decide, and the name only where they do not.

    Raises
    ------
    RecordingError : it cannot be read, or is something else.
    OptionNotApplicable : a topic was given, and it has no topics.
    """
    head = b""
    if os.path.isdir(path) and log_kind(path, head) is None:
        cure = "name a file in it, or let ros2 bag reindex make the metadata.yaml of a bag"
        raise RecordingError("is_directory", f"{path} is a directory and no bag", cure)
    if path != "-":  # a pipe can be read only once
        with contextlib.suppress(OSError), open(open_regular(path, follow=True), "rb") as file:
            head = file.read(16)
    if (kind := log_kind(path, head)) is not None:
        return LogFile(path, kind, options)
    arrays = array_kind(path, head)
    opened = RawCapture(path) if arrays is None else ArrayFile(path, arrays, options)
    if options.topic is not None:
        text = f"--topic is for bags and logs of autopilots, and {path} is none"
        raise OptionNotApplicable("topic_not_applicable", text, "leave it out")
    if isinstance(opened, ArrayFile):
        return opened
    text_file = _text_file(opened, options) if opened.header is None else None
    if text_file is not None:
        return text_file
    if options.sensor is not None:
        text = f"--sensor is for tables and logs, and {path} is neither"
        raise OptionNotApplicable("sensor_not_applicable", text, "leave it out")
    if opened.header is None and (advice := _text_cure(opened.head[:HEAD_BYTES])) is not None:
        text = f"{path} is text, but no table with a line that names its columns"
        raise RecordingError("no_messages", text, advice)
    return DecodedCapture(opened, options.block_bytes)


def _text_file(capture: RawCapture, options: ReadOptions) -> Recording | None:
    """Return the recording that the text of a file without a header of imumon is; None: it is no table."""
    if capture.head.startswith((b"\xff\xfe", b"\xfe\xff")) and b"\0" in capture.head[:HEAD_LINES]:
        raise RecordingError("utf_16", f"{capture.path} is text in UTF-16", "save it as UTF-8")
    if options.sensor is None and (decoder := driver().decoder()) is not None:
        table = sentence_table(capture, options, decoder, DEFAULT_SCHEME)
        if table is not None:
            return table
    return CsvFile(capture, options) if _is_csv(capture, options) else None


def _text_cure(head: bytes) -> str | None:
    """Return how to make a table of text that has no sentences of a sensor; None: it is something else."""
    text = head.decode("utf-8-sig", "ignore")
    if not text.strip() or b"$" in head or not all(c.isprintable() or c in "\t\r\n" for c in text):
        return None
    if text.lstrip()[0] in "[{":
        return "it is JSON: write it as CSV, pandas.read_json(FILE).to_csv(...)"
    return "write one line of names and one line of numbers per sample, with one separator"


def _is_numbers(lines: Sequence[str]) -> bool:
    """Return whether the first lines are rows of as many numbers: a table without a header."""
    rows = [split(line, separator_of(line)) for line in lines[:HEAD_LINES] if line.strip()]
    rows = rows[:-1] if len(rows) > 1 else rows  # the last one may end elsewhere
    return bool(rows) and all(len(row) == len(rows[0]) and all(map(is_number, row)) for row in rows)


def _is_csv(capture: RawCapture, options: ReadOptions) -> bool:
    """Return whether text is a table: its name says so, or its header names an inertial sensor."""
    head = capture.head[:HEAD_BYTES]
    if (decoder := driver().decoder()) is not None:
        decoder.feed(head)
        if decoder.messages:
            return False
    name = capture.path.lower().removesuffix(".gz")
    if name.endswith((".csv", ".tsv")) or options.columns:
        return True
    if b"\0" in capture.head:
        return False
    lines = head.decode("utf-8-sig", "replace").splitlines()
    at = header_line(lines)
    if at is None:
        return _is_numbers(lines) or any(map(is_echoed, lines))
    try:
        layout([lines[at], *split(lines[at], separator_of(lines[at]))])
    except RecordingError:
        return False
    return True
