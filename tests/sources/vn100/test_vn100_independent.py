"""The VN-100 codec and the emulator against the independent packer and unpacker of `vn100_wire`."""

from __future__ import annotations

import struct
from collections.abc import Sequence
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


def emulator() -> CommandHandler:
    """Return an emulated sensor with little noise at 921600 baud, without an asynchronous output."""
    settings = EmulatorSettings(seed=7, gyro=QUIET, accel=QUIET, mag=QUIET, baud=921600, rate=0)
    return make_device(settings)  # type: ignore[return-value]


def stream(device: CommandHandler, ticks: int = 1600) -> bytes:
    """Return what the sensor sends by itself up to a tick of its 800 Hz loop."""
    return b"".join(message for _, message in device.advance(ticks))
