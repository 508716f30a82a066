"""Session: every way in, every mishap on the way, and a sensor left restored settings.

Most tests drive the emulated device over a port in memory on a clock that only reading moves, so that ten
seconds of scanning take none; the rest use the emulator's own process and a real terminal.
"""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from imumon.devices.base import DeviceLost, DeviceNotFound, InvalidOption
from imumon.devices.serial_port import SerialPort
from imumon.devices.vn100.ascii import ERRORS, encode
from imumon.devices.vn100.binary import BinaryLayout
from imumon.devices.vn100.commands import BAUD_RATES, NotAVn100, OtherSensor
from imumon.devices.vn100.decoder import Vn100Decoder
from imumon.devices.vn100.emulator import EmulatorProcess, EmulatorSettings, spawn
from imumon.devices.vn100.emulator.command_handler import CommandHandler
from imumon.devices.vn100.emulator.emulator import make_device
from imumon.devices.vn100.emulator.faults import ForeignDevice
from imumon.devices.vn100.registers import REGISTERS
from imumon.devices.vn100.stream_settings import DIVISORS, alias_factors, divisors, is_ours, output
from imumon.devices.vn100.vn100_session import StreamRequest, Vn100Session
from imumon.samples import DeviceInfo, Notice, SampleBlock

STEP_S = 0.02


class Unplugged(Exception):
    """Exception of a port that has vanished."""


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
        self.dead = self.deaf = self.garbling = self.vanished = False
        self.cured_by_reopening = False
        self.steps_left: int | None = None  # reads and writes until the process is killed
        self.impostor: ForeignDevice | None = None
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
        if self.vanished:
            raise Unplugged
        sent = [message for _, message in self.device.advance(int(self.now * 800))]
        sent += self.device.replies(self.now)
        if self.impostor is not None:
            sent = self.impostor.messages(self.now)
        if self.dead:
            return
        for message in sent:
            if self.baud != self._line_baud and self.impostor is None:
                message = self._noise.randbytes(len(message))
            elif self.garbling:
                message = message[:-4] + bytes([message[-4] ^ 1]) + message[-3:]
            self._queue += message
        self._line_baud = self.device.baud  # a reply has the baud rate of its command

    def write(self, data: bytes) -> None:
        if self.vanished:
            raise Unplugged
        self._step()
        self.written.append(data)
        if self.refuses and self.refuses in data:
            self._queue += b"$VNERR,07*76\r\n"
        elif self.baud == self.device.baud and not (self.deaf or self.dead or self.impostor):
            self.device.receive(data, self.now)

    def set_baud(self, baud: int) -> bool:
        if baud not in self.adapter_can:
            return False
        self.baud = baud
        self._queue.clear()
        return True

    def reopen(self) -> None:
        self._queue.clear()
        if self.cured_by_reopening:
            self.garbling = False

    def power_cut(self) -> None:
        """Restart the sensor with its saved registers."""
        self.device.restart(self.now)

    def registers(self) -> dict[tuple[int, int], tuple[str, ...]]:
        """Return the settings of the sensor for both of its ports."""
        memory = self.device.registers
        return {(r, p): memory.read(r, p) for r in REGISTERS if r in memory for p in (1, 2)}

    def session(self, request: StreamRequest = StreamRequest(), **more: object) -> Vn100Session:  # noqa: B008
        return Vn100Session(self, request, self.clock, **more)  # type: ignore[arg-type]

    def streaming(self, request: StreamRequest = StreamRequest()) -> Vn100Session:  # noqa: B008
        session = self.session(request)
        session.connect()
        session.save_settings()
        session.configure()
        return session

    def run(self, session: Vn100Session, seconds: float) -> tuple[int, list[Notice]]:
        """Return the number of samples of the stream in this time, and the notices."""
        samples, notices, until = 0, [], self.now + seconds
        while self.now < until:
            for item in session.decode(session.read(0.05)):
                if isinstance(item, SampleBlock) and item.stream.kind == session.info().stream:
                    samples += len(item)
            notices += session.check_health()
        return samples, notices


def kinds(notices: list[Notice]) -> list[str]:
    return [notice.kind for notice in notices]


# ---------------------------------------------------------------------- connection


RATE = {9600: 5.0, 19200: 10.0, 38400: 25.0}


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_first_connection_finds_every_baud_and_streams_at_the_highest_rate(baud: int) -> None:
    bench = Bench(make_device(EmulatorSettings(seed=1, baud=baud, rate=RATE.get(baud, 40.0))))
    session = bench.session()
    info = session.connect()
    assert bench.now < 10.0
    assert (info.id, info.model, info.serial) == ("vn100-0100056785", "VN-100T-CR", "0100056785")
    assert (info.firmware, info.baud) == ("3.1.0.0", baud)
    info = session.configure()
    assert bench.baud == baud, "the baud rate is raised on request only"
    assert (info.stream, info.alias_factor, info.caveats) == ("deltas", 1.0, ())
    assert info.sample_rate_hz is not None
    begun = bench.now
    samples, notices = bench.run(session, 4.0)
    assert notices == []
    assert samples == pytest.approx((bench.now - begun) * info.sample_rate_hz, abs=3)
    assert info.sample_rate_hz * 64 <= 0.6 * baud / 10


def test_each_wrong_baud_takes_less_than_half_a_second() -> None:
    took = []
    for baud in BAUD_RATES:
        bench = Bench(make_device(EmulatorSettings(seed=1, baud=baud, rate=RATE.get(baud, 40.0))))
        begun = bench.now
        bench.session().connect()
        took.append(bench.now - begun)
    assert all(t - took[0] < 0.5 * wrong for wrong, t in enumerate(took) if wrong)


def test_default_stream_is_a_hundred_hertz_at_the_factory_baud() -> None:
    bench = Bench()
    info = bench.streaming().info()
    assert info.sample_rate_hz == 100.0
    assert (info.source, info.clock) == ("binary 05:0001,00F2", "startup")
    assert info.settings["75 binary output 1"] == "1,8,05,0001,00F2"


@pytest.mark.parametrize("rate", [0.0, 1.0, 200.0])
@pytest.mark.parametrize("firmware", ["2.1.0.0", "3.1.0.0"])
def test_stream_does_not_depend_on_the_previous_output(rate: float, firmware: str) -> None:
    device = make_device(EmulatorSettings(seed=1, baud=460800, rate=rate, firmware=firmware))
    bench = Bench(device)
    samples, _ = bench.run(bench.streaming(), 1.0)
    assert samples >= 395


def test_paused_sensor_is_found_and_resumed() -> None:
    bench = Bench()
    bench.write(b"$VNASY,0*XX\r\n")
    bench.read(0.1)
    assert bench.read(1.0) == b""
    samples, _ = bench.run(bench.streaming(), 1.0)
    assert samples >= 95


def test_garbage_in_the_input_buffer_does_not_disturb_the_first_request() -> None:
    bench = Bench(rate=0.0)
    bench.write(b"\x00\xff$VNRRG,0")
    assert bench.session().connect().model == "VN-100T-CR"


def test_only_the_configured_baud_is_tried() -> None:
    bench = Bench()
    with pytest.raises(NotAVn100) as refused:
        bench.session(StreamRequest(baud=9600)).connect()
    assert refused.value.code == "device_sends_garbage"
    assert bench.session(StreamRequest(baud=115200)).connect().baud == 115200


def test_the_requested_output_rate_is_set_and_the_change_is_said() -> None:
    bench = Bench()
    session = bench.streaming(StreamRequest(set_rate_hz=50.0))
    samples, _ = bench.run(session, 2.0)
    assert session.info().sample_rate_hz == 50.0
    assert samples == pytest.approx(100, abs=5)
    changed = "the sensor sends binary at 50 Hz now; ASCII at 40 Hz is restored at the end"
    assert session.changes() == changed
    assert session.restore()
    assert session.changes() is None


@pytest.mark.parametrize("rate", [70.0, 200.0])
def test_an_output_rate_that_is_not_possible_is_refused(rate: float) -> None:
    bench = Bench()
    with pytest.raises(InvalidOption, match=r"at 115200 baud: give --set-rate one of 1, 2, .*, 100, or"):
        bench.streaming(StreamRequest(set_rate_hz=rate))
    assert bench.streaming(StreamRequest(set_rate_hz=200.0, set_baud=230400)).info().sample_rate_hz == 200.0


def test_unsupported_baud_is_skipped_or_an_error() -> None:
    bench = Bench(baud=9600)
    bench.adapter_can = {9600, 115200}
    assert bench.session().connect().baud == 115200
    with pytest.raises(DeviceNotFound) as refused:
        bench.session(StreamRequest(baud=921600)).connect()
    assert refused.value.code == "baud_unsupported"
    session = bench.session(StreamRequest(set_baud=921600))
    session.connect()
    with pytest.raises(DeviceNotFound) as refused:
        session.configure()
    assert refused.value.code == "baud_unsupported"
    assert bench.device.baud == 115200


@pytest.mark.parametrize("serial_port", [1, 2])
def test_both_ports_of_the_sensor_work(serial_port: int) -> None:
    bench = Bench(serial_port=serial_port)
    samples, _ = bench.run(bench.streaming(), 1.0)
    assert samples >= 95
    assert bench.device.registers.read(75)[0] == str(serial_port)


def test_the_other_port_keeps_its_stream() -> None:
    bench = Bench()
    bench.device.set_register(76, "3", "80", "01", "0001")
    session = bench.streaming()
    assert bench.device.registers.read(76) == ("2", "80", "01", "0001")
    assert session.restore()
    assert bench.device.registers.read(76) == ("3", "80", "01", "0001")


@pytest.mark.parametrize("family", ["VN-110", "VN-200", "VN-210", "VN-300", "VN-310"])
def test_another_model_has_its_own_name_and_a_remark(family: str) -> None:
    bench = Bench(model=f"{family}T-CR")
    info = bench.streaming().info()
    assert (info.model, info.kind) == (f"{family}T-CR", family)
    assert info.id == f"{family.lower().replace('-', '')}-0100056785"
    assert any(f"{family}T-CR" in remark for remark in info.remarks)


def test_packets_of_another_model_are_no_garbage() -> None:
    """GNSS and INS: groups 4, 6 and 7."""
    decoder = Vn100Decoder()
    layouts = [
        BinaryLayout.of({4: 0x0FFF}),
        BinaryLayout.of({6: 0x07FF}),
        BinaryLayout.of({1: 0x0441, 7: 0x0001}),
    ]
    data = b"".join(layout.encode({layout.fields[0]: np.zeros(20)}) for layout in layouts)
    decoder.feed(data)
    assert (decoder.messages, decoder.discarded) == (60, 0)


# ---------------------------------------------------------------------- other devices


@pytest.mark.parametrize(
    ("kind", "code"),
    [("silent", "device_silent"), ("nmea", "device_sends_nmea"), ("garbage", "device_sends_garbage")],
)
@pytest.mark.parametrize("listen_only", [False, True])
def test_another_device_is_refused_with_a_code_for_its_bytes(kind: str, code: str, listen_only: bool) -> None:
    bench = Bench()
    bench.impostor = ForeignDevice(kind, 0.0)
    tried: list[str] = []
    with pytest.raises(NotAVn100) as refused:
        bench.session(StreamRequest(listen_only=listen_only), progress=tried.append).connect()
    assert refused.value.code == code
    assert refused.value.cure
    assert "\n" not in str(refused.value)
    assert bench.now < (13.0 if listen_only else 10.0)
    assert tried
    assert listen_only == (not bench.written)


class Thermometer(ForeignDevice):
    """Ten lines of text per second."""

    def messages(self, now: float) -> list[bytes]:
        first, self._count = self._count, int(now * 10)
        return [b"temp=21.5C humidity=40% ok\r\n"] * (self._count - first)


def test_other_text_is_shown() -> None:
    bench = Bench()
    bench.impostor = Thermometer("silent", 0.0)
    with pytest.raises(NotAVn100) as error:
        bench.session().connect()
    assert error.value.code == "device_sends_text"
    assert "humidity=40%" in error.value.message


def test_interrupted_transmit_wire_has_its_own_code() -> None:
    bench = Bench()
    bench.deaf = True
    with pytest.raises(NotAVn100) as refused:
        bench.session().connect()
    assert refused.value.code == "device_receives_nothing"


def test_exception_of_a_vanished_port_passes_through() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.vanished = True
    with pytest.raises(Unplugged):
        session.decode(session.read(0.1))


# ---------------------------------------------------------------------- requested stream


@pytest.mark.parametrize("stream", ["uncompensated", "compensated"])
@pytest.mark.parametrize("baud", [9600, 115200, 921600])
def test_readings_are_averaged_over_their_interval(stream: str, baud: int) -> None:
    bench = Bench(make_device(EmulatorSettings(seed=1, baud=baud, rate=RATE.get(baud, 40.0))))
    session = bench.streaming(StreamRequest(stream=stream))  # type: ignore[arg-type]
    info = session.info()
    assert info.stream == stream
    assert info.alias_factor == 1.0
    assert info.sample_rate_hz == {9600: 8.0, 115200: 100.0, 921600: 800.0}[baud]
    assert (info.caveats == ("compensated",)) == (stream == "compensated")
    assert int(bench.device.registers.read(85)[1]) == 800 / info.sample_rate_hz
    samples, notices = bench.run(session, 1.0)
    assert samples >= info.sample_rate_hz - 3
    assert notices == []


def test_compensated_deltas_are_switched_to_uncompensated() -> None:
    bench = Bench()
    bench.device.set_register(82, "0", "1", "1", "0", "0")
    session = bench.streaming()
    assert bench.device.registers.read(82) == ("0", "0", "0", "0", "0")
    assert session.restore()
    assert bench.device.registers.read(82) == ("0", "1", "1", "0", "0")


def test_set_baud_raises_the_baud_and_restore_lowers_it() -> None:
    bench = Bench()
    session = bench.streaming(StreamRequest(set_baud=921600))
    assert bench.baud == bench.device.baud == 921600
    assert session.info().sample_rate_hz == 800.0
    samples, _ = bench.run(session, 1.0)
    assert samples >= 795
    assert session.restore()
    assert bench.baud == bench.device.baud == 115200


def test_too_little_bandwidth_lowers_the_rate_with_a_remark(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.devices.vn100.stream_settings.LOAD", 1.6)
    bench = Bench()
    session = bench.streaming()
    info = session.info()
    assert info.sample_rate_hz == 160.0
    assert "the sensor refused a higher rate at this baud rate" in info.remarks
    samples, _ = bench.run(session, 1.0)
    assert samples >= 155


def test_without_binary_outputs_the_sentences_are_used() -> None:
    for before, source in (("14", "$VNYMR"), ("0", "$VNIMU")):
        bench = Bench()
        bench.device.set_register(6, before)
        bench.refuses = b"$VNWRG,75,1"
        session = bench.streaming()
        samples, _ = bench.run(session, 1.0)
        info = session.info()
        assert samples >= 38
        assert (info.source, info.sample_rate_hz) == (source, 40.0)
        assert info.alias_factor == pytest.approx(5**0.5)
        assert any("the binary stream does not arrive" in remark for remark in info.remarks)


@pytest.mark.parametrize(
    ("binary", "stream"), [(None, "compensated"), (("1", "8", "06", "0001", "00C0"), "deltas")]
)
def test_listen_only_writes_nothing_and_reports_unknown_values(
    binary: tuple[str, ...] | None, stream: str
) -> None:
    bench = Bench()
    if binary is not None:
        bench.device.set_register(75, *binary)
    before = bench.registers()
    session = bench.session(StreamRequest(listen_only=True, rate_hz=40.0 if binary is None else None))
    assert session.connect().model is None
    assert session.save_settings() == {}
    session.configure()
    samples, _ = bench.run(session, 1.0)
    assert samples >= 38
    info = session.info()
    assert (info.id, info.stream) == ("vn100-ttybench", stream)
    assert info.alias_factor == (None if stream == "compensated" else 1.0)
    assert any("listen-only" in remark for remark in info.remarks)
    assert any("aliasing" in remark for remark in info.remarks) == (stream == "compensated")
    assert info.sample_rate_hz == (40.0 if binary is None else None)
    assert session.restore()
    assert bench.written == []
    assert bench.registers() == before


def listening(*binary: str, register: tuple[str, ...] = (), **options: object) -> DeviceInfo:
    """Return the device information after one second of a stream, listen-only or with `register` as 82."""
    bench = Bench()
    bench.device.set_register(75, *binary)
    if register:
        bench.device.set_register(82, *register)
    session = bench.session(StreamRequest(listen_only=not register, **options))  # type: ignore[arg-type]
    session.connect()
    bench.run(session, 1.0)
    return session.info()


def test_only_increments_are_free_of_aliasing() -> None:
    info = listening("1", "8", "04", "0044")  # delta theta, uncompensated acceleration
    assert info.stream == "uncompensated"
    assert info.alias_factors == {"gyro": 1.0, "accel": None}
    assert info.alias_factor is None
    assert any("aliasing" in remark for remark in info.remarks)
    info = listening("1", "8", "04", "0044", register=("0", "0", "0", "0", "0"))
    assert info.alias_factors["gyro"] == 1.0
    assert info.alias_factor == info.alias_factors["accel"] == pytest.approx(2**0.5)
    assert "aliased" in info.caveats


def test_deltas_are_uncompensated_only_if_register_82_is_known() -> None:
    assert "unknown_compensation" in listening("1", "8", "06", "0001", "00C0").caveats
    for register, caveats in ((("0", "1", "1", "0", "0"), ("compensated",)), (("0",) * 5, ())):
        info = listening("1", "8", "06", "0001", "00C0", register=register)
        assert info.caveats == caveats
    assert listening("1", "8", "04", "000C").caveats == ()


@pytest.mark.parametrize(("rate", "correct"), [(40.0, True), (39.8, True), (38.0, False), (80.0, False)])
def test_configured_rate_is_compared_with_the_host_clock(rate: float, correct: bool) -> None:
    bench = Bench()
    session = bench.session(StreamRequest(listen_only=True, rate_hz=rate))
    session.connect()
    bench.run(session, 4.0)
    assert not any("samples arrive at" in remark for remark in session.info().remarks)
    bench.run(session, 26.0)
    texts = [remark for remark in session.info().remarks if "samples arrive at" in remark]
    assert bool(texts) != correct
    assert all(
        re.match(rf"samples arrive at (39|40)[.\d]* Hz, not at the configured {rate:g} Hz", text)
        for text in texts
    )
    assert session.info() == session.info(), "the remark stays the same"


def test_rate_is_not_compared_in_time_lapse() -> None:
    bench = Bench()
    session = bench.session(StreamRequest(listen_only=True, rate_hz=80.0), paced=False)
    session.connect()
    bench.run(session, 10.0)
    assert not any("samples arrive at" in remark for remark in session.info().remarks)


# ---------------------------------------------------------------------- faults


def test_restarted_sensor_is_configured_again() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.run(session, 1.0)
    bench.power_cut()
    samples, notices = bench.run(session, 5.0)
    assert "reconfigured" in kinds(notices)
    assert samples > 200
    samples, notices = bench.run(session, 1.0)
    assert samples >= 95
    assert notices == []
    assert session.restore()
    assert bench.device.registers.read(6) == ("14",)


def test_restarted_sensor_with_the_same_saved_stream_is_configured_again() -> None:
    bench = Bench()
    for words in (b"06,0", b"75,1,8,05,0001,00F2", b"82,0,1,1,0,0"):
        bench.device.receive(b"$VNWRG,%b*XX\r\n" % words, bench.now)
    bench.device.receive(b"$VNWNV*XX\r\n", bench.now)
    session = bench.streaming()
    assert bench.run(session, 2.0)[1] == []
    bench.power_cut()
    _, notices = bench.run(session, 3.0)
    assert kinds(notices) == ["reconfigured"]
    assert bench.device.registers.read(82) == ("0", "0", "0", "0", "0"), "the deltas are uncompensated again"
    assert bench.run(session, 1.0)[1] == []


@pytest.mark.parametrize("flash", [9600, 460800])
def test_other_baud_after_a_power_interruption_is_found(flash: int) -> None:
    bench = Bench(make_device(EmulatorSettings(seed=1, baud=flash, rate=RATE.get(flash, 40.0))))
    session = bench.streaming(StreamRequest(set_baud=115200))
    assert bench.baud == 115200
    bench.run(session, 0.5)
    bench.power_cut()
    samples, notices = bench.run(session, 14.0)
    assert "found" in kinds(notices) or "reconfigured" in kinds(notices)
    assert samples >= 95
    assert bench.baud == 115200, "the requested baud rate is set again"


def test_paused_sensor_is_resumed_during_the_stream() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.device.receive(b"$VNASY,0*XX\r\n", bench.now)
    samples, notices = bench.run(session, 3.0)
    assert samples >= 100
    assert kinds(notices) == ["resumed"]


def test_one_second_of_bad_checksums_reopens_the_port() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.garbling = bench.cured_by_reopening = True
    samples, notices = bench.run(session, 4.0)
    assert kinds(notices) == ["garbage", "resumed"]
    assert samples >= 200


def test_lasting_bad_checksums_give_one_notice() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.garbling = True
    _, notices = bench.run(session, 25.0)
    assert kinds(notices).count("garbage") <= 1
    assert kinds(notices).count("lost") <= 1
    bench.garbling = False
    samples, notices = bench.run(session, 20.0)
    assert samples > 100
    assert bench.run(session, 1.0)[0] >= 95


def test_silence_and_its_end_give_one_notice_each() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.dead = True
    _, notices = bench.run(session, 25.0)
    assert kinds(notices).count("silent") == 1
    bench.dead = False
    _, notices = bench.run(session, 12.0)
    assert bench.run(session, 1.0)[0] >= 95
    assert {"resumed", "found", "reconfigured"} & set(kinds(notices))
    assert "garbage" not in kinds(notices), "the port keeps the baud rate of the sensor"


def test_sensor_errors_give_notices() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.device.receive(b"$VNXXX*XX\r\n", bench.now)
    _, notices = bench.run(session, 0.5)
    assert kinds(notices) == ["sensor_error"]
    assert "invalid command" in notices[0].text


def test_repeated_sensor_error_gives_one_notice_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.devices.vn100.vn100_session.ERROR_NOTICE_S", 5.0)
    bench = Bench()
    session, notices = bench.streaming(), []
    for _ in range(70):
        bench.device.receive(b"$VNXXX*XX\r\n", bench.now)
        notices += bench.run(session, 0.1)[1]
    assert kinds(notices) == ["sensor_error"] * 2
    assert re.search(r"\d+ more", notices[1].text)


def test_unknown_sensor_errors_count_as_one() -> None:
    bench = Bench()
    session, notices = bench.streaming(), []
    for code in sorted(set(range(256)) - set(ERRORS)):
        bench._queue += encode(f"VNERR,{code:02X}")
        notices += bench.run(session, 0.04)[1]
    assert kinds(notices) == ["sensor_error"]


def test_another_sensor_on_the_same_port_is_refused() -> None:
    bench = Bench()
    with pytest.raises(OtherSensor) as error:
        bench.session(serial="0100000001").connect()
    assert error.value.code == "other_sensor"
    assert all(serial in error.value.message for serial in ("0100056785", "0100000001"))
    session = bench.streaming()
    bench.device = make_device(EmulatorSettings(seed=2, serial="0100000002"))
    bench.device.advance(int(bench.now * 800))
    with pytest.raises(OtherSensor) as error:
        bench.run(session, 5.0)
    assert error.value.code == "other_sensor"


def test_lossy_line_is_usable() -> None:
    bench = Bench()
    live, noise = bench._live, random.Random(3)

    def lossy() -> None:
        live()
        for at in range(len(bench._queue)):
            if noise.random() < 1e-3:
                bench._queue[at] ^= 1 << noise.randrange(8)

    bench._live = lossy  # type: ignore[method-assign]
    session = bench.streaming()
    assert session.info().stream == "deltas"
    assert bench.run(session, 4.0)[0] > 300


def test_flash_is_not_written_and_the_sensor_is_not_reset() -> None:
    bench = Bench()
    session = bench.streaming(StreamRequest(set_baud=230400))
    bench.run(session, 1.0)
    bench.power_cut()
    bench.run(session, 4.0)
    session.restore()
    allowed = {b"$VNRRG", b"$VNWRG", b"$VNASY"}
    assert {command[:6] for command in bench.written} == allowed


# ---------------------------------------------------------------------- restored settings


def _random_settings(dice: random.Random) -> CommandHandler:
    """Return a device with random settings."""
    baud = dice.choice((115200, 230400, 921600))
    device = make_device(EmulatorSettings(seed=1, baud=baud, serial_port=dice.choice((1, 2))))
    device.set_register(6, dice.choice(("0", "14", "19", "1")))
    device.set_register(7, dice.choice(("1", "20", "40")))
    device.set_register(82, "0", dice.choice("01"), dice.choice("01"), "0", "0")
    device.set_register(
        85,
        "0",
        *(dice.choice(("0", "1", "4", "20")) for _ in range(4)),
        *(dice.choice("0123") for _ in range(5)),
    )
    for register in (75, 76, 77):
        if dice.random() < 0.4:
            device.set_register(register, dice.choice("0123"), dice.choice(("80", "40")), "01", "0129")
    return device


@pytest.mark.parametrize("seed", range(12))
def test_restore_restores_every_register(seed: int) -> None:
    dice = random.Random(seed)
    bench = Bench(_random_settings(dice))
    before = bench.registers()
    stream = dice.choice(("deltas", "uncompensated", "compensated"))
    session = bench.streaming(StreamRequest(stream=stream, set_baud=dice.choice((None, 460800))))  # type: ignore[arg-type]
    assert bench.registers() != before
    bench.run(session, 0.5)
    assert session.restore()
    assert bench.registers() == before
    assert session.restore(), "a second call writes nothing"


@pytest.mark.parametrize("seed", range(4))
def test_settings_are_restored_after_a_kill_at_any_moment(seed: int) -> None:
    """The same session restores them after an interruption, the next one after a kill."""
    dice = random.Random(100 + seed)
    original = _random_settings(dice)
    request = StreamRequest(
        stream=dice.choice(("deltas", "uncompensated")), set_baud=dice.choice((None, 460800))
    )  # type: ignore[arg-type]
    before = Bench(original).registers()
    for steps in range(seed % 3, 1000, 3):
        for killed in (True, False):
            bench = Bench(original)
            session = bench.session(request)
            session.connect()
            saved = session.save_settings()
            bench.steps_left = steps
            try:
                session.configure()
                finished = True
            except Killed:
                finished = False
            bench.steps_left = None
            if killed:
                session = bench.session(request)
                session.connect()
                session.save_settings(saved)
                session.configure()
                assert bench.run(session, 0.3)[0] > 10
            assert session.restore()
            assert bench.registers() == before, f"ended at step {steps}"
        if finished:
            return
    raise AssertionError("the set-up never ended")


def test_settings_of_a_killed_process_are_restored_without_saved_settings() -> None:
    for stream in ("deltas", "uncompensated"):
        bench = Bench()
        before = bench.registers()
        bench.streaming(StreamRequest(stream=stream))  # type: ignore[arg-type]
        assert bench.registers() != before
        second = bench.streaming()
        assert second.restore()
        assert bench.registers() == before, "the factory settings"


def test_old_saved_settings_do_not_undo_later_changes_of_the_user() -> None:
    bench = Bench()
    saved = bench.session().connect() and {
        "5": "9600",
        "6": "19",
        "75": "1,80,01,0129",
        "85": "0,9,9,9,0,0,3,3,3,0",
    }
    bench.device.set_register(85, "0", "3", "5", "4", "0", "0", "3", "3", "3", "0")
    before = bench.registers()
    session = bench.session()
    session.connect()
    session.save_settings(saved)
    session.configure()
    assert session.restore()
    assert bench.registers() == before


def test_restore_without_a_sensor_ends_soon() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.dead = True
    begun = bench.now
    assert not session.restore()
    assert bench.now - begun < 1.0


# ---------------------------------------------------------------------- alias factors and streams


def test_alias_factors_follow_the_definition() -> None:
    factory = "0,4,4,4,0,0,3,3,3,0"
    for rate, factor in {20.0: 10**0.5, 40.0: 5**0.5, 100.0: 2**0.5, 200.0: 1.0, 800.0: 1.0}.items():
        for kind in ("compensated", "uncompensated"):
            assert alias_factors(kind, rate, factory) == pytest.approx({"gyro": factor, "accel": factor})  # type: ignore[arg-type]
        assert set(alias_factors("deltas", rate, factory).values()) == {1.0}
    apart = alias_factors("uncompensated", 40.0, "0,20,4,4,0,0,3,3,3,0")
    assert apart == pytest.approx({"accel": 1.0, "gyro": 5**0.5})
    off = alias_factors("compensated", 40.0, "0,20,20,4,0,0,1,1,1,0")
    assert off == pytest.approx({"accel": 20**0.5, "gyro": 20**0.5}), (
        "the window is for uncompensated readings"
    )
    for rate, text in ((None, factory), (40.0, None), (40.0, "nonsense")):
        assert set(alias_factors("compensated", rate, text).values()) == {None}


def test_requested_streams_fit_the_baud_and_are_recognised() -> None:
    for kind in ("deltas", "uncompensated", "compensated"):
        assert all(is_ours(output(kind, divisor, mode)) for divisor in DIVISORS for mode in (1, 2))  # type: ignore[arg-type]
        for baud in BAUD_RATES:
            fastest = divisors(kind, baud)[0]  # type: ignore[arg-type]
            assert 60 * 800 / fastest <= 0.6 * baud / 10


# ---------------------------------------------------------------------- emulator process


@pytest.fixture
def emulator() -> Iterator[EmulatorProcess]:
    with spawn(EmulatorSettings(seed=1)) as running:
        yield running


def live(session: Vn100Session, seconds: float, enough: int) -> int:
    """Samples until there are enough, or so long."""
    count, until = 0, time.monotonic() + seconds
    while count < enough and time.monotonic() < until:
        for item in session.decode(session.read(0.1)):
            count += len(item) if isinstance(item, SampleBlock) else 0
        session.check_health()
    return count


@pytest.mark.parametrize("baud", [115200, 921600, 230400])
def test_first_connection_on_a_terminal(baud: int) -> None:
    with spawn(EmulatorSettings(seed=1, baud=baud)) as running, SerialPort(running.path) as port:
        session = Vn100Session(port, StreamRequest(), time.monotonic)
        session.connect()
        session.configure()
        assert live(session, 3.0, 50) >= 50
        fd = os.open(running.path, os.O_RDWR | os.O_NOCTTY)
        assert termios.tcgetattr(fd)[5] == getattr(termios, f"B{baud}")
        os.close(fd)
        assert session.decoder.bad_checksums == session.decoder.discarded == 0
        assert session.restore()


def test_replugged_sensor_under_another_name(tmp_path: Path) -> None:
    link = tmp_path / "sensor"
    with spawn(EmulatorSettings(seed=1, link=str(link))) as running:
        with SerialPort(str(link)) as port:
            session = Vn100Session(port, StreamRequest(), time.monotonic)
            serial = session.connect().serial
            saved = session.save_settings()
            session.configure()
            assert live(session, 3.0, 20) >= 20
            first = os.path.realpath(link)
            running.ask("unplug")
            with pytest.raises(DeviceLost):
                live(session, 5.0, 10**6)
        taken = []  # the old name must be taken: another process may have freed a lower one
        while not os.path.exists(first):
            taken.append(os.open("/dev/ptmx", os.O_RDWR | os.O_NOCTTY))
        running.ask("replug")
        assert os.path.realpath(link) != first
        with SerialPort(str(link)) as port:
            again = Vn100Session(
                port, StreamRequest(), time.monotonic, decoder=session.decoder, serial=serial
            )
            again.connect()
            again.save_settings(saved)
            again.configure()
            assert live(again, 3.0, 20) >= 20
            assert again.restore()
        for terminal in taken:
            os.close(terminal)


def test_reboot_on_a_terminal(emulator: EmulatorProcess) -> None:
    with SerialPort(emulator.path) as port:
        session = Vn100Session(port, StreamRequest(), time.monotonic)
        session.connect()
        session.configure()
        assert live(session, 3.0, 20) >= 20
        emulator.ask("reboot")
        notices: list[Notice] = []
        until = time.monotonic() + 8.0
        while "reconfigured" not in kinds(notices) and time.monotonic() < until:
            session.decode(session.read(0.1))
            notices += session.check_health()
        assert "reconfigured" in kinds(notices)
        assert live(session, 3.0, 50) >= 50


def test_settings_of_a_killed_process_are_restored(emulator: EmulatorProcess) -> None:
    code = """
import sys, time
from imumon.devices.vn100.vn100_session import StreamRequest, Vn100Session
from imumon.devices.serial_port import SerialPort
session = Vn100Session(SerialPort(sys.argv[1]), StreamRequest(), time.monotonic)
session.connect(); session.save_settings(); session.configure()
print("streaming", flush=True)
while True:
    session.read(1.0)
"""
    command = [sys.executable, "-c", code, emulator.path]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as victim:
        assert victim.stdout is not None
        assert victim.stdout.readline() == b"streaming\n"
        victim.send_signal(signal.SIGKILL)
    with SerialPort(emulator.path) as port:
        session = Vn100Session(port, StreamRequest(), time.monotonic)
        assert session.connect().settings["6 async data output type"] == "0"
        assert session.save_settings()["6"] == "14"
        session.configure()
        assert live(session, 3.0, 20) >= 20
        assert session.restore()
        after = Vn100Session(port, StreamRequest(), time.monotonic).connect()
        assert after.settings["6 async data output type"] == "14"
        assert after.settings["75 binary output 1"] == "0,0,00"
