"""Driver of the VectorNav VN-100: what other packages reach through the registry."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from imumon.devices.base import (
    Check,
    Device,
    DeviceDriver,
    DeviceOptions,
    Observation,
    RawDecoder,
    ReferenceValue,
)


class Vn100Driver(DeviceDriver):
    """VN-100 on a serial port, a pyserial URL, or ``sim`` (the emulator)."""

    scheme = "vn100"
    title = "VectorNav VN-100"

    def create(self, options: DeviceOptions) -> Device:
        raise NotImplementedError

    def decoder(self) -> RawDecoder:
        from imumon.devices.vn100.decoder import Vn100Decoder

        return Vn100Decoder()

    def checks(self, observation: Observation, settings: Any) -> Iterator[Check]:
        yield from ()

    def reference_values(self, model: str | None) -> Mapping[tuple[str, str], Sequence[ReferenceValue]]:
        return {}

    def setting_text(self, name: str, value: str) -> str | None:
        from imumon.devices.vn100.register_text import describe_setting

        return describe_setting(name, value)

    def add_run_options(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run_overrides(self, arguments: argparse.Namespace) -> dict[str, Any]:
        return {}

    def emulator(self, *, speed: float = 1.0, seed: int | None = None) -> AbstractContextManager[str] | None:
        raise NotImplementedError
