"""Metrics: every number of the report once, valid for Prometheus, scraped by a real one where it is installed."""

from __future__ import annotations

import json
import re
import shutil
import socket
import struct
import subprocess
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from daemons import Daemon
from free_ports import free_port
from paths import ROOT
from prometheus_client.parser import text_string_to_metric_families
from reports import warming_up as report
from scraping import scraped, values
from slow_clients import SlowClients
from usage import resident_kb

from imumon.config import ConfigError, load
from imumon.config.settings import LimitSettings
from imumon.history.metrics import MetricsError, MetricsServer
from imumon.report import Event

DOCS = ROOT / "docs" / "monitoring"


@pytest.fixture
def server() -> Iterator[MetricsServer]:
    with closing(MetricsServer(f"127.0.0.1:{free_port()}")) as made:
        made.update(report())
        for kind in ("connect", "disconnect", "connect"):
            made.event(Event(time="", kind=kind, text="", device="imu"))
        yield made


def test_every_number_of_the_report_is_there(server: MetricsServer) -> None:
    made, found = report(), values(scraped(server.address))
    assert found["imumon_up",] == 1.0
    assert found["imumon_samples_total",] == made.session.samples
    assert found["imumon_missing_total",] == made.session.missing
    assert found["imumon_events_total", "connect"] == 2.0
    assert found["imumon_temperature_celsius",] == made.channels["temperature"].last
    for name, channel in made.channels.items():
        for letter in "NBK":
            part = channel.coefficients.get(letter)
            for limit in ("value", "low", "high"):
                known = getattr(part, limit) if part is not None else None
                assert found.get(("imumon_noise", name, letter, limit)) == known
    nearest = made.grade["gyro"].nearest
    assert found["imumon_grade", nearest or "", "nearest", "gyro"] == 1.0
    assert sum(found["imumon_grade", name, "nearest", "gyro"] for name in made.limits["gyro"]["N"]) == 1.0


def test_a_sensor_without_samples_is_down(server: MetricsServer) -> None:
    server.update(replace(report(), state="waiting"))
    found = values(scraped(server.address))
    assert found["imumon_up",] == 0.0
    assert 0.0 <= found["imumon_report_age_seconds",] < 60.0


def test_there_are_no_numbers_before_the_first_report() -> None:
    with closing(MetricsServer(f"127.0.0.1:{free_port()}")) as made:
        assert values(scraped(made.address)) == {}


def test_a_port_in_use_is_passed_over(server: MetricsServer) -> None:
    port = int(server.address.rpartition(":")[2])
    with closing(MetricsServer(server.address)) as other:
        assert port < int(other.address.rpartition(":")[2]) <= port + 15


def test_an_address_of_another_machine_is_an_error() -> None:
    with pytest.raises(MetricsError) as refused:
        MetricsServer("203.0.113.7:9847")
    assert refused.value.code == "metrics_not_served"


@pytest.mark.parametrize("listen", ["9847", "localhost", "localhost:x", "a b:1"])
def test_an_address_that_is_none(tmp_path: Path, listen: str) -> None:
    file = tmp_path / "config.toml"
    file.write_text(f'[metrics]\nlisten = "{listen}"\n')
    with pytest.raises(ConfigError):
        load(file)


def test_the_documents_use_metrics_that_exist(server: MetricsServer) -> None:
    known = {
        f"{f.name}{'_total' if f.type == 'counter' else ''}"
        for f in text_string_to_metric_families(scraped(server.address))
    }
    dashboard = json.loads((DOCS / "grafana-dashboard.json").read_text())
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    used = set(re.findall(r"\bimumon_\w+", " ".join(expressions) + (DOCS / "alerts.yml").read_text()))
    assert used <= known
    assert set(re.findall(r"^\| `(imumon_\w+)`", (DOCS / "README.md").read_text(), re.MULTILINE)) == known


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed (Debian: prometheus)")
def test_promtool_finds_nothing_wrong(server: MetricsServer) -> None:
    done = subprocess.run(
        ["promtool", "check", "metrics"],
        input=scraped(server.address),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    rules = subprocess.run(
        ["promtool", "check", "rules", str(DOCS / "alerts.yml")], capture_output=True, text=True, check=False
    )
    assert rules.returncode == 0, rules.stderr


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("prometheus") is None, reason="prometheus is not installed (Debian: prometheus)"
)
def test_prometheus_scrapes_a_daemon_and_raises_the_alert_when_it_ends(tmp_path: Path) -> None:
    port, own = free_port(), free_port()
    settings = tmp_path / "config.toml"
    settings.write_text(f'[metrics]\nlisten = "127.0.0.1:{port}"\n')
    rules = re.sub(r"for: \w+", "for: 1s", (DOCS / "alerts.yml").read_text())
    (tmp_path / "alerts.yml").write_text(rules)
    (tmp_path / "prometheus.yml").write_text(
        "global: {scrape_interval: 1s, evaluation_interval: 1s}\nrule_files: [alerts.yml]\nscrape_configs:\n"
        f'  - job_name: imumon\n    static_configs: [{{targets: ["127.0.0.1:{port}"]}}]\n'
    )

    def query(path: str) -> list[dict[str, dict[str, str]]]:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{own}/api/v1/{path}", timeout=5) as reply:
                data = json.load(reply)["data"]
                return list(data.get("result") or data.get("alerts") or [])
        except OSError:
            return []

    def until(path: str, name: str, label: str) -> dict[str, str]:
        end = time.monotonic() + 60
        while time.monotonic() < end:
            for each in query(path):
                labels = each.get("metric") or each.get("labels") or {}
                if labels.get(label) == name:
                    return labels
            time.sleep(0.3)
        raise AssertionError(f"{path} has no {name}")

    words = ("--id", "lab", "--config", str(settings))
    command = [
        "prometheus", f"--config.file={tmp_path}/prometheus.yml", f"--storage.tsdb.path={tmp_path}/data",
        f"--web.listen-address=127.0.0.1:{own}", "--log.level=error",
    ]  # fmt: skip
    with Daemon("sim", tmp_path / "state", *words) as daemon, subprocess.Popen(command) as prometheus:
        try:
            daemon.wait(lambda r: r.session.elapsed_s > 5)
            until("query?query=imumon_up==1", "lab", "device")
            until("query?query=imumon_noise%7Blimit=%22value%22%7D", "gyro/x", "channel")
            assert not query("alerts")
            daemon.stop()
            until("alerts", "ImumonDown", "alertname")
        finally:
            prometheus.terminate()


LIMITS = LimitSettings(connections=8, request_s=1.0)


def connected(server: MetricsServer) -> socket.socket:
    host, _, port = server.address.rpartition(":")
    return socket.create_connection((host, int(port)), timeout=30)


def test_a_request_that_stops_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    """A client that is slow, or gone, is no traceback in the log of the daemon."""
    with closing(MetricsServer(f"127.0.0.1:{free_port()}", LIMITS)) as server:
        clients = [connected(server) for _ in range(20)]
        for client in clients:
            client.sendall(b"GET /metrics HT")
        for client in clients[:10]:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()  # with a reset
        for client in clients[10:]:
            with client:
                assert ended(client)  # the server gives up
    assert "Traceback" not in "".join(capfd.readouterr())


def ended(client: socket.socket) -> bool:
    """Whether the server closes, or resets, a connection within its time limit."""
    try:
        return client.recv(1) == b""
    except ConnectionError:
        return True


def test_many_clients_that_stop_delay_no_other(server: MetricsServer) -> None:
    """The kernel repeats a connection that finds the queue of the server full after 1 s."""
    with ExitStack() as clients:
        begin = time.monotonic()
        for _ in range(100):
            clients.enter_context(connected(server)).sendall(b"GET /metrics HT")
        assert values(scraped(server.address))["imumon_up",] == 1.0
        assert time.monotonic() - begin < 20.0  # of 100 that are repeated


def test_a_byte_now_and_then_prolongs_no_request_and_takes_no_thread() -> None:
    """Each read ends in time, the request does not: only a deadline for all of it ends such clients."""
    with closing(MetricsServer(f"127.0.0.1:{free_port()}", LIMITS)) as server, ExitStack() as clients:
        server.update(report())
        before = threading.active_count()
        slow = [clients.enter_context(connected(server)) for _ in range(60)]
        begin, most = time.monotonic(), 0
        while time.monotonic() - begin < 4.0:
            for client in slow:
                with suppress(OSError):
                    client.sendall(b"G")
            most = max(most, threading.active_count() - before)
            time.sleep(0.2)
        # one too many lives until its connection is closed, and the one for which it is closed exists already
        assert most <= LIMITS.connections + 2
        assert all(map(ended, slow))
        assert values(scraped(server.address))["imumon_up",] == 1.0
        begin = time.monotonic()
    assert time.monotonic() - begin < 3.0


@pytest.mark.parametrize("request_", [b"GET /metrics HTTP/1.1\r\nA: " + b"x" * (1 << 20), b"\0" * (1 << 20)])
def test_a_request_without_an_end_is_closed(server: MetricsServer, request_: bytes) -> None:
    with connected(server) as client:
        with suppress(ConnectionError):
            client.sendall(request_)
        assert ended(client)


@pytest.mark.slow
def test_1100_slow_clients_disturb_no_daemon(tmp_path: Path) -> None:
    """It measures, publishes, saves in its period, answers, and ends in time; its log stays short."""
    settings, port = tmp_path / "config.toml", free_port()
    settings.write_text(f'[metrics]\nlisten = "127.0.0.1:{port}"\n[state]\nsave_period_s = 2.0\n')
    few = ("prlimit", "--nofile=256")
    with Daemon("sim", tmp_path / "state", "--config", str(settings), before=few) as daemon:
        calm = daemon.wait(lambda r: r.session.elapsed_s > 5)
        attack = SlowClients(port, 1100)
        try:
            quiet = 1024.0 * resident_kb(daemon.process.pid)
            end, oldest = time.monotonic() + 30, 0.0
            while time.monotonic() < end:
                (state,) = (tmp_path / "state").glob("*.state")
                oldest = max(oldest, time.time() - state.stat().st_mtime)
                begin = time.monotonic()
                assert daemon.metrics["imumon_up",] == 1.0
                assert time.monotonic() - begin < 20.0
                time.sleep(1.0)
            assert oldest < 6.0  # two periods, and a busy machine
            assert 1024.0 * resident_kb(daemon.process.pid) - quiet < 20e6
            last = daemon.wait(lambda r: r.session.elapsed_s > calm.session.elapsed_s + 20)
            assert last.session.missing == calm.session.missing
            begin = time.monotonic()
            code, _, said = daemon.stop()
            assert time.monotonic() - begin < 10.0
        finally:
            attack.stop()
        assert code == 0
        assert len(said.splitlines()) < 50
