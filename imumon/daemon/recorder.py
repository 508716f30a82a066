"""Tape: the raw bytes of the sensor, kept on disk from the first one on, if that is wanted.

A recording says in its header what is recorded, and that is known only when the first samples are there: what
came before waits. A disk that is full ends the recording, not the daemon; that is told once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imumon.config import RecordSettings
from imumon.recordings import CaptureWriter, SourceError, check_place

EARLY_BYTES = 1 << 20
"""Bytes after which a recording begins even though nothing of the stream is known yet."""


class Recorder:
    """What is recorded of one sensor.

    Parameters
    ----------
    wanted : the settings; nothing is kept where they name no file.

    Attributes
    ----------
    waits : there is something to keep, and no header for it yet.
    """

    def __init__(self, wanted: RecordSettings) -> None:
        self._wanted = wanted
        self._early = bytearray()
        self._recorder: CaptureWriter | None = None
        self._ending: list[CaptureWriter] = []  # of earlier records, which may still write what waited
        self._complaints: list[str] = []
        self.waits = bool(wanted.file)

    def check(self) -> None:
        """Look whether anything can be recorded there, before there is something to record.

        Raises
        ------
        SourceError : it is plainly the wrong place.
        """
        if self.waits:
            check_place(self._wanted.file)

    @property
    def full(self) -> bool:
        """Whether so much waits that it must be written whatever is known."""
        return len(self._early) >= EARLY_BYTES

    def take(self, data: bytes) -> None:
        """Keep bytes; returns at once."""
        if self._recorder is not None:
            self._recorder.write(data)
        elif self.waits:
            self._early += data

    def begin(self, header: Mapping[str, Any]) -> None:
        """What is recorded is known: write it, and what has waited for it."""
        early, self._early, self.waits = bytes(self._early), bytearray(), False
        rotate = int(self._wanted.rotate_mb * 1e6)
        try:
            self._recorder = CaptureWriter(
                self._wanted.file, header, rotate_bytes=rotate, compress=self._wanted.gzip
            )
        except SourceError as error:
            self._complaints.append(str(error))
            return
        self._recorder.write(early)

    def lost(self, away_s: float | None) -> None:
        """Note that the link was lost, so that a replay has the same gap."""
        if self._recorder is not None:
            self._recorder.lost(away_s)

    def begin_anew(self) -> None:
        """What comes now belongs to another record: it goes to a recording of its own, if one goes on."""
        if self._recorder is not None and self._recorder.stopped is None:
            self._recorder.end()
            self._ending.append(self._recorder)
            self._recorder, self.waits = None, True

    def complaints(self) -> list[str]:
        """Why something is not recorded, each once."""
        if self._recorder is not None and self._recorder.stopped is not None:
            self._complaints.append(self._recorder.stopped)
            self._recorder = None
        for old in tuple(self._ending):
            ended = old.ended  # asked first: it may stop meanwhile
            if old.stopped is not None:
                self._complaints.append(old.stopped)
            if ended or old.stopped is not None:
                self._ending.remove(old)
        said, self._complaints = self._complaints, []
        return said

    def close(self, wait_s: float = 10.0) -> None:
        """Write what waits, that of earlier records too, and wait so long for each."""
        for recorder in (*self._ending, self._recorder):
            if recorder is not None:
                recorder.close(wait_s)
