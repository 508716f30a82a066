"""Build command: what setuptools does, the manual page, and table of errors and revision of the source as package data.

`imumon/commit.txt` is only in built distributions. In a source checkout imumon asks git.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from build_manpages import build_py as BuildWithManual
from setuptools.command.sdist import sdist as Sdist


class build_py(BuildWithManual):  # type: ignore[misc, valid-type]
    """Build the package with the table of errors, and record the revision; without git, that of the archive stays."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:  # a checkout has the table itself
            shutil.copy(Path(__file__).parent / "docs" / "ERRORS.md", Path(self.build_lib) / "imumon")
        revision = git_revision(Path(__file__).parent)
        if not self.editable_mode and revision is not None:
            target = Path(self.build_lib) / "imumon" / "commit.txt"
            target.write_text(revision + "\n")


def git_revision(directory: Path) -> str | None:
    """Return the commit of a checkout, with ``-dirty`` if files differ from it; None without git."""
    words = ["git", "-C", str(directory), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


class sdist(Sdist):
    """Make the source archive and record the revision in it: without git, a build takes it from there."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        revision = git_revision(Path(__file__).parent)
        if revision is not None:
            (Path(base_dir) / "imumon" / "commit.txt").write_text(revision + "\n")
