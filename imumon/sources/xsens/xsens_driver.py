"""Driver of Xsens MTi sensors: the interface for other packages, through the registry."""

from __future__ import annotations

from collections.abc import Mapping

from imumon.sources.device import (
    Device,
    DeviceDriver,
    DeviceOptions,
    RawDecoder,
)


class XsensDriver(DeviceDriver):
    """MTi on a serial port or a pyserial URL."""

    scheme = "xsens"
    title = "Xsens MTi"
    settings = frozenset({"baud", "rate_hz", "set_rate_hz", "listen_only", "stream"})

    def create(self, options: DeviceOptions) -> Device:
        from imumon.sources.xsens.mt_session import XsensDevice

        return XsensDevice(options)

    def decoder(self, settings: Mapping[str, str] | None = None) -> RawDecoder:
        from imumon.sources.xsens.mt_decoder import MtDecoder

        return MtDecoder()

    def filter_advice(self, rate_hz: float | None) -> Mapping[str, str]:
        return {
            "unknown": "Use DeltaQ and DeltaV (--stream deltas), which are integrals over their interval."
        }
