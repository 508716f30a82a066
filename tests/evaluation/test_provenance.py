"""Where a number comes from: program, input, options, excluded intervals, date, item and operator."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import forked
import numpy as np
import pytest
from evaluations import imumon, make_report, replayed, shown

from imumon.api.traceability import with_provenance
from imumon.datasheet.evidence import excluding_events
from imumon.report import Event, Report, from_json


def test_a_report_names_program_input_and_options(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.json"
    imumon("report", recording, "--no-guards", "--stream", "uncompensated", "-o", saved)
    made = from_json(Report, saved.read_text()).evaluation
    origin = made.provenance
    assert origin.software.startswith("imumon ")
    assert origin.commit
    assert (origin.input, origin.input_bytes) == ("rest.csv", recording.stat().st_size)
    assert origin.input_sha256 == hashlib.sha256(recording.read_bytes()).hexdigest()
    assert origin.options == {"--stream": "uncompensated", "--no-guards": ""}
    assert origin.guards is False
    page = imumon(
        "report", saved, "--format", "md"
    )  # from the saved report: the origin stays that of the numbers
    for text in (origin.input_sha256, origin.commit, "imumon.report/1", "--no-guards", origin.host or "-"):
        assert text in page


def test_standard_input_has_no_digest(recording: Path) -> None:
    done = forked.run("replay", "-", "--json", text=recording.read_bytes())
    origin = json.loads(done.stdout)["evaluation"]["provenance"]
    assert (origin["input_sha256"], origin["input_reason"]) == (None, "read from standard input")


def test_the_digest_of_a_directory_is_of_all_its_files(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for name, data in (("b.db3", b"two"), ("a.yaml", b"one")):
        (bag / name).write_bytes(data)
    made = with_provenance(make_report(), str(bag), {}, None).evaluation
    assert made.provenance.input_sha256 == hashlib.sha256(b"onetwo").hexdigest()
    assert made.provenance.input == "bag"


def test_excluded_intervals_have_begin_and_end() -> None:
    report = replace(make_report(), events=_events())
    text = shown(with_provenance(report, None, {}, True))
    rows = ("| 0.00 s     | 594.00 s   | 2026-03-01T08:00:00.000Z | a warm-up",
            "| 400.13 s   | 400.14 s   | 2026-03-01T08:06:40.130Z | glitch",
            "| 1,000.00 s | 1,002.00 s | 2026-03-01T08:16:40.000Z | knock")  # fmt: skip
    at = [text.find(row) for row in rows]
    assert -1 not in at
    assert at == sorted(at)
    assert len(excluding_events(report)) == 3  # the first warm-up is part of the second


def _events() -> tuple[Event, ...]:
    rows = (
        ("disturbance", 400.13, 0.01, "glitch on gyro/x: 0.01 s excluded"),
        ("disturbance", 1000.0, 2.0, "knock on gyro/x: 2 s excluded"),
        ("warmup", 1500.0, 300.0, "a warm-up of 5 min is over and excluded"),
        ("warmup", 1638.0, 594.0, "a warm-up of 9 min 54 s is over and excluded"),
    )
    return tuple(
        Event(time=make_report().time, kind=kind, text=text, device="a", elapsed_s=at, length_s=length)
        for kind, at, length, text in rows
    )


def test_the_date_of_a_record_is_known_where_its_clock_shows_it(recording: Path, tmp_path: Path) -> None:
    rows = np.loadtxt(recording, delimiter=",", skiprows=1)
    np.savez(tmp_path / "unix.npz", t=rows[:, 0] + 1.75e9, gyro=rows[:, 1:4], accel=rows[:, 4:])
    assert replayed(tmp_path / "unix.npz").session.started == "2025-06-15T15:06:40.000Z"
    assert replayed(recording).session.started is None
    assert "| Start | 2025-06-15T15:06:40.000Z |" in " ".join(imumon("report", tmp_path / "unix.npz").split())


def test_the_item_is_in_every_document(recording: Path, tmp_path: Path) -> None:
    item = tmp_path / "item.toml"
    item.write_text('operator = "A. Person"\nambient = "23.1 °C, 45 %"\nplace = "room 3"\n')
    out = tmp_path / "x.json"
    imumon("report", recording, "--item", item, "--item", "serial=S-17", "--item", "place=room 4", "-o", out)
    report = from_json(Report, out.read_text())
    assert (report.item.operator, report.item.place, report.device.serial) == ("A. Person", "room 4", "S-17")
    for form in ("md", "html"):
        page = imumon("report", out, "--format", form, "--item", "note=<script>x</script>")
        for text in ("A. Person", "23.1 °C, 45 %", "room 4", "S-17", "not stated"):
            assert text in page
        assert "<script>" not in page
    assert "Item and measurement" not in imumon("report", recording)


@pytest.mark.parametrize(
    "word",
    [
        "colour=red", "operator=", "note=" + "x" * 1_000_000, "nothing.toml", "=", "operator",
        "FILE:operator = 3\n[place]\n", "FILE:= 1", "FILE:colour = 'red'", "FILE:note = '" + "x" * 200_000,
        "note=a\nb", "note=a\tb", "note=\x1b[2J", "note=a\u202eb", 'FILE:note = "a\\nb"',
    ],
)  # fmt: skip
def test_a_wrong_item_is_one_line(word: str, saved: Path, tmp_path: Path) -> None:
    if word.startswith("FILE:"):
        (tmp_path / "item.toml").write_text(word[5:])
        word = str(tmp_path / "item.toml")
    message = imumon("report", saved, "--item", word, code=2)
    assert message.startswith("imumon: --item: ")
    assert len(message.splitlines()) == 1
    assert len(message) < 400
