"""Other programs on the bus: the daemon measures on in bounded memory, and viewers show what is from the daemon.

Every attack was tried against an earlier version. The processes that attack are in `attackers.py`.
"""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import attackers
import forked
import pytest
import zenoh_sessions
from attackers import attacking
from bus_actors import Actor, event, report, stage
from free_ports import free_endpoint
from hostile_input import TITLE
from usage import resident_kb
from waiting import until
from zenoh import ext

from imumon.bus import Publisher, Subscriber, device_states
from imumon.config import ZenohSettings
from imumon.model.report_json import to_json

GOOD = to_json(report("b", 5))
CRAFTED = {
    TITLE: GOOD,
    "x": GOOD,  # the id of another device
    "y": GOOD.replace('"mean":0.5', f'"mean":1{"0" * 400}'),
    "z": GOOD.replace('"mean":0.5', '"mean":1e308'),
    "b": GOOD.replace('"model":null', f'"model":{json.dumps(TITLE)}', 1),  # that of the device
}
"""Reports beside which every command is tried, by the name in their keys."""
MESSAGES: list[tuple[str, str | None]] = [
    *((f"{name}/report", to_json(report("a", 1))) for name in (TITLE, "A", "a b")),
    *((f"{name}/event", to_json(event("a", 1))) for name in (TITLE, "A", "a b")),
    *((f"{name}/alive", None) for name in (TITLE, "A", "a b")),
    ("b/report", to_json(report("c", 6))),
    ("b/report", to_json(report("b", 7)) + " " * 1_000_000),
    ("b/event", to_json(event("c", 1))),
    ("b/event", to_json(event("b", 1)) + " " * 100_000),
]
"""Keys and texts that viewers ignore; a key without a text is a token."""
COMMANDS = (
    ("status", 0, ""),
    ("status --json", 0, ""),
    ("report", 0, ""),
    ("wait --timeout 5s", 0, ""),
    ("status --id x", 3, ""),
    ("doctor --port /dev/null", 1, "running: b;"),
)
"""Commands beside the crafted reports, with their exit code and a part of what they print."""
GROWTH_KB = 40_000
"""kB that it may take more during one attack."""


@contextmanager
def publisher(**settings: object) -> Iterator[tuple[Actor, str, Callable[..., Actor]]]:
    """A daemon of the bus alone, its endpoint, and what starts other actors."""
    with stage() as start:
        address = free_endpoint()
        yield start("daemon", listen=[address], **settings).ready(), address, start


@pytest.fixture
def router() -> Iterator[str]:
    """Endpoint of a router that lets everybody publish."""
    endpoint = free_endpoint()
    with zenoh_sessions.router(endpoint):
        yield endpoint


def command(*arguments: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    done = forked.run(*arguments, timeout=timeout)
    assert "Traceback" not in done.stderr
    assert "\x1b" not in done.stdout + done.stderr
    return done


@pytest.mark.few
@pytest.mark.parametrize("way", [attackers.payload, attackers.many, attackers.forge])
def test_queries_and_messages_take_bounded_memory(way: Callable[..., int]) -> None:
    with publisher(period=1.0) as (daemon, address, _):
        before, most = resident_kb(daemon.process.pid), 0
        with attacking(address, "a", 2.0, way) as output:
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                most = max(most, resident_kb(daemon.process.pid))
                time.sleep(0.02)
        assert output[0] > 5
        assert most - before < GROWTH_KB
        assert daemon.request("state")["error"] is None
        with Subscriber([address]) as viewer:
            until(lambda: viewer.reports() and viewer.reports()["a"][0].session.samples >= 3)


def test_a_hostile_message_is_ignored_and_counted(router: str) -> None:
    with Subscriber([router]) as viewer, zenoh_sessions.client(router) as attacker:
        until(viewer.connected)
        until(lambda: attacker.put("imumon/b/report", to_json(report("b", 5))) or viewer.reports())
        until(lambda: attacker.put("imumon/b/event", to_json(event("b", 1))) or viewer.events("b"))
        tokens = []
        for key, text in MESSAGES:
            before = viewer.malformed
            if text is None:
                tokens.append(attacker.liveliness().declare_token(f"imumon/{key}"))
            else:
                attacker.put(f"imumon/{key}", text)
            # a report is parsed when it is asked for
            until(lambda before=before: viewer.reports() and viewer.malformed > before)
            shown = {name: entry[0] for name, entry in viewer.reports().items()}
            assert shown == {"b": report("b", 5)}, key
            assert viewer.events("a") == [], key
            assert viewer.events("b") == [event("b", 1)], key
            assert viewer.alive() == set(), key


@pytest.mark.few
@pytest.mark.parametrize(("words", "code", "says"), COMMANDS)
def test_commands_print_no_escape_sequences_and_no_traceback(
    router: str, words: str, code: int, says: str
) -> None:
    tokens, publishers = [], []
    with zenoh_sessions.client(router) as attacker:
        for name, text in CRAFTED.items():
            tokens.append(attacker.liveliness().declare_token(f"imumon/{name}/alive"))
            publishers.append(
                ext.declare_advanced_publisher(
                    attacker, f"imumon/{name}/report", cache=ext.CacheConfig(1), publisher_detection=True,
                    sample_miss_detection=ext.MissDetectionConfig(),
                )
            )  # fmt: skip
            publishers[-1].put(text)
        done = command(*words.split(), "--connect", router)
        assert done.returncode == code
        assert "owned" not in done.stderr
        assert says in done.stdout
        publishers.clear()


# ---------------------------------------------------------------------- what a viewer bears


def test_of_two_programs_with_one_name_the_first_is_shown(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(device_states, "GONE_S", 1.0)
    first, second = free_endpoint(), free_endpoint()
    with (
        Publisher("a", ZenohSettings(listen=(first,))) as one,
        Publisher("a", ZenohSettings(listen=(second,))) as two,
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
    with (
        Publisher("a", ZenohSettings(listen=(), connect=(router,))) as daemon,
        Subscriber([router]) as viewer,
    ):
        daemon.publish(report("a", 1))
        until(lambda: viewer.reports())
        with zenoh_sessions.client(router) as forger:

            def seen() -> bool:
                forger.put("imumon/a/report", to_json(report("a", 10**6)))
                return "rival" in viewer.reports()["a"][0].caveats

            until(seen)
        assert viewer.reports()["a"][0].session.samples == 1


def test_a_daemon_that_restarts_or_has_two_routes_is_one_program(router: str) -> None:
    endpoint = free_endpoint()
    with Subscriber([endpoint, router]) as viewer:
        for start in (0, 100):
            with Publisher("a", ZenohSettings(listen=(endpoint,), connect=(router,))) as daemon:
                for number in range(start + 1, start + 6):
                    daemon.publish(report("a", number))
                    until(lambda number=number: viewer.reports() and _samples(viewer) == number)
            until(lambda: not viewer.alive())
        assert viewer.rivals() == {}


def _samples(viewer: Subscriber) -> int:
    return viewer.reports()["a"][0].session.samples
