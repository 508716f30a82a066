"""Laws of the settings: all faults at once with codes, options override the file, config.toml has the defaults."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import ROOT

from imumon import config
from imumon.config import ConfigError, Settings, load, origin_lines

SHIPPED = ROOT / "config.toml"

BAUDS = "9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600"
BAD = """\
baud = 3
[device]
bawd = 9600
baud = 1234
rate_hz = -3
port = 7
[zenoh]
listen = "tcp/127.0.0.1:7448"
[guard]
margin_s = 2
[report]
period_s = 1000
precision_n = "a"
save_period_s = 3
[record]
gzip = 1
rotate_mb = inf
"""


def write(folder: Path, text: str) -> Path:
    file = folder / "config.toml"
    file.write_text(text, "utf-8")
    return file


def faults(file: Path, **overrides: object) -> list[tuple[str, str]]:
    """Code and text of each fault."""
    with pytest.raises(ConfigError) as caught:
        load(file, {name.replace("__", "."): value for name, value in overrides.items()})
    assert caught.value.code == "invalid_settings"
    found = caught.value.faults
    assert str(caught.value) == "\n".join(map(str, found))
    return [(fault.code, str(fault).replace(f"{file.parent}/", "")) for fault in found]


def test_empty_file_is_the_defaults(tmp_path: Path) -> None:
    settings = load(write(tmp_path, ""))
    assert (settings.device, settings.zenoh, settings.report) == (
        Settings().device,
        Settings().zenoh,
        Settings().report,
    )
    assert set(settings.origins.values()) == {"default"}


def test_shipped_file_is_the_defaults_with_a_comment_each() -> None:
    read = load(SHIPPED)
    assert not [name for name, origin in read.origins.items() if origin == "default"]
    for part in config.SECTIONS:
        assert getattr(read, part) == getattr(Settings(), part)
    lines = SHIPPED.read_text("utf-8").splitlines()
    settings = [n for n, line in enumerate(lines) if " = " in line and not line.startswith("#")]
    comments = [lines[n - 1] for n in settings]
    assert not [text for text in comments if not re.match(r"# (\S+ )+\S+", text)]
    assert len(set(comments)) == len(comments)
    for part, section in config.SECTIONS.items():
        assert f"[{part}]  # {section.__doc__}" in lines


def test_every_fault_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    assert faults(write(tmp_path, BAD), device__set_baud=12) == [
        ("unknown_setting", "config.toml:1: baud: no such setting; did you mean device.baud?"),
        ("unknown_setting", "config.toml:3: device.bawd: no such setting; did you mean device.baud?"),
        ("invalid_value", f'config.toml:4: device.baud: 1234 is not valid; give one of "auto", {BAUDS}'),
        ("invalid_value", "config.toml:5: device.rate_hz: -3 is not valid; give a number from 0 to 100000"),
        ("invalid_value", "config.toml:6: device.port: 7 is not valid; give text in quotes"),
        (
            "invalid_value",
            'config.toml:8: zenoh.listen: "tcp/127.0.0.1:7448" is not valid; give a list, such as ["..."]',
        ),
        ("unknown_section", "config.toml:9: [guard]: no such section; did you mean [guards]?"),
        ("invalid_value", "config.toml:12: report.period_s: 1000 is not valid; give a number from 0.1 to 60"),
        (
            "invalid_value",
            'config.toml:13: report.precision_n: "a" is not valid; give a number between 0 and 1, or a text in '
            'percent, such as "5%"',
        ),
        (
            "unknown_setting",
            "config.toml:14: report.save_period_s: no such setting; did you mean state.save_period_s?",
        ),
        ("invalid_value", "config.toml:16: record.gzip: 1 is not valid; give true or false"),
        (
            "invalid_value",
            "config.toml:17: record.rotate_mb: inf is not valid; give a number from 0 to 1000000",
        ),
        ("invalid_value", f"command line: device.set_baud: 12 is not valid; give one of 0, {BAUDS}"),
    ]


@pytest.mark.parametrize(
    ("text", "code", "fault"),
    [
        (
            "[device\n",
            "not_toml",
            "config.toml: not TOML: Expected ']' at the end of a table declaration (at line 1",
        ),
        (
            "device = 3\n",
            "not_a_section",
            "config.toml:1: device: is a section, not a value; write [device] on",
        ),
        (
            "[zenoh]\nuser = 'ann'\n",
            "contradiction",
            "config.toml:2: zenoh.user: zenoh.password is missing; set both",
        ),
        (
            "[device]\nlisten_only = true\nset_baud = 921600\n",
            "contradiction",
            "config.toml:3: device.set_baud: is not ",
        ),
        (
            "[device]\nid = '////'\n",
            "invalid_value",
            'config.toml:2: device.id: "////" is not valid; use letters',
        ),
    ],
)
def test_single_faults(tmp_path: Path, text: str, code: str, fault: str) -> None:
    ((found, line),) = faults(write(tmp_path, text))
    assert found == code
    assert line.startswith(fault)


def test_unreadable_files(tmp_path: Path) -> None:
    message = "none.toml: cannot be read: No such file or directory; check the path"
    assert faults(tmp_path / "none.toml") == [("file_unreadable", message)]
    file = write(tmp_path, "")
    file.write_bytes(b"port = '\xff'")
    assert faults(file) == [("not_utf8", "config.toml: is not UTF-8 text (byte 8); save it as UTF-8")]
    assert "larger" in faults(Path("/dev/zero"))[0][1]
    assert load(Path("/dev/null"))


def test_options_override_the_file_and_every_value_has_its_origin(tmp_path: Path) -> None:
    file = write(
        tmp_path, "[device]\nbaud = 9600\nport = 'sim'\n[zenoh.raw]\n'transport/link/tx/lease' = 3000\n"
    )
    login = {"zenoh.user": "ann", "zenoh.password": "secret"}
    settings = load(
        file, {"device.baud": 921600, "device.rate_hz": None, "zenoh.connect": ["tcp/host:1"], **login}
    )
    assert (settings.device.baud, settings.device.port, settings.device.rate_hz) == (921600, "sim", 0.0)
    assert settings.zenoh.connect == ("tcp/host:1",)
    assert settings.zenoh.raw == {"transport/link/tx/lease": 3000}
    assert settings.origins["device.baud"] == "command line"
    assert settings.origins["device.port"] == f"{file}:3"
    assert settings.origins["zenoh.raw"] == f"{file}:4"
    assert settings.origins["device.rate_hz"] == "default"
    assert set(settings.origins) == set(config.NAMES)
    lines = origin_lines(settings)
    assert "device.baud = 921600  # command line" in lines
    assert f'device.port = "sim"  # {file}:3' in lines
    assert "device.rate_hz = 0.0  # default" in lines
    assert [line.partition(" = ")[0] for line in lines] == list(config.NAMES)  # one line each
    read = tomllib.loads("\n".join(lines))
    assert read["zenoh"]["raw"] == settings.zenoh.raw
    assert read["zenoh"]["password"] == "********"


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The directory of the user's settings, below an empty current directory."""
    home = tmp_path / "xdg"
    (home / "imumon").mkdir(parents=True)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home))
    monkeypatch.chdir(tmp_path)
    return home / "imumon"


def test_search_order(places: Path) -> None:
    assert load().path in (None, Path("/etc/imumon/config.toml"))
    write(places, "[log]\nlevel = 'debug'\n")
    assert load().log.level == "debug"
    write(Path.cwd(), "[log]\nlevel = 'error'\n")
    assert load().log.level == "error"
    assert load().ignored is None


@pytest.mark.parametrize(
    "text",
    [
        "[server]\nport = 80\n",
        "[server\n",
        "device = 'cuda'\nlog = 3\n",
        'text = """\n[device]\n"""\n',
        "\ufffe\0 no text [log]\n",
        "[server\n" + "x = 1\n" * 20_000,
    ],
)
def test_the_config_toml_of_another_program_is_ignored(places: Path, text: str) -> None:
    write(places, "[log]\nlevel = 'debug'\n")
    write(Path.cwd(), text)
    settings = load()
    assert settings.log.level == "debug"
    assert settings.ignored == Path("config.toml")
    assert load(places / "config.toml").ignored is None


@given(st.text(), st.floats(0.1, 60.0), st.lists(st.text(), max_size=3))
def test_what_is_shown_is_read_back(text: str, period: float, names: list[str]) -> None:
    settings = Settings(
        device=config.DeviceSettings(port=text),
        report=config.ReportSettings(period_s=period),
        zenoh=config.ZenohSettings(connect=tuple(names), raw={"a/b": text, "c": [1, True]}),
    )
    read = tomllib.loads("\n".join(origin_lines(settings)))
    assert read["device"]["port"] == text
    assert read["report"]["period_s"] == period
    assert read["zenoh"]["connect"] == names
    assert read["zenoh"]["raw"] == {"a/b": text, "c": [1, True]}


@given(text=st.text(max_size=200))
def test_no_text_does_worse_than_a_config_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    file = tmp_path_factory.getbasetemp() / "any.toml"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        load(file)
    except ConfigError as error:
        assert all(line.isprintable() for line in str(error).split("\n"))  # noqa: PT017
