"""Zenoh sessions as this project opens them: closed to the world until somebody says otherwise.

A default Zenoh session listens on all interfaces, announces itself by multicast and takes whatever a
stranger publishes. Ours listens on the loopback alone, finds nobody by itself (no multicast, no gossip),
shares no memory, notices a dead link after 2 s, tries again every 0.5 to 2 s, and lets nothing in: whoever
connects may subscribe and ask, no more. This file knows no report and no key; it turns Zenoh's errors into
one line for people.
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

from imumon.errors import ImumonError

PORTS = range(7448, 7464)
"""Ports a daemon takes the first free of, and a viewer tries all of."""

LEASE_S = 2.0
"""A link that is silent for so long is dead."""

RETRY_S = 2.0
"""Longest wait before a lost connection is tried again."""

_FIXED = ("mode", "listen", "connect", "access_control")  # have settings of their own
_BIGGEST_MESSAGE = 16 * 1024 * 1024  # bytes; a report takes some tens of kB
_LOCAL_PROTOCOLS = ("unixsock-stream", "unixpipe")
_NET_PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws")

T = TypeVar("T")


class BusError(ImumonError):
    """An address, a certificate or a name cannot be used.

    Attributes
    ----------
    setting : dotted name of the setting at fault, such as ``zenoh.raw``; None: no single setting.
    """

    def __init__(self, message: str, *, setting: str | None = None) -> None:
        super().__init__("bus_unavailable", message)
        self.setting = setting


class Unreachable(BusError):
    """Nobody answers at an endpoint, or nobody who lets us in: there is no telling which."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """How to get on the bus and whom to let in; the settings of ``[zenoh]`` under the same names.

    Attributes
    ----------
    listen, connect : endpoints such as ``tcp/127.0.0.1:7448``.
    mode : ``peer`` or ``router``, and ``client`` for links of our own.
    user, password : to log in with; whoever knows them may connect to us as well.
    users_file : file of lines ``user:password``, who else may connect to us.
    certificate, key, ca : PEM files; with them links of ``tls/`` and ``quic/`` prove who they are on both
        sides.
    verify_name : the other side's certificate must name the host that was connected to.
    read_only : what others publish does not get in.
    allow : common names of certificates, or users, that may read; empty: all who can connect.
    insecure : listening beyond this machine without TLS is meant so.
    raw : further settings of Zenoh, path to value.
    """

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    mode: str = "peer"
    user: str = ""
    password: str = ""
    users_file: str = ""
    certificate: str = ""
    key: str = ""
    ca: str = ""
    verify_name: bool = True
    read_only: bool = True
    allow: tuple[str, ...] = ()
    insecure: bool = False
    raw: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, settings: object | None) -> Self:
        """Options of anything that has attributes of these names; None gives the defaults."""
        if settings is None:
            return cls()
        if isinstance(settings, cls):
            return settings
        return cls(**{f.name: getattr(settings, f.name) for f in fields(cls)})


def clean_id(name: str) -> str:
    """Name of a device as it may stand in a key: a-z, 0-9, ``_`` and ``-``.

    >>> clean_id("VN100 0100056785"), clean_id("/dev/ttyUSB0")
    ('vn100-0100056785', 'dev-ttyusb0')
    """
    clean = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[:64]
    if not clean:
        raise BusError(f'device name "{name}": use letters and digits, such as --id imu-1')
    return clean


def local_endpoints() -> tuple[str, ...]:
    """Endpoints where a daemon of this machine is by default."""
    return tuple(f"tcp/127.0.0.1:{port}" for port in PORTS)


def check_endpoint(endpoint: str) -> tuple[str, str]:
    """Protocol and host of an endpoint.

    >>> check_endpoint("tcp/127.0.0.1:7448"), check_endpoint("tls/[::1]:7448")
    (('tcp', '127.0.0.1'), ('tls', '::1'))
    """
    protocol, slash, rest = endpoint.partition("/")
    address = re.split(r"[?#]", rest)[0]
    if slash and protocol in _LOCAL_PROTOCOLS and address:
        return protocol, ""
    host = re.fullmatch(r"(?:\[([0-9a-fA-F:.%\w]+)\]|([^\s:/\[\]]+)):(\d{1,5})", address)
    if slash and protocol in _NET_PROTOCOLS and host and int(host[3]) < 65536:
        return protocol, host[1] or host[2]
    bare = re.fullmatch(r"[^\s/]+:\d+", endpoint)
    write = f"tcp/{endpoint}" if bare else "tcp/HOST:PORT, such as tcp/127.0.0.1:7448"
    raise BusError(f"{endpoint}: is not an endpoint; write {write}")


def is_local(endpoint: str) -> bool:
    """Whether only this machine can reach the endpoint."""
    protocol, host = check_endpoint(endpoint)
    if protocol in _LOCAL_PROTOCOLS or host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def open_session(
    options: SessionOptions, listen: Sequence[str], connect: Sequence[str], *, guarded: bool
) -> zenoh.Session:
    """A session on these endpoints.

    Parameters
    ----------
    guarded : the rules for those who connect hold (`SessionOptions.read_only`, `SessionOptions.allow`).

    Raises
    ------
    BusError : an endpoint cannot be had, or may not be.
    """
    for endpoint in (*listen, *connect):
        check_endpoint(endpoint)
    for endpoint in listen:
        encrypted = endpoint.startswith(("tls/", "quic/"))
        if not (is_local(endpoint) or encrypted or options.insecure):
            raise BusError(
                f"{endpoint}: everybody on the network could read along: use tls/ with certificates, "
                "or say zenoh.insecure = true"
            )
        if encrypted and not options.certificate:
            raise BusError(f"{endpoint}: needs zenoh.certificate and zenoh.key")
    for path in (options.users_file, options.certificate, options.key, options.ca):
        if path and not os.access(path, os.R_OK):
            raise BusError(f"{path}: cannot be read")
    with _users(options, bool(listen)) as users:
        config = _config(options, listen, connect, users, guarded)
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            text = explain(error, (*listen, *connect))
            raise (Unreachable if "nobody answers" in text else BusError)(text) from None


def listener(source: Iterable[T], take: Callable[[T], None]) -> threading.Thread:
    """Thread that takes what arrives, until the session closes.

    Zenoh could call `take` from threads of its own, but those outlive the session a little: one that meets
    the end of the interpreter aborts the process. This one can be waited for.
    """

    def run() -> None:
        with suppress(zenoh.ZError):
            for item in source:
                take(item)

    thread = threading.Thread(target=run, name="imumon-listener", daemon=True)
    thread.start()
    return thread


def _config(
    options: SessionOptions, listen: Sequence[str], connect: Sequence[str], users: str, guarded: bool
) -> zenoh.Config:
    """Zenoh's own configuration."""
    tls = "transport/link/tls/"
    beside = bool(connect) and all(endpoint.startswith(_LOCAL_PROTOCOLS) for endpoint in connect)
    here = bool(connect) and all(map(is_local, connect))
    soon = 0.1 if beside else 0.5  # a socket of this machine is there or not: to try costs nothing
    values: dict[str, Any] = {
        "mode": options.mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/retry": {
            "period_init_ms": round(soon * 1000),
            "period_max_ms": round((soon if here else RETRY_S) * 1000),
            "period_increase_factor": 1.5,
        },
        "connect/timeout_ms": 0 if options.mode == "client" else -1,  # -1: for ever, in the background
        "connect/exit_on_failure": options.mode == "client",
        "open/return_conditions/connect_scouted": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": round(LEASE_S * 1000),
        "transport/link/rx/max_message_size": _BIGGEST_MESSAGE,
        "timestamping/enabled": True,
        tls + "enable_mtls": bool(options.ca and options.certificate),
        tls + "verify_name_on_connect": options.verify_name,
    }
    if options.user:
        values["transport/auth/usrpwd/user"] = options.user
        values["transport/auth/usrpwd/password"] = options.password
    if users:
        values["transport/auth/usrpwd/dictionary_file"] = users
    if options.ca:
        values[tls + "root_ca_certificate"] = options.ca
    if options.certificate:
        for side in ("listen", "connect"):
            values[f"{tls}{side}_certificate"] = options.certificate
            values[f"{tls}{side}_private_key"] = options.key
    if guarded and (options.read_only or options.allow):
        values["access_control"] = _access(options)
    config = zenoh.Config()
    for path, value in values.items():
        config.insert_json5(path, json.dumps(value))
    for path, value in options.raw.items():
        if path.partition("/")[0] in _FIXED:
            raise BusError(
                f'zenoh.raw: "{path}" cannot be set there; [zenoh] has settings for it', setting="zenoh.raw"
            )
        try:
            config.insert_json5(path, json.dumps(value))
        except (zenoh.ZError, TypeError) as error:
            raise BusError(
                f'zenoh.raw: "{path}" = {json.dumps(value, default=str)}: {_plain(str(error))}',
                setting="zenoh.raw",
            ) from None
    return config


def _access(options: SessionOptions) -> dict[str, Any]:
    """Rules of access: out goes what is published, in come subscriptions and questions; no data comes in."""
    keys = ["imumon/**", "imumon/**/@adv/**"]  # ** does not match the chunk of the cache's own keys
    out = ["put", "delete", "reply", "declare_queryable", "liveliness_token"]
    into = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"]
    both = sorted({*out, *into})
    outward, inward = (out, into) if options.read_only else (both, both)
    rules = [
        {"id": flow, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
        for flow, messages in (("egress", outward), ("ingress", inward))
    ]
    names = list(options.allow)
    subjects = (
        [{"id": "certificates", "cert_common_names": names}, {"id": "users", "usernames": names}]
        if names
        else [{"id": "everybody"}]
    )
    policy = {"rules": [rule["id"] for rule in rules], "subjects": [subject["id"] for subject in subjects]}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": [policy],
    }


@contextmanager
def _users(options: SessionOptions, listens: bool) -> Iterator[str]:
    """Path of a file with all users that may connect, empty for everybody.

    Zenoh wants a file, and refuses everybody when only `user` is set: so the own name is put beside the
    others.
    """
    if not listens or not options.user:
        yield options.users_file if listens else ""
        return
    if ":" in options.user or "\n" in options.user + options.password:
        raise BusError("zenoh.user: without a colon, please, and all on one line", setting="zenoh.user")
    lines = f"{options.user}:{options.password}\n".encode()
    try:
        if options.users_file:
            lines += Path(options.users_file).read_bytes()
        file = tempfile.NamedTemporaryFile(prefix="imumon-")  # mode 0600  # noqa: SIM115
    except OSError as error:
        message = f"zenoh.user: the list of users cannot be kept: {error.strerror}"
        raise BusError(message, setting="zenoh.user") from None
    with file:
        file.write(lines)
        file.flush()
        yield file.name


_CURES = {
    "unable to connect to any": "nobody answers, or the password or certificate is not the right one",
    "address already in use": "is taken by another daemon or program; choose another with --listen",
    "cannot assign requested address": "is not an address of this machine",
    "permission denied": "no permission; a port above 1023, or a folder that you may write to",
    "no such file or directory": "no such file or folder",
    "failed to lookup address": "no such host",
    "usrpwd": "zenoh.users_file: must be lines of user:password",
    "keymismatch": "zenoh.key: is not the private key of zenoh.certificate",
    "private key": "zenoh.key: is not the private key of zenoh.certificate, in PEM",
    "certificate": "zenoh.certificate or zenoh.ca: is not a certificate, in PEM",
}


def explain(error: Exception, endpoints: Sequence[str]) -> str:
    """Zenoh's error as one line for people."""
    text = str(error)
    where = next((e for e in endpoints if e in text), None) or (endpoints[0] if endpoints else "Zenoh")
    cure = next((cure for sign, cure in _CURES.items() if sign in text.lower()), None)
    return f"{where}: {cure or _plain(text)}"


def _plain(text: str) -> str:
    """An error without the places in Zenoh's own source.

    >>> _plain('Str("unknown key") at /home/x/.cargo/x/config.rs:86.')
    'unknown key'
    """
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", text)
    quoted = re.search(r'(?:Str\(|msg: )"((?:[^"\\]|\\.)*)"', text)
    return " ".join((quoted[1] if quoted else text).split()).rstrip(".]")
