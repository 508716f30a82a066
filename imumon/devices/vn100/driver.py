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
        from imumon.devices.vn100.reference_values import REFERENCE_VALUES

        return REFERENCE_VALUES if _is_vn100(model) else {}

    def reference_notes(
        self, model: str | None, channels: Sequence[str], rate_hz: float | None
    ) -> Sequence[str]:
        from imumon.devices.vn100.reference_values import reference_notes

        return reference_notes(channels, rate_hz) if _is_vn100(model) else ()

    def setting_text(self, name: str, value: str) -> str | None:
        from imumon.devices.vn100.register_text import meaning

        return meaning(name, value)

    def add_run_options(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run_overrides(self, arguments: argparse.Namespace) -> dict[str, Any]:
        return {}

    def emulator(self, *, speed: float = 1.0, seed: int | None = None) -> AbstractContextManager[str] | None:
        raise NotImplementedError


def _is_vn100(model: str | None) -> bool:
    """Return whether a sensor that this driver reads is a VN-100; one that cannot be asked is taken for one."""
    return model is None or model.startswith("VN-100")
