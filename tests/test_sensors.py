"""Every sensor package keeps the contract, whatever comes down its line."""

from __future__ import annotations

import importlib
import pkgutil

import imumon.sensors
import numpy as np
import pytest

from imumon.devices.base import RawDecoder
from imumon.samples import SampleBlock

PACKAGES = [m.name for m in pkgutil.iter_modules(imumon.sensors.__path__) if m.ispkg]


def _decoder(package: str) -> RawDecoder:
    made: RawDecoder = importlib.import_module(f"imumon.devices.{package}").RawDecoder()
    return made


def test_there_is_a_sensor() -> None:
    assert "vn100" in PACKAGES


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("chunk", [1, 13, 100_000])
def test_garbage_is_discarded_to_the_byte(package: str, chunk: int) -> None:
    decoder = _decoder(package)
    data = np.random.default_rng(11).integers(0, 256, 20_000, np.uint8).tobytes()
    items = []
    for at in range(0, len(data), chunk):
        items += decoder.feed(data[at : at + chunk])
        assert decoder.fed == decoder.message_bytes + decoder.discarded + decoder.pending
        assert decoder.pending < 4096
    items += decoder.finish()
    assert not any(isinstance(item, SampleBlock) for item in items)
    assert (decoder.fed, decoder.messages, decoder.discarded, decoder.pending) == (len(data), 0, len(data), 0)


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_in_nothing_out(package: str) -> None:
    decoder = _decoder(package)
    assert (decoder.feed(b""), decoder.finish(), decoder.finish(), decoder.fed) == ([], [], [], 0)
