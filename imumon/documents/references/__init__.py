"""References: published limits of sensors, one TOML file each, and their comparison with a report.

reference_sheet  files and their format; the files of this directory are read by the model of the device
comparison       each value beside the measured interval
"""

from imumon.documents.references.reference_sheet import (
    ReferenceSheet,
    SheetError,
    published,
    read_sheet,
    sheet_of_model,
)

__all__ = ["ReferenceSheet", "SheetError", "published", "read_sheet", "sheet_of_model"]
