"""Scene: emulator, daemon and subscriber, each a process of its own, and the laws at the end.

    with scene(tmp_path, seed=1) as play:
        before = play.calm()
        play.sensor.ask("unplug")            # the fault
        ...
        play.end(before, play.calm())        # the laws

The subscriber is the viewer of the test; whatever it waits for has gone over the bus.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import laws
from daemons import Daemon
from faulty_sensor import FaultySensorProcess, spawn
from usage import resident_kb

from imumon.model.report import Event, Report, from_json
from imumon.sources.vn100.emulator import EmulatorSettings

ID = "vn100-0100056785"
CONFIG = "[report]\nperiod_s = 0.25\n[state]\nsave_period_s = 1.0\n"
MOMENTS, MOST_MOMENTS = 3, 300
CATCHES_UP_S = 0.05
"""s by which a report is less late than the one before while the daemon works off what has waited for it."""
SETTLED_SAMPLES = 800
"""Samples that a new process takes before its first calm moment: by then it has saved and made fits some times. Without
a fault, it grows by 7 MB in these 8 s."""
STOP_S = 10.0
"""What the service unit grants; a clean stop takes half a second where the machine is free."""


class Scene:
    """What a scenario plays with.

    Attributes
    ----------
    folder, state, port : of this scenario; the port is a link that a new terminal moves along.
    away_s : s, how long there was no daemon, up to the first calm moment of the next.
    sensor : the emulator.
    daemon : the one that was started last.
    """

    def __init__(self, folder: Path, sensor: FaultySensorProcess, port: str, stack: ExitStack) -> None:
        self.folder, self.sensor, self.port = folder, sensor, port
        self.state = folder / "state"
        self._stack = stack
        self._config = folder / "config.toml"
        self.daemon: Daemon
        self.said = ""
        self.away_s = 0.0
        self._settled = True
        self._left: float | None = None

    def start(
        self,
        *words: str,
        before: Sequence[str] = (),
        environment: dict[str, str] | None = None,
        listen: str | None = None,
        settings: str = "",
    ) -> Daemon:
        """Start a daemon, on the state that is there, with more tables of settings."""
        self._config.write_text(CONFIG + settings)
        words = ("--config", str(self._config), "--json", *words)
        made = Daemon(self.port, self.state, *words, before=before, environment=environment, listen=listen)
        self.daemon, self._settled = self._stack.enter_context(made), False
        return self.daemon

    def calm(self, more: int = 60) -> laws.Moment:
        """Moment with so many samples more than now: of some, the one whose report came soonest."""
        now = self._running(1).session.samples
        self._running(now + more)
        if self._left is not None:
            self.away_s, self._left = self.away_s + time.monotonic() - self._left, None
        if not self._settled:
            more, self._settled = max(more, SETTLED_SAMPLES), True
        moments = [self._moment(now + more)]
        while len(moments) < MOMENTS or (len(moments) < MOST_MOMENTS and _catches_up(moments)):
            moments.append(self._moment(moments[-1].report.session.samples + 1))
        return min(moments, key=laws.Moment.late_s)

    def _running(self, samples: int) -> Report:
        return self.daemon.wait(lambda r: r.state == "running" and r.session.samples >= samples)

    def _moment(self, samples: int) -> laws.Moment:
        report = self._running(samples)
        return laws.Moment(report, self.sensor.ask("counters"), resident_kb(self.daemon.process.pid))

    def events(self, *kinds: str) -> list[Event]:
        """Events of these kinds that the subscriber has heard."""
        return [event for event in self.daemon.viewer.events(ID) if event.kind in kinds]

    def end(
        self, before: laws.Moment, after: laws.Moment, fault: laws.Fault | None = None, *, code: int = 0
    ) -> Report:
        """Stop the daemon and hold everything to the laws; its last report."""
        final = self.stop(code)
        told = self.sensor.ask("counters")
        fault = replace(fault or laws.Fault(), away_s=self.away_s)
        laws.hold(before, after, final, told["sent"] - told["replies"], fault)
        return final

    def kill(self) -> None:
        """What a power cut does to the daemon."""
        self._left = time.monotonic()
        _, _, self.said = self.daemon.stop(signal.SIGKILL)

    def stop(self, code: int = 0) -> Report:
        """Stop the daemon as a service manager does; its last report."""
        self._left = asked = time.monotonic()
        left, out, self.said = self.daemon.stop(signal.SIGTERM)
        assert left == code, self.said
        assert time.monotonic() - asked < STOP_S
        assert not list(self.state.glob("*.found.json"))  # the sensor has its own settings back
        final = from_json(Report, out)
        if (self.state / f"{ID}.state").exists():
            laws.is_kept(self.state / f"{ID}.state", final)
        return final


def _catches_up(moments: Sequence[laws.Moment]) -> bool:
    """Return whether a daemon on a busy machine still works off samples that have waited for it since its start."""
    *_, before, last = moments
    return last.late_s() < before.late_s() - CATCHES_UP_S


@contextmanager
def scene(
    folder: Path, *, seed: int, start: bool = True, corrupt: float = 0.0, **settings: Any
) -> Iterator[Scene]:
    """A sensor at rest, and a daemon that reads it."""
    folder.mkdir(exist_ok=True)
    port = str(folder / "sensor")
    words: dict[str, Any] = {**laws.WHITE, "warm_up": 0.0, "gyro_thermal": 0.0, "link": port, **settings}
    with ExitStack() as stack:
        sensor = stack.enter_context(spawn(EmulatorSettings(seed=seed, **words), corrupt=corrupt))
        play = Scene(folder, sensor, port, stack)
        if start:
            play.start()
        yield play
