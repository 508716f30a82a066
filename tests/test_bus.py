"""The keys of the bus as anybody reads them, and the manners of both its ends."""

from __future__ import annotations

import json
import math
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
import zenoh
from bus_actors import CHANNELS, Actor, event, free, free_port, report, stage, until, view
from hypothesis import given
from hypothesis import strategies as st

from imumon.bus import BusError, Publisher, SessionOptions, Subscriber, clean_id
from imumon.bus.queryable import LastValues
from imumon.bus.texts import BULKY, Texts
from imumon.bus.zenoh_session import check_endpoint, explain, is_local
from imumon.config import ZenohSettings
from imumon.report import Event, Report, Signal, from_json, to_dict, to_json


def plain_session(endpoint: str, mode: str = "client") -> zenoh.Session:
    """A session as any other tool opens it, which knows nothing of this project."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    if mode == "peer":
        config.insert_json5("listen/endpoints", "[]")
    return zenoh.open(config)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Where a daemon in another process publishes, 20 times a second."""
    with stage() as start:
        place = free()
        actor = start("daemon", listen=[place]).ready()
        actor.tell("events 120")
        until(lambda: actor.ask("counts")["events"] == 120)
        yield place


def test_every_published_key_answers_a_get(endpoint: str) -> None:
    with plain_session(endpoint) as session:

        def get(key: str) -> list[zenoh.Sample]:
            return [reply.ok for reply in session.get(f"imumon/a/{key}") if reply.ok]

        until(lambda: get("report"))
        (sample,) = get("report")
        whole = from_json(Report, sample.payload.to_bytes())
        assert str(sample.encoding) == "application/json"
        assert sample.timestamp is not None
        assert whole == report("a", whole.session.samples)
        for name in (*CHANNELS, "temperature"):
            (sample,) = get(name)
            entry = json.loads(sample.payload.to_bytes())
            expected = to_dict(report("a", entry["count"]).channels[name])
            for bulky in ("allan", "histogram", "spectrum"):
                del expected[bulky]
            assert entry == expected
        (sample,) = get("grade")
        assert json.loads(sample.payload.to_bytes()) == to_dict(whole.grade)
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


def test_a_subscriber_of_everything_sees_the_table_of_keys(endpoint: str) -> None:
    seen: dict[str, str] = {}
    with plain_session(endpoint) as session:
        session.declare_subscriber(
            "imumon/**", lambda s: seen.update({str(s.key_expr): s.payload.to_string()})
        )
        wanted = {f"imumon/a/{name}" for name in (*CHANNELS, "temperature", "report")}
        until(lambda: set(seen) >= wanted)
        assert set(seen) == wanted  # grade and event on change, signals when asked for
        for text in seen.values():
            json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_the_device_is_alive_as_long_as_its_daemon(endpoint: str) -> None:
    with plain_session(endpoint) as session:
        until(lambda: [str(r.ok.key_expr) for r in session.liveliness().get("imumon/*/alive") if r.ok])


def test_late_viewer_gets_the_last_of_all_at_once(endpoint: str) -> None:
    with stage() as start:
        place = free()
        start("daemon", id="once", listen=[place], period=0).ready()
        with Subscriber([place]) as quiet, Subscriber([endpoint]) as busy:
            begun = time.monotonic()
            got = quiet.wait_report("once")  # published once, before this viewer was there
            assert got == report("once", 1)
            assert time.monotonic() - begun < 1.0
            assert busy.wait_report()
            until(lambda: len(busy.events("a")) == 100)
            assert busy.events("a") == [event("a", n) for n in range(20, 120)]
            until(lambda: busy.alive() == {"a"})
            assert busy.connected()
            assert busy.wait_report("nobody", timeout=0.2) is None


def test_the_signal_of_one_channel_follows_the_reports(endpoint: str) -> None:
    with Subscriber([endpoint]) as viewer:
        viewer.wait_report()
        assert viewer.signal() is None
        viewer.watch("a", "gyro/x")
        first = until(viewer.signal)[0]
        later = until(lambda: (s := viewer.signal()) and s[0] != first and s[0])
        assert later.minute.high > first.minute.high
        viewer.watch("a", "gyro/y")  # nothing is published of that one
        assert viewer.signal() is None
        viewer.watch("a", None)


def test_two_daemons_and_one_viewer() -> None:
    with stage() as start:
        places = [free(), free()]
        for id, place in zip(("left", "right"), places, strict=True):
            start("daemon", id=id, listen=[place])
        with Subscriber(places) as viewer:  # both daemons come after it
            until(lambda: viewer.alive() == {"left", "right"})
            until(lambda: set(viewer.reports()) == {"left", "right"})
            version = viewer.version
            until(lambda: viewer.version > version)


def test_default_addresses_are_local_and_found_without_words() -> None:
    with stage() as start:
        names = ("default-1", "default-2")
        actors: list[Actor] = [start("daemon", id=id).ready() for id in names]
        places = [actor.said[0]["endpoints"][0] for actor in actors]
        assert len(set(places)) == 2
        for place in places:
            assert place.startswith("tcp/127.0.0.1:")
            assert 7448 <= int(place.rpartition(":")[2]) <= 7463
        with Subscriber() as viewer:
            for id in names:
                assert viewer.wait_report(id, timeout=5.0)
        twin = start("daemon", id=names[0]).ready()
        assert twin.said[0]["error"].startswith('a daemon named "default-1" is running already; ')


def test_what_was_handed_over_before_the_end_still_arrives() -> None:
    with stage() as start:
        places = [free() for _ in range(4)]
        actors = [start("daemon", id=f"d{n}", listen=[place]) for n, place in enumerate(places)]
        with Subscriber(places) as viewer:
            until(lambda: len(viewer.reports()) == 4)
            for actor in actors:
                actor.tell("stop")
            until(lambda: not viewer.alive())
            until(lambda: all(r.session.samples == 10**6 for r, _ in viewer.reports().values()), 2)
        for actor in actors:
            assert until(lambda actor=actor: actor.said[-1].get("closed_s", 0)) < 1.0
            assert actor.process.wait(5) == 0  # no thread of Zenoh meets the end of the interpreter


def test_nothing_waits_and_nothing_is_lost_in_silence() -> None:
    with Publisher("x", listen=[free()]) as publisher:
        for number in range(5000):
            publisher.event(event("x", number))
        publisher.publish(report("x", 1))
        counts = until(lambda: (c := publisher.counts) and c.reports == 1 and c)
        assert counts.events + counts.events_dropped == 5000
        bad = report("x", 2)
        bad = Report(
            **{**{f: getattr(bad, f) for f in ("time", "device", "session")}, "state": "running"},
            speed=math.nan,
        )
        publisher.publish(bad)
        until(lambda: publisher.counts.errors == 1)
        assert "finite" in (publisher.last_error or "")
        publisher.publish(report("x", 3))
        until(lambda: publisher.counts.reports == 2)
        assert publisher.last_error is None


def test_what_was_sent_is_held_no_longer() -> None:
    class Signals(dict[str, Signal]):
        """A dict that tells when it goes."""

    with Publisher("x", listen=[free()]) as publisher:
        signals = Signals()
        gone = weakref.ref(signals)
        publisher.publish(report("x", 1), signals)
        del signals
        until(lambda: gone() is None)


def test_signals_are_made_for_those_who_ask() -> None:
    place = free()
    with Publisher("x", listen=[place]) as publisher, plain_session(place) as session:
        publisher.publish(report("x", 1), {})
        until(lambda: publisher.counts.reports)
        list(session.get("imumon/x/**"))
        assert publisher.wanted() == frozenset()
        question = session.get("imumon/x/signal/gyro/*")  # waits for the next report
        until(lambda: publisher.wanted() == {"gyro/x", "gyro/y", "gyro/z"})
        publisher.publish(report("x", 2), {"gyro/z": view("gyro/z", 7)})
        (reply,) = question
        assert json.loads(reply.ok.payload.to_bytes())["minute"]["high"] == [7.0]
        (reply,) = session.get("imumon/x/signal/gyro/z")
        assert str(reply.ok.key_expr) == "imumon/x/signal/gyro/z"
        assert list(session.get("imumon/x/nothing")) == []


@pytest.mark.parametrize("ahead", [timedelta(seconds=5), timedelta(days=1), timedelta(days=-1)])
def test_a_daemon_whose_clock_is_wrong_or_stepped_is_heard(
    ahead: timedelta, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = free()
    with Publisher("x", listen=[place]) as publisher:
        offset, source = ahead, publisher._session.new_timestamp().get_id()
        monkeypatch.setattr(publisher, "_stamp", lambda: zenoh.Timestamp(datetime.now(UTC) + offset, source))
        publisher.publish(report("x", 1))
        until(lambda: publisher.counts.reports == 1)
        with Subscriber([place]) as viewer:
            assert viewer.wait_report("x", timeout=5.0) == report("x", 1)
            for number in range(2, 6):
                offset = ahead if number < 4 else -ahead
                publisher.publish(report("x", number))
                publisher.event(event("x", number))
                until(lambda number=number: viewer.reports()["x"][0].session.samples == number)
            until(lambda: viewer.events("x") == [event("x", number) for number in range(2, 6)])


def test_grade_is_sent_on_change_alone() -> None:
    place, seen = free(), []
    with Publisher("x", listen=[place]) as publisher, plain_session(place) as session:
        session.declare_subscriber("imumon/x/grade", lambda s: seen.append(json.loads(s.payload.to_bytes())))
        until(lambda: session.info.transports())
        for number, grade in enumerate(("industrial", "industrial", "tactical", "tactical"), 1):
            publisher.publish(report("x", number, grade=grade))
            until(lambda number=number: publisher.counts.reports == number)
        until(lambda: seen and seen[-1]["gyro"]["nearest"] == "tactical")
        assert len(seen) <= 2  # the first may have been sent before the subscription was known


@pytest.mark.parametrize(
    ("listen", "fault"),
    [
        ("tcp/0.0.0.0:7448", "everybody on the network could read along"),
        ("tcp/[::]:7448", "everybody on the network could read along"),
        ("tcp/192.0.2.1:7448", "everybody on the network could read along"),
        ("tls/0.0.0.0:7448", "needs zenoh.certificate and zenoh.key"),
        ("7448", "is not an endpoint; write tcp/HOST:PORT"),
        ("localhost:7448", "is not an endpoint; write tcp/localhost:7448"),
        ("tcp/127.0.0.1", "is not an endpoint"),
        ("tcp/127.0.0.1:99999", "is not an endpoint"),
        ("smtp/127.0.0.1:25", "is not an endpoint"),
        ("unixsock-stream//no/such/folder/x", "no such file or folder"),
    ],
)
def test_addresses_that_are_refused(listen: str, fault: str) -> None:
    with pytest.raises(BusError, match=r"^[^\n]*$") as caught:
        Publisher("x", listen=[listen])
    assert str(caught.value).startswith(f"{listen}: ")
    assert fault in str(caught.value)


def test_address_in_use_foreign_address_and_files() -> None:
    place = free()
    with Publisher("x", listen=[place]):
        with pytest.raises(BusError, match="is taken by another daemon or program"):
            Publisher("y", listen=[place])
        with pytest.raises(BusError, match='"x" is running already'):
            Publisher("x", listen=[free()], connect=[place])
    with pytest.raises(BusError, match="is not an address of this machine"):
        Publisher("x", listen=["tcp/192.0.2.1:7448"], settings=SessionOptions(insecure=True))
    with pytest.raises(BusError, match=r"^/none/users: cannot be read$"):
        Publisher("x", listen=[free()], settings=SessionOptions(users_file="/none/users"))
    with pytest.raises(BusError, match=r'zenoh.raw: "transport/lnk" = 1: unknown key$'):
        Publisher("x", listen=[free()], settings=SessionOptions(raw={"transport/lnk": 1}))
    with pytest.raises(BusError, match=r'zenoh.raw: "listen/endpoints" cannot be set there'):
        Publisher("x", listen=[free()], settings=SessionOptions(raw={"listen/endpoints": ["tcp/[::]:7447"]}))
    with pytest.raises(BusError, match="use letters and digits"):
        Publisher("//", listen=[free()])


def test_open_listening_must_be_asked_for() -> None:
    settings = SessionOptions(insecure=True)
    with Publisher("x", listen=[f"tcp/0.0.0.0:{free_port()}"], settings=settings) as publisher:
        assert publisher.endpoints[0].startswith("tcp/0.0.0.0:")


def test_unix_socket(tmp_path_factory: pytest.TempPathFactory) -> None:
    place = f"unixsock-stream/{tmp_path_factory.mktemp('bus')}/z"
    with Publisher("x", listen=[place]) as publisher, Subscriber([place]) as viewer:
        publisher.publish(report("x", 1))
        assert viewer.wait_report("x", timeout=5.0)


def test_settings_of_the_file_are_the_options_of_the_bus() -> None:
    assert SessionOptions.of(ZenohSettings()) == SessionOptions()
    assert SessionOptions.of(ZenohSettings(user="ann", raw={"a": 1})) == SessionOptions(
        user="ann", raw={"a": 1}
    )


def test_viewer_finds_the_daemon_of_the_same_settings() -> None:
    place = free()
    settings = ZenohSettings(listen=(place,), user="ann", password="secret")
    with Publisher("x", settings=settings) as publisher, Subscriber(settings=settings) as viewer:
        publisher.publish(report("x", 1))
        assert viewer.wait_report("x", timeout=5.0)


@given(st.text())
def test_any_name_is_made_fit_for_a_key_or_refused(name: str) -> None:
    try:
        clean = clean_id(name)
    except BusError:
        return
    assert set(clean) <= set("abcdefghijklmnopqrstuvwxyz0123456789_-")
    assert clean_id(clean) == clean
    zenoh.KeyExpr(f"imumon/{clean}/report")


@given(st.text())
def test_any_endpoint_is_understood_or_refused(text: str) -> None:
    with suppress(BusError):
        assert check_endpoint(text)
        assert is_local(text) in (True, False)


def test_errors_show_nothing_of_zenoh_itself() -> None:
    error = zenoh.ZError("Boom [x]: odd at /home/x/.cargo/git/a.rs:12.] at /home/x/.cargo/git/b.rs:3.")
    assert explain(error, ["tcp/h:1"]) == "tcp/h:1: Boom [x]: odd"


def test_texts_are_those_of_the_report_whatever_of_it_is_new() -> None:
    texts = Texts()
    first, other = report("a", 100), report("a", 200)
    grown = replace(
        first,
        session=replace(first.session, samples=101),
        channels={name: replace(each, count=101) for name, each in first.channels.items()},
    )
    for made in (first, grown, other, replace(first, channels={}), first):
        texts.write(made)
        assert texts.report == to_json(made)
        assert set(texts.channels) == set(made.channels)
        for name, text in texts.channels.items():
            whole = to_dict(made.channels[name])
            assert json.loads(text) == {key: whole[key] for key in whole if key not in BULKY}


def test_what_strangers_once_asked_for_is_forgotten() -> None:
    answers = LastValues("imumon/a")
    answers._asked = {f"made-up-{k}": 0.0 for k in range(1000)} | {"gyro/x": time.monotonic()}
    assert answers.wanted(5.0) == {"gyro/x"}
    assert len(answers._asked) == 1
