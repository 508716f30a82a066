"""The VN-100 as a device: identification, configuration, health checks and restored settings.

The port and the clock of a session are arguments; it waits only in `read` of the port, which `PortDevice` opens. Rules:

- Only `configuration` changes the sensor and restores it; with `DeviceSettings.listen_only` nothing is written.
- `check_health` repairs what can be repaired in place: a paused sensor, a restarted one, another baud rate, a
  bad read. If the port vanishes, the exception of the port passes through.

Life of a session: `connect`, `save_settings` (keep the result on disk), `configure`; then `read`, `decode` and
`check_health` repeatedly; `restore`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from imumon.model.samples import DeviceInfo, Kind, Notice, SampleBlock, Stream
from imumon.sources.device import RESTART_NS, DeviceNotFound, DeviceOptions, sample_blocks
from imumon.sources.port_device import QUIET_UNKNOWN_S, PortDevice, RateCheck, Session
from imumon.sources.ports import BAUD_RATES
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.ascii import ERRORS, SensorError
from imumon.sources.vn100.commands import CommandChannel, NotAVn100, OtherSensor
from imumon.sources.vn100.configuration import Configuration
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder
from imumon.sources.vn100.device_info import device_info, nominal_rate
from imumon.sources.vn100.registers import CHANGE_THE_DATA, FACTORY_BAUD, LOOP_RATE, RegisterNumber

if TYPE_CHECKING:
    from imumon.config import DeviceSettings

QUIET_S = 1.0
"""s without data after which the sensor is resumed; or four samples, if they take longer."""
RETRY_S = 5.0
"""s between two scans for a sensor that does not reply. A scan takes up to ten seconds."""
GARBAGE_BYTES = 64
"""Bytes without a valid message that count as garbage; fewer may be the rest of a message."""

_BEST: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")


class Vn100Session(Session):
    """One sensor on one port.

    Parameters
    ----------
    port : open port.
    settings : what the user requests.
    clock : s, monotonic.
    decoder : of an earlier session with this sensor, so that its counters continue.
    serial : serial number that the sensor must have; None: any.
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
        serial: str | None = None,
        progress: Callable[[str], None] = lambda text: None,
        paced: bool = True,
    ) -> None:
        self.decoder = Vn100Decoder() if decoder is None else decoder
        self._port, self._settings, self._clock, self._progress = port, settings, clock, progress
        self._channel = CommandChannel(port, clock, settings.listen_only, progress)
        self._configuration = Configuration(self._channel, settings, clock)
        self._serial, self._paced = serial, paced
        self._identity: dict[int, str] = {}
        self._divisor: int | None = None  # of the configured stream; None if the sensor sends its own
        self._streams: dict[Kind, Stream] = {}
        self._notices: list[Notice] = []
        self._rate_check = RateCheck()
        self._unread = b""
        self._newest_ns, self._garbage, self._silences, self._restarted = 0, 0, 0, False
        self._troubles: set[str] = set()
        self._errors: set[int | None] = set()  # codes that were reported
        self._reset_health(clock())

    # ------------------------------------------------------------------ start and end

    def connect(self) -> DeviceInfo:
        """Find the baud rate of the sensor, identify it and read its settings.

        Raises
        ------
        NotAVn100 : no VN-100 replies.
        OtherSensor : another serial number than `serial`.
        """
        self._channel.find_baud(self._bauds())
        if not self._settings.listen_only:
            self._identify()
        self._reset_health(self._clock())
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
        self._reset_health(self._clock())
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
        valid = self.decoder.messages
        items = self.decoder.feed(data)
        now = self._clock()
        if data:
            self._bytes_at = now
            self._garbage += len(data)
        if self.decoder.messages > valid:
            self._valid_at, self._garbage = now, 0
        for item in items:
            if isinstance(item, SampleBlock):
                self._streams[item.stream.kind] = item.stream
                # samples of another output do not show that the requested one is alive
                if self._divisor is None or item.stream.kind == self._settings.stream:
                    self._on_samples(now)
                self._check_rate(item, now)
                self._check_restart(item)
            elif isinstance(item, SensorError):
                self._on_sensor_error(item)
        return items

    def check_health(self) -> list[Notice]:
        """Check the sensor and repair what can be repaired; call it a few times a second.

        It may take as long as `connect` and `configure` if the sensor must be found again.

        Raises
        ------
        OtherSensor : another serial number replies.
        """
        now = self._clock()
        if now >= self._next_check:
            self._repair(now)
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
        # a sensor of another serial number would be configured, and would continue the record of this one
        serial = self._identity.get(3)
        if self._serial is not None and serial is not None and serial != self._serial:
            message = f"the sensor on {self._port.name} is {serial}, not {self._serial}"
            raise OtherSensor("other_sensor", message, "connect the first one again, or restart imumon")
        self._serial = serial or self._serial

    # ------------------------------------------------------------------ health

    def _reset_health(self, now: float) -> None:
        self._rate_check.restart()
        self._bytes_at = self._valid_at = self._sample_at = self._next_check = now
        self._garbage, self._silences = 0, 0
        self._newest_ns, self._restarted = 0, False

    def _on_samples(self, now: float) -> None:
        """End the troubles: samples of the stream have arrived."""
        if self._troubles or self._silences:
            silent = now - self._sample_at
            self._notices.append(Notice("resumed", f"samples arrive again after {silent:.1f} s"))
            self._rate_check.restart()
        self._sample_at, self._silences = now, 0
        self._troubles.clear()

    def _repair(self, now: float) -> None:
        """Find a trouble, if there is one, and try to repair it: the most specific first."""
        quiet = QUIET_UNKNOWN_S if self._divisor is None else max(QUIET_S, 4 * self._divisor / LOOP_RATE)
        if self._restarted and self._divisor is not None:
            self._reconnect("reconfigured", "the sensor was restarted and is configured again")
        elif now - self._bytes_at > quiet:
            self._break_silence(now)
        elif now - self._valid_at > quiet and self._garbage >= GARBAGE_BYTES:
            if "garbage" in self._troubles:
                self._reconnect("found", "the sensor sends valid messages again")
            else:
                # a bad read of an adapter, where every check fails, ends with a reopened port; a scan is the next step
                self._notice_once("garbage", "bytes arrive, but no valid message: the port is reopened")
                self._port.reopen()
                self._bytes_at = self._valid_at = self._clock()
                self._garbage = 0
        elif now - self._sample_at > quiet and self._divisor is not None:
            self._reconnect("reconfigured", "the sensor had lost its configuration and is configured again")
        elif now - self._sample_at > 2 * quiet:
            self._notice_once("no_samples", "valid messages arrive, but none that can be characterised")

    def _break_silence(self, now: float) -> None:
        """Resume a sensor that was paused; at each eighth call, scan the baud rates."""
        self._silences += 1
        self._next_check = now + QUIET_S
        if self._silences > 2:
            self._notice_once("silent", "nothing arrives from the sensor: check its power and the cable")
        if self._settings.listen_only:
            return
        if self._silences % 8:  # a scan takes ten seconds; a paused sensor answers at once
            self._channel.resume_output()
        else:
            self._reconnect("found", "the sensor replies again")

    def _on_sensor_error(self, error: SensorError) -> None:
        """Report an error of the sensor once: it may repeat a hundred times a second. Unknown codes count as one."""
        code = error.code if error.code in ERRORS else None
        if code not in self._errors:
            self._errors.add(code)
            self._notices.append(Notice("sensor_error", f"the sensor reports an error: {error.text}"))

    def _reconnect(self, kind: str, text: str) -> None:
        """Connect and configure again; if that fails, a later check tries again."""
        # what is pending will not be completed: the scan takes the bytes behind it
        for block in sample_blocks(self.decoder.finish()):
            self.decoder.leave_out("start", len(block))
        self._unread = b""
        before = self._silences, self._restarted
        try:
            self.connect()
            self.save_settings()
            self.configure()
        except DeviceNotFound as error:
            self._silences, self._restarted = before  # a failed scan changes nothing
            self._notice_once("lost", str(error))
            self._next_check = self._clock() + RETRY_S
        else:
            self._notices.append(Notice(kind, text))
            self._troubles.clear()

    def _notice_once(self, kind: str, text: str) -> None:
        """Report a trouble once until samples arrive again."""
        if kind not in self._troubles:
            self._notices.append(Notice(kind, text))
            self._troubles.add(kind)


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
            serial=self._serial,
            progress=lambda text: self.progress(text),
            paced=not self._time_lapse,
        )
