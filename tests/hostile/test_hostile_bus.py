"""Other programs on the bus: the daemon measures on in bounded memory, and viewers show what is from the daemon.

Every attack was tried against an earlier version. The inputs are in `corpus_bus.py`, and the processes that attack in
`attackers.py`.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import attackers
import forked
import pytest
import zenoh
from attackers import attacking, resident_mb
from bus_actors import Actor, event, free_endpoint, report, stage
from corpus import through
from corpus_bus import CRAFTED
from daemons import Daemon
from faulty_sensor import spawn
from free_ports import free_port
from hostile_input import Hostile
from waiting import until
from zenoh import ext

from imumon.bus import Publisher, Subscriber, device_states
from imumon.model.report_json import to_json
from imumon.sources.vn100.emulator import EmulatorSettings

TARGET_MB = 150.0
"""MB resident that a daemon may take during all attacks at once."""
GROWTH_MB = 40.0
"""MB that it may take more during one attack."""
needs_proc = pytest.mark.skipif(
    not Path("/proc/self/statm").exists(),
    reason="there is no /proc, from which the memory of a process is read",
)


@contextmanager
def publisher(**settings: object) -> Iterator[tuple[Actor, str, Callable[..., Actor]]]:
    """A daemon of the bus alone, its endpoint, and what starts other actors."""
    with stage() as start:
        address = free_endpoint()
        yield start("daemon", listen=[address], **settings).ready(), address, start


def foreign(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


@pytest.fixture
def router() -> Iterator[str]:
    """Endpoint of a router that lets everybody publish."""
    with stage() as start:
        port = free_port()
        start("router", port=port).ready()
        yield f"tcp/127.0.0.1:{port}"


def command(*arguments: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    done = forked.run(*arguments, timeout=timeout)
    assert "Traceback" not in done.stderr
    assert "\x1b" not in done.stdout + done.stderr
    return done


# ---------------------------------------------------------------------- the corpus


@needs_proc
@pytest.mark.parametrize("hostile", through("query"))
def test_queries_and_messages_take_bounded_memory(hostile: Hostile, tmp_path: Path) -> None:
    with publisher(period=1.0) as (daemon, address, _):
        before, most = resident_mb(daemon.process.pid), 0.0
        with attacking(address, "a", 2.0, hostile.make(tmp_path)) as done:
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                most = max(most, resident_mb(daemon.process.pid))
                time.sleep(0.02)
        assert done[0] > 5
        assert most - before < GROWTH_MB
        assert daemon.request("state")["error"] is None
        with Subscriber([address]) as viewer:
            until(lambda: viewer.reports() and viewer.reports()["a"][0].session.samples >= 3)


def test_a_hostile_message_is_ignored_and_counted(router: str, tmp_path: Path) -> None:
    with Subscriber([router]) as viewer, foreign(router) as attacker:
        until(viewer.connected)
        until(lambda: attacker.put("imumon/b/report", to_json(report("b", 5))) or viewer.reports())
        until(lambda: attacker.put("imumon/b/event", to_json(event("b", 1))) or viewer.events("b"))
        tokens = []
        for parameter in through("message"):
            key, text = parameter.values[0].make(tmp_path)
            before = viewer.malformed
            if text is None:
                tokens.append(attacker.liveliness().declare_token(f"imumon/{key}"))
            else:
                attacker.put(f"imumon/{key}", text)
            # a report is parsed when it is asked for
            until(lambda before=before: viewer.reports() and viewer.malformed > before)
            shown = {name: entry[0] for name, entry in viewer.reports().items()}
            assert shown == {"b": report("b", 5)}, parameter.id
            assert viewer.events("a") == [], parameter.id
            assert viewer.events("b") == [event("b", 1)], parameter.id
            assert viewer.alive() == set(), parameter.id


@pytest.mark.parametrize("hostile", through("command"))
def test_commands_print_no_escape_sequences_and_no_traceback(
    router: str, hostile: Hostile, tmp_path: Path
) -> None:
    tokens, publishers = [], []
    with foreign(router) as attacker:
        for name, text in CRAFTED.items():
            tokens.append(attacker.liveliness().declare_token(f"imumon/{name}/alive"))
            publishers.append(
                ext.declare_advanced_publisher(
                    attacker, f"imumon/{name}/report", cache=ext.CacheConfig(1), publisher_detection=True,
                    sample_miss_detection=ext.MissDetectionConfig(),
                )
            )  # fmt: skip
            publishers[-1].put(text)
        done = command(*hostile.make(tmp_path), "--connect", router)
        assert str(done.returncode) == hostile.outcome
        assert "owned" not in done.stderr
        assert hostile.says in done.stdout
        publishers.clear()


# ---------------------------------------------------------------------- attacks on a daemon


def _attack_together(tmp_path: Path, seconds: float) -> None:
    """Attack in every way at once; no sample is lost, memory is bounded, and viewers work."""
    ways = (*attackers.WAYS, attackers.stopped, attackers.stopped)
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path, "--id", "a") as daemon:
        daemon.samples(100)
        # while the emulator stalls, every sample that it has sent can be counted
        counted = sensor.ask("stall 600")
        time.sleep(2.2)
        first = daemon.samples()
        sensor.ask("stall 0")
        daemon.samples(first.session.samples + 200)
        most = 0.0
        with attacking(daemon.endpoint, "a", seconds, *ways) as done:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                most = max(most, resident_mb(daemon.process.pid))
                time.sleep(0.1)
        print(dict(zip((way.__name__ for way in ways), done, strict=True)), f"{most:.0f} MB")
        assert min(done) > 0
        assert most < TARGET_MB
        before = daemon.viewer.version
        until(lambda: daemon.viewer.version > before)
        command = [sys.executable, "-m", "imumon", "status", "--json", "--connect", daemon.endpoint]
        status = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert status.returncode == 0, status.stderr
        with Subscriber([daemon.endpoint]) as subscriber:
            assert subscriber.wait_report("a", timeout=30.0) is not None
        after = sensor.ask("stall 600")
        time.sleep(0.2)  # the thread that reads has it
        daemon.process.send_signal(signal.SIGTERM)
        last = daemon.wait(lambda r: r.state == "stopped")
        sent = (after["sent"] - after["replies"]) - (counted["sent"] - counted["replies"])
        assert sent > 100 * seconds * 0.9
        assert last.session.samples - first.session.samples == sent
        assert last.session.missing == last.session.bad_checksums == 0
        assert daemon.stop()[0] == 0


@pytest.mark.slow
def test_everything_at_once_for_a_minute(tmp_path: Path) -> None:
    _attack_together(tmp_path, 60.0)


# ---------------------------------------------------------------------- what a viewer bears


def test_of_two_programs_with_one_name_the_first_is_shown(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(device_states, "GONE_S", 1.0)
    first, second = free_endpoint(), free_endpoint()
    with (
        Publisher("a", listen=[first]) as one,
        Publisher("a", listen=[second]) as two,
        Subscriber([first, second]) as viewer,
    ):
        one.publish(report("a", 1))
        until(lambda: viewer.reports())
        for number in range(2, 6):
            two.publish(report("a", 1000 + number))
            two.event(event("a", 7))
            one.publish(report("a", number))
            until(lambda number=number: viewer.reports()["a"][0].session.samples == number)
        sessions = viewer.rivals()["a"]
        assert sessions == (str(one._session.info.zid()), str(two._session.info.zid()))
        assert viewer.events("a") == []
        status = command("status", "--connect", first, "--connect", second)
        assert "two programs publish a; the first is shown" in status.stderr
        checked = command("check", "--connect", first, "--connect", second)
        assert "two programs publish a" in checked.stdout
        assert checked.returncode >= 1
        doctor = ("doctor", "--connect", first, "--connect", second, "--port", "/dev/null")
        until(lambda: all(session in command(*doctor).stdout for session in sessions))
        both = ((one, report("a", 6)), (two, report("a", 1006)))

        def marked() -> bool:  # so the screen has it, and what `report` writes
            for publisher, newest in both:
                publisher.publish(newest)
            return "rival" in viewer.reports()["a"][0].caveats

        until(marked)
        document = command("report", "--connect", first, "--connect", second, "--format", "json")
        assert '"rival"' in document.stdout, document.stderr
        one.close()
        until(lambda: two.publish(report("a", 2000)) or viewer.reports()["a"][0].session.samples == 2000)
        until(lambda: not viewer.rivals() and "rival" not in viewer.reports()["a"][0].caveats)


def test_a_forged_report_of_a_session_without_a_name_is_noticed(router: str) -> None:
    with Publisher("a", listen=[], connect=[router]) as daemon, Subscriber([router]) as viewer:
        daemon.publish(report("a", 1))
        until(lambda: viewer.reports())
        with foreign(router) as forger:

            def seen() -> bool:
                forger.put("imumon/a/report", to_json(report("a", 10**6)))
                return "rival" in viewer.reports()["a"][0].caveats

            until(seen)
        assert viewer.reports()["a"][0].session.samples == 1


def test_a_daemon_that_restarts_or_has_two_routes_is_one_program(router: str) -> None:
    endpoint = free_endpoint()
    with Subscriber([endpoint, router]) as viewer:
        for start in (0, 100):
            with Publisher("a", listen=[endpoint], connect=[router]) as daemon:
                for number in range(start + 1, start + 6):
                    daemon.publish(report("a", number))
                    until(lambda number=number: viewer.reports() and _samples(viewer) == number)
            until(lambda: not viewer.alive())
        assert viewer.rivals() == {}


def _samples(viewer: Subscriber) -> int:
    return viewer.reports()["a"][0].session.samples
