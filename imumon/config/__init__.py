"""Settings: a TOML file and the options of the command line become one immutable tree."""

from imumon.config.settings import (
    FASTEST_HZ,
    NAMES,
    SECTIONS,
    SLOWEST_HZ,
    AlertSettings,
    DeviceSettings,
    GuardSettings,
    LogSettings,
    RecordSettings,
    ReportSettings,
    Settings,
    StateSettings,
    ZenohSettings,
    load,
    origin_lines,
    render,
    search,
)
from imumon.config.toml_file import ConfigError, ConfigFault

__all__ = [
    "FASTEST_HZ",
    "NAMES",
    "SECTIONS",
    "SLOWEST_HZ",
    "AlertSettings",
    "ConfigError",
    "ConfigFault",
    "DeviceSettings",
    "GuardSettings",
    "LogSettings",
    "RecordSettings",
    "ReportSettings",
    "Settings",
    "StateSettings",
    "ZenohSettings",
    "load",
    "origin_lines",
    "render",
    "search",
]
