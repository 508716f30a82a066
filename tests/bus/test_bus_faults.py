"""Faults of the bus with sessions in other processes: congested, killed, frozen, restarted, forged data."""

from __future__ import annotations

import itertools
import math
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from bus_actors import Actor, event, free_endpoint, report, stage
from bus_actors import router as router_at
from free_ports import free_port
from test_bus import plain_session
from waiting import until

from imumon.bus import Publisher, Subscriber
from imumon.bus.zenoh_session import LEASE_S

LISTENING = "0A"


def sockets(pid: int) -> tuple[set[str], int]:
    """Return the TCP addresses on which a process listens, and its number of UDP sockets."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(entry)
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    listening, datagram = set(), 0
    for name in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[9] not in inodes:
                continue
            if name.startswith("udp"):
                datagram += 1
            elif columns[3] == LISTENING:
                address, port = columns[1].split(":")
                listening.add(f"{address}:{int(port, 16)}")
    return listening, datagram


def last_number(subscriber: Actor) -> int:
    """Return the number of the last report of device a in a subscriber process; 0: none yet."""
    return int(subscriber.messages[-1].get("numbers", {}).get("a", 0)) if subscriber.messages else 0


@pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="the sockets of a process are read from Linux's /proc"
)
def test_a_daemon_listens_on_its_endpoint_only_and_a_subscriber_on_none() -> None:
    with stage() as start:
        port = free_port()
        address = f"tcp/127.0.0.1:{port}"
        daemon, subscriber = start("daemon", listen=[address]), start("subscriber", connect=[address])
        daemon.ready()
        until(lambda: last_number(subscriber))
        assert sockets(daemon.messages[0]["pid"]) == ({f"0100007F:{port}"}, 0)
        assert sockets(subscriber.messages[0]["pid"]) == (set(), 0)


@pytest.mark.slow
def test_a_stopped_subscriber_delays_neither_the_daemon_nor_other_subscribers() -> None:
    with stage() as start:
        address = free_endpoint()
        # 60 kB at 100 Hz: more than all buffers hold until the lease of the stopped subscriber ends
        daemon = start("daemon", listen=[address], period=0.01, octaves=60)
        subscribers = [start("subscriber", connect=[address]) for _ in range(3)]
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
        assert max(gaps) < 0.75 * LEASE_S  # who waits for a stopped subscriber waits for its lease
        assert state["longest"] < 0.75 * LEASE_S  # longest call of `publish`
        assert state["error"] is None
        resumed.kill(signal.SIGCONT)
        number = last_number(healthy)
        until(lambda: last_number(resumed) > number)
        daemon.send("stop")
        assert until(lambda: daemon.messages[-1].get("closed_s")) < 0.8 * LEASE_S
        healthy.send("stop")
        assert daemon.process.wait(30) == healthy.process.wait(30) == 0


def test_a_subscriber_that_starts_first_connects_to_the_daemon_and_its_successors() -> None:
    with stage() as start:
        address = free_endpoint()
        with Subscriber([address]) as subscriber:
            assert not subscriber.connected()
            assert subscriber.wait_report(timeout=0.1) is None
            daemon = start("daemon", listen=[address]).ready()
            assert subscriber.wait_report("a", timeout=30.0)
            until(lambda: subscriber.alive() == {"a"})
            for number in range(2):
                daemon.kill()
                until(
                    lambda: not subscriber.alive(), 1.0
                )  # the kernel closes the link, so there is no wait for the lease
                assert not subscriber.connected()
                daemon = start("daemon", listen=[address], period=0).ready()  # a single report
                until(lambda: subscriber.alive() == {"a"})
                until(lambda: subscriber.reports()["a"][0].session.samples == 1)
                daemon.send(f"events {number + 1}")
            until(lambda: subscriber.events("a") == [event("a", 0), event("a", 1)])


def test_a_frozen_daemon_is_not_alive_after_the_lease_and_alive_when_it_continues() -> None:
    with stage() as start:
        address = free_endpoint()
        daemon = start("daemon", listen=[address]).ready()
        with Subscriber([address]) as subscriber:
            until(lambda: subscriber.alive() == {"a"})
            daemon.kill(signal.SIGSTOP)
            until(lambda: not subscriber.alive())
            daemon.kill(signal.SIGCONT)
            until(lambda: subscriber.alive() == {"a"})
            version = subscriber.version
            until(lambda: subscriber.version > version + 3)


def test_each_change_of_an_uplink_and_each_send_error_is_reported_once() -> None:
    address, messages = free_endpoint(), list[str]()

    def reported(text: str) -> bool:
        messages.extend(text for text, _ in publisher.status_changes())
        return any(text in line for line in messages)

    with Publisher("a", listen=[free_endpoint()], connect=[address]) as publisher:
        until(lambda: reported("no answer"))
        router = router_at(address)
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
            assert neighbour.wait_report("a", timeout=30.0)
            assert "no answer" in daemon.request("state")["uplinks"][address]
            router = router_at(address)
            until(lambda: subscriber.alive() == {"a"})
            assert subscriber.wait_report("a", timeout=30.0) == report("a", 1)
            until(lambda: subscriber.events("a") == [event("a", n) for n in range(3)])
            assert daemon.request("state")["uplinks"] == {address: None}
            router.close()
            until(lambda: not subscriber.alive())
            until(lambda: "lost" in (daemon.request("state")["uplinks"][address] or ""))
            assert neighbour.alive() == {"a"}
            with router_at(address):
                until(lambda: subscriber.alive() == {"a"})
                with plain_session(address, "peer") as other_tool:  # any other tool
                    until(lambda: [r for r in other_tool.get("imumon/*/gyro/x") if r.ok])
