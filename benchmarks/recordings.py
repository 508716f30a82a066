"""Fits of two real recordings as Markdown and as figures, and the agreement of the parts of three.

    python benchmarks/recordings.py [--recordings DIR] [--figures DIR]

The recordings are not part of the project; without the folder there is nothing to do. Their `$VNYMR` is
read here without the decoder and without guards: every sample counts. "Octaves outside" is the share of octaves with
the model outside the 95 % limits of the curve.

A sensor at rest has one N, B and K, so the intervals of two parts of one record must overlap, apart from what
the sensor itself changes. The parts are halves, and quarters after the warm-up; each goes through the whole
pipeline. Its interval is the wider of its limits and of its value plus and minus 1.96 times its own scatter.
Goals: at most 1 in 20 pairs disjoint for N and K, 1 in 10 for B.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import math
from pathlib import Path

import numpy as np
from document_tables import head, row

from imumon import analyse
from imumon.model.coefficients import COEFFICIENTS, Estimate
from imumon.model.report import Report
from imumon.model.units import figures, pretty
from imumon.noise import AllanCurve, ChannelFit, Estimator, OctaveCascade

RATE = 40.0
AXES = ("gyro/x", "gyro/y", "gyro/z", "accel/x", "accel/y", "accel/z")
NAMES = {"kiran_stat5min": "VN-100 at rest", "fc_car_idle": "VN-100 in a parked car"}


def read(path: Path) -> np.ndarray:
    """Return (n, 6) rad/s and m/s^2 of the `$VNYMR` sentences whose checksum holds."""
    rows = []
    for line in gzip.decompress(path.read_bytes()).splitlines():
        body, star, check = line.strip().partition(b"*")
        if not star or not body.startswith(b"$VNYMR,"):
            continue
        total = 0
        for byte in body[1:]:
            total ^= byte
        if check[:2].upper() == b"%02X" % total:
            fields = [float(field) for field in body.split(b",")[1:]]
            rows.append(fields[9:12] + fields[6:9])
    return np.array(rows)


def formatted(axis: str, name: str, coefficient: Estimate) -> str:
    """Return a coefficient with its limits in readable units."""
    shown = COEFFICIENTS[name].units[axis.partition("/")[0]]
    if coefficient.status == "pending":
        return "pending"
    high = figures(coefficient.high * shown.factor)
    if coefficient.value is None:
        return f"< {high} {pretty(shown.unit)}"
    low, value = (figures(v * shown.factor) for v in (coefficient.low, coefficient.value))
    return f"{value} [{low}, {high}] {pretty(shown.unit)}"


def outside_limits(fit: ChannelFit) -> tuple[int, int]:
    """Return the number of octaves whose limits do not hold the model, and of all with limits."""
    given = (fit.edf > 0.0) & (fit.model > 0.0)
    return int((given & ((fit.model < fit.low) | (fit.model > fit.high))).sum()), int(given.sum())


def table(name: str, curve: AllanCurve, fits: tuple[ChannelFit, ...]) -> None:
    print(f"\n### {NAMES[name]}: {curve.span} samples, {curve.span / RATE:.0f} s\n")
    columns = ("axis", *"NBK", "up to, Hz", "χ²/dof", "octaves outside", "caveats")
    print(head(f"recording-{name.replace('_', '-')}", *columns))
    for axis, fit in zip(AXES, fits, strict=True):
        outside, octaves = outside_limits(fit)
        tested = (f"{fit.highest_hz:.3g}", f"{fit.chi2:.1f}/{fit.dof}") if fit.dof else ("–", "–")
        found = (formatted(axis, c, getattr(fit, c)) for c in "NBK")
        caveats = ", ".join(fit.caveats) or "–"
        print(row([axis, *found, *tested, f"{outside} of {octaves}", caveats]))


def draw(name: str, curve: AllanCurve, fits: tuple[ChannelFit, ...], folder: Path) -> None:
    """Draw curve, limits, model and left-out octaves of six axes, one panel per axis."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "font.size": 8,
            "svg.hashsalt": "imumon",
            "svg.fonttype": "none",
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )
    figure, panels = plt.subplots(2, 3, figsize=(9.6, 5.6), sharex=True, layout="constrained")
    for panel, axis, fit, sigma in zip(panels.flat, AXES, fits, curve.sigma.T, strict=True):
        used, tau = fit.used, curve.tau
        bars = [sigma - fit.low, np.minimum(fit.high, 3 * sigma) - sigma]
        panel.plot(tau, fit.model, color="#c44e52", lw=1.4, label="model", zorder=1)
        for mask, style, label in (
            (used, {"mfc": "#1f4e79"}, "in the fit"),
            (~used, {"mfc": "white"}, "left out"),
        ):
            if mask.any():
                limits = [bar[mask] for bar in bars]
                panel.errorbar(
                    tau[mask],
                    sigma[mask],
                    limits,
                    fmt="o",
                    ms=4.5,
                    color="#1f4e79",
                    elinewidth=0.9,
                    label=label,
                    **style,
                )
        panel.set(xscale="log", yscale="log")
        low = min(sigma.min(), fit.model.min())
        panel.set_ylim(low / 2, max(sigma.max(), fit.model.max()) * 1.6)
        panel.grid(True, which="major", lw=0.4, alpha=0.5)
        panel.minorticks_off()
        panel.set_title(axis, loc="left", fontweight="bold")
        text = "\n".join(f"{c} {formatted(axis, c, getattr(fit, c))}" for c in "NBK")
        panel.text(0.98, 0.97, text, transform=panel.transAxes, ha="right", va="top", fontsize=6.3)
    for line, unit in zip(panels, ("rad/s", "m/s²"), strict=True):
        line[0].set_ylabel(f"Allan deviation, {unit}")
    for panel in panels[1]:
        panel.set_xlabel("averaging time τ, s")
    handles = {}
    for panel in panels.flat:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(handles.values(), handles.keys(), loc="outside upper right", ncols=3, frameon=False)
    figure.suptitle(
        f"{NAMES[name]}, {curve.span / RATE:.0f} s at {RATE:.0f} Hz; bars: 95 % limits",
        x=0.01,
        ha="left",
        fontsize=9,
    )
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    figure.savefig(folder / f"{name}.png", dpi=110)
    plt.close(figure)


# Agreement of the parts ----------------------------------------------------------------

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
    return analyse(gyro=values[:, :3], accel=values[:, 3:], rate_hz=rate).report


def interval(part: Estimate | None) -> tuple[float, float] | None:
    """Return the wider of limits and scatter; None while pending."""
    if part is None or part.high is None:
        return None
    spread = 1.96 * (part.scatter or 0.0)
    value = part.value if part.value is not None else 0.0
    return min(part.low or 0.0, value - spread), max(part.high, value + spread)


def consistency(folder: Path) -> None:
    """Print the disjoint pairs of intervals of the parts of each record."""
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    parser.add_argument("--recordings", type=Path, default=default)
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args()
    for name in NAMES:
        path = options.recordings / f"{name}.vnymr.txt.gz"
        if not path.exists():
            print(f"{path} is not there: nothing to fit")
            continue
        cascade = OctaveCascade(len(AXES), tau0=1 / RATE)
        cascade.update(read(path))
        curve = cascade.result()
        fits = Estimator(averaged=False).fit(curve)
        table(name, curve, fits)
        if options.figures:
            draw(name, curve, fits, options.figures)
    if options.recordings.exists():
        print()
        consistency(options.recordings)


if __name__ == "__main__":
    main()
