"""Files of public programs are read right without options, or refused with cures that lead to the right numbers."""

from __future__ import annotations

from pathlib import Path

import pytest
from followed_cures import outcomes
from paths import ROOT
from public_formats import ACCEL, FORMATS, GYRO, RATE, PublicFormat, T, rows

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.model.report import Report

WITHIN = 0.03
"""Share by which N may differ: counts are rounded, and a file has less digits than an array."""

SHARED = ROOT.parent / "shared" / "cases"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Return the report of the same samples in SI."""
    path = tmp_path_factory.mktemp("plain") / "a.csv"
    units = ("s", *["rad/s"] * 3, *["m/s^2"] * 3)
    names = ("t", "gx", "gy", "gz", "ax", "ay", "az")
    path.write_text(
        rows(T, GYRO, ACCEL, header=",".join(f"{n} [{u}]" for n, u in zip(names, units, strict=True)))
    )
    return replay(ReplayOptions(path=str(path), guarded=False))


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_public_format_is_read_right_or_cured(tmp_path: Path, plain: Report, form: PublicFormat) -> None:
    path = tmp_path / form.file
    path.write_text(form.text())
    reports = list(outcomes(path, ReplayOptions(path=str(path), guarded=False), known=form.known))
    seen: set[str] = set()
    for report in reports:
        assert report.device.sample_rate_hz == pytest.approx(RATE, rel=1e-3)
        for name, channel in report.channels.items():
            if (sensor := name.partition("/")[0]) in ("gyro", "accel"):
                seen.add(sensor)
                assert channel.N.value == pytest.approx(plain.channels[name].N.value, rel=WITHIN), name
    # a sensor may also be named in a remark, with how to use it
    remarks = " ".join(text for report in reports for text in report.device.remarks)
    named = {s for s in form.sensors if f"{s}/x=" in remarks or "reads others" in remarks}
    assert seen | named >= set(form.sensors) or (form.asked and not seen)


# ---------------------------------------------------------------- the cases beside the checkout

N_OF_AXES = {"gyro": (1.0e-4, 2.0e-4, 3.0e-4), "accel": (1.0e-3, 1.5e-3, 2.0e-3)}
"""SI, true N of x, y, z in most cases."""
EVEN = {"gyro": (3.0e-4,) * 3, "accel": (1.5e-3,) * 3}
CASES: dict[str, dict[str, tuple[float, ...]]] = {
    "blank_separated_units/data.txt": {"gyro": (1.0e-4,) * 3, "accel": (0.843e-3,) * 3},
    "json/mqtt.jsonl": EVEN,
    "one_row_per_event/sensors.sense": EVEN,
    "labelled_lines/labels1.log": EVEN,
    "labelled_lines/serial.log": EVEN,
    "millimetres/adxl345-20230101.csv": {"accel": (3.0e-3,) * 3},
}
"""SI, N of the white noise that the files have, by their differences; the others have `N_OF_AXES`."""

KNOWN = {
    "COUNTS": "16.4",
    "ACCEL_SCALE": repr(2.0**-29),
    "GYRO_SCALE": repr(2.0**-33),
    "--rate": "--rate 100",
}
"""What the owner of a case knows: counts of its gyroscope, scales of its IMU, the rate."""

CASE_FILES = sorted(path for path in SHARED.glob("*/*") if path.is_file()) if SHARED.is_dir() else []


@pytest.mark.skipif(not CASE_FILES, reason="the cases are beside the checkout, in ../shared/cases")
@pytest.mark.parametrize("path", CASE_FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_case_is_read_right_or_cured(path: Path) -> None:
    right = CASES.get(f"{path.parent.name}/{path.name}", N_OF_AXES)
    reports = list(outcomes(path, ReplayOptions(path=str(path), guarded=False), known=KNOWN))
    assert reports
    for report in reports:
        for name, channel in report.channels.items():
            sensor, _, axis = name.partition("/")
            if sensor in right:
                true, N = right[sensor]["xyz".index(axis)], channel.N
                assert N.value == pytest.approx(true, rel=WITHIN) or N.low <= true <= N.high, name
