"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import resource
import signal
import stat
from contextlib import nullcontext
from pathlib import Path

import pytest

from imumon.files import check_replaceable, rename_aside, replace_file


def test_a_file_is_replaced_with_its_mode_and_through_its_link(tmp_path: Path) -> None:
    file, link = tmp_path / "page.html", tmp_path / "link.html"
    file.write_bytes(b"old")
    file.chmod(0o640)
    link.symlink_to(file)
    replace_file(link, b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.html", "page.html"]


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    """A limit on the size of files replaces the disk."""
    file = tmp_path / "page.html"
    file.write_bytes(b"old")
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            replace_file(file, b"x" * 5000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert file.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_a_pipe_is_written_as_it_is(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    replace_file(pipe, b"data")
    assert os.read(reader, 100) == b"data"
    os.close(reader)


@pytest.mark.parametrize(("reason", "kept"), [("damaged", range(16, 26)), ("other-version", range(1, 26))])
def test_of_files_that_nobody_can_use_the_newest_are_kept(tmp_path: Path, reason: str, kept: range) -> None:
    (tmp_path / "a.damaged-x.state").write_text("of somebody else")
    for number in range(1, 26):
        (tmp_path / "a.state").write_text(str(number))
        assert rename_aside(tmp_path / "a.state", "a", reason, ".state").read_text() == str(number)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"a.damaged-x.state", *(f"a.{reason}-{number}.state" for number in kept)}


@pytest.mark.parametrize(
    ("name", "error"),
    [("none/x", FileNotFoundError), ("", IsADirectoryError), ("/dev/full", None), ("x", None)],
)
def test_an_output_is_checked_without_a_trace(tmp_path: Path, name: str, error: type[OSError] | None) -> None:
    with pytest.raises(error) if error else nullcontext():
        check_replaceable(tmp_path / name)
    assert not list(tmp_path.iterdir())
