"""Replayed record: the record of one recording, and the report of what has been read of it.

Whoever reads the recording feeds the record, block by block; the report joins what the record knows of the samples to
what the recording and its user say: identity, filter, remarks, and why reading ended early.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from imumon.api.replay_options import ReplayOptions
from imumon.model import report
from imumon.model.cures import option, option_text
from imumon.model.ledger import merged
from imumon.model.report import DeviceDescription, Event, Report
from imumon.model.report_json import MAX_ITEMS, plain
from imumon.model.samples import ALIASED, Gap
from imumon.record import Record
from imumon.sources import registry
from imumon.sources.device import DeviceDriver
from imumon.sources.files import Recording

if TYPE_CHECKING:  # arrays need no bus
    from imumon.bus import Publisher


class ReplayedRecord:
    """Record of one recording; events wait until they are published.

    Parameters
    ----------
    options : how to replay it.
    recording : says what is known of its samples so far.

    Attributes
    ----------
    record : gets the samples.
    device : as the header of the recording describes it.
    started : date of the first sample by the header.
    earlier_ledger : of what a restored state had received before.
    """

    def __init__(self, options: ReplayOptions, recording: Recording) -> None:
        header = recording.header or {}
        self.recording = recording
        self.record = Record(options.record, rate_hz=options.read.rate_hz or header.get("rate_hz"))
        serial, scheme = header.get("serial"), header.get("driver", registry.DEFAULT_SCHEME)
        id = header.get("id") or (f"{scheme}-{serial}" if serial else "replay")
        settings = header.get("settings", {})
        driver = registry.installed(header.get("driver"))
        self.device = report.DeviceDescription(
            id=id,
            driver=driver.scheme if driver is not None else header.get("driver", recording.driver),
            setting_texts=registry.setting_texts(driver, settings),
            topic=recording.topic,
            model=header.get("model"),
            serial=serial,
            firmware=header.get("firmware"),
            port=options.path or None,
            alias_factor=header.get("alias_factor"),
            settings=settings,
        )
        self.started = header.get("time")
        self._driver, self._filter = driver or _driver_of(recording), options.filter
        self.earlier_ledger: Mapping[str, int] = {}
        self._events: list[Event] = []  # not published yet
        self._record_events: list[Event] = []  # the first ones of the record
        self._unlisted = 0  # events of the record after these
        self._restarts: Counter[str] = Counter()  # breaks of the record by code
        self._restart_texts: dict[str, str] = {}  # the last one by code

    def gap(self, gap: Gap) -> None:
        """Note that the recording was interrupted, as the daemon does."""
        if gap.length_s is not None:
            self.record.flush()
        self.record.gap(gap.length_s)

    def left_out(self) -> dict[str, int]:
        """Return what was received and what became of all of it that is no sample of the record."""
        return merged(self.recording.ledger, self.record.left_out(), self.earlier_ledger)

    @property
    def elapsed_s(self) -> float:
        """Length of the recording so far, s."""
        rate = self.record.sample_rate_hz
        return self.record.samples / rate if rate else 0.0

    def publish(self, bus: Publisher, state: report.State) -> None:
        """Publish a report and the events since the last one; their time and name are those of the replay."""
        current = self.report(state)
        bus.publish(replace(current, device=replace(current.device, id=bus.id)))
        for event in self._events:
            bus.event(replace(event, device=bus.id))
        self._events.clear()

    def _caveats(self, device: report.DeviceDescription) -> tuple[str, ...]:
        """Return the caveats of the stream and of the recording, each once."""
        stream = self.record.stream
        stream_caveats = stream.caveats if stream is not None else ()
        # those that the daemon noted come first: it could ask the device
        noted = (self.recording.header or {}).get("caveats", stream_caveats)
        truncated = () if self.recording.problem is None else ("truncated",)
        compensated = (caveat for caveat in stream_caveats if caveat == "compensated")
        aliased = ("aliased",) if device is not self.device and (device.alias_factor or 1.0) > ALIASED else ()
        return tuple(dict.fromkeys((*noted, *compensated, *aliased, *self.recording.caveats, *truncated)))

    def _remarks(self, current: report.Report) -> list[str]:
        """Return what the recording leaves open, and why the record began again."""
        remarks = list(self.recording.remarks)
        breaks = [
            f"{self._restart_texts[code]}{f' (the last of {n:,} such events)' if n > 1 else ''}"
            for code, n in self._restarts.items()
        ]
        return [*remarks, *self._without_time(), *breaks]

    def report(self, state: report.State) -> report.Report:
        """Return a report of what has been read so far."""
        session = report.SessionCounters(
            started=self.started or self.recording.started,
            discarded_bytes=self.recording.discarded,
            bad_checksums=self.recording.bad_checksums,
            received_bytes=self.recording.fed,
            ledger=self.left_out(),
        )
        device, remark = self._filtered()
        now = datetime.now(UTC)
        current = self.record.report(now, device, state, session, device_caveats=self._caveats(device))
        for event in self.record.events():
            self._note(event.stamped(now, self.device.id))
            if event.kind == "restart":
                self._restarts[event.code] += 1
                self._restart_texts[event.code] = event.text
        remarks = tuple(map(plain, (*current.device.remarks, *self._remarks(current), *remark)))
        columns = report.RecordingDescription(columns=tuple(self.recording.columns))
        recording = columns if columns.columns else None
        return replace(current, device=replace(current.device, remarks=remarks), recording=recording)

    def _without_time(self) -> tuple[str, ...]:
        """Return a remark on the samples whose clock stood still; none: there are no such samples."""
        count = self.record.left_out().get("repeated", 0)
        if not count:
            return ()
        samples = "1 sample has" if count == 1 else f"{count:,} samples have"
        fault = "the time of the sample before, as of a clock that stops"
        return (f"{samples} {fault}: left out, because their place is not known",)

    def final(self) -> Report:
        """Return the report of a recording that has ended, with its events.

        Raises
        ------
        ImumonError : it has no samples.
        """
        self.record.flush()
        final = replace(self.report("stopped"), events=self.record_events())
        if not final.session.samples:
            raise self.recording.no_samples()
        return final

    def _filtered(self) -> tuple[DeviceDescription, tuple[str, ...]]:
        """Return the device with the filter that the user names, and why that is not used."""
        stream, rate = self.record.stream, self.record.sample_rate_hz
        if self._filter is None or stream is None or rate is None:
            return self.device, ()
        if stream.kind == "deltas":
            return self.device, (f"deltas are true averages: {option('filter')} is not used",)
        if self.device.alias_factor is not None:
            return self.device, (f"it names the filter of the sensor: {option('filter')} is not used",)
        factor = self._filter.alias_factor(self._driver, rate)
        given, assumed = (
            f"{self._filter.text}, as given with {option('filter')}",
            self._filter.assumption(self._driver),
        )
        settings = {**self.device.settings, "filter": f"{given}; {assumed}" if assumed else given}
        advice = "give window and rate, such as 8@1000; 1@1000 averages nothing"
        remark = f"{option_text(filter=self._filter.text)}: {assumed}; {advice}"
        return replace(self.device, alias_factor=factor, settings=settings), (remark,) if assumed else ()

    def _note(self, event: Event) -> None:
        self._events.append(event)
        if len(self._record_events) < MAX_ITEMS:
            self._record_events.append(event)
        else:
            self._unlisted += 1

    def record_events(self) -> tuple[Event, ...]:
        """Return the events of the record in the order of their time; the last one counts those left out."""
        events = sorted(self._record_events, key=lambda event: event.elapsed_s or 0.0)
        if self._unlisted:
            text = f"{self._unlisted + 1:,} later events are not listed"
            events[-1] = replace(events[-1], kind="remark", text=text, channel=None, length_s=None, size=None)
        return tuple(events)


def _driver_of(recording: Recording) -> DeviceDriver | None:
    """Return the driver whose format a recording without a header has; None for a table."""
    return registry.driver(recording.driver) if recording.driver is not None else None
