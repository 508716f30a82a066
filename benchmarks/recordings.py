"""Fits of two real recordings, a VN-100 at rest and one in a parked car, as Markdown and as figures.

    python benchmarks/recordings.py [--recordings DIR] [--figures DIR]

The recordings are not part of the project; without the folder there is nothing to do. Their `$VNYMR` is
read here without the decoder and without guards: every sample counts. "Octaves outside" is the share of octaves with
the model outside the 95 % limits of the curve.
"""

from __future__ import annotations

import argparse
import gzip
from pathlib import Path

import numpy as np
from document_tables import head, row

from imumon.coefficients import COEFFICIENTS, Estimate
from imumon.noise import AllanCurve, ChannelFit, Estimator, OctaveCascade
from imumon.units import figures, pretty

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


if __name__ == "__main__":
    main()
