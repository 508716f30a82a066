"""A real daemon in a process of its own, on an emulator, with its own endpoint and state; and its metrics."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from forked import Captured, Forked, content, new_file
from free_ports import free_endpoint, free_port
from prometheus_client.parser import text_string_to_metric_families
from waiting import until

from imumon.bus import Subscriber
from imumon.model.report import Channel, Report


def n_is_within_a_tenth(channel: Channel) -> bool:
    """Whether the limits of N are close to it; a first report of half a second of samples has N within a quarter."""
    n = channel.coefficients["N"]
    return n.value is not None and n.high is not None and n.high < 1.1 * n.value


class Daemon:
    """`imumon run` with the given words; end it with `stop`, or leave the context.

    Parameters
    ----------
    before : words in front of the command, such as ``unshare``, that make its world and then become it.
    environment : variables beside those of the test.
    """

    def __init__(
        self,
        port: str,
        state: Path,
        *words: str,
        listen: str | None = None,
        before: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.endpoint = listen or free_endpoint()
        words = ("run", "--port", port, "--state", str(state), "--listen", self.endpoint, *words)
        self._out, self._err = new_file(), new_file()
        self.process: Forked | subprocess.Popen[bytes]
        with open(os.devnull) as nothing:
            # a copy of this process has its libraries already
            if before or "LD_PRELOAD" in (environment or {}):
                self.process = subprocess.Popen(
                    [*before, sys.executable, "-m", "imumon", *words],
                    env={**os.environ, **(environment or {})},
                    stdin=nothing,
                    stdout=self._out,
                    stderr=self._err,
                )
            else:
                streams = (nothing.fileno(), self._out.fileno(), self._err.fileno())
                self.process = Forked(words, streams, environment=environment)
        self.viewer = Subscriber([self.endpoint])

    @property
    def log(self) -> str:
        """What it has said on stderr so far."""
        return content(self._err)

    def ended(self, within_s: float = 60.0) -> tuple[str, str]:
        """What it said, once it has ended."""
        self.process.wait(within_s)
        return content(self._out), content(self._err)

    def wait(self, holds: Callable[[Report], bool], timeout: float = 120.0) -> Report:
        """First report for which something holds."""
        deadline = time.monotonic() + timeout
        last: Report | None = None
        while time.monotonic() < deadline:
            for last, _ in self.viewer.reports().values():
                if holds(last):
                    return last
            if self.process.poll() is not None:
                break
            time.sleep(0.02)
        seen = f"last report: {last and (last.state, last.session)}; log: {self.log[-1000:]}"
        raise AssertionError(f"it did not come to it; {seen}")

    def samples(self, count: int = 100) -> Report:
        """First report with so many samples."""
        return self.wait(lambda r: r.session.samples >= count)

    def stop(self, how: signal.Signals = signal.SIGTERM) -> tuple[int, str, str]:
        """End it: exit code, stdout and stderr."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        out, err = self.ended()
        self.viewer.close()
        assert "Traceback" not in err, err
        return self.process.returncode, out, err

    def __enter__(self) -> Daemon:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.ended()
        self.viewer.close()


class MetricsViewer:
    """`imumon metrics` of the daemon on an endpoint, until the context is left.

    Parameters
    ----------
    file : to write; None: it listens on `address`, and does so when the context begins.
    """

    def __init__(self, endpoint: str, *words: str, file: Path | None = None) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        where = ("--listen", self.address) if file is None else ("--file", str(file))
        self._listens = file is None
        self._process = Captured(("metrics", *where, "--connect", endpoint, *words))

    def __enter__(self) -> MetricsViewer:
        until(lambda: self.address in self._process.err or not self._listens)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(60)
        assert "Traceback" not in self._process.err


def scraped(address: str) -> str:
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=60) as reply:
        return str(reply.read().decode())


def values(text: str) -> dict[tuple[str, ...], float]:
    """Values by name and labels without the device."""
    return {
        (
            sample.name,
            *(value for name, value in sorted(sample.labels.items()) if name != "device"),
        ): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
