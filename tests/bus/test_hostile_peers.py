"""Other programs on the bus: a viewer ignores what is no report of its key, and keeps the first of two sessions."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import forked
import pytest
import zenoh
from bus_actors import event, free_endpoint, free_port, report, stage
from waiting import until
from zenoh import ext

from imumon.bus import Publisher, Subscriber, device_states
from imumon.bus import subscriber as subscriber_module
from imumon.report import to_json

ESCAPE = "\x1b]0;owned\x07"


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


def test_names_with_escape_sequences_are_counted_and_ignored(router: str) -> None:
    with Subscriber([router]) as viewer, foreign(router) as attacker:
        until(viewer.connected)
        until(lambda: attacker.put("imumon/b/report", to_json(report("b", 5))) or viewer.reports())
        until(lambda: attacker.put("imumon/b/event", to_json(event("b", 1))) or viewer.events("b"))
        for name in (ESCAPE, "A", "x" * 65, "ä", "a b"):
            before = viewer.malformed
            attacker.put(f"imumon/{name}/report", to_json(report("a", 1)))
            attacker.put(f"imumon/{name}/event", to_json(event("a", 1)))
            token = attacker.liveliness().declare_token(f"imumon/{name}/alive")
            until(lambda before=before: viewer.malformed >= before + 3)
            token.undeclare()
        assert (set(viewer.reports()), viewer.alive(), viewer.events("a")) == ({"b"}, set(), [])


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "words",
    [
        ("status",),
        pytest.param(("status", "--json"), marks=SLOW),
        pytest.param(("report",), marks=SLOW),
        pytest.param(("wait", "--timeout", "5s"), marks=SLOW),
        pytest.param(("status", "--id", "x"), marks=SLOW),
        pytest.param(("status", "--id", "y"), marks=SLOW),
        pytest.param(("status", "--id", "z"), marks=SLOW),
        pytest.param(("doctor", "--port", "/dev/null"), marks=SLOW),
    ],
    ids=" ".join,
)
def test_commands_print_no_escape_sequences_and_no_traceback(router: str, words: tuple[str, ...]) -> None:
    good = to_json(report("b", 5))
    crafted = {
        ESCAPE: good,
        "x": good,  # the id of another device
        "y": good.replace('"mean":0.5', f'"mean":1{"0" * 400}'),
        "z": good.replace('"mean":0.5', '"mean":1e308'),
        "b": good.replace('"model":null', f'"model":{json.dumps(ESCAPE)}', 1),  # that of the device
    }
    tokens, publishers = [], []
    with foreign(router) as attacker:
        for name, text in crafted.items():
            tokens.append(attacker.liveliness().declare_token(f"imumon/{name}/alive"))
            publishers.append(
                ext.declare_advanced_publisher(
                    attacker, f"imumon/{name}/report", cache=ext.CacheConfig(1), publisher_detection=True,
                    sample_miss_detection=ext.MissDetectionConfig(),
                )
            )  # fmt: skip
            publishers[-1].put(text)
        done = command(*words, "--connect", router)
        assert done.returncode == {"dev/null": 1, "x": 3, "y": 3, "z": 3}.get(words[-1].strip("/"), 0)
        assert "owned" not in done.stderr
        assert words[0] != "doctor" or "b answers" in done.stdout
        publishers.clear()


def test_reports_of_another_device_and_long_messages_are_ignored(router: str) -> None:
    with Subscriber([router]) as viewer, foreign(router) as attacker:
        until(viewer.connected)
        until(lambda: attacker.put("imumon/b/report", to_json(report("b", 5))) or viewer.reports())
        for key, text in (
            ("b/report", to_json(report("c", 6))),
            ("b/report", to_json(report("b", 7)) + " " * 1_000_000),
            ("b/event", to_json(event("c", 1))),
            ("b/event", to_json(event("b", 1)) + " " * 100_000),
        ):
            before = viewer.malformed
            attacker.put(f"imumon/{key}", text)
            until(lambda before=before: viewer.reports() and viewer.malformed > before)
        assert viewer.reports()["b"][0] == report("b", 5)
        assert viewer.events("b") == []


def test_a_viewer_keeps_at_most_256_devices_and_32_mb(router: str, monkeypatch: pytest.MonkeyPatch) -> None:
    text = to_json(report("NAME", 1, octaves=2))
    with Subscriber([router]) as viewer, foreign(router) as attacker:
        until(viewer.connected)

        def put(count: int, padding: str = "") -> None:
            """Put reports of many devices; a busy machine loses some of them."""
            for number in range(count):
                attacker.put(f"imumon/d{number}/report", text.replace("NAME", f"d{number}") + padding)
                if number % 20 == 0:
                    time.sleep(0.01)

        until(lambda: put(600) or (viewer.malformed > 50 and len(viewer.reports()) > 200))
        start = time.process_time()
        assert 200 < len(viewer.reports()) <= 256
        assert time.process_time() - start < 5.0
        monkeypatch.setattr(subscriber_module, "KEPT_BYTES", 500_000)
        before = viewer.malformed
        until(lambda: put(20, " " * 500_000) or viewer.malformed >= before + 20)
        monkeypatch.setattr(device_states, "GONE_S", 0.1)
        monkeypatch.setattr(subscriber_module, "KEPT_BYTES", 32_000_000)
        time.sleep(0.2)  # devices that are gone make room
        until(lambda: attacker.put("imumon/new/report", text.replace("NAME", "new")) or viewer.report("new"))


def test_a_viewer_of_one_device_does_not_see_thousands_of_others(router: str) -> None:
    with Subscriber([router], id="b") as viewer, foreign(router) as attacker:
        until(viewer.connected)
        for number in range(300):
            attacker.put(f"imumon/d{number}/report", to_json(report(f"d{number}", 1, octaves=2)))
        until(lambda: attacker.put("imumon/b/report", to_json(report("b", 5))) or viewer.reports())
        assert set(viewer.reports()) == {"b"}


@pytest.mark.slow
def test_wait_keeps_its_timeout_among_3000_devices(router: str) -> None:
    text = to_json(report("NAME", 1, octaves=19))
    texts = {f"d{number}": text.replace("NAME", f"d{number}") for number in range(3000)}
    stop = threading.Event()

    def publish(session: zenoh.Session) -> None:
        while not stop.is_set():
            for name, each in texts.items():
                session.put(f"imumon/{name}/report", each)
            stop.wait(0.5)

    with foreign(router) as attacker:
        thread = threading.Thread(target=publish, args=(attacker,))
        thread.start()
        start = time.monotonic()
        done = command("wait", "--connect", router, "--grade", "navigation", "--timeout", "4s", timeout=90.0)
        length_s = time.monotonic() - start
        stop.set()
        thread.join()
    assert (done.returncode, length_s < 10.0) == (4, True), (done.stderr, length_s)


def test_of_two_programs_with_one_name_the_first_is_shown_until_it_ends(
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
        doctor = ("doctor", "--connect", first, "--connect", second, "--port", "/dev/null")
        until(lambda: all(session in command(*doctor).stdout for session in sessions))
        one.close()
        until(lambda: two.publish(report("a", 2000)) or viewer.reports()["a"][0].session.samples == 2000)


def test_a_daemon_that_restarts_or_has_two_routes_is_one_program(router: str) -> None:
    endpoint = free_endpoint()
    with Subscriber([endpoint, router]) as viewer:
        for start in (0, 100):
            with Publisher("a", listen=[endpoint], connect=[router]) as daemon:
                for number in range(start + 1, start + 6):
                    daemon.publish(report("a", number))
                    begin = time.monotonic()
                    until(lambda number=number: viewer.reports() and _samples(viewer) == number)
                    assert start or time.monotonic() - begin < 4.0
            until(lambda: not viewer.alive())
        assert viewer.rivals() == {}


def _samples(viewer: Subscriber) -> int:
    return viewer.reports()["a"][0].session.samples
