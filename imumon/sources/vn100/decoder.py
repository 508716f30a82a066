"""Decoder of the VN-100: bytes in any chunks to samples, responses and errors.

Rules, which do not depend on the chunks:

- A message begins at ``$`` or at FA: both occur inside payloads, see `FrameDecoder`.
- A message is valid if its frame, its checksum and its grammar are valid. Then it is counted with all its
  bytes. Not every valid message is a sample: its numbers may not be finite.
- A binary packet with a wrong CRC counts as a bad checksum only if its header occurred in a valid packet
  before, or if there was no valid packet yet: the payload of a damaged packet contains random headers, too.

Therefore fed = message_bytes + discarded + pending. Consecutive messages of one type are decoded as arrays,
which changes only the speed. `LossCounter` estimates the number of lost messages.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from imumon.model.samples import Bools, SampleBlock, selected
from imumon.sources.frame_decoder import FrameDecoder
from imumon.sources.vn100 import ascii, binary
from imumon.sources.vn100.ascii import Response, SensorError

_TEXT = bytes(range(0x20, 0x7F)) + b"\r\n\t"
_MAX_RUN = 8192
"""Messages; most that are decoded as one array, about as many as one read delivers."""


DecodedItem: TypeAlias = SampleBlock | Response | SensorError


class LossCounter:
    """Estimates how many messages were damaged or lost, by the name of their stream.

    A message that was recognised but is invalid counts for its own stream. Other discarded bytes count as one
    message per message length of the stream that they resemble: text resembles sentences, other bytes
    resemble packets; of several streams, the one with the most bytes. Text between packets counts for no
    stream if there are no sentences. Nothing counts before the first message of a stream.
    """

    def __init__(self) -> None:
        self._message_size: dict[bytes, int] = {}
        self._total_bytes: Counter[bytes] = Counter()
        self._lost: Counter[bytes] = Counter()
        self._gap_bytes = 0
        self._gap_is_text = True

    def has_seen(self, name: bytes) -> bool:
        """Return whether there was a valid message of this name."""
        return name in self._message_size

    def add_discarded(self, data: bytes) -> None:
        """Count bytes that belong to no valid message."""
        self._gap_bytes += len(data)
        self._gap_is_text = self._gap_is_text and not data.translate(None, _TEXT)

    def add_damaged(self, name: bytes) -> None:
        """Count a message of this name that was recognised but is invalid."""
        if name in self._message_size:
            self._lost[name] += 1
            self._gap_bytes -= self._message_size[name]

    def add_lost(self, name: bytes, count: int) -> None:
        """Count lost messages of this name."""
        self._lost[name] += count

    def end_gap(self) -> None:
        """Assign the discarded bytes before a valid message to a stream."""
        if self._gap_bytes > 0:
            packets = [name for name in self._total_bytes if name[0] == binary.SYNC]
            sentences = [name for name in self._total_bytes if name[0] != binary.SYNC]
            # text between packets is that of a logger, if the sensor sends no sentences
            candidates = sentences if self._gap_is_text or not packets else packets
            if candidates:
                name = max(candidates, key=self._total_bytes.__getitem__)
                self.add_lost(name, round(self._gap_bytes / self._message_size[name]))
        self._gap_bytes = 0
        self._gap_is_text = True

    def add_valid(self, name: bytes, size: int, count: int) -> int:
        """Count `count` valid messages of `size` bytes; return how many were lost directly before them."""
        self.end_gap()
        self._message_size[name] = size
        self._total_bytes[name] += size * count
        return self._lost.pop(name, 0)


class Vn100Decoder(FrameDecoder[Response | SensorError]):
    """Feed bytes, get items; see `imumon.sources.frame_decoder.FrameDecoder`.

    >>> decoder = Vn100Decoder()
    >>> decoder.feed(b"noise$VNRRG,07,40*5C\\r\\n$VNE"), decoder.pending
    ([Response(command='VNRRG', fields=('07', '40'))], 4)
    """

    start = re.compile(rb"[$\xfa]")

    def __init__(self) -> None:
        super().__init__()
        self._losses = LossCounter()
        self._started_streams: set[bytes] = set()
        self._seen_packet = False

    def finish(self) -> list[DecodedItem]:
        """Return the items in the pending bytes at the end of the stream.

        Bytes that are fed later belong to another connection; losses between the two are not estimated.
        """
        items = super().finish()
        self._losses = LossCounter()
        self._started_streams.clear()
        return items

    def _read(self, data: bytes, begin: int) -> int | None:
        return self._packet(data, begin) if data[begin] == binary.SYNC else self._sentence(data, begin)

    def _discard(self, data: bytes) -> None:
        super()._discard(data)
        self._losses.add_discarded(data)

    def _packet(self, data: bytes, begin: int) -> int | None:
        """Return the bytes of the valid packets that begin here; 0: none, None: more bytes are needed."""
        try:
            layout = binary.parse_header(data, begin)
        except binary.IncompleteHeader:
            return None
        if layout is None:
            return 0
        complete = (len(data) - begin) // layout.length
        if complete == 0:
            return None
        count = layout.count_valid(data, begin, min(complete, _MAX_RUN))
        if count == 0:
            # FA and a possible header occur in payloads: only a known one is a packet that was damaged
            if self._losses.has_seen(layout.header) or not self._seen_packet:
                self._count_damaged()
            self._losses.add_damaged(layout.header)
            return 0
        self._seen_packet = True
        self._count(layout.length, count)
        lost = self._losses.add_valid(layout.header, layout.length, count)
        if layout.converter is not None:
            packets = layout.decode(data, begin, count)
            block, valid = layout.converter.convert(partial(layout.quantity, packets), count)
            self._emit(layout.header, block, valid, lost)
        else:
            self.leave_out("other_message", count)
        return layout.length * count

    def _sentence(self, data: bytes, begin: int) -> int | None:
        """Return the same as `_packet`, for sentences."""
        match = ascii.SENTENCE.match(data, begin, begin + ascii.MAX_SENTENCE_BYTES)
        if match is None:
            if ascii.is_prefix(data, begin):
                return None
            # five letters of a sentence, or other bytes, which name no stream and count for none
            self._losses.add_damaged(data[begin + 1 : begin + 6])
            return 0
        body, check = match.groups()
        if not ascii.intact(body, check):
            self._count_damaged()
            self._losses.add_damaged(body[:5])
            return 0
        size = match.end() - begin
        if body[:5] in ascii.MEASUREMENT_HEADERS:
            return self._measurements(data, begin, body, size, len(check))
        items = self._parse_response(body)
        if items is None:
            return 0
        self._items += items
        self._losses.end_gap()
        self._count(size)
        self.leave_out("other_message")
        return size

    @staticmethod
    def _parse_response(body: bytes) -> list[DecodedItem] | None:
        """Return the items of a sentence that is not a measurement; None if its grammar is wrong."""
        if ascii.PRINTABLE.fullmatch(body) is None:
            return None
        command, fields = ascii.split(body)
        if command == "VNERR":
            error = ascii.parse_error(fields)
            return None if error is None else [error]
        return [] if command in ascii.OTHER_PRODUCTS else [Response(command, fields)]

    def _measurements(self, data: bytes, begin: int, body: bytes, size: int, check: int) -> int:
        """Return the bytes of the valid sentences of one format from here; 0: the grammar is wrong."""
        name = body[:5]
        sentence_format = ascii.sentence_format(body)
        if sentence_format is None:
            self._losses.add_damaged(name)
            return 0
        limit = min((len(data) - begin) // size, _MAX_RUN)
        count = sentence_format.count_valid(data, begin, check, size - len(body) - check - 2, limit)
        self._count(size, count)
        lost = self._losses.add_valid(name, size, count)
        converter = sentence_format.converter
        if converter is not None:
            values = sentence_format.read(data, begin, size, count)
            block, valid = converter.convert(partial(sentence_format.quantity, values), count)
            self._emit(name, block, valid, lost)
        else:
            self.leave_out("other_message", count)
        return size * count

    def _emit(self, name: bytes, block: SampleBlock, valid: Bools | None, lost: int) -> None:
        """Add the valid samples of a block; invalid ones count as lost."""
        if valid is not None:
            total, rows = len(block), np.flatnonzero(valid)
            self.leave_out("not_finite", total - len(rows))
            if len(rows) == 0:
                self._losses.add_lost(name, lost + total)
                return
            # what follows the last valid row is lost before the next block
            self._losses.add_lost(name, total - 1 - int(rows[-1]))
            block = replace(selected(block, valid), lost=np.diff(rows, prepend=-1) - 1)
        block.lost[0] += lost
        if name not in self._started_streams:  # messages before the first sample are no part of the record
            self._started_streams.add(name)
            block.lost[0] = 0
        self._items.append(block)
