"""Faults of the cable: unplugged, loose, noisy."""

from __future__ import annotations

from pathlib import Path

import pytest
from laws import ON_THE_WAY, PACKET, Fault
from scene import scene

pytestmark = pytest.mark.slow


def test_01_unplug_and_replug(tmp_path: Path) -> None:
    with scene(tmp_path, seed=1) as play:
        before = play.calm()
        play.sensor.ask("unplug")
        play.daemon.wait(lambda r: r.state == "waiting")
        play.sensor.ask("replug")
        after = play.calm()
        assert after.report.session.gaps == 1
        kinds = [event.kind for event in play.events("connect", "disconnect")]
        assert kinds[-2:] == ["disconnect", "connect"]
        play.end(before, after, Fault(on_the_way=ON_THE_WAY))


def test_02_flapping_link(tmp_path: Path) -> None:
    flaps = 10
    with scene(tmp_path, seed=2) as play:
        before = play.calm()
        for _ in range(flaps):
            play.sensor.ask("unplug")
            play.sensor.ask("replug")
            play.calm(more=20)
        after = play.calm()
        assert 1 <= after.report.session.gaps <= flaps
        play.end(before, after, Fault(on_the_way=flaps * ON_THE_WAY))


@pytest.mark.parametrize("probability", [1e-4, 1e-2])
def test_03_corrupted_bytes(tmp_path: Path, probability: float) -> None:
    with scene(tmp_path, seed=3) as play:
        before = play.calm()
        begun = play.sensor.ask(f"fault corrupt={probability}")["made"]
        play.calm(more=200)
        exposed = play.sensor.ask("fault")["made"] - begun
        after = play.calm(more=250)  # a busy machine has damaged messages on the way
        damaged = 1.0 - (1.0 - probability) ** PACKET
        assert after.report.session.bad_checksums > 0 or damaged * exposed < 5
        play.end(before, after, Fault(exposed=exposed, damaged=damaged))


def test_04_found_through_noise(tmp_path: Path) -> None:
    """The line is bad from the start: the sensor is found, set up and left as it was, all the same."""
    with scene(tmp_path, seed=4, corrupt=2e-3) as play:
        begun = play.sensor.ask("counters")["made"]
        before = play.calm()
        after = play.calm(more=200)
        damaged = 1.0 - 0.998**PACKET
        exposed = after.told["made"] - begun
        play.end(before, after, Fault(exposed=exposed, damaged=damaged, lasting=True))
