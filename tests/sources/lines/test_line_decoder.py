"""Laws of the decoder of lines: every byte is counted, no sample is invented, any chunking gives the same."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import ROOT

from imumon.model.samples import ACCEL, GYRO, SampleBlock
from imumon.record import Record
from imumon.sources.device import InvalidOption
from imumon.sources.files import ReadOptions, open_recording
from imumon.sources.lines.line_decoder import LONGEST_LINE, LineDecoder
from imumon.sources.lines.lines_driver import parse_url

SEVEN = {"columns": "t_us,gx,gy,gz,ax,ay,az"}


def chunks(data: bytes, size: int) -> Iterator[bytes]:
    return (data[at : at + size] for at in range(0, len(data), size))


def decoded(data: bytes, given: dict[str, str], size: int = 1 << 20) -> tuple[list[SampleBlock], LineDecoder]:
    decoder = LineDecoder(given)
    blocks = [block for chunk in chunks(data, size) for block in decoder.feed(chunk)] + decoder.finish()
    return blocks, decoder


def rows(blocks: list[SampleBlock]) -> np.ndarray:
    return np.concatenate([block.values for block in blocks]) if blocks else np.empty((0, 0))


def times(blocks: list[SampleBlock]) -> list[int]:
    return [int(t) for block in blocks for t in (block.time_ns if block.time_ns is not None else ())]


def lines(count: int, rate: float = 100.0, start: int = 0, period: int = 1 << 62) -> bytes:
    """Lines of `SEVEN` whose first value is their number."""
    stamps = ((start + round(k * 1e6 / rate)) % period for k in range(count))
    return b"".join(b"%d,%d,0.1,-2e-3,0,+.5,9.8\r\n" % (t, k) for k, t in enumerate(stamps))


NO_SAMPLES = [
    b"MPU6050 connection successful", b"1,2,3", b"1,,2,3,4,5,6,7", b"1,2,3,4,5,6,", b"1,2,3,4,5,6,7,8",
    b"1,nan,3,4,5,6,7", b"1,2,3,4,inf,6,7", b"nan,2,3,4,5,6,7", b"1e300,2,3,4,5,6,7", b"1,2,3,4,5,6,ovf",
    b"1,2,3,4,5,6,1_0", b"0x1,2,3,4,5,6,7", b"1,2,3,4,5,6,7\x00", b"\xff\xfe1,2,3,4,5,6,7", b",,,,,,",
]  # fmt: skip


@pytest.mark.parametrize("line", NO_SAMPLES)
def test_a_line_that_is_no_sample_is_counted(line: bytes) -> None:
    data = lines(150) + line + b"\n" + lines(150, start=1_500_000)
    blocks, decoder = decoded(data, SEVEN)
    assert len(rows(blocks)) == decoder.messages == 300
    assert (decoder.bad_checksums, decoder.discarded) == (1, len(line) + 1)
    assert decoder.fed == decoder.message_bytes + decoder.discarded
    assert len(decoder.remarks) == 1
    assert "\n" not in decoder.remarks[0]


def test_without_a_clock_such_a_line_is_a_lost_sample_but_none_before_the_first() -> None:
    data = b"boot\nready\n1,2,3\n4,5,6\nbad\n\n# note\nbad\n7,8,9\n"
    blocks, decoder = decoded(data, {"columns": "gx,gy,gz"})
    assert [int(n) for block in blocks for n in block.lost] == [0, 0, 2]
    assert blocks[0].stream.clock == "none"
    assert decoder.bad_checksums == 4


@given(
    st.lists(st.sampled_from([*NO_SAMPLES, b"", b"#x", b"9,1,2,3,4,5,6"]), max_size=30), st.integers(1, 40)
)
@settings(deadline=None, max_examples=60)
def test_any_chunking_gives_the_same(content: list[bytes], size: int) -> None:
    data = b"\n".join(content)
    whole, one = decoded(data, SEVEN)
    parts, other = decoded(data, SEVEN, size)
    assert rows(whole).tolist() == rows(parts).tolist()
    assert times(whole) == times(parts)
    counts = ("fed", "messages", "message_bytes", "discarded", "bad_checksums", "pending", "remarks")
    assert [getattr(one, n) for n in counts] == [getattr(other, n) for n in counts]
    assert one.fed == one.message_bytes + one.discarded


def test_a_megabyte_without_an_end_of_line_is_discarded_in_bounded_memory() -> None:
    decoder = LineDecoder(SEVEN)
    blocks = decoder.feed(lines(200))
    for chunk in chunks(b"7" * (1 << 20), 1000):
        assert decoder.feed(chunk) == []
        assert decoder.pending <= LONGEST_LINE
    blocks += decoder.feed(b"\n" + lines(200, start=2_000_000)) + decoder.finish()
    assert len(rows(blocks)) == 400
    assert (decoder.bad_checksums, decoder.discarded) == (1, (1 << 20) + 1)


@pytest.mark.parametrize(
    ("unit", "period"), [("us", 1 << 32), ("us", 1 << 30), ("ms", 1 << 32), ("ms", 1 << 30)]
)
def test_a_counter_that_wraps_is_no_gap(unit: str, period: int) -> None:
    before = 2_000_000 if unit == "us" else 2_000
    data = lines(1000, rate=100.0 if unit == "us" else 1e5, start=period - before, period=period)
    blocks, _ = decoded(data, {"columns": f"t_{unit},gx,gy,gz,ax,ay,az"})
    steps = np.diff(times(blocks))
    assert len(steps) == 999
    assert set(steps.tolist()) == {10_000_000}


@pytest.mark.parametrize("uptime_s", [5, 1000, 3000, 4000])
def test_a_clock_that_goes_back_is_a_restart_and_no_gap_of_known_length(uptime_s: int) -> None:
    data = lines(500, start=uptime_s * 1_000_000) + lines(500, start=1234)
    monitor = Record()
    for block in decoded(data, SEVEN)[0]:
        monitor.feed(block)
    monitor.flush()
    assert monitor.restarts == 1
    assert monitor.samples == 1000


@pytest.mark.parametrize("rate", [640.0, 950.0, 1000.0])
def test_stamps_in_milliseconds_that_are_too_coarse_lose_nothing(rate: float) -> None:
    stamps = np.floor(np.arange(20_000) * 1000.0 / rate + 1e-6).astype(int)
    data = b"".join(b"%d,1,2,3,4,5,6\n" % t for t in stamps)
    blocks, decoder = decoded(data, {"columns": "t_ms,gx,gy,gz,ax,ay,az"})
    steps = np.diff(times(blocks))
    assert len(steps) == len(stamps) - 1
    assert steps == pytest.approx(1e9 / rate, rel=0.02)
    assert steps.mean() == pytest.approx(1e9 / rate, rel=1e-4)
    assert any("too coarse" in remark for remark in decoder.remarks)


def test_units_signs_and_decimal_commas() -> None:
    given = {"columns": "t_s,gx,gy,gz,ax,ay,az,temp,-", "gyro": "deg/s", "accel": "g", "temp": "K"}
    data = b"0,5;180;0;0;0;0;1;300,15;-7\n0,6;-90;0;0;0;0;1;nan;8\n"
    blocks, decoder = decoded(data, given)
    first, second = rows(blocks)
    assert first.tolist() == pytest.approx([math.pi, 0, 0, 0, 0, 9.80665, 27.0])
    assert second[0] == pytest.approx(-math.pi / 2.0)
    assert math.isnan(second[-1])  # unknown, and the sample counts
    assert times(blocks) == [500_000_000, 600_000_000]
    assert decoder.columns.stream.channels == (*GYRO, *ACCEL, "temperature")


FORMS = [
    "t,gx,gy,gz\n{},{},{},{}",
    "t={} gx={} gy={} gz={}",
    "t: {}, gyro_x: {}, gyro_y: {}, gyro_z: {}",
    '{{"time": {}, "gx": {}, "gy": {}, "gz": {}}}',
    "t: {}\ngyro: x {} y {} z {}\n",
    "Kreisel Nº 2: t={} gx={} gy={} gz={}",
    "sample {}\nGyro: {}, {}, {}",
]
NOISE = np.random.default_rng(0).normal(0.0, 1e-3, (90, 3)).round(6)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("unit", "first", "step"),
    [("s", 0, "0.01"), ("s", 1_700_000_000, "0.01"), ("ms", 0, "10"), ("us", 5, "10000"), ("ns", 0, "1e7")],
)
def test_the_first_lines_show_how_a_sample_is_printed(form: str, unit: str, first: int, step: str) -> None:
    """What they do not state is used if it is accepted; a recording of the lines then gives the same."""
    header, row = ("t,gx,gy,gz", "{},{},{},{}") if form == FORMS[0] else ("", form)
    lines = [row.format(f"{first + k * Decimal(step):f}", *NOISE[k]) for k in range(90)]
    data = "\n".join([*filter(None, [header]), *lines, ""]).encode("latin-1")
    assert not rows(decoded(data, {})[0]).size
    blocks, decoder = decoded(data, {"accept": ""}, size=7)
    assert rows(blocks) == pytest.approx(NOISE)
    if form != FORMS[-1]:  # the number of a sample is no time
        assert set(np.diff(times(blocks)).tolist()) == {10_000_000}
    assert "assumed_unit" in decoder.columns.caveats
    again, _ = decoded(data, dict(decoder.columns.settings))
    assert rows(again) == pytest.approx(rows(blocks))
    assert times(again) == times(blocks)


def test_a_column_whose_name_comes_twice_may_be_time_and_axis() -> None:
    lines = "".join(f"{0.01 * k:.2f},{0.01 * (k % 3)},{9.8 + 0.01 * (k % 5)},9.7\n" for k in range(300))
    blocks, _ = decoded(f"ax,ay,az,ax\n{lines}".encode(), {"accept": ""})
    assert len(rows(blocks)) == 300


LIKE_FILES = {
    "words and checks": "$IMX,{0:.2f},{1:.6f},{2:.6f},{3:.6f},{4:.4f},{5:.4f},{6:.4f}*4F\n",
    "dates": "2024-01-01T10:00:{0:09.6f},{1:.6f},{2:.6f},{3:.6f},{4:.4f},{5:.4f},{6:.4f}\n",
    "two sensors": "gyro,{0:.2f},{1:.6f},{2:.6f},{3:.6f}\nacc,{0:.2f},{4:.4f},{5:.4f},{6:.4f}\n",
}


@pytest.mark.parametrize("form", LIKE_FILES.values(), ids=LIKE_FILES)
def test_a_device_is_read_as_a_file_of_its_lines(form: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    sizes = rng.normal((0.0, 0.0, 0.0, 0.0, 0.0, 9.81), (1e-3,) * 3 + (1e-2,) * 3, (300, 6))
    text = "".join(form.format(0.01 * k, *row) for k, row in enumerate(sizes.tolist()))
    (tmp_path / "a.log").write_text(text)
    blocks, decoder = decoded(text.encode(), {"accept": ""}, size=100)
    recording = open_recording(str(tmp_path / "a.log"), ReadOptions(accept=True))
    recorded = [block for items in recording for block in items if isinstance(block, SampleBlock)]
    assert rows(blocks) == pytest.approx(rows(recorded))
    assert blocks[0].stream.channels == recorded[0].stream.channels
    counts = {reason: count for reason, count in decoder.ledger.items() if reason != "pending"}
    assert counts == recording.ledger


def test_a_question_is_asked_once_for_all_attempts() -> None:
    decoder, rng, questions = LineDecoder({}), np.random.default_rng(5), set()
    for k in range(900):
        row = [*rng.normal(0.0, 1e-3, 3), *rng.normal((0.0, 0.0, 9.81), 0.01)]
        decoder.feed(
            "t={:.3f} gx={:.5f} gy={:.5f} gz={:.5f} ax={:.4f} ay={:.4f} az={:.4f}\n".format(
                0.01 * k, *row
            ).encode()
        )
        questions.update(text for text in decoder.remarks if "accept" in text)
    assert len(questions) == 1
    assert not decoder.messages


def test_a_header_changes_neither_given_columns_nor_those_of_samples() -> None:
    header = b"t_us,ax,ay,az,gx,gy,gz\n"
    blocks, decoder = decoded(header + lines(200), SEVEN)
    assert blocks[0].stream.channels[:3] == GYRO
    assert rows(blocks)[:, 5] == pytest.approx(9.8)
    blocks, decoder = decoded(
        lines(200) + header + lines(200, start=2_000_000), {"columns": SEVEN["columns"]}
    )
    assert len(rows(blocks)) == 400
    assert decoder.bad_checksums == 0


def test_the_unit_of_an_acceleration_that_is_not_that_of_gravity_is_doubted() -> None:
    data = b"".join(b"%d,0,0,0,0.01,0.02,0.99\n" % (10 * k) for k in range(300))
    given = {"columns": "t_ms,gx,gy,gz,ax,ay,az"}
    assert any("accel=" in remark for remark in decoded(data, given)[1].remarks)
    assert not decoded(data, given | {"accel": "g"})[1].remarks


@pytest.mark.parametrize(
    ("url", "code"),
    [
        ("lines:", "lines_url_invalid"),
        ("lines:/dev/x?colums=gx", "lines_parameter_unknown"),
        ("lines:/dev/x?columns=gx,gy,speed", "lines_columns_invalid"),
        ("lines:/dev/x?columns=t_ms,temp", "lines_columns_invalid"),
        ("lines:/dev/x?columns=gx,gx", "lines_columns_invalid"),
        ("lines:/dev/x?columns=t_ms,gx [furlong]", "lines_unit_invalid"),
        ("lines:/dev/x?gyro=furlong", "lines_unit_invalid"),
        ("lines:/dev/x?baud=fast", "lines_url_invalid"),
        ("lines:/dev/x?rate=-1", "lines_url_invalid"),
        ("lines:udp://:4000?from=board", "lines_url_invalid"),
        ("lines:tcp://10.0.0.7:4000?from=10.0.0.7", "lines_url_invalid"),
    ],
)
def test_a_url_that_is_wrong_has_a_code_and_a_cure(url: str, code: str) -> None:
    with pytest.raises(InvalidOption) as wrong:
        parse_url(url)
    assert wrong.value.code == code
    assert wrong.value.cure


SKETCHES = re.findall(
    r"```text lines\n(.*?)```\n+```sh lines\n(.*?)```", (ROOT / "docs" / "SENSORS.md").read_text(), re.S
)
BOARDS = ["MPU-6050", "ICM-20948", "BNO085", "MicroPython", "pipe"]


@pytest.mark.parametrize(("printed", "command"), SKETCHES, ids=BOARDS)
def test_a_sketch_of_the_documentation_prints_samples(printed: str, command: str) -> None:
    words = shlex.split(command)
    given = parse_url(words[words.index("--port") + 1]).settings
    *header, first, second = printed.encode().splitlines()
    separator = b"," if b"," in first else b" "
    start, step = (
        int(first.split(separator)[0]),
        int(second.split(separator)[0]) - int(first.split(separator)[0]),
    )
    values = [line.split(separator, 1)[1] for line in (first, second)]
    lines = [*header, *(b"%d%s%s" % (start + k * step, separator, values[k % 2]) for k in range(300)), b""]
    blocks, decoder = decoded(b"\r\n".join(lines), dict(given))
    assert len(rows(blocks)) == 300
    assert (decoder.bad_checksums, decoder.remarks) == (0, ())
    channels = blocks[0].stream.channels
    acceleration = rows(blocks)[:, [channels.index(name) for name in ACCEL]]
    assert np.linalg.norm(acceleration, axis=1) == pytest.approx(9.81, rel=0.05)
    assert np.abs(rows(blocks)[:, [channels.index(name) for name in GYRO]]).max() < 0.1
    if "temperature" in channels:
        assert rows(blocks)[:, channels.index("temperature")] == pytest.approx(25.5, abs=2.0)
