"""The VN-100 as a device: identification, configuration, health checks and restored settings.

The port and the clock of a session are arguments; it waits only in `read` of the port, which `PortDevice` opens. Rules:

- Only `configuration` changes the sensor and restores it; with `DeviceSettings.listen_only` nothing is written.
- A sensor that is paused, was restarted, or has another baud rate is lost: `PortDevice` opens its port again, and finds
  and configures it as at the start.

Life of a session: `connect`, `save_settings` (keep the result on disk), `configure`; then `read`, `decode` and
`check_health` repeatedly; `restore`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from imumon.model.samples import DeviceInfo, Kind, Notice, SampleBlock, Stream
from imumon.sources.device import RESTART_NS, DeviceLost, DeviceOptions
from imumon.sources.port_device import QUIET_UNKNOWN_S, PortDevice, RateCheck, Session
from imumon.sources.ports import BAUD_RATES
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.ascii import ERRORS, SensorError
from imumon.sources.vn100.commands import CommandChannel, NotAVn100
from imumon.sources.vn100.configuration import Configuration
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder
from imumon.sources.vn100.device_info import device_info, nominal_rate
from imumon.sources.vn100.registers import CHANGE_THE_DATA, FACTORY_BAUD, LOOP_RATE, RegisterNumber

if TYPE_CHECKING:
    from imumon.config import DeviceSettings

OTHER_STREAM_S = 1.0
"""s for which a sensor may send another stream than the configured one: it was restarted."""

_BEST: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")


class Vn100Session(Session):
    """One sensor on one port.

    Parameters
    ----------
    port : open port.
    settings : what the user requests.
    clock : s, monotonic.
    decoder : of an earlier session with this sensor, so that its counters continue.
    progress : called with a short text about the current step, a few times a second at most.
    paced : samples arrive at their rate; False for an emulator in time-lapse, which waits for its reader.

    Attributes
    ----------
    decoder : decodes the stream; its counters are those of the record. Scans and requests use others.
    """

    def __init__(
        self,
        port: SerialPort,
        settings: DeviceSettings,
        clock: Callable[[], float],
        *,
        decoder: Vn100Decoder | None = None,
        progress: Callable[[str], None] = lambda text: None,
        paced: bool = True,
    ) -> None:
        self.decoder = Vn100Decoder() if decoder is None else decoder
        self._port, self._settings, self._clock, self._progress = port, settings, clock, progress
        self._channel = CommandChannel(port, clock, settings.listen_only, progress)
        self._configuration = Configuration(self._channel, settings, clock)
        self._paced = paced
        self._identity: dict[int, str] = {}
        self._divisor: int | None = None  # of the configured stream; None if the sensor sends its own
        self._streams: dict[Kind, Stream] = {}
        self._notices: list[Notice] = []
        self._rate_check = RateCheck()
        self._unread = b""
        self._newest_ns, self._restarted, self._sends_other_stream = 0, False, False
        self._errors: set[int | None] = set()  # codes that were reported

    @property
    def quiet_s(self) -> float:  # type: ignore[override]
        if self._sends_other_stream:
            return OTHER_STREAM_S
        return max(QUIET_UNKNOWN_S, 4 * (self._divisor or 0) / LOOP_RATE)

    # ------------------------------------------------------------------ start and end

    def connect(self) -> DeviceInfo:
        """Find the baud rate of the sensor, identify it and read its settings.

        Raises
        ------
        NotAVn100 : no VN-100 replies.
        """
        self._channel.find_baud(self._bauds())
        if not self._settings.listen_only:
            self._identify()
        return self.info()

    def save_settings(self, saved: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the settings to restore at the end. Keep them on disk until `restore` has succeeded.

        Parameters
        ----------
        saved : the return value in an earlier process that ended without `restore`; None: there was none.
        """
        return {} if self._settings.listen_only else self._configuration.save_originals(saved)

    def configure(self) -> DeviceInfo:
        """Make the sensor stream the requested samples; if it cannot, use its own stream and add a remark.

        Raises
        ------
        DeviceNotFound : it has stopped replying.
        """
        self._streams.clear()
        self._divisor = None
        if not self._settings.listen_only:
            self._progress("configuring the stream")
            configured = self._configuration.apply()
            if configured is not None:
                self._streams[configured.stream.kind] = configured.stream
                self._divisor, self._unread = configured.divisor, configured.unread
        return self.info()

    def changes(self) -> str | None:
        """Return which output was changed and what is restored at the end; None without a change."""
        return None if self._settings.listen_only else self._configuration.changes()

    def restore(self) -> bool:
        """Restore the original settings; return whether the sensor has confirmed each.

        It may be called at any moment, also after an interrupted `configure`.
        """
        return self._configuration.revert()

    # ------------------------------------------------------------------ while it streams

    def read(self, timeout: float) -> bytes:
        """Return bytes of the stream; wait up to `timeout` seconds for the first."""
        if self._unread:  # the start of the stream was read by the decoder that waited for it
            data, self._unread = self._unread, b""
            return data
        return self._port.read(timeout)

    def decode(self, data: bytes) -> list[DecodedItem]:
        """Return the items in bytes that `read` returned."""
        items = self.decoder.feed(data)
        for item in items:
            if isinstance(item, SampleBlock):
                self._streams[item.stream.kind] = item.stream
                self._sends_other_stream = not self.is_alive(item)
                self._check_rate(item, self._clock())
                self._check_restart(item)
            elif isinstance(item, SensorError):
                self._on_sensor_error(item)
        return items

    def is_alive(self, block: SampleBlock) -> bool:
        # after a power-up, a sensor may send another output, of its flash
        return self._divisor is None or block.stream.kind == self._settings.stream

    def check_health(self) -> list[Notice]:
        if self._restarted and self._divisor is not None:
            raise DeviceLost(
                "device_lost", f"the sensor on {self._port.name} was restarted", "check its power"
            )
        notices, self._notices = self._notices, []
        return notices

    def info(self) -> DeviceInfo:
        """Return what is known of the sensor and its stream."""
        info = device_info(
            self._port.name,
            self._port.baud,
            self._identity,
            self._channel.settings,
            self._best(),
            LOOP_RATE / self._divisor if self._divisor is not None else self._settings.rate_hz or None,
            tuple(self._configuration.remarks),
        )
        # by the rate of the registers or of the user: without a clock, N, B and K rest on it alone
        remark = info.sample_rate_hz and self._rate_check.remark(info.sample_rate_hz)
        return replace(info, remarks=(*info.remarks, remark)) if remark else info

    def _best(self) -> Stream | None:
        """Return the stream that is characterised; None before its first sample."""
        return next((self._streams[kind] for kind in _BEST if kind in self._streams), None)

    def _check_rate(self, block: SampleBlock, now: float) -> None:
        """Compare a configured rate with the host clock if the stream has no clock, or with listen-only."""
        if not self._paced or block.stream != self._best():
            return
        # otherwise the divisor is known and the sensor has a clock: there is nothing to doubt
        if self._settings.listen_only or block.stream.clock == "none":
            nominal = nominal_rate(self._channel.settings, block.stream) or self._settings.rate_hz
            if nominal:
                self._rate_check.update(len(block) + int(block.lost.sum()), now, nominal)

    def _check_restart(self, block: SampleBlock) -> None:
        """Notice a restart of the sensor by its clock, if it streams the same from its flash."""
        # its volatile settings, such as register 82, are then those of the flash, though the stream looks the same
        if block.stream.clock == "startup" and block.time_ns is not None and len(block):
            self._restarted |= int(block.time_ns[0]) < self._newest_ns - RESTART_NS
            self._newest_ns = int(block.time_ns[-1])

    # ------------------------------------------------------------------ identification

    def _bauds(self) -> list[int]:
        """Return the baud rates to try, in this order."""
        if self._port.fixed_baud:
            return [self._port.baud]
        if self._settings.baud != "auto":
            return list(dict.fromkeys((self._settings.baud, self._settings.set_baud or self._settings.baud)))
        # the present rate first: after a loss, the sensor is most likely still there
        return list(dict.fromkeys((self._port.baud, *BAUD_RATES)))

    def _identify(self) -> None:
        """Read identity and settings."""
        self._progress("reading the settings of the sensor")
        settings = self._channel.settings
        self._identity.clear()
        settings.clear()
        # the output type is read early: a sensor may be configured to switch its output off at an error
        for register in dict.fromkeys((1, 3, 4, RegisterNumber.OUTPUT_TYPE, *CHANGE_THE_DATA)):
            text = self._channel.read(register)
            if text is None and register == 1:  # it is heard, and does not hear
                message = f"{self._port.name} sends valid messages but does not reply"
                cure = "connect the wire to the receiver of the sensor, or use --listen-only"
                raise NotAVn100("device_receives_nothing", message, cure)
            if text is not None:
                (self._identity if register < RegisterNumber.BAUD else settings)[register] = text

    def _on_sensor_error(self, error: SensorError) -> None:
        """Report an error of the sensor once: it may repeat a hundred times a second. Unknown codes count as one."""
        code = error.code if error.code in ERRORS else None
        if code not in self._errors:
            self._errors.add(code)
            self._notices.append(Notice("sensor_error", f"the sensor reports an error: {error.text}"))


class Vn100Device(PortDevice):
    """One VN-100.

    Parameters
    ----------
    options : `url` is a path or a pyserial URL; empty: the only VN-100 on the serial ports.
    """

    title = "VN-100"

    def __init__(self, options: DeviceOptions) -> None:
        self._settings = options.settings
        self._messages = Vn100Decoder()
        path = options.url.removeprefix("vn100:")
        baud = FACTORY_BAUD if self._settings.baud == "auto" else self._settings.baud
        super().__init__(options, path, baud, self._messages)

    def _new_session(self, port: SerialPort) -> Vn100Session:
        return Vn100Session(
            port,
            self._settings,
            time.monotonic,
            decoder=self._messages,
            progress=lambda text: self.progress(text),
            paced=not self._time_lapse,
        )
