"""Datasheet: a report in, documents out. Nothing is measured here and nothing is computed but units.

text       the table on a terminal
sheet      what a datasheet says, block by block
blocks     what it is made of, before it has a form
markdown   that as Markdown
page       that as one self-contained HTML page
plot       Allan curves as SVG, written by hand
picture    Allan curves as PNG (matplotlib)
snippets   settings to paste into Kalibr, ROS, PX4, ArduPilot, GTSAM, OpenVINS
curves     the curves and coefficients as CSV
known      figures of others: the manufacturer's, a published laboratory report's
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from imumon.report import Report, to_json


class CannotDraw(Exception):
    """A document cannot be made here; the text says why and what to do."""


def document(made: Report, form: str) -> bytes:
    """A document of one of `FORMS`.

    Raises
    ------
    CannotDraw : something it needs is not installed, or the report has nothing to draw.
    """
    found = FORMS[form][0](made)
    return found if isinstance(found, bytes) else found.encode(errors="replace")


def _markdown(made: Report) -> str:
    from imumon.datasheet.content import sheet
    from imumon.datasheet.markdown import markdown

    return markdown(sheet(made))


def _page(made: Report) -> str:
    from imumon.datasheet.content import sheet
    from imumon.datasheet.html import page

    return page(sheet(made), made)


def _picture(made: Report) -> bytes:
    from imumon.datasheet.png_figure import picture

    return picture(made)


def _json(made: Report) -> str:
    return to_json(made, indent=1) + "\n"


def _csv(made: Report) -> str:
    from imumon.datasheet.csv_tables import table

    return table(made)


def _snippet(name: str) -> Callable[[Report], str]:
    def make(made: Report) -> str:
        from imumon.datasheet import config_snippets

        return config_snippets.SNIPPETS[name](made)

    return make


FORMS: Mapping[str, tuple[Callable[[Report], str | bytes], str]] = {
    "md": (_markdown, "the datasheet as Markdown"),
    "html": (_page, "the datasheet as one self-contained page that prints well"),
    "png": (_picture, "the Allan curves as a picture"),
    "json": (_json, "the report itself; --baseline reads it"),
    "csv": (_csv, "the curves and coefficients as a table"),
    "kalibr": (_snippet("kalibr"), "Kalibr imu.yaml"),
    "ros": (_snippet("ros"), "covariances of a ROS sensor_msgs/Imu"),
    "px4": (_snippet("px4"), "PX4 EKF2 parameters"),
    "ardupilot": (_snippet("ardupilot"), "ArduPilot EKF3 parameters"),
    "gtsam": (_snippet("gtsam"), "GTSAM preintegration parameters, Python"),
    "openvins": (_snippet("openvins"), "OpenVINS kalibr_imu_chain.yaml"),
}
"""What makes a document, and what it is, by the name of its form."""
