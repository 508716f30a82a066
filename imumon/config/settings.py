"""Settings: their sections, types, limits, defaults and descriptions.

A setting is declared once: `loading` lets pydantic check its type and limits where a file or an option gives it, and
its description is the comment in `config.toml`, which is ``render(Settings())``. A command without settings does not
import pydantic, which takes longer than the command. An empty file is valid. Empty text, 0 and [] mean "not given".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_type_hints

from imumon.alarms import DEFAULT_LIMITS
from imumon.coefficients import NOISE, GradeName
from imumon.samples import FASTEST_HZ

BaudRate: TypeAlias = Literal[9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]
Share: TypeAlias = Annotated[float, "a share: a number, or a text in percent"]


FRACTION = {"gt": 0.0, "lt": 1.0}
"""Limits of a share."""
RATE_HZ = {"ge": 0.0, "le": FASTEST_HZ}
"""Limits of a rate; 0: not given."""


class Section:
    """Section of the file: values have exactly the declared type."""


@dataclass(frozen=True, kw_only=True)
class DeviceSettings(Section):
    """The device, its port and what to request from it"""

    port: str = ""
    """device path, pyserial URL, ros2:TOPIC or "sim"; empty: the only sensor found"""
    baud: Literal["auto", BaudRate] = "auto"
    '"auto" detects it'
    set_baud: Literal[0, BaudRate] = 0
    """change the baud rate of the sensor until its next power-up; 0: never"""
    set_rate_hz: float = field(default=0.0, metadata=RATE_HZ)
    """output rate to set on the sensor while the daemon runs, in Hz; 0: the highest that fits the baud rate"""
    rate_hz: float = field(default=0.0, metadata=RATE_HZ)
    """sample rate of samples without time stamps, in Hz; 0: not given"""
    listen_only: bool = False
    """write nothing to the sensor; measure the stream that it already sends"""
    stream: Literal["deltas", "uncompensated", "compensated"] = "deltas"
    """stream to request from the sensor: deltas, uncompensated or compensated"""
    id: str = field(default="", metadata={"max_length": 64})
    """name in the Zenoh keys; empty: that of the device, such as vn100-<serial number>"""


@dataclass(frozen=True, kw_only=True)
class ZenohSettings(Section):
    """Zenoh: where the daemon listens, and who may connect"""

    listen: tuple[str, ...] = ()
    """endpoints; empty: first free of tcp/127.0.0.1:7448 to 7463"""
    connect: tuple[str, ...] = ()
    """endpoints of routers to publish through as well; they may disconnect and reconnect"""
    mode: Literal["peer", "router"] = "peer"
    """peer, or router: other programs can connect to it as to a router"""
    user: str = ""
    """name to log in with; others who connect must give it too"""
    password: str = ""
    """its password; protect this file (of a service: group dialout, mode 0640)"""
    users_file: str = ""
    """who else may connect: file of lines user:password; if this and user are empty, everybody may connect"""
    certificate: str = ""
    """own TLS certificate, PEM"""
    key: str = ""
    """its private key, PEM"""
    ca: str = ""
    """certificate of the authority that signs the certificates of others, PEM"""
    verify_name: bool = True
    """the certificate must also name the host of the connection"""
    read_only: bool = True
    """others may subscribe and query, but publish nothing"""
    allow: tuple[str, ...] = ()
    """certificate or user names that may read; empty: all that may connect"""
    insecure: bool = False
    """allow listening beyond this machine without TLS"""
    raw: Mapping[str, Any] = field(default_factory=dict)
    """more settings of Zenoh: "path/of/setting" = value"""


@dataclass(frozen=True, kw_only=True)
class StateSettings(Section):
    """The accumulated statistics on disk"""

    directory: str = ""
    """directory; empty: $STATE_DIRECTORY, else $XDG_STATE_HOME/imumon, else ~/.local/state/imumon"""
    save_period_s: float = field(default=30.0, metadata={"ge": 1.0, "le": 3600.0})
    """time between two saves, in seconds; a power failure loses at most this time"""


@dataclass(frozen=True, kw_only=True)
class HistorySettings(Section):
    """What the sensor did over months, in one SQLite file in the directory of the state"""

    enabled: bool = True
    """false: no history is kept"""
    keep_days: float = field(default=400.0, metadata={"ge": 1.0, "le": 36500.0})
    """days after which entries are deleted; nine channels take about 80 MB a year"""


@dataclass(frozen=True, kw_only=True)
class MetricsSettings(Section):
    """Numbers for Prometheus, over HTTP"""

    listen: str = ""
    """address to listen on, such as 127.0.0.1:9847; empty: off"""


@dataclass(frozen=True, kw_only=True)
class RecordSettings(Section):
    """The raw bytes, saved for replay"""

    file: str = ""
    """file to save to; empty: nothing is saved"""
    rotate_mb: float = field(default=0.0, metadata={"ge": 0.0, "le": 1e6})
    """start a new file at this size; 0: never"""
    gzip: bool = False
    """compress the file"""


@dataclass(frozen=True, kw_only=True)
class ReportSettings(Section):
    """What is published, and the required precision"""

    period_s: float = field(default=1.0, metadata={"ge": 0.1, "le": 60.0})
    """time between two reports, in seconds"""
    precision_n: Share = field(default=0.01, metadata=FRACTION)
    """required half-width of the 95 % limits of N, as a share of N, such as 0.01 or "1%\""""
    precision_b: Share = field(default=0.2, metadata=FRACTION)
    """the same for B"""
    precision_k: Share = field(default=0.5, metadata=FRACTION)
    """the same for K"""
    grade: Literal["", GradeName] = ""
    """grade for imumon wait: navigation, tactical, industrial or consumer; empty: it ends at the first sample"""
    baseline: str = ""
    """earlier report of the sensor (JSON) to compare with, as --baseline; empty: none"""

    @property
    def precision(self) -> dict[str, float]:
        """Required half-widths by letter."""
        return {letter: getattr(self, f"precision_{letter.lower()}") for letter in NOISE}


@dataclass(frozen=True, kw_only=True)
class Ros2Settings(Section):
    """ROS 2: where it is, and what the daemon publishes there"""

    domain: int = field(default=0, metadata={"ge": 0, "le": 232})
    """ROS_DOMAIN_ID"""
    router: str = "tcp/127.0.0.1:7447"
    """Zenoh endpoint of the router, rmw_zenohd"""
    rmw: Literal["zenoh", "dds"] = "zenoh"
    """middleware of what is published: zenoh or dds; a topic that is read has ?rmw= in its URL"""
    node: str = "imumon"
    """name of the node; give each daemon of a system another one"""
    diagnostics: bool = False
    """publish diagnostic_msgs/msg/DiagnosticArray on /diagnostics"""
    covariance: str = ""
    """topic for the messages of a ros2: device with measured covariances; empty: none"""


@dataclass(frozen=True, kw_only=True)
class GuardSettings(Section):
    """What is excluded from the statistics: knocks, motion, warm-up"""

    enabled: bool = True
    """false: every valid sample counts"""


@dataclass(frozen=True, kw_only=True)
class LogSettings(Section):
    """The log of the daemon on standard error"""

    level: Literal["error", "warning", "notice", "info", "debug"] = "info"
    """lowest level that is logged: error, warning, notice, info or debug"""
    format: Literal["auto", "text", "journal", "json"] = "auto"
    """auto (journal under systemd, else text), text, journal or json"""


@dataclass(frozen=True, kw_only=True)
class AlertSettings(Section):
    """What to run at a warning, and the limits from which there is one"""

    command: str = ""
    """given to /bin/sh for each event of level warning or higher, with the event as JSON on standard input"""
    max_loss: Share = field(default=DEFAULT_LIMITS["loss"], metadata=FRACTION)
    """share of the samples of a minute that may be missing without a warning, such as 0.01 or "1%\""""


@dataclass(frozen=True, kw_only=True)
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
    record: RecordSettings = field(default_factory=RecordSettings)
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
NAMES = tuple(f"{section}.{each.name}" for section, cls in SECTIONS.items() for each in fields(cls))
"""Dotted name of every setting."""
