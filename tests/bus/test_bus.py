"""Keys and payloads of the bus as any Zenoh client sees them; behaviour of publisher and subscriber."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
import zenoh
from bus_actors import CHANNELS, Actor, event, free_endpoint, report, stage
from hypothesis import given
from hypothesis import strategies as st
from waiting import until

from imumon.bus import BusError, Publisher, SessionOptions, Subscriber, clean_id, zenoh_session
from imumon.bus.publisher import CURVES
from imumon.bus.queryable import MAX_QUEUED
from imumon.bus.zenoh_session import check_endpoint, is_local
from imumon.model.report import Event, Report, from_json
from imumon.model.report_json import to_json


def plain_session(endpoint: str, mode: str = "client") -> zenoh.Session:
    """Open a session as any other tool does, without code of this project."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    if mode == "peer":
        config.insert_json5("listen/endpoints", "[]")
    return zenoh.open(config)


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
    with plain_session(endpoint) as session:

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


def test_a_wildcard_subscriber_gets_exactly_the_documented_keys(endpoint: str) -> None:
    received: dict[str, str] = {}
    with plain_session(endpoint) as session:
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
            first = late.wait_report("once", timeout=30.0)  # published once, before this subscription
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
                assert subscriber.wait_report(id, timeout=30.0)


def test_messages_published_before_close_arrive() -> None:
    with stage() as start:
        addresses = [free_endpoint() for _ in range(4)]
        actors = [start("daemon", id=f"d{n}", listen=[address]) for n, address in enumerate(addresses)]
        with Subscriber(addresses) as subscriber:
            until(lambda: len(subscriber.reports()) == 4)
            for actor in actors:
                actor.send("stop")
            until(lambda: not subscriber.alive())
            until(lambda: all(r.session.samples == 10**6 for r, _ in subscriber.reports().values()))
        for actor in actors:
            until(lambda actor=actor: actor.messages[-1].get("closed_s"))
            assert actor.process.wait(30) == 0  # no thread of Zenoh outlives the interpreter


def sent(session: zenoh.Session, number: int) -> None:
    """Wait until this report of device x is published."""

    def numbers() -> list[int]:
        replies = (reply.ok for reply in session.get("imumon/x/report"))
        return [json.loads(ok.payload.to_bytes())["session"]["samples"] for ok in replies if ok is not None]

    until(lambda: number in numbers())


def test_publish_returns_at_once_drops_old_events_and_survives_a_bad_report() -> None:
    address = free_endpoint()
    arrived: list[Any] = []
    with Publisher("x", listen=[address]) as publisher, plain_session(address) as session:
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
    with Publisher("x", listen=[address]) as publisher:
        offset, source = ahead, publisher._session.new_timestamp().get_id()
        monkeypatch.setattr(
            publisher, "_timestamp", lambda: zenoh.Timestamp(datetime.now(UTC) + offset, source)
        )
        publisher.publish(report("x", 1))
        with plain_session(address) as session:
            sent(session, 1)
        with Subscriber([address]) as subscriber:
            assert subscriber.wait_report("x", timeout=30.0) == report("x", 1)
            for number in range(2, 6):
                offset = ahead if number < 4 else -ahead
                publisher.publish(report("x", number))
                publisher.event(event("x", number))
                until(lambda number=number: subscriber.reports()["x"][0].session.samples == number)
            until(lambda: subscriber.events("x") == [event("x", number) for number in range(2, 6)])


def test_the_grade_is_published_only_when_it_changes() -> None:
    address, received = free_endpoint(), []
    with Publisher("x", listen=[address]) as publisher, plain_session(address) as session:
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


def refused(id: str, **arguments: Any) -> BusError:
    """Return the error that a publisher with these arguments raises."""
    with pytest.raises(BusError) as caught:
        Publisher(id, **{"listen": [free_endpoint()], **arguments})
    return caught.value


def test_errors_have_a_code_and_name_the_setting() -> None:
    address = free_endpoint()
    with Publisher("x", listen=[address]):
        assert refused("y", listen=[address]).code == "address_in_use"
    options = SessionOptions(insecure=True)
    assert refused("x", listen=["tcp/192.0.2.1:7448"], settings=options).code == "address_not_local"
    assert refused("x", settings=SessionOptions(certificate="/none/a.pem")).code == "file_unreadable"
    unknown = refused("x", settings=SessionOptions(raw={"transport/lnk": 1}))
    assert (unknown.code, unknown.setting) == ("raw_invalid", "zenoh.raw")
    reserved = refused("x", settings=SessionOptions(raw={"listen/endpoints": ["tcp/[::]:7447"]}))
    assert (reserved.code, reserved.setting) == ("raw_not_allowed", "zenoh.raw")
    assert refused("//").code == "id_invalid"


def test_a_daemon_has_no_more_sessions_than_its_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """One viewer too many is refused, and the first one is served on."""
    address = free_endpoint()
    monkeypatch.setattr(zenoh_session, "_MOST_SESSIONS", 1)
    with Publisher("x", listen=[address]) as publisher:
        publisher.publish(report("x", 1))
        with Subscriber([address]) as first:
            assert first.wait_report("x", timeout=30.0)
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
