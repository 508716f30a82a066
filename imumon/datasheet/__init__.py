"""Datasheet: documents and settings made from a report."""

from imumon.datasheet.datasheet import (
    FORMS,
    CannotDraw,
    document,
)

__all__ = [
    "FORMS",
    "CannotDraw",
    "document",
]
