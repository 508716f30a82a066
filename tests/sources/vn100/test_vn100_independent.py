"""The VN-100 codec against messages of an independent packer.

The emulator and the decoder share the code that packs and unpacks messages, so an error in it could cancel out. The
file `vn100_independent.json.gz` has messages with their numbers, made once by a program that was written separately
after the user manual (UM001 2.43), with the standard library only: every binary field, combinations of them, every
sentence with both checksums and all suffixes, errors, responses, and messages of other products.
"""

from __future__ import annotations

import gzip
import json
from itertools import product
from typing import Any

import numpy as np
import pytest
from cases import case
from paths import TESTS

from imumon.model.samples import SampleBlock
from imumon.sources.vn100 import ascii, binary
from imumon.sources.vn100.ascii import Response, SensorError
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder

VECTORS = json.loads(gzip.decompress((TESTS / "data" / "vn100_independent.json.gz").read_bytes()))


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
            for name, numbers in zip(layout.fields, vector["fields"], strict=True):
                assert decoded[name].tolist() == numbers, (vector["hex"], name)


def test_the_decoder_accepts_no_field_and_no_error_without_an_independent_vector() -> None:
    accepted = []
    for group, bit in product(range(1, 8), range(15)):
        decoder, word = Vn100Decoder(), (1 << bit).to_bytes(2, "little")
        decoder.feed(b"\xfa" + bytes([1 << group - 1]) + word)
        accepted += [[group, bit]] if decoder.pending else []
    assert accepted == VECTORS["positions"]
    assert set(ascii.ERRORS) == {vector["error"] for vector in VECTORS["messages"] if "error" in vector}
