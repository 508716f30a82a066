"""Fleet: many daemons, one router, one subscriber; cost, latency and completeness.

    python benchmarks/fleet.py [--daemons 20] [--period 1.0] [--seconds 20]

Every daemon is a process that publishes the report of a day (nine channels, all curves) through a router in
another process. The subscriber is read 50 times a second. Latency is from the call of `publish` to the
arrival, on the monotonic clock of this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from imumon.bus import Publisher, Subscriber
from imumon.report import Report, SessionCounters, from_json
from imumon.report_json import to_json

EXAMPLE = Path(__file__).parents[1] / "docs" / "example" / "report.json"


def report(id: str) -> Report:
    """Return the report of a day, with all its curves."""
    made = from_json(Report, EXAMPLE.read_text())
    return replace(made, device=replace(made.device, id=id))


def cost(start_s: float) -> dict[str, float]:
    """Return CPU seconds of the process, seconds since `start_s`, and the largest resident memory."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "wall_s": time.monotonic() - start_s,
        "rss_mb": usage.ru_maxrss / 1024,
    }


def measured(wait: Any) -> dict[str, float]:
    """Return the cost of what happens during `wait`, in percent of a core."""
    start_s, before = time.monotonic(), cost(0.0)["cpu_s"]
    wait()
    after = cost(start_s)
    return {"cpu_percent": 100 * (after["cpu_s"] - before) / after["wall_s"], "rss_mb": after["rss_mb"]}


def play_daemon(id: str, place: str, socket_path: str, period: float, seconds: float) -> None:
    template = report(id)
    with Publisher(id, listen=[f"unixsock-stream/{socket_path}"], connect=[place]) as publisher:
        sent = 0

        def loop() -> None:
            nonlocal sent
            start = time.monotonic()
            while (now := time.monotonic()) - start < seconds:
                sent += 1
                session = SessionCounters(samples=sent, received_bytes=time.monotonic_ns())
                publisher.publish(replace(template, session=session))
                time.sleep(max(0.0, start + sent * period - now))

        result = measured(loop)
        time.sleep(1.0)  # until the last report has arrived
        print(json.dumps({"sent": sent, **result}), flush=True)


def play_router(port: int) -> None:
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    with zenoh.open(config):
        print(json.dumps({"ready": True}), flush=True)
        sys.stdin.readline()
        print(json.dumps(measured(sys.stdin.readline)), flush=True)


def start(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, __file__, "--play", *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def run(daemons: int, period: float, seconds: float) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    place = f"tcp/127.0.0.1:{port}"
    router = start("router", port)
    assert router.stdin
    assert router.stdout
    router.stdout.readline()
    with tempfile.TemporaryDirectory() as folder, Subscriber([place]) as subscriber:
        fleet = [
            start("daemon", f"d{n:02}", place, Path(folder) / f"{n}.sock", period, seconds)
            for n in range(daemons)
        ]
        seen: dict[str, set[int]] = {}
        latencies: list[float] = []

        def watch() -> None:
            end = time.monotonic() + seconds - 1.0
            while time.monotonic() < end:
                collect(subscriber, seen, latencies)

        while len(subscriber.reports()) < daemons:
            collect(subscriber, seen, latencies)
        router.stdin.write("begin\n")
        router.stdin.flush()
        own = measured(watch)
        router.stdin.write("end\n")
        router.stdin.flush()
        while any(p.poll() is None for p in fleet):
            collect(subscriber, seen, latencies)
        ends = [json.loads(p.communicate()[0]) for p in fleet]
        middle = json.loads(router.communicate()[0].splitlines()[-1])
    sent, got = sum(end["sent"] for end in ends), sum(len(numbers) for numbers in seen.values())
    latencies = sorted(latencies)
    share = [end["cpu_percent"] for end in ends]
    size, late = len(to_json(report("d00"))) / 1000, latencies[len(latencies) * 99 // 100]
    middle_ms = statistics.median(latencies)
    memory = statistics.mean(end["rss_mb"] for end in ends)
    print(f"{daemons} daemons, a report of {size:.1f} kB every {period:g} s, {os.cpu_count()} cores")
    print(f"  reports: sent {sent}, seen {got}, lost or replaced by the next {sent - got}")
    print(f"  latency, ms: median {middle_ms:.2f}, 99 % {late:.2f}, most {latencies[-1]:.2f}")
    print(f"  CPU, percent of a core: daemon {statistics.mean(share):.2f} (most {max(share):.2f}), ", end="")
    print(f"router {middle['cpu_percent']:.2f}, subscriber {own['cpu_percent']:.2f}")
    print(f"  memory, MB: daemon {memory:.0f}, router {middle['rss_mb']:.0f}, subscriber {own['rss_mb']:.0f}")
    idle = [f"tcp/127.0.0.1:{port + n if port < 60000 else port - n}" for n in range(16)]
    with Subscriber(idle):
        waiting = measured(lambda: time.sleep(10.0))
    print(f"  CPU of a subscriber that tries 16 endpoints without a daemon: {waiting['cpu_percent']:.2f}")


def collect(subscriber: Subscriber, seen: dict[str, set[int]], latencies: list[float]) -> None:
    time.sleep(0.02)
    for id, (got, arrived) in subscriber.reports().items():
        numbers = seen.setdefault(id, set())
        if got.session.samples not in numbers:
            numbers.add(got.session.samples)
            latencies.append(1e3 * (arrived - got.session.received_bytes * 1e-9))


def main() -> None:
    if sys.argv[1:2] == ["--play"]:
        if sys.argv[2] == "router":
            play_router(int(sys.argv[3]))
        else:
            id, place, path, period, seconds = sys.argv[3:]
            play_daemon(id, place, path, float(period), float(seconds))
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--daemons", type=int, default=20)
    parser.add_argument("--period", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    run(options.daemons, options.period, options.seconds)


if __name__ == "__main__":
    main()
