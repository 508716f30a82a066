"""Settings: a TOML file and the options of the command line become one immutable tree.

settings   the sections: types, limits, defaults, descriptions
loading    a file and options to checked settings, and back to TOML
toml_file  lines and places of a TOML file, faults
"""

from imumon.config.loading import load, origin_lines, render, search
from imumon.config.settings import (
    NAMES,
    SECTIONS,
    AlertSettings,
    DeviceSettings,
    GuardSettings,
    LogSettings,
    RecordSettings,
    ReportSettings,
    Settings,
    StateSettings,
    ZenohSettings,
)
from imumon.config.toml_file import ConfigError, ConfigFault

__all__ = [
    "NAMES",
    "SECTIONS",
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
