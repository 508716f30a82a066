"""What the emulated device sends: its streams, and the noise of its sensors."""

from __future__ import annotations

import math

import numpy as np
import pytest
import vn100_wire as wire
from vn100_emulated import ask, blocks, columns, make, save

from imumon.devices.vn100.binary import GROUPS, BinaryLayout
from imumon.devices.vn100.emulator import EmulatorSettings
from imumon.devices.vn100.emulator.command_handler import CommandHandler
from imumon.devices.vn100.emulator.sensor_model import SensorModel
from imumon.devices.vn100.registers import (
    BINARY_OUTPUTS,
    LOOP_RATE,
    OUTPUT_TYPES,
)
from imumon.samples import Floats

# ---------------------------------------------------------------- streams


@pytest.mark.parametrize("kind", [k for k in OUTPUT_TYPES if k != 9])
def test_every_sentence_is_valid_and_has_its_rate(kind: int) -> None:
    device = make(baud=921600)
    ask(device, f"VNWRG,06,{kind}")
    messages = device.advance(LOOP_RATE)
    assert [tick for tick, _ in messages] == list(range(0, LOOP_RATE, 20))
    for _, message in messages:
        assert wire.unframe(message)[0] == OUTPUT_TYPES[kind]


def test_the_factory_sentence_is_as_long_as_the_real_one() -> None:
    assert {len(message) for _, message in make().advance(800)} == {122}


@pytest.mark.parametrize("group", GROUPS)
def test_every_binary_field_is_sent(group: int) -> None:
    device = make(baud=921600, rate=0)
    for bit, entry in GROUPS[group].items():
        assert ask(device, f"VNWRG,76,1,80,{1 << (group - 1):02X},{1 << bit:04X}").startswith("VNWRG,76")
        layout = BinaryLayout.of({group: 1 << bit})
        messages = device.advance(device.outputs.tick + 800)
        assert len(messages) == 10
        packets = layout.decode(b"".join(message for _, message in messages), count=10)
        assert layout.count_valid(b"".join(message for _, message in messages), 0, 10) == 10
        assert np.isfinite(packets[f"{group}.{entry.name}"].astype(float)).all()
        assert group not in (4, 6, 7) or not packets[f"{group}.{entry.name}"].any()


def test_streams_interleave_at_message_boundaries_in_order() -> None:
    device = make(baud=921600, rate=200)
    ask(device, "VNWRG,75,1,4,01,0739")
    messages = device.advance(800)
    assert [tick for tick, _ in messages] == sorted(tick for tick, _ in messages)
    kinds = [message[:1] for _, message in messages]
    assert (kinds.count(b"$"), kinds.count(b"\xfa")) == (200, 200)


def test_the_output_does_not_depend_on_the_step_size() -> None:
    def output(steps: list[int]) -> bytes:
        device = make(baud=921600, rate=50)
        ask(device, "VNWRG,75,1,3,07,0021,0001,00C1")
        return b"".join(message for tick in steps for _, message in device.advance(tick))

    whole = output([20_000])
    rng = np.random.default_rng(2)
    assert output([*np.cumsum(rng.integers(1, 600, 60)).tolist(), 20_000]) == whole
    assert output([*range(4, 2400, 4), 20_000]) == whole


def test_pausing_stops_ascii_and_binary() -> None:
    device = make(baud=921600)
    ask(device, "VNWRG,75,1,8,01,0001")
    ask(device, "VNASY,0")
    assert device.advance(800) == []
    assert ask(device, "VNRRG,01") == "VNRRG,01,VN-100T-CR"
    ask(device, "VNASY,1")
    assert len(device.advance(1600)) == 140


def test_the_other_serial_port_has_its_own_outputs() -> None:
    device = make(rate=0, baud=921600, serial_port=2)
    assert ask(device, "VNRRG,05,?") == "VNRRG,05,921600,2"
    ask(device, "VNWRG,75,1,40,01,0001")
    assert device.advance(800) == []
    ask(device, "VNWRG,75,2,40,01,0001")
    assert len(device.advance(1600)) == 20


def test_a_binary_output_can_be_polled() -> None:
    device = make(rate=0)
    device.advance(800)
    ask(device, "VNWRG,77,1,0,01,0001")
    device.receive(b"$VNBOM,03*XX\r\n", 1.0)
    (packet,) = device.replies(1.0)
    assert BinaryLayout.of({1: 1}).count_valid(packet, 0, 1) == 1
    assert device.advance(1600) == []


def test_appended_fields_and_checks() -> None:
    device = make(rate=40)
    ask(device, "VNWRG,32,3,0,0,0,1,1,0,100000000,0")
    ask(device, "VNWRG,30,3,1,0,0,3,0,1")
    ask(device, "VNKMD,1")
    messages = [message for _, message in device.advance(1600)]
    fields = [message.partition(b"*")[0].split(b",")[-2:] for message in messages]
    counts = np.array([int(count[1:]) for count, _ in fields])
    assert (np.diff(counts) == 20).all()
    assert {status for _, status in fields} == {b"S0800"}
    assert {len(message) for message in messages} == {122 + 12 + 6 + 2}
    ask(device, "VNWRG,33,0,0,0")
    assert ask(device, "VNRRG,33") == "VNRRG,33,0,0,0"
    device.advance(device.outputs.tick + 100)
    assert ask(device, "VNRRG,33") == "VNRRG,33,0,0,100"


# ---------------------------------------------------------------- signals


def relative(sigma: Floats, truth: float, count: int) -> float:
    """Deviation of the axes' mean from the truth, in its own standard errors."""
    return float((sigma.mean() / truth - 1.0) * math.sqrt(2.0 * 3.0 * count))


def test_the_moving_average_aliases_and_the_increments_do_not() -> None:
    constant = {"warm_up": 0.0}
    uncompensated = make(rate=40, **constant)
    ask(uncompensated, "VNWRG,06,19")
    gyro = columns(uncompensated.advance(600 * LOOP_RATE), "gyro")
    # The bandwidth of the element removes a part of the variance of the 5 ms average.
    a = (1.0 - math.sqrt(0.5)) / (2.0 * (1.0 - math.cos(2.0 * math.pi * 256.0 / LOOP_RATE)))
    taps = np.convolve([a, 1 - 2 * a, a], np.full(4, 0.25))
    measured = 6.1e-5 * math.sqrt(LOOP_RATE * float(np.sum(taps**2)))
    assert abs(relative(gyro.std(axis=0), measured, len(gyro))) < 4.0
    assert measured / math.sqrt(40) / 6.1e-5 == pytest.approx(math.sqrt(5), rel=0.06)

    deltas = make(rate=0, **constant)
    ask(deltas, "VNWRG,75,1,20,06,0001,00C0")
    gyro = columns(deltas.advance(600 * LOOP_RATE), "gyro")[1:]
    assert abs(relative(gyro.std(axis=0), 6.1e-5 * math.sqrt(40), len(gyro))) < 4.0


def test_a_matched_window_removes_the_aliasing() -> None:
    device = make(rate=40, warm_up=0.0)
    ask(device, "VNWRG,06,19")
    ask(device, "VNWRG,85,0,20,20,4,0,0,3,3,3,0")
    gyro = columns(device.advance(600 * LOOP_RATE), "gyro")
    assert gyro.std(axis=0).mean() == pytest.approx(6.1e-5 * math.sqrt(40), rel=0.03)
    ask(device, "VNWRG,85,0,0,0,0,0,0,3,3,3,0")
    gyro = columns(device.advance(1200 * LOOP_RATE), "gyro")
    a = (1.0 - math.sqrt(0.5)) / (2.0 * (1.0 - math.cos(2.0 * math.pi * 256.0 / LOOP_RATE)))
    unfiltered = 6.1e-5 * math.sqrt(LOOP_RATE * (2 * a * a + (1 - 2 * a) ** 2))
    assert abs(relative(gyro.std(axis=0), unfiltered, len(gyro))) < 4.0


def test_increments_add_up_with_any_reset() -> None:
    def total(*outputs: str) -> Floats:
        device = make(rate=0, baud=921600)
        for command in outputs:
            ask(device, command)
        layout = BinaryLayout.of({3: 0x00C0})
        data = b"".join(message for _, message in device.advance(8000))
        packets = layout.decode(data, count=len(data) // layout.length)
        return (
            np.concatenate((packets["3.deltaTheta"], packets["3.deltaVel"]), axis=1).astype(float).sum(axis=0)
        )

    slow = total("VNWRG,75,1,50,04,00C0")
    fast = total("VNWRG,75,1,10,04,00C0")
    # The last slow packet ends at tick 7950, the last fast one 40 ticks later.
    assert slow[0] == pytest.approx(7951 / LOOP_RATE, rel=1e-6)
    assert fast[0] == pytest.approx(7991 / LOOP_RATE, rel=1e-6)
    assert fast[6] - slow[6] == pytest.approx(-9.793746 * 40 / LOOP_RATE, rel=0.01)
    two = total("VNWRG,75,1,50,04,00C0", "VNWRG,76,1,10,04,00C0")
    assert two[0] == pytest.approx(7991 / LOOP_RATE + 160 * 10 / LOOP_RATE, rel=0.01)


def test_polling_the_increments_resets_them() -> None:
    device = make(rate=0)
    device.advance(400)
    assert float(ask(device, "VNRRG,80").split(",")[2]) == pytest.approx(0.5, abs=0.002)
    device.advance(480)
    assert float(ask(device, "VNRRG,80").split(",")[2]) == pytest.approx(0.1, abs=0.002)


def test_the_bias_is_subtracted_from_the_compensated_rate() -> None:
    device = make(rate=0, baud=921600)
    ask(device, "VNWRG,75,1,4,05,0020,0008")
    layout = BinaryLayout.of({1: 0x20, 3: 0x08})
    data = b"".join(message for _, message in device.advance(120 * LOOP_RATE))
    packets = layout.decode(data, count=len(data) // layout.length)[-20_000:]
    bias = packets["3.uncompGyro"].astype(float).mean(axis=0)
    rest = packets["1.angularRate"].astype(float).mean(axis=0)
    assert (np.abs(bias) > 5e-3).all()
    assert (np.abs(rest) < 5e-5).all()
    spread = packets["1.angularRate"].std(axis=0) / packets["3.uncompGyro"].std(axis=0)
    assert spread == pytest.approx(np.ones(3), abs=0.01)


def test_the_magnetometer_repeats_its_readings_and_has_mains_hum() -> None:
    device = make(rate=0, baud=921600, hum=0.02, hum_hz=50.0)
    ask(device, "VNWRG,75,1,1,04,0002")
    layout = BinaryLayout.of({3: 0x02})
    data = b"".join(message for _, message in device.advance(8000))
    field = layout.decode(data, count=8000)["3.uncompMag"].astype(float)
    assert (np.diff(field[:, 0]) == 0).mean() == pytest.approx(1 - 250 / 800, abs=0.01)
    spectrum = np.abs(np.fft.rfft(field[:, 0] - field[:, 0].mean())) ** 2
    assert np.fft.rfftfreq(8000, 1 / 800)[spectrum.argmax()] == pytest.approx(50.0)


def test_calibrations_apply_to_uncompensated_outputs_too() -> None:
    device = make(rate=0, baud=921600, warm_up=0.0)
    ask(device, "VNWRG,75,1,8,04,00CE")
    layout = BinaryLayout.of({3: 0xCE})

    def means(seconds: int) -> dict[str, Floats]:
        data = b"".join(message for _, message in device.advance(device.outputs.tick + seconds * LOOP_RATE))
        packets = layout.decode(data, count=len(data) // layout.length)[1:]
        return {name: packets[name].astype(float).mean(axis=0) for name in layout.fields}

    before = means(20)
    ask(device, "VNWRG,84,1,0,0,0,1,0,0,0,1,0.5,0,0")
    ask(device, "VNWRG,25,1,0,0,0,2,0,0,0,1,0,0,0")
    ask(device, "VNWRG,23,0,1,0,1,0,0,0,0,1,0,0,0")
    means(1)
    after = means(20)
    assert after["3.uncompGyro"][0] - before["3.uncompGyro"][0] == pytest.approx(-0.5, abs=1e-4)
    rotation = after["3.deltaTheta"][1] - before["3.deltaTheta"][1]
    assert rotation == pytest.approx(math.degrees(-0.5) * 0.01, rel=1e-3)
    assert after["3.uncompAccel"][1] == pytest.approx(2 * before["3.uncompAccel"][1], abs=5e-3)
    assert after["3.uncompMag"][:2] == pytest.approx(before["3.uncompMag"][1::-1], abs=2e-3)


def test_the_reference_frame_changes_after_saving_and_a_reset() -> None:
    device = make()
    ask(device, "VNWRG,26,1,0,0,0,-1,0,0,0,-1")
    device.advance(800)
    assert float(ask(device, "VNRRG,18").split(",")[4]) < -9
    save(device, 0.0)
    ask(device, "VNRST", now=1.0)
    device.replies(3.0)
    device.advance(1600)
    assert float(ask(device, "VNRRG,18", now=3.0).split(",")[4]) > 9


def test_the_warm_up_changes_the_bias() -> None:
    device = make(rate=0, warm_up=10.0, warm_up_s=60.0, gyro_thermal=1e-4)
    ask(device, "VNWRG,75,1,8,04,0018")
    layout = BinaryLayout.of({3: 0x18})
    data = b"".join(message for _, message in device.advance(300 * LOOP_RATE))
    packets = layout.decode(data, count=len(data) // layout.length)
    temperature = packets["3.temp"].astype(float).ravel()
    assert temperature[-100:].mean() - temperature[:10].mean() == pytest.approx(10.0, abs=0.2)
    rate = packets["3.uncompGyro"].astype(float)
    assert rate[-2000:].mean(axis=0) - rate[:200].mean(axis=0) == pytest.approx(np.full(3, 1e-3), rel=0.1)


def test_the_startup_bias_is_saved_on_command() -> None:
    device = make()
    device.advance(60 * LOOP_RATE)
    ask(device, "VNSGB")
    saved = [float(field) for field in ask(device, "VNRRG,43").split(",")[2:]]
    assert saved == pytest.approx([0.0152, -0.0113, -0.0064], abs=2e-4)


def test_time_stamps_are_whole_microseconds_with_jitter() -> None:
    device = make(rate=800, baud=921600)
    time = np.concatenate([b.time_ns for b in blocks(device.advance(8000)) if b.time_ns is not None])
    assert (time % 1000 == 0).all()
    error = np.diff(time) - 1_250_000
    assert error.std() / 1000 == pytest.approx(4.7 * math.sqrt(2), rel=0.05)


def test_the_same_seed_gives_the_same_output() -> None:
    one, two, other = (
        CommandHandler(EmulatorSettings(seed=s), SensorModel(EmulatorSettings(seed=s))) for s in (1, 1, 2)
    )
    first = one.advance(4000)
    assert first == two.advance(4000)
    assert first != other.advance(4000)


def test_too_many_outputs_are_refused() -> None:
    device = make(baud=9600, rate=5)
    for number in BINARY_OUTPUTS:
        answer = ask(device, f"VNWRG,{number},1,400,01,0739")
        assert answer.startswith(("VNWRG", "VNERR,0C"))
    assert device.outputs.bytes_per_second() <= 960
