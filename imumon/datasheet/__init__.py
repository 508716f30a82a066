"""Datasheet: documents and settings from a report. The only computation is the conversion of units.

datasheet        entry: `document`, and the formats there are
content          content of a datasheet, block by block
blocks           the blocks, and their form in Markdown
html             the form as one self-contained HTML page
figures          Allan deviation as SVG and PNG, by matplotlib
tables           table for a terminal, curves and coefficients as CSV
signal_text      bias, drift, spectral lines and changes as lines of text
config_snippets  settings for Kalibr, ROS, PX4, ArduPilot, GTSAM, OpenVINS
"""

from imumon.datasheet.datasheet import FORMS, document
from imumon.datasheet.figures import NoCurve

__all__ = ["FORMS", "NoCurve", "document"]
