"""Texts: the JSON of reports that follow one another, each part written when it is another one.

A report is 60 kB, of which most, curves and spectra, is the same from one to the next until it is worked out
anew. Parts of channels are frozen, so one that is still the same object has the same text.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from itertools import groupby

from imumon.report import Channel, Report, to_json

BULKY = ("allan", "histogram", "spectrum")
"""Parts of a channel that its own key leaves out; the report has them."""
CHANNEL, REPORT = (tuple(field.name for field in fields(kind)) for kind in (Channel, Report))


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
        named = {"", *report.channels}
        self._kept = {key: kept for key, kept in self._kept.items() if key[0] in named}
        channels = {name: self._members(name, channel) for name, channel in report.channels.items()}
        self.channels = {
            name: _object(text for field, text in members if field not in BULKY)
            for name, members in channels.items()
        }
        whole = _object(
            f"{to_json(name)}:{_object(text for _, text in members)}" for name, members in channels.items()
        )
        self.report = _object(
            f'"channels":{whole}' if field == "channels" else self._member("", field, getattr(report, field))
            for field in REPORT
        )

    def _members(self, name: str, channel: Channel) -> list[tuple[str, str]]:
        """Texts of a channel's members by field; numbers that lie side by side are new each time, and written
        in one."""
        members = []
        values = ((field, getattr(channel, field)) for field in CHANNEL)
        for numbers, run in groupby(values, key=lambda each: isinstance(each[1], float | int)):
            if numbers:
                members.append(("", to_json(dict(run))[1:-1]))
            else:
                members += [(field, self._member(name, field, value)) for field, value in run]
        return members

    def _member(self, name: str, field: str, value: object) -> str:
        """Text of a member that most often is the same object as the time before, of the report itself where
        there is no `name`."""
        kept = self._kept.get((name, field))
        if kept is None or kept[0] is not value:
            kept = self._kept[name, field] = value, f'"{field}":{to_json(value)}'
        return kept[1]


def _object(members: Iterable[str]) -> str:
    """A JSON object of members whose texts are known."""
    return "{" + ",".join(members) + "}"
