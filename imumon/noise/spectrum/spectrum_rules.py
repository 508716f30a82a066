"""Rules of the spectrum: which segments and levels count, and which bins are lines.

The thresholds of `spectrum_accumulator`, `power_spectrum` and `spectral_lines`. docs/THEORY.md prints this table.
"""

from __future__ import annotations

from imumon.noise.rule_table import RuleTable

RULES = RuleTable()

LEAST_AVERAGES = RULES.add(
    "LEAST_AVERAGES",
    4,
    unit="averages",
    decides="a level with fewer does not count in a fit, and the level above is displayed instead",
    without="the density of a bin is hardly known, and a level of few averages hides a better one",
    origin="with three, the 95 % limits of a bin span a factor of 13",
    benchmark="",
)
MOST_VARIATION = RULES.add(
    "MOST_VARIATION",
    0.8,
    unit="relative variance of the shares of valid samples within a segment",
    decides="a segment with more does not count; where a share p is missing, it is p / (1 - p), so that 44 % may be",
    without="at 0.06, a record with a sixth of it in holes has no segments where B shows, and its K is a bound",
    origin="with 40 % of scattered losses, flicker is expected 1.5 % too large at level 0, with 48 % it would be 3 %",
    benchmark="holes.py",
)
LINE_CHANCE = RULES.add(
    "LINE_CHANCE",
    1e-6,
    unit="probability",
    decides="a bin is a narrow band above a density that noise alone exceeds in this share of bins",
    without="lower, a weak line stays in the spectrum that is fitted; higher, bins are left out by chance",
    origin="one in 200 reports of nine channels has such a band, of little power; one that is also a line "
    "was in none of 3,000",
    benchmark="guards.py --lines",
)
PROMINENCE = RULES.add(
    "PROMINENCE",
    2.0,
    unit="of the density beside it",
    decides="a band whose highest bin exceeds it is reported as a line",
    without="bands that change no coefficient are named",
    origin="chosen: less does not matter to a user",
    benchmark="guards.py --lines",
)
SIDE = RULES.add(
    "SIDE",
    11,
    unit="bins",
    decides="the density beside a bin is the median of this many bins on each side; lower bins have no lines",
    without="the median of fewer scatters more, and that of more follows a slope of the density less",
    origin="chosen",
    benchmark="guards.py --lines",
)
LEVEL_ERRORS = RULES.add(
    "LEVEL_ERRORS",
    3.0,
    unit="standard errors",
    decides="the threshold of a line is raised by this many of the median beside it",
    without="a median that is too low by chance makes a line of noise",
    origin="chosen",
    benchmark="guards.py --lines",
)
SAME_LINE = RULES.add(
    "SAME_LINE",
    0.03,
    unit="relative difference",
    decides="two lines of two levels whose frequencies differ by less are one",
    without="a line between two levels is named twice",
    origin="chosen",
    benchmark="",
)
HARMONICS = RULES.add(
    "HARMONICS",
    3,
    unit="",
    decides="highest harmonic of the mains that a line, or its alias, is compared with",
    without="with more, some harmonic is near to any frequency",
    origin="chosen",
    benchmark="",
)
MAINS_SPREAD = RULES.add(
    "MAINS_SPREAD",
    0.002,
    unit="of the frequency",
    decides="deviation of the mains from 50 or 60 Hz up to which a line may be of the mains",
    without="a hum beside the nominal frequency has no cause that is named",
    origin="chosen: a deviation that is common",
    benchmark="",
)
