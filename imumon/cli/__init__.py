"""Commands of the program: one module per group."""

from imumon.cli.main import main, parsers

__all__ = ["main", "parsers"]
