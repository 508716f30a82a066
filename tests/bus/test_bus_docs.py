"""docs/ZENOH.md is correct: its settings are valid, and its private directory keeps others out."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from pathlib import Path

import pytest
from bus_actors import stage
from paths import ROOT

from imumon.bus import Subscriber
from imumon.config import load

TEXT = (ROOT / "docs" / "ZENOH.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("text", blocks("toml"))
def test_the_settings_are_valid(text: str, tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    file.write_text(text)
    settings = load(file)
    assert "config.toml" in " ".join(settings.origins.values())


def test_another_user_cannot_connect_to_a_socket_in_a_private_directory(tmp_path: Path) -> None:
    """With the command and the endpoint of the document, below another directory."""
    if os.geteuid() != 0:
        pytest.skip("another user is needed")
    (command,) = re.findall(r"`(mkdir -m 700 /home/me/imumon)`", TEXT)
    (endpoint,) = set(re.findall(r'"(unixsock-stream//home/me/[^"]+)"', TEXT))
    with tempfile.TemporaryDirectory() as home:
        os.chmod(home, 0o755)
        subprocess.run(command.replace("/home/me", home).split(), check=True)
        path = endpoint.replace("/home/me", home).removeprefix("unixsock-stream/")
        reach = f"import socket; socket.socket(socket.AF_UNIX).connect({path!r})"
        with stage() as start:
            start("daemon", id="imu-1", listen=[f"unixsock-stream/{path}"]).ready()
            os.chmod(path, 0o777)  # the directory alone keeps others out
            with Subscriber([f"unixsock-stream/{path}"]) as subscriber:
                assert subscriber.wait_report("imu-1", timeout=30.0) is not None
            python = ["/usr/bin/env", "python3", "-c", reach]
            assert subprocess.run(python, check=False).returncode == 0
            refused = subprocess.run(python, user=65534, group=65534, extra_groups=[],
                                     capture_output=True, text=True, check=False)  # fmt: skip
            assert "PermissionError" in refused.stderr
