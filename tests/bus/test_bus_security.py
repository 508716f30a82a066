"""Access by password and certificate, as docs/ZENOH.md says."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest
import zenoh
import zenoh_sessions
from bus_actors import stage
from free_ports import free_endpoint, free_port
from paths import ROOT
from waiting import until

from imumon.bus import Subscriber
from imumon.bus.zenoh_session import open_session
from imumon.config import ZenohSettings, load


def receives(address: str, *, timeout: float, **settings: object) -> bool:
    """Return whether a subscriber with these settings gets a report."""
    with Subscriber([address], settings=ZenohSettings(**settings)) as subscriber:
        received = subscriber.wait_report("a", timeout=timeout) is not None
        assert received == subscriber.connected()
        return received


def test_a_router_may_ask_for_a_password(tmp_path: Path) -> None:
    users, address = tmp_path / "users", free_endpoint()
    users.write_text("ann:secret\n")
    login = {"user": "ann", "password": "secret"}
    with stage() as start, zenoh_sessions.router(address, passwords=users):
        start("daemon", listen=[free_endpoint()], connect=[address], **login).ready()
        assert receives(address, timeout=60.0, **login)
        assert not receives(address, timeout=0.4, user="ann", password="other")
        assert not receives(address, timeout=0.4)


def test_the_login_of_a_router_is_not_asked_of_viewers_of_this_machine() -> None:
    with stage() as start:
        address = free_endpoint()
        start("daemon", listen=[address], user="ann", password="secret").ready()
        assert receives(address, timeout=60.0)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with a certificate authority and its certificates by docs/ZENOH.md; another one in `other`."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl, which makes the certificates, is not installed")
    (recipe,) = blocks("sh")
    root = tmp_path_factory.mktemp("keys")
    (root / "other").mkdir()
    for directory, names in ((root, "router daemon viewer guest"), (root / "other", "viewer")):
        commands = recipe.replace("router daemon viewer", names)
        subprocess.run(["sh", "-euc", commands], cwd=directory, check=True, capture_output=True)
    return root


def identity(keys: Path, name: str, *, ca: str = "ca") -> dict[str, str]:
    return {
        "certificate": str(keys / f"{name}.pem"),
        "key": str(keys / f"{name}.key"),
        "ca": str(keys / f"{ca}.pem"),
    }


def test_a_router_lets_daemons_publish_and_viewers_read(keys: Path) -> None:
    """With the configuration of docs/ZENOH.md: what a viewer or an unknown certificate publishes reaches nobody."""
    (text,) = blocks("json5")
    address = f"tls/127.0.0.1:{free_port()}"
    text = text.replace("/etc/zenoh", str(keys)).replace("tls/0.0.0.0:7449", address)
    with stage() as start, zenoh.open(zenoh.Config.from_json5(text)):
        start("daemon", listen=[free_endpoint()], connect=[address], **identity(keys, "daemon")).ready()
        assert receives(address, timeout=60.0, **identity(keys, "viewer"))
        assert not receives(address, timeout=0.5, **identity(keys, "other/viewer"))
        assert not receives(address, timeout=0.5, **identity(keys, "viewer", ca="other/ca"))
        assert not receives(address, timeout=0.5, ca=str(keys / "ca.pem"))
        with Subscriber([address], settings=ZenohSettings(**identity(keys, "guest"))) as guest:
            until(guest.connected)
            assert guest.wait_report(timeout=0.4) is None
        with Subscriber([address], settings=ZenohSettings(**identity(keys, "viewer"))) as viewer:
            assert viewer.wait_report("a", timeout=60.0) is not None
            for name in ("viewer", "guest"):
                with forger(address, **identity(keys, name)) as session:
                    for _ in range(20):
                        session.put("imumon/a/report", "forged")
                        time.sleep(0.02)
            assert not viewer.rivals()
            with forger(address, **identity(keys, "daemon")) as session:
                until(lambda: session.put("imumon/a/report", "forged") or viewer.rivals())


def forger(address: str, **settings: str) -> zenoh.Session:
    return open_session(ZenohSettings(**settings), (), [address], access_control=False, client=True)


TEXT = (ROOT / "docs" / "ZENOH.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("text", blocks("toml"))
def test_the_settings_are_valid(text: str, tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    file.write_text(text)
    settings = load(file)
    assert "config.toml" in " ".join(settings.origins.values())
