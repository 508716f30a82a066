"""Rules of Gauss–Markov and popcorn noise, and of a walk that looks like other slow noise.

They decide whether these terms are in the model, and what is stated of them: the thresholds of `markov_search`,
`popcorn` and `search`. docs/THEORY.md prints this table after that of `fit_rules`.
"""

from __future__ import annotations

from imumon.noise.rule_table import RuleTable

RULES = RuleTable()

SHORTEST = RULES.add(
    "SHORTEST",
    10.0,
    unit="samples",
    decides="least time constant of Gauss–Markov noise that is tried",
    without="with less, the term competes with a filter in the sensor, and N is what neither explains",
    origin="below ten samples, the density is flat down to a tenth of the sampling rate: a low-pass has the same shape",
    benchmark="markov.py",
)
LONGEST = RULES.add(
    "LONGEST",
    0.1,
    unit="of the record",
    decides="greatest time constant of Gauss–Markov noise that is tried",
    without="with more, it looks like a random walk, and no record distinguishes the two",
    origin="a record of ten time constants has five independent values",
    benchmark="markov.py",
)
MARKOV_TIMES = RULES.add(
    "MARKOV_TIMES",
    9,
    unit="time constants",
    decides="number of time constants whose gains are averaged to the odds of the term",
    without="with fewer, a term between two of them loses gain; with more, fits are slow",
    origin="chosen: two of them are a factor of 2.7 apart in 2 h at 40 Hz, and the density of the term is wider",
    benchmark="markov.py",
)
PENALTY = RULES.add(
    "PENALTY",
    3.0,
    unit="odds",
    decides="odds against Gauss–Markov noise before the data",
    without="at 1, every record of flicker noise has odds above even, and limits of B reach to zero; at 8, half of the "
    "records of 36 time constants count as flicker and walk",
    origin="noise without the term has even odds in 1 to 7 % of records, and odds of 19 in none of 400",
    benchmark="markov.py",
)
CERTAIN_ODDS = RULES.add(
    "CERTAIN_ODDS",
    19.0,
    unit="odds",
    decides="Gauss–Markov noise is measured; below, it is one of several noises that the record does not distinguish",
    without="a standard deviation with a lower limit is stated of noise that may be flicker",
    origin="19 to 1 is 95 %, as of all limits",
    benchmark="markov.py",
)
INSTEAD_GAIN = RULES.add(
    "INSTEAD_GAIN",
    1.0,
    unit="log likelihood",
    decides="a walk that Gauss–Markov noise in its place explains better by as much is `indistinct`",
    without="M of a 36th of the record is measured as K in one record in five",
    origin="one parameter more (Akaike 1974); of a true walk, 3 to 10 % of the records are `indistinct` by it",
    benchmark="markov.py",
)
SLOWEST = RULES.add(
    "SLOWEST",
    4,
    unit="coefficients",
    decides="a walk that does not show without these lowest coefficients is a mean that moves slowly, and they are "
    "left out; then twice and four times as many, up to half of those that stay single",
    without="a mean that rises and falls once by 20 floors is measured as K in four records of five, and B is too "
    "small in one of four; with 6, K of three times the smallest is lost in 15 % of the records, with 4 in 12 %",
    origin="two cycles of the record: the least that is an oscillation",
    benchmark="markov.py",
)
BEYOND_EVIDENCE = RULES.add(
    "BEYOND_EVIDENCE",
    2.7,
    unit="twice the log likelihood ratio",
    decides="a walk shows without the lowest coefficients",
    without="at 1, a mean that moves from one level to another is measured as K in 10 of 100 records instead of 7",
    origin="5 % by chance (Chernoff 1954)",
    benchmark="markov.py",
)
CONSISTENT = RULES.add(
    "CONSISTENT",
    0.7,
    unit="probability",
    decides="a walk is as large without the lowest coefficients as with them if this quantile of K is above its value",
    without="at 0.9, a mean that moves from one level to another is measured as K in 23 of 100 records instead of 7",
    origin="half a standard error: where K is seen without the lowest coefficients, leaving them out costs little",
    benchmark="markov.py",
)
SLOW_TIMES = RULES.add(
    "SLOW_TIMES",
    6,
    unit="time constants",
    decides="number of time constants, up to the longest, that are tried in the place of a walk",
    without="with those of the odds, two of which are a factor of 2.7 apart in 2 h at 40 Hz, M loses gain between them",
    origin="chosen: two of them are a factor of 1.6 apart",
    benchmark="markov.py",
)
END_SHARE = RULES.add(
    "END_SHARE",
    0.2,
    unit="of the greatest density",
    decides="a time constant is bounded where its density has fallen to this share at both ends of what was tried",
    without="limits of a time constant are those of the tried ones and not of the data",
    origin="chosen: 1.8 standard errors",
    benchmark="markov.py",
)
LATTICE = RULES.add(
    "LATTICE",
    16,
    unit="time constants per octave",
    decides="time constants are rounded to a lattice",
    without="expectations are computed again for each channel and fit",
    origin="steps of 4 %: below the error of any time constant",
    benchmark="",
)
MARKOV_GRID = RULES.add(
    "MARKOV_GRID",
    10,
    unit="values",
    decides="resolution of B, of K and of M beside each other",
    without="with 7, limits of M move by a tenth of their distance in half of the channels",
    origin="chosen for the time. In 18 channels with M, limits with 20 values and 13 time constants differ by 1 % of "
    "their distance in half of the channels, and by 15 % in one",
    benchmark="",
)
MARKOV_NODES = RULES.add(
    "MARKOV_NODES",
    7,
    unit="time constants",
    decides="number of time constants over which the likelihood is summed",
    without="with 5, limits of the time constant move by up to a quarter of their distance",
    origin="chosen for the time; they span what has more than 0.2 % of the greatest likelihood",
    benchmark="",
)
SCORE_ODDS = RULES.add(
    "SCORE_ODDS",
    0.39,
    unit="odds",
    decides="below these odds by the score, which costs a tenth, the likeliest powers are not sought",
    without="each fit without the term takes a fifth longer",
    origin="in 154 fits with and without the term, the odds were 0.74 at most where the score gave less than 0.39",
    benchmark="",
)
PEAK_STEPS = RULES.add(
    "PEAK_STEPS",
    40,
    unit="steps",
    decides="most steps of Fisher's scoring in the logarithms of the powers",
    without="with 25, one gain in twenty is too small by 1.5",
    origin="95 % of gains are within 0.02 of those with 400 steps; the others differ by up to 0.8 from them",
    benchmark="",
)
CONVERGED = RULES.add(
    "CONVERGED",
    1e-3,
    unit="of a power",
    decides="scoring ends where no power moves by more",
    without="all steps are taken, of which most fits need a third",
    origin="a gain is flat at its maximum: it moves by the square",
    benchmark="",
)
LONGEST_STEP = RULES.add(
    "LONGEST_STEP",
    1.5,
    unit="in the logarithm of a power",
    decides="longest step of scoring, a factor of 4.5",
    without="a power far from its maximum overshoots, and scoring does not end",
    origin="chosen",
    benchmark="",
)
LEAST_SHARE = RULES.add(
    "LEAST_SHARE",
    1e-4,
    unit="of the noise",
    decides="least power that a term has in scoring, where it shows most",
    without="a power that vanishes has no logarithm",
    origin="chosen: far below what any record shows",
    benchmark="",
)
LEVELS_SIGMA = RULES.add(
    "LEVELS_SIGMA",
    4.0,
    unit="standard deviations",
    decides="Gauss–Markov noise is popcorn noise where the excess kurtosis of the block means is below zero by as much",
    without="Gauss–Markov noise is described by two levels that it does not have",
    origin="3e-5 if the kurtosis is normal, because every channel is tested in every fit; none of 60 records of "
    "Gauss–Markov noise is one",
    benchmark="markov.py",
)
LEVELS_SPAN = RULES.add(
    "LEVELS_SPAN",
    20.0,
    unit="time constants",
    decides="levels are about a mean over this time",
    without="a walk beside the jumps smears the levels",
    origin="chosen: ten times in each level",
    benchmark="markov.py",
)
