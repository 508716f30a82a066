"""Laws of a session with a VN-100: connection, other devices and the requested stream."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest
from faulty_sensor import spawn
from vn100_bench import RATE, Bench, Killed, kinds

from imumon.config import DeviceSettings
from imumon.model.samples import DeviceInfo
from imumon.sources.device import DeviceError, DeviceLost, DeviceNotFound, DeviceOptions, InvalidOption
from imumon.sources.ports import BAUD_RATES
from imumon.sources.vn100.commands import NotAVn100
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.emulator.command_handler import CommandHandler
from imumon.sources.vn100.emulator.emulator import make_device
from imumon.sources.vn100.stream_settings import alias_factors
from imumon.sources.vn100.vn100_session import Vn100Device

# ---------------------------------------------------------------------- connection


@pytest.mark.few
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
    begun = bench.now
    samples, notices = bench.run(session, 4.0)
    assert notices == []
    assert samples == pytest.approx((bench.now - begun) * info.sample_rate_hz, abs=3)
    assert info.sample_rate_hz * 64 <= 0.6 * baud / 10


def test_the_requested_output_rate_is_set_and_the_change_is_said() -> None:
    bench = Bench()
    session = bench.streaming(DeviceSettings(set_rate_hz=50.0))
    samples, _ = bench.run(session, 2.0)
    assert session.info().sample_rate_hz == 50.0
    assert samples == pytest.approx(100, abs=5)
    changed = "the sensor sends binary at 50 Hz now; ASCII at 40 Hz is restored at the end"
    assert session.changes() == changed
    assert session.restore()
    assert session.changes() is None


@pytest.mark.parametrize(("rate", "baud"), [(70.0, None), (200.0, 230400), (400.0, 460800)])
def test_an_output_rate_that_is_not_possible_is_refused(rate: float, baud: int | None) -> None:
    """The cure names the lowest baud rate with which the rate is possible, if there is one."""
    bench = Bench()
    with pytest.raises(InvalidOption) as error:
        bench.streaming(DeviceSettings(set_rate_hz=rate))
    assert "at 115200 baud: set device.set_rate_hz to one of 1, 2, " in str(error.value)
    assert str(error.value).partition(", 100")[2] == (f", or --set-baud {baud}" if baud else "")
    if baud:
        settings = DeviceSettings(set_rate_hz=rate, set_baud=baud)
        assert bench.streaming(settings).info().sample_rate_hz == rate


def test_unsupported_baud_is_skipped_or_an_error() -> None:
    bench = Bench(baud=9600)
    bench.adapter_can = {9600, 115200}
    assert bench.session().connect().baud == 115200
    with pytest.raises(DeviceNotFound) as refused:
        bench.session(DeviceSettings(baud=921600)).connect()
    assert refused.value.code == "baud_unsupported"
    session = bench.session(DeviceSettings(set_baud=921600))
    session.connect()
    with pytest.raises(DeviceNotFound) as refused:
        session.configure()
    assert refused.value.code == "baud_unsupported"
    assert bench.device.baud == 115200


@pytest.mark.parametrize(
    ("kind", "code"),
    [("silent", "device_silent"), ("nmea", "device_sends_text"), ("garbage", "device_sends_garbage")],
)
@pytest.mark.parametrize("listen_only", [False, True])
def test_another_device_is_refused_with_a_code_for_its_bytes(kind: str, code: str, listen_only: bool) -> None:
    bench = Bench()
    bench.impostor = kind
    tried: list[str] = []
    with pytest.raises(NotAVn100) as refused:
        bench.session(DeviceSettings(listen_only=listen_only), progress=tried.append).connect()
    assert refused.value.code == code
    assert refused.value.cure
    assert "\n" not in str(refused.value)
    assert bench.now < (13.0 if listen_only else 10.0)
    assert tried
    assert listen_only == (not bench.written)


# ---------------------------------------------------------------------- requested stream


@pytest.mark.few
@pytest.mark.parametrize("stream", ["uncompensated", "compensated"])
@pytest.mark.parametrize("baud", [9600, 115200, 921600])
def test_readings_are_averaged_over_their_interval(stream: str, baud: int) -> None:
    bench = Bench(make_device(EmulatorSettings(seed=1, baud=baud, rate=RATE.get(baud, 40.0))))
    session = bench.streaming(DeviceSettings(stream=stream))  # type: ignore[arg-type]
    info = session.info()
    assert info.stream == stream
    assert info.alias_factor == 1.0
    assert info.sample_rate_hz == {9600: 8.0, 115200: 100.0, 921600: 800.0}[baud]
    assert (info.caveats == ("compensated",)) == (stream == "compensated")
    assert int(bench.device.registers[85][1]) == 800 / info.sample_rate_hz
    samples, notices = bench.run(session, 1.0)
    assert samples >= info.sample_rate_hz - 3
    assert notices == []


def test_too_little_bandwidth_lowers_the_rate_with_a_remark(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.sources.vn100.stream_settings.LOAD", 1.6)
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


@pytest.mark.few
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
    session = bench.session(DeviceSettings(listen_only=True, rate_hz=40.0 if binary is None else 0.0))
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
    session = bench.session(DeviceSettings(listen_only=not register, **options))  # type: ignore[arg-type]
    session.connect()
    bench.run(session, 1.0)
    return session.info()


def test_deltas_are_uncompensated_only_if_register_82_is_known() -> None:
    assert "unknown_compensation" in listening("1", "8", "06", "0001", "00C0").caveats
    for register, caveats in ((("0", "1", "1", "0", "0"), ("compensated",)), (("0",) * 5, ())):
        info = listening("1", "8", "06", "0001", "00C0", register=register)
        assert info.caveats == caveats
    assert listening("1", "8", "04", "000C").caveats == ()


@pytest.mark.few
@pytest.mark.parametrize(("rate", "correct"), [(40.0, True), (39.8, True), (38.0, False), (80.0, False)])
def test_configured_rate_is_compared_with_the_host_clock(rate: float, correct: bool) -> None:
    bench = Bench()
    session = bench.session(DeviceSettings(listen_only=True, rate_hz=rate))
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


def factors_of(kind: str, rate: float | None, filtering: str | None) -> dict[str, float | None]:
    return alias_factors(lambda _: kind, rate, filtering)  # type: ignore[arg-type,return-value]


def test_alias_factors_follow_the_definition() -> None:
    factory = "0,4,4,4,0,0,3,3,3,0"
    for rate, factor in {20.0: 10**0.5, 40.0: 5**0.5, 100.0: 2**0.5, 200.0: 1.0, 800.0: 1.0}.items():
        for kind in ("compensated", "uncompensated"):
            assert factors_of(kind, rate, factory) == pytest.approx({"gyro": factor, "accel": factor})  # type: ignore[arg-type]
        assert set(factors_of("deltas", rate, factory).values()) == {1.0}
    apart = factors_of("uncompensated", 40.0, "0,20,4,4,0,0,3,3,3,0")
    assert apart == pytest.approx({"accel": 1.0, "gyro": 5**0.5})
    off = factors_of("compensated", 40.0, "0,20,20,4,0,0,1,1,1,0")
    assert off == pytest.approx({"accel": 20**0.5, "gyro": 20**0.5}), (
        "the window is for uncompensated readings"
    )
    for rate, text in ((None, factory), (40.0, None), (40.0, "nonsense")):
        assert set(factors_of("compensated", rate, text).values()) == {None}


# ---------------------------------------------------------------------- faults


@pytest.mark.few(2)
@pytest.mark.parametrize("flash", [115200, 9600, 460800])
def test_a_sensor_is_found_at_any_baud_and_configured_again_after_a_power_interruption(flash: int) -> None:
    bench = Bench(make_device(EmulatorSettings(seed=1, baud=flash, rate=RATE.get(flash, 40.0))))
    session = bench.streaming(DeviceSettings(set_baud=115200))
    saved = session.save_settings()
    bench.run(session, 0.5)
    bench.power_cut()
    with pytest.raises(DeviceLost):
        bench.run(session, 14.0)
    session = bench.streaming(DeviceSettings(set_baud=115200), saved)
    samples, notices = bench.run(session, 1.0)
    assert (samples >= 95, notices) == (True, [])
    assert bench.baud == 115200, "the requested baud rate is set again"
    assert session.restore()
    assert bench.device.registers[6] == ("14",)


def test_a_silent_sensor_is_lost_and_found_again() -> None:
    bench = Bench()
    session = bench.streaming()
    saved = session.save_settings()
    bench.dead = True
    with pytest.raises(DeviceLost):
        bench.run(session, 25.0)
    with pytest.raises(NotAVn100):
        bench.streaming(saved=saved)
    assert bench.baud == 115200, "the port keeps the baud rate of the sensor"
    bench.dead = False
    assert bench.run(bench.streaming(saved=saved), 1.0)[0] >= 95


def test_sensor_errors_give_notices() -> None:
    bench = Bench()
    session = bench.streaming()
    bench.device.receive(b"$VNXXX*XX\r\n", bench.now)
    _, notices = bench.run(session, 0.5)
    assert kinds(notices) == ["sensor_error"]
    assert "invalid command" in notices[0].text


def test_flash_is_not_written_and_the_sensor_is_not_reset() -> None:
    bench = Bench()
    session = bench.streaming(DeviceSettings(set_baud=230400))
    bench.run(session, 1.0)
    bench.power_cut()
    with pytest.raises(DeviceLost):
        bench.run(session, 4.0)
    bench.streaming(DeviceSettings(set_baud=230400), session.save_settings()).restore()
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


@pytest.mark.few
@pytest.mark.parametrize("seed", range(12))
def test_restore_restores_every_register(seed: int) -> None:
    dice = random.Random(seed)
    bench = Bench(_random_settings(dice))
    before = bench.registers()
    stream = dice.choice(("deltas", "uncompensated", "compensated"))
    session = bench.streaming(DeviceSettings(stream=stream, set_baud=dice.choice((0, 460800))))  # type: ignore[arg-type]
    assert bench.registers() != before
    samples, _ = bench.run(session, 1.0)
    assert samples >= 0.95 * session.info().sample_rate_hz, "whatever the sensor sent before"
    assert session.restore()
    assert bench.registers() == before
    assert session.restore(), "a second call writes nothing"


@pytest.mark.few
@pytest.mark.parametrize("seed", range(4))
def test_settings_are_restored_after_a_kill_at_any_moment(seed: int) -> None:
    """The same session restores them after an interruption, the next one after a kill."""
    dice = random.Random(100 + seed)
    original = _random_settings(dice)
    request = DeviceSettings(
        stream=dice.choice(("deltas", "uncompensated")), set_baud=dice.choice((0, 460800))
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
        bench.streaming(DeviceSettings(stream=stream))  # type: ignore[arg-type]
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


# ---------------------------------------------------------------------- emulator process


def test_another_sensor_in_the_place_of_a_lost_one_is_refused(tmp_path: Path) -> None:
    link = tmp_path / "sensor"
    device = Vn100Device(DeviceOptions(url=str(link), settings=DeviceSettings()))
    with spawn(EmulatorSettings(seed=1, link=str(link))):
        device.open()
        device.start()
    device.close()
    with (
        spawn(EmulatorSettings(seed=2, link=str(link), serial="0100000002")),
        pytest.raises(DeviceError) as error,
    ):
        device.open()
    assert error.value.code == "other_sensor"
    assert all(serial in error.value.message for serial in ("0100056785", "0100000002"))
