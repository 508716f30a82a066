"""The program: `imumon`, and `python -m imumon`."""

import sys


def main() -> int:
    """The command line; a daemon, which is to run for months, has its heap told how before all else."""
    try:
        if sys.argv[1:2] == ["run"]:
            from imumon import heap

            heap.tune()
        from imumon.cli import main as command
    except KeyboardInterrupt:
        return 130  # as the command line itself does
    return command()


if __name__ == "__main__":
    sys.exit(main())
