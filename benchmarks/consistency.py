"""Agreement of the parts of real recordings: halves, and quarters after the warm-up, as Markdown.

    python benchmarks/consistency.py [--recordings DIR]

A sensor at rest has one N, B and K, so the intervals of two parts of one record must overlap, apart from what
the sensor itself changes. Each part goes through the whole pipeline. Its interval is the wider of its limits
and of its value plus and minus 1.96 times its own scatter. Goals: at most 1 in 20 pairs disjoint for N and K,
1 in 10 for B. The recordings are not part of the project; without the folder there is nothing to do.
"""

from __future__ import annotations

import argparse
import itertools
import math
import tempfile
from pathlib import Path

import numpy as np
from document_tables import head, row
from recordings import read

from imumon.coefficients import Estimate
from imumon.replay import ReplayOptions, replay
from imumon.report import Report

AXES = ("gyro/x", "gyro/y", "gyro/z", "accel/x", "accel/y", "accel/z")
ADIS = ("adis16405_1", "adis16405_4")
WARM_UP_S = {"adis16405_1": 3600.0, "adis16405_4": 3600.0, "kiran_stat5min": 0.0}
GOALS = {"N": 0.05, "B": 0.10, "K": 0.05}
ACCEL_N = (0.19 / 60.0, 0.31 / 60.0)
"""m/s^2/sqrt(Hz), N of the accelerometers of the ADIS16405 by independent analysis."""


def load(folder: Path, name: str) -> tuple[np.ndarray, float]:
    """Return (n, 6) rad/s and m/s^2, and the rate, Hz."""
    if name not in ADIS:
        return read(folder / f"{name}.vnymr.txt.gz"), 40.0
    data = np.load(folder / f"{name}.npz")
    return np.column_stack((np.radians(data["gyro_dps"]), 9.80665 * data["accel_g"])), 100.0


def report_of(values: np.ndarray, rate: float) -> Report:
    """Return the report of a part of a record."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "part.npz")
        time = np.arange(len(values)) / rate
        np.savez(path, t=time, gyro=values[:, :3], accel=values[:, 3:])
        return replay(ReplayOptions(path=path))


def interval(part: Estimate | None) -> tuple[float, float] | None:
    """Return the wider of limits and scatter; None while pending."""
    if part is None or part.high is None:
        return None
    spread = 1.96 * (part.scatter or 0.0)
    value = part.value if part.value is not None else 0.0
    return min(part.low or 0.0, value - spread), max(part.high, value + spread)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    parser.add_argument("--recordings", type=Path, default=folder)
    folder = parser.parse_args().recordings
    if not folder.exists():
        print("no recordings")
        return
    pairs: dict[str, list[bool]] = {letter: [] for letter in "NBK"}
    pending = dict.fromkeys("NBK", 0)
    print(head("consistency", "record", "axis", "N, B, K of the whole record", "disjoint pairs"))
    for name, warm_up in WARM_UP_S.items():
        values, rate = load(folder, name)
        n, begin = len(values), round(warm_up * rate)
        bounds = np.linspace(begin, n, 5).round().astype(int)
        parts = {"first half": values[: n // 2], "second half": values[n // 2 :]}
        parts |= {f"quarter {i + 1}": values[a:b] for i, (a, b) in enumerate(itertools.pairwise(bounds))}
        reports = {part: report_of(each, rate) for part, each in parts.items()}
        whole = report_of(values, rate)
        names = list(reports)
        for axis in AXES:
            disjoint = []
            for letter in "NBK":
                for one, two in [(names[0], names[1]), *itertools.combinations(names[2:], 2)]:
                    a, b = (
                        interval(reports[part].channels[axis].coefficients.get(letter)) for part in (one, two)
                    )
                    if a is None or b is None:
                        pending[letter] += 1
                        continue
                    pairs[letter].append(a[1] < b[0] or b[1] < a[0])
                    if pairs[letter][-1]:
                        disjoint.append(f"{letter}: {one}, {two}")
            channel = whole.channels[axis]
            texts = [text(channel.coefficients.get(letter)) for letter in "NBK"]
            mark = ""
            if name in ADIS and axis.startswith("accel"):
                n_value = channel.coefficients["N"].value
                mark = "" if n_value is not None and ACCEL_N[0] <= n_value <= ACCEL_N[1] else " **!**"
            print(row([name, axis, ", ".join(texts) + mark, "; ".join(disjoint) or "–"]), flush=True)
    print("\n" + head("consistency-pairs", "", "pairs", "disjoint", "goal", "pending"))
    for letter, found in pairs.items():
        share = sum(found) / max(len(found), 1)
        missed = "" if share <= GOALS[letter] else " **!**"
        shown = f"{sum(found)} ({100 * share:.1f} %){missed}"
        print(row([letter, len(found), shown, f"{100 * GOALS[letter]:.0f} %", pending[letter]]))


def text(part: Estimate | None) -> str:
    """Return value and limits, or the bound, in readable units."""
    if part is None or part.readable.high is None:
        return "pending"
    if part.readable.value is None:
        return f"< {part.readable.high:.3g}"
    digits = max(3, 2 - math.floor(math.log10(part.readable.high - (part.readable.low or 0.0))))
    return f"{part.readable.value:.{min(digits, 4)}g} ({part.readable.low:.3g}–{part.readable.high:.3g})"


if __name__ == "__main__":
    main()
