"""Sessions of Zenoh as other programs open them: without code of imumon."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import zenoh

QUIET: dict[str, object] = {"scouting/multicast/enabled": False, "transport/shared_memory/enabled": False}


def opened(settings: Mapping[str, object]) -> zenoh.Session:
    """Open a session with these settings, by their paths."""
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def client(endpoint: str) -> zenoh.Session:
    return opened({**QUIET, "mode": "client", "connect/endpoints": [endpoint]})


def peer(endpoint: str) -> zenoh.Session:
    return opened({**QUIET, "mode": "peer", "connect/endpoints": [endpoint], "listen/endpoints": []})


def router(endpoint: str, passwords: Path | None = None) -> zenoh.Session:
    """Open a bare router, such as a site may have, in this process; with a file of users, it asks for a password."""
    settings = {**QUIET, "mode": "router", "listen/endpoints": [endpoint], "scouting/gossip/enabled": False}
    if passwords is not None:
        settings["transport/auth/usrpwd/dictionary_file"] = str(passwords)
    return opened(settings)
