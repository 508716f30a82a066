"""References: published limits of sensors, one TOML file each, and the check of a report against them.

reference_sheet  files and their format; the files of this directory are read by the model of the device
limit_checks     pass, fail or undecided of each value
"""

from imumon.references.reference_sheet import (
    ReferenceSheet,
    SheetError,
    published,
    read_sheet,
    sheet_of_model,
)

__all__ = ["ReferenceSheet", "SheetError", "published", "read_sheet", "sheet_of_model"]
