"""Documents of a report: complete, correct and usable for every report."""

from __future__ import annotations

import csv
import io
import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from daemons import Daemon
from reports import LENGTH_S, LONG_RATE, LONG_S, RATE, nothing_yet, report

from imumon.datasheet import FORMS, NoCurve, document
from imumon.datasheet.blocks import DataTable
from imumon.datasheet.config_snippets import ros, worst_axis
from imumon.datasheet.content import datasheet_content
from imumon.datasheet.figures import svg
from imumon.datasheet.signal_text import baseline_summary, signal_lines
from imumon.datasheet.tables import report_table
from imumon.messages import CAVEATS, uncertainty
from imumon.noise.synthesis import synthesise
from imumon.pipeline.report_builder import effective_samples
from imumon.report import Allan, Coefficient, Readable, Report, from_json, to_json
from imumon.tui.formatting import Notation
from imumon.units import READABLE

AGES = {"nothing": 0.0, "seconds": 3.0, "minutes": 200.0, "hours": LENGTH_S, "long": LONG_S}


def aged(name: str) -> Report:
    return nothing_yet() if name == "nothing" else report(AGES[name])


def text(made: Report, form: str) -> str:
    return document(made, form).decode()


@pytest.mark.parametrize("age", AGES)
@pytest.mark.parametrize("form", [form for form in FORMS if form != "png"])
def test_every_document_of_every_age_is_made(form: str, age: str) -> None:
    made = text(aged(age), form)
    assert made.endswith("\n")
    assert not re.search(r"\bnan\b|\binf\b|\bNone\b", made), "unknown is said in words"


@pytest.mark.parametrize("age", ["minutes", "hours"])
def test_picture_is_a_png(age: str) -> None:
    assert document(aged(age), "png").startswith(b"\x89PNG\r\n\x1a\n")


def test_there_is_no_picture_without_a_curve() -> None:
    with pytest.raises(NoCurve) as caught:
        document(nothing_yet(), "png")
    assert caught.value.code == "no_curve"


@pytest.mark.parametrize("form", ["md", "html"])
def test_published_values_are_those_of_the_device(form: str) -> None:
    """Values of the VN-100 are shown for a VN-100 only; older reports do not name their driver."""

    def shown(**known: object) -> bool:
        made = report()
        return "manufacturer" in text(replace(made, device=replace(made.device, **known)), form)  # type: ignore[arg-type]

    assert shown()
    assert shown(driver=None)
    assert shown(driver=None, id="bench", model="VN-100S-CR")
    assert not shown(driver=None, id="replay", model=None)
    assert not shown(model="VN-200")
    assert not shown(driver="ros2", id="ros2-imu-data", model=None)


# ---------------------------------------------------------------- settings to paste


def settings(made: Report, form: str) -> dict[str, float]:
    """Lines ``name: number`` that are not commented out."""
    found = re.findall(r"^\s*(\w+): ([-+.\de]+)(?:  # .*)?$", text(made, form), re.MULTILINE)
    return {name: float(value) for name, value in found}


@pytest.mark.parametrize("form", ["kalibr", "openvins"])
def test_densities_are_those_of_the_worst_axis(form: str) -> None:
    made = report(LONG_S)
    found = settings(made, form)
    for sensor, name in (("gyro", "gyroscope"), ("accel", "accelerometer")):
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            parts = [getattr(made.channels[f"{sensor}/{axis}"], letter) for axis in "xyz"]
            assert all(part.status == "measured" for part in parts)
            expected = max(part.value for part in parts)
            assert found[f"{name}_{key}"] == pytest.approx(expected, rel=1e-6)
    assert found["update_rate"] == LONG_RATE


def test_what_is_not_seen_is_its_bound_and_says_so() -> None:
    made = report(400.0)
    bounded = [made.channels[f"gyro/{axis}"].K for axis in "xyz"]
    assert {part.status for part in bounded if part} == {"upper_bound"}
    assert settings(made, "kalibr")["gyroscope_random_walk"] == pytest.approx(
        max(part.high or 0.0 for part in bounded if part), rel=1e-6
    )
    bound = "95 % upper bound, not seen in this record"
    for form, line in (
        ("kalibr", "gyroscope_random_walk: "),
        ("openvins", "gyroscope_random_walk: "),
        ("px4", "param set EKF2_GYR_B_NOISE "),
        (
            "ardupilot",
            "# EK3_GBIAS_P_NSE in ",
        ),  # on the line above: a comment behind a value would be read as a part of it
        ("gtsam", "params.setBiasOmegaCovariance("),
    ):
        assert re.search(rf"^ *{re.escape(line)}.*  # {bound}$", text(made, form), re.MULTILINE)
        assert bound not in text(report(LONG_S), form)


@pytest.mark.parametrize("age", ["nothing", "seconds"])
def test_what_is_not_known_is_never_a_number(age: str) -> None:
    made = aged(age)
    for sensor in ("gyro", "accel"):
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            name = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor] + f"_{key}"
            assert (name in settings(made, "kalibr")) == (worst_axis(made, sensor, letter).value is not None)
            if worst_axis(made, sensor, letter).value is None:
                assert f"# {name}: ?" in text(made, "kalibr")


def with_k(made: Report, code: str | None, *, gyro: bool) -> Report:
    """The same with gyroscopes whose K is not known for the reason of this code, or without gyroscopes."""
    some = {n: c for n, c in made.channels.items() if not n.startswith("gyro") or gyro}
    none = Readable(value=None, low=None, high=None, unit="")
    lacking = Coefficient(
        value=None, low=None, high=None, status="pending", unit="", readable=none, reason_code=code
    )
    changed = {n: replace(c, K=lacking) if n.startswith("gyro") else c for n, c in some.items()}
    return replace(made, channels=changed)


@pytest.mark.parametrize(
    ("code", "gyro", "cure"),
    [
        (None, True, "record longer"),
        ("constant", True, "dead or stuck"),
        ("resolution", True, "more digits"),
        (None, False, "holds no gyroscope"),
    ],
)
def test_a_longer_record_is_advised_only_where_it_helps(code: str | None, gyro: bool, cure: str) -> None:
    for form in ("kalibr", "px4", "ardupilot", "gtsam", "openvins"):
        said = text(with_k(report(10801.0), code, gyro=gyro), form)
        assert cure in said
        assert ("record longer" in said) == (cure == "record longer")


@pytest.mark.parametrize("word", sorted({*CAVEATS} - {"aliased"}))
def test_caveats_come_before_the_numbers(word: str) -> None:
    made = report()
    one = {"gyro/x": replace(made.channels["gyro/x"], caveats=(word,))}
    for form in ("kalibr", "ros", "px4", "ardupilot", "gtsam", "openvins"):
        assert f"WARNING: {word.replace('_', ' ')}: " in text(replace(made, caveats=(word,)), form)
        said = text(replace(made, channels=made.channels | one), form)
        assert f"WARNING: {word.replace('_', ' ')} (gyro x" in said


@pytest.mark.parametrize("form", ["kalibr", "openvins"])
def test_an_unknown_rate_is_no_number(form: str) -> None:
    made = report()
    made = replace(made, device=replace(made.device, sample_rate_hz=None))
    assert "update_rate" not in settings(made, form)
    assert "# update_rate: ?" in text(made, form)


def test_ros_covariance_is_the_variance_of_a_sample() -> None:
    made = report()
    for field, sensor in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        row = re.search(rf"^{field}_covariance: \[(.*)\]", text(made, "ros"), re.MULTILINE)
        assert row
        matrix = np.array([float(v) for v in row[1].split(",")]).reshape(3, 3)
        n = [made.channels[f"{sensor}/{axis}"].N for axis in "xyz"]
        np.testing.assert_allclose(np.diag(matrix), [(p.value or 0) ** 2 * RATE for p in n if p], rtol=1e-4)
        assert np.count_nonzero(matrix) == 3


def test_ros_covariance_of_a_sensor_that_never_changes_is_unknown() -> None:
    made = report()
    dead = {
        name: replace(made.channels[name], N=None, std=0.0) for name in made.channels if name[:4] == "gyro"
    }
    lines = ros(replace(made, channels=made.channels | dead)).splitlines()
    assert "# angular_velocity_covariance: all zeros, which means unknown" in lines
    assert not any(line.startswith("angular_velocity_covariance") for line in lines)


@pytest.mark.parametrize(
    ("form", "line", "step_s", "names"),
    [
        (
            "px4",
            r"^param set (\w+) (\S+)$",
            0.010,
            ("EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE", "EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE"),
        ),
        (
            "ardupilot",
            r"^(EK3_\w+),(\S+)$",
            0.012,
            ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", "EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE"),
        ),
    ],
)
def test_a_filter_that_adds_its_noise_in_every_step_grows_as_the_sensor_does(
    form: str, line: str, step_s: float, names: tuple[str, ...]
) -> None:
    """Both add (s dt)^2 in a step of dt, to angle or velocity and to the bias: N^2 or K^2 a second."""
    made = report(LONG_S)
    found = dict(re.findall(line, text(made, form), re.MULTILINE))
    parts = [(sensor, letter) for sensor in ("gyro", "accel") for letter in "NK"]
    for name, (sensor, letter) in zip(names, parts, strict=True):
        grown = sum((float(found[name]) * step_s) ** 2 for _ in range(round(12.0 / step_s)))
        expected = worst_axis(made, sensor, letter).value or 0.0
        assert grown == pytest.approx(12.0 * expected**2, rel=1e-3)


def test_openvins_gets_every_matrix_it_asks_for() -> None:
    shown = text(report(), "openvins")
    for name, size, diagonal in (
        ("T_i_b", 4, 1.0),
        *((name, 3, 1.0) for name in ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC")),
        ("Tg", 3, 0.0),
    ):
        rows = re.search(rf"^  {name}:\n((?:    - \[.*\]\n)+)", shown, re.MULTILINE)
        assert rows
        matrix = np.array([[float(v) for v in row.split(",")] for row in re.findall(r"\[(.*)\]", rows[1])])
        np.testing.assert_array_equal(matrix, diagonal * np.eye(size))


@pytest.mark.parametrize("age", AGES)
def test_gtsam_is_python_and_leaves_no_covariance_of_one(age: str) -> None:
    code = text(aged(age), "gtsam")
    compile(code, "gtsam", "exec")
    assert "params.setIntegrationCovariance(" in code


@pytest.mark.parametrize("form", ["kalibr", "ros", "px4", "ardupilot", "gtsam", "openvins", "md", "html"])
def test_no_document_hides_what_is_wrong_with_the_stream(form: str) -> None:
    made = report()
    made = replace(made, caveats=("aliased", "compensated"))
    shown = text(made, form).lower()
    assert "aliased" in shown
    assert "3.16" in shown
    assert "compensated" in shown


# ---------------------------------------------------------------- the sheet and its forms


@pytest.mark.parametrize("age", AGES)
def test_tables_have_a_cell_for_each_column(age: str) -> None:
    made = aged(age)
    for block in datasheet_content(made).blocks:
        if isinstance(block, DataTable):
            assert {len(row) for row in block.rows} <= {len(block.head)}
    lines = text(made, "md").splitlines()
    for k, line in enumerate(lines):
        if line.startswith("|--"):
            width = len(re.findall(r"(?<!\\)\|", line))
            for row in (lines[k - 1], *lines[k + 1 : k + 4]):
                if row.startswith("|"):
                    assert len(re.findall(r"(?<!\\)\|", row)) == width


class Balance(HTMLParser):
    """Open elements, and everything that a browser would have to fetch."""

    VOID = ("meta", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        links = [str(v) for k, v in attrs if k in ("src", "href")]
        self.fetched += [v for v in links if not v.startswith("#")] + ([tag] if tag == "script" else [])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("age", AGES)
def test_page_is_whole_and_fetches_nothing(age: str) -> None:
    page = text(aged(age), "html")
    parser = Balance()
    parser.feed(page)
    assert parser.open == []
    assert parser.fetched == []
    assert "url(#" in page or age in ("nothing", "seconds")
    assert not re.search(r"url\((?!#)|@import|https?:", page)


def test_page_is_safe_with_any_name() -> None:
    made = report(200.0)
    made = replace(made, device=replace(made.device, model="<script>alert(1)</script>", serial='"&|`*'))
    assert "<script" not in text(made, "html")
    assert "alert(1)" in text(made, "html")


@pytest.mark.parametrize("sensor", ["gyro", "accel", "mag"])
@pytest.mark.parametrize("age", ["minutes", "hours", "long"])
def test_every_point_of_a_curve_is_drawn_within_the_frame(sensor: str, age: str) -> None:
    made = aged(age)
    root = ET.fromstring(svg(made, sensor))
    width, height = (float(v) for v in (root.get("viewBox") or "").split()[2:])
    for axis in "xyz":
        allan = made.channels[f"{sensor}/{axis}"].allan
        assert allan is not None
        styled = ((use, use.get("style") or "") for use in root.iter("use"))
        marks = [use for use, style in styled if f"stroke: var(--{axis})" in style]
        assert len(marks) == len(allan.tau_s) + 1  # one in the legend
        for mark in marks:
            assert 0.0 <= float(mark.get("x") or -1) <= width
            assert 0.0 <= float(mark.get("y") or -1) <= height


def test_a_figure_is_the_same_every_time() -> None:
    assert svg(report(), "gyro") == svg(report(), "gyro")


def test_csv_holds_every_point_and_coefficient() -> None:
    made = report()
    rows = list(csv.reader(io.StringIO(text(made, "csv"))))
    empty = rows.index([])
    points = sum(len(c.allan.tau_s) for c in made.channels.values() if c.allan)
    assert empty - 1 == points
    assert len(rows) - empty - 2 == 3 * sum(1 for c in made.channels.values() if c.N)
    assert float(rows[1][3]) == made.channels["gyro/x"].allan.sigma[0]  # type: ignore[union-attr]


def test_json_is_the_report_itself() -> None:
    made = report()
    assert from_json(Report, text(made, "json")) == made


# ---------------------------------------------------------------- on the command line


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten minutes at rest as CSV, with a known N."""
    path = tmp_path_factory.mktemp("recording") / "rest.csv"
    noise = synthesise(24_000, 40.0, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    noise[:, 5] -= 9.8
    np.savetxt(
        path,
        np.column_stack([np.arange(24_000) / 40.0, noise]),
        delimiter=",",
        header="t [s],wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]",
        comments="",
        fmt="%.9g",
    )
    return path


def test_recording_to_report_to_datasheet_and_baseline(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.json"
    assert imumon("report", recording, "-o", saved) == ""
    made = from_json(Report, saved.read_text())
    n = made.channels["gyro/x"].N
    assert n is not None
    assert (n.low or 0.0) < 6e-5 < (n.high or 0.0)
    page = tmp_path / "sheet.html"
    imumon("report", saved, "-o", page)
    assert "rest.csv" in page.read_text()
    assert imumon("report", saved, "--format", "kalibr") == text(made, "kalibr")
    again = json.loads(imumon("replay", recording, "--json", "--baseline", saved))
    assert again["channels"]["gyro/x"]["changes"] == []
    printed = imumon("replay", recording, "--baseline", saved)
    assert printed.endswith("\nnothing changed against the baseline\n")
    half = replace(n, value=6e-5 / 2, low=2.9e-5, high=3.1e-5)
    before = replace(made, channels=made.channels | {"gyro/x": replace(made.channels["gyro/x"], N=half)})
    saved.write_text(to_json(before))
    printed = imumon("replay", recording, "--baseline", saved)
    now = float(re.search(r"^gyro/x: N was 0.103, is (\S+) °/√h \(against the baseline\)$", printed, re.M)[1])  # type: ignore[index]
    assert now == pytest.approx(READABLE["gyro", "N"].factor * (n.value or 0.0), rel=0.01)
    assert "nothing changed" not in printed


def test_what_could_not_be_compared_is_not_called_baseline_summary() -> None:
    assert "nothing to compare" in str(baseline_summary(report(), nothing_yet()))
    assert baseline_summary(report(), report()) == "nothing changed against the baseline"


def test_a_slope_over_temperature_is_told_only_beyond_noise() -> None:
    made = report()
    channel = made.channels["gyro/x"]
    assert channel.drift is not None
    assert channel.drift.per_degC is not None
    assert not any("per degree" in line for line in signal_lines(made))
    for form in ("md", "html"):
        assert f"{channel.drift.per_degC:.2e}" not in text(made, form)
    beyond = replace(channel, drift=replace(channel.drift, steady_N=channel.N))
    shown = signal_lines(replace(made, channels={"gyro/x": beyond}))
    assert any("gyro/x: follows the temperature by" in line for line in shown)


def test_running_daemon_and_its_saved_state(tmp_path: Path) -> None:
    with Daemon("sim", tmp_path, "--speed", "20", "--seed", "3") as daemon:
        live = daemon.samples(3000)
        shown = imumon("report", "--connect", daemon.endpoint, "--format", "md")
        assert live.device.serial is not None
        assert live.device.serial in shown
        code, _, _ = daemon.stop()
        assert code == 0
    (state,) = tmp_path.glob("*.state")
    made = from_json(Report, imumon("report", state, "--format", "json"))
    assert made.session.samples >= 3000
    assert made.device.model == live.device.model
    assert made.device.stream == "deltas"
    assert made.channels["gyro/x"].N is not None
    assert made.channels["gyro/x"].N.status == "measured"
    data = state.read_bytes()
    state.write_bytes(data[:-100])
    assert "damaged" in imumon("report", state, code=1)


def test_a_model_name_is_no_tag() -> None:
    made = report(200.0)
    made = replace(made, device=replace(made.device, model="<script>alert(1)</script>"))
    assert "<script>" not in document(made, "html").decode()
    outside_code = document(made, "md").decode().split("```")[0::2]
    assert "<script>" not in "".join(outside_code).replace("\\<", "")


def test_mistakes_are_one_line(tmp_path: Path, recording: Path) -> None:
    assert "no daemon answers" in imumon("report", "--connect", "tcp/127.0.0.1:1", code=3)
    assert "nowhere" in imumon("report", tmp_path / "nowhere", code=1)
    broken = tmp_path / "broken.json"
    broken.write_text('{"schema": 3')
    assert "broken.json" in imumon("report", broken, code=1)
    imumon("report", recording, "--format", "docx", code=2)
    imumon("report", recording, "--id", "x", code=2)
    assert "cannot write" in imumon("report", recording, "-o", tmp_path / "no" / "a.md", code=1)


def test_a_document_never_takes_the_place_of_what_it_is_made_of(recording: Path, tmp_path: Path) -> None:
    own, bag = tmp_path / "own.csv", tmp_path / "bag"
    own.write_bytes(recording.read_bytes())
    bag.mkdir()
    (tmp_path / "linked.csv").symlink_to(own)
    (tmp_path / "same.csv").hardlink_to(own)
    (bag / "part.db3").write_bytes(b"part")
    for read, out in (
        (own, own),
        (own, tmp_path / "linked.csv"),
        (tmp_path / "linked.csv", own),
        (own, tmp_path / "same.csv"),
        (bag, bag / "part.db3"),
    ):
        assert "name another file" in imumon("report", read, "--format", "md", "-o", out, code=2)
    assert own.read_bytes() == recording.read_bytes()
    assert (bag / "part.db3").read_bytes() == b"part"


def test_the_name_of_the_output_tells_the_form_or_is_refused(recording: Path, tmp_path: Path) -> None:
    said = imumon("report", recording, "-o", tmp_path / "x.foo", code=2)
    assert "unknown format foo" in said
    assert "markdown" not in said
    assert all(form in said for form in FORMS)
    assert not (tmp_path / "x.foo").exists()
    imumon("report", recording, "-o", tmp_path / "x.foo", "--format", "csv")
    assert (tmp_path / "x.foo").read_text().startswith("channel,")
    imumon("report", recording, "-o", tmp_path / "plain")
    assert (tmp_path / "plain").read_text().startswith("# ")


def test_nothing_is_lost_between_report_and_json() -> None:
    assert json.loads(to_json(report(200.0)))["schema"] == "imumon.report/1"


@pytest.mark.parametrize("age", AGES)
@pytest.mark.parametrize("width", [80, 95, 100, 134])
def test_the_table_fits_the_terminal_and_cuts_nothing(age: str, width: int) -> None:
    """Narrower: uncertainties in percent instead of limits; into a pipe goes everything."""
    made = aged(age)
    lines = report_table(made, width).splitlines()
    rows = lines[lines.index("") : len(lines) - lines[::-1].index("")]
    assert max((len(line) for line in rows), default=0) <= width
    assert "…" not in "".join(lines)
    assert report_table(made) == report_table(made, 134)


def test_the_table_says_what_its_caveats_mean_and_counts_in_the_singular() -> None:
    said = report_table(replace(report(), caveats=("aliased",)))
    assert "caveat aliased: the sensor's own filter folds noise" in said
    assert "caveat vibration (accel y): something vibrates" in said
    assert "1 disturbance," in said


@pytest.mark.parametrize(
    "form", ["text", "kalibr", "ros", "px4", "ardupilot", "gtsam", "openvins", "md", "html"]
)
def test_every_form_warns_of_an_unknown_filter(form: str) -> None:
    """Of a stream that was only listened to, N is too high by a factor that depends on its rate."""
    made = report(200.0)

    def shown(**known: object) -> str:
        changed = replace(made, caveats=(), device=replace(made.device, **known))  # type: ignore[arg-type]
        return report_table(changed) if form == "text" else text(changed, form)

    heard = shown(alias_factor=None, stream="compensated", sample_rate_hz=40.0)
    assert "filter not known" in heard
    assert "here 2.24" in heard
    assert "filter not known" not in shown(alias_factor=1.0, stream="compensated", sample_rate_hz=40.0)
    assert "filter not known" not in shown(alias_factor=None, stream="deltas", sample_rate_hz=40.0)


def test_excluded_seconds_add_up() -> None:
    """Seconds of the magnetometer alone are no part of those that are excluded from all channels."""
    made = report()

    def line(seconds: float, **by: float) -> str:
        session = replace(made.session, disturbances=1, excluded_s=seconds, excluded_by=by)
        return report_table(replace(made, session=session)).splitlines()[2]

    assert line(0.0, magnetic=6.5) == "1 disturbance, 6.5 s of the magnetometer alone excluded"
    assert line(5.0, knock=5.0) == "1 disturbance, 5.0 s (knock 5.0 s) excluded"
    both = "1 disturbance, 5.0 s (knock 5.0 s) and 6.5 s of the magnetometer alone excluded"
    assert line(5.0, knock=5.0, magnetic=6.5) == both


def test_axes_move_together_only_where_chance_does_not_explain_it() -> None:
    """A few samples, or two random walks, correlate by chance; each pair is named once."""

    def lines(independent: float | None) -> list[str]:
        made = report(200.0)
        channels = dict(made.channels)
        for name, other in (("gyro/x", "gyro/y"), ("gyro/y", "gyro/x")):
            shape = channels[name].distribution
            assert shape is not None
            shape = replace(shape, correlation={other: 0.76}, effective_samples=independent)
            channels[name] = replace(channels[name], distribution=shape)
        shown = signal_lines(replace(made, channels=channels))
        return [line for line in shown if line.startswith("gyro") and "moves together" in line]

    for independent in (None, 4.0, 40.0):
        assert lines(independent) == []
    assert lines(400.0) == ["gyro/x: moves together with gyro/y (+0.76)"]


def test_effective_samples_are_the_count_of_white_noise_and_few_of_a_walk() -> None:
    tau = tuple(2.0**k for k in range(10))
    white = Allan(tau_s=tau, sigma=tuple(t**-0.5 for t in tau))
    walk = Allan(tau_s=tau, sigma=tuple(t**0.5 for t in tau))
    assert effective_samples(white, 1.0, 1024) == pytest.approx(1024.0)
    assert (effective_samples(walk, 20.0, 1024) or 0.0) < 3.0
    assert effective_samples(None, 1.0, 1024) is None
    assert effective_samples(white, None, 1024) is None


def test_both_tables_name_their_units() -> None:
    heads = [line for line in signal_lines(report(200.0)) if "drift per hour" in line]
    assert [head.split("  ")[0] for head in heads] == ["in rad/s", "in m/s²", "in gauss", "in °C", "in kPa"]


def test_wide_limits_are_a_factor_as_they_are_skewed() -> None:
    made = report()
    k = replace(made.channels["gyro/x"].K, status="measured", value=1.0)  # type: ignore[type-var]
    k = replace(k, readable=Readable(value=3.5, low=1.0, high=9.0, unit="deg/h/sqrt(h)"))
    shown = report_table(replace(made, channels={"gyro/x": replace(made.channels["gyro/x"], K=k)}), 100)
    assert "3.5 ×÷3.0" in shown
    assert uncertainty() in shown
    assert Notation(ascii=True).coefficient(k, None) == ("3.5 x/3.0", "text")
