"""Errors: docs/ERRORS.md lists every code and no other; errors of the system end in one line with a cure."""

from __future__ import annotations

import ast
import errno
import functools
import io
import os
import re
from pathlib import Path

import pytest
from paths import ROOT
from source_trees import nodes

from imumon.cli import output as command_output
from imumon.model.errors import ImumonError
from imumon.model.system_errors import cure_of_reading, not_done, not_read, not_written

DOCUMENT = (ROOT / "docs" / "ERRORS.md").read_text("utf-8")
LISTED = [
    code
    for line in DOCUMENT.splitlines()
    if line.startswith("| `")
    for code in re.findall(r"`(\w+)`", line.split("|")[1])
]


def _error_classes() -> set[str]:
    """Return the names of `ImumonError` and its subclasses, and of `ConfigFault`, which has a code too."""
    found = {"ImumonError", "ConfigFault"}
    classes = [node for module in nodes().values() for node in module if isinstance(node, ast.ClassDef)]
    while more := {c.name for c in classes if any(ast.unparse(base) in found for base in c.bases)} - found:
        found |= more
    return found


@functools.cache
def calls() -> list[tuple[Path, ast.Call]]:
    """Return each call that makes an error, with the module it is in."""
    errors = _error_classes()
    return [
        (path, node)
        for path, module in nodes().items()
        for node in module
        if isinstance(node, ast.Call) and node.args and ast.unparse(node.func) in errors
    ]


COMPOSED = ("format_", "_invalid")
"""Parts of codes that are made from a word of a table or the name of an option."""


def test_every_code_is_listed() -> None:
    literal = {call.args[0].value for _, call in calls() if isinstance(call.args[0], ast.Constant)}
    assert len(literal) > 80
    assert not literal - set(LISTED)


def test_every_listed_code_exists() -> None:
    words = {
        node.value
        for module in nodes().values()
        for node in module
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    composed = {code for code in LISTED if code.startswith(COMPOSED[0]) or code.endswith(COMPOSED[1])}
    assert not set(LISTED) - words - composed
    for code in composed - words:
        assert code.replace(COMPOSED[0], "").replace(COMPOSED[1], "") in words, code


def has_cure(call: ast.Call) -> bool:
    if any(isinstance(argument, ast.Starred) for argument in call.args):
        return True
    return len(call.args) >= 3 and not (isinstance(call.args[2], ast.Constant) and call.args[2].value == "")


def test_an_error_has_a_cure() -> None:
    """A state that is not usable is renamed without a user; a fault of the settings has a cure by its type."""
    others = ("ConfigFault", "ConfigError", "StateError", "StateVersionError", "RecordMismatch")
    assert not [
        f"{path}:{call.lineno}: {ast.unparse(call.func)}"
        for path, call in calls()
        if ast.unparse(call.func) not in others and not has_cure(call)
    ]


def test_the_text_of_an_error_is_message_and_cure() -> None:
    error = ImumonError("port_busy", "it is in use", "end that program")
    assert str(error) == "it is in use: end that program"
    assert "\n" not in str(error)


# ---------------------------------------------------------------- errors of the operating system


NUMBERS = sorted({*errno.errorcode, 9999})
"""Every number of the system, and one that it does not have."""


ENOUGH = (errno.EPIPE, errno.ESHUTDOWN)
"""A reader of the output has ended: no error of the command."""


def error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.mark.few
@pytest.mark.parametrize("number", NUMBERS)
def test_every_number_has_a_message_and_a_cure_of_one_line(number: int) -> None:
    raised = error(number)
    for described in (not_written("a.html", raised, "name another"), not_read("a", raised), not_done(raised)):
        assert described.message.endswith(os.strerror(number).lower())
        assert described.cure
        assert not set("\n{}") & set(str(described))
    # what a number says does not hold of another kind of file
    assert "--state" not in not_written("a.html", raised, "name another").cure + cure_of_reading(raised)


@pytest.mark.few
@pytest.mark.parametrize("number", [n for n in NUMBERS if n not in ENOUGH])
def test_standard_output_that_fails_is_an_error_of_the_output(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """The lowest stream fails as the system does; what is above it is real."""

    class Failing(io.FileIO):
        def write(self, data: object, /) -> int:
            raise error(number)

    class Output(command_output._StandardOutput, Failing):
        """Standard output above a system that fails."""

    monkeypatch.setattr(command_output, "discard_stdout", lambda: None)
    read_end, write_end = os.pipe()
    stream = io.BufferedWriter(Output(write_end, "w", closefd=False))
    stream.write(b"x")
    with pytest.raises(ImumonError) as caught:
        stream.flush()
    assert (caught.value.code, caught.value.message.split(":")[0]) == (
        "output_not_writable",
        "cannot write the output",
    )
    with pytest.raises(ImumonError):
        stream.close()
    os.close(read_end)
    os.close(write_end)
