"""Laws of printed logs: one table of numbers, however a loop prints it, and every line is counted."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.model.errors import ImumonError
from imumon.model.ledger import imbalance, merged
from imumon.sources.files import ReadOptions, open_recording
from imumon.sources.files.printed_log import tables
from imumon.sources.files.record_reader import RecordReader

RNG = np.random.default_rng(7)
ROWS = np.column_stack(
    [10.0 * np.arange(400), RNG.normal(0.0, 1e-3, (400, 3)), RNG.normal([0.1, -0.2, 9.8], 0.02, (400, 3))]
).round(5)
NAMES = ("t", "gx", "gy", "gz", "ax", "ay", "az")


def lines(form: str, header: str = "") -> str:
    return header + "".join(form.format(*row) for row in ROWS.tolist())


def dicts() -> str:
    rows = [{"t": r[0], "gyro": r[1:4], "acc": {"x": r[4], "y": r[5], "z": r[6]}} for r in ROWS.tolist()]
    return "".join(f"{row}\n" for row in rows)


CSV = ",".join(["{}"] * 7) + "\n"
FORMS: dict[str, str] = {
    "csv": lines(CSV, ",".join(NAMES) + "\n"),
    "comments before": lines(CSV, "# a logger\n# version 2\n" + ",".join(NAMES) + "\n"),
    "units below": lines(CSV, ",".join(NAMES) + "\nms,rad/s,rad/s,rad/s,g,g,g\n"),
    "sources below": lines(
        CSV, ",".join(NAMES) + "\nms,rad/s,rad/s,rad/s,g,g,g\n,1: gyro,1: gyro,,2: acc,2: acc,\n"
    ),
    "units above": lines(CSV, "Unit,rad/s,rad/s,rad/s,g,g,g\nStep,1,1,1,1,1,1\n" + ",".join(NAMES) + "\n"),
    "units in a comment": lines(CSV, "# ms,rad/s,rad/s,rad/s,g,g,g\n# " + ",".join(NAMES) + "\n"),
    "decimal comma": lines(CSV.replace(",", ";"), ";".join(NAMES) + "\n").replace(".", ","),
    "blanks": lines(CSV.replace(",", "  "), "  ".join(NAMES) + "\n"),
    "separator at the end": lines(CSV.replace("\n", ",\n"), ",".join(NAMES) + ",\n"),
    "a mark at the end": lines(CSV.replace("\n", ";\n")),
    "an address behind": lines(CSV.replace("\n", ",C2 @ C0:83:26:30:5A:4D\n"), ",".join(NAMES) + ",device\n"),
    "quoted": lines('"{}"' + ',"{}"' * 6 + "\n", ",".join(NAMES) + "\n"),
    "no header": lines(CSV),
    "first row cut": "0.1,9.8\n" + lines(CSV),
    "a sentence above": lines(CSV.replace(",", " "), "/sys/bus/iio/devices/device0\n"),
    "labels": lines("t: {}, gx: {}, gy: {}, gz: {}, ax: {}, ay: {}, az: {}\n", "ready\n"),
    "labels of one letter": lines("T {} G {} {} {} A {} {} {}\n"),
    "equal signs": lines("t={} gx={} gy={} gz={} ax={} ay={} az={}\n"),
    "several lines": lines(
        "\nTime {} ms\nGyro X: {}, Y: {}, Z: {} rad/s\nAccel X: {}, Y: {}, Z: {} m/s^2\n", "Hello\n"
    ),
    "vectors": lines('{},"[{}, {}, {}]","[{}, {}, {}]"\n', "t,gyro,acc\n"),
    "brackets": lines("Scaled. T {} Gyr (DPS) [ {}, {}, {} ], Acc (mg) [ {}, {}, {} ]\n"),
    "yaml": lines("---\nt: {}\nangular:\n  x: {}\n  y: {}\n  z: {}\nlinear:\n  x: {}\n  y: {}\n  z: {}\n"),
    "protobuf": lines(
        "t: {}\nang {{\n  x: {}\n  y: {}\n  z: {}\n}}\nlin {{\n  x: {}\n  y: {}\n  z: {}\n}}\n"
    ),
    "json lines": "".join(json.dumps(dict(zip(NAMES, r, strict=True))) + "\n" for r in ROWS.tolist()),
    "dicts": dicts(),
    "decimal comma in quotes": lines('"{}"' + ';"{}"' * 6 + "\n").replace(".", ",").replace(";", ","),
    "exponents of Fortran": "".join(
        " ".join(f"{x:.6E}".replace("E", "D") for x in row) + "\n" for row in ROWS
    ),
    "bytes between": lines("t {} ms 0A 1F 00 3C gyro: {} {} {} acc: {} {} {}\n"),
    "places before": lines("T:\t{}\nGyro:\t[0] {}\n\t[1] {}\n\t[2] {}\nAcc:\t[0] {}\n\t[1] {}\n\t[2] {}\n"),
    "a list behind a number": lines("gyro t={}ns, ({}, {}, {})\nacc ({}, {}, {})\n"),
    "lines now and then": "".join(
        "T {}\nGyro: [ {} {} {} ]\nAcc: [ {} {} {} ]\n".format(*row)
        + f"Mag\nField: [ {k} {k} {k} ]\n" * (k * k // 7 % 6 == 3)
        for k, row in enumerate(ROWS.tolist())
    ),
    "carriage returns": lines(CSV, ",".join(NAMES) + "\n").replace("\n", "\r\n"),
}


@pytest.mark.parametrize("form", FORMS)
def test_one_table_however_it_is_printed(form: str) -> None:
    table = tables(FORMS[form].replace("\r", ""))[0]
    assert table.rows[-300:, :7] == pytest.approx(ROWS[-300:])
    if any(table.names):
        assert "x" in table.names[1].lower() or "[0]" in table.names[1], table.names


def read(form: str, pieces: Sequence[int]) -> tuple[np.ndarray, dict[str, int], int]:
    """Return the rows, the ledger and the lines of a text that is read in pieces of so many lines."""
    text = FORMS[form].replace("\r", "")
    table = tables(text)[0]
    reader = RecordReader("a", table, range(7))
    every = [f"{line}\n".encode() for line in text.split("\n")[table.begin :] if line or table.pattern]
    every = every[:-1] if not every[-1].strip() else every
    rows, begin = [], 0
    for size in [*pieces, len(every)]:
        block = every[begin : begin + size]
        if block:
            last = begin + size >= len(every)
            rows.append(reader.read(b"".join(block), begin + 1, last=last)[0])
        begin += size
    return np.concatenate(rows), reader.ledger, len(every)


@pytest.mark.parametrize("form", FORMS)
def test_a_reader_gives_the_rows_and_counts_every_line(form: str) -> None:
    rows, ledger, count = read(form, [])
    assert rows[-300:] == pytest.approx(ROWS[-300:])
    assert len(rows) + sum(n for reason, n in ledger.items() if reason != "received") == count


read_whole = cache(partial(read, pieces=[]))


@given(st.lists(st.integers(1, 300), max_size=6), st.sampled_from([*FORMS]))
def test_any_chunking_gives_the_same(pieces: list[int], form: str) -> None:
    whole, ledger, _ = read_whole(form)
    rows, other, _ = read(form, pieces)
    assert rows == pytest.approx(whole)
    assert other == ledger


CHUNKS: dict[str, Callable[[float, np.ndarray], str]] = {
    "objects": lambda t, of: json.dumps(
        {"t": t, "acc": [dict(zip("xyz", a, strict=True)) for a in of.tolist()]}
    ),
    "rows": lambda t, of: json.dumps({"t": t, "acc": of.tolist()}),
    "axes": lambda t, of: json.dumps({"t": t, **dict(zip(("ax", "ay", "az"), of.T.tolist(), strict=True))}),
    "labels": lambda t, of: f"T: {t}\n" + "\n".join("acc: {} {} {}".format(*a) for a in of),
}


@pytest.mark.parametrize("form", CHUNKS)
def test_the_samples_of_a_record_are_rows(form: str) -> None:
    text = "".join(f"{CHUNKS[form](ROWS[k, 0], ROWS[k : k + 8, 4:])}\n" for k in range(0, 400, 8))
    table = tables(text + "end")[0]
    expected = np.column_stack([np.repeat(ROWS[::8, 0], 8), ROWS[:, 4:]])
    assert table.rows == pytest.approx(expected)
    reader = RecordReader("a", table, range(4))
    parts = [f"{line}\n".encode() for line in text.splitlines()]
    rows = [
        reader.read(b"".join(part), 1, last=k > 0)[0]
        for k, part in enumerate((parts[:77], parts[77:]))
        if part
    ]
    assert np.concatenate(rows) == pytest.approx(expected)
    ledger = merged(reader.ledger, {"received": len(parts), "samples": 400})
    assert imbalance(ledger) == 0


def test_a_separator_in_quotes_separates_no_cells() -> None:
    text = "".join(f't,"{k}",x,"{"|".join(map(str, ROWS[k : k + 50, 4]))}"\n' for k in range(50))
    assert tables(text + "end")[0].rows[0, 1:] == pytest.approx(ROWS[0:50, 4])


def test_two_sensors_of_one_name_are_no_samples_of_one() -> None:
    text = "".join(f"t {t} acc: {a} {b} {c} acc: {b} {c} {a}\n" for t, _, _, _, a, b, c in ROWS.tolist())
    assert not tables(text + "end")[0].samples


def test_text_between_samples_is_no_sample_and_a_damaged_one_is_lost(tmp_path: Path) -> None:
    form = "t_ms: {}, gx_dps: {}, gy_dps: {}, gz_dps: {}, ax: {}, ay: {}, az: {}\n"
    every = lines(form).splitlines(keepends=True)
    every[50] = "low battery\n"
    every[60] = every[60].replace("gy", "g?")
    path = tmp_path / "a.log"
    path.write_text("boot\n" + "".join(every), newline="\r\n")
    recording = open_recording(str(path), ReadOptions())
    samples = sum(len(block) for blocks in recording for block in blocks if hasattr(block, "values"))
    assert samples == 398
    assert recording.ledger["not_numbers"] == 1
    assert recording.ledger["damaged"] == 1
    assert imbalance(merged(recording.ledger, {"samples": samples})) == 0


@pytest.mark.parametrize("form", ["units below", "sources below", "units above", "units in a comment"])
def test_a_line_of_units_is_that_of_the_names(form: str) -> None:
    table = tables(FORMS[form])[0]
    units = ("" if form == "units above" else "ms", *("rad/s",) * 3, *("g",) * 3)
    assert (table.names, table.units) == (NAMES, units)


def test_a_unit_in_brackets_behind_numbers_is_theirs() -> None:
    forms = (
        "T: {} [ms]\nrate: [ {} {} {} ] [rad/s]\nacc: ( {} {} {} ) (g)\n",
        "[ms] {} [rad/s] {} {} {} (g) {} {} {}\n",
    )
    for form in forms:  # but those of the next ones if each is before its numbers
        assert tables(lines(form, "ready\n"))[0].units == ("ms", *("rad/s",) * 3, *("g",) * 3)


def test_a_unit_in_a_cell_is_that_of_its_column() -> None:
    table = tables(lines(CSV.replace("{}", "{} sec", 1), ",".join(NAMES) + "\n"))[0]
    assert (table.names, table.units) == (NAMES, ("sec", *("",) * 6))
    assert table.rows[-300:] == pytest.approx(ROWS[-300:])


def test_bars_may_be_around_the_cells() -> None:
    text = lines("| " + " | ".join(["{}"] * 7) + " |\n", f"|{'|'.join(NAMES)}|\n{'|---' * 7}|\n")
    assert tables(text)[0].names == ("", *NAMES, "")


@pytest.mark.parametrize("separator", [",", "\t", " "])
def test_a_stamp_before_each_line_is_a_column_of_its_own(separator: str) -> None:
    rows = [NAMES, *ROWS.tolist()]
    text = "".join(
        f"09:44:{0.01 * k:06.3f} -> {separator.join(map(str, row))}\n" for k, row in enumerate(rows)
    )
    table = tables(text)[0]
    assert table.names == ("time", *NAMES)
    assert table.rows[-300:, 1:] == pytest.approx(ROWS[-300:])


def test_two_devices_in_turn_are_two_tables_whatever_their_numbers(tmp_path: Path) -> None:
    """Two sensors on one board differ by their noise alone."""
    form = "2024-03-19 09:44:{:05.2f}: IMU {{I : {}, GyrX : {}, GyrY : {}, GyrZ : {}}}\n"
    every = [form.format(0.04 * k, i, *row[1:4]) for k, row in enumerate(ROWS.tolist()) for i in (0, 1)]
    path = tmp_path / "a.log"
    path.write_text("".join(every))
    assert [table.codes for table in tables(path.read_text())] == [((1, "0"),), ((1, "1"),)]
    recording = open_recording(str(path), ReadOptions(where={"I": "1"}, accept=True))
    blocks = [block for some in recording for block in some]
    assert recording.ledger["other_sensor"] == sum(map(len, blocks)) == 400
    assert blocks[0].stream.interval_s == pytest.approx(0.04)


def test_texts_that_no_program_prints_are_refused_or_asked_about(tmp_path: Path) -> None:
    """A code of rows that is an axis by its name, and blank lines between few numbers."""
    sensor = "".join(f"{['acc', 'gyr'][k % 2]}\t{9.8 + k % 7 * 1e-3}\t{k}\t{k}\n" for k in range(600))
    for text in (f"ax\t\t\tid\n{sensor}", "\n\n2\n" + "\n\n1\n\n" * 15):
        (tmp_path / "a.txt").write_text(text)
        with pytest.raises(ImumonError):
            list(open_recording(str(tmp_path / "a.txt"), ReadOptions(accept=True)))


def test_a_counter_beside_a_clock_divides_nothing() -> None:
    assert len(tables("".join(f"{k},{k % 3}\n" for k in range(500)))) == 1


def test_coarse_numbers_of_a_sensor_do_not_divide_the_rows() -> None:
    form = "{},{},{},{},{},{},{}"
    rows = [f"{form.format(*row)},{300 + k * 5 % 7}\n" for k, row in enumerate(ROWS.tolist())]
    assert len(tables(",".join(NAMES) + ",imu.magY\n" + "".join(rows))) == 1


@pytest.mark.parametrize(
    "row", ["0x{:04X} 0x{:04X} 0x{:04X}\n", "{:04X} {:04X} {:04X}\n", "1,0x{:x},0x{:x},0x{:x}\n"]
)
def test_hexadecimal_numbers_are_named_as_the_fault(tmp_path: Path, row: str) -> None:
    path = tmp_path / "a.log"
    path.write_text("".join(row.format(0xFFE0 + k % 30, 0xA1B2, 0x4012 + k) for k in range(400)))
    with pytest.raises(ImumonError) as error:
        read_all(path)
    assert "hexadecimal" in error.value.message
    assert "decimal" in error.value.cure
    path.write_text("colour 0x0 0x0 0xffff\n" + "speed: 1.5 m/s\nspeed: 1.6 m/s\n" * 200)
    with pytest.raises(ImumonError) as error:
        read_all(path)
    assert "are hexadecimal" not in error.value.message


def test_a_row_that_ends_early_costs_no_more_than_others() -> None:
    """Each number of many digits could be split in many ways, and a row of them in the product of all."""
    row = "v " + ", ".join([str(10**19 + 7)] * 9)
    table = tables(f"{row}\n" * 20 + f"{row[:-1]}x\n" + f"{row}\n" * 20)[0]
    assert len(table.rows) == 40


HOSTILE: dict[str, Callable[[], bytes]] = {
    "a million columns": lambda: b"a," * 10**6 + b"\n" + b"1," * 10**6 + b"\n",
    "a line without end": lambda: b"1,2,3," * 10**6,
    "zeros": lambda: bytes(10**6),
    "invalid UTF-8": lambda: b"t,gx,gy,gz\n" + b"\xff\xfe\xc3,1,\xe2,3\n" * 1000,
    "brackets": lambda: b"[" * 10**6,
    "quotes": lambda: b'"' * 10**6 + b"\n",
    "numbers without a separator": lambda: b"1" * 10**6 + b"\n",
    "no numbers": lambda: b"hello world\n" * 10**5,
    "nothing but ends of lines": lambda: b"\n" * 10**6,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_text_is_one_error(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(HOSTILE[name]())
    with pytest.raises(ImumonError) as error:
        read_all(path)
    assert "\n" not in error.value.message


def read_all(path: Path) -> None:
    recording = open_recording(str(path), ReadOptions(accept=True))
    if not [block for blocks in recording for block in blocks]:
        raise recording.no_samples()
