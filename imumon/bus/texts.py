"""Texts: the JSON of reports that follow one another, each part written when it is another one.

A report is 60 kB, of which most, curves and spectra, is the same from one to the next until it is worked out
anew. Parts of channels are frozen, so one that is still the same object has the same text.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass

from imumon.report import Channel, Report, to_json

BULKY = ("allan", "histogram", "spectrum")
"""Parts of a channel that its own key leaves out; the report has them."""


class Texts:
    """JSON of the newest report.

    Attributes
    ----------
    report : as `to_json` gives it.
    channels : of each channel without its bulky parts.
    """

    def __init__(self) -> None:
        self.report = ""
        self.channels: dict[str, str] = {}
        self._kept: dict[tuple[str, str], tuple[object, str]] = {}

    def write(self, report: Report) -> None:
        """Take the texts of a report."""
        channels = {name: self._parts(name, channel) for name, channel in report.channels.items()}
        self._kept = {key: kept for key, kept in self._kept.items() if key[0] in channels}
        whole = _object((name, _object(parts)) for name, parts in channels.items())
        self.channels = {
            name: _object(part for part in parts if part[0] not in BULKY) for name, parts in channels.items()
        }
        self.report = _object(
            (field.name, whole if field.name == "channels" else to_json(getattr(report, field.name)))
            for field in fields(report)
        )

    def _parts(self, name: str, channel: Channel) -> list[tuple[str, str]]:
        """Texts of a channel's fields; a new one is kept where it has fields of its own."""
        parts = []
        for field in fields(channel):
            value = getattr(channel, field.name)
            part, text = self._kept.get((name, field.name), (None, ""))
            if part is None or part is not value:
                text = to_json(value)
                if is_dataclass(value):
                    self._kept[name, field.name] = value, text
            parts.append((field.name, text))
        return parts


def _object(parts: Iterable[tuple[str, str]]) -> str:
    """A JSON object of members whose texts are known."""
    return "{" + ",".join(f"{to_json(name)}:{text}" for name, text in parts) + "}"
