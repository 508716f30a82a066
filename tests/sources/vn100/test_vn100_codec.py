"""The VN-100 codec: vectors, recordings, streams and kinds, losses, framing."""

from __future__ import annotations

import base64
import json
import math
import re
from typing import Any

import numpy as np
import pytest
from cases import case
from paths import RECORDINGS, TESTS

from imumon.model.samples import SampleBlock, Stream, concatenated
from imumon.sources.vn100 import ascii, binary
from imumon.sources.vn100.ascii import Response, SensorError
from imumon.sources.vn100.binary import BinaryLayout, Group
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder

CHUNKS = (1, 2, 7, 61, 1 << 20)


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


def only(data: bytes) -> SampleBlock:
    """Return the only block in the data."""
    _, items = decode(data)
    (block,) = items
    assert isinstance(block, SampleBlock)
    return block


def flat(values: Any) -> list[float]:
    """Return all numbers in nested lists, in order."""
    if isinstance(values, dict):
        values = list(values.values())
    return [x for v in values for x in flat(v)] if isinstance(values, list) else [values]


# ---------------------------------------------------------------------------------------- vectors


def test_vectors_decode_the_same_in_any_chunks() -> None:
    for vector in json.loads((TESTS / "data" / "vn100_vectors.json").read_text()):
        with case(vector["id"]):
            data = base64.b64decode(vector["b64"]) if "b64" in vector else bytes.fromhex(vector["hex"])
            for chunk in CHUNKS if vector["kind"] == "stream" else range(1, len(data) + 1):
                decoder, items = decode(data, chunk)
                _vector_is(vector, data, decoder, items)


def _vector_is(vector: dict[str, Any], data: bytes, decoder: Vn100Decoder, items: list[DecodedItem]) -> None:
    expect = vector.get("expect")
    if vector["kind"] == "stream":
        assert total(items, "$") == expect["ascii_async"]
        assert total(items, "binary") + decoder.nonfinite == expect["binary"]
    elif vector["id"] == "own-cmd-xx" or not vector["valid"]:  # only a host may send XX
        assert (decoder.messages, items) == (0, [])
    else:
        assert (decoder.messages, decoder.discarded) == (1, 0)
        if vector["kind"] == "ascii_response_or_command":
            fields = tuple(expect["fields"])
            if "register" in expect:
                assert isinstance(items[0], Response)
                assert int(items[0].fields[0]) == expect["register"]
                fields = (items[0].fields[0], *fields)
            assert items == [Response(expect["header"], fields)]
        elif vector["kind"] == "ascii_error":
            assert [i.code for i in items if isinstance(i, SensorError)] == [expect["code"]]
        elif vector["kind"] == "binary":
            _packet_is(data, items, flat(expect["values"]))
        else:
            _sentence_is(data, items, expect)


def _sentence_is(data: bytes, items: list[DecodedItem], expect: dict[str, Any]) -> None:
    sentence_format = ascii.sentence_format(data[1 : data.rindex(b"*")])
    want = list(expect["values"].values()) + [expect[k] for k in ("count",) if k in expect]
    assert sentence_format.read(data, 0, len(data), 1)[0].tolist() == want
    names = list(expect["values"])
    for block in blocks(items):
        assert (block.stream.clock == "counter") == ("count" in expect)
        if "count" in expect:
            assert block.time_ns.tolist() == [expect["count"]]
        for channel, value in zip(block.stream.channels, block.values[0], strict=True):
            name = channel.replace("gyro/", "GYRO").replace("accel/", "ACCEL").replace("mag/", "MAG")
            name = {"temperature": "temp", "pressure": "pres"}.get(name, name.lower())
            column = [n.lower().removeprefix("u") for n in names]
            if name in column:
                assert value == expect["values"][names[column.index(name)]]
            else:
                turn = {"gyro": ("dtheta", math.pi / 180.0), "accel": ("dvel", 1.0)}
                of, factor = turn[name[:-1]]
                raw = expect["values"][names[column.index(of + name[-1])]]
                assert value == pytest.approx(raw * factor / expect["values"]["deltaTime"], rel=1e-14)


def _packet_is(data: bytes, items: list[DecodedItem], want: list[float]) -> None:
    layout = binary.parse_header(data)
    packet = layout.decode(data)[0]
    got = [float(x) for name in layout.fields for x in packet[name]]
    assert got == pytest.approx(want, rel=1e-6)
    values = {name: packet[name][None] for name in layout.fields}
    assert layout.encode(values) == data
    assert (not blocks(items)) == (layout.converter is None or not _usable(layout, packet))


def _usable(layout: BinaryLayout, packet: Any) -> bool:
    if "dt" not in layout.sources or layout.converter is None or layout.converter.stream.kind != "deltas":
        return True
    name, where = layout.sources["dt"]
    return bool(packet[name][where][0] > 0.0)


# ------------------------------------------------------------------------------------- recordings


def _wink() -> list[Any]:
    page = RECORDINGS / "wink.md"
    if not page.exists():
        return [
            pytest.param(
                "", 0, 0, id="absent", marks=pytest.mark.skip(reason="no recordings beside the checkout")
            )
        ]
    rows = re.findall(r"^\| (\S+\.bin) \| \d+ \| \d+ \| (\d+) \| \d+ \| (\d+) \|", page.read_text(), re.M)
    assert len(rows) == 12
    return [pytest.param(name, int(packets), int(lines), id=name) for name, packets, lines in rows]


@pytest.mark.few
@pytest.mark.parametrize("chunk", [97, 4096])
@pytest.mark.parametrize(("name", "packets", "lines"), _wink())
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
    assert (decoder.messages, decoder.discarded, decoder.nonfinite, total(items)) == (9, 0, 6, 3)
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
    assert (decoder.messages, decoder.nonfinite, total(items)) == (3, 1, 2)
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
