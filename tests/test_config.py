"""Laws of the settings: every fault at once with its cure, flags win, the shipped file says the defaults."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon import config
from imumon.config import ConfigError, Settings, load, render

SHIPPED = Path(__file__).parents[1] / "config.toml"

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


def faults(file: Path, **overrides: object) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(file, {name.replace("__", "."): value for name, value in overrides.items()})
    return str(caught.value).replace(f"{file.parent}/", "").splitlines()


def test_empty_file_is_the_defaults(tmp_path: Path) -> None:
    settings = load(write(tmp_path, ""))
    assert (settings.device, settings.zenoh, settings.report) == (
        Settings().device,
        Settings().zenoh,
        Settings().report,
    )
    assert set(settings.origins.values()) == {"default"}


def test_shipped_file_is_the_defaults_with_a_comment_each() -> None:
    assert SHIPPED.read_text("utf-8") == render(Settings())
    read = load(SHIPPED)
    for part in config.SECTIONS:
        assert getattr(read, part) == getattr(Settings(), part)
    lines = SHIPPED.read_text("utf-8").splitlines()
    for number, line in enumerate(lines):
        if " = " in line and not line.startswith("#"):
            assert lines[number - 1].startswith("# ")


def test_every_fault_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    assert faults(write(tmp_path, BAD), device__set_baud=12) == [
        "config.toml:1: baud: no such setting; did you mean device.baud?",
        "config.toml:3: device.bawd: no such setting; did you mean device.baud?",
        f'config.toml:4: device.baud: must be one of "auto", {BAUDS}, not 1234',
        "config.toml:5: device.rate_hz: must be a number from 0 to 100000, not -3",
        "config.toml:6: device.port: must be text in quotes, not 7",
        'config.toml:8: zenoh.listen: must be a list, such as ["..."], not "tcp/127.0.0.1:7448"',
        "config.toml:9: [guard]: no such section; did you mean [guards]?",
        "config.toml:12: report.period_s: must be a number from 0.1 to 60, not 1000",
        'config.toml:13: report.precision_n: must be a number between 0 and 1, not "a"',
        "config.toml:14: report.save_period_s: no such setting; did you mean state.save_period_s?",
        "config.toml:16: record.gzip: must be true or false, not 1",
        "config.toml:17: record.rotate_mb: must be a number from 0 to 1000000, not inf",
        f"command line: device.set_baud: must be one of 0, {BAUDS}, not 12",
    ]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[device\n", "config.toml:1: not TOML: expected ']' at the end of a table declaration (column 8)"),
        ("device = 3\n", "config.toml:1: device: must be a section, [device]"),
        ("\ndevice.bawd = 3\n", "config.toml:2: device.bawd: no such setting; did you mean device.baud?"),
        ("device = { bawd = 3 }\n", "config.toml:1: device.bawd: no such setting; did you mean device.baud?"),
        (
            "[log]\nlevel = 'loud'\n",
            'config.toml:2: log.level: must be one of "error", "warning", "info", "debug", ',
        ),
        ("[zenoh]\nuser = 'ann'\n", "config.toml:2: zenoh.user: needs zenoh.password beside it"),
        ("[zenoh]\nkey = 'a.pem'\n", "config.toml:2: zenoh.key: needs zenoh.certificate beside it"),
        (
            "[device]\nlisten_only = true\nset_baud = 921600\n",
            "config.toml:3: device.set_baud: cannot be had with device.listen_only",
        ),
        ("[device]\nid = '////'\n", "config.toml:2: device.id: needs a letter or a digit, such as imu-1"),
        ("[device]\nrate_hz = 1e-300\n", "config.toml:2: device.rate_hz: must be 0 or from 0.0001 to 100000"),
        (
            "[device]\nbaud = 12345678901234567890123\n",
            f'config.toml:2: device.baud: must be one of "auto", {BAUDS}, not 12345678901234567890123',
        ),
        (
            '[state]\ndirectory = "a\\u0000b"\n',
            "config.toml:2: state.directory: has a character that no file and no key can have",
        ),
        (
            '[zenoh]\nlisten = ["a", "b\\u0000"]\n',
            "config.toml:2: zenoh.listen: has a character that no file and no key can have",
        ),
        (
            "[record]\nfile = 2020-01-01\n",
            "config.toml:2: record.file: must be text in quotes, not 2020-01-01",
        ),
        (
            "[zenoh]\nlisten = ['a', 12:00:00]\n",
            "config.toml:2: zenoh.listen: must be text in quotes, not 12:00:00",
        ),
    ],
)
def test_single_faults(tmp_path: Path, text: str, fault: str) -> None:
    (line,) = faults(write(tmp_path, text))
    assert line.startswith(fault)


def test_words_that_are_no_text_are_refused(tmp_path: Path) -> None:
    (line,) = faults(write(tmp_path, ""), record__file="r\udcff.bin")
    assert line.startswith("command line: record.file: has a character that no file and no key can have")


def test_unreadable_files(tmp_path: Path) -> None:
    assert faults(tmp_path / "none.toml") == ["none.toml: cannot be read: No such file or directory"]
    file = write(tmp_path, "")
    file.write_bytes(b"port = '\xff'")
    assert faults(file) == ["config.toml: is not UTF-8 text (byte 8)"]


def test_monstrous_files_are_a_line_too(tmp_path: Path) -> None:
    deep = write(tmp_path, "x = " + 3000 * "[" + 3000 * "]")
    assert faults(deep) == ["config.toml: not TOML: nested too deeply"]
    assert faults(write(tmp_path, "[zenoh.raw]\n" + 3000 * "a." + "a = 1\n"))[0].endswith("nested too deeply")
    assert len(faults(write(tmp_path, "[device]\nbaud = " + 5000 * "9"))) == 1


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    assert load(write(tmp_path, "\ufeff[log]\nlevel = 'debug'\n")).log.level == "debug"


def test_without_a_file_or_a_flag_nothing_is_checked_and_pydantic_not_loaded(tmp_path: Path) -> None:
    code = "import sys; from imumon.config import load; load(None, {'device.port': None}); "
    code += "print('pydantic' in sys.modules)"
    clean = {"HOME": str(tmp_path), "PATH": "", "PYTHONPATH": str(SHIPPED.parent)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=clean, capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


def test_flags_win_and_every_value_knows_where_it_is_from(tmp_path: Path) -> None:
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
    shown = render(settings, origins=True)
    assert "# command line\nbaud = 921600\n" in shown
    assert f'# {file}:3\nport = "sim"\n' in shown
    assert "secret" not in shown
    assert set(settings.origins) == set(config.NAMES)


def test_search_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "xdg"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home))
    monkeypatch.chdir(tmp_path)
    assert load().path in (None, Path("/etc/imumon/config.toml"))
    (home / "imumon").mkdir(parents=True)
    write(home / "imumon", "[log]\nlevel = 'debug'\n")
    assert load().log.level == "debug"
    write(tmp_path, "[log]\nlevel = 'error'\n")
    assert load().log.level == "error"


@given(st.text(), st.floats(0.1, 60.0), st.lists(st.text(), max_size=3))
def test_what_is_rendered_is_read_back(text: str, period: float, names: list[str]) -> None:
    settings = Settings(
        device=config.DeviceSettings(port=text),
        report=config.ReportSettings(period_s=period),
        zenoh=config.ZenohSettings(allow=tuple(names), raw={"a/b": text, "c": [1, True]}),
    )
    read = tomllib.loads(render(settings))
    assert read["device"]["port"] == text
    assert read["report"]["period_s"] == period
    assert read["zenoh"]["allow"] == names
    assert read["zenoh"]["raw"] == {"a/b": text, "c": [1, True]}


@given(text=st.text(max_size=200))
def test_no_text_does_worse_than_a_config_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    file = tmp_path_factory.getbasetemp() / "any.toml"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    with contextlib.suppress(ConfigError):
        load(file)


def test_read_apart_the_settings_are_the_same_and_pydantic_stays_out(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.toml", tmp_path / "bad.toml"
    good.write_text("[report]\nperiod_s = 2.0\n")
    bad.write_text("[report]\nperiod_s = 0\n")
    code = f"""
import sys
from imumon.config import ConfigError, load, load_apart
flags = {{"device.baud": 9600}}
made = load_apart({str(good)!r}, flags)()
try:
    load_apart({str(bad)!r}, flags)()
except ConfigError as error:
    said = str(error)
assert "pydantic" not in sys.modules
assert made == load({str(good)!r}, flags), made
assert "bad.toml:2: report.period_s" in said, said
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_settings_are_read_here_where_the_process_of_its_own_is_killed(tmp_path: Path) -> None:
    good = tmp_path / "good.toml"
    good.write_text("[report]\nperiod_s = 2.0\n")
    code = f"""
import os, signal
from imumon import config
here, whole = os.getpid(), config.load
def load(*words):
    if os.getpid() != here:
        os.kill(os.getpid(), signal.SIGKILL)
    return whole(*words)
config.load = load
assert config.load_apart({str(good)!r}, {{}})().report.period_s == 2.0
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
