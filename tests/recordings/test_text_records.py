"""Text with names beside the numbers, and tables whose rows are of several sensors."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from tables import DEG, read, replayed, truth

from imumon.model.errors import RateRequired
from imumon.sources.files import OptionNotApplicable, RecordingError
from imumon.sources.files.columns import parse_map
from imumon.sources.files.sensor_column import parse_where
from imumon.sources.lines.line_decoder import LineDecoder

T, GYRO, ACCEL = truth(600)
AXES = "xyz"


def _by_name(t: float, g: np.ndarray, a: np.ndarray) -> dict[str, float]:
    return {"t": round(t, 6)} | {f"g{n}": v for n, v in zip(AXES, g, strict=True)} | {
        f"a{n}": v for n, v in zip(AXES, a, strict=True)
    }  # fmt: skip


def _nested(t: float, g: np.ndarray, a: np.ndarray) -> dict[str, object]:
    return {"ts": round(t, 6), "gyro": list(g), "acc": dict(zip(AXES, a, strict=True)), "id": "a;b,c"}


def _rows(write: Callable[[float, np.ndarray, np.ndarray], str]) -> list[str]:
    return [write(t, g, a) for t, g, a in zip(T.tolist(), GYRO.tolist(), ACCEL.tolist(), strict=True)]


YAML = """header:
  seq: 1
  stamp:
    secs: {s}
    nsecs: {ns}
  frame_id: "imu"
orientation_covariance: [0.0, 0.0, 0.0]
angular_velocity:
  x: {g[0]!r}
  y: {g[1]!r}
  z: {g[2]!r}
linear_acceleration:
  x: {a[0]!r}
  y: {a[1]!r}
  z: {a[2]!r}
---"""
FORMS = {
    "json lines": "\n".join(_rows(lambda t, g, a: json.dumps(_by_name(t, g, a)))),
    "nested": "\n".join(_rows(lambda t, g, a: json.dumps(_nested(t, g, a)))),
    "json list": json.dumps([_by_name(t, g, a) for t, g, a in zip(T.tolist(), GYRO, ACCEL, strict=True)], indent=1),
    "json columns": json.dumps({"t": T.round(6).tolist()} | {
        f"{s}{n}": list(v[:, k]) for s, v in (("g", GYRO), ("a", ACCEL)) for k, n in enumerate(AXES)
    }),
    "labels": "\n".join(_rows(lambda t, g, a: ", ".join(f"{k}: {v!r}" for k, v in _by_name(t, g, a).items()))),
    "equals": "\n".join(_rows(lambda t, g, a: " ".join(f"{k}={v!r}" for k, v in _by_name(t, g, a).items()))),
    "lists": "ready\n" + "\n".join(_rows(
        lambda t, g, a: f"time: {t:.6f}\nGyro (rad/s): {g[0]!r}, {g[1]!r}, {g[2]!r}\n"
        f"Accel: {a[0]!r} {a[1]!r} {a[2]!r}\n"
    )),
    "units": "Set to: 21 Hz\n" + "\n".join(_rows(
        lambda t, g, a: f"t: {t:.6f} s\nAcceleration X: {a[0]!r}, Y: {a[1]!r}, Z: {a[2]!r} m/s^2\n"
        f"Rotation X: {g[0] / DEG!r}, Y: {g[1] / DEG!r}, Z: {g[2] / DEG!r} deg/s\nTemperature: 30.0 degC\n"
    )),
    "rostopic": "\n".join(_rows(
        lambda t, g, a: YAML.format(s=1_700_000_000 + int(t), ns=round(t % 1 * 1e9), g=g, a=a)
    )),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_names_beside_the_numbers_are_read(tmp_path: Path, form: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(FORMS[form] + "\n")
    found = read(path)
    np.testing.assert_allclose(found.values[:, :6], np.hstack([GYRO, ACCEL]), rtol=1e-9, atol=1e-12)
    assert found.stream.interval_s == pytest.approx(0.01)
    report, remarks = replayed(path)
    assert report.session.missing == 0
    assert "header" not in remarks  # there is none to write a unit into


def test_a_record_that_cannot_be_read_is_an_invalid_row(tmp_path: Path) -> None:
    lines = FORMS["nested"].splitlines()
    lines[300] = lines[300][:40]
    (tmp_path / "a.jsonl").write_text("\n".join(lines) + "\n")
    report, remarks = replayed(tmp_path / "a.jsonl")
    assert (report.session.samples, report.session.missing, report.session.bad_checksums) == (599, 1, 1)
    assert "1 row is invalid" in remarks


def test_labels_without_a_time_need_a_rate(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("Found sensor!\n" + FORMS["labels"].replace("t: ", "n: "))
    with pytest.raises(RateRequired):
        read(tmp_path / "a.log")
    assert len(read(tmp_path / "a.log", rate_hz=100.0)) == len(T)


@pytest.mark.parametrize("form", ["json lines", "nested", "labels", "equals", "lists", "units"])
@pytest.mark.parametrize("chunk", [7, 100_000])
def test_live_lines_with_names_are_samples(form: str, chunk: int) -> None:
    data = (FORMS[form] + "\n").encode()
    decoder = LineDecoder({})
    blocks = [b for k in range(0, len(data), chunk) for b in decoder.feed(data[k : k + chunk])]
    blocks += decoder.finish()
    values = np.concatenate([block.values for block in blocks])
    np.testing.assert_allclose(values[:, :6], np.hstack([GYRO, ACCEL]), rtol=1e-9, atol=1e-12)
    assert decoder.fed == decoder.message_bytes + decoder.discarded + decoder.pending
    assert decoder.columns is not None
    # a recording keeps the columns, and is decoded by them
    again = LineDecoder(decoder.columns.settings)
    assert sum(map(len, [*again.feed(data), *again.finish()])) == len(values)


def test_a_table_with_times_of_day_is_no_labelled_text(tmp_path: Path) -> None:
    rows = [
        f" 9:44:{16 + k // 100:02}.{k % 100:02}7\tWT901(COM5)\t2024-3-19 9:44:{6 + k // 100}:{k % 100 * 10:03}\t"
        + "\t".join(map(repr, [*g, *a]))
        for k, (g, a) in enumerate(zip(GYRO.tolist(), ACCEL.tolist(), strict=True))
    ]
    names = ["Time", "Device name", "Chip Time()", *(f"Angular velocity {a}(rad/s)" for a in "XYZ")]
    names += [f"Acceleration {a}(m/s2)" for a in "XYZ"]
    (tmp_path / "a.txt").write_text("\n".join(["\t".join(names), *rows]) + "\n")
    found = read(tmp_path / "a.txt")
    np.testing.assert_allclose(found.values, np.hstack([GYRO, ACCEL]), rtol=1e-9, atol=1e-12)
    assert found.stream.interval_s == pytest.approx(0.01)


@pytest.mark.parametrize("separator", ["\t", ",", ";"])
def test_a_row_of_units_below_the_names_is_read_with_every_separator(tmp_path: Path, separator: str) -> None:
    names = ["S1_Time_CAL", *(f"S1_Gyro_{a}_CAL" for a in "XYZ"), *(f"S1_Accel_{a}_CAL" for a in "XYZ")]
    units = ["ms", *["deg/s"] * 3, *["m/(s^2)"] * 3]
    rows = np.column_stack([1e3 * T, GYRO / DEG, ACCEL]).tolist()
    lines = [f"{separator.join(map(str, row))}{separator}" for row in (names, units, *rows)]
    (tmp_path / "a.csv").write_text("\n".join([f'"sep={separator}"', *lines]) + "\n")
    np.testing.assert_allclose(
        read(tmp_path / "a.csv").values, np.hstack([GYRO, ACCEL]), rtol=1e-9, atol=1e-12
    )


# ---------------------------------------------------------------- sensors by row


def by_row(path: Path, names: tuple[str, str], *, fast: int = 1, columns: str = "sensor,t,x,y,z") -> Path:
    """Write rows of an accelerometer and of a gyroscope that is `fast` times as fast."""
    rows = [(t, names[0], a) for t, a in zip(T.tolist(), ACCEL.tolist(), strict=True)]
    more = np.random.default_rng(8).normal(0.001, 7e-4, (fast * len(T), 3))
    rows += [(T[0] + 0.003 + k * 0.01 / fast, names[1], g) for k, g in enumerate(more.tolist())]
    lines = [f"{name},{t:.6f},{v[0]!r},{v[1]!r},{v[2]!r}" for t, name, v in sorted(rows)]
    path.write_text("\n".join([columns, *lines]) + "\n")
    return path


@pytest.mark.parametrize("names", [("1", "4"), ("Accelerometer", "Gyroscope"), ("a", "b")])
@pytest.mark.parametrize("fast", [1, 4])
@pytest.mark.parametrize("suffix", ["csv", "txt"])
def test_rows_of_several_sensors_are_a_choice_and_each_option_works(
    tmp_path: Path, names: tuple[str, str], fast: int, suffix: str
) -> None:
    path = by_row(tmp_path / f"a.{suffix}", names, fast=fast)
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "several_sensors"
    options = [shlex.split(text) for text in error.value.cure.removeprefix("choose one: ").split(" or ")]
    sensors = {}
    for words in options:
        given = dict(zip(words[::2], words[1::2], strict=True))
        more = {"columns": parse_map(given["--map"])} if "--map" in given else {}
        report, remarks = replayed(path, where=parse_where(given["--where"]), **more)
        sensors[min(report.channels)] = report
        assert "rows are of other sensors" in remarks
    assert sensors["accel/x"].channels["accel/z"].mean == pytest.approx(ACCEL[:, 2].mean())
    assert (sensors["accel/x"].session.samples, sensors["gyro/x"].session.samples) == (len(T), fast * len(T))
    assert sensors["gyro/x"].device.sample_rate_hz == pytest.approx(100.0 * fast)


def test_two_sensors_of_one_kind_are_a_choice(tmp_path: Path) -> None:
    lines = ["t,imu,gx,gy,gz"]
    for k, (t, g) in enumerate(zip(T.tolist(), GYRO.tolist(), strict=True)):
        lines.append(f"{t:.4f},{k % 2},{g[0] + 0.01 * (k % 2)!r},{g[1]!r},{g[2]!r}")
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError) as error:
        replayed(tmp_path / "a.csv")
    assert error.value.cure == "choose one: --where imu=0 or --where imu=1"


@pytest.mark.parametrize("column", ["flag", "battery", "id"])
def test_a_column_by_which_nothing_differs_does_not_divide_the_rows(tmp_path: Path, column: str) -> None:
    rng = np.random.default_rng(2)
    values = (
        rng.integers(0, 3, len(T)) if column != "battery" else np.round(rng.normal(16.5, 0.05, len(T)), 1)
    )
    lines = [f"t,{column},gx,gy,gz"]
    lines += [
        f"{t:.4f},{v},{g[0]!r},{g[1]!r},{g[2]!r}" for t, v, g in zip(T, values, GYRO.tolist(), strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    assert replayed(tmp_path / "a.csv")[0].session.samples == len(T)


def test_a_wrong_choice_of_rows_is_an_error(tmp_path: Path) -> None:
    path = by_row(tmp_path / "a.csv", ("1", "4"))
    for where, code in (("sensor=7", "no_such_rows"), ("sensr=4", "unknown_column")):
        with pytest.raises(RecordingError) as error:
            replayed(path, where=parse_where(where))
        assert error.value.code == code
    assert "COLUMN=VALUE" in imumon("replay", path, "--where", "sensor", code=2)
    np.savez(tmp_path / "a.npz", t=T, gyro=GYRO)
    with pytest.raises(OptionNotApplicable):
        replayed(tmp_path / "a.npz", where={"sensor": "4"})
