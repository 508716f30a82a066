"""The VN-100 codec: vectors, recordings, streams and losses, and laws on damaged and mixed streams in any chunks."""

from __future__ import annotations

import gzip
import json
import re
from dataclasses import dataclass
from functools import reduce
from itertools import product
from operator import xor
from typing import Any

import numpy as np
import pytest
from cases import case
from hypothesis import example, given, settings
from hypothesis import strategies as st
from paths import RECORDINGS, TESTS

from imumon.model.samples import SampleBlock, Stream, concatenated
from imumon.sources.vn100 import ascii, binary, checksum
from imumon.sources.vn100.ascii import Response, SensorError
from imumon.sources.vn100.binary import BinaryLayout, Group
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder
from imumon.sources.vn100.register_text import describe_setting
from imumon.sources.vn100.registers import DATA_REGISTERS, REGISTERS


def decode(data: bytes, chunk: int = 1 << 20) -> tuple[Vn100Decoder, list[DecodedItem]]:
    """Return decoder and items; check the conservation of bytes after every feed."""
    decoder = Vn100Decoder()
    items: list[DecodedItem] = []
    for at in range(0, len(data), chunk):
        items += decoder.feed(data[at : at + chunk])
        assert decoder.fed == decoder.message_bytes + decoder.discarded + decoder.pending
    items += decoder.finish()
    assert decoder.pending == 0
    assert decoder.fed == decoder.message_bytes + decoder.discarded == len(data)
    return decoder, items


def blocks(items: list[DecodedItem], source: str = "") -> list[SampleBlock]:
    return [i for i in items if isinstance(i, SampleBlock) and i.stream.source.startswith(source)]


def total(items: list[DecodedItem], source: str = "") -> int:
    return sum(len(block) for block in blocks(items, source))


WINK = RECORDINGS / "wink.md"
"""Table of recordings with the numbers of their messages."""


def _wink() -> list[Any]:
    rows = re.findall(r"^\| (\S+\.bin) \| \d+ \| \d+ \| (\d+) \| \d+ \| (\d+) \|", WINK.read_text(), re.M)
    assert len(rows) == 12
    return [pytest.param(name, int(packets), int(lines), id=name) for name, packets, lines in rows]


@pytest.mark.few
@pytest.mark.parametrize("chunk", [97, 4096])
@pytest.mark.parametrize(("name", "packets", "lines"), _wink() if WINK.exists() else [])
def test_a_wink_recording_has_the_documented_messages(
    name: str, packets: int, lines: int, chunk: int
) -> None:
    decoder, items = decode((RECORDINGS / "wink" / name).read_bytes(), chunk)
    assert (total(items, "binary"), total(items, "$")) == (packets, lines)
    assert decoder.messages == packets + lines
    assert all(not block.lost.any() for block in blocks(items))
    if packets:
        assert decoder.bad_checksums == 0
        time = np.concatenate([b.time_ns for b in blocks(items, "binary") if b.time_ns is not None])
        steps = np.diff(time)
        assert np.all(np.abs(steps - np.median(steps)) < 50_000)
    else:
        assert decoder.bad_checksums > 0 or lines


# ---------------------------------------------------------------------------------- kinds, clocks


def test_a_mixed_message_has_the_worse_kind_and_the_kind_of_each_sensor() -> None:
    both = BinaryLayout.of({Group.IMU: 0x00C0 | 0x0100}).converter
    mixed = BinaryLayout.of({Group.IMU: 0x0044 | 0x0100}).converter
    assert both.stream.averaged == (True,) * 6 + (False,) * 3, "the magnetometer has no increments"
    assert mixed.stream.averaged == (True,) * 3 + (False,) * 6
    assert (mixed.stream.kind_of("gyro"), mixed.stream.kind_of("accel")) == ("deltas", "uncompensated")


def test_merged_blocks_keep_the_saturation_flags_of_their_samples() -> None:
    stream = Stream("uncompensated", ("gyro/x",), "test", "none")
    silent = SampleBlock(stream, np.zeros((2, 1)), None, np.zeros(2, np.int64), None)
    says = SampleBlock(stream, np.ones((1, 1)), None, np.zeros(1, np.int64), np.array([True]))
    joined = concatenated([silent, says])
    assert joined.saturated.tolist() == [False, False, True]
    assert concatenated([silent, silent]).saturated is None


def test_a_message_with_a_number_that_no_sensor_has_is_not_a_sample() -> None:
    layout = BinaryLayout.of({Group.IMU: 0x00C0})
    theta = np.full((9, 4), 0.01)
    theta[0, 1], theta[2, 2] = np.nan, np.inf
    theta[3, 0], theta[5, 0] = 0.0, -0.01  # intervals
    theta[6, 2], theta[7, 0] = -3e38, 1e-40
    decoder, items = decode(layout.encode({"deltaTheta": theta, "deltaVel": np.zeros((9, 3))}))
    assert (decoder.messages, decoder.discarded, decoder.ledger["not_finite"], total(items)) == (9, 0, 6, 3)
    assert blocks(items)[0].lost.tolist() == [0, 2, 3]
    assert np.abs(blocks(items)[0].values).max() < 1.0


# ----------------------------------------------------------------------------------------- losses


def _row(n: int) -> bytes:
    return ascii.encode(ascii.sentence("VNYMR", np.arange(12) * 0.1 + n))


def test_damaged_messages_count_before_the_next_sample_of_their_stream() -> None:
    layout = BinaryLayout.of({Group.IMU: 0x000E})
    packets = [layout.encode({"uncompGyro": [[n, 0, 0]]}) for n in range(8)]
    bad = bytes(packets[0][:20]) + b"\x55" + packets[0][21:]
    flipped = _row(0).replace(b"0", b"1", 1)
    line = bad + _row(9) + packets[1] + bad + bad + _row(1) + flipped + packets[2] + _row(2) + packets[3]
    decoder, items = decode(line)
    lost = {s: np.concatenate([b.lost for b in blocks(items, s)]).tolist() for s in ("binary", "$")}
    assert lost == {"binary": [0, 2, 0], "$": [0, 0, 1]}
    assert decoder.bad_checksums == 4


def test_truncated_messages_count_as_lost() -> None:
    _, items = decode(_row(0) + _row(1)[:50] + _row(2)[:7] + _row(3) + _row(4)[61:] + _row(5))
    assert blocks(items)[0].lost.tolist() == [0, 2, 0]
    _, items = decode(_row(0) + _row(1)[20:] + _row(2))
    assert blocks(items)[0].lost.tolist() == [0, 1]


@pytest.mark.parametrize("kind", ["packets", "sentences", "both"])
def test_samples_and_lost_messages_add_up_to_the_messages_sent(kind: str) -> None:
    layout = BinaryLayout.of({Group.TIME: 0x0001, Group.IMU: 0x00C0})
    theta = np.full((1500, 4), 0.1)
    packets = layout.encode({"timeStartup": np.arange(1500), "deltaTheta": theta})
    sent = [packets[at : at + layout.length] for at in range(0, len(packets), layout.length)]
    sent = [] if kind == "sentences" else sent
    sent += [] if kind == "packets" else [_row(n % 9) for n in range(500)]
    rng = np.random.default_rng(7)
    rng.shuffle(sent)
    line = bytearray(b"".join(sent))
    for place in rng.integers(500, len(line) - 500, 60):
        line[place] ^= 1 << rng.integers(8)
    decoder, items = decode(bytes(line), 300)
    lost = sum(int(block.lost.sum()) for block in blocks(items))
    assert 40 <= lost <= 60
    assert total(items) + lost == len(sent)
    assert 0.7 * lost <= decoder.bad_checksums <= lost


def test_losses_between_two_connections_are_not_estimated() -> None:
    decoder = Vn100Decoder()
    decoder.feed(_row(0) + b"\x85" * 1000 + _row(1)[:60])
    decoder.finish()
    (block,) = decoder.feed(_row(2) + _row(3))
    assert isinstance(block, SampleBlock)
    assert block.lost.tolist() == [0, 0]


# --------------------------------------------------------------------------------------- the line


def test_blocks_are_merged_only_without_an_item_between_them() -> None:
    answer = ascii.encode("VNRRG,07,40", "crc")
    _, items = decode(_row(0) + _row(1) + answer + _row(2) + ascii.encode("VNYPR,+1.0,+2.0,+3.0") + _row(3))
    assert [len(i) if isinstance(i, SampleBlock) else i for i in items] == [
        2,
        Response("VNRRG", ("07", "40")),
        2,
    ]


@pytest.mark.parametrize("interval", ["2000000.0", "0.0", "-1.0"])
def test_an_interval_that_no_sensor_has_is_a_lost_sample(interval: str) -> None:
    rows = [f"VNDTV,{dt},+000.010,+000.020,+000.030,+0.1,+0.2,+0.3" for dt in ("0.01", interval, "0.01")]
    decoder, items = decode(b"".join(map(ascii.encode, rows)))
    assert (decoder.messages, decoder.ledger["not_finite"], total(items)) == (3, 1, 2)
    assert blocks(items)[0].lost.tolist() == [0, 1]


@pytest.mark.parametrize(
    "body",
    [
        "VNACC", "VNACC,1,2", "VNACC,1,2,3,4", "VNACC,1,2,", "VNACC,1,2,nan", "VNACC,1,2,inf",
        "VNACC,1,2,1e3", "VNACC,1,2,1_0", "VNACC,1,2, 3", "VNACC,1,2,--3", "VNACC,1,2,3.",
        "VNACC,1,2,.3", "VNACC,1,2,+",
        "VNACC,1,2,1234567890123456", "VNACC,1,2,3,T", "VNACC,1,2,3,T12,T13", "VNACC,1,2,3,S000",
        "VNACC,1,2,3,S00G0", "VNACC,1,2,3,T-1", "VNACC,1,2,3,T1,S0000,S0000", "VNACC,S0000,1,2,3",
        "VNERR", "VNERR,XY", "VNERR,003", "VNERR,1,2",
    ],
)  # fmt: skip
def test_a_valid_checksum_with_invalid_grammar_is_refused(body: str) -> None:
    decoder, items = decode(ascii.encode(body))
    assert (decoder.messages, decoder.bad_checksums, items) == (0, 0, [])
    assert decoder.discarded == decoder.fed


# ---------- the VN-100 codec against messages of an independent packer


VECTORS = json.loads(gzip.decompress((TESTS / "data" / "vn100_independent.json.gz").read_bytes()))
"""Messages with their numbers, of a packer that was written separately after the user manual (UM001 2.43).

The emulator and the decoder share the code that packs messages, so an error in it could cancel out. Every binary
field, combinations of them, every sentence with both checksums and all suffixes, errors, responses, other products.
"""


def sample(item: DecodedItem) -> dict[str, Any]:
    """Return the only sample of a block as a vector has it."""
    assert isinstance(item, SampleBlock)
    sensors, saturated = list(dict.fromkeys(item.stream.sensors)), None
    if item.saturated is not None:
        saturated = sorted(np.array(sensors)[item.saturated[0]].tolist())
    return {
        "kind": item.stream.kind,
        "values": dict(zip(item.stream.channels, item.values[0].tolist(), strict=True)),
        "clock": item.stream.clock,
        "time_ns": None if item.time_ns is None else int(item.time_ns[0]),
        "saturated": saturated,
    }


def test_every_independent_message_is_decoded_to_its_numbers_in_any_chunks() -> None:
    for vector in VECTORS["messages"]:
        data = bytes.fromhex(vector["hex"])
        for chunk in (1, 7, len(data)):
            with case((vector["hex"], chunk)):
                decoder = Vn100Decoder()
                items = [i for at in range(0, len(data), chunk) for i in decoder.feed(data[at : at + chunk])]
                items += decoder.finish()
                assert (decoder.messages, decoder.message_bytes, decoder.discarded) == (1, len(data), 0)
                if "error" in vector:
                    assert [i.code for i in items if isinstance(i, SensorError)] == [vector["error"]]
                elif "response" in vector:
                    command, *fields = vector["response"]
                    assert items == [Response(command, tuple(fields))]
                elif vector.get("sample") is None:
                    assert items == []
                else:
                    (item,) = items
                    expected, found = vector["sample"], sample(item)
                    numbers = pytest.approx(list(expected["values"].values()), rel=1e-14)
                    assert list(found["values"]) == list(expected["values"])
                    assert list(found.pop("values").values()) == numbers
                    assert found == {name: value for name, value in expected.items() if name != "values"}


def test_every_field_of_an_independent_packet_has_its_numbers() -> None:
    for vector in VECTORS["messages"]:
        if "fields" in vector:
            data = bytes.fromhex(vector["hex"])
            layout = binary.parse_header(data)
            assert layout.length == len(data)
            decoded = layout.decode(data)[0]
            assert layout.encode({name: decoded[name][None] for name in layout.fields}) == data
            for name, numbers in zip(layout.fields, vector["fields"], strict=True):
                assert decoded[name].tolist() == numbers, (vector["hex"], name)


def test_the_decoder_accepts_no_field_and_no_error_without_an_independent_vector() -> None:
    accepted = []
    for group, bit in product(range(1, 8), range(15)):
        decoder, word = Vn100Decoder(), (1 << bit).to_bytes(2, "little")
        decoder.feed(b"\xfa" + bytes([1 << group - 1]) + word)
        accepted += [[group, bit]] if decoder.pending else []
    assert accepted == VECTORS["positions"]
    assert decode(b"$VNRRG,01*XX\r\n")[1] == []  # only a host may send XX
    assert set(ascii.ERRORS) == {vector["error"] for vector in VECTORS["messages"] if "error" in vector}


# ---------- descriptions of settings: every register that changes the data has one, and no value makes it fai


def named(number: int) -> str:
    return f"{number} {REGISTERS[number].name}"


@pytest.mark.parametrize(
    ("number", "value", "expected"),
    [
        (85, "0,20,20,4,0,0,3,3,3,0", "accel and gyro averaged over 20 samples (25 ms); temperature"),
        (85, "0,1,0,0,0,0,3,3,3,0", "no averages"),
        (85, "0,0,8,0,0,0,0,2,0,0", "gyro averaged over 8 samples (10 ms), compensated outputs only"),
        (82, "0,1,0,0,0", "bias of gyro removed"),
    ],
)
def test_a_description_says_what_the_setting_does(number: int, value: str, expected: str) -> None:
    assert expected in (describe_setting(named(number), value) or "")


def test_an_unknown_setting_has_no_description() -> None:
    for name, text in (
        ("", ""),
        ("VPE", "on"),
        ("999 what", "1"),
        ("85 IMU filtering", "x"),
        ("6 type", "14"),
        ("35 VPE basic control", "1,1,1,1"),
    ):
        assert describe_setting(name, text) is None


@given(number=st.sampled_from(DATA_REGISTERS), text=st.text("0123456789,.-+AFx", max_size=40))
def test_no_value_makes_the_description_fail(number: int, text: str) -> None:
    description = describe_setting(named(number), text)
    assert description is None or description


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
