"""The relay in front of Zenoh: what it passes on, and what each state of a connection is limited to."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from bus_actors import free_endpoint
from waiting import until

from imumon.bus import Publisher, Subscriber, tcp_relay
from imumon.bus.tcp_relay import NoPlace, TcpRelay

FIRST = b"\x03\x00abc"


def served(relay: TcpRelay) -> tuple[socket.socket, list[socket.socket]]:
    """Listen where the session would; return the socket, and what it accepts from now on."""
    server, accepted = socket.socket(socket.AF_UNIX), list[socket.socket]()
    server.bind(relay.endpoint.removeprefix("unixsock-stream/"))
    server.listen()

    def run() -> None:
        with suppress(OSError):
            while True:
                accepted.append(server.accept()[0])

    threading.Thread(target=run, daemon=True).start()
    return server, accepted


@contextmanager
def relaying(
    silent: int = 4, greeting: int = 4, greeting_s: float = 5.0
) -> Iterator[tuple[tuple[str, int], list[socket.socket]]]:
    endpoint = free_endpoint()
    relay = TcpRelay([endpoint], silent, greeting, greeting_s)
    server, accepted = served(relay)
    relay.start()
    host, port = endpoint.removeprefix("tcp/").split(":")
    try:
        yield (host, int(port)), accepted
    finally:
        for session in accepted:
            session.close()
        server.shutdown(socket.SHUT_RDWR)
        server.close()
        relay.close()
    assert not Path(relay.endpoint.removeprefix("unixsock-stream/")).parent.exists()


def is_closed(client: socket.socket) -> bool:
    client.settimeout(0.0)
    try:
        return client.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def read_all(end: socket.socket, size: int) -> bytes:
    end.settimeout(10.0)
    data = b""
    while len(data) < size and (part := end.recv(1 << 16)):
        data += part
    return data


def test_bytes_are_passed_on_in_both_directions_whatever_their_pieces() -> None:
    up, down = bytes(range(256)) * 8000, bytes(reversed(range(256))) * 8000  # more than the kernel holds
    with relaying() as (address, accepted), socket.create_connection(address) as client:
        for byte in FIRST:
            client.sendall(bytes([byte]))
            time.sleep(0.01)
        until(lambda: len(accepted) == 1)
        (session,) = accepted
        assert read_all(session, len(FIRST)) == FIRST
        senders = [
            threading.Thread(target=end.sendall, args=(data,))
            for end, data in ((client, up), (session, down))
        ]
        client.settimeout(None)
        for sender in senders:
            sender.start()
        received: dict[str, bytes] = {}
        readers = [
            threading.Thread(
                target=lambda name, end, size: received.update({name: read_all(end, size)}), args=words
            )
            for words in (("up", session, len(up)), ("down", client, len(down)))
        ]
        for reader in readers:
            reader.start()
        for thread in (*senders, *readers):
            thread.join(20)
        assert received == {"up": up, "down": down}
        session.close()
        until(lambda: is_closed(client))


@pytest.mark.parametrize("said", [b"", b"\x22", FIRST[:-1]], ids=["nothing", "a byte", "all but a byte"])
def test_connections_without_a_whole_message_keep_out_no_other(said: bytes) -> None:
    with relaying() as (address, accepted):
        idle = [socket.create_connection(address) for _ in range(20)]
        for client in idle:
            with suppress(OSError):
                client.sendall(said)
        with socket.create_connection(address) as viewer:
            viewer.sendall(FIRST)
            until(lambda: len(accepted) == 1, 2.0)
            until(lambda: sum(map(is_closed, idle)) >= 16)
            assert not is_closed(viewer)
        for client in idle:
            client.close()


def test_a_greeting_has_a_time_and_a_number() -> None:
    with relaying(silent=20, greeting=4, greeting_s=0.6) as (address, accepted):
        clients = [socket.create_connection(address) for _ in range(12)]
        for client in clients:
            client.sendall(FIRST)
        until(lambda: sum(map(is_closed, clients)) >= 8)
        until(lambda: all(map(is_closed, clients)), 3.0)
        others = len(accepted)
        with socket.create_connection(address) as viewer:  # one that completes it, stays
            viewer.sendall(FIRST)
            until(lambda: len(accepted) > others)
            accepted[-1].sendall(b"reply")
            assert read_all(viewer, 5) == b"reply"
            viewer.sendall(b"second")
            assert read_all(accepted[-1], len(FIRST) + 6).endswith(b"second")
            accepted[-1].sendall(b"agreed")
            assert read_all(viewer, 6) == b"agreed"
            time.sleep(1.2)
            assert not is_closed(viewer)
        for client in clients:
            client.close()


@pytest.mark.parametrize("first", [b"GET / HTTP/1.1\r\n\r\n", b"\x00\x00", b"\xff\xff" + bytes(9000)])
def test_what_begins_with_no_message_of_zenoh_is_closed(first: bytes) -> None:
    with relaying() as (address, accepted), socket.create_connection(address) as client:
        client.sendall(first)
        until(lambda: is_closed(client), 2.0)
        assert not accepted


def test_a_client_that_takes_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp_relay, "BLOCKED_S", 0.5)
    with relaying() as (address, accepted), socket.create_connection(address) as client:
        client.sendall(FIRST)
        until(lambda: len(accepted) == 1)
        (session,) = accepted
        session.settimeout(10.0)
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            session.sendall(bytes(1 << 26))


def test_greetings_have_a_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tcp_relay, "GREETINGS_HZ", 1.0)
    monkeypatch.setattr(tcp_relay, "GREETINGS_AT_ONCE", 3)
    with relaying(greeting=50) as (address, accepted):
        clients = [socket.create_connection(address) for _ in range(20)]
        for client in clients:
            with suppress(OSError):
                client.sendall(FIRST)
        until(lambda: sum(map(is_closed, clients)) >= 16)
        assert len(accepted) <= 4
        for client in clients:
            client.close()


def test_sockets_of_killed_daemons_are_removed_and_those_of_others_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_relay.tempfile, "tempdir", str(tmp_path))
    for name in ("killed", "alive", "other"):
        (tmp_path / f"imumon-bus-{name}").mkdir()
    (tmp_path / "imumon-bus-other" / "note").touch()
    server = {name: socket.socket(socket.AF_UNIX) for name in ("killed", "alive")}
    for name, one in server.items():
        one.bind(str(tmp_path / f"imumon-bus-{name}" / "zenoh"))
        one.listen()
    server["killed"].close()
    with Publisher("a", listen=[free_endpoint()]):
        names = {path.name for path in tmp_path.iterdir()}
        assert {"imumon-bus-alive", "imumon-bus-other"} < names
        assert len(names) == 3
    assert {path.name for path in tmp_path.iterdir()} == {"imumon-bus-alive", "imumon-bus-other"}
    server["alive"].close()


def test_without_a_place_for_its_socket_the_session_listens_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere() -> str:
        raise NoPlace

    monkeypatch.setattr(tcp_relay, "_private_directory", nowhere)
    address = free_endpoint()
    with Publisher("a", listen=[address]), Subscriber([address]) as subscriber:
        until(lambda: "a" in subscriber.alive())
