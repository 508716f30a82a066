"""Strangers on the bus and at the port: whatever they say, ask and hold, the daemon measures on."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
import serial
from laws import ON_THE_WAY, Fault
from scene import scene

pytestmark = pytest.mark.slow


@pytest.mark.slow
def test_21_port_is_taken_while_the_sensor_was_away(tmp_path: Path) -> None:
    """Who has it is told once; as soon as it is free the record goes on."""
    with scene(tmp_path, seed=21) as play:
        before = play.calm()
        play.sensor.ask("unplug")
        play.daemon.wait(lambda r: r.state == "waiting")
        play.daemon.process.send_signal(signal.SIGSTOP)  # the other one is quicker
        play.sensor.ask("replug")
        with serial.Serial(play.port, exclusive=True):
            play.daemon.process.send_signal(signal.SIGCONT)
            play.daemon.wait(
                lambda r: any(f"({os.getpid()})" in event.text for event in play.events("waiting"))
            )
        after = play.calm()
        assert len(play.events("waiting")) == 1
        play.end(before, after, Fault(on_the_way=ON_THE_WAY))
