"""A machine with a real systemd, booted for a test: its own root, network and processes, this one's /usr.

Programs come from here, read-only; everything else is thrown away. `imumon` stands in /usr/local/bin as an
installation would put it, and an emulated sensor waits on /dev/ttySIM.
"""

from __future__ import annotations

import json
import os
import shutil
import site
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from commands import manual_page
from paths import ROOT

BOOT_S = 60.0
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
SENSOR = """[Unit]
Description=an emulated sensor

[Service]
ExecStart=imumon sim --link /dev/ttySIM --rate 100 --baud 921600 --seed 1
ExecStartPost=timeout 10 sh -c "until chgrp dialout /dev/ttySIM; do sleep 0.02; done; chmod g+rw /dev/ttySIM"
"""
TARGET = """[Unit]
Description=a machine with a sensor
Requires=sensor.service
After=sensor.service
"""


def lacking() -> str | None:
    """Why no such machine can be booted here, None when one can."""
    if os.geteuid() != 0:
        return "a machine is booted by root alone"
    missing = [name for name in ("systemd-nspawn", "nsenter") if shutil.which(name) is None]
    return f"{missing[0]} is not installed" if missing else None


class Machine:
    """Booted when the context is entered, powered off when it is left."""

    def __init__(self, directory: Path, drop_in: str = "") -> None:
        self.root = directory / "root"
        self._drop_in = drop_in
        self._console = directory / "console"
        self._process: subprocess.Popen[bytes] | None = None
        self._first = 0

    def __enter__(self) -> Machine:
        binds = self._furnish()
        command = ["systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--private-network", "--boot"]
        # the filters of devices and addresses are programs that systemd loads into the kernel
        command += ["--capability=CAP_BPF,CAP_PERFMON", "--system-call-filter=bpf"]
        command += [f"--directory={self.root}", *(f"--bind-ro={bind}" for bind in binds)]
        with self._console.open("wb") as console:
            self._process = subprocess.Popen(
                [*command, "systemd.unit=test.target", "systemd.firstboot=no"],
                stdin=subprocess.DEVNULL, stdout=console, stderr=console,
                env={**os.environ, "SYSTEMD_NSPAWN_UNIFIED_HIERARCHY": "1"},
            )  # fmt: skip
        try:
            self.until(self._is_up, BOOT_S)
        except AssertionError:
            self.__exit__()
            raise AssertionError(self._console.read_text(errors="replace")) from None
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()  # nspawn powers the machine off
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(20)

    def run(self, *words: str, check: bool = True) -> str:
        """Standard output of a command on the machine."""
        inside = ["nsenter", "--target", str(self._first), "--all", "--"]
        done = subprocess.run(
            [*inside, *words], capture_output=True, text=True, timeout=60, check=False, env={"PATH": PATH}
        )
        assert done.returncode == 0 or not check, f"{words}: {done.stdout}{done.stderr}"
        return done.stdout

    def show(self, unit: str, name: str) -> str:
        """A property of a unit."""
        return self.run("systemctl", "show", "--property", name, "--value", unit).strip()

    def journal(self, unit: str, *words: str) -> list[str]:
        """Lines that a unit has said."""
        said = self.run("journalctl", "--quiet", "--output=cat", "--unit", unit, *words)
        return said.splitlines()

    def until(self, holds: Callable[[], bool], within_s: float = 20.0) -> float:
        """Seconds until something held."""
        start = time.monotonic()
        while not holds():
            took = time.monotonic() - start
            assert took < within_s, f"not within {within_s:g} s"
            assert self._process.poll() is None, "the machine is off"
            time.sleep(0.02)
        return time.monotonic() - start

    def took_s(self, unit: str, first: str, last: str) -> float:
        """Seconds between the last two lines of the manager on a unit that begin so, by the journal."""
        lines = self.run("journalctl", "--quiet", "--output=json", f"UNIT={unit}").splitlines()
        said = [json.loads(line) for line in lines]
        times = [
            max(int(line["__MONOTONIC_TIMESTAMP"]) for line in said if line["MESSAGE"].startswith(word))
            for word in (first, last)
        ]
        return (times[1] - times[0]) / 1e6

    def process(self, unit: str) -> int:
        """A unit's main process, by its number outside of the machine."""
        inside = self.show(unit, "MainPID")
        for status in Path("/proc").glob("[0-9]*/status"):
            numbers = _field(status, "NSpid").split()
            if numbers[1:] == [inside] and _in_machine(int(numbers[0]), self._first):
                return int(numbers[0])
        raise AssertionError(f"{unit} has no process")

    def _furnish(self) -> list[str]:
        """Make the root; what is bound into it."""
        for name in ("bin", "sbin", "lib", "lib64"):
            if Path("/", name).is_symlink():
                self.root.mkdir(parents=True, exist_ok=True)
                (self.root / name).symlink_to(os.readlink(f"/{name}"))
        local = self.root / "opt/local"
        for place in ("usr/lib", "etc/systemd/system", "opt/local/bin", "opt/local/share", "opt/site"):
            (self.root / place).mkdir(parents=True)
        (self.root / "usr/lib/os-release").write_text("ID=test\n")  # else nspawn takes it for no system
        (self.root / "etc/passwd").write_text("root:x:0:0:root:/root:/bin/sh\n")
        (self.root / "etc/group").write_text("root:x:0:\ntty:x:5:\ndialout:x:20:\n")
        binds = ["/usr", f"{local}:/usr/local", f"{ROOT / 'imumon'}:/opt/site/imumon"]
        binds.append(f"{site.getsitepackages()[0]}:/opt/packages")
        python = Path(sys.base_prefix)
        if not python.is_relative_to("/usr"):  # a home is hidden from a service
            binds.append(f"{python}:/opt/python")
            python = Path("/opt/python")
        program = local / "bin/imumon"
        name = f"python{sys.version_info.major}.{sys.version_info.minor}"
        program.write_text(
            "#!/bin/sh\nexport PYTHONPATH=/opt/site:/opt/packages PYTHONDONTWRITEBYTECODE=1 "
            f'LD_LIBRARY_PATH={python}/lib\nexec {python}/bin/{name} -m imumon "$@"\n'
        )
        program.chmod(0o755)
        pages = local / "share/man/man1"
        pages.mkdir(parents=True)
        (pages / "imumon.1").write_text(manual_page())
        if Path("/etc/manpath.config").exists():
            shutil.copy("/etc/manpath.config", self.root / "etc")
        units = self.root / "etc/systemd/system"
        shutil.copy(ROOT / "systemd/imumon@.service", units)
        (units / "sensor.service").write_text(SENSOR)
        (units / "test.target").write_text(TARGET)
        if self._drop_in:
            (units / "imumon@.service.d").mkdir()
            (units / "imumon@.service.d/test.conf").write_text(self._drop_in)
        return binds

    def _is_up(self) -> bool:
        children = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        for child in children:
            if _field(Path(f"/proc/{child}/status"), "NSpid").split()[-1:] == ["1"]:
                self._first = int(child)
                return self.run("systemctl", "is-active", "test.target", check=False).strip() == "active"
        return False


def _field(status: Path, name: str) -> str:
    """A field of a process's status, empty when the process is gone."""
    try:
        lines = status.read_text().splitlines()
    except OSError:
        return ""
    return next((line.partition(":")[2] for line in lines if line.startswith(f"{name}:")), "")


def _in_machine(process: int, first: int) -> bool:
    return os.readlink(f"/proc/{process}/ns/pid") == os.readlink(f"/proc/{first}/ns/pid")
