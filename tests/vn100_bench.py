"""A session with the emulated VN-100 on a line in memory, whose time the test sets."""

from __future__ import annotations

import random
from collections.abc import Mapping

from emulated_sensor import FOREIGN_HZ, foreign_message

from imumon.config import DeviceSettings
from imumon.model.samples import Notice, SampleBlock
from imumon.sources.device import DeviceLost
from imumon.sources.ports import BAUD_RATES
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.emulator.command_handler import CommandHandler
from imumon.sources.vn100.emulator.emulator import make_device
from imumon.sources.vn100.vn100_session import Vn100Session

STEP_S = 0.02
RATE = {9600: 5.0, 19200: 10.0, 38400: 25.0}
"""Hz, by the bauds that carry no 40 Hz."""


class Killed(BaseException):
    """End of the process."""


class Bench:
    """A device behind a port in memory; time passes only in `read`."""

    name = "/dev/ttyBench"
    fixed_baud = False

    def __init__(
        self, device: CommandHandler | None = None, *, baud: int = 115200, **settings: object
    ) -> None:
        self.device = device or make_device(EmulatorSettings(seed=1, **settings))  # type: ignore[arg-type]
        self.now = self.device.outputs.tick / 800
        self.baud = baud
        self.written: list[bytes] = []
        self.adapter_can = set(BAUD_RATES)
        self.dead = False
        self.steps_left: int | None = None  # reads and writes until the process is killed
        self.impostor: str | None = None  # a kind of `foreign_message`
        self._count = 0
        self.refuses = b""
        self._line_baud = self.device.baud
        self._noise = random.Random(1)
        self._queue = bytearray()

    def clock(self) -> float:
        return self.now

    def _step(self) -> None:
        if self.steps_left is not None:
            if self.steps_left == 0:
                raise Killed
            self.steps_left -= 1

    def read(self, timeout: float) -> bytes:
        self._step()
        self._live()
        until = self.now + timeout
        while not self._queue and self.now < until:
            self.now = min(until, self.now + STEP_S)
            self._live()
        data = bytes(self._queue)
        self._queue.clear()
        return data

    def _live(self) -> None:
        """Queue the messages that the device has sent by now."""
        sent = [message for _, message in self.device.advance(int(self.now * 800))]
        sent += self.device.replies(self.now)
        if self.impostor is not None:
            first, self._count = self._count, int(self.now * FOREIGN_HZ)
            sent = [foreign_message(self.impostor, number) for number in range(first, self._count)]
        if self.dead:
            return
        for message in sent:
            if self.baud != self._line_baud and self.impostor is None:
                message = self._noise.randbytes(len(message))
            self._queue += message
        self._line_baud = self.device.baud  # a reply has the baud rate of its command

    def write(self, data: bytes) -> None:
        self._step()
        self.written.append(data)
        if self.refuses and self.refuses in data:
            self._queue += b"$VNERR,07*76\r\n"
        elif self.baud == self.device.baud and not (self.dead or self.impostor):
            self.device.receive(data, self.now)

    def set_baud(self, baud: int) -> bool:
        if baud not in self.adapter_can:
            return False
        self.baud = baud
        self._queue.clear()
        return True

    def power_cut(self) -> None:
        """Restart the sensor with its saved registers."""
        self.device.restart(self.now)

    def registers(self) -> dict[int, tuple[str, ...]]:
        """Return the settings of the sensor."""
        return dict(self.device.registers)

    def session(self, settings: DeviceSettings = DeviceSettings(), **more: object) -> Vn100Session:  # noqa: B008
        return Vn100Session(self, settings, self.clock, **more)  # type: ignore[arg-type]

    def streaming(
        self,
        settings: DeviceSettings = DeviceSettings(),  # noqa: B008
        saved: Mapping[str, str] | None = None,
    ) -> Vn100Session:
        session = self.session(settings)
        session.connect()
        session.save_settings(saved)
        session.configure()
        return session

    def run(self, session: Vn100Session, seconds: float) -> tuple[int, list[Notice]]:
        """Return the samples of the stream in this time and the notices, or lose the sensor, as `PortDevice` does."""
        samples, notices, until, alive_at = 0, [], self.now + seconds, self.now
        while self.now < until:
            for item in session.decode(session.read(0.05)):
                if isinstance(item, SampleBlock):
                    alive_at = self.now if session.is_alive(item) else alive_at
                    samples += len(item) * (item.stream.kind == session.info().stream)
            if self.now - alive_at > session.quiet_s:
                raise DeviceLost("device_lost", "no sample arrives")
            notices += session.check_health()
        return samples, notices


def kinds(notices: list[Notice]) -> list[str]:
    return [notice.kind for notice in notices]
