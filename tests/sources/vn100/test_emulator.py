"""Laws of the emulated VN-100: registers, framing, output, noise, and its terminal as clients see it."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import forked
import numpy as np
import pytest
from cases import case
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import until

from imumon.model.samples import Floats, SampleBlock
from imumon.sources.device import InvalidOption
from imumon.sources.vn100 import ascii
from imumon.sources.vn100.decoder import Vn100Decoder
from imumon.sources.vn100.emulator import (
    EmulatorSettings,
    Noise,
    spawn,
)
from imumon.sources.vn100.emulator.command_handler import BOOTING_S, CommandHandler
from imumon.sources.vn100.emulator.emulator import make_device
from imumon.sources.vn100.registers import ASCII_RATES, LOOP_RATE, REGISTERS

WHITE = Noise((6.1e-5,) * 3, (0.0,) * 3, (0.0,) * 3)


def make(**options: object) -> CommandHandler:
    """Device with white noise only, which is quick to generate, unless `options` say otherwise."""
    quick = {"seed": 7, "gyro": WHITE, "accel": WHITE, "mag": WHITE}
    return make_device(EmulatorSettings(**{**quick, **options}))  # type: ignore[arg-type]


def ask(device: CommandHandler, body: str, check: str = "crc", now: float = 0.0) -> str:
    """Reply to one command without its frame."""
    device.receive(ascii.encode(body, check), now)  # type: ignore[arg-type]
    replies = device.replies(now)
    assert len(replies) == 1, replies
    return replies[0][1:].partition(b"*")[0].decode()


def blocks(messages: list[tuple[int, bytes]]) -> list[SampleBlock]:
    decoder = Vn100Decoder()
    items = [*decoder.feed(b"".join(message for _, message in messages)), *decoder.finish()]
    assert decoder.discarded == 0
    return [item for item in items if isinstance(item, SampleBlock)]


def columns(messages: list[tuple[int, bytes]], sensor: str) -> Floats:
    """(n, 3) samples of one sensor in these messages."""
    sample_blocks = blocks(messages)
    channels = sample_blocks[0].stream.channels
    index = [i for i, name in enumerate(channels) if name.startswith(sensor)]
    return np.concatenate([block.values[:, index] for block in sample_blocks])


# ---------------------------------------------------------------- registers and commands


@pytest.mark.few
def test_every_register_can_be_written_back_exactly_as_read() -> None:
    device = make()
    device.advance(1600)
    for number in range(256):
        answer = ask(device, f"VNRRG,{number}")
        register = REGISTERS.get(number)
        if register is None:
            assert answer == "VNERR,08"
            continue
        assert answer.startswith(f"VNRRG,{number:02d},")
        settable = register.access == "setting"
        assert ask(device, "VNWRG" + answer[5:]) == ("VNWRG" + answer[5:] if settable else "VNERR,09")
        assert not settable or ask(device, f"VNRRG,{number}") == answer


def test_a_command_is_accepted_or_refused_with_its_code() -> None:
    for command, answer in (
        ("VNRRG,5,1", "VNRRG,05,115200,1"),
        ("VNRRG,05,?", "VNRRG,05,115200,1"),
        ("VNRRG,05,3", "VNERR,07"),  # a client counts the ports until an error
        ("VNWRG,06,1,2", "VNWRG,06,1,2"),
        ("VNRRG", "VNERR,05"),
        ("VNRRG,85,1", "VNERR,06"),
        ("VNXYZ", "VNERR,04"),
        ("VNWRG,27,1", "VNERR,09"),
        ("VNWRG,07,3", "VNERR,07"),
        ("VNWRG,75,1,400,1,321", "VNWRG,75,1,400,1,321"),
        ("VNWRG,75,1,400,1,0321,0001", "VNERR,07"),
        ("VNWRG,07,100", "VNERR,0C"),
        ("VNTAR", "VNERR,04"),  # firmware 2 alone has it
        ("VNSIH,+045.000", "VNSIH,+045.000"),
    ):
        with case(command):
            assert ask(make(), command) == answer


def test_a_reply_has_the_checksum_of_its_command() -> None:
    right = b"$VNRRG,01,VN-100T-CR*32\r\n"
    for line, reply in (
        (b"$VNRRG,01*72\r\n", right),
        (b"$VNRRG,1*xx\n", right),
        (b"$VNRRG,01*XXXX\r\n", ascii.encode("VNRRG,01,VN-100T-CR", "crc")),
        (b"$VNRRG,01*73\r\n", b"$VNERR,03*72\r\n"),
        (b"$VNRRG,01*0000\r\n", ascii.encode("VNERR,03", "crc")),
        (b"garbage $VNRR$VNRRG,01*72\r\n", right),
        (b"x" * 300 + b"\r\n", b"$VNERR,02*73\r\n"),
        (b"$VNRRG,01*72", b""),
    ):
        for size in (1, 7, len(line)):
            with case((line, size)):
                device = make()
                for begin in range(0, len(line), size):
                    device.receive(line[begin : begin + size], 0.0)
                assert b"".join(device.replies(0.0)) == reply


FIELD = st.one_of(
    st.sampled_from(["", "0", "1", "3", "75", "85", "115200", "?", "XX", "1e9", "nan", "inf", "FF"]),
    st.integers(-5, 300).map(str),
    st.text("0123456789abcdefABCDEF.+-e?", max_size=6),
)
COMMAND = st.sampled_from(["VNRRG", "VNWRG", "VNASY", "VNSIH", "VNSGB", "VNCMD", "VNXYZ", "VN"])


@settings(max_examples=100, derandomize=True)
@given(
    commands=st.lists(st.tuples(COMMAND, st.lists(FIELD, max_size=14)), max_size=8),
    noise=st.binary(max_size=40),
)
def test_any_input_is_answered_by_valid_messages(commands: list[tuple[str, list[str]]], noise: bytes) -> None:
    device = make(baud=921600, rate=100)
    device.receive(noise + b"\r\n", 0.0)
    for command, fields in commands:
        device.receive(ascii.encode(",".join((command, *fields))), 0.0)
    decoder = Vn100Decoder()
    for reply in device.replies(0.0):
        decoder.feed(reply)
        assert decoder.message_bytes == decoder.fed
    assert device.outputs.bytes_per_second() <= device.baud / 10
    device.advance(device.outputs.tick + 40)


def test_a_reset_loses_what_was_not_saved_and_restarts_the_sensor_clock() -> None:
    device = make(rate=400, baud=921600)
    before = blocks(device.advance(800))[0].time_ns
    ask(device, "VNWRG,00,kept")
    ask(device, "VNWNV")
    ask(device, "VNWRG,00,lost", now=3.0)
    assert ask(device, "VNRST", now=4.0) == "VNRST"
    device.receive(b"$VNRRG,00*XX\r\n", 4.1)
    assert device.advance(1000) == []
    assert device.replies(4.1) == []
    device.replies(4.0 + BOOTING_S)
    after = blocks(device.advance(1100))[0].time_ns
    assert after[0] == pytest.approx(before[0], abs=100_000)
    assert ask(device, "VNRRG,00", now=6.0) == "VNRRG,00,kept"
    assert ask(device, "VNRFS", now=6.0) == "VNRFS"
    device.replies(7.0)
    assert ask(device, "VNRRG,00", now=7.0) == "VNRRG,00,"


def test_the_lowest_baud_that_carries_the_rate_is_chosen() -> None:
    for rate in ASCII_RATES:
        with case(rate):
            device = make(rate=rate)
            assert device.baud == (115200 if rate <= 50 else 230400 if rate <= 100 else 460800)
            assert len(device.advance(2 * LOOP_RATE)) == 2 * rate
    with pytest.raises(InvalidOption) as divided:
        EmulatorSettings(rate=300)
    assert divided.value.code == "rate_invalid"
    with pytest.raises(InvalidOption) as unfit:
        make(rate=100, baud=115200)
    assert unfit.value.code == "rate_does_not_fit"


# ---------------------------------------------------------------- output and noise


def test_the_output_does_not_depend_on_the_step_size() -> None:
    def output(steps: list[int]) -> bytes:
        device = make(baud=921600, rate=50)
        ask(device, "VNWRG,75,1,3,07,0021,0001,00C1")
        return b"".join(message for tick in steps for _, message in device.advance(tick))

    whole = output([20_000])
    rng = np.random.default_rng(2)
    assert output([*np.cumsum(rng.integers(1, 600, 60)).tolist(), 20_000]) == whole
    assert output([*range(4, 2400, 4), 20_000]) == whole


def relative(sigma: Floats, truth: float, count: int) -> float:
    """Deviation of the axes' mean from the truth, in its own standard errors."""
    return float((sigma.mean() / truth - 1.0) * math.sqrt(2.0 * 3.0 * count))


def test_the_moving_average_aliases_and_the_increments_do_not() -> None:
    averaged = make(rate=40, warm_up=0.0)
    ask(averaged, "VNWRG,06,19")
    gyro = columns(averaged.advance(600 * LOOP_RATE), "gyro")
    assert abs(relative(gyro.std(axis=0), 6.1e-5 * math.sqrt(LOOP_RATE / 4), len(gyro))) < 4.0

    ask(averaged, "VNWRG,85,0,20,20,4,0,0,3,3,3,0")  # a window as long as the interval
    gyro = columns(averaged.advance(1200 * LOOP_RATE), "gyro")
    assert gyro.std(axis=0).mean() == pytest.approx(6.1e-5 * math.sqrt(40), rel=0.03)

    deltas = make(rate=0, warm_up=0.0)
    ask(deltas, "VNWRG,75,1,20,06,0001,00C0")
    gyro = columns(deltas.advance(600 * LOOP_RATE), "gyro")[1:]
    assert abs(relative(gyro.std(axis=0), 6.1e-5 * math.sqrt(40), len(gyro))) < 4.0


# ---------------------------------------------------------------- the terminal


def test_the_emulator_exits_with_its_parent() -> None:
    code = "import time; from imumon.sources.vn100.emulator import spawn; print(spawn().pid, flush=True); "
    code += "time.sleep(60)"
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = Path(f"/proc/{int(parent.stdout.readline())}/stat")
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    until(lambda: not child.exists() or "Z" in child.read_text().split()[2])


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_signals_end_the_emulator_and_remove_the_link(number: int, code: int, tmp_path: Path) -> None:
    link = tmp_path / "vn100"
    process = forked.ForkedModule("imumon", "sim", "--link", str(link))
    path = process.stdout.readline().strip()
    assert os.readlink(link) == path
    process.send_signal(number)
    assert process.wait(60) == code
    assert not link.is_symlink()
    process.stdout.close()


def test_a_link_replaces_no_other_file_and_no_terminal_in_use(tmp_path: Path) -> None:
    kept, link = tmp_path / "kept", tmp_path / "vn100"
    kept.write_text("mine")
    with spawn(EmulatorSettings(seed=1, link=str(link))) as sensor:
        for place in (kept, link):
            done = forked.run("sim", "--link", str(place))
            assert (done.returncode, done.stdout) == (2, "")
            assert str(place) in done.stderr
            assert done.stderr.count("\n") == 1
        assert os.readlink(link) == sensor.path
        # The kernel gives the number of a closed terminal again, perhaps to another test at once:
        # this stale link names a terminal that no system has.
        link.unlink()
        link.symlink_to("/dev/pts/4000000000")
        with spawn(EmulatorSettings(seed=1, link=str(link))) as successor:
            assert os.readlink(link) == successor.path
            link.unlink()
            link.symlink_to("elsewhere")
    assert os.readlink(link) == "elsewhere"
    assert kept.read_text() == "mine"
