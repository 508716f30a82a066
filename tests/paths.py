"""Places of the checkout, and of the real recordings beside it."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
RECORDINGS = ROOT.parent / "shared" / "recordings"
needs_recordings = pytest.mark.skipif(not RECORDINGS.exists(), reason="no recordings beside the checkout")
