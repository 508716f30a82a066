"""The program: `imumon`, and `python -m imumon`."""

import sys


def main() -> int:
    """Run the command line and return its exit code."""
    try:
        from imumon.cli import main as command
    except KeyboardInterrupt:
        return 130  # as the command line itself does
    return command()


if __name__ == "__main__":
    sys.exit(main())
