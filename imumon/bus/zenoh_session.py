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
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

import zenoh

from imumon.bus.bus_error import BusError, classify, readable
from imumon.config import ZenohSettings

DEFAULT_PORTS = range(7448, 7464)  # TCP: a daemon listens on the first free one, a subscriber connects to all
LEASE_S = 2.0  # s; a link without traffic for this time is closed
RETRY_S = 0.5  # s between two attempts to connect
MAX_REPLY_BYTES = 32 << 20  # of rows of the history, of which a daemon sends at most 10 MB
_MAX_QUERY_BYTES = 1 << 16
"""Size of a message that a session accepts if it accepts no data: queries and subscriptions, without a payload.
Zenoh's limit of 1 GB would let anyone who may read fill the memory with the payloads of queries."""
_BLOCKED_S = 1.0  # s; a link that takes no reply for this time is closed: other queries wait
_MOST_SESSIONS = 100
"""Peers of a session at once; Zenoh may keep 16 unfinished messages, so 1 MB, for each."""
_HANDSHAKE_S = 2.0
"""s that the handshake of a connection may take, on both sides. Zenoh waits for a limited number of unfinished ones, so
that connections that say nothing keep viewers out until their time is over, which is 10 s without this setting."""
_RESERVED_RAW = ("mode", "listen", "connect", "access_control")
"""Top-level settings of Zenoh that imumon sets itself."""
_KEYS = ["imumon/**", "imumon/**/@adv/**"]  # ** does not match the verbatim chunk in the keys of caches
_ACCESS = {
    "enabled": True,
    "default_permission": "deny",
    "rules": [
        {
            "id": "egress", "permission": "allow", "flows": ["egress"], "key_exprs": _KEYS,
            "messages": ["put", "delete", "reply", "declare_queryable", "liveliness_token"],
        },
        {
            "id": "ingress", "permission": "allow", "flows": ["ingress"], "key_exprs": _KEYS,
            "messages": [
                "declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"
            ],
        },
    ],
    "subjects": [{"id": "everybody"}],
    "policies": [{"rules": ["egress", "ingress"], "subjects": ["everybody"]}],
}  # fmt: skip
"""Access rules of a daemon: publications go out, subscriptions and queries come in, data does not come in."""
_LOCAL_PROTOCOLS = ("unixsock-stream", "unixpipe")
_NETWORK_PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws")

T = TypeVar("T")


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
    settings: ZenohSettings,
    listen: Sequence[str],
    connect: Sequence[str],
    *,
    access_control: bool,
    client: bool = False,
) -> zenoh.Session:
    """Open a session on these endpoints.

    Parameters
    ----------
    client : connect once and raise an error if that fails, as for a router; a peer connects in the background.
    access_control : whether peers may subscribe and query only, as with a daemon.

    Raises
    ------
    Unreachable : no connection to `connect`, of a client.
    BusError : an endpoint, a file or an option is invalid or not allowed.
    """
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint)
    for endpoint in listen:
        _check_listen(settings, endpoint)
    for path in (settings.certificate, settings.key, settings.ca):
        if path and not os.access(path, os.R_OK):
            raise BusError("file_unreadable", f"{path}: cannot be read", "check the path and its permissions")
    config = _zenoh_config(settings, listen, connect, access_control, client)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise classify(error, (*listen, *connect)) from None


def _check_listen(settings: ZenohSettings, endpoint: str) -> None:
    """Raise `BusError` if the options do not allow to listen on this endpoint."""
    if not (is_local(endpoint) or settings.insecure):
        message = f"{endpoint}: every host on the network could read the data"
        cure = "publish through a router with --connect, or set zenoh.insecure = true"
        raise BusError("listen_insecure", message, cure)


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
    settings: ZenohSettings,
    listen: Sequence[str],
    connect: Sequence[str],
    access_control: bool,
    client: bool,
) -> zenoh.Config:
    """Return the configuration of a session."""
    values: dict[str, Any] = {
        "mode": "client" if client else "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/retry": {"period_init_ms": round(RETRY_S * 1000), "period_max_ms": round(RETRY_S * 1000)},
        "connect/timeout_ms": 0 if client else -1,  # -1: no limit, in the background
        "connect/exit_on_failure": client,
        "open/return_conditions/connect_scouted": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": round(LEASE_S * 1000),
        "transport/link/rx/max_message_size": _MAX_QUERY_BYTES if access_control else MAX_REPLY_BYTES,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(_BLOCKED_S * 1e6),
        "transport/unicast/accept_timeout": round(_HANDSHAKE_S * 1000),
        "transport/unicast/open_timeout": round(_HANDSHAKE_S * 1000),
        "transport/unicast/max_sessions": _MOST_SESSIONS,
        "timestamping/enabled": True,
    }
    if not listen:
        values |= _credentials(settings)
    if access_control:
        values["access_control"] = _ACCESS
    config = zenoh.Config()
    for path, value in values.items():
        config.insert_json5(path, json.dumps(value))
    for path, value in settings.raw.items():
        _insert_raw(config, path, value)
    return config


def _credentials(settings: ZenohSettings) -> dict[str, Any]:
    """Return the settings of password and certificate for a router."""
    password, tls = "transport/auth/usrpwd/", "transport/link/tls/"
    given: dict[str, Any] = {tls + "enable_mtls": bool(settings.ca and settings.certificate)}
    if settings.user:
        given |= {password + "user": settings.user, password + "password": settings.password}
    if settings.ca:
        given[tls + "root_ca_certificate"] = settings.ca
    if settings.certificate:
        given |= {
            tls + "connect_certificate": settings.certificate,
            tls + "connect_private_key": settings.key,
        }
    return given


def _insert_raw(config: zenoh.Config, path: str, value: Any) -> None:
    """Set one setting of ``[zenoh.raw]``."""
    if path.partition("/")[0] in _RESERVED_RAW:
        message = f'zenoh.raw: "{path}" cannot be set there'
        raise BusError("raw_not_allowed", message, "use the settings of [zenoh]", setting="zenoh.raw")
    try:
        config.insert_json5(path, json.dumps(value))
    except (zenoh.ZError, TypeError) as error:
        message = f'zenoh.raw: "{path}" = {json.dumps(value, default=str)}: {readable(str(error))}'
        cure = "see the configuration of Zenoh"
        raise BusError("raw_invalid", message, cure, setting="zenoh.raw") from None
