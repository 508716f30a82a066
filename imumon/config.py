"""Settings: a TOML file and the command line to one frozen tree, or every fault at once.

A person who wrote a file with five mistakes wants to see five lines, each with the line of the file, what is
allowed and the nearest right name; and to see later where a value came from. So every section is checked by
pydantic, its errors are rewritten here, and `Settings.origins` keeps the origin of each value. What a setting
is for stands beside its type; `config.toml` at the top of the project is `render(Settings())`. An empty file
is valid. Empty text, 0 and [] mean "not given".

Only this file knows pydantic, and it imports it where there is something to check: it takes its time and
8 MB, which nobody pays who has neither a file nor a flag, and a daemon only until the check is done
(`load_apart`).
"""

from __future__ import annotations

import difflib
import json
import os
import pickle
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import date, time
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_origin, get_type_hints

Baud: TypeAlias = Literal["auto", 9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]
NewBaud: TypeAlias = Literal[0, 9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]
SLOWEST_HZ, FASTEST_HZ = 1e-4, 1e5


class ConfigError(Exception):
    """Faults of a file or of the command line, one a line, each with its cure."""


@dataclass(frozen=True, kw_only=True)
class ResourceLimits:
    """Bounds of a number, or the longest text, under pydantic's names."""

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    max_length: int | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return {**handler(source), **{name: value for name, value in given.items() if value is not None}}


@dataclass(frozen=True, kw_only=True)
class DeviceSettings:
    """The sensor, its port and what to ask of it"""

    port: Annotated[str, 'device path, pyserial URL or "sim"; empty: the one sensor that is found'] = ""
    baud: Annotated[Baud, '"auto" finds it'] = "auto"
    set_baud: Annotated[NewBaud, "change the sensor's baud to this until its next power-up; 0: never"] = 0
    rate_hz: Annotated[
        float, ResourceLimits(ge=0.0, le=FASTEST_HZ), "sample rate of a stream without a clock; 0: not given"
    ] = 0.0
    listen_only: Annotated[bool, "write nothing to the sensor; characterise what it already sends"] = False
    stream: Annotated[
        Literal["deltas", "uncompensated", "compensated"],
        "what to ask the sensor for: deltas, uncompensated or compensated",
    ] = "deltas"
    id: Annotated[
        str, ResourceLimits(max_length=64), "name in the Zenoh keys; empty: vn100-<serial number>"
    ] = ""


@dataclass(frozen=True, kw_only=True)
class ZenohSettings:
    """The bus: where the daemon listens, whom it lets in"""

    listen: Annotated[tuple[str, ...], "endpoints; empty: the first free of tcp/127.0.0.1:7448 to 7463"] = ()
    connect: Annotated[
        tuple[str, ...], "endpoints of routers to publish through as well; they may come and go"
    ] = ()
    mode: Annotated[Literal["peer", "router"], "peer; or router: others may connect as to a router"] = "peer"
    user: Annotated[
        str, "name to log in with at the other side, which others must give to connect to us, too"
    ] = ""
    password: Annotated[
        str, "and its password; keep the file from others (of a service: group dialout, mode 0640)"
    ] = ""
    users_file: Annotated[
        str, "who else may connect to us: a file of lines user:password; empty, and no user: everybody"
    ] = ""
    certificate: Annotated[str, "own TLS certificate, PEM"] = ""
    key: Annotated[str, "and its private key, PEM"] = ""
    ca: Annotated[str, "authority that must have signed the other side's certificate, PEM"] = ""
    verify_name: Annotated[bool, "the certificate must also name the host that is connected to"] = True
    read_only: Annotated[bool, "others may read and ask, but nothing they publish gets in"] = True
    allow: Annotated[tuple[str, ...], "certificate or user names that may read; empty: all who get in"] = ()
    insecure: Annotated[bool, "listen beyond this machine without TLS"] = False
    raw: Annotated[Mapping[str, Any], 'further settings of Zenoh: "path/of/setting" = value'] = field(
        default_factory=dict
    )


@dataclass(frozen=True, kw_only=True)
class StateSettings:
    """The accumulated statistics on disk"""

    directory: Annotated[
        str, "empty: $STATE_DIRECTORY, else $XDG_STATE_HOME/imumon, else ~/.local/state/imumon"
    ] = ""
    save_period_s: Annotated[
        float, ResourceLimits(ge=1.0, le=3600.0), "what a power cut may cost, in seconds"
    ] = 30.0


@dataclass(frozen=True, kw_only=True)
class RecordSettings:
    """The raw bytes, kept for replay"""

    file: Annotated[str, "empty: none are kept"] = ""
    rotate_mb: Annotated[float, ResourceLimits(ge=0.0, le=1e6), "begin a new file at this size; 0: never"] = (
        0.0
    )
    gzip: Annotated[bool, "compress"] = False


@dataclass(frozen=True, kw_only=True)
class ReportSettings:
    """What is published and how precise is precise enough"""

    period_s: Annotated[float, ResourceLimits(ge=0.1, le=60.0), "between two reports, in seconds"] = 1.0
    precision_n: Annotated[
        float, ResourceLimits(gt=0.0, lt=1.0), "asked half-width of N's 95 % interval, as a share of N"
    ] = 0.01
    precision_b: Annotated[float, ResourceLimits(gt=0.0, lt=1.0), "the same of B"] = 0.2
    precision_k: Annotated[float, ResourceLimits(gt=0.0, lt=1.0), "the same of K"] = 0.5
    grade: Annotated[
        Literal["", "navigation", "tactical", "industrial", "consumer"],
        "grade you need, which imumon wait waits for: navigation, tactical, industrial or consumer; "
        "empty: the first sample",
    ] = ""


@dataclass(frozen=True, kw_only=True)
class GuardSettings:
    """What is cut out of the statistics: knocks, motion, warm-up"""

    enabled: Annotated[bool, "false: every valid sample counts"] = True


@dataclass(frozen=True, kw_only=True)
class LogSettings:
    """What the daemon says on standard error"""

    level: Annotated[
        Literal["error", "warning", "info", "debug"],
        "least weight that is said: error, warning, info or debug",
    ] = "info"
    format: Annotated[
        Literal["auto", "text", "journal", "json"],
        "auto (journal under systemd, else text), text, journal or json",
    ] = "auto"


@dataclass(frozen=True, kw_only=True)
class Settings:
    """All settings.

    Attributes
    ----------
    path : file they were read from, None without one.
    origins : where each value comes from by its dotted name: ``default``,
        ``config.toml:12`` or ``command line``.
    """

    device: DeviceSettings = field(default_factory=DeviceSettings)
    zenoh: ZenohSettings = field(default_factory=ZenohSettings)
    state: StateSettings = field(default_factory=StateSettings)
    record: RecordSettings = field(default_factory=RecordSettings)
    report: ReportSettings = field(default_factory=ReportSettings)
    guards: GuardSettings = field(default_factory=GuardSettings)
    log: LogSettings = field(default_factory=LogSettings)
    path: Path | None = None
    origins: Mapping[str, str] = field(default_factory=dict)


SECTIONS: dict[str, type] = {
    name: cls for name, cls in get_type_hints(Settings).items() if name not in ("path", "origins")
}
NAMES = tuple(f"{name}.{f.name}" for name, cls in SECTIONS.items() for f in fields(cls))
"""Dotted name of every setting."""
_HINTS = {name: get_type_hints(cls, include_extras=True) for name, cls in SECTIONS.items()}


@cache
def _check(part: str) -> Callable[[str], Any]:
    """What makes a section of its JSON text, or raises pydantic's error."""
    from pydantic import ConfigDict, TypeAdapter, with_config

    strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    return TypeAdapter(with_config(strict)(SECTIONS[part])).validate_json


def search() -> Path | None:
    """First there is of ./config.toml, $XDG_CONFIG_HOME/imumon/config.toml, /etc/imumon/config.toml."""
    # expanduser, unlike Path.home(), takes a user without a home for no fault: a service may run as one
    home = Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config"))
    places = (Path("config.toml"), home / "imumon" / "config.toml", Path("/etc/imumon/config.toml"))
    return next((place for place in places if place.is_file()), None)


def load(path: Path | str | None = None, overrides: Mapping[str, Any] | None = None) -> Settings:
    """Settings of a file (without one: of the first found), with values of the command line on top.

    Parameters
    ----------
    path : file to read; None: the one `search` finds, if any.
    overrides : dotted name to value, such as ``{"device.baud": 115200}``; None values are passed over.

    Raises
    ------
    ConfigError : its text has one line for each fault.
    """
    place = search() if path is None else Path(path)
    if place is None and not any(value is not None for value in (overrides or {}).values()):
        return Settings(origins=dict.fromkeys(NAMES, "default"))
    from pydantic import ValidationError

    text = "" if place is None else _read(place)
    file = str(place)
    values, lines = _parse(text, file), _lines(text)
    at = {name: f"{file}:{line}" for name, line in lines.items()}
    for name, value in (overrides or {}).items():
        if value is not None:
            part, _, leaf = name.partition(".")
            if isinstance(table := values.setdefault(part, {}), dict):
                table[leaf] = value
            at[name] = "command line"
    faults: list[str] = []
    sections: dict[str, Any] = {}
    for part, table in values.items():
        where = _where(part, at, file)
        if part not in SECTIONS:
            faults.append(f"{where}: {_unknown(part, isinstance(table, dict))}")
        elif not isinstance(table, dict):
            faults.append(f"{where}: {part}: must be a section, [{part}]")
        else:
            try:
                odd = [leaf for leaf, value in table.items() if not _sayable(value)]
                faults += [f"{_where(f'{part}.{leaf}', at, file)}: {part}.{leaf}: {_ODD}" for leaf in odd]
                table = {leaf: value for leaf, value in table.items() if leaf not in odd}
                # TOML's dates and times, which no setting is, go as null and are refused
                sections[part] = _check(part)(json.dumps(table, default=lambda value: None))
            except ValidationError as error:
                faults.extend(_faults(error.errors(), part, table, at, file))
            except RecursionError:
                faults.append(f"{where}: {part}: is nested too deeply")
    faults.extend(_contradictions(sections, at, file))
    if faults:
        raise ConfigError("\n".join(sorted(faults, key=_by_line)))
    given = {f"{part}.{leaf}" for part, table in values.items() for leaf in table}
    origins = {name: _where(name, at, file) if name in given else "default" for name in NAMES}
    return Settings(**sections, path=place, origins=origins)


def load_apart(path: Path | str | None, overrides: Mapping[str, Any] | None) -> Callable[[], Settings]:
    """`load` in a process of its own, whose memory goes with it; call the answer for the settings.

    For a program that has no threads yet.
    """
    ours, theirs = os.pipe()
    child = os.fork()
    if not child:
        try:
            told: object = load(path, overrides)
        except BaseException as error:
            told = error
        with open(theirs, "wb") as out:
            pickle.dump(told, out)
        os._exit(0)
    os.close(theirs)

    def answer() -> Settings:
        with open(ours, "rb") as heard:
            said = heard.read()
        os.waitpid(child, 0)
        told = pickle.loads(said) if said else load(path, overrides)  # it was killed: memory may be short
        if isinstance(told, BaseException):
            raise told
        assert isinstance(told, Settings)
        return told

    return answer


def render(settings: Settings, *, origins: bool = False) -> str:
    """Settings as a TOML file, each under a comment: what it is or, asked so, where its value is from.

    With `origins` it is for the eye: a password is not shown.
    """
    out: list[str] = []
    if not origins:
        out += ["# Settings of imumon: all of them, with their defaults. Flags win over this file."]
        out += [
            "# Looked for in ./config.toml, $XDG_CONFIG_HOME/imumon/config.toml, /etc/imumon/config.toml.",
            "",
        ]
    for part, cls in SECTIONS.items():
        out.append(f"[{part}]" if origins else f"[{part}]  # {(cls.__doc__ or '').strip()}")
        for f in fields(cls):
            note = (
                settings.origins.get(f"{part}.{f.name}", "default")
                if origins
                else _HINTS[part][f.name].__metadata__[-1]
            )
            value = getattr(getattr(settings, part), f.name)
            shown = "********" if origins and value and f.name == "password" else value
            out += [f"# {note}", f"{f.name} = {_toml(shown)}"]
        out.append("")
    return "\n".join(out[:-1]) + "\n"


def _toml(value: Any) -> str:
    """TOML text of a value.

    >>> _toml(("a", True, 0.5)), _toml({"x/y": 1})
    ('["a", true, 0.5]', '{ "x/y" = 1 }')
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda m: f"\\u{ord(m[0]):04x}", escaped) + '"'
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_toml(str(key))} = {_toml(item)}" for key, item in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return value.isoformat() if isinstance(value, date | time) else repr(value)


def _read(place: Path) -> str:
    try:
        return place.read_text("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{place}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{place}: is not UTF-8 text (byte {error.start})") from None


def _parse(text: str, file: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"^(.*?) \(at line (\d+), column (\d+)\)$", str(error))
        what, line, column = found.groups() if found else (str(error), str(text.count("\n") + 1), "1")
        what = what.removesuffix(" (at end of document)")
        raise ConfigError(
            f"{file}:{line}: not TOML: {what[:1].lower()}{what[1:]} (column {column})"
        ) from None
    except RecursionError:
        raise ConfigError(f"{file}: not TOML: nested too deeply") from None
    except ValueError as error:  # a number of thousands of digits
        raise ConfigError(f"{file}: not TOML: {error}") from None


def _lines(text: str) -> dict[str, int]:
    """Line of each section and setting by its dotted name, as far as a look at the text tells."""
    found: dict[str, int] = {}
    table = ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", line):
            table = _bare(header[1])
            found.setdefault(table, number)
        elif key := re.match(
            r"\s*((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=", line
        ):
            name = f"{table}.{_bare(key[1])}".lstrip(".")
            while name:
                found.setdefault(name, number)
                name = name.rpartition(".")[0]
    return found


def _bare(key: str) -> str:
    return ".".join(part.strip().strip("\"'") for part in key.split("."))


def _where(name: str, at: Mapping[str, str], file: str) -> str:
    """Place of a setting, or of the nearest thing around it that has one."""
    while name and name not in at:
        name = name.rpartition(".")[0]
    return at.get(name, file)


def _by_line(fault: str) -> tuple[bool, int, str]:
    found = re.match(r".*?:(\d+): ", fault)
    return (found is None, int(found[1]) if found else 0, fault)


def _unknown(name: str, is_section: bool) -> str:
    """Why a name is not one, with the nearest that is."""
    if is_section:
        near = difflib.get_close_matches(name, SECTIONS, n=1, cutoff=0.5)
        return f"[{name}]: no such section" + (f"; did you mean [{near[0]}]?" if near else "")
    part, _, leaf = name.rpartition(".")
    everywhere = {n.partition(".")[2]: n for n in reversed(NAMES)}
    here = {n.partition(".")[2]: n for n in NAMES if n.startswith(f"{part}.")}
    near = difflib.get_close_matches(leaf, here or everywhere, n=1, cutoff=0.6)
    right = everywhere.get(leaf) or ((here or everywhere)[near[0]] if near else None)
    return f"{name}: no such setting" + (f"; did you mean {right}?" if right else "")


def _faults(
    errors: Iterable[Any], part: str, table: Mapping[str, Any], at: Mapping[str, str], file: str
) -> Iterator[str]:
    """Pydantic's errors of a section as lines for people."""
    for fault in errors:
        leaf = str(fault["loc"][0])
        name = f"{part}.{leaf}"
        if fault["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
            yield f"{_where(name, at, file)}: {_unknown(name, False)}"
        else:
            allowed = _allowed(fault, _HINTS[part][leaf])
            yield f"{_where(name, at, file)}: {name}: {allowed}, not {_shown(_value(table, fault['loc']))}"


def _value(table: Any, path: Iterable[Any]) -> Any:
    """What stands at a place of a section, or what is nearest around it."""
    for step in path:
        try:
            table = table[step]
        except (KeyError, IndexError, TypeError):
            break
    return table


def _shown(value: Any) -> str:
    text = _toml(value)
    return text if len(text) <= 40 else text[:37] + "..."


_TYPES = {
    "string_type": "must be text in quotes",
    "bool_type": "must be true or false",
    "tuple_type": 'must be a list, such as ["..."]',
    "mapping_type": "must be a table",
}


def _allowed(fault: Any, hint: Any) -> str:
    """What a setting may be."""
    kind, plain = fault["type"], hint.__origin__
    if get_origin(plain) is Literal:
        return "must be one of " + ", ".join(map(_toml, get_args(plain)))
    limits = next((note for note in hint.__metadata__ if isinstance(note, ResourceLimits)), ResourceLimits())
    if limits.ge is not None:
        return f"must be a number from {limits.ge:.9g} to {limits.le:.9g}"
    if limits.gt is not None:
        return f"must be a number between {limits.gt:g} and {limits.lt:g}"
    if limits.max_length is not None and kind == "string_too_long":
        return f"must be at most {limits.max_length} characters"
    return _TYPES.get(kind) or str(fault["msg"]).lower()


_ODD = "has a character that no file and no key can have: a zero byte, or one that is not UTF-8"


def _sayable(value: Any) -> bool:
    """Whether every text in a value can be the name of something."""
    if isinstance(value, str):
        return "\0" not in value and not any("\ud800" <= letter <= "\udfff" for letter in value)
    if isinstance(value, dict):
        return all(map(_sayable, (*value, *value.values())))
    return not isinstance(value, list | tuple) or all(map(_sayable, value))


def _contradictions(sections: Mapping[str, Any], at: Mapping[str, str], file: str) -> Iterator[str]:
    """Settings that are right each but not together."""
    bus = sections.get("zenoh", ZenohSettings())
    for one, other in (
        ("user", "password"),
        ("password", "user"),
        ("certificate", "key"),
        ("key", "certificate"),
    ):
        if getattr(bus, one) and not getattr(bus, other):
            yield f"{_where(f'zenoh.{one}', at, file)}: zenoh.{one}: needs zenoh.{other} beside it"
    device = sections.get("device", DeviceSettings())
    if device.listen_only and device.set_baud:
        yield f"{_where('device.set_baud', at, file)}: device.set_baud: cannot be had with device.listen_only"
    if 0.0 < device.rate_hz < SLOWEST_HZ:
        allowed = f"must be 0 or from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
        yield f"{_where('device.rate_hz', at, file)}: device.rate_hz: {allowed}, not {device.rate_hz:g}"
    if device.id and not re.search(r"[a-z0-9_]", device.id.lower()):
        yield f"{_where('device.id', at, file)}: device.id: needs a letter or a digit, such as imu-1"
