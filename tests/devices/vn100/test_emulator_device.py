"""Laws of the emulated device: registers, framing, resets and its serial line."""

from __future__ import annotations

import argparse
import math

import pytest
import vn100_wire as wire
from hypothesis import given, settings
from hypothesis import strategies as st
from vn100_emulated import ask, blocks, make, save

from imumon.devices.base import InvalidOption
from imumon.devices.vn100 import ascii
from imumon.devices.vn100.checksum import crc16
from imumon.devices.vn100.emulator import EmulatorSettings, Noise, add_arguments, from_arguments
from imumon.devices.vn100.emulator.command_handler import BOOTING_S, SAVING_S
from imumon.devices.vn100.emulator.faults import Faults
from imumon.devices.vn100.registers import (
    ASCII_RATES,
    LOOP_RATE,
    MEASUREMENTS,
    REGISTERS,
)

# ---------------------------------------------------------------- registers


@pytest.mark.parametrize("firmware", ["2.1.0.0", "3.1.0.0"])
def test_every_register_can_be_written_back_exactly_as_read(firmware: str) -> None:
    device = make(firmware=firmware)
    existing = 0
    for number in range(256):
        answer = ask(device, f"VNRRG,{number}")
        register = REGISTERS.get(number)
        if register is None or not register.in_generation(device.registers.generation):
            assert answer == "VNERR,08"
            continue
        assert answer.startswith(f"VNRRG,{number:02d},")
        existing += 1
        written = ask(device, "VNWRG" + answer[5:])
        if register.access == "setting":
            assert written == "VNWRG" + answer[5:]
            if number != 33:
                assert ask(device, f"VNRRG,{number}") == answer
        else:
            assert written == "VNERR,09"
    assert existing >= 44


@pytest.mark.parametrize(
    ("firmware", "number", "answer"),
    [
        ("3.1.0.0", 0, "VNRRG,00,"),
        ("3.1.0.0", 30, "VNRRG,30,0,0,0,0,1,0,1"),
        ("3.1.0.0", 32, "VNRRG,32,3,0,0,0,6,1,0,100000000,0"),
        ("3.1.0.0", 44, "VNRRG,44,0,1,5"),
        ("2.1.0.0", 44, "VNRRG,44,1,3,5"),
        ("3.1.0.0", 75, "VNRRG,75,0,0,00"),
        ("3.1.0.0", 85, "VNRRG,85,0,4,4,4,0,0,3,3,3,0"),
        ("3.1.0.0", 55, "VNERR,08"),
        ("3.1.0.0", 74, "VNERR,08"),
        ("2.1.0.0", 101, "VNERR,08"),
    ],
)
def test_factory_values(firmware: str, number: int, answer: str) -> None:
    assert ask(make(firmware=firmware), f"VNRRG,{number}") == answer


def test_identity() -> None:
    device = make(model="VN-200T-CR", serial="0100099999", firmware="2.0.1.0")
    assert [ask(device, f"VNRRG,{number:02d}") for number in (1, 2, 3, 4)] == [
        "VNRRG,01,VN-200T-CR",
        "VNRRG,02,7",
        "VNRRG,03,0100099999",
        "VNRRG,04,2.0.1.0",
    ]


def test_measurement_registers_have_the_fields_of_their_messages() -> None:
    device = make()
    device.advance(1600)
    for number, message in MEASUREMENTS.items():
        answer = ask(device, f"VNRRG,{number}")
        expected = sum(ascii.WIDTHS[name] for name in ascii.MEASUREMENTS[message])  # type: ignore[attr-defined]
        assert len(answer.split(",")) == 2 + expected
        assert all(math.isfinite(float(field)) for field in answer.split(",")[2:])


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("VNRRG,05", "VNRRG,05,115200"),
        ("VNRRG,5,1", "VNRRG,05,115200,1"),
        ("VNRRG,05,2", "VNRRG,05,115200,2"),
        ("VNRRG,05,?", "VNRRG,05,115200,1"),
        ("VNRRG,05,3", "VNERR,07"),
        ("VNRRG,06,0", "VNERR,07"),
        ("VNWRG,06,0,3", "VNERR,07"),
        ("VNWRG,06,1,2", "VNWRG,06,1,2"),
        ("VNRRG,06,1,1", "VNERR,06"),
        ("VNRRG", "VNERR,05"),
        ("VNRRG,x", "VNERR,07"),
        ("VNRRG,85,1", "VNERR,06"),
        ("VNRRG,99", "VNERR,08"),
        ("VNRRG,157", "VNERR,08"),
        ("VNXYZ", "VNERR,04"),
        ("VNWRG,99,1", "VNERR,08"),
        ("VNWRG,01,x", "VNERR,09"),
        ("VNWRG,27,1", "VNERR,09"),
        ("VNWRG,85,0,4,4,4,0", "VNERR,05"),
        ("VNWRG,85,0,4,4,4,0,0,3,3,3,0,0", "VNERR,06"),
        ("VNWRG,85,0,4,4,4,0,0,3,3,9,0", "VNERR,07"),
        ("VNWRG,85,0,20,20,4,0,0,3,3,3,0", "VNWRG,85,0,20,20,4,0,0,3,3,3,0"),
        ("VNWRG,07,3", "VNERR,07"),
        ("VNWRG,05,12345", "VNERR,07"),
        ("VNWRG,00,", "VNWRG,00,"),
        ("VNWRG,00,SENSOR_A", "VNWRG,00,SENSOR_A"),
        ("VNWRG,00,a tag of more than twenty letters", "VNERR,07"),
        ("VNWRG,75,0,0,00", "VNWRG,75,0,0,00"),
        ("VNWRG,75,1,400,1,321", "VNWRG,75,1,400,01,0321"),
        ("VNWRG,75,1,400,1,0321,0001", "VNERR,07"),
        ("VNWRG,75,1,400,08,0001", "VNWRG,75,1,400,08,0001"),
        ("VNWRG,75,1,400,80,0001", "VNERR,07"),
        ("VNWRG,75,1,400,04,7000", "VNERR,07"),
        ("VNWRG,82,1,0,0,0,0", "VNWRG,82,1,0,0,0,0"),
        (
            "VNWRG,83,1,1,0,0,1000,0.000000,0.0,0.0,0.0",
            "VNWRG,83,1,1,0,0,1000,0.000,+00.00000000,+000.00000000,+00000.000",
        ),
        ("VNWRG,75,1,400,01,8001", "VNERR,07"),
        ("VNWRG,21,1.000000,0.000000,1.800000,0.000000,0.000000,-9.793750", "VNWRG,21,1,0,1.8,0,0,-9.79375"),
        ("VNASY,2", "VNERR,07"),
        ("VNASY", "VNERR,05"),
        ("VNASY,0", "VNASY,0"),
        ("VNKMD,1", "VNKMD,1"),
        ("VNKAD,0", "VNKAD,0"),
        ("VNKAD", "VNERR,05"),
        ("VNSGB", "VNSGB"),
        ("VNSFB", "VNSFB"),
        ("VNSIH,+045.000", "VNSIH,+045.000"),
        ("VNTAR", "VNERR,04"),
        ("VNFWU", "VNERR,04"),
        ("VNBOM,4", "VNERR,07"),
        ("VNBOM,1", "VNERR,07"),
        ("VNWNV,1", "VNERR,06"),
    ],
)
def test_replies(command: str, answer: str) -> None:
    assert ask(make(), command) == answer


def test_firmware_2_has_tare_and_no_set_heading() -> None:
    device = make(firmware="2.1.0.0")
    assert ask(device, "VNTAR") == "VNTAR"
    assert ask(device, "VNSIH,1") == "VNERR,04"
    assert ask(device, "VNWRG,06,9") == "VNWRG,06,9"
    assert ask(device, "VNWRG,06,34") == "VNERR,07"


# ---------------------------------------------------------------- framing


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        (b"$VNRRG,01*72\r\n", b"$VNRRG,01,VN-100T-CR*32\r\n"),
        (b"$VNRRG,01*72\n", b"$VNRRG,01,VN-100T-CR*32\r\n"),
        (b"$VNRRG,1*xx\r", b"$VNRRG,01,VN-100T-CR*32\r\n"),
        (b"$VNRRG,01*XXXX\r\n", ascii.encode("VNRRG,01,VN-100T-CR", "crc")),
        (b"$VNRRG,85*%04x\r\n" % crc16(b"VNRRG,85"), ascii.encode("VNRRG,85,0,4,4,4,0,0,3,3,3,0", "crc")),
        (b"$VNRRG,01*73\r\n", b"$VNERR,03*72\r\n"),
        (b"$VNRRG,01*7\r\n", b"$VNERR,03*72\r\n"),
        (b"$VNRRG,01\r\n", b"$VNERR,03*72\r\n"),
        (b"$VNRRG,01*0000\r\n", ascii.encode("VNERR,03", "crc")),
        (b"garbage $VNRR$VNRRG,01*72\r\n", b"$VNRRG,01,VN-100T-CR*32\r\n"),
        (b"x" * 300 + b"\r\n", b"$VNERR,02*73\r\n"),
        (b"no dollar\r\n", b""),
        (b"$VNRRG,01*72", b""),
    ],
)  # fmt: skip
def test_framing_of_commands_and_replies(line: bytes, reply: bytes) -> None:
    for size in (1, 7, len(line)):
        device = make()
        for at in range(0, len(line), size):
            device.receive(line[at : at + size], 0.0)
        assert b"".join(device.replies(0.0)) == reply


def test_error_modes() -> None:
    device = make()
    ask(device, "VNWRG,30,0,0,0,0,1,0,0")
    device.receive(b"$VNXYZ*XX\r\n", 0.0)
    assert device.replies(0.0) == []
    ask(device, "VNWRG,30,0,0,0,0,1,0,2")
    assert ask(device, "VNXYZ") == "VNERR,04"
    assert ask(device, "VNRRG,06") == "VNRRG,06,0"


FIELD = st.one_of(
    st.sampled_from(["", "0", "1", "3", "75", "85", "115200", "?", "XX", "1e9", "nan", "inf", "FF"]),
    st.integers(-5, 300).map(str),
    st.text("0123456789abcdefABCDEF.+-e?", max_size=6),
)
COMMAND = st.sampled_from(
    ["VNRRG", "VNWRG", "VNASY", "VNBOM", "VNSIH", "VNKMD", "VNSGB", "VNTAR", "VNCMD", "VNXYZ", "VN"]
)


@settings(max_examples=100, derandomize=True)
@given(
    commands=st.lists(st.tuples(COMMAND, st.lists(FIELD, max_size=14)), max_size=8),
    noise=st.binary(max_size=40),
)
def test_any_input_is_answered_by_valid_messages(commands: list[tuple[str, list[str]]], noise: bytes) -> None:
    device = make(baud=921600, rate=100)
    device.receive(noise + b"\r\n", 0.0)
    for command, fields in commands:
        device.receive(ascii.encode(",".join((command, *fields))), 0.0)
    for reply in device.replies(0.0):
        assert reply[:1] == b"\xfa" or wire.unframe(reply)
    assert device.outputs.bytes_per_second() <= device.baud / 10
    device.advance(device.outputs.tick + 40)


# ---------------------------------------------------------------- register file and resets


def test_saving_takes_half_a_second_and_repeated_commands_are_answered() -> None:
    device = make()
    ask(device, "VNWRG,07,20")
    for now in (0.0, 0.2, 0.4):
        device.receive(b"$VNWNV*57\r\n", now)
        assert device.replies(now) == []
    assert device.next_reply() == SAVING_S
    assert device.replies(SAVING_S) == [b"$VNWNV*57\r\n"] * 3


def test_a_reset_loses_what_was_not_saved() -> None:
    device = make()
    ask(device, "VNWRG,00,kept")
    save(device, 1.0)
    ask(device, "VNWRG,00,lost", now=3.0)
    device.advance(800)
    assert ask(device, "VNRST", now=4.0) == "VNRST"
    device.receive(b"$VNRRG,00*XX\r\n", 4.1)
    assert device.advance(1000) == []
    assert device.replies(4.1) == []
    device.replies(4.0 + BOOTING_S)
    first = device.advance(1100)[0][1]
    assert first.startswith(b"$VNYMR")
    assert ask(device, "VNRRG,00", now=6.0) == "VNRRG,00,kept"
    assert ask(device, "VNRFS", now=6.0) == "VNRFS"
    device.replies(7.0)
    assert ask(device, "VNRRG,00", now=7.0) == "VNRRG,00,"


def test_a_reset_restarts_the_sensor_clock() -> None:
    device = make(rate=400, baud=921600)
    before = blocks(device.advance(1600))[0].time_ns
    device.restart(2.0)
    device.replies(3.0)
    after = blocks(device.advance(3200))[0].time_ns
    assert before is not None
    assert after is not None
    assert before[-1] > 2_000_000_000 > after[0]


# ---------------------------------------------------------------- serial line


@pytest.mark.parametrize(
    ("baud", "commands", "last"),
    [
        (115200, ["VNWRG,07,50"], "VNWRG,07,50"),
        (115200, ["VNWRG,07,100"], "VNERR,0C"),
        (115200, ["VNWRG,06,19", "VNWRG,07,100"], "VNWRG,07,100"),
        (115200, ["VNWRG,06,1", "VNWRG,07,200"], "VNWRG,07,200"),
        (115200, ["VNWRG,05,38400"], "VNERR,0C"),
        (115200, ["VNWRG,75,1,4,06,0001,00C0"], "VNERR,0C"),
        (115200, ["VNWRG,06,0", "VNWRG,75,1,4,06,0001,00C0"], "VNWRG,75,1,4,06,0001,00C0"),
        (115200, ["VNWRG,06,0", "VNWRG,75,1,2,06,0001,00C0"], "VNERR,0C"),
        (115200, ["VNWRG,06,0", "VNWRG,75,1,8,01,0C01"], "VNWRG,75,1,8,01,0C01"),
        (115200, ["VNWRG,06,0", "VNWRG,75,2,1,01,0C01"], "VNERR,0C"),
        (921600, ["VNWRG,06,0", "VNWRG,75,1,1,01,0739"], "VNWRG,75,1,1,01,0739"),
        (921600, ["VNWRG,06,0", "VNWRG,75,3,1,01,0739"], "VNERR,0C"),
        (460800, ["VNWRG,06,0", "VNWRG,75,1,1,06,0001,00C0"], "VNWRG,75,1,1,06,0001,00C0"),
    ],
)
def test_output_that_does_not_fit_the_baud_is_refused(baud: int, commands: list[str], last: str) -> None:
    device = make(baud=baud)
    assert [ask(device, command) for command in commands][-1] == last


@pytest.mark.parametrize("rate", ASCII_RATES)
def test_the_lowest_baud_that_carries_the_rate_is_chosen(rate: int) -> None:
    device = make(rate=rate)
    assert device.baud == (115200 if rate <= 50 else 230400 if rate <= 100 else 460800)
    assert len(device.advance(2 * LOOP_RATE)) == 2 * rate


def test_impossible_rates_are_rejected() -> None:
    with pytest.raises(InvalidOption) as divided:
        EmulatorSettings(rate=300)
    assert divided.value.code == "rate_invalid"
    with pytest.raises(InvalidOption) as unfit:
        make(rate=100, baud=115200)
    assert unfit.value.code == "rate_does_not_fit"


def test_the_command_line_gives_the_settings() -> None:
    settings = EmulatorSettings(
        rate=100, baud=230400, speed=60, gyro=Noise((1e-4, 2e-4, 3e-4), (0, 0, 0), (0, 0, 0)), seed=3,
        hum=0.01, model="VN-200", impostor="nmea", faults=Faults.parse("drop=0.25,crc=1e-3"),
    )  # fmt: skip
    words = "--rate 100 --baud 230400 --speed 60 --gyro-n 1e-4,2e-4,3e-4 --gyro-b 0 --gyro-k 0,0,0 --seed 3 "
    words += "--hum 0.01 --model VN-200 --impostor nmea --fault drop=0.25,crc=1e-3"
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert from_arguments(parser.parse_args(words.split())) == settings
    assert from_arguments(parser.parse_args([])) == EmulatorSettings()
