"""Settings: a TOML file and the options of the command line become one immutable tree.

settings   the sections: types, limits, defaults
loading    a file and options to checked settings, and back to lines of TOML
toml_file  lines and places of a TOML file, faults
"""

from imumon.config.loading import load, origin_lines, search
from imumon.config.settings import (
    ADDRESS,
    NAMES,
    SECTIONS,
    DeviceSettings,
    RecordingSettings,
    ReportSettings,
    Settings,
    ZenohSettings,
)
from imumon.config.toml_file import ConfigError

__all__ = [
    "ADDRESS",
    "NAMES",
    "SECTIONS",
    "ConfigError",
    "DeviceSettings",
    "RecordingSettings",
    "ReportSettings",
    "Settings",
    "ZenohSettings",
    "load",
    "origin_lines",
    "search",
]
