"""The program: `imumon`, and `python -m imumon`."""

import os
import sys
import threading
from contextlib import suppress


def main() -> int:
    """Run the command line and return its exit code."""
    try:
        from imumon.cli import main as command
    except KeyboardInterrupt:
        return 130  # as the command line itself does
    code = command()
    # A command gives each of its threads some time to end. On a starved machine one may need longer, and an interpreter
    # that ends while a thread is inside Zenoh, which is in Rust, aborts the process.
    if any(thread.daemon for thread in threading.enumerate()):
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
