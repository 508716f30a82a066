"""Driver of the VectorNav VN-100: the interface for other packages, through the registry."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from imumon.sources.clock import REAL_TIME, HostClock
from imumon.sources.device import (
    Check,
    Device,
    DeviceDriver,
    DeviceOptions,
    InvalidOption,
    Observation,
    RawDecoder,
)
from imumon.sources.vn100.doctor_checks import checks
from imumon.sources.vn100.emulator import add_arguments, from_arguments, spawn, time_lapse_settings
from imumon.sources.vn100.emulator.process import run
from imumon.sources.vn100.register_text import describe_setting
from imumon.sources.vn100.stream_settings import FACTORY_WINDOW, alias_factor, filter_advice


class Vn100Driver(DeviceDriver):
    """VN-100 on a serial port or a pyserial URL."""

    scheme = "vn100"
    title = "VectorNav VN-100"
    settings = frozenset({"baud", "set_baud", "set_rate_hz", "rate_hz", "listen_only", "stream"})

    def create(self, options: DeviceOptions) -> Device:
        from imumon.sources.vn100.vn100_session import Vn100Device

        return Vn100Device(options)

    def decoder(self, settings: Mapping[str, str] | None = None) -> RawDecoder:
        from imumon.sources.vn100.decoder import Vn100Decoder

        return Vn100Decoder()

    def checks(self, observation: Observation, settings: Any) -> Iterator[Check]:

        return checks(observation, settings)

    def alias_factor(self, window: int | None, rate_hz: float) -> float:

        return alias_factor(FACTORY_WINDOW if window is None else window, rate_hz)

    def filter_advice(self, rate_hz: float | None) -> Mapping[str, str]:

        return filter_advice(rate_hz)

    def setting_text(self, name: str, value: str) -> str | None:

        return describe_setting(name, value)

    @contextmanager
    def emulator(self, *, clock: HostClock = REAL_TIME, seed: int | None = None) -> Iterator[str]:

        with spawn(time_lapse_settings(clock, seed)) as process:
            yield process.path

    def add_emulator_options(self, parser: argparse.ArgumentParser) -> None:

        add_arguments(parser)

    def run_emulator(self, arguments: argparse.Namespace) -> int:

        settings = from_arguments(arguments)
        if settings.rate == 0:  # for tests only: a sensor without output
            raise InvalidOption("rate_invalid", "--rate 0 is not an output rate", "give one, such as 40")
        return run(settings)
