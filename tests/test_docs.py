"""The documents are correct: their commands and programs run, their links and options exist.

A block ```` ```sh ```` or ```` ```python ```` runs unchanged, next to a daemon on an emulated sensor, a recording
and its report. A second word says why a block does not run: ``sensor`` (it needs a real one), ``service`` (a service
manager), ``root``, ``setup`` (it installs), ``long``, ``example`` and ``lines`` (tests/sources run them), ``board``
(it runs on another computer), ``hook`` (git runs it). A ``slow`` block runs with the slow tests. The options of all
blocks are checked against the command line.
"""

from __future__ import annotations

import doctest
import json
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import forked
import pytest
from daemons import Daemon
from free_ports import free_endpoint
from paths import ROOT
from tables import sentences
from waiting import until

import imumon
from imumon.cli import parsers

DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "dev").glob("*.md")),
]


class Block(NamedTuple):
    name: str
    language: str
    reason: str
    text: str


def _blocks() -> list[Block]:
    found = []
    for path in DOCUMENTS:
        text = path.read_text("utf-8")
        for match in re.finditer(r"^```(\w+)(?: (\w+))?\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            line = text[: match.start()].count("\n") + 1
            found.append(Block(f"{path.name}:{line}", match[1], match[2] or "", match[3]))
    return found


BLOCKS = _blocks()
RUN = [b for b in BLOCKS if b.reason in ("", "slow")]


def _marked(block: Block) -> Any:
    return pytest.param(block, marks=pytest.mark.slow) if block.reason == "slow" else block


class Place(NamedTuple):
    """Where documents are tested: a directory with recordings, and a daemon."""

    directory: Path
    endpoint: str
    environment: dict[str, str]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    forked.preload("matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "matplotlib.figure")
    directory = tmp_path_factory.mktemp("documents")
    endpoint = free_endpoint()
    (directory / "config.toml").write_text(f'[zenoh]\nlisten = ["{endpoint}"]\n')
    home = {"HOME": str(directory), "XDG_STATE_HOME": str(directory / "state")}
    path = f"{directory / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, **home, "PATH": path}
    (directory / "imu.vnymr.txt").write_text("".join(f"{line}\r\n" for line in sentences(400)[1]), newline="")
    words = ("sim", directory / "state", "--seed", "1", "--speed")
    with Daemon(*words, "50", "--record", str(directory / "recording.bin")) as fast:
        fast.samples(2000)
        fast.stop()
    subprocess.run(["gzip", "-k", directory / "recording.bin"], check=True)
    (directory / "bin").mkdir()
    with (
        Daemon(*words, "1", listen=endpoint) as daemon,  # beside the commands, and in nobody's way
        forked.installed(directory / "bin"),
    ):
        daemon.wait(lambda report: report.session.restarts >= 1)
        yield Place(directory, endpoint, environment)


def _run(block: Block, place: Place, directory: Path) -> subprocess.CompletedProcess[str]:
    if "imumon run" in block.text:  # it needs its own endpoint
        (directory / "config.toml").write_text(f'[zenoh]\nlisten = ["{free_endpoint()}"]\n')
    else:
        directory = place.directory
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        cwd=directory,
        env=place.environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=290,  # of the 300 s of a test: commands take seconds, on a machine that has time
    )


Runs = dict[str, "Future[subprocess.CompletedProcess[str]]"]


@pytest.fixture(scope="module")
def runs(
    place: Place, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Runs]:
    """Run the commands of a document in their order, and the documents beside each other."""
    items = [
        item for item in request.session.items if getattr(item, "originalname", "") == "test_a_command_runs"
    ]
    blocks: list[Block] = [item.callspec.params["block"] for item in items]  # type: ignore[attr-defined]
    started: Runs = {block.name: Future() for block in blocks}

    def run_document(document: Iterable[Block]) -> None:
        for block in document:
            try:
                started[block.name].set_result(_run(block, place, tmp_path_factory.mktemp("own")))
            except subprocess.TimeoutExpired as error:
                started[block.name].set_exception(error)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for _, document in groupby(blocks, lambda block: block.name.partition(":")[0]):
            pool.submit(run_document, list(document))
        yield started


@pytest.mark.parametrize("block", [_marked(b) for b in RUN if b.language == "sh"], ids=lambda b: b.name)
def test_a_command_runs(block: Block, runs: Runs) -> None:
    done = runs[block.name].result()
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow  # ten hours of a sensor in time-lapse
@pytest.mark.timeout(1500)  # as fast as the machine is
def test_the_commands_of_the_readme_for_a_sensor_run_beside_an_emulated_one(tmp_path: Path) -> None:
    """Numbers for Kalibr in three commands, of which the second ends when the third has what it needs."""
    blocks = re.findall(
        r"^```sh sensor\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.M | re.DOTALL
    )
    text = "".join(blocks)
    commands = [line.partition(" #")[0].split() for line in text.splitlines()]
    asking = [words[1:] for words in commands if words[1] in ("wait", "report")]
    assert [words[0] for words in asking] == ["wait", "report"]
    with Daemon("sim", tmp_path / "state", "--seed", "1", "--speed", "10000") as daemon:
        daemon.samples()
        for words in asking:
            done = subprocess.run(
                [sys.executable, "-m", "imumon", *words, "--connect", daemon.endpoint],
                cwd=tmp_path, capture_output=True, text=True, check=False, timeout=1200,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
    walks = re.findall(r"^\w*random_walk: ([\d.e+-]+)", (tmp_path / "imu.yaml").read_text(), re.MULTILINE)
    assert len(walks) == 2


def test_the_tables_of_the_documents_are_the_saved_results() -> None:
    sys.path.insert(0, str(ROOT / "benchmarks"))
    document_tables = import_module("document_tables")
    for path in document_tables.DOCUMENTS:
        text = path.read_text("utf-8")
        assert document_tables.written(text) == text, (
            f"python benchmarks/document_tables.py writes {path.name}"
        )


def test_the_installed_command_runs(place: Place) -> None:
    """The commands of documents are forked: this is the one that pip installed, in a process of its own."""
    command = Path(sys.executable).parent / "imumon"
    words = [command, "replay", "recording.bin", "--json"]
    version = subprocess.check_output([command, "--version"], text=True, env=place.environment)
    assert version.split() == ["imumon", imumon.__version__]
    made = subprocess.run(
        words, cwd=place.directory, env=place.environment, capture_output=True, text=True, check=True
    )
    assert json.loads(made.stdout)["session"]["samples"] > 0
    assert not made.stderr


@pytest.mark.parametrize("block", [b for b in RUN if b.language == "python"], ids=lambda b: b.name)
def test_a_program_runs(block: Block, place: Place) -> None:
    code = block.text.replace("tcp/127.0.0.1:7448", place.endpoint)
    code = code.replace("Subscriber()", f"Subscriber([{place.endpoint!r}])")
    name = f"program_{BLOCKS.index(block)}"
    code = f"import sys\nsys.stdout.reconfigure(line_buffering=True)\n{code}"
    (place.directory / f"{name}.py").write_text(code)
    path = {**place.environment, "PYTHONPATH": str(place.directory)}
    process = forked.Captured([], directory=place.directory, environment=path, module=name)
    until(lambda: process.out.strip() or process.poll() is not None)  # a subscriber does not end
    process.kill()
    assert process.out.strip(), process.err
    assert "Traceback" not in process.err


def unknown_options(text: str) -> Iterator[str]:
    """Yield the commands and options of a block that imumon does not have."""
    _, commands = parsers()
    for line in text.replace("\\\n", " ").splitlines():
        for part in re.split(r"\|\||&&|[|;&]", line.partition(" #")[0]):
            words = shlex.split(part) if part.count("'") % 2 == 0 and part.count('"') % 2 == 0 else []
            if not words or Path(words[0]).name != "imumon" or len(words) < 2 or words[1] == "--version":
                continue
            name, *rest = words[1:]
            if name not in commands:
                yield f"imumon {name}"
                continue
            known = {option for action in commands[name]._actions for option in action.option_strings}
            options = {word for word in rest if word.startswith("-") and word != "-"}
            yield from (f"imumon {name} {option}" for option in sorted(options - known))


def test_options_exist() -> None:
    """Commands and options exist, also in blocks that do not run, and in sentences."""
    texts = [(block.name, block.text) for block in BLOCKS if block.language == "sh"]
    for path in DOCUMENTS:
        texts += [
            (path.name, text) for text in re.findall(r"`(imumon [a-z][^`\n]*)`", path.read_text("utf-8"))
        ]
    assert not [f"{name}: {unknown}" for name, text in texts for unknown in unknown_options(text)]


def test_links_exist() -> None:
    missing = []
    for path in DOCUMENTS:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", path.read_text("utf-8")):
            if "://" in target:
                continue
            page = path.parent / target if target else path
            if not page.exists() or (anchor and anchor not in _anchors(page)):
                missing.append(f"{path.name}: {target}#{anchor}")
    assert not missing


def _anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_tests_and_benchmarks_that_are_named_exist() -> None:
    named = {
        name
        for path in DOCUMENTS
        for name in re.findall(r"(?:tests|benchmarks)/[\w/]+\.py", path.read_text("utf-8"))
    }
    assert not [name for name in named if not (ROOT / name).exists()]


def test_the_changelog_has_known_headings() -> None:
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    heads = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert heads[0] == "Unreleased"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ - \d{4}-\d\d-\d\d", head) for head in heads[1:])
    assert heads[1].startswith(f"{imumon.__version__} - ")
    kinds = set(re.findall(r"^### (.+)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Fixed", "Removed", "Security"}


def test_every_example_of_a_docstring_gives_what_it_says() -> None:
    """Modules are imported here alone: as tests of their own, each process of a run imports all of them."""
    names = [module.name for module in pkgutil.walk_packages(imumon.__path__, "imumon.")]
    results = {name: doctest.testmod(import_module(name)) for name in names if "__main__" not in name}
    assert sum(result.attempted for result in results.values()) > 100
    assert not [name for name, result in results.items() if result.failed]
