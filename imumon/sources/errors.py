"""Errors of sources: one line each, what is wrong and how to mend it."""

from __future__ import annotations


class SourceError(Exception):
    """Bytes cannot be had or kept; the text says why and what to do."""
