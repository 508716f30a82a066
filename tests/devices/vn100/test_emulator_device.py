"""Emulated device without a port: registers, commands, output streams and signals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import vn100_wire as wire
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.devices.base import InvalidOption
from imumon.devices.vn100 import ascii
from imumon.devices.vn100.binary import GROUPS, BinaryLayout
from imumon.devices.vn100.checksum import crc16
from imumon.devices.vn100.decoder import Vn100Decoder
from imumon.devices.vn100.emulator import EmulatorSettings, Noise, from_command_line
from imumon.devices.vn100.emulator.command_handler import BOOTING_S, SAVING_S, CommandHandler
from imumon.devices.vn100.emulator.emulator import make_device
from imumon.devices.vn100.emulator.faults import Faults
from imumon.devices.vn100.emulator.sensor_model import SensorModel
from imumon.devices.vn100.registers import (
    ASCII_RATES,
    BINARY_OUTPUTS,
    LOOP_RATE,
    MEASUREMENTS,
    OUTPUT_TYPES,
    REGISTERS,
)
from imumon.samples import Floats, SampleBlock

WHITE = Noise((6.1e-5,) * 3, (0.0,) * 3, (0.0,) * 3)


def make(**options: object) -> CommandHandler:
    """Device with white noise only, which is quick to generate, unless `options` say otherwise."""
    quick = {"seed": 7, "gyro": WHITE, "accel": WHITE, "mag": WHITE}
    return make_device(EmulatorSettings(**{**quick, **options}))  # type: ignore[arg-type]


def ask(device: CommandHandler, body: str, check: str = "crc", now: float = 0.0) -> str:
    """Reply to one command without its frame."""
    device.receive(ascii.encode(body, check), now)  # type: ignore[arg-type]
    replies = device.replies(now)
    assert len(replies) == 1, replies
    return replies[0][1:].partition(b"*")[0].decode()


def save(device: CommandHandler, now: float) -> None:
    device.receive(b"$VNWNV*57\r\n", now)
    assert device.replies(now) == []
    assert device.replies(now + SAVING_S) == [b"$VNWNV*57\r\n"]


def blocks(messages: list[tuple[int, bytes]]) -> list[SampleBlock]:
    decoder = Vn100Decoder()
    items = [*decoder.feed(b"".join(message for _, message in messages)), *decoder.finish()]
    assert decoder.discarded == 0
    return [item for item in items if isinstance(item, SampleBlock)]


def columns(messages: list[tuple[int, bytes]], sensor: str) -> Floats:
    """(n, 3) samples of one sensor in these messages."""
    sample_blocks = blocks(messages)
    channels = sample_blocks[0].stream.channels
    index = [i for i, name in enumerate(channels) if name.startswith(sensor)]
    return np.concatenate([block.values[:, index] for block in sample_blocks])


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


def test_settings_survive_a_round_trip_through_the_command_line() -> None:
    settings = EmulatorSettings(
        rate=100, baud=230400, speed=60, gyro=Noise((1e-4, 2e-4, 3e-4), (0, 0, 0), (0, 0, 0)), seed=3,
        hum=0.01, model="VN-200", impostor="nmea", faults=Faults.parse("drop=0.25,crc=1e-3"),
    )  # fmt: skip
    assert from_command_line(settings.arguments()) == settings
    assert from_command_line([]) == EmulatorSettings()


# ---------------------------------------------------------------- streams


@pytest.mark.parametrize("kind", [k for k in OUTPUT_TYPES if k != 9])
def test_every_sentence_is_valid_and_has_its_rate(kind: int) -> None:
    device = make(baud=921600)
    ask(device, f"VNWRG,06,{kind}")
    messages = device.advance(LOOP_RATE)
    assert [tick for tick, _ in messages] == list(range(0, LOOP_RATE, 20))
    for _, message in messages:
        assert wire.unframe(message)[0] == OUTPUT_TYPES[kind]


def test_the_factory_sentence_is_as_long_as_the_real_one() -> None:
    assert {len(message) for _, message in make().advance(800)} == {122}


@pytest.mark.parametrize("group", GROUPS)
def test_every_binary_field_is_sent(group: int) -> None:
    device = make(baud=921600, rate=0)
    for bit, entry in GROUPS[group].items():
        assert ask(device, f"VNWRG,76,1,80,{1 << (group - 1):02X},{1 << bit:04X}").startswith("VNWRG,76")
        layout = BinaryLayout.of({group: 1 << bit})
        messages = device.advance(device.outputs.tick + 800)
        assert len(messages) == 10
        packets = layout.decode(b"".join(message for _, message in messages), count=10)
        assert layout.count_valid(b"".join(message for _, message in messages), 0, 10) == 10
        assert np.isfinite(packets[f"{group}.{entry.name}"].astype(float)).all()
        assert group not in (4, 6, 7) or not packets[f"{group}.{entry.name}"].any()


def test_streams_interleave_at_message_boundaries_in_order() -> None:
    device = make(baud=921600, rate=200)
    ask(device, "VNWRG,75,1,4,01,0739")
    messages = device.advance(800)
    assert [tick for tick, _ in messages] == sorted(tick for tick, _ in messages)
    kinds = [message[:1] for _, message in messages]
    assert (kinds.count(b"$"), kinds.count(b"\xfa")) == (200, 200)


def test_the_output_does_not_depend_on_the_step_size() -> None:
    def output(steps: list[int]) -> bytes:
        device = make(baud=921600, rate=50)
        ask(device, "VNWRG,75,1,3,07,0021,0001,00C1")
        return b"".join(message for tick in steps for _, message in device.advance(tick))

    whole = output([20_000])
    rng = np.random.default_rng(2)
    assert output([*np.cumsum(rng.integers(1, 600, 60)).tolist(), 20_000]) == whole
    assert output([*range(4, 2400, 4), 20_000]) == whole


def test_pausing_stops_ascii_and_binary() -> None:
    device = make(baud=921600)
    ask(device, "VNWRG,75,1,8,01,0001")
    ask(device, "VNASY,0")
    assert device.advance(800) == []
    assert ask(device, "VNRRG,01") == "VNRRG,01,VN-100T-CR"
    ask(device, "VNASY,1")
    assert len(device.advance(1600)) == 140


def test_the_other_serial_port_has_its_own_outputs() -> None:
    device = make(rate=0, baud=921600, serial_port=2)
    assert ask(device, "VNRRG,05,?") == "VNRRG,05,921600,2"
    ask(device, "VNWRG,75,1,40,01,0001")
    assert device.advance(800) == []
    ask(device, "VNWRG,75,2,40,01,0001")
    assert len(device.advance(1600)) == 20


def test_a_binary_output_can_be_polled() -> None:
    device = make(rate=0)
    device.advance(800)
    ask(device, "VNWRG,77,1,0,01,0001")
    device.receive(b"$VNBOM,03*XX\r\n", 1.0)
    (packet,) = device.replies(1.0)
    assert BinaryLayout.of({1: 1}).count_valid(packet, 0, 1) == 1
    assert device.advance(1600) == []


def test_appended_fields_and_checks() -> None:
    device = make(rate=40)
    ask(device, "VNWRG,32,3,0,0,0,1,1,0,100000000,0")
    ask(device, "VNWRG,30,3,1,0,0,3,0,1")
    ask(device, "VNKMD,1")
    messages = [message for _, message in device.advance(1600)]
    fields = [message.partition(b"*")[0].split(b",")[-2:] for message in messages]
    counts = np.array([int(count[1:]) for count, _ in fields])
    assert (np.diff(counts) == 20).all()
    assert {status for _, status in fields} == {b"S0800"}
    assert {len(message) for message in messages} == {122 + 12 + 6 + 2}
    ask(device, "VNWRG,33,0,0,0")
    assert ask(device, "VNRRG,33") == "VNRRG,33,0,0,0"
    device.advance(device.outputs.tick + 100)
    assert ask(device, "VNRRG,33") == "VNRRG,33,0,0,100"


# ---------------------------------------------------------------- signals


def relative(sigma: Floats, truth: float, count: int) -> float:
    """Deviation of the axes' mean from the truth, in its own standard errors."""
    return float((sigma.mean() / truth - 1.0) * math.sqrt(2.0 * 3.0 * count))


def test_the_moving_average_aliases_and_the_increments_do_not() -> None:
    constant = {"warm_up": 0.0}
    uncompensated = make(rate=40, **constant)
    ask(uncompensated, "VNWRG,06,19")
    gyro = columns(uncompensated.advance(600 * LOOP_RATE), "gyro")
    # The bandwidth of the element removes a part of the variance of the 5 ms average.
    a = (1.0 - math.sqrt(0.5)) / (2.0 * (1.0 - math.cos(2.0 * math.pi * 256.0 / LOOP_RATE)))
    taps = np.convolve([a, 1 - 2 * a, a], np.full(4, 0.25))
    measured = 6.1e-5 * math.sqrt(LOOP_RATE * float(np.sum(taps**2)))
    assert abs(relative(gyro.std(axis=0), measured, len(gyro))) < 4.0
    assert measured / math.sqrt(40) / 6.1e-5 == pytest.approx(math.sqrt(5), rel=0.06)

    deltas = make(rate=0, **constant)
    ask(deltas, "VNWRG,75,1,20,06,0001,00C0")
    gyro = columns(deltas.advance(600 * LOOP_RATE), "gyro")[1:]
    assert abs(relative(gyro.std(axis=0), 6.1e-5 * math.sqrt(40), len(gyro))) < 4.0


def test_a_matched_window_removes_the_aliasing() -> None:
    device = make(rate=40, warm_up=0.0)
    ask(device, "VNWRG,06,19")
    ask(device, "VNWRG,85,0,20,20,4,0,0,3,3,3,0")
    gyro = columns(device.advance(600 * LOOP_RATE), "gyro")
    assert gyro.std(axis=0).mean() == pytest.approx(6.1e-5 * math.sqrt(40), rel=0.03)
    ask(device, "VNWRG,85,0,0,0,0,0,0,3,3,3,0")
    gyro = columns(device.advance(1200 * LOOP_RATE), "gyro")
    a = (1.0 - math.sqrt(0.5)) / (2.0 * (1.0 - math.cos(2.0 * math.pi * 256.0 / LOOP_RATE)))
    unfiltered = 6.1e-5 * math.sqrt(LOOP_RATE * (2 * a * a + (1 - 2 * a) ** 2))
    assert abs(relative(gyro.std(axis=0), unfiltered, len(gyro))) < 4.0


def test_increments_add_up_with_any_reset() -> None:
    def total(*outputs: str) -> Floats:
        device = make(rate=0, baud=921600)
        for command in outputs:
            ask(device, command)
        layout = BinaryLayout.of({3: 0x00C0})
        data = b"".join(message for _, message in device.advance(8000))
        packets = layout.decode(data, count=len(data) // layout.length)
        return (
            np.concatenate((packets["3.deltaTheta"], packets["3.deltaVel"]), axis=1).astype(float).sum(axis=0)
        )

    slow = total("VNWRG,75,1,50,04,00C0")
    fast = total("VNWRG,75,1,10,04,00C0")
    # The last slow packet ends at tick 7950, the last fast one 40 ticks later.
    assert slow[0] == pytest.approx(7951 / LOOP_RATE, rel=1e-6)
    assert fast[0] == pytest.approx(7991 / LOOP_RATE, rel=1e-6)
    assert fast[6] - slow[6] == pytest.approx(-9.793746 * 40 / LOOP_RATE, rel=0.01)
    two = total("VNWRG,75,1,50,04,00C0", "VNWRG,76,1,10,04,00C0")
    assert two[0] == pytest.approx(7991 / LOOP_RATE + 160 * 10 / LOOP_RATE, rel=0.01)


def test_polling_the_increments_resets_them() -> None:
    device = make(rate=0)
    device.advance(400)
    assert float(ask(device, "VNRRG,80").split(",")[2]) == pytest.approx(0.5, abs=0.002)
    device.advance(480)
    assert float(ask(device, "VNRRG,80").split(",")[2]) == pytest.approx(0.1, abs=0.002)


def test_the_bias_is_subtracted_from_the_compensated_rate() -> None:
    device = make(rate=0, baud=921600)
    ask(device, "VNWRG,75,1,4,05,0020,0008")
    layout = BinaryLayout.of({1: 0x20, 3: 0x08})
    data = b"".join(message for _, message in device.advance(120 * LOOP_RATE))
    packets = layout.decode(data, count=len(data) // layout.length)[-20_000:]
    bias = packets["3.uncompGyro"].astype(float).mean(axis=0)
    rest = packets["1.angularRate"].astype(float).mean(axis=0)
    assert (np.abs(bias) > 5e-3).all()
    assert (np.abs(rest) < 5e-5).all()
    spread = packets["1.angularRate"].std(axis=0) / packets["3.uncompGyro"].std(axis=0)
    assert spread == pytest.approx(np.ones(3), abs=0.01)


def test_the_magnetometer_repeats_its_readings_and_has_mains_hum() -> None:
    device = make(rate=0, baud=921600, hum=0.02, hum_hz=50.0)
    ask(device, "VNWRG,75,1,1,04,0002")
    layout = BinaryLayout.of({3: 0x02})
    data = b"".join(message for _, message in device.advance(8000))
    field = layout.decode(data, count=8000)["3.uncompMag"].astype(float)
    assert (np.diff(field[:, 0]) == 0).mean() == pytest.approx(1 - 250 / 800, abs=0.01)
    spectrum = np.abs(np.fft.rfft(field[:, 0] - field[:, 0].mean())) ** 2
    assert np.fft.rfftfreq(8000, 1 / 800)[spectrum.argmax()] == pytest.approx(50.0)


def test_calibrations_apply_to_uncompensated_outputs_too() -> None:
    device = make(rate=0, baud=921600, warm_up=0.0)
    ask(device, "VNWRG,75,1,8,04,00CE")
    layout = BinaryLayout.of({3: 0xCE})

    def means(seconds: int) -> dict[str, Floats]:
        data = b"".join(message for _, message in device.advance(device.outputs.tick + seconds * LOOP_RATE))
        packets = layout.decode(data, count=len(data) // layout.length)[1:]
        return {name: packets[name].astype(float).mean(axis=0) for name in layout.fields}

    before = means(20)
    ask(device, "VNWRG,84,1,0,0,0,1,0,0,0,1,0.5,0,0")
    ask(device, "VNWRG,25,1,0,0,0,2,0,0,0,1,0,0,0")
    ask(device, "VNWRG,23,0,1,0,1,0,0,0,0,1,0,0,0")
    means(1)
    after = means(20)
    assert after["3.uncompGyro"][0] - before["3.uncompGyro"][0] == pytest.approx(-0.5, abs=1e-4)
    rotation = after["3.deltaTheta"][1] - before["3.deltaTheta"][1]
    assert rotation == pytest.approx(math.degrees(-0.5) * 0.01, rel=1e-3)
    assert after["3.uncompAccel"][1] == pytest.approx(2 * before["3.uncompAccel"][1], abs=5e-3)
    assert after["3.uncompMag"][:2] == pytest.approx(before["3.uncompMag"][1::-1], abs=2e-3)


def test_the_reference_frame_changes_after_saving_and_a_reset() -> None:
    device = make()
    ask(device, "VNWRG,26,1,0,0,0,-1,0,0,0,-1")
    device.advance(800)
    assert float(ask(device, "VNRRG,18").split(",")[4]) < -9
    save(device, 0.0)
    ask(device, "VNRST", now=1.0)
    device.replies(3.0)
    device.advance(1600)
    assert float(ask(device, "VNRRG,18", now=3.0).split(",")[4]) > 9


def test_the_warm_up_changes_the_bias() -> None:
    device = make(rate=0, warm_up=10.0, warm_up_s=60.0, gyro_thermal=1e-4)
    ask(device, "VNWRG,75,1,8,04,0018")
    layout = BinaryLayout.of({3: 0x18})
    data = b"".join(message for _, message in device.advance(300 * LOOP_RATE))
    packets = layout.decode(data, count=len(data) // layout.length)
    temperature = packets["3.temp"].astype(float).ravel()
    assert temperature[-100:].mean() - temperature[:10].mean() == pytest.approx(10.0, abs=0.2)
    rate = packets["3.uncompGyro"].astype(float)
    assert rate[-2000:].mean(axis=0) - rate[:200].mean(axis=0) == pytest.approx(np.full(3, 1e-3), rel=0.1)


def test_the_startup_bias_is_saved_on_command() -> None:
    device = make()
    device.advance(60 * LOOP_RATE)
    ask(device, "VNSGB")
    saved = [float(field) for field in ask(device, "VNRRG,43").split(",")[2:]]
    assert saved == pytest.approx([0.0152, -0.0113, -0.0064], abs=2e-4)


def test_time_stamps_are_whole_microseconds_with_jitter() -> None:
    device = make(rate=800, baud=921600)
    time = np.concatenate([b.time_ns for b in blocks(device.advance(8000)) if b.time_ns is not None])
    assert (time % 1000 == 0).all()
    error = np.diff(time) - 1_250_000
    assert error.std() / 1000 == pytest.approx(4.7 * math.sqrt(2), rel=0.05)


def test_the_same_seed_gives_the_same_output() -> None:
    one, two, other = (
        CommandHandler(EmulatorSettings(seed=s), SensorModel(EmulatorSettings(seed=s))) for s in (1, 1, 2)
    )
    first = one.advance(4000)
    assert first == two.advance(4000)
    assert first != other.advance(4000)


def test_too_many_outputs_are_refused() -> None:
    device = make(baud=9600, rate=5)
    for number in BINARY_OUTPUTS:
        answer = ask(device, f"VNWRG,{number},1,400,01,0739")
        assert answer.startswith(("VNWRG", "VNERR,0C"))
    assert device.outputs.bytes_per_second() <= 960
