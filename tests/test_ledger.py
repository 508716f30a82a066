"""What was received is the sum of what became of it, to the row: files, lines, messages, live and recorded.

`conftest` holds every report that a test makes to this law; here are inputs whose counts are known.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import WRITERS, records
from tables import csv, replayed, sentences, truth

from imumon.model.ledger import REASONS, RECEIVED, Ledger, imbalance, merged, with_received
from imumon.model.report import Report, SessionCounters, from_json
from imumon.model.report_json import to_json
from imumon.record import Record
from imumon.sources.lines.line_decoder import LineDecoder
from imumon.sources.vn100 import ascii

NAMES = ["t [s]", *(f"gyro_{a} [rad/s]" for a in "xyz"), *(f"accel_{a} [m/s2]" for a in "xyz")]


def table(path: Path, n: int = 300) -> list[str]:
    """Write a table; return its lines."""
    t, gyro, accel = truth(n)
    csv(path, NAMES, t, gyro, accel)
    return path.read_text().splitlines()


def ledger(path: Path, **more: object) -> dict[str, int]:
    report, _ = replayed(path, **more)
    assert imbalance(report.session.ledger) == 0
    assert report.session.ledger.get("samples") == report.session.samples
    return dict(report.session.ledger)


def test_a_ledger_knows_its_reasons_and_counts_both_sides() -> None:
    counts = Ledger()
    with pytest.raises(KeyError):
        counts.add("lost")
    counts.receive(3)
    counts.add("samples", 2)
    assert imbalance(counts.counts()) == 1
    assert imbalance(merged(counts.counts(), counts.counts(), {"repeated": 2})) == 0
    assert with_received({"samples": 2, "header": 1}) == {"received": 3, "samples": 2, "header": 1}
    assert RECEIVED not in REASONS


def test_every_line_of_a_table_is_in_its_ledger(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    header, *rows = table(path)
    rows[20] = rows[20].rpartition(",")[0] + ","  # an empty cell
    rows[30] = "garbage," + rows[30].partition(",")[2]
    rows[40] = "1,2"
    rows[50:50] = ["# a comment", "", header, rows[49]]  # the row before again
    lines = ["% export", "logger 7", "", header, *rows, rows[-1][:17]]
    path.write_text("\n".join(lines))
    assert ledger(path) == {
        "received": len(lines),
        "samples": 297,
        "header": 3,
        "comment": 2,
        "blank": 2,
        "not_numbers": 2,
        "wrong_columns": 1,
        "repeated": 1,
        "pending": 1,
    }


def test_stamps_that_their_neighbours_refute_are_counted() -> None:
    """Of 2,000 lines, every second one has a time that is far off: no sample is lost without a count."""
    rng = np.random.default_rng(1)
    rows = [
        f"{10 * k if k % 2 == 0 else 10**8 + 7 * k},{','.join(f'{x:.6f}' for x in rng.normal(0.0, 1e-3, 3))}"
        for k in range(2000)
    ]
    text = "\n".join(["t_ms,gx,gy,gz", *rows, ""])
    decoder, monitor = LineDecoder({"columns": "t_ms,gx,gy,gz"}), Record()
    for k in range(0, len(text), 777):
        for block in decoder.feed(text[k : k + 777].encode()):
            monitor.feed(block)
    for block in decoder.finish():
        monitor.feed(block)
    monitor.flush()
    total = merged(decoder.ledger, monitor.left_out(), {"samples": monitor.samples})
    assert imbalance(total) == 0
    assert total["received"] == 2001
    assert total["samples"] + total.get("wrong_time", 0) + total.get("out_of_order", 0) == 2000


@pytest.mark.few
@pytest.mark.parametrize("stuck", [slice(600, 1000), slice(1000, 2000), slice(0, 500)])
@pytest.mark.parametrize("resumes", ["ahead", "where it stopped"])
def test_a_clock_that_stands_still_is_counted_live_and_recorded(
    tmp_path: Path, stuck: slice, resumes: str
) -> None:
    """The samples have no place, those with a running clock have the right N and rate, and the report says it."""
    rng, t = np.random.default_rng(4), np.arange(2000) * 10
    lost = t[stuck].copy()
    t[stuck] = lost[0]
    if resumes == "where it stopped":
        t[stuck.stop :] -= lost[-1] - lost[0]
    rows = [f"{k},{','.join(f'{x:.6f}' for x in rng.normal(0.0, 1e-3, 3))}" for k in t]
    decoder, monitor = LineDecoder({"columns": "t_ms,gx,gy,gz"}), Record()
    for block in [*decoder.feed("\n".join([*rows, ""]).encode()), *decoder.finish()]:
        monitor.feed(block)
    monitor.flush()
    live = merged(decoder.ledger, monitor.left_out(), {"samples": monitor.samples})
    assert live == {"received": 2000, "samples": 2001 - len(lost), "repeated": len(lost) - 1}
    path = tmp_path / "a.csv"
    names = "t [ms],gx [rad/s],gy [rad/s],gz [rad/s]"
    path.write_text("\n".join([names, *rows, ""]))
    report, remarks = replayed(path)
    recorded = dict(report.session.ledger)
    assert (recorded["samples"], recorded["repeated"]) == (live["samples"], live["repeated"])
    assert f"{len(lost) - 1:,} samples have the time of the sample before" in remarks
    assert report.device.sample_rate_hz == pytest.approx(100.0)
    assert report.channels["gyro/y"].N.low < 1e-4 < report.channels["gyro/y"].N.high


def test_lines_of_every_kind_are_counted() -> None:
    text = b"MPU ready\n\n# hello\nt_ms,gx,gy,gz\n0,1,2,3\n10,1,nan,3\n20,1,2\n30,1,x,3\n40,1,2,3\n50,1"
    decoder = LineDecoder({"columns": "t_ms,gx,gy,gz"})
    samples = sum(len(block) for block in [*decoder.feed(text), *decoder.finish()])
    assert samples == 2
    assert decoder.ledger == {
        "received": 10, "header": 1, "comment": 1, "blank": 1, "not_numbers": 1, "wrong_columns": 1,
        "not_finite": 1, "start": 1, "pending": 1,
    }  # fmt: skip


@pytest.mark.usefixtures("log_in_thread")
@pytest.mark.parametrize("name", [name for name in WRITERS if "csv" not in name and name != "a.tsv"])
def test_rows_of_other_forms_are_counted(name: str, tmp_path: Path) -> None:
    t, gyro, accel = truth(300)
    gyro[40, 1] = np.nan
    path = WRITERS[name](tmp_path / name, (t, gyro, accel))
    reason = "not_numbers" if name == "a.jsonl" else "not_finite"  # JSON has no number that is none
    assert ledger(path) == {"received": 300, "samples": 299, reason: 1}


def test_text_between_records_of_json_is_counted(tmp_path: Path) -> None:
    path = records(tmp_path / "a.jsonl", truth(300))
    text = path.read_text()
    path.write_text(f"{text[:40]}\n{text}SENSOR RESET\n{text.splitlines()[-1][:30]}")
    assert ledger(path)["samples"] == 300


def test_messages_that_fail_their_check_are_damaged(tmp_path: Path) -> None:
    _, texts = sentences(400)
    texts[100] = texts[100].replace("5", "6")  # the check is that of another number
    other = [ascii.encode("VNRRG,07,40").decode().strip()] * 3
    path = tmp_path / "a.log"
    path.write_text("\r\n".join([*texts[:50], *other, *texts[50:]]) + "\r\n")
    assert ledger(path, rate_hz=100.0) == {
        "received": 403, "samples": 399, "damaged": 1, "other_message": 3,
    }  # fmt: skip


def test_samples_of_an_earlier_record_and_of_a_better_stream_are_counted() -> None:
    monitor = Record(rate_hz=100.0)
    decoder = LineDecoder({"columns": "gx,gy,gz"})
    [block] = decoder.feed(b"".join(b"%d,2,3\n" % k for k in range(200)))
    better = LineDecoder({"columns": "gx,gy,gz,ax,ay,az"})
    [more] = better.feed(b"".join(b"%d,2,3,4,5,6\n" % k for k in range(100)))
    for part in (block, more, block):
        monitor.feed(part)
    assert monitor.left_out() == {"received": 0, "other_message": 200, "earlier_record": 200}
    assert monitor.samples == 100


def test_each_column_has_a_use_or_a_reason(tmp_path: Path) -> None:
    t, gyro, accel = truth(300)
    names = ["n", "t [s]", "gx [rad/s]", "gy [rad/s]", "gz [rad/s]", "q_x", "q_y", "q_z", "clock [s]"]
    path = csv(tmp_path / "a.csv", names, np.arange(300), t, gyro, accel, t + 1e-3)
    report, _ = replayed(path)
    uses = {column.name: column.use or column.reason for column in report.recording.columns}
    assert list(uses) == names
    assert [uses[name] for name in names[1:5]] == ["time", "gyro/x", "gyro/y", "gyro/z"]
    assert all(c.use or c.reason for c in report.recording.columns)
    assert from_json(Report, to_json(report)).recording == report.recording


def test_a_device_that_counts_nothing_has_delivered_what_arrived() -> None:
    monitor = Record(rate_hz=100.0)
    [block] = LineDecoder({"columns": "gx,gy,gz"}).feed(b"".join(b"%d,2,3\n" % k for k in range(200)))
    monitor.feed(block)
    assert monitor._counted(SessionCounters()).ledger == {"received": 200, "samples": 200}
