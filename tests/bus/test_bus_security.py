"""Access by password and certificate, with the daemon in another process."""

from __future__ import annotations

import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh
from bus_actors import free_endpoint, stage
from free_ports import free_port
from test_bus_docs import blocks
from waiting import until

from imumon.bus import BusError, Publisher, SessionOptions, Subscriber
from imumon.bus.zenoh_session import open_session


def receives(address: str, *, timeout: float, **settings: object) -> bool:
    """Return whether a subscriber with these settings gets a report."""
    with Subscriber([address], settings=SessionOptions(**settings)) as subscriber:
        received = subscriber.wait_report("a", timeout=timeout) is not None
        assert received == subscriber.connected()
        return received


def test_only_users_with_the_right_password_get_reports(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("ann:secret\nbob:other\n")
    with stage() as start:
        address = f"tcp/127.0.0.1:{free_port()}"
        start("daemon", listen=[address], users_file=str(users)).ready()
        assert receives(address, timeout=30.0, user="ann", password="secret")
        assert receives(address, timeout=30.0, user="bob", password="other")
        assert not receives(address, timeout=0.4, user="ann", password="other")
        assert not receives(address, timeout=0.4, user="eve", password="secret")
        assert not receives(address, timeout=0.4)


def test_the_user_of_the_settings_and_those_of_the_file_get_reports(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_bytes(b"ann:s\xc3\xa4cret\n")
    with stage() as start:
        address = f"tcp/127.0.0.1:{free_port()}"
        settings = {"users_file": str(users), "user": "bob", "password": "other"}
        start("daemon", listen=[address], **settings).ready()
        assert receives(address, timeout=30.0, user="bob", password="other")
        assert receives(address, timeout=30.0, user="ann", password="säcret")
    with pytest.raises(BusError) as caught:
        Publisher("a", listen=[address], settings=SessionOptions(user="a:b", password="c"))
    assert (caught.value.code, caught.value.setting) == ("user_invalid", "zenoh.user")


def test_the_same_settings_serve_daemon_and_subscriber() -> None:
    with stage() as start:
        address = f"tcp/127.0.0.1:{free_port()}"
        start("daemon", listen=[address], user="ann", password="secret").ready()
        assert receives(address, timeout=30.0, user="ann", password="secret")
        assert not receives(address, timeout=0.4)


def test_users_that_are_not_allowed_get_no_reports(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("ann:secret\nbob:other\n")
    with stage() as start:
        address = f"tcp/127.0.0.1:{free_port()}"
        start("daemon", listen=[address], users_file=str(users), allow=["ann"]).ready()
        assert receives(address, timeout=30.0, user="ann", password="secret")
        with Subscriber([address], settings=SessionOptions(user="bob", password="other")) as subscriber:
            until(subscriber.connected)
            assert subscriber.wait_report(timeout=0.4) is None


def test_an_invalid_file_of_users_has_its_code(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("no colon here\n")
    with pytest.raises(BusError, match=r"^[^\n]*$") as caught:
        Publisher(
            "a", listen=[f"tcp/127.0.0.1:{free_port()}"], settings=SessionOptions(users_file=str(users))
        )
    assert caught.value.code == "users_file_invalid"
    assert str(users) in caught.value.message


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


def test_only_certificates_of_the_authority_get_reports(keys: Path) -> None:
    with stage() as start:
        port = free_port()
        address = f"tls/127.0.0.1:{port}"
        start("daemon", listen=[address], **identity(keys, "daemon")).ready()
        assert receives(address, timeout=30.0, **identity(keys, "viewer"))
        assert not receives(address, timeout=0.5, **identity(keys, "other/viewer"))
        assert not receives(address, timeout=0.5, **identity(keys, "other/viewer", ca="other/ca"))
        assert not receives(address, timeout=0.5, **identity(keys, "viewer", ca="other/ca"))
        assert not receives(address, timeout=0.5, ca=str(keys / "ca.pem"))
        assert not receives(f"tcp/127.0.0.1:{port}", timeout=0.5)


def test_allow_lists_common_names_and_tls_may_listen_on_every_interface(keys: Path) -> None:
    with stage() as start:
        port = free_port()
        address = f"tls/127.0.0.1:{port}"
        start("daemon", listen=[f"tls/0.0.0.0:{port}"], allow=["viewer"], **identity(keys, "daemon")).ready()
        assert receives(address, timeout=30.0, **identity(keys, "viewer"))
        with Subscriber([address], settings=SessionOptions(**identity(keys, "guest"))) as subscriber:
            until(subscriber.connected)
            assert subscriber.wait_report(timeout=0.4) is None


def test_invalid_key_and_certificate_files_have_their_codes(keys: Path) -> None:
    def code(**settings: str) -> str:
        with pytest.raises(BusError, match=r"^[^\n]*$") as caught:
            Publisher("a", listen=[f"tls/127.0.0.1:{free_port()}"], settings=SessionOptions(**settings))
        return caught.value.code

    right = identity(keys, "daemon")
    assert code(**{**right, "key": "/none.key"}) == "file_unreadable"
    assert code(**{**right, "key": right["ca"]}) == "key_invalid"
    assert code(**{**right, "certificate": right["key"]}) == "certificate_invalid"
    assert code(**{**right, "key": str(keys / "viewer.key")}) == "key_invalid"


def test_a_router_lets_daemons_publish_and_viewers_read(keys: Path) -> None:
    """With the configuration of docs/ZENOH.md: what a viewer or an unknown certificate publishes reaches nobody."""
    (text,) = blocks("json5")
    address = f"tls/127.0.0.1:{free_port()}"
    text = text.replace("/etc/zenoh", str(keys)).replace("tls/0.0.0.0:7449", address)
    with stage() as start, zenoh.open(zenoh.Config.from_json5(text)):
        start("daemon", listen=[free_endpoint()], connect=[address], **identity(keys, "daemon")).ready()
        assert receives(address, timeout=30.0, **identity(keys, "viewer"))
        assert not receives(address, timeout=0.5, **identity(keys, "other/viewer"))
        with Subscriber([address], settings=SessionOptions(**identity(keys, "guest"))) as guest:
            until(guest.connected)
            assert guest.wait_report(timeout=0.4) is None
        with Subscriber([address], settings=SessionOptions(**identity(keys, "viewer"))) as viewer:
            assert viewer.wait_report("a", timeout=30.0) is not None
            for name in ("viewer", "guest"):
                with forger(address, **identity(keys, name)) as session:
                    for _ in range(20):
                        session.put("imumon/a/report", "forged")
                        time.sleep(0.02)
            assert not viewer.rivals()
            with forger(address, **identity(keys, "daemon")) as session:
                until(lambda: session.put("imumon/a/report", "forged") or viewer.rivals())


def forger(address: str, **settings: str) -> zenoh.Session:
    options = replace(SessionOptions(**settings), mode="client")
    return open_session(options, (), [address], access_control=False)
