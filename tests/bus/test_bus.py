"""Keys and payloads of the bus as any Zenoh client sees them; publisher, subscriber and router, also in faults."""

from __future__ import annotations

import itertools
import json
import math
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import psutil
import pytest
import reports
import zenoh
import zenoh_sessions
from bus_actors import CHANNELS, Actor, event, report, stage
from free_ports import free_endpoint, free_port
from hypothesis import given
from hypothesis import strategies as st
from waiting import until

from imumon.bus import BusError, Publisher, Subscriber, clean_id, zenoh_session
from imumon.bus.publisher import CURVES, ReportDocuments
from imumon.bus.queryable import MAX_QUEUED
from imumon.bus.zenoh_session import check_endpoint, is_local
from imumon.config import ZenohSettings
from imumon.model.report import Event, Report, from_json
from imumon.model.report_json import to_json


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Endpoint of a daemon in another process that publishes 20 times a second."""
    with stage() as start:
        address = free_endpoint()
        actor = start("daemon", listen=[address]).ready()
        actor.send("events 120")
        with Subscriber([address]) as subscriber:
            until(lambda: event("a", 119) in subscriber.events("a"))
        yield address


def test_every_published_key_answers_a_get(endpoint: str) -> None:
    with zenoh_sessions.client(endpoint) as session:

        def get(key: str) -> list[zenoh.Sample]:
            return [reply.ok for reply in session.get(f"imumon/a/{key}") if reply.ok]

        until(lambda: get("report"))
        (sample,) = get("report")
        complete = from_json(Report, sample.payload.to_bytes())
        assert str(sample.encoding) == "application/json"
        assert sample.timestamp is not None
        assert complete == report("a", complete.session.samples)
        for name in (*CHANNELS, "temperature"):
            (sample,) = get(name)
            entry = json.loads(sample.payload.to_bytes())
            expected = json.loads(to_json(report("a", entry["count"]).channels[name]))
            for curve in CURVES:
                del expected[curve]
            assert entry == expected
        (sample,) = get("grade")
        assert json.loads(sample.payload.to_bytes()) == json.loads(to_json(complete.grade))
        (sample,) = get("event")
        assert from_json(Event, sample.payload.to_bytes()) == event("a", 119)
        every = session.get("imumon/a/event", consolidation=zenoh.ConsolidationMode.NONE)
        assert [from_json(Event, r.ok.payload.to_bytes()) for r in every if r.ok] == [
            event("a", number) for number in range(20, 120)
        ]
        (sample,) = get("signal/gyro/x")
        assert json.loads(sample.payload.to_bytes())["minute"]["high"][0] > 0
        assert {str(s.key_expr) for s in get("gyro/*")} == {f"imumon/a/gyro/{axis}" for axis in "xyz"}
        assert {str(s.key_expr) for s in get("**")} == {
            f"imumon/a/{name}"
            for name in (*CHANNELS, "temperature", "report", "grade", "event", "signal/gyro/x")
        }


def test_documents_are_those_of_their_report_whatever_was_sent_before() -> None:
    documents, young, old = ReportDocuments(), reports.report(200.0), reports.report()
    later = replace(
        old, session=replace(old.session, samples=7), channels=dict(list(old.channels.items())[1:])
    )
    for sent in (young, old, old, later, young):
        texts = documents.of(sent)
        assert from_json(Report, texts["report"]) == sent
        assert texts == ReportDocuments().of(sent)
        assert json.loads(texts["report"]) == json.loads(to_json(sent))


def test_a_wildcard_subscriber_gets_exactly_the_documented_keys(endpoint: str) -> None:
    received: dict[str, str] = {}
    with zenoh_sessions.client(endpoint) as session:
        session.declare_subscriber(
            "imumon/**", lambda s: received.update({str(s.key_expr): s.payload.to_string()})
        )
        expected = {f"imumon/a/{name}" for name in (*CHANNELS, "temperature", "report")}
        until(lambda: set(received) >= expected)
        assert set(received) == expected  # grade and event on change, signals on request
        for text in received.values():
            json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def test_a_late_subscriber_gets_the_last_values_at_once(endpoint: str) -> None:
    with stage() as start:
        address = free_endpoint()
        start("daemon", id="once", listen=[address], period=0).ready()
        with Subscriber([address]) as late, Subscriber([endpoint]) as active:
            first = late.wait_report("once", timeout=60.0)  # published once, before this subscription
            assert first == report("once", 1)
            assert active.wait_report()
            until(lambda: len(active.events("a")) == 100)
            assert active.events("a") == [event("a", n) for n in range(20, 120)]
            until(lambda: active.alive() == {"a"})
            assert active.connected()
            assert active.wait_report("absent", timeout=0.2) is None


def test_the_signal_of_one_channel_follows_the_reports(endpoint: str) -> None:
    with Subscriber([endpoint]) as subscriber:
        subscriber.wait_report()
        assert subscriber.signal() is None
        subscriber.watch("a", "gyro/x")
        first = until(subscriber.signal)[0]
        later = until(lambda: (s := subscriber.signal()) and s[0] != first and s[0])
        assert later.minute.high > first.minute.high
        subscriber.watch("a", "gyro/y")  # nothing is published of that one
        assert subscriber.signal() is None
        subscriber.watch("a", None)


def test_default_endpoints_are_local_and_need_no_configuration() -> None:
    with stage() as start:
        names = ("default-1", "default-2")
        actors: list[Actor] = [start("daemon", id=id).ready() for id in names]
        addresses = [actor.messages[0]["endpoints"][0] for actor in actors]
        assert len(set(addresses)) == 2
        for address in addresses:
            assert address.startswith("tcp/127.0.0.1:")
            assert 7448 <= int(address.rpartition(":")[2]) <= 7463
        with Subscriber() as subscriber:
            for id in names:
                assert subscriber.wait_report(id, timeout=60.0)


def test_messages_published_before_close_arrive() -> None:
    with stage() as start:
        addresses = [free_endpoint() for _ in range(2)]
        actors = [start("daemon", id=f"d{n}", listen=[address]) for n, address in enumerate(addresses)]
        with Subscriber(addresses) as subscriber:
            until(lambda: len(subscriber.reports()) == 2)
            for actor in actors:
                actor.send("stop")
            until(lambda: not subscriber.alive())
            until(lambda: all(r.session.samples == 10**6 for r, _ in subscriber.reports().values()))
        for actor in actors:
            until(lambda actor=actor: actor.messages[-1].get("closed_s"))
            assert actor.process.wait(60) == 0  # no thread of Zenoh outlives the interpreter


def sent(session: zenoh.Session, number: int) -> None:
    """Wait until this report of device x is published."""

    def numbers() -> list[int]:
        replies = (reply.ok for reply in session.get("imumon/x/report"))
        return [json.loads(ok.payload.to_bytes())["session"]["samples"] for ok in replies if ok is not None]

    until(lambda: number in numbers())


def test_publish_returns_at_once_drops_old_events_and_survives_a_bad_report() -> None:
    address = free_endpoint()
    arrived: list[Any] = []
    with (
        Publisher("x", ZenohSettings(listen=(address,))) as publisher,
        zenoh_sessions.client(address) as session,
    ):
        session.declare_subscriber(
            "imumon/x/event", lambda s: arrived.append(json.loads(s.payload.to_bytes()))
        )
        until(lambda: publisher.event(event("x", 0)) or arrived)  # the subscription is known
        for number in range(5000):
            publisher.event(event("x", number))
        queued = list(publisher._events)
        assert len(queued) <= MAX_QUEUED
        assert not queued or queued[-1] == event("x", 4999)
        newest = json.loads(to_json(event("x", 4999)))
        # behind so many, a busy network drops it: the publisher never waits for room
        until(lambda: publisher.event(event("x", 4999)) or newest in arrived)
        publisher.publish(report("x", 1))
        sent(session, 1)
        bad = report("x", 2)
        bad = Report(
            **{**{f: getattr(bad, f) for f in ("time", "device", "session")}, "state": "running"},
            speed=math.nan,
        )
        publisher.publish(bad)
        until(lambda: "JSON" in (publisher.last_error or ""))
        publisher.publish(report("x", 3))
        until(lambda: publisher.last_error is None)
        sent(session, 3)


@pytest.mark.few
@pytest.mark.parametrize("ahead", [timedelta(seconds=5), timedelta(days=1), timedelta(days=-1)])
def test_reports_arrive_from_a_daemon_whose_clock_is_wrong_or_stepped(
    ahead: timedelta, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = free_endpoint()
    with Publisher("x", ZenohSettings(listen=(address,))) as publisher:
        offset, source = ahead, publisher._session.new_timestamp().get_id()
        monkeypatch.setattr(
            publisher, "_timestamp", lambda: zenoh.Timestamp(datetime.now(UTC) + offset, source)
        )
        publisher.publish(report("x", 1))
        with zenoh_sessions.client(address) as session:
            sent(session, 1)
        with Subscriber([address]) as subscriber:
            assert subscriber.wait_report("x", timeout=60.0) == report("x", 1)
            for number in range(2, 6):
                offset = ahead if number < 4 else -ahead
                publisher.publish(report("x", number))
                publisher.event(event("x", number))
                until(lambda number=number: subscriber.reports()["x"][0].session.samples == number)
            until(lambda: subscriber.events("x") == [event("x", number) for number in range(2, 6)])


def test_the_grade_is_published_only_when_it_changes() -> None:
    address, received = free_endpoint(), []
    with (
        Publisher("x", ZenohSettings(listen=(address,))) as publisher,
        zenoh_sessions.client(address) as session,
    ):
        session.declare_subscriber(
            "imumon/x/grade", lambda s: received.append(json.loads(s.payload.to_bytes()))
        )
        until(lambda: session.info.transports())
        for number, grade in enumerate(("industrial", "industrial", "tactical", "tactical"), 1):
            publisher.publish(report("x", number, grade=grade))
            sent(session, number)
        until(lambda: received and received[-1]["gyro"]["meets"] == "tactical")
        publisher.close()
        assert len(received) <= 2  # the first may have been sent before the subscription was known


@pytest.mark.parametrize(
    ("listen", "code"),
    [
        ("tcp/0.0.0.0:7448", "listen_insecure"),
        ("tcp/[::]:7448", "listen_insecure"),
        ("tcp/192.0.2.1:7448", "listen_insecure"),
        ("tls/0.0.0.0:7448", "listen_insecure"),
        ("7448", "endpoint_invalid"),
        ("localhost:7448", "endpoint_invalid"),
        ("tcp/127.0.0.1", "endpoint_invalid"),
        ("tcp/127.0.0.1:99999", "endpoint_invalid"),
        ("smtp/127.0.0.1:25", "endpoint_invalid"),
        ("unixsock-stream//no/such/directory/x", "path_not_found"),
    ],
)
def test_unusable_listen_endpoints_are_refused(listen: str, code: str) -> None:
    error = refused("x", listen=[listen])
    assert error.code == code
    assert error.message.startswith(f"{listen}: ")
    assert error.cure
    assert "\n" not in str(error)


def refused(id: str, **settings: Any) -> BusError:
    """Return the error that a publisher with these settings raises."""
    with pytest.raises(BusError) as caught:
        Publisher(id, ZenohSettings(**{"listen": [free_endpoint()], **settings}))
    return caught.value


def test_errors_have_a_code_and_name_the_setting() -> None:
    address = free_endpoint()
    with Publisher("x", ZenohSettings(listen=(address,))):
        assert refused("y", listen=[address]).code == "address_in_use"
    assert refused("x", listen=["tcp/192.0.2.1:7448"], insecure=True).code == "address_not_local"
    assert refused("x", certificate="/none/a.pem").code == "file_unreadable"
    unknown = refused("x", raw={"transport/lnk": 1})
    assert (unknown.code, unknown.setting) == ("raw_invalid", "zenoh.raw")
    reserved = refused("x", raw={"listen/endpoints": ["tcp/[::]:7447"]})
    assert (reserved.code, reserved.setting) == ("raw_not_allowed", "zenoh.raw")
    assert refused("//").code == "id_invalid"


def test_a_daemon_has_no_more_sessions_than_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """One viewer too many is refused, and the first one is served on."""
    address = free_endpoint()
    monkeypatch.setattr(zenoh_session, "_MOST_SESSIONS", 1)
    with Publisher("x", ZenohSettings(listen=(address,))) as publisher:
        publisher.publish(report("x", 1))
        with Subscriber([address]) as first:
            assert first.wait_report("x", timeout=60.0)
            with Subscriber([address]) as second:
                assert second.wait_report("x", timeout=1.0) is None
            version = first.version
            publisher.publish(report("x", 2))
            until(lambda: first.version > version)


@given(st.text())
def test_any_name_becomes_a_valid_key_or_is_refused(name: str) -> None:
    try:
        clean = clean_id(name)
    except BusError:
        return
    assert set(clean) <= set("abcdefghijklmnopqrstuvwxyz0123456789_-")
    assert clean_id(clean) == clean
    zenoh.KeyExpr(f"imumon/{clean}/report")


@given(st.text())
def test_any_text_is_an_endpoint_or_is_refused(text: str) -> None:
    with suppress(BusError):
        assert check_endpoint(text)
        assert is_local(text) in (True, False)


# ---------------------------------------------------------------- faults: congested, killed, frozen, restarted


def sockets(pid: int) -> tuple[set[str], int]:
    """Return the TCP addresses on which a process listens, and its number of UDP sockets."""
    every = psutil.Process(pid).net_connections()
    listening = {f"{each.laddr.ip}:{each.laddr.port}" for each in every if each.status == psutil.CONN_LISTEN}
    return listening, sum(each.type == socket.SOCK_DGRAM for each in every)


PATIENCE_S = 600.0
PATIENT = {"transport/link/tx/lease": round(1000 * PATIENCE_S)}
"""Settings of a program that may be silent for longer than a test takes, before others close their links to it."""


def last_number(subscriber: Actor) -> int:
    """Return the number of the last report of device a in a subscriber process; 0: none yet."""
    return int(subscriber.messages[-1].get("numbers", {}).get("a", 0)) if subscriber.messages else 0


def test_a_daemon_listens_on_its_endpoint_only_and_a_subscriber_on_none() -> None:
    with stage() as start:
        port = free_port()
        address = f"tcp/127.0.0.1:{port}"
        daemon, subscriber = start("daemon", listen=[address]), start("subscriber", connect=[address])
        daemon.ready()
        until(lambda: last_number(subscriber))
        assert sockets(daemon.messages[0]["pid"]) == ({f"127.0.0.1:{port}"}, 0)
        assert sockets(subscriber.messages[0]["pid"]) == (set(), 0)


@pytest.mark.slow
def test_a_stopped_subscriber_delays_neither_the_daemon_nor_other_subscribers() -> None:
    with stage() as start:
        address = free_endpoint()
        # 60 kB at 100 Hz: more than all buffers hold
        daemon = start("daemon", listen=[address], period=0.01, octaves=60)
        subscribers = [start("subscriber", connect=[address], raw=PATIENT) for _ in range(3)]
        daemon.ready()
        for subscriber in subscribers:
            until(lambda subscriber=subscriber: last_number(subscriber))
        frozen, resumed, healthy = subscribers
        for subscriber in (frozen, resumed):
            subscriber.kill(signal.SIGSTOP)
        start_s, first = time.monotonic(), len(healthy.messages)
        until(lambda: time.monotonic() - start_s > 3.0 and len(healthy.messages) - first > 50)
        arrivals = [message["at"] for message in healthy.messages[first:]]
        gaps = [b - a for a, b in itertools.pairwise(arrivals)]
        state = daemon.request("state")
        assert max(gaps) < 0.1 * PATIENCE_S  # who waits for a stopped subscriber waits for its lease
        assert state["longest"] < 0.1 * PATIENCE_S  # longest call of `publish`
        assert state["error"] is None
        resumed.kill(signal.SIGCONT)
        number = last_number(healthy)
        until(lambda: last_number(resumed) > number)
        daemon.send("stop")
        assert until(lambda: daemon.messages[-1].get("closed_s")) < 0.1 * PATIENCE_S
        healthy.send("stop")
        assert daemon.process.wait(60) == healthy.process.wait(60) == 0


def test_a_subscriber_that_starts_first_connects_to_the_daemon_and_its_successors() -> None:
    with stage() as start:
        address = free_endpoint()
        with Subscriber([address]) as subscriber:
            assert not subscriber.connected()
            assert subscriber.wait_report(timeout=0.1) is None
            daemon = start("daemon", listen=[address], raw=PATIENT).ready()
            assert subscriber.wait_report("a", timeout=60.0)
            until(lambda: subscriber.alive() == {"a"})
            for number in range(2):
                daemon.kill()
                until(lambda: not subscriber.alive())  # the kernel closes the link: none waits for the lease
                until(lambda: not subscriber.connected())
                daemon = start("daemon", listen=[address], period=0, raw=PATIENT).ready()  # a single report
                until(lambda: subscriber.alive() == {"a"})
                until(lambda: subscriber.reports()["a"][0].session.samples == 1)
                daemon.send(f"events {number + 1}")
            until(lambda: subscriber.events("a") == [event("a", 0), event("a", 1)])


def test_each_change_of_an_uplink_and_each_send_error_is_reported_once() -> None:
    address, messages = free_endpoint(), list[str]()

    def reported(text: str) -> bool:
        messages.extend(text for text, _ in publisher.status_changes())
        return any(text in line for line in messages)

    with Publisher("a", ZenohSettings(listen=(free_endpoint(),), connect=(address,))) as publisher:
        until(lambda: reported("no answer"))
        router = zenoh_sessions.router(address)
        until(lambda: reported("connected"))
        router.close()
        until(lambda: reported("lost"))
        broken = replace(report("a", 1), period_s=math.nan)
        for _ in range(3):
            publisher.publish(broken)
            until(lambda: reported("could not be published"))
    assert len(messages) == len(set(messages)) == 4


def test_a_router_may_start_late_and_restart() -> None:
    with stage() as start:
        address, local = free_endpoint(), free_endpoint()
        daemon = start("daemon", listen=[local], connect=[address], period=0).ready()  # a single report
        daemon.send("events 3")
        with Subscriber([address]) as subscriber, Subscriber([local]) as neighbour:
            assert neighbour.wait_report("a", timeout=60.0)
            assert "no answer" in daemon.request("state")["uplinks"][address]
            router = zenoh_sessions.router(address)
            until(lambda: subscriber.alive() == {"a"})
            assert subscriber.wait_report("a", timeout=60.0) == report("a", 1)
            until(lambda: subscriber.events("a") == [event("a", n) for n in range(3)])
            assert daemon.request("state")["uplinks"] == {address: None}
            router.close()
            until(lambda: not subscriber.alive())
            until(lambda: "lost" in (daemon.request("state")["uplinks"][address] or ""))
            assert neighbour.alive() == {"a"}
            with zenoh_sessions.router(address):
                until(lambda: subscriber.alive() == {"a"})
                with zenoh_sessions.peer(address) as other_tool:  # any other tool
                    until(lambda: [r for r in other_tool.get("imumon/*/gyro/x") if r.ok])


STUCK = """
import sys, threading, zenoh, imumon.cli
from imumon.__main__ import main
from imumon.bus.zenoh_session import start_listener
def command():
    session = zenoh.open(zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["%s"]}}'))
    samples = session.declare_subscriber("imumon/**")
    kept.extend((session, samples, start_listener(samples, lambda sample: None)))
    print("the end")
    return 3
kept = []
imumon.cli.main = command
sys.exit(main())
"""


def test_a_thread_that_outlives_its_time_aborts_no_program(endpoint: str) -> None:
    """On a starved machine a thread is still inside Zenoh when the interpreter ends."""
    ended = subprocess.run(
        [sys.executable, "-c", STUCK % endpoint], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "the end\n", "")
