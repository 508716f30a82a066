"""What a person sees of `imumon demo`: how soon it lives, and what two minutes of it show.

    python benchmarks/demo.py [SECONDS [PICTURE.svg]]

Runs it in a terminal multiplexer of 150 x 40 and reads the screen there: when the first numbers stand, how
many of the 18 coefficients of gyroscope and accelerometer are measured (the others are bounds, or pending),
how long the curve is, and since when the grades are no longer provisional. Misses are said, and exit 1.
With a picture it saves the screen at the end, by its own key: so `docs/screen.svg` is made.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from terminals import Tmux
from waiting import until

ALIVE_S, SETTLED_S = 5.0, 120.0
CELL = re.compile(r"(\S+ (?:±|×÷)\S+|< \S+|in \S+ \w+|pending|never changes|rounded away|–)")
OCTAVES = re.compile(r"(\d+) of (\d+) octaves\s+longest (\S+ \w+(?: \d+ \w+)?)")


def coefficients(text: str) -> list[str]:
    """The 18 cells of N, B and K of gyroscope and accelerometer, as far as they stand there."""
    cells: list[str] = []
    for line in text.splitlines():
        if re.match(r"[ ▌]+[xyz]  ", line[:8]) and len(cells) < 18:
            cells += CELL.findall(line[24:72])[:3]
    return cells


def seen(text: str) -> tuple[int, int, str, str]:
    """Measured coefficients, all there are, length of the curve, and how the grades stand."""
    cells = coefficients(text)
    octaves = OCTAVES.search(text)
    names = re.findall(r"^ *(?:gyro|accel) +meets \w+, nearest \w+(, provisional)?", text, re.MULTILINE)
    grades = f"{len(names)} graded, {len(names) - names.count('')} provisional"
    length = f"{octaves[2]} octaves to {octaves[3]}" if octaves else "no curve yet"
    return sum("±" in cell or "×÷" in cell for cell in cells), len(cells), length, grades


def watch(seconds: float, picture: Path | None = None) -> int:
    """Watch a demo; exit code."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        pane = Tmux(Path(folder) / "tmux", f"cd {folder}; {sys.executable} -P -m imumon demo")
        try:
            alive, settled, first, last = _watched(pane, begin, seconds)
            if picture is not None:
                pane.press("s")
                until(lambda: "save this view" in pane.text())
                pane.press("v")
                until(lambda: list(Path(folder).glob("*.svg")))
                shutil.copy(next(Path(folder).glob("*.svg")), picture)
            pane.press("q")
        finally:
            time.sleep(1.0)
            pane.close()
    print(f"alive after {_or_never(alive)}, grades settled after {_or_never(settled)}")
    print(f"measured at first {first} of 18, at last {last}")
    fine = alive is not None and alive <= ALIVE_S and settled is not None and last > first
    return 0 if fine else 1


def _watched(pane: Tmux, begin: float, seconds: float) -> tuple[float | None, float | None, int, int]:
    """Seconds to the first numbers and to settled grades, measured coefficients at first and at last."""
    alive = settled = None
    first = last = 0
    told = -10.0
    while (now := time.monotonic() - begin) < seconds:
        text = pane.text()
        measured, known, length, grades = seen(text)
        if known == 18 and alive is None:
            alive, first = now, measured
        last = measured if known == 18 else last
        if "2 graded, 0 provisional" in grades:
            settled = now if settled is None else settled
        else:
            settled = None
        if now - told >= 10.0 or (alive == now):
            told = now
            print(f"{now:6.1f} s  {measured:2d} of {known:2d} measured  {length:<32}{grades}", flush=True)
        time.sleep(0.1 if alive is None else 1.0)
    return alive, settled, first, last


def _or_never(moment: float | None) -> str:
    return "never" if moment is None else f"{moment:.1f} s"


if __name__ == "__main__":
    span = float(sys.argv[1]) if len(sys.argv) > 1 else SETTLED_S
    sys.exit(watch(span, Path(sys.argv[2]) if len(sys.argv) > 2 else None))
