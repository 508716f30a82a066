"""Formats of a datasheet, and how each is made from a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from imumon.datasheet import config_snippets, figures
from imumon.datasheet.blocks import markdown
from imumon.datasheet.content import datasheet_content
from imumon.datasheet.html import html_page
from imumon.datasheet.tables import csv_tables
from imumon.report import Report, to_json


def document(report: Report, form: str) -> bytes:
    """Return the document of a report in one of the `FORMS`.

    Raises
    ------
    NoCurve : the format is a figure, and the report has no curve yet.
    """
    data = FORMS[form][0](report)
    return data if isinstance(data, bytes) else data.encode(errors="replace")


FORMS: Mapping[str, tuple[Callable[[Report], str | bytes], str]] = {
    "md": (lambda report: markdown(datasheet_content(report)), "the datasheet as Markdown"),
    "html": (
        lambda report: html_page(datasheet_content(report), report),
        "the datasheet as one page to print",
    ),
    "png": (figures.png, "the Allan curves as a picture"),
    "json": (lambda report: to_json(report, indent=1) + "\n", "the report itself; --baseline reads it"),
    "csv": (csv_tables, "the curves and coefficients as a table"),
    "kalibr": (config_snippets.kalibr, "Kalibr imu.yaml"),
    "ros": (config_snippets.ros, "covariances of a ROS sensor_msgs/Imu"),
    "px4": (config_snippets.px4, "PX4 EKF2 parameters"),
    "ardupilot": (config_snippets.ardupilot, "ArduPilot EKF3 parameters"),
    "gtsam": (config_snippets.gtsam, "GTSAM preintegration parameters, Python"),
    "openvins": (config_snippets.openvins, "OpenVINS kalibr_imu_chain.yaml"),
}
"""Function that makes a document, and what the document is, by the name of the format."""
