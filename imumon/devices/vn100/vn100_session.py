"""Session with a VN-100: know it, have it stream what noise needs, look after it, leave it as it was.

The port and the clock are handed in; this file opens nothing and waits for nothing but `Port.read`. Rules:

- What is changed of the sensor, `changes` alone changes and puts back; with `StreamRequest.listen_only` nothing
  is written at all.
- `tick` repairs what can be repaired in place: a paused sensor, a restarted one, another baud, a bad
  read. A port that vanishes is its owner's affair: the exception of `Port` goes through.

Life of a session: `connect`, `remember` (keep its answer on disk), `configure`; then `read`, `decode` and
`tick` for as long as it goes; `restore`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from imumon.devices.vn100.ascii import SensorError
from imumon.devices.vn100.commands import (
    BAUDS,
    CommandChannel,
    NotAVn100,
    Port,
    SensorChanged,
    SessionError,
)
from imumon.devices.vn100.configuration import Configuration
from imumon.devices.vn100.decoder import DecodedItem, Vn100Decoder
from imumon.devices.vn100.device_info import Vn100Info, describe, nominal_rate
from imumon.devices.vn100.rate_check import RateCheck
from imumon.devices.vn100.registers import BAUD, CHANGE_THE_DATA, LOOP_RATE, OUTPUT_TYPE
from imumon.samples import Kind, SampleBlock, Stream

__all__ = [
    "NotAVn100",
    "Notice",
    "Port",
    "SensorChanged",
    "SessionError",
    "StreamRequest",
    "Vn100Info",
    "Vn100Session",
]

QUIET_S = 1.0
PATIENT_S = 3.0  # with a stream whose rate is not known
RETRY_S = 5.0
BACK_NS = 1_000_000_000  # a clock that goes back so far began anew
RUBBISH = 64  # bytes; fewer may be the rest of a message
ERROR_S = 60.0  # between two notices of one error of the sensor, which may come a hundred times a second

_BEST: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """What the user asks for.

    Attributes
    ----------
    stream : kind of samples to ask the sensor for.
    listen_only : write nothing.
    baud : bit/s; None: find it.
    set_baud : change the sensor's baud to this; None: never.
    rate_hz : rate of a stream without a clock whose sensor cannot be asked.
    """

    stream: Kind = "deltas"
    listen_only: bool = False
    baud: int | None = None
    set_baud: int | None = None
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Notice:
    """Something worth telling: `kind` is one word, `text` one line for people."""

    kind: str
    text: str


class Vn100Session:
    """One sensor on one port.

    Parameters
    ----------
    port : open port.
    wanted : what the user asks for.
    clock : seconds, monotonic.
    decoder : that of an earlier session with this sensor, so that its counters go on.
    serial : serial number that the sensor must have; None: any.
    progress : told in a few words what is being tried, a few times a second at most.
    paced : samples come at their rate; else the far end is an emulator in time-lapse, which waits for its
        reader.

    Attributes
    ----------
    decoder : decodes the stream; its counters are the record's. Scanning and asking use others.
    """

    def __init__(
        self,
        port: Port,
        wanted: StreamRequest,
        clock: Callable[[], float],
        *,
        decoder: Vn100Decoder | None = None,
        serial: str | None = None,
        progress: Callable[[str], None] = lambda text: None,
        paced: bool = True,
    ) -> None:
        self.decoder = Vn100Decoder() if decoder is None else decoder
        self._port, self._wanted, self._clock, self._progress = port, wanted, clock, progress
        self._dialogue = CommandChannel(port, clock, wanted.listen_only, progress)
        self._changes = Configuration(self._dialogue, wanted.stream, wanted.set_baud, clock)
        self._serial = serial
        self._identity: dict[int, str] = {}
        self._divisor: int | None = None  # of our own stream, None when the sensor sends another
        self._streams: dict[Kind, Stream] = {}
        self._notices: list[Notice] = []
        self._arrival = RateCheck()
        self._paced = paced
        self._ahead = b""
        self._rubbish, self._silences = 0, 0
        self._newest_ns, self._restarted = 0, False  # of our stream's own clock
        self._troubles: set[str] = set()
        self._errors: dict[int, tuple[float, int]] = {}  # by code: when told again, how many were not
        self._watch_from(clock())

    # ------------------------------------------------------------------ the way in and out

    def connect(self) -> Vn100Info:
        """Find the sensor's baud, know it and read its settings.

        Raises
        ------
        NotAVn100 : nothing answers like one; the text says what was seen.
        SensorChanged : another serial number than `serial`.
        """
        self._dialogue.find(self._bauds())
        if not self._wanted.listen_only:
            self._know()
        self._watch_from(self._clock())
        return self.facts()

    def remember(self, saved: Mapping[str, str] | None = None) -> dict[str, str]:
        """Settings to put back at the end. Keep the answer on disk until `restore` has succeeded.

        Parameters
        ----------
        saved : the answer of an earlier process that ended without `restore`, None when there was none.
        """
        return {} if self._wanted.listen_only else self._changes.remember(saved)

    def configure(self) -> Vn100Info:
        """Have the sensor stream what is wanted; in vain, take what it sends and say so.

        Raises
        ------
        SessionError : it does not answer any more.
        """
        self._streams.clear()
        self._divisor = None
        if not self._wanted.listen_only:
            self._progress("setting up the stream")
            flow = self._changes.make()
            if flow is not None:
                self._streams[flow.stream.kind] = flow.stream
                self._divisor, self._ahead = flow.divisor, flow.ahead
        self._watch_from(self._clock())
        return self.facts()

    def restore(self) -> bool:
        """Put the settings back as they were found; True when the sensor has confirmed each.

        It may be called at any moment, also after `configure` was interrupted.
        """
        return self._changes.undo()

    # ------------------------------------------------------------------ while it streams

    def read(self, timeout: float) -> bytes:
        """Bytes of the stream; waits up to `timeout` seconds for the first."""
        if self._ahead:
            data, self._ahead = self._ahead, b""
            return data
        return self._port.read(timeout)

    def decode(self, data: bytes) -> list[DecodedItem]:
        """Items in bytes that `read` gave."""
        valid = self.decoder.messages
        items = self.decoder.feed(data)
        now = self._clock()
        if data:
            self._bytes_at = now
            self._rubbish += len(data)
        if self.decoder.messages > valid:
            self._valid_at, self._rubbish = now, 0
        for item in items:
            if isinstance(item, SampleBlock):
                self._streams[item.stream.kind] = item.stream
                if self._divisor is None or item.stream.kind == self._wanted.stream:
                    self._sampled(now)
                self._compare(item, now)
                self._follow(item)
            elif isinstance(item, SensorError):
                self._complain(item, now)
        return items

    def tick(self) -> list[Notice]:
        """Look after the sensor; call it a few times a second. What happened, for people.

        May take as long as `connect` and `configure` when the sensor must be found again.

        Raises
        ------
        SensorChanged : another serial number answers.
        """
        now = self._clock()
        if now >= self._patience:
            self._look_after(now)
        notices, self._notices = self._notices, []
        return notices

    def facts(self) -> Vn100Info:
        """What is known of the sensor and its stream by now."""
        facts = describe(
            self._port.name,
            self._port.baud,
            self._identity,
            self._dialogue.settings,
            self._best(),
            LOOP_RATE / self._divisor if self._divisor is not None else self._wanted.rate_hz,
            tuple(self._changes.remarks),
        )
        remark = facts.sample_rate_hz and self._arrival.remark(facts.sample_rate_hz)
        return replace(facts, remarks=(*facts.remarks, remark)) if remark else facts

    def _best(self) -> Stream | None:
        """The stream that is characterised, None before its first sample."""
        return next((self._streams[kind] for kind in _BEST if kind in self._streams), None)

    def _compare(self, block: SampleBlock, now: float) -> None:
        """Hold the rate that was told against the clock, where nothing else would notice a wrong one."""
        if not self._paced or block.stream != self._best():
            return
        if self._wanted.listen_only or block.stream.clock == "none":
            settings = self._dialogue.settings
            told = nominal_rate(settings, block.stream) or self._wanted.rate_hz
            if told:
                self._arrival.take(len(block) + int(block.lost.sum()), now, told)

    def _follow(self, block: SampleBlock) -> None:
        """See in the clock of our stream that the sensor was restarted, if the same comes from its flash."""
        if block.stream.clock == "startup" and block.time_ns is not None and len(block):
            self._restarted |= int(block.time_ns[0]) < self._newest_ns - BACK_NS
            self._newest_ns = int(block.time_ns[-1])

    # ------------------------------------------------------------------ knowing it

    def _bauds(self) -> list[int]:
        """Bauds to try, in this order."""
        if self._port.fixed_baud:
            return [self._port.baud]
        if self._wanted.baud is not None:
            return list(dict.fromkeys((self._wanted.baud, self._wanted.set_baud or self._wanted.baud)))
        return list(dict.fromkeys((self._port.baud, *BAUDS)))

    def _know(self) -> None:
        """Read identity and settings."""
        self._progress("reading the sensor's settings")
        settings = self._dialogue.settings
        self._identity.clear()
        settings.clear()
        # the output type early: a sensor may be set to switch its output off at the first error
        for register in dict.fromkeys((1, 3, 4, OUTPUT_TYPE, *CHANGE_THE_DATA)):
            text = self._dialogue.read(register)
            if text is None and register == 1:
                raise NotAVn100(
                    f"{self._port.name} sends valid messages but does not answer: connect the wire to the "
                    "sensor's receiver, or use --listen-only"
                )
            if text is not None:
                (self._identity if register < BAUD else settings)[register] = text
        serial = self._identity.get(3)
        if self._serial is not None and serial is not None and serial != self._serial:
            raise SensorChanged(f"the sensor on {self._port.name} is {serial}, not {self._serial}")
        self._serial = serial or self._serial

    # ------------------------------------------------------------------ looking after it

    def _watch_from(self, now: float) -> None:
        self._arrival.begin()
        self._bytes_at = self._valid_at = self._sample_at = self._patience = now
        self._rubbish, self._silences = 0, 0
        self._newest_ns, self._restarted = 0, False

    def _sampled(self, now: float) -> None:
        """A sample of the stream has come: all is well."""
        if self._troubles or self._silences:
            silent = now - self._sample_at
            self._notices.append(Notice("resumed", f"samples come again, after {silent:.1f} s"))
            self._arrival.begin()
        self._sample_at, self._silences = now, 0
        self._troubles.clear()

    def _look_after(self, now: float) -> None:
        """What is wrong, if anything, and the cure for it."""
        quiet = PATIENT_S if self._divisor is None else max(QUIET_S, 4 * self._divisor / LOOP_RATE)
        if self._restarted and self._divisor is not None:
            self._again("reconfigured", "the sensor was restarted, and is set up again")
        elif now - self._bytes_at > quiet:
            self._break_silence(now)
        elif now - self._valid_at > quiet and self._rubbish >= RUBBISH:
            if "garbage" in self._troubles:
                self._again("found", "the sensor is found again")
            else:
                self._report("garbage", "bytes come, but nothing valid: the port is opened anew")
                self._port.reopen()
                self._bytes_at = self._valid_at = self._clock()
                self._rubbish = 0
        elif now - self._sample_at > quiet and self._divisor is not None:
            self._again("reconfigured", "the sensor had gone back to its own settings: was it restarted?")
        elif now - self._sample_at > 2 * quiet:
            self._report("no_samples", "valid messages come, but none that can be characterised")

    def _break_silence(self, now: float) -> None:
        """Wake a sensor that was paused; in vain, look for it at other bauds now and then."""
        self._silences += 1
        self._patience = now + QUIET_S
        if self._silences > 2:
            self._report("silent", "nothing comes from the sensor: has it power, and is the cable in?")
        if self._wanted.listen_only:
            return
        if self._silences % 8:
            self._dialogue.wake()
        else:
            self._again("found", "the sensor is back")

    def _complain(self, error: SensorError, now: float) -> None:
        """Tell an error of the sensor; one that goes on, once a minute."""
        due, untold = self._errors.get(error.code, (now, 0))
        if now < due:
            self._errors[error.code] = due, untold + 1
            return
        before = f" ({untold} times more since that was told last)" if untold else ""
        self._notices.append(Notice("sensor_error", f"the sensor says: {error.text}{before}"))
        self._errors[error.code] = now + ERROR_S, 0

    def _again(self, kind: str, text: str) -> None:
        """Connect and configure once more; in vain, let a later tick try."""
        self.decoder.finish()
        self._ahead = b""
        before = self._silences, self._restarted
        try:
            self.connect()
            self.remember()
            self.configure()
        except SensorChanged:
            raise
        except SessionError as error:
            self._silences, self._restarted = before  # a scan that found nothing has changed nothing
            self._report("lost", str(error))
            self._patience = self._clock() + RETRY_S
        else:
            self._notices.append(Notice(kind, text))
            self._troubles.clear()

    def _report(self, kind: str, text: str) -> None:
        """Say a trouble once, until samples come again."""
        if kind not in self._troubles:
            self._notices.append(Notice(kind, text))
            self._troubles.add(kind)
