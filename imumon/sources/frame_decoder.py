"""Frame decoder: what decoders of messages with a frame share, whatever is in the messages."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import ClassVar, Generic, TypeVar

from imumon.model.ledger import Ledger
from imumon.model.samples import SampleBlock, concatenated
from imumon.sources.device import sample_blocks

Other = TypeVar("Other")
"""Type of the items of a decoder that are no samples."""


class FrameDecoder(ABC, Generic[Other]):
    """A `RawDecoder` of framed messages. Its rules do not depend on the chunks.

    - A message begins at `start`; every other byte between messages is discarded.
    - Bytes that may become a message are kept until more bytes decide. If they cannot become one, or if the checksum is
      wrong, **one** byte is discarded and the search continues after it: what begins a message also occurs in one, and
      a damaged message must not take its neighbour with it.
    - Consecutive blocks of one stream are one block.
    - A message is a sample, or `leave_out` says why it is none. One that fails its check is received, too.

    Attributes
    ----------
    start : pattern of the first byte of a message.
    """

    start: ClassVar[re.Pattern[bytes]]

    def __init__(self) -> None:
        self.fed = self.messages = self.message_bytes = self.discarded = self.bad_checksums = 0
        self._ledger = Ledger()
        self._buffer = b""
        self._items: list[SampleBlock | Other] = []

    @property
    def pending(self) -> int:
        """Bytes kept until more bytes decide whether they are a message."""
        return len(self._buffer)

    @property
    def ledger(self) -> dict[str, int]:
        """What became of all messages but those that are samples, by reason."""
        return self._ledger.counts()

    def feed(self, data: bytes) -> list[SampleBlock | Other]:
        """Return the items that `data` completes, in the order of their last bytes."""
        self.fed += len(data)
        # the buffer holds one unfinished message at most, so what is scanned twice is bounded
        return self._scan(self._buffer + data, final=False)

    def finish(self) -> list[SampleBlock | Other]:
        """Return the items in the pending bytes, at the end of the stream."""
        return self._scan(self._buffer, final=True)

    @abstractmethod
    def _read(self, data: bytes, begin: int) -> int | None:
        """Add the items of the valid messages from `data[begin]` on to `_items`, and count them.

        Returns
        -------
        Bytes of these messages; 0: no message begins there, None: more bytes are needed.
        """

    def _count(self, size: int, count: int = 1) -> None:
        """Count valid messages of `size` bytes."""
        self.messages += count
        self.message_bytes += size * count
        self._ledger.receive(count)

    def _count_damaged(self) -> None:
        """Count a message that fails its check."""
        self.bad_checksums += 1
        self._ledger.receive()
        self.leave_out("damaged")

    def leave_out(self, reason: str, count: int = 1) -> None:
        """Count messages that are no samples."""
        self._ledger.add(reason, count)

    def _discard(self, data: bytes) -> None:
        self.discarded += len(data)

    def _scan(self, data: bytes, *, final: bool) -> list[SampleBlock | Other]:
        """Return the items of the messages in `data`; keep the bytes of an unfinished one unless `final`."""
        begin, end = 0, len(data)
        while begin < end:
            match = self.start.search(data, begin)
            first = match.start() if match else end
            self._discard(data[begin:first])
            begin = first
            if begin == end:
                break
            size = self._read(data, begin)
            if size is None and not final:
                break
            # At the end, what needs more bytes is no message, but its bytes may hide a shorter one. Only one byte
            # is discarded: a damaged length would otherwise take the intact messages behind it.
            if not size:
                self._discard(data[begin : begin + 1])
            begin += size or 1
        self._buffer = data[begin:]
        items, self._items = self._items, []
        return list(_merged(items))


def _merged(items: Sequence[SampleBlock | Other]) -> Iterator[SampleBlock | Other]:
    """Yield items with consecutive blocks of one stream merged."""
    # only neighbours: a reply between two blocks must stay between them
    for _, group in groupby(items, key=lambda item: getattr(item, "stream", None)):
        members = list(group)
        blocks = sample_blocks(members)
        yield from [concatenated(blocks)] if blocks else members
