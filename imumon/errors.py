"""Errors of sources: one line each, what is wrong and how to mend it."""

from __future__ import annotations


class SourceError(Exception):
    """Bytes cannot be had or kept; the text says why and what to do."""


class RateUnknown(SourceError):
    """Samples have no time, and nobody told their rate."""


class OptionNotApplicable(SourceError):
    """A file is asked for what one of its kind has not."""
