"""Completion scripts for bash, zsh and fish, made from the parsers of the commands.

They are static text: completing starts no Python. An option's value completes as its choices, as a file
where its placeholder is FILE, DIR or PATH, as a serial port where it is PORT, and as nothing else.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_KINDS = {"FILE": "file", "PATH": "file", "DIR": "dir", "PORT": "port"}


@dataclass(frozen=True, slots=True)
class _Word:
    """An option, or a positional argument with no `names`.

    `kind` is ``flag``, ``choices``, ``file``, ``dir``, ``port`` or ``text``.
    """

    names: tuple[str, ...]
    kind: str
    choices: tuple[str, ...]
    help: str


def script(shell: str, commands: Mapping[str, argparse.ArgumentParser]) -> str:
    """Text to be sourced by the shell; the first line says how."""
    words = {name: tuple(_words(parser)) for name, parser in commands.items()}
    about = {name: (parser.description or "").rstrip(".") for name, parser in commands.items()}
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](words, about)


def _words(parser: argparse.ArgumentParser) -> Iterator[_Word]:
    for action in parser._actions:
        place = action.metavar if isinstance(action.metavar, str) else ""
        kind = next((kind for part, kind in _KINDS.items() if place.startswith(part)), "text")
        if action.nargs == 0:
            kind = "flag"
        elif action.choices:
            kind = "choices"
        text = (action.help or "").replace("%%", "%").replace("%(default)s", str(action.default))
        choices = tuple(str(choice) for choice in action.choices or ())
        yield _Word(tuple(action.option_strings), kind, choices, text)


def _bash(words: Mapping[str, tuple[_Word, ...]], about: Mapping[str, str]) -> str:
    cases = []
    for command, known in words.items():
        cases.append(f"        {command})\n            case $previous in")
        cases += [
            f"                {'|'.join(word.names)}) {_bash_value(word)} ;;"
            for word in known
            if word.names and word.kind != "flag"
        ]
        options = " ".join(name for word in known for name in word.names)
        free = next((word for word in known if not word.names), None)
        cases.append("            esac")
        rest = _bash_value(free) if free else "return"
        cases.append(f'            case $current in -*) offer "{options}" ;; *) {rest} ;; esac ;;')
    body = "\n".join(cases)
    return f"""# imumon, completed by bash. Put it there once and for all:
# imumon completion bash > ~/.local/share/bash-completion/completions/imumon
_imumon() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD - 1]}}
    COMPREPLY=()
    offer() {{ mapfile -t COMPREPLY < <(compgen -W "$1" -- "$current"); }}
    files() {{ compopt -o filenames 2>/dev/null; mapfile -t COMPREPLY < <(compgen "$1" -- "$current"); }}
    ports() {{
        mapfile -t COMPREPLY < <(compgen -W sim -- "$current"; compgen -G "${{current:-/dev/tty}}*")
    }}
    if ((COMP_CWORD == 1)); then
        offer "{" ".join(words)} --help --version"
        return
    fi
    case ${{COMP_WORDS[1]}} in
{body}
    esac
}}
complete -F _imumon imumon
"""


def _bash_value(word: _Word) -> str:
    return {
        "choices": f'offer "{" ".join(word.choices)}"; return',
        "file": "files -f; return",
        "dir": "files -d; return",
        "port": "ports; return",
        "text": "return",
    }[word.kind]


def _zsh(words: Mapping[str, tuple[_Word, ...]], about: Mapping[str, str]) -> str:
    cases = []
    for command, known in words.items():
        lines = [f"        {command})", "            _arguments -S \\"]
        for word in known:
            note = _zsh_text(word.help)
            if not word.names:
                lines.append(f"                ':{note}:{_zsh_value(word)}' \\")
            for name in word.names:
                value = "" if word.kind == "flag" else f":value:{_zsh_value(word)}"
                lines.append(f"                '*{name}[{note}]{value}' \\")
        cases.append("\n".join(lines).removesuffix(" \\") + " ;;")
    listed = "\n".join(f"        '{name}:{_zsh_text(text)}'" for name, text in about.items())
    body = "\n".join(cases)
    return f"""#compdef imumon
# imumon, completed by zsh: imumon completion zsh > DIRECTORY/_imumon, a directory of $fpath
_imumon() {{
    local -a commands
    commands=(
{listed}
    )
    if ((CURRENT == 2)); then
        _describe command commands
        return
    fi
    local command=${{words[2]}}
    shift words
    ((CURRENT--))
    case $command in
{body}
    esac
}}
if [[ $funcstack[1] == _imumon ]]; then _imumon "$@"; else compdef _imumon imumon; fi
"""


def _zsh_text(text: str) -> str:
    """Text within single quotes, where brackets and colons mean something."""
    return text.replace("'", "").replace("[", "(").replace("]", ")").replace(":", "\\:")


def _zsh_value(word: _Word) -> str:
    return {
        "choices": f"({' '.join(word.choices)})",
        "file": "_files",
        "dir": "_files -/",
        "port": '_files -g "/dev/tty*"',
        "text": " ",
    }[word.kind]


def _fish(words: Mapping[str, tuple[_Word, ...]], about: Mapping[str, str]) -> str:
    lines = [
        "# imumon, completed by fish: imumon completion fish > ~/.config/fish/completions/imumon.fish",
        "complete -c imumon -f",
    ]
    for name, text in about.items():
        lines.append(f"complete -c imumon -n __fish_use_subcommand -a {name} -d {_fish_text(text)}")
    for command, known in words.items():
        only = f"complete -c imumon -n '__fish_seen_subcommand_from {command}'"
        for word in known:
            value = {
                "flag": "",
                "choices": f" -x -a {_fish_text(' '.join(word.choices))}",
                "file": " -r -F",
                "dir": " -x -a '(__fish_complete_directories)'",
                "port": " -x -a 'sim /dev/tty*'",
                "text": " -x",
            }[word.kind]
            options = "".join(
                f" -l {name[2:]}" if name.startswith("--") else f" -s {name[1:]}" for name in word.names
            )
            if options or value.strip() not in ("", "-x"):
                value = value if options else value.replace(" -x", "").replace(" -r", "")
                lines.append(f"{only}{options}{value} -d {_fish_text(word.help)}")
    return "\n".join(lines) + "\n"


def _fish_text(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"
