"""Settings: their sections, types, limits and defaults.

The file `config.toml` of the source tree describes each setting; it is part of every installation. pydantic checks that
a value has the declared type and keeps the limits. An empty file is valid. Empty text, 0 and [] mean "not given".
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass as plain_dataclass
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_type_hints

from pydantic import BeforeValidator, ConfigDict, Field, Strict
from pydantic.dataclasses import dataclass

from imumon.model.coefficients import NOISE, LimitedGrade
from imumon.model.readiness import ProgramName
from imumon.model.report import MAX_LOSS
from imumon.model.samples import FASTEST_HZ

BaudRate: TypeAlias = Literal[9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]


def _from_percent(value: Any) -> Any:
    """Return the share that a text such as ``2%`` gives; other values as they are."""
    if isinstance(value, str) and value.endswith("%"):
        with suppress(ValueError):
            return float(value[:-1]) / 100.0
    return value


Share: TypeAlias = Annotated[float, BeforeValidator(_from_percent), Field(gt=0.0, lt=1.0)]
"""A share: a number, or a text in percent."""
RateHz: TypeAlias = Annotated[float, Field(ge=0.0, le=FASTEST_HZ)]
"""A rate; 0: not given."""
Texts: TypeAlias = Annotated[tuple[str, ...], Strict(False)]
"""A list of TOML, which is no tuple."""

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
"""Values have exactly the declared type."""

ADDRESS = r"^(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):\d{1,5}$"
"""Host and port to listen on."""


class Section:
    """Section of the file."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DeviceSettings(Section):
    """The device, its port and what to request from it"""

    port: str = ""
    baud: Literal["auto", BaudRate] = "auto"
    set_baud: Literal[0, BaudRate] = 0
    set_rate_hz: RateHz = 0.0
    rate_hz: RateHz = 0.0
    listen_only: bool = False
    stream: Literal["deltas", "uncompensated", "compensated"] = "deltas"
    id: Annotated[str, Field(max_length=64)] = ""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ZenohSettings(Section):
    """Zenoh: where the daemon listens, and who may connect"""

    listen: Texts = ()
    connect: Texts = ()
    user: str = ""
    password: str = ""
    certificate: str = ""
    key: str = ""
    ca: str = ""
    insecure: bool = False
    raw: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class StateSettings(Section):
    """The accumulated statistics on disk"""

    directory: str = ""
    save_period_s: Annotated[float, Field(ge=1.0, le=3600.0)] = 30.0


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HistorySettings(Section):
    """What the sensor did over months, in one SQLite file in the directory of the state"""

    enabled: bool = True
    keep_days: Annotated[float, Field(ge=1.0, le=36500.0)] = 400.0


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MetricsSettings(Section):
    """Numbers for Prometheus, by imumon metrics"""

    listen: Annotated[str, Field(pattern=ADDRESS)] = "127.0.0.1:9847"
    file: str = ""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RecordingSettings(Section):
    """The raw bytes, saved for replay"""

    file: str = ""
    rotate_mb: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    gzip: bool = False


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ReportSettings(Section):
    """What is published, and the required precision"""

    period_s: Annotated[float, Field(ge=0.1, le=60.0)] = 1.0
    precision_n: Share = 0.01
    precision_b: Share = 0.2
    precision_k: Share = 0.5
    grade: Literal["", LimitedGrade] = ""
    program: ProgramName = "kalibr"
    baseline: str = ""

    @property
    def precision(self) -> dict[str, float]:
        """Required half-widths by letter."""
        return {letter: getattr(self, f"precision_{letter.lower()}") for letter in NOISE}


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Ros2Settings(Section):
    """ROS 2: where it is, and what the daemon publishes there"""

    domain: Annotated[int, Field(ge=0, le=232)] = 0
    router: str = "tcp/127.0.0.1:7447"
    rmw: Literal["zenoh", "dds"] = "zenoh"
    node: str = "imumon"
    diagnostics: bool = False
    covariance: str = ""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GuardSettings(Section):
    """What is excluded from the statistics: knocks, motion, warm-up"""

    enabled: bool = True


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LogSettings(Section):
    """The log of the daemon on standard error"""

    level: Literal["error", "warning", "notice", "info", "debug"] = "info"
    format: Literal["auto", "text", "journal", "json"] = "auto"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class AlertSettings(Section):
    """What to run at a warning, and the limits from which there is one"""

    command: str = ""
    max_loss: Share = MAX_LOSS


@plain_dataclass(frozen=True, kw_only=True)
class Settings:
    """All settings.

    Attributes
    ----------
    path : file they were read from, None without one.
    ignored : ``config.toml`` of the current directory that belongs to another program; None: there is none.
    origins : where each value comes from by its dotted name: ``default``, ``config.toml:12`` or
        ``command line``.
    """

    device: DeviceSettings = field(default_factory=DeviceSettings)
    zenoh: ZenohSettings = field(default_factory=ZenohSettings)
    state: StateSettings = field(default_factory=StateSettings)
    history: HistorySettings = field(default_factory=HistorySettings)
    record: RecordingSettings = field(default_factory=RecordingSettings)
    report: ReportSettings = field(default_factory=ReportSettings)
    guards: GuardSettings = field(default_factory=GuardSettings)
    metrics: MetricsSettings = field(default_factory=MetricsSettings)
    ros2: Ros2Settings = field(default_factory=Ros2Settings)
    log: LogSettings = field(default_factory=LogSettings)
    alert: AlertSettings = field(default_factory=AlertSettings)
    path: Path | None = None
    ignored: Path | None = None
    origins: Mapping[str, str] = field(default_factory=dict)


SECTIONS: dict[str, type[Any]] = {
    name: cls
    for name, cls in get_type_hints(Settings).items()
    if isinstance(cls, type) and issubclass(cls, Section)
}
NAMES = tuple(f"{section}.{setting.name}" for section, cls in SECTIONS.items() for setting in fields(cls))
"""Dotted name of every setting."""
