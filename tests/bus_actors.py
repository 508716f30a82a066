"""Actors for the tests of the bus: a daemon and a subscriber in processes of their own.

Run as ``python -m bus_actors ROLE JSON``. An actor prints one JSON object per line, the first one when it is
ready, and executes the lines that it reads.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from forked import ForkedModule
from waiting import until

from imumon.model.coefficients import Estimate
from imumon.model.report import (
    Allan,
    Channel,
    DeviceDescription,
    Event,
    Report,
    SensorGrade,
    SessionCounters,
    Signal,
    Strip,
)

CHANNELS = tuple(f"{sensor}/{axis}" for sensor in ("gyro", "accel", "mag") for axis in "xyz")
UNIT = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss", "temperature": "degC"}
TIME = "2026-01-02T03:04:05.678Z"


def report(id: str, number: int, *, octaves: int = 19, grade: str = "industrial") -> Report:
    """A report of the usual size; `number` is the count of samples, which identifies it."""
    noise = Estimate(value=1e-4, low=9e-5, high=2e-4, status="measured", unit="rad/s/sqrt(Hz)")
    curve = Allan(
        tau_s=tuple(0.01 * 2.0**k for k in range(octaves)),
        sigma=(1e-3,) * octaves,
        low=(9e-4,) * octaves,
        high=(None,) * octaves,
        edf=(3.5,) * octaves,
        model=(1e-3,) * octaves,
        noise=(1e-3,) * octaves,
        used=(True,) * octaves,
    )
    channels = {
        name: Channel(
            unit=UNIT[name.partition("/")[0]], count=number, mean=0.5, coefficients={"N": noise}, allan=curve
        )
        for name in CHANNELS
    }
    channels["temperature"] = Channel(unit="degC", count=number, mean=25.0)
    return Report(
        time=TIME,
        device=DeviceDescription(id=id),
        state="running",
        session=SessionCounters(samples=number, started=TIME),
        grade={"gyro": SensorGrade(meets=grade), "accel": SensorGrade(meets="consumer")},
        channels=channels,
    )


def event(id: str, number: int) -> Event:
    return Event(time=TIME, kind="gap", text=f"gap {number}", device=id)


def make_signal(channel: str, number: int, columns: int = 1) -> Signal:
    strip = Strip(start_s=0.0, column_s=1.0, low=(0.0,) * columns, high=(float(number),) * columns)
    return Signal(channel=channel, unit=UNIT[channel.partition("/")[0]], minute=strip)


def emit(**values: Any) -> None:
    print(json.dumps(values), flush=True)


def daemon(
    id: str,
    listen: list[str],
    connect: list[str],
    period: float,
    octaves: int,
    columns: int = 1,
    **settings: Any,
) -> None:
    """Publishes a report every `period` seconds, or one alone (0), until it reads `stop`."""
    from imumon.bus import BusError, Publisher
    from imumon.config import ZenohSettings

    try:
        publisher = Publisher(id, ZenohSettings(listen=listen, connect=connect, **settings))
    except BusError as error:
        emit(error=error.code)
        return
    stop = threading.Event()
    longest, number = 0.0, 0

    def publish() -> None:
        nonlocal longest, number
        number += 1
        data, signals = (
            report(id, number, octaves=octaves),
            {"gyro/x": partial(make_signal, "gyro/x", number, columns)},
        )
        start = time.perf_counter()
        publisher.publish(data, signals)
        longest = max(longest, time.perf_counter() - start)

    def loop() -> None:
        publish()
        while period and not stop.wait(period):
            publish()

    thread = threading.Thread(target=loop)
    thread.start()
    emit(ready=True, pid=os.getpid(), endpoints=publisher.endpoints)
    for line in sys.stdin:
        command, _, rest = line.strip().partition(" ")
        if command == "events":
            for index in range(int(rest)):
                publisher.event(event(id, index))
        elif command == "state":
            emit(longest=longest, error=publisher.last_error, uplinks=publisher.uplink_errors())
        elif command == "stop":
            break
    stop.set()
    thread.join()
    number = 10**6 - 1
    publish()
    start = time.perf_counter()
    publisher.close()
    emit(closed_s=time.perf_counter() - start, longest=longest)


def subscriber(connect: list[str], **settings: Any) -> None:
    """Prints the number of each report that it gets."""
    from imumon.bus import Subscriber
    from imumon.config import ZenohSettings

    with Subscriber(connect, settings=ZenohSettings(**settings)) as reader:
        emit(ready=True, pid=os.getpid())
        over = threading.Event()
        threading.Thread(target=lambda: (sys.stdin.readline(), over.set()), daemon=True).start()
        received = -1
        while not over.wait(0.005):
            if reader.version != received:
                received = reader.version
                numbers = {id: newest.session.samples for id, (newest, _) in reader.reports().items()}
                emit(numbers=numbers, at=time.monotonic())


class Actor:
    """A process with a role; a thread reads what it prints."""

    def __init__(self, role: str, **arguments: Any) -> None:
        self.process = ForkedModule("bus_actors", role, json.dumps(arguments))
        self.messages: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        for line in self.process.stdout:
            self.messages.append(json.loads(line))

    def ready(self) -> Actor:
        until(lambda: self.messages or self.process.poll() is not None)
        assert self.messages, "the actor has ended; its standard error says why"
        return self

    def send(self, line: str) -> None:
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def request(self, line: str) -> dict[str, Any]:
        before = len(self.messages)
        self.send(line)
        until(lambda: len(self.messages) > before)
        return self.messages[-1]

    def kill(self, number: int = signal.SIGKILL) -> None:
        self.process.send_signal(number)
        if number == signal.SIGKILL:
            self.process.wait(60)

    def end(self) -> None:
        self.process.kill()
        self.process.wait(60)
        self._thread.join(60)
        with suppress(OSError):
            self.process.stdin.close()
        self.process.stdout.close()


@contextmanager
def stage() -> Iterator[Callable[..., Actor]]:
    """Yield a function that starts actors by role; all are ended on exit."""
    actors: list[Actor] = []

    def start(role: str, **arguments: Any) -> Actor:
        if role == "daemon":
            arguments = {"id": "a", "listen": [], "connect": [], "period": 0.05, "octaves": 19} | arguments
        actors.append(Actor(role, **arguments))
        return actors[-1]

    try:
        yield start
    finally:
        for actor in actors:
            actor.end()


if __name__ == "__main__":
    {"daemon": daemon, "subscriber": subscriber}[sys.argv[1]](**json.loads(sys.argv[2]))
