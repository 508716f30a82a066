"""An emulated VN-100 without a line: commands in, messages out."""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats, SampleBlock
from imumon.sources.vn100 import ascii
from imumon.sources.vn100.decoder import Vn100Decoder
from imumon.sources.vn100.emulator import EmulatorSettings, Noise
from imumon.sources.vn100.emulator.command_handler import SAVING_S, CommandHandler
from imumon.sources.vn100.emulator.emulator import make_device

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
