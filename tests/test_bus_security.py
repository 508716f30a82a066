"""Who may read along: passwords and certificates, with the daemon in another process."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from bus_actors import free_port, stage, until

from imumon.bus import BusError, Options, Publisher, Viewer


def gets(place: str, *, timeout: float, **settings: object) -> bool:
    """Whether a viewer with these settings gets a report."""
    with Viewer([place], settings=Options(**settings)) as viewer:  # type: ignore[arg-type]
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
        with Viewer([place], settings=Options(user="bob", password="other")) as viewer:
            until(viewer.connected)
            assert viewer.wait_report(timeout=0.4) is None


def test_a_bad_file_of_users_is_one_line(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("no colon here\n")
    with pytest.raises(BusError, match="users_file: must be lines of user:password"):
        Publisher("a", listen=[f"tcp/127.0.0.1:{free_port()}"], settings=Options(users_file=str(users)))


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two authorities and what they signed: the commands of docs/ZENOH.md."""
    if shutil.which("openssl") is None:
        pytest.skip("certificates are made with openssl, which is not here")
    folder = tmp_path_factory.mktemp("keys")
    for authority, names in (("ca", ("daemon", "viewer", "guest")), ("other", ("stranger",))):
        make(folder, "req", "-x509", "-days", "3650", "-subj", f"/CN={authority}", *new_key(authority))
        for name in names:
            make(folder, "req", "-subj", f"/CN={name}", *new_key(name, out="csr"))
            (folder / f"{name}.ext").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
            make(
                folder,
                *("x509", "-req", "-days", "365", "-in", f"{name}.csr", "-out", f"{name}.pem"),
                *("-CA", f"{authority}.pem", "-CAkey", f"{authority}.key", "-CAcreateserial"),
                *("-extfile", f"{name}.ext"),
            )
    return folder


def new_key(name: str, *, out: str = "pem") -> tuple[str, ...]:
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    return (*curve, "-keyout", f"{name}.key", "-out", f"{name}.{out}")


def make(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


def identity(keys: Path, name: str, authority: str = "ca") -> dict[str, str]:
    return {
        "certificate": str(keys / f"{name}.pem"),
        "key": str(keys / f"{name}.key"),
        "ca": str(keys / f"{authority}.pem"),
    }


def test_only_those_whom_the_authority_signed_get_in(keys: Path) -> None:
    with stage() as start:
        port = free_port()
        place = f"tls/127.0.0.1:{port}"
        start("daemon", listen=[place], **identity(keys, "daemon")).ready()
        assert gets(place, timeout=5.0, **identity(keys, "viewer"))
        assert not gets(place, timeout=0.5, **identity(keys, "stranger"))
        assert not gets(place, timeout=0.5, **identity(keys, "stranger", "other"))
        assert not gets(place, timeout=0.5, **identity(keys, "viewer", "other"))
        assert not gets(place, timeout=0.5, ca=str(keys / "ca.pem"))
        assert not gets(f"tcp/127.0.0.1:{port}", timeout=0.5)


def test_names_on_certificates_may_be_listed_and_tls_may_listen_to_the_world(keys: Path) -> None:
    with stage() as start:
        port = free_port()
        place = f"tls/127.0.0.1:{port}"
        start("daemon", listen=[f"tls/0.0.0.0:{port}"], allow=["viewer"], **identity(keys, "daemon")).ready()
        assert gets(place, timeout=5.0, **identity(keys, "viewer"))
        with Viewer([place], settings=Options(**identity(keys, "guest"))) as viewer:
            until(viewer.connected)
            assert viewer.wait_report(timeout=0.4) is None


def test_bad_files_of_keys_are_one_line(keys: Path) -> None:
    def fault(**settings: str) -> str:
        with pytest.raises(BusError, match=r"^[^\n]*$") as caught:
            Publisher("a", listen=[f"tls/127.0.0.1:{free_port()}"], settings=Options(**settings))  # type: ignore[arg-type]
        return str(caught.value)

    right = identity(keys, "daemon")
    assert "cannot be read" in fault(**{**right, "key": "/none.key"})
    assert "zenoh.key" in fault(**{**right, "key": right["ca"]})
    assert "zenoh.certificate" in fault(**{**right, "certificate": right["key"]})
    assert "zenoh.key" in fault(**{**right, "key": str(keys / "viewer.key")})
