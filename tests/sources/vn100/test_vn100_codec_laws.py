"""Laws of the VN-100 decoder on intact, damaged and mixed streams in any chunks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from imumon.model.samples import SampleBlock
from imumon.sources.vn100 import ascii, checksum
from imumon.sources.vn100.binary import BinaryLayout, Group
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder

LAYOUTS = (
    BinaryLayout.of({Group.TIME: 0x0001, Group.IMU: 0x00D2}),
    BinaryLayout.of({Group.COMMON: 0x0739}),
    BinaryLayout.of({Group.IMU: 0x0008}),
    BinaryLayout.of({Group.COMMON: 0x0020, Group.ATTITUDE: 0x0002}),
)
MESSAGES = ("VNYMR", "VNIMU", "VNGYR", "VNDTV", "VNQMR")
laws = settings(derandomize=True, max_examples=60)


@dataclass(frozen=True)
class Piece:
    """Bytes of a stream; `tag` is the gyro/x of the sample in them, None if they must not give a sample."""

    data: bytes
    tag: float | None


def message(kind: int, serial: int, check: str, end: bytes, tail: str) -> Piece:
    """Return a valid measurement whose gyro/x is unique."""
    x = serial * 1e-3
    if kind < len(LAYOUTS):
        layout = LAYOUTS[kind]
        theta = [[0.5, x, 1.5, 1.5]]
        rate, imu = [[x, 2.0, -2.0]], [[-250.0, 1e-7, 9.81, x, 2.0, -2.0]]
        fields: dict[str, Any] = {"deltaTheta": theta, "angularRate": rate, "uncompGyro": rate, "imu": imu}
        data = layout.encode({"timeStartup": [serial], "quat": [[np.inf] * 4], **fields})
        scale = np.pi / 180.0 / 0.5 if kind == 0 else 1.0
        return Piece(data, float(np.float32(x)) * scale)
    name = MESSAGES[kind - len(LAYOUTS)]
    numbers = [0.25] * sum(ascii.WIDTHS[q] for q in ascii.MEASUREMENTS[name])
    quantities = ascii.MEASUREMENTS[name]
    gyro = next(q for q in quantities if q in ("gyro", "ugyro", "dtheta"))
    at = sum(ascii.WIDTHS[q] for q in quantities[: quantities.index(gyro)])
    numbers[at] = x
    body = ascii.sentence(name, numbers) + tail
    data = ascii.encode(body, "crc" if check == "crc" else "xor")[:-2] + end
    return Piece(data, float(f"{x:.6f}") / 0.25 * np.pi / 180.0 if name == "VNDTV" else float(f"{x:.6f}"))


KINDS = st.integers(0, len(LAYOUTS) + len(MESSAGES) - 1)
CHECKS = st.sampled_from(["xor", "crc"])
ENDS = st.sampled_from([b"\r\n", b"\n"])
TAILS = st.sampled_from(["", "", ",T0000000543", ",S0C01,T12", ",T7,S0001"])
OTHERS = st.sampled_from(
    [
        ascii.encode("VNRRG,07,40"),
        ascii.encode("VNERR,0C", "crc"),
        ascii.encode("VNYPR,+1.0,-2.0,+3.0"),
        b"log: 12\r\n",
    ]
)
EVIL = st.lists(
    st.sampled_from([b"\xfa", b"$", b"$VN", b"$VNYMR,", b"\xfa\x01\x08\x00", b"*65\r\n", b"\n", b"0"]),
    max_size=6,
)
DAMAGE = st.sampled_from(["none", "none", "none", "none", "flip", "head", "tail", "hole", "double"])


@st.composite
def lines(draw: st.DrawFn) -> list[Piece]:
    """Draw a stream: runs of messages, some damaged, with responses, text and random bytes between them."""
    pieces: list[Piece] = []
    for serial in range(1, draw(st.integers(1, 6))):
        kind, check, end, tail = draw(KINDS), draw(CHECKS), draw(ENDS), draw(TAILS)
        for turn in range(draw(st.sampled_from([1, 1, 2, 12]))):
            piece = message(kind, serial * 16 + turn, check, end, tail)
            data, damage = piece.data, draw(DAMAGE)
            place = draw(st.integers(2, len(data) - 3))
            if damage == "flip":
                # bit 0 of a byte: every check finds one flipped bit
                data = data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]
            elif damage == "head":
                # more than half is missing, so that two fragments cannot form a message
                data = data[: min(place, len(data) // 2)] + b"\n"
            elif damage == "tail":
                data = data[max(place, len(data) // 2) :]
            elif damage == "hole":
                data = data[: 1 + place // 2] + data[1 + place :]
            pieces.append(Piece(data, piece.tag if damage in ("none", "double") else None))
            if damage == "double":
                pieces.append(pieces[-1])
        between = draw(st.one_of(st.binary(max_size=40), OTHERS, EVIL.map(b"".join)))
        pieces.append(Piece(between, None))
    return pieces


def run(data: bytes, cuts: list[int]) -> tuple[list[DecodedItem], list[int], Vn100Decoder]:
    """Return the items, the counters before `finish`, and the decoder."""
    decoder = Vn100Decoder()
    items: list[DecodedItem] = []
    for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
        items += decoder.feed(data[start:end])
        assert decoder.fed == end == decoder.message_bytes + decoder.discarded + decoder.pending
        assert decoder.pending < 2048
    counters = [decoder.messages, decoder.message_bytes, decoder.discarded, decoder.pending]
    items += decoder.finish()
    assert decoder.pending == 0
    assert decoder.fed == decoder.message_bytes + decoder.discarded
    names = ("messages", "discarded", "bad_checksums", "ledger")
    return items, counters + [getattr(decoder, name) for name in names], decoder


def rows(items: list[DecodedItem]) -> list[Any]:
    """Return the items with blocks split into samples, so that merging makes no difference."""
    out: list[Any] = []
    for item in items:
        if not isinstance(item, SampleBlock):
            out.append(item)
            continue
        assert len(item) == len(item.values) == len(item.lost) > 0
        assert np.isfinite(item.values).all()
        assert (item.lost >= 0).all()
        for i in range(len(item)):
            time = None if item.time_ns is None else int(item.time_ns[i])
            flag = None if item.saturated is None else bool(item.saturated[i].any())
            out.append((item.stream, item.values[i].tobytes(), time, int(item.lost[i]), flag))
    return out


def values_of(items: list[DecodedItem]) -> list[float]:
    return [float(v) for i in items if isinstance(i, SampleBlock) for v in i.values[:, 0]]


@laws
@given(lines(), st.data())
def test_any_chunks_give_the_same_items_and_counters(pieces: list[Piece], data: st.DataObject) -> None:
    line = b"".join(piece.data for piece in pieces)
    whole, counters, _ = run(line, [])
    single, counters_single, _ = run(line, list(range(1, len(line))))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(line)), max_size=8)))
    some, counters_some, _ = run(line, cuts)
    assert rows(whole) == rows(single) == rows(some)
    assert counters == counters_single == counters_some


@laws
@given(lines())
def test_exactly_the_intact_messages_give_samples(pieces: list[Piece]) -> None:
    items, _, _ = run(b"".join(piece.data for piece in pieces), [])
    expected = [piece.tag for piece in pieces if piece.tag is not None]
    assert len(values_of(items)) == len(expected)
    np.testing.assert_allclose(values_of(items), expected, rtol=1e-14)


@laws
@given(st.lists(st.one_of(st.binary(max_size=300), EVIL.map(b"".join)), max_size=12).map(b"".join))
@example(b"\xfa" * 5000)
@example(b"$" * 5000)
@example(b"$VNYMR," * 500)
@example(b"\xfa\x77\xff\x7f" * 1000)
@example(b"\xfa\xff\xff\xff\xff" * 1000)
def test_random_bytes_give_no_sample_and_no_exception(data: bytes) -> None:
    items, _, _ = run(data, [])
    assert values_of(items) == []


@pytest.mark.parametrize("kind", range(len(LAYOUTS) + len(MESSAGES)))
@pytest.mark.parametrize("check", ["xor", "crc"])
def test_a_flipped_bit_never_changes_a_sample(kind: int, check: str) -> None:
    """The only harmless bit is the one that changes a hexadecimal digit from upper to lower case."""
    piece = message(kind, 77, check, b"\r\n", "")
    after = message(kind, 78, check, b"\r\n", "")
    for bit in range(len(piece.data) * 8):
        data = bytearray(piece.data)
        data[bit // 8] ^= 1 << bit % 8
        items, _, _ = run(bytes(data) + after.data, [])
        in_check = len(data) - 7 < bit // 8 and piece.data.endswith(b"\r\n")
        expected = [piece.tag, after.tag] if in_check and chr(data[bit // 8]) in "abcdef" else [after.tag]
        assert len(values_of(items)) == len(expected)
        np.testing.assert_allclose(values_of(items), expected, rtol=1e-14)


NUMBERS = st.from_regex(r"[+-]?[0-9]{1,9}(\.[0-9]{1,6})?", fullmatch=True)


@laws
@given(st.lists(NUMBERS, min_size=3, max_size=3), st.integers(1, 40))
@example(["-0.000", "+00.0", "-999999999.999999"], 3)
def test_numbers_are_parsed_exactly_as_float_does(fields: list[str], count: int) -> None:
    data = ascii.encode(",".join(["VNGYR", *fields])) * count
    (block,) = Vn100Decoder().feed(data)
    assert isinstance(block, SampleBlock)
    expected = np.array([[float(field) for field in fields]] * count)
    assert block.values.tobytes() == expected.tobytes()


@laws
@given(st.binary(min_size=1, max_size=80))
def test_checksums_match_the_bitwise_definition(data: bytes) -> None:
    assert checksum.xor8(data) == reduce(xor, data)
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    assert checksum.crc16(data) == crc
    assert checksum.crc16(data + crc.to_bytes(2, "big")) == 0


@pytest.mark.few
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("where", [0, 127, 128, 129, 640, 641, 2500, 2999])
def test_a_long_run_ends_at_the_first_damaged_packet(layout: BinaryLayout, where: int) -> None:
    """A flipped bit in header, payload or CRC, also in packets that are checked as an array."""
    rows = np.random.default_rng(3).normal(size=(3000, 3))
    data = layout.encode(
        {name: rows for name in layout.fields if layout.dtype[name].shape == (3,)}
        or {"timeStartup": np.arange(3000)}
    )
    assert layout.count_valid(data, 0, 3000) == 3000
    for byte in (0, len(layout.header) - 1, layout.length // 2, layout.length - 1):
        damaged = bytearray(data)
        damaged[where * layout.length + byte] ^= 0x10
        assert layout.count_valid(bytes(damaged), 0, 3000) == where
