"""Build command: what setuptools does, the manual page, and the table of errors as package data."""

from __future__ import annotations

import shutil
from pathlib import Path

from build_manpages import build_py as BuildWithManual


class build_py(BuildWithManual):  # type: ignore[misc, valid-type]
    """Build the package with the table of errors."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:  # a checkout has the table itself
            shutil.copy(Path(__file__).parent / "docs" / "ERRORS.md", Path(self.build_lib) / "imumon")
