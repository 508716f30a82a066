"""Coverage-guided fuzzing of the VN-100 decoder against a simple implementation of its rules.

The fuzzer composes streams of random bytes, of sentences and packets with any content and a valid checksum, of
damage and repetition. The decoder must not raise, must conserve bytes, must give the same result for any chunks,
and must find exactly what `reference` finds, which has no arrays, no patterns and no chunks.

    pip install atheris
    python benchmarks/fuzz_codec.py -max_total_time=600 -max_len=2048
"""

from __future__ import annotations

import math
import re
import struct
import sys
import warnings

import atheris

with atheris.instrument_imports(include=["imumon"]):
    from imumon.devices.vn100 import ascii, binary, checksum
    from imumon.devices.vn100.decoder import Vn100Decoder
    from imumon.samples import SampleBlock

NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?")
SENTENCE = re.compile(rb"\$(VN[A-Z0-9]{3})((?:,[^$\r\n\xfa]*)?)\*([0-9A-Fa-f]{2}|[0-9A-Fa-f]{4})\r?\n")
SIZES = {"u1": 1, "<u2": 2, "<u4": 4, "<u8": 8, "<f4": 4, "<f8": 8}
MESSAGES = [*ascii.MEASUREMENTS, "VNRRG", "VNERR", "VNGPS", "VNXYZ"]


def packet_length(data: bytes, at: int) -> int | None:
    """Return the length of the packet at `at` by its header; None: no valid or no complete header."""
    try:
        start = at
        byte, at = data[at + 1], at + 2
        if byte & 0x80:
            if data[at]:
                return None
            at += 1
        payload = 0
        for group in range(1, 8):
            if not byte >> (group - 1) & 1:
                continue
            (word,) = struct.unpack_from("<H", data, at)
            at += 2
            if not word & 0x7FFF:
                return None
            for bit in range(15):
                if word >> bit & 1:
                    field = binary.GROUPS[group][bit]
                    payload += SIZES[field.code] * field.width
            if word & 0x8000:
                if data[at] or data[at + 1]:
                    return None
                at += 2
        return at - start + payload + 2 if payload else None
    except (IndexError, struct.error, KeyError):
        return None


def grammatical(name: str, fields: list[str]) -> list[float] | None:
    """Return the numbers of a measurement, with the count of T last; None: its grammar is wrong."""
    fields = fields[:]
    marks: list[str] = []
    while fields and fields[-1][:1] in ("S", "T") and len(marks) < 2:
        marks.append(fields.pop())
    if len({mark[0] for mark in marks}) != len(marks):
        return None
    count = [mark[1:] for mark in marks if mark[0] == "T"]
    if not all(re.fullmatch("T[0-9]{1,15}|S[0-9A-Fa-f]{4}", mark) for mark in marks):
        return None
    if len(fields) != sum(ascii.WIDTHS[q] for q in ascii.MEASUREMENTS[name]):
        return None
    if not all(NUMBER.fullmatch(field) and sum(c.isdigit() for c in field) <= 15 for field in fields):
        return None
    return [float(field) for field in fields + count]


def reference(data: bytes) -> list[tuple[bytes, list[float] | None]]:
    """Return the valid messages, each with its numbers if it is an ASCII measurement."""
    found: list[tuple[bytes, list[float] | None]] = []
    at = 0
    while at < len(data):
        message = data[at : at + 1]
        if message == b"\xfa":
            length = packet_length(data, at)
            if (
                length is not None
                and at + length <= len(data)
                and not checksum.crc16(data[at + 1 : at + length])
            ):
                found.append((data[at : at + length], None))
                at += length
                continue
        elif message == b"$" and (match := SENTENCE.match(data, at, at + 256)) is not None:
            body, check = match[1] + match[2], match[3]
            right = 0
            for byte in body:
                right ^= byte
            if int(check, 16) == (right if len(check) == 2 else checksum.crc16(body)):
                name, *fields = body.decode("latin1").split(",")
                numbers = grammatical(name, fields) if name in ascii.MEASUREMENTS else []
                if numbers == [] and not re.fullmatch(rb"[ -~]*", body):
                    numbers = None
                if name == "VNERR" and (len(fields) != 1 or not re.fullmatch("[0-9A-Fa-f]{1,2}", fields[0])):
                    numbers = None
                if numbers is not None:
                    found.append((match[0], numbers))
                    at = match.end()
                    continue
        at += 1
    return found


def program(provider: atheris.FuzzedDataProvider) -> bytes:
    """Return the stream that the fuzzer composes."""
    line = b""
    while provider.remaining_bytes() and len(line) < 6000:
        act = provider.ConsumeIntInRange(0, 6)
        if act == 0:
            piece = provider.ConsumeBytes(provider.ConsumeIntInRange(0, 64))
        elif act == 1:
            body = provider.ConsumeBytes(provider.ConsumeIntInRange(0, 120))
            name = MESSAGES[provider.ConsumeIntInRange(0, len(MESSAGES) - 1)]
            piece = ascii.encode(name.encode() + b"," + body, "crc" if provider.ConsumeBool() else "xor")
        elif act in (2, 3):
            name = [*ascii.MEASUREMENTS][provider.ConsumeIntInRange(0, len(ascii.MEASUREMENTS) - 1)]
            width = sum(ascii.WIDTHS[q] for q in ascii.MEASUREMENTS[name])
            values = [provider.ConsumeIntInRange(-20_000, 20_000) / 1000 for _ in range(width)]
            tail = ["", ",T12", ",S0A1b", ",T0000000001,S0000", ",S1234,T9"][provider.ConsumeIntInRange(0, 4)]
            piece = ascii.encode(
                ascii.sentence(name, values) + tail, "crc" if provider.ConsumeBool() else "xor"
            )
            piece = piece.replace(b"\r\n", b"\n") if provider.ConsumeBool() else piece
        elif act in (4, 5):
            head = bytes([0xFA, provider.ConsumeIntInRange(0, 255)]) + provider.ConsumeBytes(
                provider.ConsumeIntInRange(2, 10)
            )
            length = packet_length(head, 0) or len(head) + 2
            piece = (head + provider.ConsumeBytes(length).ljust(length, b"\x3e"))[: length - 2]
            piece += checksum.crc16(piece[1:]).to_bytes(2, "big")
        else:
            piece = line[-provider.ConsumeIntInRange(0, 300) :] if line else b""
        if piece and provider.ConsumeIntInRange(0, 5) == 0:
            place = provider.ConsumeIntInRange(0, len(piece) - 1)
            kind = provider.ConsumeIntInRange(0, 2)
            piece = (
                piece[:place]
                + bytes([piece[place] ^ provider.ConsumeIntInRange(1, 255)])
                + piece[place + 1 :],
                piece[:place],
                piece[place:],
            )[kind]
        line += piece * provider.ConsumeIntInRange(1, 12 if len(piece) < 200 else 2)
    return line


def decode(line: bytes, cuts: list[int]) -> tuple[Vn100Decoder, list[object]]:
    """Return the decoder after its end, and its items with blocks split into samples."""
    decoder = Vn100Decoder()
    out: list[object] = []
    items = []
    for start, end in zip([0, *cuts], [*cuts, len(line)], strict=True):
        items += decoder.feed(line[start:end])
        assert decoder.fed == end == decoder.message_bytes + decoder.discarded + decoder.pending
        assert decoder.pending < 2048
    items += decoder.finish()
    assert decoder.fed == decoder.message_bytes + decoder.discarded
    for item in items:
        if not isinstance(item, SampleBlock):
            out.append(item)
            continue
        for row in range(len(item)):
            assert all(map(math.isfinite, item.values[row]))
            assert item.lost[row] >= 0
            time = None if item.time_ns is None else item.time_ns[row]
            flag = None if item.saturated is None else item.saturated[row]
            out.append((item.stream, item.values[row].tobytes(), time, item.lost[row], flag))
    return decoder, out


COUNTERS = ("messages", "message_bytes", "discarded", "bad_checksums", "nonfinite")


def test_one_input(data: bytes) -> None:
    """Check all laws on one input."""
    provider = atheris.FuzzedDataProvider(data)
    cuts = [provider.ConsumeIntInRange(0, 400) for _ in range(provider.ConsumeIntInRange(0, 4))]
    line = program(provider)
    whole, items = decode(line, [])
    other, others = decode(line, sorted(min(cut, len(line)) for cut in cuts))
    assert items == others
    assert [getattr(whole, name) for name in COUNTERS] == [getattr(other, name) for name in COUNTERS]
    messages = reference(line)
    assert whole.messages == len(messages)
    assert whole.message_bytes == sum(len(message) for message, _ in messages)
    read = []
    for message, numbers in messages:
        if numbers:
            sentence_format = ascii.sentence_format(message[1 : message.rindex(b"*")])
            assert sentence_format is not None
            assert sentence_format.read(message, 0, len(message), 1)[0].tolist() == numbers
        if message[:1] == b"\xfa" and (layout := binary.parse_header(message)) is not None:
            assert layout.length == len(message)
        converter = (
            sentence_format.converter
            if numbers
            else layout.converter
            if message[:1] == b"\xfa" and layout
            else None
        )
        read.append(converter is not None)
    assert sum(isinstance(item, tuple) for item in items) == sum(read) - whole.nonfinite


def main() -> None:
    """Fuzz until interrupted."""
    warnings.simplefilter("error")
    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
