"""What a session with a VN-100 does about faults, and the settings that it restores."""

from __future__ import annotations

import random

import pytest
from vn100_bench import RATE, Bench, Killed, kinds

from imumon.config import DeviceSettings
from imumon.sources.device import DeviceLost
from imumon.sources.vn100.commands import NotAVn100
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.emulator.command_handler import CommandHandler
from imumon.sources.vn100.emulator.emulator import make_device

# ---------------------------------------------------------------------- faults


def test_a_restarted_sensor_is_lost_and_configured_again() -> None:
    bench = Bench()
    session = bench.streaming()
    saved = session.save_settings()
    bench.run(session, 1.0)
    bench.power_cut()
    with pytest.raises(DeviceLost):
        bench.run(session, 5.0)
    session = bench.streaming(saved=saved)
    samples, notices = bench.run(session, 1.0)
    assert samples >= 95
    assert notices == []
    assert session.restore()
    assert bench.device.registers.read(6) == ("14",)


@pytest.mark.few
@pytest.mark.parametrize("flash", [9600, 460800])
def test_other_baud_after_a_power_interruption_is_found(flash: int) -> None:
    bench = Bench(make_device(EmulatorSettings(seed=1, baud=flash, rate=RATE.get(flash, 40.0))))
    session = bench.streaming(DeviceSettings(set_baud=115200))
    saved = session.save_settings()
    assert bench.baud == 115200
    bench.run(session, 0.5)
    bench.power_cut()
    with pytest.raises(DeviceLost):
        bench.run(session, 14.0)
    session = bench.streaming(DeviceSettings(set_baud=115200), saved)
    assert bench.run(session, 1.0)[0] >= 95
    assert bench.baud == 115200, "the requested baud rate is set again"


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
    bench.run(session, 0.5)
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
