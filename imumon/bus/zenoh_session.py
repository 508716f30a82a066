"""Zenoh sessions with safe defaults.

A default Zenoh session listens on all interfaces, announces itself by multicast and accepts what any peer
publishes. A session of imumon listens on the loopback interface only, uses neither multicast nor gossip nor
shared memory, detects a dead link after 2 s, reconnects every 0.5 s, and accepts no data: a peer may
subscribe and query. This module knows no keys and no reports.
"""

from __future__ import annotations

import ipaddress
import json
import os
import re
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self, TypeVar

import zenoh

from imumon.bus.bus_error import BusError, classify, readable
from imumon.errors import why
from imumon.system_errors import cure_of_writing

DEFAULT_PORTS = range(7448, 7464)  # TCP: a daemon listens on the first free one, a subscriber connects to all
LEASE_S = 2.0  # s; a link without traffic for this time is closed
RETRY_S = 0.5  # s between two attempts to connect
MAX_MESSAGE_BYTES = 1 << 20  # a report has less than 100 kB
_MAX_QUERY_BYTES = 1 << 16
"""Size of a message that a session accepts if it accepts no data: queries and subscriptions, without a payload.
Zenoh's limit of 1 GB would let anyone who may read fill the memory with the payloads of queries."""
_BLOCKED_S = 1.0  # s; a link that takes no reply for this time is closed: other queries wait
_MOST_SESSIONS = 100
"""Peers of a session at once; Zenoh may keep 16 unfinished messages, so 1 MB, for each."""
_HANDSHAKE_S = 2.0
"""s that the handshake of a connection may take, on both sides. Zenoh waits for a limited number of unfinished ones, so
that connections that say nothing keep viewers out until their time is over, which is 10 s without this setting."""
_RESERVED_RAW = {
    "mode": "zenoh.mode",
    "listen": "zenoh.listen",
    "connect": "zenoh.connect",
    "access_control": "zenoh.read_only and zenoh.allow",
}  # top-level keys, and the settings for them
_LOCAL_PROTOCOLS = ("unixsock-stream", "unixpipe")
_NETWORK_PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws")
_ENCRYPTED = ("tls/", "quic/")

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """Options of a session: the settings of ``[zenoh]`` under the same names."""

    listen: tuple[str, ...] = ()  # endpoints such as ``tcp/127.0.0.1:7448``
    connect: tuple[str, ...] = ()  # endpoints
    mode: str = "peer"  # or ``router``; ``client`` for the uplinks and the tests of an endpoint
    user: str = ""  # for login; peers that present the same user and password may connect to this session
    password: str = ""
    users_file: str = ""  # file of lines ``user:password``: further users that may connect to this session
    certificate: str = (
        ""  # PEM file for mutual TLS on endpoints of ``tls/`` and ``quic/``, as are the next two
    )
    key: str = ""
    ca: str = ""
    verify_name: bool = True  # whether the certificate of the other side must name the host in the endpoint
    read_only: bool = True  # whether data that peers publish is rejected
    allow: tuple[str, ...] = ()  # common names of certificates, or users, that may read; empty: all
    insecure: bool = False  # whether to listen on other interfaces than the loopback without TLS
    raw: Mapping[str, Any] = field(default_factory=dict)  # further settings of Zenoh, path to value

    @classmethod
    def of(cls, settings: object | None) -> Self:
        """Return the options in an object with attributes of these names, such as ``[zenoh]``; None: the defaults."""
        if isinstance(settings, cls):
            return settings
        return cls(**{f.name: getattr(settings, f.name) for f in fields(cls) if hasattr(settings, f.name)})


def clean_id(name: str) -> str:
    """Return the name of a device in the form that keys take: a-z, 0-9, ``_`` and ``-``.

    Raises
    ------
    BusError : ``id_invalid``, the name has no such character.

    >>> clean_id("VN100 0100056785"), clean_id("/dev/ttyUSB0")
    ('vn100-0100056785', 'dev-ttyusb0')
    """
    clean = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[:64]
    if not clean:
        raise BusError("id_invalid", f'device name "{name}"', "use letters and digits, such as --id imu-1")
    return clean


def local_endpoints() -> tuple[str, ...]:
    """Return the default endpoints of the daemons on this machine."""
    return tuple(f"tcp/127.0.0.1:{port}" for port in DEFAULT_PORTS)


def check_endpoint(endpoint: str) -> tuple[str, str]:
    """Return the protocol and the host of an endpoint; the host of a local protocol is empty.

    Raises
    ------
    BusError : ``endpoint_invalid``.

    >>> check_endpoint("tcp/127.0.0.1:7448"), check_endpoint("tls/[::1]:7448")
    (('tcp', '127.0.0.1'), ('tls', '::1'))
    """
    protocol, slash, rest = endpoint.partition("/")
    address = re.split(r"[?#]", rest)[0]
    if slash and protocol in _LOCAL_PROTOCOLS and address:
        return protocol, ""
    host = re.fullmatch(r"(?:\[([0-9a-fA-F:.%\w]+)\]|([^\s:/\[\]]+)):(\d{1,5})", address)
    if slash and protocol in _NETWORK_PROTOCOLS and host and int(host[3]) < 65536:
        return protocol, host[1] or host[2]
    without_protocol = re.fullmatch(r"[^\s/]+:\d+", endpoint)
    example = f"tcp/{endpoint}" if without_protocol else "tcp/HOST:PORT, such as tcp/127.0.0.1:7448"
    raise BusError("endpoint_invalid", f"{endpoint}: is not an endpoint", f"write {example}")


def is_local(endpoint: str) -> bool:
    """Return whether only this machine can reach the endpoint."""
    protocol, host = check_endpoint(endpoint)
    if protocol in _LOCAL_PROTOCOLS or host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def open_session(
    options: SessionOptions,
    listen: Sequence[str],
    connect: Sequence[str],
    *,
    access_control: bool,
    most_bytes: int = MAX_MESSAGE_BYTES,
) -> zenoh.Session:
    """Open a session on these endpoints.

    Parameters
    ----------
    most_bytes : size of a message that the session accepts, if it accepts data.
    access_control : whether `SessionOptions.read_only` and `SessionOptions.allow` apply to peers.

    Raises
    ------
    Unreachable : no connection to `connect` (mode ``client`` only; the other modes connect in the
        background).
    BusError : an endpoint, a file or an option is invalid or not allowed.
    """
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint)
    for endpoint in listen:
        _check_listen(options, endpoint)
    for path in (options.users_file, options.certificate, options.key, options.ca):
        if path and not os.access(path, os.R_OK):
            raise BusError("file_unreadable", f"{path}: cannot be read", "check the path and its permissions")
    with _users_file(options, bool(listen)) as users:
        config = _zenoh_config(options, listen, connect, users, access_control, most_bytes)
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            raise classify(error, (*listen, *connect), options.users_file) from None


def _check_listen(options: SessionOptions, endpoint: str) -> None:
    """Raise `BusError` if the options do not allow to listen on this endpoint."""
    encrypted = endpoint.startswith(_ENCRYPTED)
    if not (is_local(endpoint) or encrypted or options.insecure):
        message = f"{endpoint}: every host on the network could read the data"
        cure = "use tls/ with certificates, or set zenoh.insecure = true"
        raise BusError("listen_insecure", message, cure)
    if encrypted and not options.certificate:
        message = f"{endpoint}: no certificate"
        raise BusError("certificate_missing", message, "set zenoh.certificate and zenoh.key")


def start_listener(source: Iterable[T], handle: Callable[[T], None]) -> threading.Thread:
    """Start a thread that handles each item of `source` until the session closes.

    Zenoh can also call `handle` from its own threads, but these outlive the session for a short time, and one
    that is still running when the interpreter ends aborts the process. This thread can be joined.
    """

    def run() -> None:
        with suppress(zenoh.ZError):
            for item in source:
                handle(item)

    thread = threading.Thread(target=run, name="imumon-listener", daemon=True)
    thread.start()
    return thread


def _zenoh_config(
    options: SessionOptions,
    listen: Sequence[str],
    connect: Sequence[str],
    users: str,
    access_control: bool,
    most_bytes: int,
) -> zenoh.Config:
    """Return the configuration of a session; `users` is the path of the file of users."""
    only_queries = access_control and options.read_only
    values: dict[str, Any] = {
        "mode": options.mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/retry": {"period_init_ms": round(RETRY_S * 1000), "period_max_ms": round(RETRY_S * 1000)},
        "connect/timeout_ms": 0 if options.mode == "client" else -1,  # -1: no limit, in the background
        "connect/exit_on_failure": options.mode == "client",
        "open/return_conditions/connect_scouted": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": round(LEASE_S * 1000),
        "transport/link/rx/max_message_size": _MAX_QUERY_BYTES if only_queries else most_bytes,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(_BLOCKED_S * 1e6),
        "transport/unicast/accept_timeout": round(_HANDSHAKE_S * 1000),
        "transport/unicast/open_timeout": round(_HANDSHAKE_S * 1000),
        "transport/unicast/max_sessions": _MOST_SESSIONS,
        "timestamping/enabled": True,
    }
    values |= _credentials(options, users)
    if access_control and (options.read_only or options.allow):
        values["access_control"] = _access_rules(options)
    config = zenoh.Config()
    for path, value in values.items():
        config.insert_json5(path, json.dumps(value))
    for path, value in options.raw.items():
        _insert_raw(config, path, value)
    return config


def _credentials(options: SessionOptions, users: str) -> dict[str, Any]:
    """Return the settings of passwords and certificates; `users` is the path of the file of users."""
    password, tls = "transport/auth/usrpwd/", "transport/link/tls/"
    given: dict[str, Any] = {
        tls + "enable_mtls": bool(options.ca and options.certificate),
        tls + "verify_name_on_connect": options.verify_name,
    }
    if options.user:
        given |= {password + "user": options.user, password + "password": options.password}
    if users:
        given[password + "dictionary_file"] = users
    if options.ca:
        given[tls + "root_ca_certificate"] = options.ca
    for side in ("listen", "connect") if options.certificate else ():
        given |= {f"{tls}{side}_certificate": options.certificate, f"{tls}{side}_private_key": options.key}
    return given


def _insert_raw(config: zenoh.Config, path: str, value: Any) -> None:
    """Set one setting of ``[zenoh.raw]``."""
    if path.partition("/")[0] in _RESERVED_RAW:
        message = f'zenoh.raw: "{path}" cannot be set there'
        cure = f"use {_RESERVED_RAW[path.partition('/')[0]]}"
        raise BusError("raw_not_allowed", message, cure, setting="zenoh.raw")
    try:
        config.insert_json5(path, json.dumps(value))
    except (zenoh.ZError, TypeError) as error:
        message = f'zenoh.raw: "{path}" = {json.dumps(value, default=str)}: {readable(str(error))}'
        cure = "see the configuration of Zenoh"
        raise BusError("raw_invalid", message, cure, setting="zenoh.raw") from None


def _access_rules(options: SessionOptions) -> dict[str, Any]:
    """Return access rules: publications go out, subscriptions and queries come in, data does not come in."""
    keys = ["imumon/**", "imumon/**/@adv/**"]  # ** does not match the verbatim chunk in the keys of caches
    publishing = ["put", "delete", "reply", "declare_queryable", "liveliness_token"]
    reading = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"]
    both = sorted({*publishing, *reading})
    egress, ingress = (publishing, reading) if options.read_only else (both, both)
    rules = [
        {"id": flow, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
        for flow, messages in (("egress", egress), ("ingress", ingress))
    ]
    names = list(options.allow)
    subjects: list[dict[str, Any]] = [{"id": "everybody"}]
    if names:
        subjects = [{"id": "certificates", "cert_common_names": names}, {"id": "users", "usernames": names}]
    policy = {"rules": [rule["id"] for rule in rules], "subjects": [subject["id"] for subject in subjects]}
    access = {"rules": rules, "subjects": subjects, "policies": [policy]}
    return {"enabled": True, "default_permission": "deny", **access}


@contextmanager
def _users_file(options: SessionOptions, listens: bool) -> Iterator[str]:
    """Yield the path of a file with all users that may connect; empty: no restriction.

    Zenoh refuses every peer if only `user` is set. Therefore a temporary file (mode 0600) holds this user and
    those of `users_file`.
    """
    if not listens or not options.user:
        yield options.users_file if listens else ""
        return
    if ":" in options.user or "\n" in options.user + options.password:
        message, cure = (
            "zenoh.user: contains a colon or a line break",
            "choose another user name and password",
        )
        raise BusError("user_invalid", message, cure, setting="zenoh.user")
    lines = f"{options.user}:{options.password}\n".encode()
    try:
        if options.users_file:
            lines += Path(options.users_file).read_bytes()
        file = tempfile.NamedTemporaryFile(prefix="imumon-")  # noqa: SIM115
    except OSError as error:
        message = f"zenoh.user: the file of users cannot be written: {why(error)}"
        cure = cure_of_writing(error, "choose another temporary directory with TMPDIR")
        raise BusError("users_file_failed", message, cure, setting="zenoh.user") from None
    with file:
        file.write(lines)
        file.flush()
        yield file.name
