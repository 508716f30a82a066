"""Errors of the operating system end in one line with a cure, whatever their number."""

from __future__ import annotations

import errno
import io
import os

import pytest

from imumon.cli import output as command_output
from imumon.model.errors import ImumonError
from imumon.model.system_errors import cure_of_reading, not_done, not_read, not_written

NUMBERS = sorted({*errno.errorcode, 9999})
"""Every number of the system, and one that it does not have."""

ENOUGH = (errno.EPIPE, errno.ESHUTDOWN)
"""A reader of the output has ended: no error of the command."""


def error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.mark.few
@pytest.mark.parametrize("number", NUMBERS)
def test_every_number_has_a_message_and_a_cure_of_one_line(number: int) -> None:
    found = error(number)
    for described in (not_written("a.html", found, "name another"), not_read("a", found), not_done(found)):
        assert described.message.endswith(os.strerror(number).lower())
        assert described.cure
        assert not set("\n{}") & set(str(described))
    # what a number says does not hold of another kind of file
    assert "--state" not in not_written("a.html", found, "name another").cure + cure_of_reading(found)


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
