"""Recorder: writes the raw bytes of the device to disk, from the first one on, if the settings name a file.

The header of a recording says what is recorded, and that is known only when the first samples are there: bytes
before that wait in memory. A full disk ends the recording, not the daemon.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from imumon.config import RecordingSettings
from imumon.model.errors import ImumonError

if TYPE_CHECKING:  # most daemons record nothing
    from imumon.sources.files import CaptureWriter

EARLY_BYTES = 1 << 20
"""Bytes after which a recording starts even if nothing of the stream is known yet."""


class Recorder:
    """Recording of one device.

    Parameters
    ----------
    settings : without a file name, nothing is recorded.

    Attributes
    ----------
    needs_header : there are bytes to record, and no header for them yet.
    failed : why a recording ended before its record; None: none did.
    """

    def __init__(self, settings: RecordingSettings) -> None:
        self._settings = settings
        self._early = bytearray()
        self._writer: CaptureWriter | None = None
        self._ending: list[CaptureWriter] = []  # of earlier records, which may still be writing
        self._problems: list[str] = []
        self.needs_header = bool(settings.file)
        self.failed: str | None = None

    def check_file(self) -> None:
        """Check that the file can be written, before there is anything to record.

        Raises
        ------
        RecordingError : it cannot.
        """
        if self.needs_header:
            from imumon.sources.files import check_place

            check_place(self._settings.file)

    @property
    def full(self) -> bool:
        """Whether the bytes in memory have to be written, whatever is known."""
        return len(self._early) >= EARLY_BYTES

    def write(self, data: bytes) -> None:
        """Record bytes; returns at once."""
        if self._writer is not None:
            self._writer.write(data)
        elif self.needs_header:
            self._early += data

    def start(self, header: Mapping[str, Any]) -> str | None:
        """Start the recording with its header, and write the bytes that waited for it.

        Returns
        -------
        Path of the file, None if there is a problem: an existing file is not overwritten.
        """
        from imumon.sources.files import CaptureWriter

        early, self._early, self.needs_header = bytes(self._early), bytearray(), False
        rotate = int(self._settings.rotate_mb * 1e6)
        try:
            self._writer = CaptureWriter(
                self._settings.file, header, rotate_bytes=rotate, compress=self._settings.gzip
            )
        except ImumonError as error:
            self._problems.append(str(error))
            return None
        self._writer.write(early)
        return self._writer.path

    def gap(self, length_s: float | None) -> None:
        """Note that the stream was interrupted, so that a replay has the same gap."""
        if self._writer is not None:
            self._writer.lost(length_s)

    def start_new_record(self) -> None:
        """Put what follows into a recording of its own: it belongs to another record."""
        if self._writer is not None and self._writer.stopped is None:
            self._writer.end()
            self._ending.append(self._writer)
            self._writer, self.needs_header = None, True

    def problems(self) -> list[str]:
        """Return why something is not recorded, each reason once."""
        if self._writer is not None and self._writer.stopped is not None:
            self._problems.append(self._writer.stopped)
            self._writer = None
        for old in tuple(self._ending):
            ended = old.ended  # first: it may stop meanwhile
            if old.stopped is not None:
                self._problems.append(old.stopped)
            if ended or old.stopped is not None:
                self._ending.remove(old)
        problems, self._problems = self._problems, []
        self.failed = problems[-1] if problems else self.failed
        return problems

    def close(self, wait_s: float = 10.0) -> None:
        """Write what waits, also of earlier records; wait at most `wait_s` for each."""
        for writer in (*self._ending, self._writer):
            if writer is not None:
                writer.close(wait_s)
                self.failed = writer.stopped or self.failed
