"""Sensitivity of the published numbers to every tuning constant, as Markdown.

    python benchmarks/sensitivity.py | python benchmarks/document_tables.py -     all constants, into docs/ACCURACY.md
    python benchmarks/sensitivity.py noise.fit                                    those of one package, three minutes

Each constant (a number in capitals at the top level of a module) is halved and doubled in a process of its own, before
the module is executed, so that everything derived from it changes too. The process runs `RECORDS`: short records that
make every part of the pipeline work. The table has the constants that move a published number by more than `MOVED` of
itself, or let it appear or vanish, the strongest first. Limits and values of N, B and K, means, deviations, counters,
events and grades count; what only draws (histogram, spectrum, envelope) does not. A factor of two must never raise:
where a run fails, the errors are printed, there is no table, and the exit code is 1.

A constant whose name says what it is in nature or in a protocol (units, register numbers, formats) is no tuning
constant: `NOT_TUNING` lists the modules that hold only such ones.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

from document_tables import head, row

ROOT = Path(__file__).parents[1]
PACKAGES = ("noise", "pipeline", "timebase", "recordings")
"""Packages whose constants can move a published number. Elsewhere constants are timeouts and sizes of queues."""
NOT_TUNING = {"column_names.py", "raw_capture.py"}
MOVED = 0.1
"""Relative change of a published number from which a constant is in the table: the limits of N are 1 % wide, those of B
and K 20 % and more."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A number at the top level of a module."""

    module: str
    name: str
    value: float


def _number(node: ast.expr | None) -> float | None:
    """Return the value of a literal number or of an expression of literals; None for anything else."""
    try:
        value = eval(compile(ast.Expression(node), "", "eval"), {"__builtins__": {}, "math": math})  # type: ignore[arg-type]
    except Exception:
        return None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def constants(prefix: str = "") -> Iterator[Constant]:
    """Yield the tuning constants in the order of the files."""
    for package in PACKAGES:
        for path in sorted((ROOT / "imumon" / package).rglob("*.py")):
            if path.name in NOT_TUNING:
                continue
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            if not module.removeprefix("imumon.").startswith(prefix.removeprefix("imumon.")):
                continue
            for node in ast.parse(path.read_text("utf-8")).body:
                target = _target(node)
                if target is None or not target.lstrip("_").isupper():
                    continue
                value = _number(node.value)  # type: ignore[attr-defined]
                if value is None or value <= 0.0:  # a negative number is a mark, such as `BREAK`
                    continue
                yield Constant(module, target, value)


def _target(node: ast.stmt) -> str | None:
    if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
        return node.targets[0].id
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        return node.target.id
    return None


# ---------------------------------------------------------------------- one process: change, import, run


class ConstantPatch(MetaPathFinder):
    """Replaces one constant in the source of its module before that is executed."""

    def __init__(self, module: str, name: str, factor: float) -> None:
        self.module, self.name, self.factor = module, name, factor

    def find_spec(self, fullname: str, path: Any, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != self.module:
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin, self)
        return spec


class _Loader(SourceFileLoader, Loader):
    def __init__(self, fullname: str, path: str, patch: ConstantPatch) -> None:
        super().__init__(fullname, path)
        self._patch = patch

    def get_code(self, fullname: str) -> Any:
        tree = ast.parse(Path(self.path).read_text("utf-8"))
        for node in tree.body:
            if _target(node) == self._patch.name:
                value, literal = _number(node.value), ast.unparse(node.value)  # type: ignore[attr-defined]
                assert value is not None
                new = value * self._patch.factor
                whole = float(value).is_integer() and isinstance(ast.literal_eval(repr(value)), float)
                is_int = whole and "." not in literal and "e" not in literal.lower()
                node.value = ast.Constant(max(1, round(new)) if is_int else new)  # type: ignore[attr-defined]
        ast.fix_missing_locations(tree)
        return compile(tree, self.path, "exec")


def records() -> dict[str, dict[str, float | None]]:
    """Run the reference records and return the published numbers of each."""
    import numpy as np

    from imumon.noise import synthesise

    rate, n = 50.0, 50 * 60 * 10
    random = np.random.default_rng(2)
    time_s = np.arange(n) / rate

    disturbed = _imu(n, rate, seed=3, sensors=2)
    for at in random.integers(2000, n - 2000, 12):
        disturbed[at : at + 20] += random.normal(0.0, 0.5, (20, 6)) * [1, 1, 1, 20, 20, 20]
    disturbed[15_000:17_000] += (np.sin(2 * np.pi * 0.7 * time_s[:2000]) * 0.4)[:, None]
    disturbed[20_000:20_400] = disturbed[20_000]  # stuck
    disturbed[25_000:25_900, 1] = disturbed[25_000, 1]  # one axis

    warm = _imu(n, rate, seed=4) + (4e-3 * np.exp(-time_s / 60.0))[:, None]
    cooling = 25.0 - 8.0 * np.exp(-time_s / 60.0) + random.normal(0.0, 0.02, n)
    drifting = 25.0 + 4.0 * np.sin(2 * np.pi * time_s / 450.0) + random.normal(0.0, 0.02, n)

    mixed = _imu(n, rate, seed=6)
    mixed[:, 0] += 1e-3 * np.sin(2 * np.pi * 17.3 * time_s)
    mixed[:, 1] = synthesise(n, rate, N=6.1e-5, B=2.4e-5, K=3e-6, seed=9)[:, 0]
    mixed[:, 2] = np.round(mixed[:, 2] / 4e-4) * 4e-4

    jittered = _imu(n, rate, seed=8)
    jittered[n // 2 :, 0] += 2e-4  # a step of the bias
    jittered[:, 2] = 0.1  # constant
    return {
        "clean": _published(_imu(n, rate, seed=1), rate),
        "disturbed": _published(disturbed, rate, lose=0.002),
        "warm-up": _published(np.column_stack((warm, cooling)), rate),
        "temperature": _published(
            np.column_stack((_imu(n, rate, seed=5) + 1e-4 * (drifting - 25.0)[:, None], drifting)), rate
        ),
        "mixed": _published(mixed, rate),
        "jittered": _published(jittered, rate, jitter_s=1e-3, lose=0.01),
        "table": _table(_imu(6_000, 97.0, seed=11, sensors=2), 97.0),
    }


def _imu(n: int, rate: float, seed: int, sensors: int = 1) -> Any:
    """(n, 3) rad/s, a gyroscope at rest; with two sensors also (n, 3) m/s^2, an accelerometer."""
    import numpy as np

    from imumon.noise import synthesise

    gyro = synthesise(n, rate, N=[6.1e-5] * 3, B=2.4e-5, seed=2 * seed)
    accel = synthesise(n, rate, N=[1.3e-3] * 3, B=3e-4, seed=2 * seed + 1)
    return np.column_stack((gyro, accel + np.array([0.0, 0.0, -9.8]))) if sensors == 2 else gyro


def _published(values: Any, rate: float, *, lose: float = 0.0, jitter_s: float = 0.0) -> dict[str, Any]:
    from datetime import UTC, datetime

    import numpy as np

    from imumon import report
    from imumon.pipeline import Monitor
    from imumon.report_json import to_json
    from imumon.samples import ACCEL, GYRO, SampleBlock, Stream

    random = np.random.default_rng(99)
    names = {3: GYRO, 4: (*GYRO, "temperature"), 6: (*GYRO, *ACCEL)}[values.shape[1]]
    stream = Stream("deltas", names, source="made", clock="startup", tick_s=None if jitter_s else 1.0 / 800.0)
    keep = random.random(len(values)) >= lose
    keep[:100] = True
    time_ns = (
        (np.arange(len(values)) / rate + random.uniform(-jitter_s, jitter_s, len(values))) * 1e9
    ).astype(np.int64)[keep]
    values = values[keep]
    monitor = Monitor()
    session = report.SessionCounters()
    device = report.DeviceDescription(id="x")
    monitor.feed(SampleBlock(stream, values, time_ns, np.zeros(len(values), dtype=np.int64)))
    monitor.flush()
    made = monitor.report(datetime.now(UTC), device, "stopped", session)
    events = [event.kind for event in monitor.events()]
    numbers = _numbers(json.loads(to_json(made)))
    return numbers | {f"events/{kind}": float(events.count(kind)) for kind in sorted(set(events))}


def _table(values: Any, rate: float) -> dict[str, Any]:
    """A CSV file with jittered stamps in milliseconds and missing rows, through `replay`."""
    import tempfile

    import numpy as np

    from imumon.replay import ReplayOptions, replay
    from imumon.report_json import to_json

    random = np.random.default_rng(5)
    stamps = np.round((np.arange(len(values)) / rate + random.normal(0, 5e-4, len(values))) * 1e3)
    keep = random.random(len(values)) > 0.003
    with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
        file.write("time_ms,gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]\n")
        for stamp, row in zip(stamps[keep], values[keep], strict=True):
            file.write(f"{stamp:.0f}," + ",".join(f"{x:.9g}" for x in row) + "\n")
        file.flush()
        made = replay(ReplayOptions(path=file.name))
    return _numbers(json.loads(to_json(made)))


DRAWN = ("histogram", "spectrum", "modes", "aliases_hz", "readable", "limit_curves", "limits")
"""Parts of a report that are drawn, repeat other numbers, or are no result."""


def _numbers(tree: Any, path: str = "") -> dict[str, float | None]:
    """Return the numbers of a report by their path; None where there might be one."""
    if isinstance(tree, dict):
        pairs = [(str(key), value) for key, value in tree.items() if key not in DRAWN]
    elif isinstance(tree, list):
        pairs = [(str(index), value) for index, value in enumerate(tree)]
    else:
        return {path: tree if tree is None else float(tree)} if not isinstance(tree, str) else {}
    numbers: dict[str, float | None] = {}
    for key, value in pairs:
        numbers |= _numbers(value, f"{path}/{key}" if path else key)
    return numbers


# ---------------------------------------------------------------------- all processes: compare


def measure(constant: Constant, factor: float) -> dict[str, Any] | str:
    """Return what the records publish with a changed constant; the error if they fail. Runs in a new process."""
    if factor != 1.0:
        sys.meta_path.insert(0, ConstantPatch(constant.module, constant.name, factor))
    try:
        return records()
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def difference(base: dict[str, Any], other: dict[str, Any]) -> tuple[float, str]:
    """Return the largest relative change of a published number, and which one that is."""
    worst, which = 0.0, ""
    for record, before in base.items():
        after = other[record]
        for name in before.keys() | after.keys():
            one, two = before.get(name), after.get(name)
            if one == two or (isinstance(one, str) and name.endswith(("text", "reason", "remarks/0"))):
                continue
            both = isinstance(one, float) and isinstance(two, float)
            scale = max(abs(one), abs(two)) if both else 0.0  # type: ignore[arg-type,type-var]
            size = abs(one - two) / scale if both and scale else math.inf  # type: ignore[operator]
            if size > worst:
                worst, which = (
                    size,
                    f"{record}: {name.removeprefix('channels/')} {_short(one)} → {_short(two)}",
                )
    return worst, which


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _job(job: tuple[Constant, float]) -> dict[str, Any] | str:
    return measure(*job)


def main() -> int:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("prefix", nargs="?", default="", help="package or module, such as noise.fit")
    parser.add_argument("--processes", type=int, default=2)
    words = parser.parse_args()
    found = list(constants(words.prefix))
    import numpy  # noqa: F401
    import scipy.special  # noqa: F401  the processes inherit what takes long to import, but no module of imumon

    assert "imumon" not in sys.modules
    jobs = [
        (Constant("", "", 1.0), 1.0),
        *((constant, factor) for constant in found for factor in (0.5, 2.0)),
    ]
    rows: list[tuple[float, list[str]]] = []
    errors: list[str] = []
    with multiprocessing.get_context("fork").Pool(words.processes, maxtasksperchild=1) as pool:
        made = pool.imap(_job, jobs)
        base = next(made)
        if isinstance(base, str):
            raise SystemExit(f"the records fail without a change: {base}")
        for each in found:
            name = f"{each.module.removeprefix('imumon.')}.{each.name}"
            changes = []
            for factor in (0.5, 2.0):
                run = next(made)
                if isinstance(run, str):
                    errors.append(f"{name} = {each.value * factor:g}: {run}")
                    print(errors[-1], file=sys.stderr, flush=True)
                else:
                    changes.append(difference(base, run))
            if len(changes) == 2 and max(changes)[0] > MOVED:
                shown = [name, f"{each.value:g}", *(_percent(size) for size, _ in changes), max(changes)[1]]
                rows.append((max(changes)[0], shown))
    print(f"{len(rows)} of {len(found)} constants move a number, {len(errors)} runs fail", file=sys.stderr)
    if errors:
        return 1
    print(head("sensitivity", "constant", "value", "halved", "doubled", "largest change"))
    for _, shown in sorted(rows, key=lambda each: -each[0]):
        print(row(shown))
    return 0


def _percent(size: float) -> str:
    return "appears or vanishes" if math.isinf(size) else f"{100.0 * size:.0f} %"


if __name__ == "__main__":
    raise SystemExit(main())
