"""`imumon.analyse`: one path to a number, whichever way samples come, and no number from what is no record."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import imumon as command
from tables import csv

import imumon
from imumon.model.errors import ImumonError
from imumon.model.ledger import ColumnUse, with_received
from imumon.model.report import RecordingDescription, Report, from_json
from imumon.model.samples import GYRO
from imumon.sources.files.base import ROWS


def _of_rows(ledger: Mapping[str, int]) -> dict[str, int]:
    """Return a ledger without the lines that only a text has: a header is no row of an array."""
    rows = {name: count for name, count in ledger.items() if name not in ("header", "comment", "blank")}
    return with_received(rows)


def _uses(recording: RecordingDescription | None) -> RecordingDescription | None:
    """Return what columns are used for, without their names and their order, which are those of the source."""
    if recording is None:
        return None
    uses = sorted(column.use for column in recording.columns if column.use is not None)
    return RecordingDescription(columns=tuple(ColumnUse(name=use, use=use) for use in uses))


def comparable(report: Report) -> Report:
    """Return a report without what a run, or the name of its source, decides."""
    return replace(
        report,
        time="",
        device=replace(report.device, port=None, source=None, remarks=()),
        session=replace(report.session, received_bytes=0, ledger=_of_rows(report.session.ledger)),
        recording=_uses(report.recording),
        events=tuple(replace(event, time="") for event in report.events),
    )


RATE, N = 200.0, 6.1e-5
SAMPLES = 24_000


def samples(effect: str) -> dict[str, Any]:
    """Return arrays of a sensor at rest with an effect that occurs every day."""
    rng = np.random.default_rng(5)
    gyro = imumon.simulate(SAMPLES, RATE, N=[N] * 3, B=2e-5, seed=1)
    arrays: dict[str, Any] = {"gyro": gyro}
    if effect == "none":
        arrays["accel"] = imumon.simulate(SAMPLES, RATE, N=[1e-3] * 3, bias=[0.0, 0.0, 9.80665], seed=2)
    if effect == "glitches":
        gyro[rng.integers(0, SAMPLES, 20), rng.integers(0, 3, 20)] += 0.1
    elif effect == "knocks":
        for begin in (3_000, 10_000, 20_000):
            gyro[begin : begin + 200] += rng.normal(0.0, 0.02, (200, 3))
    elif effect == "quantised":
        step = 2.3 * N * np.sqrt(RATE)
        arrays["gyro"] = step * np.rint(gyro / step)
    elif effect == "temperature":
        degrees = 25.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES)
        arrays |= {"gyro": gyro + 1e-4 * (degrees - 25.0)[:, None], "temperature": degrees}
    elif effect == "missing":
        gyro[rng.random(SAMPLES) < 0.01, 0] = np.nan
    return arrays


EFFECTS = ("glitches", "knocks", "quantised", "temperature", "missing")


@pytest.mark.few(2)
@pytest.mark.parametrize("effect", EFFECTS)
def test_a_file_its_arrays_and_the_command_give_equal_reports(tmp_path: Path, effect: str) -> None:
    arrays, path = samples(effect), tmp_path / "a.npz"
    units = {"gyro": "rps", "accel": "mps2", "temperature": "degC"}
    stated = {f"{name}_{units[name]}": array for name, array in arrays.items()}
    np.savez(path, **stated)
    of_file = imumon.analyse(path, rate_hz=RATE)
    of_arrays = imumon.analyse(**arrays, rate_hz=RATE)
    masked = {name: np.ma.masked_invalid(array) for name, array in stated.items()}
    of_mapping = imumon.analyse(masked, rate_hz=RATE)
    printed = from_json(Report, command("replay", path, "--rate", "200", "--json"))
    assert comparable(of_arrays.report) == comparable(of_file.report)
    assert comparable(of_mapping.report) == comparable(of_file.report)
    assert comparable(printed) == comparable(of_file.report)
    x = of_file["gyro/x"].N
    if effect == "quantised":
        assert (x.status, x.value) == ("pending", None)
        assert x.reason
    else:
        low, high = x.interval
        assert 0.98 * low < N < 1.02 * high


def test_a_table_with_time_is_the_same_as_text_and_as_a_frame(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    arrays = {name: array[:6000] for name, array in samples("none").items()}
    t = 5.0 + np.arange(6000) / RATE
    kept = np.random.default_rng(1).random(6000) > 0.02  # the others are lost
    names = [
        "t [s]",
        *(f"gyro_{axis} [rad/s]" for axis in "xyz"),
        *(f"accel_{axis} [m/s2]" for axis in "xyz"),
    ]
    path = csv(tmp_path / "a.csv", names, t[kept], arrays["gyro"][kept], arrays["accel"][kept])
    frame = pandas.read_csv(path)
    of_file = comparable(imumon.analyse(str(path)).report)
    assert of_file.session.missing == np.count_nonzero(~kept)
    assert comparable(imumon.analyse(frame).report) == of_file
    assert comparable(imumon.analyse(frame.convert_dtypes()).report) == of_file
    assert comparable(imumon.analyse(frame.set_index("t [s]")).report) == of_file
    columns = {name: frame[name].to_numpy() for name in frame}
    by_sensor = {
        s: np.column_stack([v for k, v in columns.items() if k.startswith(s)]) for s in ("gyro", "accel")
    }
    # the file states its units
    units = {"gyro": "rad/s", "accel": "m/s2"}
    of_arrays = imumon.analyse(**by_sensor, time_s=columns["t [s]"], units=units)
    assert comparable(of_arrays.report) == of_file


def test_importing_loads_no_numbers_and_threads_stay_those_of_the_caller() -> None:
    code = """
import sys
import imumon
assert not {"numpy", "scipy", "pandas", "matplotlib"} & set(sys.modules), "loaded"
import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits
with threadpool_limits(2, user_api="blas"):
    before = {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}
    imumon.analyse(np.random.default_rng(1).normal(0.0, 1e-3, (900, 3)), rate_hz=100.0)
    after = {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}
    assert before.items() <= after.items(), (before, after)
assert not {"pandas", "xarray", "matplotlib"} & set(sys.modules), "loaded by analyse"
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# ---------- `imumon.Live`: blocks of any size give the report of all samples, also after results in between


LIVE_RATE = 200.0
CHANNELS = ("gyro/x", "gyro/y", "gyro/z", "temperature")


@pytest.fixture(scope="module")
def live_rows() -> np.ndarray:
    """Return (n, 4) samples with a knock and missing values, longer than two blocks that are read at once."""
    rng = np.random.default_rng(3)
    gyro = imumon.simulate(40_000, LIVE_RATE, N=[6.1e-5] * 3, B=2.4e-5, seed=2)
    gyro[12_000:12_200] += rng.normal(0.0, 0.05, (200, 3))
    gyro[rng.random(len(gyro)) < 0.001, 1] = np.nan
    return np.column_stack([gyro, 25.0 + 1e-5 * np.arange(len(gyro))])


@pytest.fixture(scope="module")
def timed(live_rows: np.ndarray) -> tuple[np.ndarray, Any]:
    """Return the times of the live_rows, with a gap, and the report of all live_rows."""
    t = 3.0 + np.arange(len(live_rows)) / LIVE_RATE
    t[30_000:] += 2.0
    return t, comparable(imumon.analyse(gyro=live_rows[:, :3], temperature=live_rows[:, 3], time_s=t).report)


@pytest.mark.few
@pytest.mark.parametrize("size", [97, 25_000])
def test_blocks_of_any_size_give_the_report_of_all_samples(
    live_rows: np.ndarray, timed: tuple[np.ndarray, Any], size: int
) -> None:
    t, expected = timed
    live = imumon.Live(channels=CHANNELS)
    for first in range(0, len(live_rows), size):
        live.update(live_rows[first : first + size], time_s=t[first : first + size])
        if first == 200 * 97:
            live.result()
    assert comparable(live.result().report) == expected
    assert comparable(live.result().report) == expected, "a result changes nothing"


def test_stamps_that_are_equal_to_a_rate_are_that_rate(tmp_path: Path) -> None:
    """The same samples, with a rate or with its times, state the same limits through every door."""
    gyro, t = imumon.simulate(6000, LIVE_RATE, N=[6.1e-5] * 3, seed=4), np.arange(6000) / LIVE_RATE
    gyro = gyro.round(12)  # as the text has it
    names = [f"gyro_{axis} [rad/s]" for axis in "xyz"]
    stamped = csv(tmp_path / "a.csv", ["t [s]", *names], t, gyro)
    plain = csv(tmp_path / "b.csv", names, gyro)
    of_rate, of_times = imumon.Live(rate_hz=LIVE_RATE), imumon.Live()
    of_rate.update(gyro)
    of_times.update(gyro, time_s=t)
    reports = [
        imumon.analyse(gyro, rate_hz=LIVE_RATE).report,
        imumon.analyse(gyro=gyro, time_s=t).report,
        of_rate.result().report,
        of_times.result().report,
        from_json(Report, command("replay", stamped, "--json")),
        from_json(Report, command("replay", plain, "--rate", "200", "--json")),
    ]
    first, *others = (
        [[part.low, part.high, *part.interval] for part in report.channels["gyro/x"].coefficients.values()]
        for report in reports
    )
    for other in others:  # blocks of another size are added in another order
        np.testing.assert_allclose(other, first, rtol=1e-9)


@pytest.mark.parametrize("count", [40, 5 * ROWS + 7])
def test_missing_samples_are_rows_without_numbers_a_mask_or_a_number(count: int) -> None:
    gyro = imumon.simulate(2000, LIVE_RATE, N=[6.1e-5] * 3, seed=2)
    holes, hidden = np.full((count, 3), np.nan), np.ones(count, dtype=bool)
    reports = []
    for missing, options in (
        (holes, {}),
        (np.zeros((count, 3)), {"missing": hidden}),
        (None, {"missing": count}),
    ):
        live = imumon.Live(rate_hz=LIVE_RATE)
        live.update(gyro[:1000])
        if missing is not None:
            live.update(missing, **options)
        live.update(gyro[1000:], **(options if missing is None else {}))
        reports.append(comparable(live.result().report))
    assert reports[0] == reports[1] == reports[2]


def test_a_number_of_missing_samples_is_arithmetic() -> None:
    """It costs no memory, and a gap of more than a month has no known length."""
    gyro, live = imumon.simulate(2000, LIVE_RATE, N=[6.1e-5] * 3, seed=2), imumon.Live(rate_hz=LIVE_RATE)
    live.update(gyro[:1000])
    tracemalloc.start()
    live.update(gyro[1000:], missing=10**18)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    session = live.result().report.session
    assert (session.samples, session.missing, session.restarts) == (2000, 0, 1)


def analysis(**given: Any) -> Callable[[], object]:
    return lambda: imumon.analyse(**given)


def growing(
    block: np.ndarray | None = None, *, channels: Any = GYRO, rate_hz: float | None = 10.0, **more: Any
) -> Callable[[], object]:
    def update() -> None:
        live = imumon.Live(rate_hz, channels=channels)
        live.update(block, **more)
        live.result()

    return update


ONES = np.ones((900, 3))


@pytest.mark.parametrize(
    ("act", "code"),
    [
        (analysis(gyro=np.zeros((3, 900)), rate_hz=RATE), "array_transposed"),
        (analysis(gyro=np.zeros((900, 6)), rate_hz=RATE), "array_shape"),
        (analysis(gyro=np.zeros((0, 3)), rate_hz=RATE), "no_rows"),
        (analysis(source={"gyro": np.zeros((0, 3))}, rate_hz=RATE), "no_rows"),
        (analysis(gyro=1e-3 * ONES, rate_hz=RATE), "all_constant"),
        (analysis(gyro=np.nan * ONES, rate_hz=RATE), "no_complete_row"),
        (analysis(gyro=ONES, accel=ONES[:800], rate_hz=RATE), "array_lengths"),
        (analysis(gyro=ONES, time_s=ONES[:, :2]), "array_shape"),
        (analysis(gyro=ONES, time_s=np.r_[0.0:450.0, 100.0:550.0]), "time_goes_back"),
        (analysis(accel=ONES * [0.0, 0.0, 1.0], rate_hz=RATE), "wrong_unit"),
        (analysis(gyro=ONES, units={"gyros": "deg/s"}, rate_hz=RATE), "units_of_unknown"),
        (analysis(gyro=ONES, kind="samples", rate_hz=RATE), "kind_unknown"),
        (
            analysis(
                source={"delta_theta": np.random.default_rng(0).normal(size=(90, 3))},
                kind="point",
                rate_hz=RATE,
            ),
            "kind_contradicts",
        ),
        (analysis(rate_hz=RATE), "no_source"),
        (analysis(source="a.csv", gyro=ONES), "two_sources"),
        (analysis(source="no_such_file.csv"), "not_readable"),
        (analysis(gyro=ONES, filter="strong", rate_hz=RATE), "filter_invalid"),
        (analysis(gyro=ONES, stream="best", rate_hz=RATE), "stream_invalid"),
        (analysis(gyro=ONES, precision={"X": 0.1}, rate_hz=RATE), "precision_invalid"),
        (growing(channels=("gyro/x", "gyro/w")), "channels_invalid"),
        (growing(np.zeros((5, 2)), channels=("gyro/x", "gyro/y")), "map_incomplete"),
        (growing(np.zeros((5, 3)), rate_hz=None), "rate_required"),
        (growing(rate_hz=0.0), "rate_invalid"),
        (growing(np.zeros((5, 2))), "array_shape"),
        (growing(np.full((5, 3), "a")), "array_type"),
        (growing(np.zeros((5, 3)), missing=np.zeros(4, bool)), "missing_invalid"),
        (growing(np.zeros((5, 3)), rate_hz=None, time_s=np.zeros(4)), "array_shape"),
        (growing(np.zeros((0, 3))), "no_rows"),
        (growing(np.zeros((50, 3))), "all_constant"),
    ],
)
def test_bad_input_is_an_error_with_a_cure_and_never_a_number(act: Callable[[], object], code: str) -> None:
    with pytest.raises(ImumonError) as error:
        act()
    assert (error.value.code, bool(error.value.cure)) == (code, True)
    assert "--" not in str(error.value)


def test_a_saved_record_continues_where_it_was(
    tmp_path: Path, live_rows: np.ndarray, timed: tuple[Any, Any]
) -> None:
    t, expected = timed
    live = imumon.Live(channels=CHANNELS)
    live.update(live_rows[:20_000], time_s=t[:20_000])
    live.save(tmp_path / "a.live")
    saved = imumon.Live.load(tmp_path / "a.live")
    n = live.result()["gyro/x"].N
    saved.update(live_rows[20_000:], time_s=t[20_000:])
    report = saved.result().report
    for field in ("samples", "missing", "disturbances", "elapsed_s", "restarts"):
        assert getattr(report.session, field) == getattr(expected.session, field), field
    n, whole = report.channels["gyro/x"].N, expected.channels["gyro/x"].N
    assert n.value == pytest.approx(
        whole.value, rel=2e-3
    )  # segments of the spectrum in progress are not saved
    (tmp_path / "b.live").write_bytes(b"nothing")
    for path, code in ((tmp_path / "b.live", "state_invalid"), (tmp_path / "c.live", "file_unreadable")):
        with pytest.raises(ImumonError) as error:
            imumon.Live.load(path)
        assert error.value.code == code
    with pytest.raises(ImumonError) as error:
        imumon.Live(rate_hz=10.0).save(tmp_path / "d.live")
    assert error.value.code == "no_rows"
