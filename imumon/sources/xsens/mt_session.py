"""The Xsens MTi as a device: identification, configuration, health and restored settings.

A sensor in the measurement state answers nothing but `GO_TO_CONFIG`, so it pauses for a moment while it is identified.
Its output configuration is kept over a power-off: it is saved before it is changed, and restored at the end.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping

from imumon.model.samples import DeviceInfo, Kind, SampleBlock
from imumon.sources.device import DeviceNotFound, DeviceOptions
from imumon.sources.port_device import QUIET_UNKNOWN_S, PortDevice, Session
from imumon.sources.ports import BAUD_RATES
from imumon.sources.serial_port import SerialPort
from imumon.sources.xsens.mt_decoder import MtDecoder, stream_of
from imumon.sources.xsens.mt_messages import (
    EVERY_PACKET,
    KIND_BITS,
    DataId,
    Message,
    MessageId,
    encode,
    outputs,
)

DEFAULT_RATE_HZ = 100
"""Hz. Deltas lose nothing at a low rate, and every model and baud rate can do this one."""
TEMPERATURE_HZ = 1
"""Hz, the highest rate that every model has."""
REPLY_S = 0.5
"""s to wait for a reply."""
TRIES = 3
LISTEN_S = 2.0
"""s to wait for a valid message at one baud rate, if nothing may be written."""
SETTING = "output configuration"
NAMES: Mapping[int, str] = {
    DataId.TEMPERATURE: "temperature", DataId.PACKET_COUNTER: "counter", DataId.SAMPLE_TIME_FINE: "time",
    DataId.DELTA_V: "DeltaV", DataId.ACCELERATION: "acceleration", DataId.RATE_OF_TURN: "rate of turn",
    DataId.DELTA_Q: "DeltaQ", DataId.STATUS_WORD: "status",
}  # fmt: skip


class MtSession(Session):
    """One sensor on an open port."""

    quiet_s = QUIET_UNKNOWN_S

    def __init__(self, port: SerialPort, device: XsensDevice) -> None:
        self._port, self._settings, self._decoder = port, device.settings, device.messages
        self._progress = device.progress
        self._serial: str | None = None
        self._model: str | None = None
        self._firmware: str | None = None
        self._configuration: bytes | None = None  # that the sensor has
        self._original: bytes | None = None  # to restore
        self._changed = False  # something was written, whether or not the sensor has confirmed it
        self._kind: Kind | None = None  # of the samples that arrived
        self._remarks: tuple[str, ...] = ()

    @property
    def _listens(self) -> bool:
        return bool(self._settings.listen_only)

    # ------------------------------------------------------------------ start and end

    def connect(self) -> DeviceInfo:
        known = self._settings.baud
        rates = (
            [self._port.baud] if self._port.fixed_baud or known != "auto" else [self._port.baud, *BAUD_RATES]
        )
        for baud in dict.fromkeys(rates):
            self._progress(f"looking for an MTi at {baud} baud")
            if (self._port.fixed_baud or self._port.set_baud(baud)) and self._replies():
                break
        else:
            text = f"nothing on {self._port.name} replies like an Xsens MTi"
            raise DeviceNotFound(
                "not_an_mti", text, "check the cable, and that it sends Xbus messages (MTData2)"
            )
        if not self._listens:
            try:
                self._identify()
            finally:  # in the configuration state, the sensor would stay silent
                self._ask(MessageId.GO_TO_MEASUREMENT)
        return self.info()

    def _replies(self) -> bool:
        if not self._listens:
            return self._ask(MessageId.GO_TO_CONFIG) is not None
        seen, end = MtDecoder(), time.monotonic() + LISTEN_S
        while not seen.messages and time.monotonic() < end:
            seen.feed(self._port.read(0.1))
        return seen.messages > 0

    def _identify(self) -> None:
        """Read serial number, model, firmware and output configuration in the configuration state."""
        identity = self._ask(MessageId.REQUEST_DEVICE) or b""
        self._serial = identity.hex().upper() or None
        product = self._ask(MessageId.REQUEST_PRODUCT)
        self._model = product.decode("ascii", "replace").strip("\0 ") or None if product else None
        firmware = self._ask(MessageId.REQUEST_FIRMWARE)
        self._firmware = ".".join(map(str, firmware[:3])) if firmware and len(firmware) >= 3 else None
        self._configuration = self._ask(MessageId.OUTPUT_CONFIGURATION)

    def save_settings(self, saved: Mapping[str, str] | None = None) -> dict[str, str]:
        if self._listens or self._configuration is None:
            return {}
        if self._original is None:  # a later connection finds the configuration of this run
            text = (saved or {}).get(SETTING, "")
            try:
                self._original = bytes.fromhex(text) or self._configuration
            except ValueError:
                self._original = self._configuration
        return {SETTING: self._original.hex()}

    def configure(self) -> DeviceInfo:
        if not self._listens:
            self._progress("configuring the stream")
            deltas = self._settings.stream == "deltas"
            rate = round(getattr(self._settings, "set_rate_hz", 0.0)) or DEFAULT_RATE_HZ
            wanted = [
                (DataId.PACKET_COUNTER, EVERY_PACKET),
                (DataId.SAMPLE_TIME_FINE, EVERY_PACKET),
                (DataId.DELTA_Q if deltas else DataId.RATE_OF_TURN, rate),
                (DataId.DELTA_V if deltas else DataId.ACCELERATION, rate),
                (DataId.TEMPERATURE, TEMPERATURE_HZ),
                (DataId.STATUS_WORD, EVERY_PACKET),
            ]
            data = b"".join(struct.pack(">HH", *output) for output in wanted)
            if not self._write(data):
                self._remarks = ("the sensor does not accept the output configuration: its own is measured",)
        return self.info()

    def restore(self) -> bool:
        # `_changed` and not a comparison: of a lost reply, nothing shows which configuration the sensor has
        return self._original is None or not self._changed or self._write(self._original)

    def _write(self, configuration: bytes) -> bool:
        """Set the output configuration; return whether the sensor has confirmed it. It then measures in any case."""
        self._changed = configuration != self._original
        try:
            self._ask(MessageId.GO_TO_CONFIG)
            reply = self._ask(MessageId.OUTPUT_CONFIGURATION, configuration)
            if reply is not None:
                self._configuration = self._ask(MessageId.OUTPUT_CONFIGURATION) or reply
        finally:
            self._ask(MessageId.GO_TO_MEASUREMENT)
        # a reply with data states what the sensor has really set
        return reply is not None and (not reply or reply == configuration)

    def _ask(self, message_id: int, data: bytes = b"") -> bytes | None:
        """Return the data of the reply to a message; None: none came, or an error. Samples meanwhile are not kept."""
        for _ in range(TRIES):
            # a decoder of its own: the record counts neither replies nor the samples between them
            replies = MtDecoder()
            self._port.write(encode(message_id, data))
            end = time.monotonic() + REPLY_S
            while (left := end - time.monotonic()) > 0.0:
                for item in replies.feed(self._port.read(left)):
                    if isinstance(item, Message) and item.id == message_id + 1:
                        return item.data
                    if isinstance(item, Message) and item.id == MessageId.ERROR:
                        return None
        return None

    # ------------------------------------------------------------------ while it streams

    def info(self) -> DeviceInfo:
        present = {data & KIND_BITS: rate for data, rate in outputs(self._configuration or b"")}
        kind = self._kind or ("deltas" if DataId.DELTA_Q in present else None)
        rate = present.get(DataId.DELTA_Q if kind == "deltas" else DataId.RATE_OF_TURN)
        return DeviceInfo(
            id=f"mti-{(self._serial or self._port.name.rsplit('/', 1)[-1]).lower()}",
            kind="MTi",
            model=self._model,
            serial=self._serial,
            firmware=self._firmware,
            port=self._port.name,
            baud=None if self._port.fixed_baud else self._port.baud,
            sample_rate_hz=float(rate) if rate and rate < EVERY_PACKET else None,
            settings={SETTING: _listed(self._configuration)} if self._configuration else {},
            remarks=tuple(self._doubts()),
            **(stream_of(kind, "startup").facts if kind else {}),
        )

    def _doubts(self) -> Iterator[str]:
        """Yield the remarks on the sensor: what is unknown, and what is changed until the end of the run."""
        yield from self._remarks
        if self._original not in (None, self._configuration):
            before = _listed(self._original or b"")
            yield f"the output configuration is changed until the end of the run, from {before}"
        if self._serial is None:
            yield "listen-only: model, serial number and settings are unknown"

    def read(self, timeout: float) -> bytes:
        return self._port.read(timeout)

    def decode(self, data: bytes) -> list[SampleBlock | Message]:
        items = self._decoder.feed(data)
        for item in items:
            if isinstance(item, SampleBlock):
                self._kind = item.stream.kind
        return items


def _listed(configuration: bytes) -> str:
    """Return the fields of an output configuration that have a rate, for people."""
    present = ((data & KIND_BITS, rate) for data, rate in outputs(configuration) if rate < EVERY_PACKET)
    return ", ".join(f"{NAMES.get(data, f'{data:04X}')} {rate} Hz" for data, rate in present)


class XsensDevice(PortDevice):
    """One MTi; `url` is ``xsens:`` and a path or a pyserial URL, or nothing: the only one on the serial ports."""

    title = "Xsens MTi"

    def __init__(self, options: DeviceOptions) -> None:
        self.settings, self.messages = options.settings, MtDecoder()
        baud = BAUD_RATES[0] if self.settings.baud == "auto" else self.settings.baud
        super().__init__(options, options.url.removeprefix("xsens:"), baud, self.messages)

    def _new_session(self, port: SerialPort) -> MtSession:
        return MtSession(port, self)
