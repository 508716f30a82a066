"""Configuration of a VN-100: the requested stream, and the original settings at the end.

- Nothing is ever written to flash, and the sensor is never reset.
- ASCII output is switched off before binary output is set: the sensor refuses what exceeds its baud rate.
- The original settings are saved before anything is written, so that they can be restored at any moment.

Which value a register gets is in `stream_settings`; how it is written is in `commands`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imumon.model.samples import SampleBlock, Stream
from imumon.sources.device import DeviceNotFound, InvalidOption
from imumon.sources.ports import BAUD_RATES
from imumon.sources.vn100.ascii import Response
from imumon.sources.vn100.commands import CommandChannel, baud_unsupported
from imumon.sources.vn100.decoder import Vn100Decoder
from imumon.sources.vn100.registers import BAUDS, BINARY_OUTPUTS, LOOP_RATE, ErrorCode, RegisterNumber
from imumon.sources.vn100.stream_settings import (
    CHANGEABLE,
    OFF,
    UNCOMPENSATED_DELTAS,
    configured_output,
    divisors,
    off_port,
    originals,
    output,
    parse_output,
    same,
    windowed,
)

if TYPE_CHECKING:
    from imumon.config import DeviceSettings

FIRST_PACKET_S = 0.5
"""s, and two output intervals, to wait for the first packet of a new stream."""

_NEW_BAUD = "new baud"
"""Key of the baud rate that will be set, in the saved settings."""


@dataclass(frozen=True, slots=True)
class ConfiguredStream:
    """Configured stream whose samples arrive.

    Attributes
    ----------
    divisor : of the 800 Hz loop rate of the sensor.
    unread : bytes read behind the first samples, for the decoder of the record.
    """

    stream: Stream
    divisor: int
    unread: bytes


class Configuration:
    """Changes of the settings of one sensor.

    Parameters
    ----------
    channel : to the sensor, whose settings are read before anything is called here.
    settings : what the user requests.
    clock : s, monotonic.

    Attributes
    ----------
    remarks : about refused settings in the last `apply`.
    """

    def __init__(self, channel: CommandChannel, settings: DeviceSettings, clock: Callable[[], float]) -> None:
        self.remarks: list[str] = []
        self._channel, self._port, self._clock = channel, channel.port, clock
        self._kind, self._baud, self._rate_hz = settings.stream, settings.set_baud, settings.set_rate_hz
        self._originals: dict[int, str] | None = None
        self._paused = False

    def save_originals(self, saved: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the settings to restore at the end, in a form to keep on disk.

        Parameters
        ----------
        saved : the return value in an earlier process that ended without `revert`; None: there was none.
        """
        new_baud = str(self._baud) if self._baud else None
        before, written = self._originals, new_baud
        if before is None and saved is not None:
            before = {int(register): text for register, text in saved.items() if register.isdigit()}
            written = saved.get(_NEW_BAUD)
        self._originals = originals(self._channel.settings, before, written)
        note = {str(register): text for register, text in self._originals.items()}
        return note if new_baud is None else note | {_NEW_BAUD: new_baud}

    def apply(self) -> ConfiguredStream | None:
        """Make the sensor stream the requested samples; None if it cannot and sends its own stream.

        Raises
        ------
        DeviceNotFound : it has stopped replying.
        InvalidOption : it has no such output rate, or not at its baud rate.
        """
        self.remarks.clear()
        if self._originals is None:
            self.save_originals()
        self._check_rate()
        self._paused = True  # before the request: an interrupt may come between it and its reply
        if self._channel.request("VNASY,0") is None:
            text = f"the sensor on {self._port.name} has stopped replying"
            raise DeviceNotFound("device_stopped_replying", text, "check the cable")
        if self._baud and not self._change_baud(self._baud):
            self.remarks.append(f"the sensor stays at {self._port.baud} baud, it refused {self._baud}")
        stream = self._start_binary()
        if stream is None:
            self._use_ascii()
        elif stream.divisor != divisors(self._kind, self._port.baud, self._rate_hz)[0]:
            self.remarks.append("the sensor refused a higher rate at this baud rate")
        self._paused = False
        return stream

    def _check_rate(self) -> None:
        """Raise `InvalidOption` if the requested rate is none of the sensor, or does not fit the baud rate."""
        rate_hz, baud = self._rate_hz, self._baud or self._port.baud
        if not rate_hz or divisors(self._kind, baud, rate_hz):
            return
        rates = [f"{LOOP_RATE // divisor}" for divisor in reversed(divisors(self._kind, baud))]
        text = f"{rate_hz:g} Hz is no output rate of the sensor at {baud} baud"
        cure = f"set device.set_rate_hz to one of {', '.join(rates)}"
        higher = [other for other in BAUDS if other > baud and divisors(self._kind, other, rate_hz)]
        if higher:
            cure += f", or --set-baud {higher[0]}"
        raise InvalidOption("rate_not_possible", text, cure)

    def changes(self) -> str | None:
        """Return which output was changed and what is restored at the end; None without a change."""
        settings = self._channel.settings
        now, before = configured_output(settings), configured_output({**settings, **(self._originals or {})})
        return None if now == before else f"the sensor sends {now} now; {before} is restored at the end"

    def revert(self) -> bool:
        """Restore the original settings; return whether the sensor has confirmed each."""
        channel, before = self._channel, self._originals or {}
        # a written register counts as changed whatever its value: the confirmation may have been lost
        changed = [r for r, text in before.items() if r in channel.written or channel.settings.get(r) != text]
        if not changed and not self._paused:
            return True
        done = self._is_pausing(before) and all(
            channel.write(r, before[r]) for r in CHANGEABLE if r in changed
        )
        # last, when the outputs are those that fit it: the sensor refuses a rate at which they do not
        if done and RegisterNumber.BAUD in changed:
            done = self._change_baud(int(before[RegisterNumber.BAUD]))
        if not done or channel.request("VNASY,1") is None:
            return False
        channel.written.clear()
        self._paused = False
        return True

    def _is_pausing(self, before: Mapping[int, str]) -> bool:
        """Pause the output, also after an interrupted change of the baud rate; return whether it is confirmed."""
        channel = self._channel
        # fewer tries: at the end of a run, the sensor may be gone, and the user waits
        if channel.request("VNASY,0", tries=3) is not None:
            return True
        if RegisterNumber.BAUD not in channel.written:
            return False
        bauds = (int(before[RegisterNumber.BAUD]), self._baud or self._port.baud)
        return any(
            self._port.set_baud(baud) and channel.is_present() and channel.request("VNASY,0") is not None
            for baud in bauds
        )

    def _change_baud(self, baud: int) -> bool:
        """Change the baud rate of the paused sensor and of the port."""
        channel, before = self._channel, self._port.baud
        if baud == before or self._port.fixed_baud:
            return baud == before
        # ask the adapter first: a sensor at a rate that this host cannot do is lost until its next power-up
        if not (self._port.set_baud(baud) and self._port.set_baud(before)):
            raise baud_unsupported(self._port.name, baud)
        if not channel.write(RegisterNumber.BAUD, str(baud)) and channel.error_code is not None:
            return False
        self._port.read(0.05)  # it replies at the old baud rate, then switches; the reply may be lost
        self._port.set_baud(baud)
        channel.decoder = Vn100Decoder()
        if channel.read(1) is None:
            channel.find_baud(dict.fromkeys((baud, before, *BAUD_RATES)))
            channel.request("VNASY,0")
        channel.settings[RegisterNumber.BAUD] = str(self._port.baud)
        return self._port.baud == baud

    def _start_binary(self) -> ConfiguredStream | None:
        """Start the requested stream; None if the sensor does not send it."""
        channel = self._channel
        # ASCII first: together with it, the packets would exceed the baud rate, and the sensor refuses them (0C)
        if not channel.write(RegisterNumber.OUTPUT_TYPE, "0"):
            return None
        # Not every firmware reports on which of its ports this is: the one whose packets arrive. Never on both: a
        # second port at 115200 baud would make the sensor refuse what a faster first one can carry.
        for mode in self._output_ports():
            for register in BINARY_OUTPUTS[1:]:
                if parse_output(text := channel.settings.get(register, OFF)) is not None:
                    channel.write(register, off_port(text, mode))
            divisor = self._write_output(mode)
            if divisor is not None:
                self._write_filter(divisor)
                if (stream := self._first_samples(divisor)) is not None:
                    return stream
                channel.request("VNASY,0")
        return None

    def _output_ports(self) -> list[int]:
        """Return the ports of the sensor, the more likely one first: its ASCII output is off now."""
        off = []
        for port in (1, 2):
            reply = self._channel.request(f"VNRRG,{RegisterNumber.OUTPUT_TYPE:02d},{port}")
            if isinstance(reply, Response) and reply.fields[1:2] == ("0",):
                off.append(port)
        return sorted((1, 2), key=lambda port: port not in off)

    def _write_output(self, mode: int) -> int | None:
        """Set the binary output at the highest rate that the sensor accepts; return its divisor."""
        channel, register = self._channel, BINARY_OUTPUTS[0]
        for divisor in divisors(self._kind, self._port.baud, self._rate_hz):
            text = output(self._kind, divisor, mode)
            # read back: the echo of a write confirms that it was accepted, not what is stored
            if channel.write(register, text) and same(channel.read(register) or "", text):
                return divisor
            if channel.error_code != ErrorCode.BAUD_RATE_TOO_LOW:
                break
        return None

    def _write_filter(self, divisor: int) -> None:
        """Make samples true averages: deltas uncompensated, readings over their own interval."""
        channel = self._channel
        if self._kind == "deltas":
            if not channel.write(RegisterNumber.DELTA_CONTROL, UNCOMPENSATED_DELTAS):
                self.remarks.append("register 82 cannot be set: the deltas may be compensated")
        elif (
            text := windowed(channel.settings.get(RegisterNumber.IMU_FILTER, ""), divisor, self._kind)
        ) is not None:
            channel.write(RegisterNumber.IMU_FILTER, text)

    def _first_samples(self, divisor: int) -> ConfiguredStream | None:
        """Resume output and wait for the first samples; None if they do not arrive."""
        self._channel.request("VNASY,1")
        decoder, tail = Vn100Decoder(), b""
        deadline = self._clock() + FIRST_PACKET_S + 2 * divisor / LOOP_RATE
        while (left := deadline - self._clock()) > 0:
            data = self._port.read(left)
            tail = (tail + data)[-4096:]  # more than what can be pending behind the last sample
            for item in decoder.feed(data):
                if isinstance(item, SampleBlock) and item.stream.kind == self._kind:
                    # the first increment may include the pause before it: start behind it
                    return ConfiguredStream(item.stream, divisor, tail[len(tail) - decoder.pending :])
        return None

    def _use_ascii(self) -> None:
        """Restore the outputs and use the stream of the sensor; where there is none, its IMU sentence."""
        channel, before = self._channel, self._originals or {}
        self.remarks.append("the binary stream does not arrive: the stream that the sensor sends is used")
        for register in CHANGEABLE:
            if register in before:
                channel.write(register, before[register])
        if before.get(RegisterNumber.OUTPUT_TYPE) == "0" and all(
            same(before.get(r, OFF), OFF) for r in BINARY_OUTPUTS
        ):
            channel.write(
                RegisterNumber.OUTPUT_TYPE, "19"
            )  # VNIMU: uncompensated; the steps of VNDTV are too coarse
        channel.request("VNASY,1")
