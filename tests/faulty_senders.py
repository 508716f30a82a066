"""A sensor that breaks the rules of its door: an MTi with impossible numbers."""

from __future__ import annotations

import math
import struct
from pathlib import Path

from mt_emulator import MtEmulator

from imumon.sources.xsens.mt_messages import DataId

IMPOSSIBLE = (math.nan, math.inf, -math.inf, 1e38)


class ImpossibleMt(MtEmulator):
    """An MTi of which every tenth packet has a valid checksum and a number that no sensor measures.

    Attributes
    ----------
    impossible : such packets so far, once `failing` is set.
    """

    failing = False
    impossible = 0

    def __init__(self, link: Path) -> None:
        super().__init__(link=link, seed=1)

    def _packet(self, k: int) -> bytes:
        data = super()._packet(k)
        if not self.failing or k % 10:
            return data
        number, self.impossible = struct.pack(">f", IMPOSSIBLE[k // 10 % 4]), self.impossible + 1
        for field in (DataId.DELTA_V, DataId.ACCELERATION, DataId.RATE_OF_TURN):
            name = struct.pack(">HB", field, 12)
            if name in data:
                place = data.index(name) + len(name)
                data = data[:place] + number + data[place + 4 :]
        return data
