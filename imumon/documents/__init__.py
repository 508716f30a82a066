"""Datasheet: documents and settings from a report. The only computation is the conversion of units.

datasheet        entry: `document`, and the formats there are
sheet            the two pages that a customer reads, element by element
appendix         what supports them, section by section
elements         the elements, and their form in Markdown
html             the form as one self-contained HTML page
figures          Allan deviation as an element of the page and as SVG and PNG, by matplotlib
report_texts     texts and numbers that several forms share
summary          the report on one screen
csv_table        every number as one tidy CSV table
filter_values    numbers for filters, with comments: unit, origin, factor against plain K, record length
convergence_figure  what was stated of a shorter record: figure and table
spectrum_figure  power spectral density
temperature_figure  the bias against the temperature
plotting         what all figures have in common
references       published limits of sensors
program_settings settings of other programs: templates and factors
"""

from imumon.documents.datasheet import DEFAULT_PROGRAM, FORMS, PAGES, document
from imumon.documents.figures import NoCurve
from imumon.documents.filter_values import short_record_text

__all__ = [
    "DEFAULT_PROGRAM",
    "FORMS",
    "PAGES",
    "NoCurve",
    "document",
    "short_record_text",
]
