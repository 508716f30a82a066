"""Entry of the terminal UI.

Textual is imported in the functions: a command that only needs a status does not pay for it.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import TYPE_CHECKING, Any

from imumon.tui import terminal

if TYPE_CHECKING:
    from imumon.bus.subscriber import Subscriber


def run(source: Subscriber, **options: Any) -> int:
    """Show a source until the user quits.

    Parameters
    ----------
    source : where reports come from.
    options : as for `imumon.tui.app.ImumonApp`.

    Returns
    -------
    int : exit code: 0, 128 + n after signal n.
    """
    from imumon.tui.app import ImumonApp

    app = ImumonApp(source, ascii=terminal.only_ascii(), **options)
    app.run()
    return _flushed(app.return_code or 0)


def _flushed(code: int) -> int:
    """Flush the output and return the exit code; with the terminal gone, exit without an error message."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os._exit(code or 128 + signal.SIGHUP)
    return code
