"""Driver of the VectorNav VN-100: what other packages reach through the registry."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from imumon.devices.base import (
    Check,
    Device,
    DeviceDriver,
    DeviceOptions,
    InvalidOption,
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
        from imumon.devices.vn100.doctor_checks import checks

        return checks(observation, settings)

    def reference_values(self, model: str | None) -> Mapping[tuple[str, str], Sequence[ReferenceValue]]:
        return {}

    def setting_text(self, name: str, value: str) -> str | None:
        from imumon.devices.vn100.register_text import meaning

        return meaning(name, value)

    def add_run_options(self, parser: argparse.ArgumentParser) -> None:
        pass

    def run_overrides(self, arguments: argparse.Namespace) -> dict[str, Any]:
        return {}

    def emulator(self, *, speed: float = 1.0, seed: int | None = None) -> AbstractContextManager[str]:
        from imumon.devices.vn100.emulator import EmulatorSettings, spawn

        process = spawn(EmulatorSettings(speed=speed, seed=seed))

        @contextmanager
        def running() -> Iterator[str]:
            with process:
                yield process.path

        return running()

    def add_emulator_options(self, parser: argparse.ArgumentParser) -> None:
        from imumon.devices.vn100.emulator import add_arguments

        add_arguments(parser)

    def run_emulator(self, arguments: argparse.Namespace) -> int:
        from imumon.devices.vn100.emulator import from_arguments, run

        settings = from_arguments(arguments)
        if settings.rate == 0:  # for tests only: a sensor without output
            raise InvalidOption("rate_invalid", "--rate 0 is no output rate", "give one, such as 40")
        return run(settings)
