"""Frame decoder: what decoders of messages with a frame share, whatever is in the messages."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import ClassVar, Generic, TypeVar

from imumon.devices.base import sample_blocks
from imumon.samples import SampleBlock, concatenated

Other = TypeVar("Other")
"""Type of the items of a decoder that are no samples."""


class FrameDecoder(ABC, Generic[Other]):
    """A `RawDecoder` of framed messages. Its rules do not depend on the chunks.

    - A message begins at `start`; every other byte between messages is discarded.
    - Bytes that may become a message are kept until more bytes decide. If they cannot become one, or if the checksum is
      wrong, **one** byte is discarded and the search continues after it: what begins a message also occurs in one, and
      a damaged message must not take its neighbour with it.
    - Consecutive blocks of one stream are one block.

    Attributes
    ----------
    start : pattern of the first byte of a message.
    """

    start: ClassVar[re.Pattern[bytes]]

    def __init__(self) -> None:
        self.fed = self.messages = self.message_bytes = self.discarded = self.bad_checksums = 0
        self._buffer = b""
        self._items: list[SampleBlock | Other] = []

    @property
    def pending(self) -> int:
        """Bytes kept until more bytes decide whether they are a message."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[SampleBlock | Other]:
        """Return the items that `data` completes, in the order of their last bytes."""
        self.fed += len(data)
        return self._scan(self._buffer + data, final=False)

    def finish(self) -> list[SampleBlock | Other]:
        """Return the items in the pending bytes, at the end of the stream."""
        return self._scan(self._buffer, final=True)

    @abstractmethod
    def _read(self, data: bytes, at: int) -> int | None:
        """Add the items of the valid messages that begin at a place, and count them.

        Returns
        -------
        Their bytes; 0: no message begins there, None: more bytes are needed.
        """

    def _count(self, size: int, count: int = 1) -> None:
        """Count valid messages of `size` bytes."""
        self.messages += count
        self.message_bytes += size * count

    def _discard(self, data: bytes) -> None:
        self.discarded += len(data)

    def _scan(self, data: bytes, *, final: bool) -> list[SampleBlock | Other]:
        at, end = 0, len(data)
        while at < end:
            found = self.start.search(data, at)
            begin = found.start() if found else end
            self._discard(data[at:begin])
            at = begin
            if at == end:
                break
            size = self._read(data, at)
            if size is None and not final:
                break
            if not size:
                self._discard(data[at : at + 1])
            at += size or 1
        self._buffer = data[at:]
        items, self._items = self._items, []
        return list(_merged(items))


def _merged(items: Sequence[SampleBlock | Other]) -> Iterator[SampleBlock | Other]:
    """Yield items with consecutive blocks of one stream merged."""
    for _, group in groupby(items, key=lambda item: getattr(item, "stream", None)):
        members = list(group)
        blocks = sample_blocks(members)
        yield from [concatenated(blocks)] if blocks else members
