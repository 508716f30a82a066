"""The rules of docs/ARCHITECTURE.md: layers, owners of libraries, names, errors, style checks and words."""

from __future__ import annotations

import ast
import collections
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from paths import ROOT
from source_trees import PACKAGE, nodes

from imumon.cli import parsers

REPEATABLE = {"__init__.py", "__main__.py", "base.py"}


@pytest.mark.timeout(600)  # the types of a tree without a cache take half a minute of processor time
@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "imumon", "tests", "benchmarks"],
        ["ruff", "format", "--check", "imumon", "tests", "benchmarks"],
        ["mypy"],
        ["importlinter.cli", "lint"],
    ],
    ids=["ruff", "format", "mypy", "layers"],
)
def test_the_tree_passes(command: list[str]) -> None:
    name, *words = command
    if name == "importlinter.cli":
        words = ["-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
        call = [sys.executable, *words]
    else:
        call = [sys.executable, "-m", name, *words]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


IMPORTS = """
import sys

def loaded():
    return {name.partition(".")[0] for name in sys.modules} - {*sys.stdlib_module_names}

before = loaded()
import imumon.model.report
from imumon.cli import main, parsers
import imumon.tui
parsers()[0].format_help()
try:
    main(["--version"])
finally:
    light = loaded() - before
    import imumon.tui.app
    print(*light, "|", *loaded())
"""


def test_no_part_loads_more_than_it_needs() -> None:
    """A report and the options need the standard library only: the manual page is built with nothing else."""
    done = subprocess.run([sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=False)
    light, screen = done.stdout.splitlines()[-1].split("|")
    assert light.split() == ["imumon"]
    assert not {*screen.split()} & {"scipy", "pydantic", "serial", "zenoh", "matplotlib"}


# ---------------------------------------------------------------------- names


def test_no_file_name_occurs_twice() -> None:
    names = collections.Counter(path.name for path in nodes() if path.name not in REPEATABLE)
    assert not [name for name, count in names.items() if count > 1]


def test_no_public_class_name_occurs_twice() -> None:
    names = collections.Counter(
        node.name
        for module, *_ in nodes().values()
        for node in getattr(module, "body", ())
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert not [name for name, count in names.items() if count > 1]


def test_an_init_only_reexports() -> None:
    kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    lazy = {"__getattr__", "__dir__"}  # PEP 562: re-exports whose modules are imported at their first use
    assert not [
        f"{path}: {node.name}"
        for path, (module, *_) in nodes().items()
        if path.name == "__init__.py"
        for node in getattr(module, "body", ())
        if isinstance(node, kinds) and node.name not in lazy
    ]


def test_a_package_that_lists_its_modules_lists_all() -> None:
    """A newcomer opens the list first, and takes what it lacks for something that does not exist."""
    for init in PACKAGE.rglob("__init__.py"):
        text = ast.get_docstring(ast.parse(init.read_text("utf-8"))) or ""
        modules = {path.stem for path in init.parent.glob("*.py")} - {"__init__", "__main__"}
        listed = {module for module in modules if re.search(rf"\b{module}\b", text)}
        assert len(listed) <= len(modules) / 2 or listed == modules, (init, modules - listed)


def test_a_module_is_one_concept() -> None:
    """A concept is whole in one file: up to 700 lines, and never too short to be a concept."""
    lines = {path: len((PACKAGE / path).read_text("utf-8").splitlines()) for path in nodes()}
    assert not [f"{path}: {n} lines" for path, n in lines.items() if n > 700]


# ---------------------------------------------------------------------- imports


def imports(module: list[ast.AST]) -> Iterator[str]:
    for node in module:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_no_modules_import_one_another_in_a_circle() -> None:
    """Also not by imports in functions; what a package re-exports is left to the layers."""
    names = {path: ".".join(("imumon", *path.with_suffix("").parts)) for path in nodes()}
    graph = {names[path]: {*imports(module)} & {*names.values()} for path, module in nodes().items()}
    TopologicalSorter(graph).prepare()


def test_only_a_device_package_names_itself() -> None:
    """In a string, by which it could be imported; the layers forbid the imports."""
    devices = {path.parent.name for path in (PACKAGE / "sources").glob("*/__init__.py")} - {"files"}
    assert "vn100" in devices
    for path, module in nodes().items():
        others = devices - {path.parts[1] if path.parts[0] == "sources" else ""}
        texts = [n.value for n in module if isinstance(n, ast.Constant) and isinstance(n.value, str)]
        assert not [text for text in texts for name in others if f"sources.{name}" in text], path


PURE = ("noise", "record", "grid", "model")
PURE_DECODERS = ("decoder.py", "ascii.py", "binary.py", "measurements.py", "checksum.py", "registers.py")
IMPURE = {
    "time", "os", "io", "socket", "subprocess", "threading", "asyncio", "select", "logging", "sys", "pathlib",
    "serial", "zenoh", "textual", "pydantic", "queue", "tempfile", "shutil",
}  # fmt: skip


def is_pure(path: Path) -> bool:
    if path.parts[:2] == ("sources", "vn100"):
        return path.name in PURE_DECODERS
    return path.parts[0] in PURE or path.name == "braille_canvas.py"


def impurities(module: list[ast.AST]) -> Iterator[str]:
    """Yield the imports and calls of a module that do I/O or read a clock."""
    yield from {name.partition(".")[0] for name in imports(module)} & IMPURE
    for node in module:
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("open", "print", "now", "today", "utcnow", "monotonic", "input"):
                yield f"{called}() in line {node.lineno}"


def test_mathematics_and_decoders_do_no_io_and_read_no_clock() -> None:
    assert not [
        f"{path}: {found}"
        for path, module in nodes().items()
        if is_pure(path)
        for found in impurities(module)
    ]


def _is_error_text(node: ast.AST) -> bool:
    """Whether an expression is the text of an error: ``str(error)``, ``error.message``, ``error.cure``."""
    names = ("e", "err", "error", "exc", "exception", "problem", "failure")
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str" and node.args:
        return isinstance(node.args[0], ast.Name) and node.args[0].id in names
    return (
        isinstance(node, ast.Attribute)
        and node.attr in ("message", "cure", "reason")
        and isinstance(node.value, ast.Name)
        and node.value.id in names
    )


def _searches_an_error_text(node: ast.AST) -> bool:
    if isinstance(node, ast.Compare) and any(isinstance(op, ast.In | ast.NotIn) for op in node.ops):
        return any(_is_error_text(side) for side in node.comparators)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        methods = ("split", "partition", "rpartition", "startswith", "endswith", "find", "splitlines")
        if node.func.attr in methods:
            return _is_error_text(node.func.value)
        if node.func.attr in ("match", "search", "fullmatch", "findall"):
            return any(_is_error_text(argument) for argument in node.args)
    return False


def test_no_control_flow_depends_on_the_text_of_a_message() -> None:
    for bad in ("'busy' in str(error)", "error.message.startswith('busy')", "re.search('busy', error.cure)"):
        assert any(_searches_an_error_text(node) for node in ast.walk(ast.parse(bad))), bad
    assert not [
        f"{path}: line {getattr(node, 'lineno', 0)}"
        for path, module in nodes().items()
        for node in module
        if _searches_an_error_text(node)
    ]


EMPTY_NAMES = {"found": 1, "own": 0, "at": 0, "made": 0, "taken": 0}
"""Words that name nothing, and the number of files that still give them to something."""


def given_names(module: list[ast.AST]) -> Iterator[str]:
    """Yield the names that a module gives: variables, arguments, functions and classes."""
    for node in module:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name


def test_names_say_what_a_thing_is() -> None:
    files = {
        word: [path for path, module in nodes().items() if word in given_names(module)]
        for word in EMPTY_NAMES
    }
    assert not {word: paths for word, paths in files.items() if len(paths) > EMPTY_NAMES[word]}


# ---------------------------------------------------------------- words


DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "config.toml",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "systemd").iterdir()),
]

PLAIN = {
    r"(is|was|are|be|been|being) told|told|tells?": "configured, set, given; reports, shows, prints",
    r"the room'?s( own)? clock|the sensor'?s own time": "host clock, sample clock",
    r"cut (out|away)": "excluded",
    r"kept from the record": "dropped samples",
    r"spoil|spoils|spoilt": "invalid row, corrupt file",
    r"strangers?|nobody('?s)?": "unknown device, unrelated bytes; no process",
    r"anew": "again, restart",
    r"shut in": "sandboxed",
    r"mend(s|ed)?": "fixed",
    r"and says so": "95 % upper bound",
    r"in vain|a vain|for ever|of its own accord|so many|let go|to the letter|it wants": "say it plainly",
    r"goes on|went on": "continues",
    r"whatever comes|what came|what (it|he) had to complain of|to be rid of": "say it plainly",
}
"""Pattern → what to write instead."""
PATTERN = re.compile("|".join(rf"\b({pattern})\b" for pattern in PLAIN), re.IGNORECASE)


def found(text: str) -> list[str]:
    """Return the words to avoid, with what precedes and follows them."""
    flat = " ".join(text.split())
    return [flat[max(0, match.start() - 30) : match.end() + 30] for match in PATTERN.finditer(flat)]


def prose(path: Path) -> Iterator[str]:
    """Yield string constants of several words and comments of a module; of one without such words, no comments."""
    for node in nodes()[path]:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.value
    source = (PACKAGE / path).read_text("utf-8")
    if PATTERN.search(source):
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.COMMENT:
                yield token.string


def test_words_to_avoid_are_nowhere() -> None:
    """In documents, in the help, and in string constants and comments of modules."""
    main, commands = parsers()
    texts = [(path.name, [path.read_text("utf-8")]) for path in DOCUMENTS]
    texts += [(parser.prog, [parser.format_help()]) for parser in (main, *commands.values())]
    texts += [(str(path), prose(path)) for path in nodes()]
    assert not [f"{name}: {words}" for name, parts in texts for text in parts for words in found(text)]


def test_no_percentage_is_a_power_of_ten() -> None:
    """`share_text` and `measured` write percentages; a format with two digits would write 130 % as 1.3e+02 %."""
    power = re.compile(r"(\.\d[ge]|:[+]?e)\} ?%")
    texts = {path: (PACKAGE / path).read_text("utf-8") for path in nodes()}
    assert [path.name for path, text in texts.items() if power.search(text)] == ["units.py"]
