"""Manual pages, made from the parsers of the commands and the settings' own notes.

imumon(1) has what all commands share, imumon-COMMAND(1) one of them, imumon(5) the settings. What a parser
does not know stands below: why one would use a command, and examples. They are written in man(7), which
every `man` reads, in ASCII with escapes. The pages are files of the project, so that an installation has
them without running anything; ``python -m imumon.cli.manual`` writes them anew.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from imumon import __version__
from imumon.cli.options import DONE, FAILED, INTERRUPTED, NOT_IN_TIME, NOTHING_THERE, USAGE

EXITS = {
    DONE: "done",
    FAILED: "failed; one line on standard error says why, and how to mend it",
    USAGE: "wrong usage, or faults in the settings",
    NOTHING_THERE: "nothing there: no port, no sensor or no daemon",
    NOT_IN_TIME: "not reached in time",
    INTERRUPTED: "interrupted by the keyboard",
}
IN_TIME = ("run", "wait")
ALONE = ("config", "completion")
"""Commands that wait for something, and those that need neither port nor daemon."""
ENVIRONMENT = {
    "XDG_CONFIG_HOME": "where imumon/config.toml is looked for; default ~/.config",
    "XDG_STATE_HOME": "where imumon/ keeps the accumulated statistics; default ~/.local/state",
    "STATE_DIRECTORY": "the same, given by a service manager; it goes before XDG_STATE_HOME",
    "NOTIFY_SOCKET": "given by a service manager: the daemon tells it when it is ready, what it does and, "
    "with WATCHDOG_USEC, that it is alive; a missing sensor is then waited for",
    "JOURNAL_STREAM": "given by a service manager: the daemon's lines get the priorities of the journal",
    "GLIBC_TUNABLES": "goes to the C library; run adds words of its own, and starts itself once more for "
    "that, under the same process number",
    "IMUMON_STARTED": "set to anything, for a debugger say, run starts once; it then takes some MB more",
    "NO_COLOR": "the screen is drawn without colours",
}
FILES = {
    "./config.toml": "the first of these that is there holds the settings, imumon(5)",
    "~/.config/imumon/config.toml": "",
    "/etc/imumon/config.toml": "",
    "~/.local/state/imumon/": "the accumulated statistics, a file a sensor and the one before it",
    "/var/lib/imumon/PORT/": "the same, of a service",
    "/etc/systemd/system/imumon@.service": "the service; imumon@ttyUSB0 reads /dev/ttyUSB0",
}
COMMON = {
    "imumon demo": "Emulated sensor, daemon and screen: see what it does, without a sensor.",
    "imumon doctor": "Ask whether port, sensor and machine are in order, before the first run.",
    "imumon run": "Read the one VN-100 that is plugged in, until told to stop.",
    "imumon tui": "Look at it, from another terminal.",
    "imumon report --format html -o sensor.html": "The datasheet of this sensor.",
    "journalctl -u imumon@ttyUSB0 -p warning": "What a service had to complain of.",
}


@dataclass(frozen=True, slots=True)
class About:
    """What a parser does not know of its command: paragraphs, examples, exits that mean more here."""

    text: str
    examples: Mapping[str, str]
    exits: Mapping[int, str] = field(default_factory=dict)


ABOUT = {
    "run": About(
        "Finds the sensor and its baud, asks it for the stream that shows its own noise, and publishes a "
        "report a second. Knocks, motion and warm-up are cut out and counted. A lost sample is a gap on the "
        "sensor's clock, an unplugged sensor is waited for, and a restart goes on with the saved record.\n"
        "Nothing is written to the sensor's flash, and at the end it has its settings back.",
        {
            "imumon run --port /dev/ttyUSB0 --record capture.bin": "Keep the raw bytes as well.",
            "imumon run --port socket://192.168.1.7:4001 --baud 115200": "A serial server on the network.",
            "imumon run --duration 600 --json": "Ten minutes, then a report on standard output.",
        },
        {NOT_IN_TIME: "no sensor within --duration"},
    ),
    "demo": About(
        "Starts an emulated sensor in time-lapse, a daemon that reads it, and the live screen. Quitting the "
        "screen ends all three, and nothing of it stays.",
        {"imumon demo --speed 600": "Ten minutes of the sensor in a second."},
    ),
    "tui": About(
        "Subscribes to the daemons and draws the newest report of one. Press ? for the keys, q to quit; the "
        "daemon goes on.",
        {"imumon tui --connect tcp/192.168.1.7:7448": "A daemon on another machine."},
    ),
    "status": About(
        "Asks a running daemon for its newest report and prints it.",
        {"imumon status --json": "The whole report, for a program."},
        {NOTHING_THERE: "no daemon answers within two seconds"},
    ),
    "wait": About(
        "Ends as soon as a running daemon's report holds what is asked, for scripts. A grade is reached when "
        "nothing that is still unknown could take it away.",
        {
            "imumon wait --grade industrial --timeout 2h": "Until the sensor is industrial for certain.",
            "imumon wait --coefficient N --precision 5% --timeout 10m": "Until N is known to 5 percent.",
        },
        {DONE: "reached", NOT_IN_TIME: "not reached within --timeout"},
    ),
    "sim": About(
        "A VN-100 without a VN-100: it answers its registers, sends what it is told to and has the noise it "
        "is told to have. The first line of its output is the path of the pseudo-terminal to read.",
        {
            "imumon sim --link /tmp/sensor --seed 1": "An emulator at a path that does not change.",
            "imumon sim --rate 800 --baud 921600 --fault drop=1e-4": "A fast one that loses messages.",
        },
    ),
    "replay": About(
        "Reads a recording, of imumon or of others, as if it came from a sensor, and prints the report.",
        {
            "imumon replay capture.bin.gz --json": "The report of a recording.",
            "imumon replay imu.csv --map gyro/x=wx:rad/s,gyro/y=wy:rad/s,gyro/z=wz:rad/s,t=time:s":
                "Columns by name and unit.",
        },
    ),
    "report": About(
        "Writes the datasheet of a sensor, and the settings that estimators want to be told, from a running "
        "daemon, a saved report or state, or a recording.",
        {
            "imumon report --format html -o sensor.html": "A page that prints well.",
            "imumon report capture.bin.gz --format kalibr": "What Kalibr wants to be told, of a recording.",
        },
    ),
    "doctor": About(
        "Checks port, permission, adapter, sensor, stream, bus, state and service, one a line: ok, warning "
        "or failed, with the cure.",
        {"imumon doctor --port /dev/ttyUSB0": "One port.", "imumon doctor --port sim": "The emulator."},
        {FAILED: "at least one check has failed"},
    ),
    "config": About(
        "Shows every setting with the origin of its value, or checks a file: all faults at once, with their "
        "lines.",
        {"imumon config check --config /etc/imumon/config.toml": "Before the service is restarted."},
        {USAGE: "the file has faults"},
    ),
    "completion": About(
        "Prints a script that lets a shell complete commands, options and their values.",
        {"imumon completion bash > ~/.local/share/bash-completion/completions/imumon": "Once and for all."},
    ),
}  # fmt: skip


def pages(whole: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]) -> dict[str, str]:
    """Text of each page by the name of its file."""
    made = {"imumon.1": _all(whole, commands), "imumon.5": _settings()}
    for name, parser in commands.items():
        made[f"imumon-{name}.1"] = _one(name, parser)
    return made


def _all(whole: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]) -> str:
    lines = [_title("imumon", 1), *_name("imumon", whole.description or "")]
    lines += [".SH SYNOPSIS", ".SY imumon", r"\fICOMMAND\fR", r"[\fIOPTIONS\fR]", ".YS"]
    lines += [".SH DESCRIPTION"]
    lines += _paragraphs(
        "imumon reads a VectorNav VN-100 and shows, live, how good it is: angle (velocity) random walk N, "
        "bias instability B and rate random walk K of every axis, each with its 95 % limits, and the grade "
        "that follows. A daemon reads the sensor and publishes on Eclipse Zenoh; the screen and your own "
        "tools subscribe.\n"
        "Standard output carries data, standard error talk. Without flags that say otherwise, a daemon "
        "listens on this machine alone, tcp/127.0.0.1:7448 or the next free port up to 7463."
    )
    lines += [".SH COMMANDS"]
    for name, parser in commands.items():
        lines += [".TP", rf"\fBimumon\-{name}\fR(1)", _text(parser.description or "")]
    lines += [".SH OPTIONS", *_options(whole)]
    lines += [*_exits({}), *_table("ENVIRONMENT", ENVIRONMENT), *_table("FILES", FILES)]
    lines += [*_examples(COMMON), *_see(["imumon(5)", *(f"imumon-{name}(1)" for name in commands)])]
    return _end(lines)


def _one(name: str, parser: argparse.ArgumentParser) -> str:
    about = ABOUT[name]
    lines = [_title(f"imumon-{name}", 1), *_name(f"imumon-{name}", parser.description or "")]
    lines += [".SH SYNOPSIS", rf'.SY "imumon {name}"']
    for action in parser._actions:
        shown = _invocation(action).partition(", ")[0].replace(" ", r"\ ")
        optional = action.option_strings or action.nargs == "?"
        lines.append(f"[{shown}]" if optional else shown)
    lines += [".YS", ".SH DESCRIPTION", *_paragraphs(about.text), ".SH OPTIONS", *_options(parser)]
    without = {NOT_IN_TIME} if name not in IN_TIME else set()
    without |= {NOTHING_THERE} if name in ALONE else set()
    lines += [*_exits(about.exits, without), *_examples(about.examples)]
    return _end([*lines, *_see(["imumon(1)", "imumon(5)"])])


def _settings() -> str:
    """The page of the file of settings, from the file that has them all."""
    from imumon.config import Settings, render

    lines = [_title("imumon", 5), *_name("imumon", "settings, config.toml"), ".SH DESCRIPTION"]
    lines += _paragraphs(
        "A TOML file with sections; an empty one is valid. Flags win over it. The first of ./config.toml, "
        "$XDG_CONFIG_HOME/imumon/config.toml and /etc/imumon/config.toml is taken. imumon config show tells "
        "where every value comes from, imumon config check all faults of a file at once. Below, every "
        "setting has its default."
    )
    note = ""
    for line in render(Settings()).splitlines()[2:]:
        if section := re.match(r"\[(\w+)\]  # (.*)", line):
            lines += [f".SH [{section[1]}]", _text(f"{section[2]}.")]
        elif line.startswith("#"):
            note = line[2:]
        elif line:
            key, _, value = line.partition(" = ")
            lines += [".TP", rf"\fB{_text(key)}\fR = {_text(value)}", _text(note)]
    return _end([*lines, *_see(["imumon(1)", "imumon-config(1)", "imumon-run(1)"])])


def _title(name: str, section: int) -> str:
    return f'.TH {_text(name.upper())} {section} "" "imumon {__version__}" "imumon"'


def _name(name: str, text: str) -> list[str]:
    said = text.rstrip(".")
    return [".SH NAME", rf"{_text(name)} \- {_text(said[:1].lower() + said[1:])}"]


def _paragraphs(text: str) -> Iterator[str]:
    for number, part in enumerate(text.split("\n")):
        yield from ([".PP"] if number else []) + [_text(part)]


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    """Options and arguments, in the groups of the parser."""
    for group in parser._action_groups:
        actions = [a for a in group._group_actions if not isinstance(a, argparse._SubParsersAction)]
        if not actions:
            continue
        if group.title not in ("options", "positional arguments"):
            yield from (f".SS {_text(str(group.title))}", _text(group.description or ""))
        for action in actions:
            said = parser._get_formatter()._expand_help(action) if action.help else ""
            choices = ", ".join(str(choice) for choice in action.choices or ())
            one_of = f"One of {choices}." if choices else ""
            yield from (".TP", _invocation(action), _text(f"{said}. {one_of}".strip(". ") + "."))


def _invocation(action: argparse.Action) -> str:
    """How an option is written, its names bold and what it takes slanted."""
    place = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    value = "" if action.nargs == 0 else rf"\fI{_text(place)}\fR"
    if not action.option_strings:
        return value
    return ", ".join(rf"\fB{_text(name)}\fR {value}".strip() for name in action.option_strings)


def _exits(more: Mapping[int, str], without: Collection[int] = ()) -> list[str]:
    codes = {str(code): more.get(code, text) for code, text in EXITS.items() if code not in without}
    return _table("EXIT STATUS", codes)


def _table(title: str, rows: Mapping[str, str]) -> list[str]:
    lines = [f".SH {title}"]
    for name, text in rows.items():
        lines += [".TP", rf"\fB{_text(name)}\fR", _text(text) or r"\&"]
    return lines


def _examples(rows: Mapping[str, str]) -> list[str]:
    lines = []
    for command, text in rows.items():
        lines += [".PP", _text(text), ".PP", ".RS 4", ".EX", _text(command), ".EE", ".RE"]
    return [".SH EXAMPLES", *lines[1:]]


def _see(names: list[str]) -> list[str]:
    shown = (re.sub(r"^(.*)\((\d)\)$", r"\\fB\1\\fR(\2)", _text(name)) for name in names)
    return [".SH SEE ALSO", ",\n".join(shown)]


def _text(text: str) -> str:
    """Plain text in the language of man(7).

    >>> print(_text("-o OUT, a 95 % limit's \\\\ and τ"))
    \\-o OUT, a 95 % limit\\(aqs \\e and \\[u03C4]
    """
    shown = text.replace("\\", r"\e").replace("-", r"\-").replace("'", r"\(aq").replace("~", r"\(ti")
    shown = shown.replace("^", r"\(ha").replace("`", r"\(ga")
    shown = "".join(c if c.isascii() else rf"\[u{ord(c):04X}]" for c in shown)
    return r"\&" + shown if shown.startswith(".") else shown


def _end(lines: list[str]) -> str:
    """A page, whose blank lines would be holes in it."""
    head = '.\\" Made by python -m imumon.cli.manual; do not edit.'
    return "\n".join([head, *(line for line in lines if line)]) + "\n"


def main() -> None:
    """Write the pages into the directory that is named, or docs/man."""
    from imumon.cli import parsers

    words = argparse.ArgumentParser(prog="python -m imumon.cli.manual", description=main.__doc__)
    words.add_argument("directory", type=Path, nargs="?", default=Path("docs/man"))
    directory: Path = words.parse_args().directory
    directory.mkdir(parents=True, exist_ok=True)
    for name, text in pages(*parsers()).items():
        (directory / name).write_text(text)


if __name__ == "__main__":
    main()
