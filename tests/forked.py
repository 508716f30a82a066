"""The program in a process of its own, forked from one that has imported it: imports are most of a short run.

Each process of a test run has one such parent, which has one thread. What depends on how Python starts, such as its
encoding, is tested with `python -m imumon` instead.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import pickle
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import IO, Any

EMULATOR = "imumon.sources.vn100.emulator"

MODULES = (
    "imumon.cli.replay_command",
    "imumon.cli.run_command",
    "imumon.api.document_report",
    "imumon.cli.report_command",
    "imumon.config.loading",
    "imumon.daemon",
    "imumon.documents",
    "imumon.sources.vn100.driver",
    EMULATOR,
    f"{EMULATOR}.process",
    "faulty_sensor",
    "imumon.sources.vn100.vn100_session",
    "imumon.doctor",
    "imumon.record.filter_report_builder",
    "imumon.api.replay",
    "pydantic.json_schema",
    "pydantic.main",
    "pydantic.types",
    "scipy.fft",
    "zenoh",
)
"""What most commands import, some of it late."""

EXTRA: list[str] = []
"""What the commands of one file of tests import beside."""

ORDER = 1 << 20
"""Bytes of the words and the environment of a process."""

NUMBER = 16
"""Bytes of a number from a parent."""

PROGRAM = """#!{} -IS
import json, os, socket, sys
told = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
told.connect({!r})
order = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)])
socket.send_fds(told, [order.encode()], [0, 1, 2])
sys.exit(int(told.recv(9)))
"""
"""File `imumon` of a shell that runs documents."""


class Forked:
    """`imumon` with these words, as `subprocess.Popen` would start it.

    Parameters
    ----------
    streams : descriptors of its standard input, output and error.
    environment : variables beside those of the test.
    module : that is run, as by `python -m`, in a session of its own; None: `imumon`.
    """

    def __init__(
        self,
        words: Sequence[str],
        streams: tuple[int, int, int],
        directory: Path | None = None,
        environment: Mapping[str, str] | None = None,
        module: str | None = None,
    ) -> None:
        self.returncode: int | None = None
        self._told, tells = os.pipe()
        place = str(directory or Path.cwd())
        order = json.dumps([words, {**os.environ, **(environment or {})}, place, module])
        socket.send_fds(_parent(), [order.encode()], [*streams, tells])
        os.close(tells)
        self.pid = int(os.read(self._told, NUMBER))

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code, or raise subprocess.TimeoutExpired."""
        if self.returncode is None:
            if not select.select([self._told], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired("imumon", timeout or 0.0)
            self.returncode = os.waitstatus_to_exitcode(int(os.read(self._told, NUMBER)))
            os.close(self._told)
        return self.returncode

    def poll(self) -> int | None:
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class ForkedModule(Forked):
    """A module, as by `python -m`, with pipes to its standard input and output."""

    def __init__(self, module: str, *words: str) -> None:
        (input_end, into), (out, out_end) = os.pipe(), os.pipe()
        path = {"PYTHONPATH": str(Path(__file__).parent)}
        super().__init__(words, (input_end, out_end, 2), environment=path, module=module)
        os.close(input_end)
        os.close(out_end)
        self.stdin, self.stdout = os.fdopen(into, "w"), os.fdopen(out)


class ForkedEmulator(ForkedModule):
    """Process of an emulator, for `EmulatorProcess`, which would start it as `python -m`."""

    def __init__(self, settings: Any, module: str = EMULATOR) -> None:
        super().__init__(module, pickle.dumps(settings).hex())


class ChildEmulator:
    """Process of an emulator that a forked program starts, as `ForkedEmulator`."""

    def __init__(self, settings: Any) -> None:
        (input_end, into), (out, out_end) = os.pipe(), os.pipe()
        self.pid = os.fork()
        if not self.pid:
            os.setsid()
            os.dup2(input_end, 0)
            os.dup2(out_end, 1)
            os.closerange(3, os.sysconf("SC_OPEN_MAX"))
            os._exit(import_module(f"{EMULATOR}.process").run(settings, (0,)))
        os.close(input_end)
        os.close(out_end)
        self._ends = os.pidfd_open(self.pid)
        self.stdin, self.stdout = os.fdopen(into, "w"), os.fdopen(out)

    def wait(self, timeout: float | None = None) -> None:
        if not select.select([self._ends], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired("emulator", timeout or 0.0)
        os.waitpid(self.pid, 0)

    def kill(self) -> None:
        os.kill(self.pid, signal.SIGKILL)


class Captured(Forked):
    """A process whose input is a text, and whose output is kept in files: a pipe that nobody reads would fill up."""

    def __init__(
        self,
        words: Sequence[str],
        text: bytes = b"",
        directory: Path | None = None,
        environment: Mapping[str, str] | None = None,
        module: str | None = None,
    ) -> None:
        into, self._out, self._err = new_file(), new_file(), new_file()
        into.write(text)
        into.seek(0)
        streams = (into.fileno(), self._out.fileno(), self._err.fileno())
        super().__init__(words, streams, directory, environment, module)

    @property
    def out(self) -> str:
        """What it has written to its standard output so far."""
        return content(self._out)

    @property
    def err(self) -> str:
        return content(self._err)


def new_file() -> IO[bytes]:
    """Return a file without a name, which is gone when nobody has it."""
    return tempfile.TemporaryFile()


def content(file: IO[bytes]) -> str:
    """Return what is in a file that a process writes, whose place in it stays."""
    return os.pread(file.fileno(), os.fstat(file.fileno()).st_size, 0).decode()


def run(*words: str, timeout: float = 120.0, **more: Any) -> subprocess.CompletedProcess[str]:
    """Return how a process of `Captured` ended, as `subprocess.run` does."""
    process = Captured(words, **more)
    try:
        code = process.wait(timeout)
    finally:
        process.kill()
    return subprocess.CompletedProcess(words, code, process.out, process.err)


@contextmanager
def installed(directory: Path) -> Iterator[None]:
    """Put a file `imumon` into a directory; a process that runs it gives its words and streams to a fork."""
    place = str(directory / "orders")
    file = directory / "imumon"
    file.write_text(PROGRAM.format(sys.executable, place))
    file.chmod(0o755)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as orders:
        orders.bind(place)
        orders.listen()
        threading.Thread(target=_answer, args=(orders,), daemon=True).start()
        yield
        orders.shutdown(socket.SHUT_RDWR)


def _answer(orders: socket.socket) -> None:
    """Take orders until the socket is shut down; commands of a pipe run at the same time."""
    with suppress(OSError):
        while True:
            client, _ = orders.accept()
            threading.Thread(target=_answer_one, args=(client,), daemon=True).start()


def _answer_one(client: socket.socket) -> None:
    with client:
        order, (into, out, err), *_ = socket.recv_fds(client, ORDER, 3)
        words, directory, environment = json.loads(order)
        process = Forked(words, (into, out, err), Path(directory), environment)
        for stream in (into, out, err):
            os.close(stream)
        code = process.wait()
        client.send(str(code if code >= 0 else 128 - code).encode())  # as a shell says it of a signal


def preload(*modules: str) -> None:
    """Let the parent import these too, if it has not been started yet."""
    EXTRA.extend(modules)


@cache
def _parent() -> socket.socket:
    """Start the parent of this process; it ends with it."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    words = [sys.executable, __file__, str(there.fileno()), *EXTRA]
    parent = subprocess.Popen(words, pass_fds=[there.fileno()])
    there.close()
    atexit.register(lambda: (here.close(), parent.wait()))
    return here


def _serve(orders: socket.socket) -> str | None:
    """Fork at each order, and return in the process that shall run the program; return its module."""
    for name in (*MODULES, *sys.argv[2:]):
        import_module(name)
    gc.freeze()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        order, descriptors, *_ = socket.recv_fds(orders, ORDER, 4)
        if not order:
            sys.exit()  # the test run has ended
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if os.fork() == 0:
            orders.close()
            return _keep(order, descriptors)
        for descriptor in descriptors:
            os.close(descriptor)


def _keep(order: bytes, descriptors: list[int]) -> str | None:
    """Fork the program, tell its number and how it ends; return in the program, with its module."""
    *streams, tells = descriptors
    program = os.fork()
    if not program:
        for to, stream in enumerate(streams):
            os.dup2(stream, to)
    for stream in streams:
        os.close(stream)
    if program:
        os.write(tells, b"%*d" % (NUMBER, program))
        os.write(tells, b"%*d" % (NUMBER, os.waitpid(program, 0)[1]))
        os._exit(0)
    os.close(tells)
    sys.stdin, sys.stdout, sys.stderr = map(os.fdopen, range(3), "rww", (-1, -1, 1))
    words, environment, directory, module = json.loads(order)
    sys.argv[1:] = words
    os.environ.clear()
    os.environ.update(environment)
    sys.path[:1] = environment.get("PYTHONPATH", "").split(os.pathsep)
    os.chdir(directory)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return module


def _run_as_module(module: str) -> None:
    os.setsid()
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    if (module := _serve(socket.socket(fileno=int(sys.argv[1])))) is not None:
        sys.exit(_run_as_module(module))
    from imumon.__main__ import main

    import_module(f"{EMULATOR}.process").start_process = ChildEmulator  # type: ignore[attr-defined]
    sys.exit(main())
