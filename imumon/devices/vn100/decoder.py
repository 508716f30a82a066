"""Decoder of what a VN-100 sends: bytes in any cuts in, samples and answers out.

The rules, which do not depend on how the bytes are cut:

- A message begins at ``$`` or at FA; every other byte in between is discarded.
- Where the bytes there are may yet become a message, they wait. Where they cannot, or where the check is
  wrong, **one** byte is discarded and the search goes on behind it: FA, ``$``, CR and LF all occur
  inside payloads, and a damaged message must not take its neighbour along.
- A message is valid when its frame, its check and its grammar are right. Then it is counted, all its
  bytes with it. Not every valid message is a sample: its numbers may not be finite.
- A binary packet whose CRC is wrong counts as a bad checksum only where the line has shown its header before,
  or none at all: in the payload of a damaged packet chance makes headers, too.

So: fed = message_bytes + discarded + pending. Runs of equal messages are decoded as one array, which
changes the speed alone. What was lost on the way is estimated by `Ledger`.
"""

from __future__ import annotations

import re
from functools import partial
from itertools import groupby
from typing import TypeAlias

import numpy as np

from imumon.devices.vn100 import ascii, binary
from imumon.devices.vn100.ascii import Response, SensorError
from imumon.devices.vn100.measurements import Batch, Recipe
from imumon.samples import Ints, SampleBlock, concatenated

_START = re.compile(rb"[$\xfa]")
_TEXT = bytes(range(0x20, 0x7F)) + b"\r\n\t"
_RUN = 8192
"""Most messages decoded as one array: what is read at once has about as many."""


DecodedItem: TypeAlias = SampleBlock | Response | SensorError


class Ledger:
    """Account of messages that were damaged on the line, by the name of their stream.

    A message that was recognised but came to no good counts for its own stream. Discarded bytes beyond those
    count one for each message length of the stream they look like: pure text is a stream of sentences', all
    else is a stream of packets', where the line has one; of several, the one with the most bytes.
    Text between packets on a line without sentences is nobody's. Nothing counts before a
    stream's first message.
    """

    def __init__(self) -> None:
        self._size: dict[bytes, int] = {}
        self._share: dict[bytes, int] = {}
        self._owed: dict[bytes, int] = {}
        self._gap = 0
        self._text = True

    def knows(self, name: bytes) -> bool:
        """Whether a valid message of this name has come."""
        return name in self._size

    def discarded(self, data: bytes) -> None:
        """These bytes belong to no message."""
        self._gap += len(data)
        self._text = self._text and not data.translate(None, _TEXT)

    def damaged(self, name: bytes) -> None:
        """A message of this name was recognised, but is not valid."""
        if name in self._size:
            self._owed[name] = self._owed.get(name, 0) + 1
            self._gap -= self._size[name]

    def owe(self, name: bytes, count: int) -> None:
        """So many messages of this name are to be counted with its next."""
        if count:
            self._owed[name] = self._owed.get(name, 0) + count

    def close(self) -> None:
        """A valid message ends the gap, if there is one."""
        if self._gap > 0:
            packets = [name for name in self._share if name[0] == binary.SYNC]
            sentences = [name for name in self._share if name[0] != binary.SYNC]
            candidates = sentences if self._text or not packets else packets
            if candidates:
                name = max(candidates, key=self._share.__getitem__)
                self.owe(name, round(self._gap / self._size[name]))
        self._gap = 0
        self._text = True

    def valid(self, name: bytes, size: int, count: int) -> int:
        """`count` valid messages of `size` bytes; answers how many were lost directly before."""
        self.close()
        self._size[name] = size
        self._share[name] = self._share.get(name, 0) + size * count
        return self._owed.pop(name, 0)


class Vn100Decoder:
    """Push bytes, get items; see `sensors.contract.Decoder`.

    Attributes
    ----------
    malformed : sentences whose check was right, but whose fields were not.
    nonfinite : valid messages that are no samples: a number not finite or beyond any that can be, an
        interval not positive.

    >>> decoder = Vn100Decoder()
    >>> decoder.feed(b"noise$VNRRG,07,40*5C\\r\\n$VNE"), decoder.pending
    ([Response(command='VNRRG', fields=('07', '40'))], 4)
    """

    def __init__(self) -> None:
        self.fed = 0
        self.messages = 0
        self.message_bytes = 0
        self.discarded = 0
        self.bad_checksums = 0
        self.malformed = 0
        self.nonfinite = 0
        self._rest = b""
        self._ledger = Ledger()
        self._sampled: set[bytes] = set()
        self._packets = False
        self._items: list[DecodedItem] = []

    @property
    def pending(self) -> int:
        """Bytes held back until more come."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[DecodedItem]:
        """Items completed by `data`, in the order they ended."""
        self.fed += len(data)
        return self._scan(self._rest + data, final=False)

    def finish(self) -> list[DecodedItem]:
        """Items among what is pending, now that nothing more will complete its beginning.

        What follows, if anything, is another connection: nothing is known of what was lost in between.
        """
        items = self._scan(self._rest, final=True)
        self._ledger = Ledger()
        self._sampled.clear()
        return items

    @np.errstate(all="ignore")  # what is not finite is taken out afterwards
    def _scan(self, data: bytes, final: bool) -> list[DecodedItem]:
        at, end = 0, len(data)
        while at < end:
            start = _START.search(data, at)
            begin = start.start() if start else end
            self._discard(data[at:begin])
            at = begin
            if at == end:
                break
            taken = self._packet(data, at) if data[at] == binary.SYNC else self._sentence(data, at)
            if taken is None:
                if not final:
                    break
                taken = 0
            if taken == 0:
                self._discard(data[at : at + 1])
                taken = 1
            at += taken
        self._rest = data[at:]
        items, self._items = self._items, []
        return _joined(items)

    def _discard(self, data: bytes) -> None:
        if data:
            self.discarded += len(data)
            self._ledger.discarded(data)

    def _packet(self, data: bytes, at: int) -> int | None:
        """Bytes of the valid packets that begin here; 0 for none, None when more bytes must tell."""
        try:
            layout = binary.layout(data, at)
        except binary.Incomplete:
            return None
        if layout is None:
            return 0
        room = (len(data) - at) // layout.length
        if room == 0:
            return None
        count = layout.count(data, at, min(room, _RUN))
        if count == 0:
            if self._ledger.knows(layout.header) or not self._packets:
                self.bad_checksums += 1
            self._ledger.damaged(layout.header)
            return 0
        self._packets = True
        self._count(layout.length, count)
        lost = self._ledger.valid(layout.header, layout.length, count)
        if layout.recipe is not None:
            packets = layout.decode(data, at, count)
            batch = layout.recipe.batch(partial(layout.quantity, packets), count)
            self._emit(layout.header, layout.recipe, batch, lost)
        return layout.length * count

    def _sentence(self, data: bytes, at: int) -> int | None:
        """As `_packet`, for sentences."""
        found = ascii.SENTENCE.match(data, at, at + ascii.LIMIT)
        if found is None:
            if ascii.begun(data, at):
                return None
            self._ledger.damaged(data[at + 1 : at + 6])
            return 0
        body, check = found.groups()
        if not ascii.intact(body, check):
            self.bad_checksums += 1
            self._ledger.damaged(body[:5])
            return 0
        size = found.end() - at
        if body[:5] in ascii.SAMPLED:
            return self._measurements(data, at, body, size, len(check))
        answer = self._answer(body)
        if answer is None:
            self.malformed += 1
            return 0
        self._items += answer
        self._ledger.close()
        self._count(size, 1)
        return size

    @staticmethod
    def _answer(body: bytes) -> list[DecodedItem] | None:
        """Response or error in a sentence that is no measurement, if any; None when its grammar is wrong."""
        if ascii.PRINTABLE.fullmatch(body) is None:
            return None
        command, fields = ascii.split(body)
        if command == "VNERR":
            error = ascii.error(fields)
            return None if error is None else [error]
        return [] if command in ascii.FOREIGN else [Response(command, fields)]

    def _measurements(self, data: bytes, at: int, body: bytes, size: int, check: int) -> int:
        """Bytes of the valid sentences of one shape that begin with this one; 0 when its grammar is wrong."""
        name = body[:5]
        shape = ascii.shape(body)
        if shape is None:
            self.malformed += 1
            self._ledger.damaged(name)
            return 0
        most = min((len(data) - at) // size, _RUN)
        count = shape.run(data, at, check, size - len(body) - check - 2, most)
        self._count(size, count)
        lost = self._ledger.valid(name, size, count)
        if shape.recipe is not None:
            values = shape.read(data, at, size, count)
            self._emit(name, shape.recipe, shape.recipe.batch(partial(shape.quantity, values), count), lost)
        return size * count

    def _count(self, size: int, count: int) -> None:
        self.messages += count
        self.message_bytes += size * count

    def _emit(self, name: bytes, recipe: Recipe, batch: Batch, lost: int) -> None:
        """Make a block of the usable samples of a batch; the others count as lost."""
        total = len(batch.values)
        before: Ints = np.zeros(total, np.int64)
        if batch.usable is not None:
            kept = np.flatnonzero(batch.usable)
            self.nonfinite += total - len(kept)
            if len(kept) == 0:
                self._ledger.owe(name, lost + total)
                return
            before = np.diff(kept, prepend=-1) - 1
            self._ledger.owe(name, total - 1 - int(kept[-1]))
            batch = batch.rows(kept)
        before[0] += lost
        if name not in self._sampled:
            self._sampled.add(name)
            before[0] = 0
        self._items.append(SampleBlock(recipe.stream, batch.values, batch.time_ns, before, batch.saturated))


def _joined(items: list[DecodedItem]) -> list[DecodedItem]:
    """Blocks of one stream that follow one another, made one."""
    joined: list[DecodedItem] = []
    for stream, group in groupby(items, key=lambda item: getattr(item, "stream", None)):
        if stream is None:
            joined += group
            continue
        blocks = [block for block in group if isinstance(block, SampleBlock)]
        joined.append(concatenated(blocks))
    return joined
