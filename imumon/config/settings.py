"""Settings: a TOML file and the options of the command line become one immutable tree.

All faults of a file are reported at once, each with its line, what is allowed and the nearest valid name, and
`Settings.origins` keeps where each value comes from. A setting is declared once: its type and limits are checked
by pydantic, its description is the comment in `config.toml`, which is ``render(Settings())``. An empty file is
valid. Empty text, 0 and [] mean "not given".
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, cast, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt, MaxLen
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from imumon.alarms import DEFAULT_LIMITS
from imumon.config.toml_file import (
    ConfigError,
    ConfigFault,
    Places,
    line_numbers,
    parse,
    read_text,
    tables,
    toml_text,
)

Baud: TypeAlias = Literal["auto", 9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]
NewBaud: TypeAlias = Literal[0, 9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]
TextList: TypeAlias = Annotated[tuple[str, ...], Field(strict=False)]
"""A TOML list of texts; not strict, because a list is not a tuple."""

SLOWEST_HZ, FASTEST_HZ = 1e-4, 1e5
"""Limits of a sample rate, Hz."""
MOST_FAULTS = 100
"""Faults that are reported of a file."""
SHOWN_CHARACTERS = 40
"""Longest value in a message, characters."""


class Section(BaseModel):
    """Section of the file: values have exactly the declared type."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class DeviceSettings(Section):
    """The device, its port and what to request from it"""

    port: str = ""
    """device path, pyserial URL, ros2:TOPIC or "sim"; empty: the only sensor found"""
    baud: Baud = "auto"
    '"auto" detects it'
    set_baud: NewBaud = 0
    """change the baud rate of the sensor until its next power-up; 0: never"""
    rate_hz: float = Field(0.0, ge=0.0, le=FASTEST_HZ)
    """sample rate of samples without time stamps, in Hz; 0: not given"""
    listen_only: bool = False
    """write nothing to the sensor; measure the stream that it already sends"""
    stream: Literal["deltas", "uncompensated", "compensated"] = "deltas"
    """stream to request from the sensor: deltas, uncompensated or compensated"""
    id: str = Field("", max_length=64)
    """name in the Zenoh keys; empty: vn100-<serial number>"""


class ZenohSettings(Section):
    """Zenoh: where the daemon listens, and who may connect"""

    listen: TextList = ()
    """endpoints; empty: first free of tcp/127.0.0.1:7448 to 7463"""
    connect: TextList = ()
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
    allow: TextList = ()
    """certificate or user names that may read; empty: all that may connect"""
    insecure: bool = False
    """allow listening beyond this machine without TLS"""
    raw: Mapping[str, Any] = Field(default_factory=dict)
    """more settings of Zenoh: "path/of/setting" = value"""


class StateSettings(Section):
    """The accumulated statistics on disk"""

    directory: str = ""
    """directory; empty: $STATE_DIRECTORY, else $XDG_STATE_HOME/imumon, else ~/.local/state/imumon"""
    save_period_s: float = Field(30.0, ge=1.0, le=3600.0)
    """time between two saves, in seconds; a power failure loses at most this time"""


class HistorySettings(Section):
    """What the sensor did over months, in one SQLite file in the directory of the state"""

    enabled: bool = True
    """false: no history is kept"""
    keep_days: float = Field(400.0, ge=1.0, le=36500.0)
    """days after which entries are deleted; nine channels take about 80 MB a year"""


class MetricsSettings(Section):
    """Numbers for Prometheus, over HTTP"""

    listen: str = ""
    """address to listen on, such as 127.0.0.1:9847; empty: off"""


class RecordSettings(Section):
    """The raw bytes, saved for replay"""

    file: str = ""
    """file to save to; empty: nothing is saved"""
    rotate_mb: float = Field(0.0, ge=0.0, le=1e6)
    """start a new file at this size; 0: never"""
    gzip: bool = False
    """compress the file"""


class ReportSettings(Section):
    """What is published, and the required precision"""

    period_s: float = Field(1.0, ge=0.1, le=60.0)
    """time between two reports, in seconds"""
    precision_n: float = Field(0.01, gt=0.0, lt=1.0)
    """required half-width of the 95 % limits of N, as a share of N"""
    precision_b: float = Field(0.2, gt=0.0, lt=1.0)
    """the same for B"""
    precision_k: float = Field(0.5, gt=0.0, lt=1.0)
    """the same for K"""
    grade: Literal["", "navigation", "tactical", "industrial", "consumer"] = ""
    """grade for imumon wait: navigation, tactical, industrial or consumer; empty: it ends at the first sample"""
    baseline: str = ""
    """earlier report of the sensor (JSON) to compare with, as --baseline; empty: none"""


class Ros2Settings(Section):
    """ROS 2: where it is, and what the daemon publishes there"""

    domain: int = Field(0, ge=0, le=232)
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


class GuardSettings(Section):
    """What is excluded from the statistics: knocks, motion, warm-up"""

    enabled: bool = True
    """false: every valid sample counts"""


class LogSettings(Section):
    """The log of the daemon on standard error"""

    level: Literal["error", "warning", "notice", "info", "debug"] = "info"
    """lowest level that is logged: error, warning, notice, info or debug"""
    format: Literal["auto", "text", "journal", "json"] = "auto"
    """auto (journal under systemd, else text), text, journal or json"""


class AlertSettings(Section):
    """What to run at a warning, and the limits from which there is one"""

    command: str = ""
    """given to /bin/sh for each event of level warning or higher, with the event as JSON on standard input"""
    max_loss: float = Field(DEFAULT_LIMITS["loss"], gt=0.0, lt=1.0)
    """share of the samples of a minute that may be missing without a warning"""


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


SECTIONS: dict[str, type[Section]] = {
    name: cls
    for name, cls in get_type_hints(Settings).items()
    if isinstance(cls, type) and issubclass(cls, Section)
}
NAMES = tuple(f"{section}.{name}" for section, cls in SECTIONS.items() for name in cls.model_fields)
"""Dotted name of every setting."""


def search() -> tuple[Path | None, Path | None]:
    """Return the first settings file there is, and the ``./config.toml`` of another program that was ignored.

    The files are ./config.toml, $XDG_CONFIG_HOME/imumon/config.toml and /etc/imumon/config.toml. The first
    counts only if it has a section of imumon, for many programs use this name.
    """
    local, ignored = Path("config.toml"), None
    if local.is_file():
        try:
            if tables(local) & SECTIONS.keys():
                return local, None
            ignored = local
        except OSError:
            return local, None  # `load` reports why it is unreadable
    # expanduser, unlike Path.home(), accepts a user without a home directory, as a service may run as one
    home = Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config"))
    others = (home / "imumon" / "config.toml", Path("/etc/imumon/config.toml"))
    return next((path for path in others if path.is_file()), None), ignored


def load(path: Path | str | None = None, overrides: Mapping[str, Any] | None = None) -> Settings:
    """Return the settings of a file with values of the command line on top, or raise all faults.

    Parameters
    ----------
    path : file to read; None: the one that `search` finds, if any.
    overrides : dotted name to value, such as ``{"device.baud": 115200}``; None values are ignored.
    """
    given = {name: value for name, value in (overrides or {}).items() if value is not None}
    found, ignored = search() if path is None else (Path(path), None)
    text = "" if found is None else read_text(found)
    values = parse(text, str(found))
    places = Places(str(found), {name: f"{found}:{line}" for name, line in line_numbers(text).items()})
    for name, value in given.items():
        section, _, setting = name.partition(".")
        if isinstance(table := values.setdefault(section, {}), dict):
            table[setting] = value
        places.known[name] = "command line"
    sections: dict[str, Section] = {}
    faults: list[ConfigFault] = []
    for section, table in values.items():
        try:
            sections[section] = _check_section(section, table, places)
        except ConfigError as error:
            faults += error.faults
        if len(faults) >= MOST_FAULTS:
            break
    faults += _contradictions(sections, places)
    if faults:
        raise ConfigError(*sorted(faults, key=places.order)[:MOST_FAULTS])
    present = {f"{section}.{name}" for section, table in values.items() for name in table}
    origins = {name: places.of(name) if name in present else "default" for name in NAMES}
    return Settings(**cast(Any, sections), path=found, ignored=ignored, origins=origins)


_FILE_COMMENT = """\
# Settings of imumon: all of them, with their defaults. Options override this file.
# Searched in ./config.toml, $XDG_CONFIG_HOME/imumon/config.toml, /etc/imumon/config.toml."""


def render(settings: Settings) -> str:
    """Return the settings as a TOML file with the description of each above it."""
    lines = [_FILE_COMMENT, ""]
    for section, cls in SECTIONS.items():
        lines.append(f"[{section}]  # {(cls.__doc__ or '').strip()}")
        for name, info in cls.model_fields.items():
            value = getattr(getattr(settings, section), name)
            lines += [f"# {info.description}", f"{name} = {toml_text(value)}"]
        lines.append("")
    return "\n".join(lines[:-1]) + "\n"


def origin_lines(settings: Settings) -> list[str]:
    """Return a line of TOML for each setting, with its origin as a comment; a password is not shown."""
    lines = []
    for full in NAMES:
        section, _, name = full.partition(".")
        value = getattr(getattr(settings, section), name)
        shown = "********" if value and name == "password" else value
        lines.append(f"{full} = {toml_text(shown)}  # {settings.origins.get(full, 'default')}")
    return lines


def _check_section(section: str, table: Any, places: Places) -> Section:
    """Return the checked section; raise `ConfigError` with all its faults."""
    if section not in SECTIONS:
        raise ConfigError(_unknown(section, isinstance(table, dict), places))
    if not isinstance(table, dict):
        message, cure = "is a section, not a value", f"write [{section}] on a line of its own"
        raise ConfigError(ConfigFault("not_a_section", places.of(section), section, message, cure))
    cls = SECTIONS[section]
    try:
        bad = [name for name, value in table.items() if not _encodable(value)]
    except RecursionError:
        fault = ConfigFault(
            "too_deep", places.of(section), section, "is nested too deeply", "use fewer levels of tables"
        )
        raise ConfigError(fault) from None
    faults = [
        ConfigFault("invalid_character", places.of(name), name, *_INVALID_CHARACTER)
        for name in (f"{section}.{name}" for name in bad)
    ]
    try:
        checked = cls.model_validate({name: value for name, value in table.items() if name not in bad})
    except ValidationError as error:
        # a list has a fault for each of its items: the first is enough
        first = {str(found["loc"][0]): found for found in reversed(error.errors())}
        shown = list(first.items())[:MOST_FAULTS]
        faults += [_fault(section, name, found, table, places) for name, found in shown]
    if faults:
        raise ConfigError(*faults)
    return checked


def _fault(section: str, name: str, found: Any, table: Mapping[str, Any], places: Places) -> ConfigFault:
    """Return pydantic's error of a setting as a fault."""
    full = f"{section}.{name}"
    if found["type"] == "extra_forbidden":
        return _unknown(full, False, places)
    value = toml_text(_value_at(table, found["loc"]))
    shown = value if len(value) <= SHOWN_CHARACTERS else value[: SHOWN_CHARACTERS - 3] + "..."
    cure = f"give {_allowed(found, SECTIONS[section].model_fields[name])}"
    return ConfigFault("invalid_value", places.of(full), full, f"{shown} is not valid", cure)


_NAMES_CURE = "imumon config show prints all of them"


def _unknown(name: str, is_section: bool, places: Places) -> ConfigFault:
    """Return the fault of an unknown name, with the nearest valid one."""
    place = places.of(name)
    if is_section:
        near = difflib.get_close_matches(name, SECTIONS, n=1)
        cure = f"did you mean [{near[0]}]?" if near else _NAMES_CURE
        return ConfigFault("unknown_section", place, f"[{name}]", "no such section", cure)
    section, _, setting = name.rpartition(".")
    everywhere = {full.partition(".")[2]: full for full in reversed(NAMES)}
    here = {full.partition(".")[2]: full for full in NAMES if full.startswith(f"{section}.")}
    candidates = here or everywhere
    near = difflib.get_close_matches(setting, candidates, n=1)
    right = everywhere.get(setting) or (candidates[near[0]] if near else None)
    cure = f"did you mean {right}?" if right else _NAMES_CURE
    return ConfigFault("unknown_setting", place, name, "no such setting", cure)


def _value_at(table: Any, path: Iterable[Any]) -> Any:
    """Return the value at a path of a section, or the nearest one around it."""
    with suppress(KeyError, IndexError, TypeError):
        for step in path:
            table = table[step]
    return table


_TYPES = {
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "tuple_type": 'a list, such as ["..."]',
    "mapping_type": "a table",
    "dict_type": "a table",
}


def _allowed(found: Any, info: Any) -> str:
    """Return what a setting may be."""
    if get_origin(info.annotation) is Literal:
        return "one of " + ", ".join(map(toml_text, get_args(info.annotation)))
    limits = {type(limit): limit for limit in info.metadata}
    if Ge in limits:
        return f"a number from {limits[Ge].ge:.9g} to {limits[Le].le:.9g}"
    if Gt in limits:
        return f"a number between {limits[Gt].gt:g} and {limits[Lt].lt:g}"
    if found["type"] == "string_too_long":
        return f"at most {limits[MaxLen].max_length} characters"
    return _TYPES.get(found["type"]) or str(found["msg"]).lower()


_INVALID_CHARACTER = ("has a zero byte or invalid UTF-8, which no file name or key can have", "remove it")


def _encodable(value: Any) -> bool:
    """Return whether every text in a value can be a file name and a key."""
    if isinstance(value, str):
        return re.search("[\0\ud800-\udfff]", value) is None
    if isinstance(value, dict):
        return all(map(_encodable, (*value, *value.values())))
    return not isinstance(value, list | tuple) or all(map(_encodable, value))


_TOGETHER = (("user", "password"), ("password", "user"), ("certificate", "key"), ("key", "certificate"))
"""Settings of ``[zenoh]`` of which the first needs the second."""


def _contradictions(sections: Mapping[str, Any], places: Places) -> Iterator[ConfigFault]:
    """Yield the faults of settings that are valid alone but not together."""

    def fault(name: str, message: str, cure: str, code: str = "contradiction") -> ConfigFault:
        return ConfigFault(code, places.of(name), name, message, cure)

    zenoh = sections.get("zenoh", ZenohSettings())
    for name, other in _TOGETHER:
        if getattr(zenoh, name) and not getattr(zenoh, other):
            yield fault(f"zenoh.{name}", f"zenoh.{other} is missing", "set both or neither")
    device = sections.get("device", DeviceSettings())
    if device.listen_only and device.set_baud:
        text = "is not possible with device.listen_only"
        yield fault("device.set_baud", text, "remove one of the two")
    if 0.0 < device.rate_hz < SLOWEST_HZ:
        message = f"{device.rate_hz:g} is not valid"
        cure = f"give 0, or a number from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
        yield fault("device.rate_hz", message, cure, "invalid_value")
    metrics = sections.get("metrics", MetricsSettings())
    if metrics.listen and not re.fullmatch(r"(\[[0-9a-fA-F:]+\]|[^\s:/\[\]]+):\d{1,5}", metrics.listen):
        message = f"{toml_text(metrics.listen)} is not valid"
        yield fault("metrics.listen", message, "write HOST:PORT, such as 127.0.0.1:9847", "invalid_value")
    if device.id and not re.search(r"[a-z0-9_]", device.id.lower()):
        message = f"{toml_text(device.id)} is not valid"
        yield fault("device.id", message, "use letters and digits, such as imu-1", "invalid_value")
