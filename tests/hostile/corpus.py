"""Every hostile input of the tests: the door that it attacks, and what must happen there.

A door is a place where something of others enters imumon. `doors.py` takes an input through its door and returns the
outcome in the words of this table. It also holds every input to the laws of the door: what a person reads has no
control character and no traceback, and time and memory are bounded.

| door | an input is | outcomes |
|---|---|---|
| recording | a file for `imumon replay` | code of the error; `N samples`: it is read |
| settings | a file for `--config` | `faults`; `read` |
| report, signal | JSON of a message | `rejected`; `shown`: in every panel |
| device-name | a name | `rejected` |
| saved-report | a file for `imumon report` | `refused` |
| query | a way to ask a daemon for the impossible, again and again | `bounded`: its memory; it measures on |
| message | key and text on the bus | `ignored` by viewers, and counted |
| command | words of a command beside a daemon with hostile reports | exit code |

The inputs of a door are in the module `corpus_*.py` of its subject. A new input is a row there. Its name is the id of
its test: `pytest -k NAME` runs it.
"""

from __future__ import annotations

from typing import Any

import pytest
from corpus_bus import BUS
from corpus_messages import MESSAGES
from corpus_recordings import CAPTURES, IN_BAGS, KINDS_OF_FILES, MORE_THAN_A_FILE_HOLDS, TABLES
from corpus_settings import SETTINGS

CORPUS = (
    *TABLES,
    *KINDS_OF_FILES,
    *MORE_THAN_A_FILE_HOLDS,
    *CAPTURES,
    *IN_BAGS,
    *SETTINGS,
    *MESSAGES,
    *BUS,
)


def through(*doors: str) -> list[Any]:
    """Return the inputs of some doors as parameters of a test: all but the first of a door are slow."""
    first = {hostile.door: hostile for hostile in reversed(CORPUS)}
    return [
        pytest.param(
            hostile,
            id=f"{hostile.door}-{hostile.name}",
            marks=[] if hostile is first[hostile.door] else pytest.mark.slow,
        )
        for hostile in CORPUS
        if hostile.door in doors
    ]
