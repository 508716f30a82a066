"""The VN-100 codec and the emulator against the independent packer and unpacker of `vn100_wire`."""

from __future__ import annotations

import math
import string
import struct
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import pytest
import vn100_wire as wire
from cases import case

from imumon.model.samples import SampleBlock, sensor_of
from imumon.sources.vn100 import ascii, binary
from imumon.sources.vn100.ascii import Response, SensorError
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder
from imumon.sources.vn100.emulator import EmulatorSettings, Noise
from imumon.sources.vn100.emulator.command_handler import CommandHandler
from imumon.sources.vn100.emulator.emulator import make_device
from imumon.sources.vn100.registers import OUTPUT_TYPES, REGISTERS

CHECKS: tuple[wire.CheckWidth, ...] = (8, 16)
ENDS = (b"\r\n", b"\n")
SUFFIXES: tuple[tuple[str, ...], ...] = (
    (), ("T0000000543",), ("S0C01",), ("T0000000543", "S0C01"), ("S0C01", "T0000000543"),
)  # fmt: skip


def decode(data: bytes, chunk: int = 1 << 20) -> tuple[Vn100Decoder, list[DecodedItem]]:
    """Return decoder and items; every byte must belong to a valid message."""
    decoder = Vn100Decoder()
    items = [item for at in range(0, len(data), chunk) for item in decoder.feed(data[at : at + chunk])]
    items += decoder.finish()
    assert (decoder.message_bytes, decoder.discarded, decoder.bad_checksums) == (len(data), 0, 0)
    return decoder, items


def samples(items: list[DecodedItem]) -> list[wire.Sample]:
    """Return the samples in the blocks of a decoder in the form of `vn100_wire`."""
    result = []
    for block in items:
        assert isinstance(block, SampleBlock)
        for row in range(len(block)):
            values = dict(zip(block.stream.channels, block.values[row].tolist(), strict=True))
            time_ns = None if block.time_ns is None else int(block.time_ns[row])
            sensors, saturated = list(dict.fromkeys(map(sensor_of, block.stream.channels))), None
            if block.saturated is not None:
                saturated = frozenset(np.array(sensors)[block.saturated[row]].tolist())
            result.append(wire.Sample(block.stream.kind, values, block.stream.clock, time_ns, saturated))
    return result


def assert_samples(items: list[DecodedItem], expected: Sequence[wire.Sample | None]) -> None:
    """Check that the decoded samples are the expected ones, to the last bits of a division."""
    decoded, expected = samples(items), [sample for sample in expected if sample is not None]
    assert len(decoded) == len(expected)
    for sample, other in zip(decoded, expected, strict=True):
        assert other is not None
        assert list(sample.values) == list(other.values)
        assert list(sample.values.values()) == pytest.approx(list(other.values.values()), rel=1e-14)
        assert (sample.kind, sample.clock, sample.time_ns) == (other.kind, other.clock, other.time_ns)
        assert sample.saturated == other.saturated


# ----------------------------------------------------------- what the decoder accepts, by trial


def test_every_kind_of_sentence_that_the_decoder_accepts_has_an_independent_vector() -> None:
    """Try all headers ``VN...``: sentences with a grammar of their own, skipped ones, all others responses."""
    strict, skipped = set(), set()
    alphabet = string.ascii_uppercase + string.digits
    for letters in product(alphabet, repeat=3):
        header = "VN" + "".join(letters)
        decoder = Vn100Decoder()
        items = decoder.feed(wire.frame(header))
        if not decoder.messages:
            strict.add(header)
        elif items != [Response(header, ())]:
            assert (items, decoder.messages) == ([], 1)
            skipped.add(header)
    assert strict == {*wire.SENTENCES, "VNERR"}
    assert skipped == wire.OTHER_PRODUCTS


def test_every_binary_field_that_the_decoder_accepts_has_an_independent_vector() -> None:
    accepted = set()
    for position in product(range(1, 8), range(15)):
        decoder = Vn100Decoder()
        decoder.feed(wire.header([position]))
        if decoder.pending:
            accepted.add(position)
    assert accepted == set(wire.FIELDS)


# ------------------------------------------------------------------- vectors of the independent packer


@pytest.mark.parametrize("header", wire.SENTENCES)
def test_independently_packed_sentences_decode_to_their_values(header: str) -> None:
    rng = np.random.default_rng(sum(header.encode()))
    for check, end, suffix in product(CHECKS, ENDS, SUFFIXES):
        bodies = []
        for _ in range(12):
            values = rng.uniform(-9.0, 9.0, len(wire.SENTENCES[header])).tolist()
            if header == "VNDTV":
                values[0] = rng.uniform(0.1, 0.9)
            bodies.append(wire.measurement(header, values, suffix))
        data = b"".join(wire.frame(body, check, end) for body in bodies)
        expected = [wire.sample_of_sentence(header, body.split(",")[1:]) for body in bodies]
        for chunk in (1, 7, 1 << 20):
            decoder, items = decode(data, chunk)
            assert decoder.messages == len(bodies)
            assert_samples(items, expected)
        _assert_all_numbers(header, bodies[0])


def _assert_all_numbers(header: str, body: str) -> None:
    """Check the numbers that are no samples, too."""
    sentence_format = ascii.sentence_format(body.encode())
    assert sentence_format is not None
    data = wire.frame(body)
    fields = [field for field in body.split(",")[1:] if field[0] not in "ST"]
    numbers = sentence_format.read(data, 0, len(data), 1)[0].tolist()
    assert numbers[: len(fields)] == [float(field) for field in fields]
    assert len(fields) == len(wire.SENTENCES[header])


@pytest.mark.parametrize("check", CHECKS)
def test_independently_packed_errors_responses_and_other_products_decode(check: wire.CheckWidth) -> None:
    for code in wire.ERROR_CODES:
        _, items = decode(wire.frame(f"VNERR,{code:02X}", check))
        assert [item.code for item in items if isinstance(item, SensorError)] == [code]
    assert set(ascii.ERRORS) == set(wire.ERROR_CODES)
    for command in wire.COMMANDS:
        for fields in ((), ("07", "40"), ("00", ""), ("01", "VN-100T-CR"), ("83", "1", "-00.5", "+1e3")):
            _, items = decode(wire.frame(",".join((command, *fields)), check))
            assert items == [Response(command, fields)]
    for header in sorted(wire.OTHER_PRODUCTS):
        decoder, items = decode(wire.frame(f"{header},333733.000159,1694,3,05", check))
        assert (decoder.messages, items) == (1, [])


def random_value(rng: np.random.Generator, position: wire.Position) -> tuple[float | bytes, ...]:
    """Return valid values of a field: finite, with a positive interval and a possible time."""
    field = wire.FIELDS[position]
    if field.format == "8s":
        return (rng.bytes(8),)
    kind = field.format[-1]
    if kind in "QIHB":
        return (int(rng.integers(0, 1 << min(62, 8 * field.size - 1))),)
    numbers = rng.uniform(-9.0, 9.0, field.count)
    if "dt" in field.names:
        numbers[0] = rng.uniform(0.1, 0.9)
    return struct.unpack("<" + field.format, struct.pack("<" + field.format, *numbers.tolist()))


def assert_fields(data: bytes, values: dict[wire.Position, tuple[float | bytes, ...]]) -> None:
    """Check that the layout of imumon reads the same values from a packet."""
    layout = binary.parse_header(data)
    assert layout is not None
    assert layout.length == len(data)
    decoded = layout.decode(data)[0]
    for name, position in zip(layout.fields, sorted(values), strict=True):
        assert name.startswith(f"{position[0]}.")
        expected = values[position]
        whole = tuple(expected[0]) if isinstance(expected[0], bytes) else expected
        assert tuple(decoded[name].tolist()) == whole


def test_independently_packed_fields_decode_to_their_values() -> None:
    for position, extended in product(wire.FIELDS, (False, True)):
        with case((position, extended)):
            rng = np.random.default_rng(position)
            packed = [{position: random_value(rng, position)} for _ in range(3)]
            data = [wire.packet(values, extended=extended) for values in packed]
            for chunk in (1, 1 << 20):
                decoder, items = decode(b"".join(data), chunk)
                assert decoder.messages == len(packed)
                assert_samples(items, [wire.sample_of_packet(values) for values in packed])
            for one, values in zip(data, packed, strict=True):
                assert_fields(one, values)


def test_independently_packed_combinations_of_fields_decode_to_their_samples() -> None:
    for seed in range(60):
        with case(seed):
            rng = np.random.default_rng(seed)
            every = list(wire.FIELDS)
            for _ in range(5):
                chosen = rng.choice(len(every), rng.integers(1, 14), replace=False)
                packed = [{every[k]: random_value(rng, every[k]) for k in chosen} for _ in range(2)]
                data = [wire.packet(values) for values in packed]
                _, items = decode(b"".join(data))
                assert_samples(items, [wire.sample_of_packet(values) for values in packed])
                assert_fields(data[0], packed[0])


def test_an_independently_packed_run_of_packets_decodes_as_an_array() -> None:
    rng = np.random.default_rng(1)
    positions = [(1, 0), (3, 1), (3, 4), (3, 5), (3, 6), (3, 7)]  # the deltas that the daemon requests
    packed = [{p: random_value(rng, p) for p in positions} for _ in range(600)]
    _, items = decode(b"".join(map(wire.packet, packed)))
    assert_samples(items, [wire.sample_of_packet(values) for values in packed])


# ---------------------------------------------------------------- the emulator, by the independent unpacker

QUIET = Noise((1e-6,) * 3, (0.0,) * 3, (0.0,) * 3)
AT_REST = {
    "gyro/x": 0.0152, "gyro/y": -0.0113, "gyro/z": -0.0064, "accel/x": 0.012, "accel/y": -0.021,
    "accel/z": -9.793746, "mag/x": 0.21, "mag/y": 0.03, "mag/z": 0.44, "pressure": 101.2, "temperature": 17.0,
}  # fmt: skip
"""What the emulated sensor measures level and at rest; the temperature is that of a cold start."""


SETTLED = 8
"""Messages after which the emulated sensor has an estimate of the gyroscope bias."""


def emulator(firmware: str = "3.1.0.0") -> CommandHandler:
    """Return an emulated sensor with little noise at 921600 baud, without an asynchronous output."""
    settings = EmulatorSettings(
        seed=7, gyro=QUIET, accel=QUIET, mag=QUIET, baud=921600, rate=0, firmware=firmware
    )
    return make_device(settings)  # type: ignore[return-value]


def ask(device: CommandHandler, body: str, check: wire.CheckWidth = 16) -> tuple[str, list[str]]:
    """Send an independently packed command; return header and fields of the independently read reply."""
    device.receive(wire.frame(body, check), 0.0)
    (reply,) = device.replies(0.0)
    header, fields, width = wire.unframe(reply)
    assert width == check  # the sensor mirrors the width of the checksum
    return header, fields


def stream(device: CommandHandler, ticks: int = 1600) -> bytes:
    """Return what the sensor sends by itself up to a tick of its 800 Hz loop."""
    return b"".join(message for _, message in device.advance(ticks))


def sentences(data: bytes) -> Iterator[tuple[str, list[str]]]:
    for message in wire.messages(data):
        assert not isinstance(message, dict)
        yield message


def assert_at_rest(sample: wire.Sample) -> None:
    """Check the values of a sample of the emulated sensor at rest."""
    tolerance = {"gyro": 2e-3, "accel": 5e-3, "mag": 2e-3, "temperature": 0.5, "pressure": 0.1}
    for channel, value in sample.values.items():
        expected = AT_REST[channel]
        if sample.kind == "compensated" and channel.startswith("gyro"):
            expected = 0.0  # the estimated bias is removed
        assert value == pytest.approx(expected, abs=tolerance[channel.partition("/")[0]]), channel


def test_sentences_of_the_emulator_are_valid_for_the_independent_unpacker() -> None:
    for kind, check in product(OUTPUT_TYPES, CHECKS):
        with case((kind, check)):
            header = OUTPUT_TYPES[kind]
            device = emulator("2.1.0.0" if header == "VNDCM" else "3.1.0.0")
            assert ask(device, f"VNWRG,30,3,1,0,0,{1 if check == 8 else 3},0,1")[0] == "VNWRG"
            assert ask(device, f"VNWRG,06,{kind}") == ("VNWRG", ["06", str(kind)])
            assert ask(device, "VNWRG,07,40") == ("VNWRG", ["07", "40"])
            data = stream(device)
            assert wire.unframe(data[: data.index(b"\n") + 1])[2] == check
            received = list(sentences(data))
            assert len(received) in (79, 80)
            for index, (name, fields) in enumerate(received):
                assert name == header
                *numbers, count, status = fields
                assert len(count) == 11
                assert len(status) == 5
                assert (count[0], status[0]) == ("T", "S")
                formats = [form for _, form in wire.SENTENCES[name]]
                assert [form % float(text) for form, text in zip(formats, numbers, strict=True)] == numbers
                sample = wire.sample_of_sentence(name, fields)
                if (
                    sample is not None and index >= SETTLED and header != "VNDTV"
                ):  # VNDTV has too coarse steps
                    assert_at_rest(sample)
            _, items = decode(data)
            assert_samples(items, [wire.sample_of_sentence(name, fields) for name, fields in received])


def test_packets_of_the_emulator_are_valid_for_the_independent_unpacker() -> None:
    for position in wire.FIELDS:
        with case(position):
            group, bit = position
            device = emulator()
            command = f"75,1,80,{1 << group - 1:02X},{1 << bit:04X}"
            assert ask(device, f"VNWRG,{command}") == ("VNWRG", command.split(","))
            data = stream(device)
            received = list(wire.messages(data))
            assert len(received) == 20
            values = []
            for message in received:
                assert isinstance(message, dict)
                assert list(message) == [position]
                values.append(message)
                if group in (4, 6, 7):  # a VN-100 has no GNSS and no INS
                    assert message[position] in ((b"\0" * 8,), (0.0,) * wire.FIELDS[position].count)
            expected = [wire.sample_of_packet(message) for message in values]
            _, items = decode(data)
            assert_samples(items, expected)
            for sample in expected[SETTLED:]:
                if sample is not None:
                    assert_at_rest(sample)


def test_the_fields_of_an_emulated_packet_agree_with_each_other() -> None:
    """The same quantity in two groups is the same; vectors, matrices and quaternions describe one attitude."""
    device = emulator()
    words = {g: sum(1 << b for h, b in wire.FIELDS if h == g) for g in (1, 2, 3, 5)}
    device.receive(wire.frame("VNWRG,05,921600"), 0.0)
    device.replies(0.0)
    groups = sum(1 << g - 1 for g in words)
    command = f"VNWRG,75,1,80,{groups:02X}," + ",".join(f"{word:04X}" for word in words.values())
    assert ask(device, command)[0] == "VNWRG"
    received = [message for message in wire.messages(stream(device)) if isinstance(message, dict)]
    assert len(received) == 20
    stamps = [message[1, 0][0] for message in received]
    steps = np.diff(np.array(stamps, dtype=float))
    assert np.abs(steps - 1e8).max() < 5e4  # 80 ticks of 1.25 ms, with the jitter of a real sensor
    for packet in received[1:]:
        number = {p: np.array(v, dtype=float) for p, v in packet.items() if not isinstance(v[0], bytes)}
        for one, other in (
            ((1, 0), (2, 0)), ((1, 3), (5, 1)), ((1, 4), (5, 2)), ((1, 5), (3, 10)), ((1, 8), (3, 9)),
            ((1, 12), (5, 0)), ((1, 13), (2, 7)),
        ):  # fmt: skip
            assert number[one].tolist() == number[other].tolist()
        assert number[1, 9].tolist() == [*number[3, 2], *number[3, 3]]
        assert number[1, 10].tolist() == [*number[3, 8], *number[3, 4], *number[3, 5]]
        assert number[1, 11].tolist() == [*number[3, 6], *number[3, 7]]
        assert number[3, 6][0] == pytest.approx(0.1, rel=1e-6)
        _assert_attitude(number)


def _assert_attitude(number: dict[wire.Position, np.ndarray]) -> None:
    """Check yaw, pitch, roll, quaternion and matrix of one packet against each other."""
    yaw, pitch, roll = np.radians(number[5, 1])
    x, y, z, w = number[5, 2]
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0, abs=1e-5)
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(yaw, abs=1e-5)
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(pitch, abs=1e-5)
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(roll, abs=1e-5)
    to_body = number[5, 3].reshape(3, 3).T  # column by column
    assert to_body @ to_body.T == pytest.approx(np.eye(3), abs=1e-5)
    assert to_body.T @ number[3, 8] == pytest.approx(number[5, 4], abs=1e-4)  # body to north, east, down
    assert to_body.T @ number[3, 9] == pytest.approx(number[5, 5], abs=1e-3)


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("firmware", ["2.1.0.0", "3.1.0.0"])
def test_replies_of_the_emulator_are_valid_for_the_independent_unpacker(
    firmware: str, check: wire.CheckWidth
) -> None:
    device = emulator(firmware)
    for number, register in REGISTERS.items():
        header, fields = ask(device, f"VNRRG,{number}", check)
        if not register.in_generation(2 if firmware[0] == "2" else 3):
            assert (header, fields) == ("VNERR", ["08"])
            continue
        assert (header, fields[0]) == ("VNRRG", f"{number:02d}")
        name = OUTPUT_MESSAGES.get(number)
        if name is not None:
            formats = [form for _, form in wire.SENTENCES[name]]
            assert [form % float(text) for form, text in zip(formats, fields[1:], strict=True)] == fields[1:]
    for body, code in (
        ("VNXYZ", 4),
        ("VNRRG", 5),
        ("VNWRG,07,40,1,1", 6),
        ("VNWRG,07,3", 7),
        ("VNRRG,99", 8),
    ):
        assert ask(device, body, check) == ("VNERR", [f"{code:02X}"])
    assert ask(device, "VNWRG,01,x", check) == ("VNERR", ["09"])


OUTPUT_MESSAGES = {
    8: "VNYPR", 9: "VNQTN", 15: "VNQMR", 17: "VNMAG", 18: "VNACC", 19: "VNGYR", 20: "VNMAR", 27: "VNYMR",
    54: "VNIMU", 80: "VNDTV", 115: "VNHVE", 239: "VNYBA", 240: "VNYIA",
}  # fmt: skip
"""Message with the fields of a measurement register (manual, tables of registers)."""
