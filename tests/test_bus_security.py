"""Who may read along: passwords and certificates, with the daemon in another process."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from bus_actors import free_port, stage, until
from test_bus_docs import blocks

from imumon.bus import BusError, Publisher, SessionOptions, Subscriber


def gets(place: str, *, timeout: float, **settings: object) -> bool:
    """Whether a viewer with these settings gets a report."""
    with Subscriber([place], settings=SessionOptions(**settings)) as viewer:  # type: ignore[arg-type]
        found = viewer.wait_report("a", timeout=timeout) is not None
        assert found == viewer.connected()
        return found


def test_only_those_with_a_password_get_in(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("ann:secret\nbob:other\n")
    with stage() as start:
        place = f"tcp/127.0.0.1:{free_port()}"
        start("daemon", listen=[place], users_file=str(users)).ready()
        assert gets(place, timeout=5.0, user="ann", password="secret")
        assert gets(place, timeout=5.0, user="bob", password="other")
        assert not gets(place, timeout=0.4, user="ann", password="other")
        assert not gets(place, timeout=0.4, user="eve", password="secret")
        assert not gets(place, timeout=0.4)


def test_the_own_name_and_those_of_the_file_get_in(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_bytes(b"ann:s\xc3\xa4cret\n")
    with stage() as start:
        place = f"tcp/127.0.0.1:{free_port()}"
        settings = {"users_file": str(users), "user": "bob", "password": "other"}
        start("daemon", listen=[place], **settings).ready()
        assert gets(place, timeout=5.0, user="bob", password="other")
        assert gets(place, timeout=5.0, user="ann", password="säcret")
    with pytest.raises(BusError, match="without a colon"):
        Publisher("a", listen=[place], settings=SessionOptions(user="a:b", password="c"))


def test_one_name_in_a_shared_file_of_settings_serves_both_ends() -> None:
    with stage() as start:
        place = f"tcp/127.0.0.1:{free_port()}"
        start("daemon", listen=[place], user="ann", password="secret").ready()
        assert gets(place, timeout=5.0, user="ann", password="secret")
        assert not gets(place, timeout=0.4)


def test_users_that_are_not_allowed_get_nothing(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("ann:secret\nbob:other\n")
    with stage() as start:
        place = f"tcp/127.0.0.1:{free_port()}"
        start("daemon", listen=[place], users_file=str(users), allow=["ann"]).ready()
        assert gets(place, timeout=5.0, user="ann", password="secret")
        with Subscriber([place], settings=SessionOptions(user="bob", password="other")) as viewer:
            until(viewer.connected)
            assert viewer.wait_report(timeout=0.4) is None


def test_a_bad_file_of_users_is_one_line(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("no colon here\n")
    with pytest.raises(BusError, match="users_file: must be lines of user:password"):
        Publisher(
            "a", listen=[f"tcp/127.0.0.1:{free_port()}"], settings=SessionOptions(users_file=str(users))
        )


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an authority and what it signed, made as docs/ZENOH.md says; in `other` another one."""
    if shutil.which("openssl") is None:
        pytest.skip("certificates are made with openssl, which is not here")
    (recipe,) = blocks("sh")
    folder = tmp_path_factory.mktemp("keys")
    (folder / "other").mkdir()
    for place, names in ((folder, "daemon viewer guest"), (folder / "other", "viewer")):
        commands = recipe.replace("daemon viewer", names)
        subprocess.run(["sh", "-euc", commands], cwd=place, check=True, capture_output=True)
    return folder


def identity(keys: Path, name: str, *, ca: str = "ca") -> dict[str, str]:
    return {
        "certificate": str(keys / f"{name}.pem"),
        "key": str(keys / f"{name}.key"),
        "ca": str(keys / f"{ca}.pem"),
    }


def test_only_those_whom_the_authority_signed_get_in(keys: Path) -> None:
    with stage() as start:
        port = free_port()
        place = f"tls/127.0.0.1:{port}"
        start("daemon", listen=[place], **identity(keys, "daemon")).ready()
        assert gets(place, timeout=5.0, **identity(keys, "viewer"))
        assert not gets(place, timeout=0.5, **identity(keys, "other/viewer"))
        assert not gets(place, timeout=0.5, **identity(keys, "other/viewer", ca="other/ca"))
        assert not gets(place, timeout=0.5, **identity(keys, "viewer", ca="other/ca"))
        assert not gets(place, timeout=0.5, ca=str(keys / "ca.pem"))
        assert not gets(f"tcp/127.0.0.1:{port}", timeout=0.5)


def test_names_on_certificates_may_be_listed_and_tls_may_listen_to_the_world(keys: Path) -> None:
    with stage() as start:
        port = free_port()
        place = f"tls/127.0.0.1:{port}"
        start("daemon", listen=[f"tls/0.0.0.0:{port}"], allow=["viewer"], **identity(keys, "daemon")).ready()
        assert gets(place, timeout=5.0, **identity(keys, "viewer"))
        with Subscriber([place], settings=SessionOptions(**identity(keys, "guest"))) as viewer:
            until(viewer.connected)
            assert viewer.wait_report(timeout=0.4) is None


def test_bad_files_of_keys_are_one_line(keys: Path) -> None:
    def fault(**settings: str) -> str:
        with pytest.raises(BusError, match=r"^[^\n]*$") as caught:
            Publisher("a", listen=[f"tls/127.0.0.1:{free_port()}"], settings=SessionOptions(**settings))  # type: ignore[arg-type]
        return str(caught.value)

    right = identity(keys, "daemon")
    assert "cannot be read" in fault(**{**right, "key": "/none.key"})
    assert "zenoh.key" in fault(**{**right, "key": right["ca"]})
    assert "zenoh.certificate" in fault(**{**right, "certificate": right["key"]})
    assert "zenoh.key" in fault(**{**right, "key": str(keys / "viewer.key")})
