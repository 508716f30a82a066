"""Session with a VN-100: know it, have it stream what noise needs, look after it, leave it as it was.

The port and the clock are handed in; this file opens nothing and waits for nothing but `Port.read`. Rules:

- Nothing is ever written to flash, and the sensor is never reset. With `Wanted.listen_only` nothing
  is written at all.
- The ASCII output goes off before the binary one is set: the sensor refuses what does not fit its baud.
- `tick` repairs what can be repaired in place: a paused sensor, a restarted one, another baud, a bad
  read. A port that vanishes is its owner's affair: the exception of `Port` goes through.

Life of a session: `connect`, `remember` (keep its answer on disk), `configure`; then `read`, `decode` and
`tick` for as long as it goes; `restore`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from imumon.samples import Kind, SampleBlock, Stream
from imumon.sensors.contract import Item, Response, SensorError
from imumon.sensors.vn100.arrival import Arrival
from imumon.sensors.vn100.decoder import Decoder
from imumon.sensors.vn100.dialogue import BAUDS, Dialogue, NotAVn100, Port, SensorChanged, SessionError
from imumon.sensors.vn100.facts import Facts, describe, nominal_rate
from imumon.sensors.vn100.registers import (
    BAUD,
    BAUD_TOO_LOW,
    BINARY_OUTPUTS,
    CHANGE_THE_DATA,
    DELTA_CONTROL,
    IMU_FILTER,
    LOOP_RATE,
    OUTPUT_TYPE,
)
from imumon.sensors.vn100.settings import (
    OFF,
    UNCOMPENSATED_DELTAS,
    divisors,
    off_port,
    originals,
    output,
    parse_output,
    same,
    windowed,
)

__all__ = ["Facts", "NotAVn100", "Notice", "Port", "SensorChanged", "Session", "SessionError", "Wanted"]

FIRST_PACKET_S = 0.5
QUIET_S = 1.0
PATIENT_S = 3.0  # with a stream whose rate is not known
RETRY_S = 5.0
BACK_NS = 1_000_000_000  # a clock that goes back so far began anew
RUBBISH = 64  # bytes; fewer may be the rest of a message
ERROR_S = 60.0  # between two notices of one error of the sensor, which may come a hundred times a second

_NEW_BAUD = "new baud"  # in the note that `remember` makes: what the baud is to be changed to
_BEST: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")


@dataclass(frozen=True, slots=True)
class Wanted:
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


class Session:
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
        wanted: Wanted,
        clock: Callable[[], float],
        *,
        decoder: Decoder | None = None,
        serial: str | None = None,
        progress: Callable[[str], None] = lambda text: None,
        paced: bool = True,
    ) -> None:
        self.decoder = Decoder() if decoder is None else decoder
        self._port, self._wanted, self._clock, self._progress = port, wanted, clock, progress
        self._dialogue = Dialogue(port, clock, wanted.listen_only, progress)
        self._serial = serial
        self._identity: dict[int, str] = {}
        self._originals: dict[int, str] | None = None
        self._divisor: int | None = None  # of our own stream, None when the sensor sends another
        self._streams: dict[Kind, Stream] = {}
        self._remarks: list[str] = []
        self._notices: list[Notice] = []
        self._arrival = Arrival()
        self._paced = paced
        self._ahead = b""
        self._rubbish, self._silences = 0, 0
        self._newest_ns, self._restarted = 0, False  # of our stream's own clock
        self._troubles: set[str] = set()
        self._errors: dict[int, tuple[float, int]] = {}  # by code: when told again, how many were not
        self._watch_from(clock())

    # ------------------------------------------------------------------ the way in and out

    def connect(self) -> Facts:
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
        if self._wanted.listen_only:
            self._originals = {}
            return {}
        new_baud = None if self._wanted.set_baud is None else str(self._wanted.set_baud)
        before, written = self._originals, new_baud
        if before is None and saved is not None:
            before = {int(register): text for register, text in saved.items() if register.isdigit()}
            written = saved.get(_NEW_BAUD)
        self._originals = originals(self._dialogue.settings, before, written)
        note = {str(register): text for register, text in self._originals.items()}
        return note if new_baud is None else note | {_NEW_BAUD: new_baud}

    def configure(self) -> Facts:
        """Have the sensor stream what is wanted; in vain, take what it sends and say so.

        Raises
        ------
        SessionError : it does not answer any more.
        """
        self._remarks.clear()
        self._streams.clear()
        self._divisor = None
        if not self._wanted.listen_only:
            if self._originals is None:
                self.remember()
            self._progress("setting up the stream")
            if self._dialogue.ask("VNASY,0") is None:
                raise SessionError(f"the sensor on {self._port.name} has stopped answering: check the cable")
            if self._wanted.set_baud is not None and not self._change_baud(self._wanted.set_baud):
                self._remarks.append(f"the sensor stays at {self._port.baud} baud, it refused the other")
            if not self._start_binary():
                self._take_ascii()
            elif self._divisor != divisors(self._wanted.stream, self._port.baud)[0]:
                self._remarks.append("the sensor refused a higher rate at this baud")
        self._watch_from(self._clock())
        return self.facts()

    def restore(self) -> bool:
        """Put the settings back as they were found; True when the sensor has confirmed each.

        It may be called at any moment, also after `configure` was interrupted.
        """
        talk, before = self._dialogue, self._originals or {}
        changed = [r for r, text in before.items() if r in talk.touched or talk.settings.get(r) != text]
        if not changed:
            return True
        done = talk.ask("VNASY,0", tries=3) is not None
        if not done and BAUD in talk.touched:  # interrupted while the baud was being changed
            for baud in (int(before[BAUD]), self._wanted.set_baud or self._port.baud):
                if not done and self._port.set_baud(baud) and talk.is_here():
                    done = talk.ask("VNASY,0") is not None
        for register in (*BINARY_OUTPUTS, DELTA_CONTROL, IMU_FILTER, OUTPUT_TYPE):
            if done and register in changed:
                done = talk.write(register, before[register])
        if done and BAUD in changed:
            done = self._change_baud(int(before[BAUD]))
        if done:
            done = talk.ask("VNASY,1") is not None
        if done:
            talk.touched.clear()
        return done

    # ------------------------------------------------------------------ while it streams

    def read(self, timeout: float) -> bytes:
        """Bytes of the stream; waits up to `timeout` seconds for the first."""
        if self._ahead:
            data, self._ahead = self._ahead, b""
            return data
        return self._port.read(timeout)

    def decode(self, data: bytes) -> list[Item]:
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

    def facts(self) -> Facts:
        """What is known of the sensor and its stream by now."""
        facts = describe(
            self._port.name,
            self._port.baud,
            self._identity,
            self._dialogue.settings,
            self._best(),
            LOOP_RATE / self._divisor if self._divisor is not None else self._wanted.rate_hz,
            tuple(self._remarks),
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

    # ------------------------------------------------------------------ making it stream

    def _change_baud(self, baud: int) -> bool:
        """Change the baud of the sensor and of the port; the sensor is paused."""
        talk, before = self._dialogue, self._port.baud
        if baud == before or self._port.fixed_baud:
            return baud == before
        if not (self._port.set_baud(baud) and self._port.set_baud(before)):
            raise SessionError(f"the adapter of {self._port.name} cannot do {baud} baud: choose another")
        if not talk.write(BAUD, str(baud)) and talk.refusal is not None:
            return False
        self._port.read(0.05)  # it answers at the old baud, then switches; the answer may be lost
        self._port.set_baud(baud)
        talk.decoder = Decoder()
        if talk.read(1) is None:
            talk.find(dict.fromkeys((baud, before, *BAUDS)))
            talk.ask("VNASY,0")
        talk.settings[BAUD] = str(self._port.baud)
        return self._port.baud == baud

    def _start_binary(self) -> bool:
        """Start our stream; False when the sensor does not send it."""
        talk = self._dialogue
        if not talk.write(OUTPUT_TYPE, "0"):
            return False
        for mode in self._ports():
            for register in BINARY_OUTPUTS[1:]:
                if parse_output(text := talk.settings.get(register, OFF)) is not None:
                    talk.write(register, off_port(text, mode))
            divisor = self._write_output(mode)
            if divisor is not None:
                self._write_filter(divisor)
                if self._flows(divisor):
                    self._divisor = divisor
                    return True
                talk.ask("VNASY,0")
        return False

    def _ports(self) -> list[int]:
        """The sensor's ports, the likelier one to be ours first: sentences are off on it now."""
        off = []
        for port in (1, 2):
            answer = self._dialogue.ask(f"VNRRG,{OUTPUT_TYPE:02d},{port}")
            if isinstance(answer, Response) and answer.fields[1:2] == ("0",):
                off.append(port)
        return sorted((1, 2), key=lambda port: port not in off)

    def _write_output(self, mode: int) -> int | None:
        """Set the binary output at the highest rate that the sensor takes; its divisor."""
        talk, register = self._dialogue, BINARY_OUTPUTS[0]
        for divisor in divisors(self._wanted.stream, self._port.baud):
            text = output(self._wanted.stream, divisor, mode)
            if talk.write(register, text) and same(talk.read(register) or "", text):
                return divisor
            if talk.refusal != BAUD_TOO_LOW:
                break
        return None

    def _write_filter(self, divisor: int) -> None:
        """Have samples be true averages: deltas uncompensated, readings over their own interval."""
        talk = self._dialogue
        if self._wanted.stream == "deltas":
            if not talk.write(DELTA_CONTROL, UNCOMPENSATED_DELTAS):
                self._remarks.append("register 82 cannot be set: the deltas may be compensated")
        elif (text := windowed(talk.settings.get(IMU_FILTER, ""), divisor, self._wanted.stream)) is not None:
            talk.write(IMU_FILTER, text)

    def _flows(self, divisor: int) -> bool:
        """Let the stream go; whether its samples come. Bytes behind the first ones are kept for `read`."""
        self._dialogue.ask("VNASY,1")
        scratch, tail = Decoder(), b""
        deadline = self._clock() + FIRST_PACKET_S + 2 * divisor / LOOP_RATE
        while (left := deadline - self._clock()) > 0:
            data = self._port.read(left)
            tail = (tail + data)[-4096:]
            for item in scratch.feed(data):
                if isinstance(item, SampleBlock) and item.stream.kind == self._wanted.stream:
                    # the first increment may be as long as the pause before it: begin behind it
                    self._ahead = tail[len(tail) - scratch.pending :]
                    self._streams[item.stream.kind] = item.stream
                    return True
        return False

    def _take_ascii(self) -> None:
        """Put things back and take the sensor's own stream; where there was none, its IMU sentence."""
        talk, before = self._dialogue, self._originals or {}
        self._remarks.append("the binary stream does not come: what the sensor sends by itself is taken")
        for register in (*BINARY_OUTPUTS, DELTA_CONTROL, IMU_FILTER, OUTPUT_TYPE):
            if register in before:
                talk.write(register, before[register])
        if before.get(OUTPUT_TYPE) == "0" and all(same(before.get(r, OFF), OFF) for r in BINARY_OUTPUTS):
            talk.write(OUTPUT_TYPE, "19")
        talk.ask("VNASY,1")

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
            if self._originals is not None:
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
