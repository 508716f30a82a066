"""Changes of a VN-100: made so that it streams what noise needs, taken back at the end.

- Nothing is ever written to flash, and the sensor is never reset.
- The ASCII output goes off before the binary one is set: the sensor refuses what does not fit its baud.
- What was found is remembered before anything is written, so that it can be put back at any moment.

What is written into which register is in `settings`, how one is written in `dialogue`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from imumon.devices.vn100.ascii import Response
from imumon.devices.vn100.commands import BAUDS, CommandChannel, SessionError
from imumon.devices.vn100.decoder import Vn100Decoder
from imumon.devices.vn100.registers import (
    BAUD,
    BAUD_TOO_LOW,
    BINARY_OUTPUTS,
    DELTA_CONTROL,
    IMU_FILTER,
    LOOP_RATE,
    OUTPUT_TYPE,
)
from imumon.devices.vn100.stream_settings import (
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
from imumon.samples import Kind, SampleBlock, Stream

FIRST_PACKET_S = 0.5

_CHANGED = (*BINARY_OUTPUTS, DELTA_CONTROL, IMU_FILTER, OUTPUT_TYPE)  # put back in this order, the baud last
_NEW_BAUD = "new baud"  # in the note that `remember` makes: what the baud is to be changed to


@dataclass(frozen=True, slots=True)
class ConfiguredStream:
    """Our stream, once its samples come.

    Attributes
    ----------
    stream : what its samples are.
    divisor : of the rate of the sensor's loop.
    ahead : bytes read behind the first samples, for the record's decoder.
    """

    stream: Stream
    divisor: int
    ahead: bytes


class Configuration:
    """What is changed of one sensor.

    Parameters
    ----------
    dialogue : with the sensor, whose settings are read before anything is called here.
    kind : of samples to ask the sensor for.
    baud : to change the sensor's to; None: never.
    clock : seconds, monotonic.

    Attributes
    ----------
    remarks : what the sensor did not take when `make` was called last.
    """

    def __init__(
        self, dialogue: CommandChannel, kind: Kind, baud: int | None, clock: Callable[[], float]
    ) -> None:
        self.remarks: list[str] = []
        self._dialogue, self._port, self._clock = dialogue, dialogue.port, clock
        self._kind, self._baud = kind, baud
        self._originals: dict[int, str] | None = None

    def remember(self, saved: Mapping[str, str] | None = None) -> dict[str, str]:
        """Settings to put back at the end, in a form to keep on disk.

        Parameters
        ----------
        saved : the answer of an earlier process that ended without `undo`, None when there was none.
        """
        new_baud = None if self._baud is None else str(self._baud)
        before, written = self._originals, new_baud
        if before is None and saved is not None:
            before = {int(register): text for register, text in saved.items() if register.isdigit()}
            written = saved.get(_NEW_BAUD)
        self._originals = originals(self._dialogue.settings, before, written)
        note = {str(register): text for register, text in self._originals.items()}
        return note if new_baud is None else note | {_NEW_BAUD: new_baud}

    def make(self) -> ConfiguredStream | None:
        """Have the sensor stream what is wanted; None where that was in vain and it sends its own.

        Raises
        ------
        SessionError : it does not answer any more.
        """
        self.remarks.clear()
        if self._originals is None:
            self.remember()
        if self._dialogue.ask("VNASY,0") is None:
            raise SessionError(f"the sensor on {self._port.name} has stopped answering: check the cable")
        if self._baud is not None and not self._change_baud(self._baud):
            self.remarks.append(f"the sensor stays at {self._port.baud} baud, it refused the other")
        flow = self._start_binary()
        if flow is None:
            self._take_ascii()
        elif flow.divisor != divisors(self._kind, self._port.baud)[0]:
            self.remarks.append("the sensor refused a higher rate at this baud")
        return flow

    def undo(self) -> bool:
        """Put the settings back as they were found; True when the sensor has confirmed each."""
        talk, before = self._dialogue, self._originals or {}
        changed = [r for r, text in before.items() if r in talk.touched or talk.settings.get(r) != text]
        if not changed:
            return True
        done = talk.ask("VNASY,0", tries=3) is not None
        if not done and BAUD in talk.touched:  # interrupted while the baud was being changed
            for baud in (int(before[BAUD]), self._baud or self._port.baud):
                if not done and self._port.set_baud(baud) and talk.is_here():
                    done = talk.ask("VNASY,0") is not None
        for register in _CHANGED:
            if done and register in changed:
                done = talk.write(register, before[register])
        if done and BAUD in changed:
            done = self._change_baud(int(before[BAUD]))
        if done:
            done = talk.ask("VNASY,1") is not None
        if done:
            talk.touched.clear()
        return done

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
        talk.decoder = Vn100Decoder()
        if talk.read(1) is None:
            talk.find(dict.fromkeys((baud, before, *BAUDS)))
            talk.ask("VNASY,0")
        talk.settings[BAUD] = str(self._port.baud)
        return self._port.baud == baud

    def _start_binary(self) -> ConfiguredStream | None:
        """Start our stream; None when the sensor does not send it."""
        talk = self._dialogue
        if not talk.write(OUTPUT_TYPE, "0"):
            return None
        for mode in self._ports():
            for register in BINARY_OUTPUTS[1:]:
                if parse_output(text := talk.settings.get(register, OFF)) is not None:
                    talk.write(register, off_port(text, mode))
            divisor = self._write_output(mode)
            if divisor is not None:
                self._write_filter(divisor)
                if (flow := self._flow(divisor)) is not None:
                    return flow
                talk.ask("VNASY,0")
        return None

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
        for divisor in divisors(self._kind, self._port.baud):
            text = output(self._kind, divisor, mode)
            if talk.write(register, text) and same(talk.read(register) or "", text):
                return divisor
            if talk.refusal != BAUD_TOO_LOW:
                break
        return None

    def _write_filter(self, divisor: int) -> None:
        """Have samples be true averages: deltas uncompensated, readings over their own interval."""
        talk = self._dialogue
        if self._kind == "deltas":
            if not talk.write(DELTA_CONTROL, UNCOMPENSATED_DELTAS):
                self.remarks.append("register 82 cannot be set: the deltas may be compensated")
        elif (text := windowed(talk.settings.get(IMU_FILTER, ""), divisor, self._kind)) is not None:
            talk.write(IMU_FILTER, text)

    def _flow(self, divisor: int) -> ConfiguredStream | None:
        """Let the stream go; None when its samples do not come."""
        self._dialogue.ask("VNASY,1")
        scratch, tail = Vn100Decoder(), b""
        deadline = self._clock() + FIRST_PACKET_S + 2 * divisor / LOOP_RATE
        while (left := deadline - self._clock()) > 0:
            data = self._port.read(left)
            tail = (tail + data)[-4096:]
            for item in scratch.feed(data):
                if isinstance(item, SampleBlock) and item.stream.kind == self._kind:
                    # the first increment may be as long as the pause before it: begin behind it
                    return ConfiguredStream(item.stream, divisor, tail[len(tail) - scratch.pending :])
        return None

    def _take_ascii(self) -> None:
        """Put things back and take the sensor's own stream; where there was none, its IMU sentence."""
        talk, before = self._dialogue, self._originals or {}
        self.remarks.append("the binary stream does not come: what the sensor sends by itself is taken")
        for register in _CHANGED:
            if register in before:
                talk.write(register, before[register])
        if before.get(OUTPUT_TYPE) == "0" and all(same(before.get(r, OFF), OFF) for r in BINARY_OUTPUTS):
            talk.write(OUTPUT_TYPE, "19")
        talk.ask("VNASY,1")
