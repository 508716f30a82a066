"""Rules of the fit: every threshold between the sums of a record and the numbers that it states.

The rows follow the way of a number: what is compared (observations), how likely it is (likelihood), which terms explain
it (search), and what is stated. The rules of the temperature are in `temperature_rules`, those of Gauss–Markov noise in
`markov_rules`. docs/THEORY.md prints these tables. `python benchmarks/sensitivity.py noise.fit` halves and doubles each
value and shows which published numbers move.

Two kinds of values must not be confused. *Decisions* (a probability, odds) say what counts; each has an error rate that
`benchmarks/real_effects.py` measures. *Resolutions* (grids, nodes, steps) only have to be fine enough: their rows say
from which size on nothing changes.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.rule_table import RuleTable

RULES = RuleTable()

# --- observations: what is compared with a model -------------------------------------------------------------

BAND_EDGES = RULES.add(
    "BAND_EDGES",
    (46, 70, 94, 128),
    unit="bins",
    decides="edges of the bands of a level; a level below the first uses bins 46 to 91 only",
    without="wider bands: one expectation does not describe a band of K; narrower ones: the likelihood is slower",
    origin="within half an octave no noise of the model changes by more than 2.3 times; the level above has "
    "the bins from 92 on",
    benchmark="",
)

LEAST_BINS = RULES.add(
    "LEAST_BINS",
    2,
    unit="bins",
    decides="a band with fewer bins beside its lines does not count",
    without="one bin beside a line holds the tail of the line and moves N",
    origin="a bin shares half of its power with its neighbours (Hann window), so that one is no independent band",
    benchmark="real_effects.py",
)
SINGLE = RULES.add(
    "SINGLE",
    48,
    unit="coefficients",
    decides="this many lowest cosine coefficients stay single; regressors act on them, the others are pooled "
    "in bands",
    without="with fewer, a settling or a step leaves power in the bands, which B and K take; with more, fits "
    "are slow",
    origin="the spectrum of a smooth column falls with the square of the number: 1/48^2 is below the noise of "
    "a band",
    benchmark="sensitivity.py",
)
LEAST_BLOCKS = RULES.add(
    "LEAST_BLOCKS",
    12,
    unit="blocks",
    decides="a segment with fewer blocks does not count, a channel with fewer is pending; a step has half of them on "
    "each side",
    without="drift and constant leave no coefficient for the noise, and limits of B and K are those of the prior",
    origin="12 blocks have 11 coefficients, of which a third stays single: three, of which the drift takes one",
    benchmark="real_effects.py",
)
MOST_FILLED = RULES.add(
    "MOST_FILLED",
    0.3,
    unit="of the blocks",
    decides="holes between blocks up to this share together are interpolated; more of them join the blocks in pairs",
    without="with 0.05 blocks are so long that no octave shows B where a sixth of a record is missing, and many "
    "records have no result where half is missing",
    origin="the expectation holds what interpolation takes; limits hold with half of a record missing",
    benchmark="holes.py",
)
LONGEST_FILLED = RULES.add(
    "LONGEST_FILLED",
    0.05,
    unit="of the blocks",
    decides="a hole up to this share is interpolated; a longer one separates two segments",
    without="the straight line over a long hole repeats the flicker of its two ends, which no expectation holds",
    origin="chosen; limits of records with lost samples are tested with it",
    benchmark="real_effects.py",
)
COUNTED_FALL = RULES.add(
    "COUNTED_FALL",
    0.5,
    unit="of the highest octave",
    decides="coarse values are counts of an angle where the density of some octave is below this share",
    without="a counting gyroscope is pending; at 1, a rounded rate counts as an angle by the scatter of its octaves",
    origin="rounding adds a quarter of the squared count there: below half of it, noise moves half a count a sample",
    benchmark="",
)
INDEPENDENT_COUNTS = RULES.add(
    "INDEPENDENT_COUNTS",
    0.5,
    unit="counts of noise between two samples",
    decides="the errors of rounding are independent from here on",
    without="errors that move together count as white, and limits of N are wrong",
    origin="errors s counts of noise apart have the correlation exp(-2 pi^2 s^2), 0.7 % here; with 0.4 counts, upper "
    "limits of N miss in 8 % of records",
    benchmark="",
)
NEGLIGIBLE_ROUNDING = RULES.add(
    "NEGLIGIBLE_ROUNDING",
    0.2,
    unit="standard errors of N^2",
    decides="what rounding of a rate adds to N^2 is looked at from here on: it may be that of an angle, twice as much",
    without="every channel of a file with few digits is fitted twice",
    origin="a tenth of the distance from N to its limit",
    benchmark="sample_errors.py",
)
LEAST_VARIANCE = RULES.add(
    "LEAST_VARIANCE",
    1e-100,
    unit="(channel unit)^2",
    decides="floor of every variance; a channel with less is constant",
    without="squares of variances underflow, and a constant channel gives 0/0",
    origin="the square of 1e-100 is above the least number of 64 bits",
    benchmark="",
)

# --- likelihood: how probable N, B and K are -------------------------------------------------------------------

GRID = RULES.add(
    "GRID",
    20,
    unit="values",
    decides="resolution of B and of K, half as many where columns are tried; also the frequencies that are tried "
    "between two coefficients for an oscillation",
    without="with 10, limits of B and K move by up to 9 % of their distance",
    origin="with 16 no limit of 15 channels moves by more than 0.7 % of the distance of the limits; with 40 and 80 "
    "by 1 %, but one, a lower limit of B, by 10 %",
    benchmark="resolution.py",
)
FINE = RULES.add(
    "FINE",
    8,
    unit="parts of a cell",
    decides="resolution of the cumulative probability between two points of the grid",
    without="with 2, limits move by up to 1.1 % of their distance",
    origin="with 32 no limit moves by more than 0.1 % of the distance of the limits",
    benchmark="resolution.py",
)
WIDEST_SEARCH = RULES.add(
    "WIDEST_SEARCH",
    (1e-6, 1e12),
    unit="of the power of N",
    decides="least and greatest power of B and K in the first search, in the lowest coefficient of the record",
    without="a channel without white noise, or with K just above nothing, begins outside of the grid",
    origin="from a thousandth of the amplitude of N to a channel whose white noise is a millionth",
    benchmark="",
)
DECADES = np.concatenate(([0.0], np.geomspace(*WIDEST_SEARCH, 27)))
"""B^2 and K^2 of the first search, in units of the power that N has in the lowest coefficient."""
DROP = RULES.add(
    "DROP",
    9.0,
    unit="log likelihood",
    decides="the grid ends where the likelihood has fallen by this much",
    without="with 4.5, limits move by up to 9 % of their distance, because tails are cut off; with more, most of the "
    "grid is empty",
    origin="exp(-9) = 10^-4 of the greatest likelihood; with 13 no limit moves by more than 0.9 %",
    benchmark="resolution.py",
)
GRID_FALL = RULES.add(
    "GRID_FALL",
    0.7,
    unit="of DROP",
    decides="a grid holds the likelihood if this has fallen by this share at both ends, and at least half of the cells "
    "lie above that",
    without="at 1 a grid that was made from its predecessor would always be made again",
    origin="exp(-6.3) = 0.002 of the greatest likelihood; with 0.5 and 0.9 no limit moves by more than 1 %",
    benchmark="resolution.py",
)
MOST_MOVES = RULES.add(
    "MOST_MOVES",
    6,
    unit="grids",
    decides="a grid that does not hold the likelihood is moved this often at most",
    without="a likelihood with two maxima would move the grid to and fro without end",
    origin="a likelihood with one maximum is held after two or three; a grid that is never held is stated as "
    "`unbounded`",
    benchmark="",
)
SCORING_STEPS = RULES.add(
    "SCORING_STEPS",
    3,
    unit="steps",
    decides="steps of Fisher's scoring for the powers that are profiled, at each point of the grid",
    without="the first step starts from the median of the upper bands, which holds B and K: N keeps a part of them",
    origin="with 1 step no limit moves by more than 0.03 % of the distance of the limits; the corner of a low-pass, "
    "which is not linear, needs the others",
    benchmark="resolution.py",
)
LEAST_MOVE = RULES.add(
    "LEAST_MOVE",
    1e-4,
    unit="of a power",
    decides="scoring ends before `SCORING_STEPS` where no power moves by more",
    without="every point of every grid takes all steps, and fits are slow",
    origin="in 359 fits of simulated and real records, the steps beyond moved no number by more than 5e-8 of itself; "
    "with 1e-2 no limit of 15 channels moves by 0.01 % of the distance of the limits",
    benchmark="resolution.py",
)
LEAST_POWER = RULES.add(
    "LEAST_POWER",
    1e-3,
    unit="of the observed power",
    decides="no expectation is smaller than this share of what was observed",
    without="a band without expected power (N = 0 in the grid) has an infinite misfit, which hides every other "
    "band",
    origin="30 dB: far below what any model that is not rejected leaves open",
    benchmark="",
)
SLOW_GROUPS = RULES.add(
    "SLOW_GROUPS",
    (0, 3, 7, 15, 31),
    unit="coefficients",
    decides="first single coefficients of the groups in which their misfit is judged",
    without="with all 48 in one, a missing lowest frequency is diluted; with each alone, all of them are",
    origin="an octave each, beginning with three coefficients, of which a drift takes one",
    benchmark="markov.py",
)
SLOW_DEGREES = RULES.add(
    "SLOW_DEGREES",
    0.5,
    unit="degrees of freedom",
    decides="a group of single coefficients with fewer degrees beside the columns is not judged",
    without="what a column nearly explains is divided by what it leaves, and any rounding is a misfit",
    origin="chosen: half of one coefficient",
    benchmark="real_effects.py",
)

# --- search: which terms explain the record --------------------------------------------------------------------

REJECT_P = RULES.add(
    "REJECT_P",
    1e-3,
    unit="probability",
    decides="the bands reject an upper end of the spectrum, and the next one is tried",
    without="with 0.01 one record in a hundred loses its highest octave by chance; with less, a weak filter is fitted "
    "as B",
    origin="nine channels that are fitted a hundred times a day: one wrong rejection a day",
    benchmark="real_effects.py",
)
TOLERANCE = RULES.add(
    "TOLERANCE",
    0.01,
    unit="relative error",
    decides="error of the model in every band that the tests of the upper end allow; also the share that a step may "
    "have in a band of the spectrum that counts",
    without="a record of months rejects every model: no sensor follows one to a tenth of a per cent",
    origin="chosen: 0.04 dB, below the ripple of the filters in sensors",
    benchmark="real_effects.py",
)
MOST_ERROR = RULES.add(
    "MOST_ERROR",
    0.3,
    unit="relative error",
    decides="beyond it, the model does not describe the channel and no coefficient is stated; N counts as shown with a "
    "relative error of N^2 up to it",
    without="coefficients with limits are stated for a vibrating platform",
    origin="an error of 30 % in every band makes limits of N of 15 %: no user calls this a measurement of noise",
    benchmark="guards.py",
)
WINDOWS = RULES.add(
    "WINDOWS",
    (2, 3, 4, 5, 6, 8, 10, 12, 16),
    unit="samples",
    decides="lengths of a moving average in the sensor that are tried",
    without="its spectrum is fitted as a low-pass, and octaves are left out that show N",
    origin="lengths that sensors have: VN-100 and ADIS16405 powers of two, others divisors of their rates",
    benchmark="real_effects.py",
)
WINDOW_BANDS = RULES.add(
    "WINDOW_BANDS",
    8,
    unit="bands",
    decides="highest bands by which a moving average is recognised",
    without="more of them compare B and K with the white noise of the average",
    origin="an average bends the highest octaves most; eight bands are the first four octaves",
    benchmark="",
)

CHANCE = RULES.add(
    "CHANCE",
    0.01,
    unit="probability",
    decides="noise alone makes an oscillation that is left out, or a misfit, in this share of records",
    without="leaving out a coefficient costs little, missing an oscillation makes B too large",
    origin="over all coefficients of a record (Bonferroni)",
    benchmark="real_effects.py",
)
LEAK = RULES.add(
    "LEAK",
    0.02,
    unit="of the noise",
    decides="coefficients beside an oscillation are left out up to where its leakage is below this share of "
    "the noise",
    without="the skirt of a strong oscillation is fitted as B",
    origin="the leakage of a steady oscillation falls with the square of the distance; 2 % is below the limits "
    "of B",
    benchmark="real_effects.py",
)
OSCILLATION_WIDTHS = RULES.add(
    "OSCILLATION_WIDTHS",
    (1, 3, 8, 24),
    unit="coefficients",
    decides="neighbouring coefficients that are tested together for an oscillation",
    without="with single ones only, an oscillation whose period wanders is fitted as B",
    origin="steps of three: between two of them the test loses little",
    benchmark="real_effects.py",
)
MOST_MASKED = RULES.add(
    "MOST_MASKED",
    0.5,
    unit="of the coefficients",
    decides="where more would be left out, nothing is: what is above the noise everywhere is noise of another kind",
    without="a random walk beside a first guess of K = 0 would be left out as oscillations",
    origin="no oscillation fills half of the spectrum",
    benchmark="real_effects.py",
)
FEWEST_CYCLES = RULES.add(
    "FEWEST_CYCLES",
    2,
    unit="cycles",
    decides="oscillations with fewer in a segment are none",
    without="one cycle looks like a random walk, and K is bounded in most records",
    origin="chosen",
    benchmark="",
)
FEW_CYCLES = RULES.add(
    "FEW_CYCLES",
    16,
    unit="cycles",
    decides="up to here columns describe an oscillation, beyond its coefficients are left out",
    without="columns beyond: the phase of an oscillation wanders, and four columns no longer hold it",
    origin="chosen",
    benchmark="real_effects.py",
)
LEAST_ODDS = RULES.add(
    "LEAST_ODDS",
    0.35,
    unit="odds",
    decides="a column is in doubt from here on, and the fits with and without it are mixed by their odds",
    without="at 1, the walk that a step of five times the floor looks like is measured in one record in ten",
    origin="below, the column has less than a quarter of the weight, and hardly moves a limit",
    benchmark="markov.py",
)
LEAST_CYCLE = RULES.add(
    "LEAST_CYCLE",
    0.15,
    unit="cycles",
    decides="from here on, a part of a cycle of a day is sought in records without a temperature",
    without="shorter parts are a drift, and K is a bound in every record",
    origin="chosen: 3.6 h, in which a cycle bends by a tenth of its size",
    benchmark="markov.py",
)
CYCLE_PENALTY = RULES.add(
    "CYCLE_PENALTY",
    3.0,
    unit="odds",
    decides="odds against a cycle of a day before the data",
    without="at 1, the walk of every second record may be a cycle, and its limits are too wide",
    origin="two free numbers gain e on the average by chance alone",
    benchmark="markov.py",
)
SETTLING_CERTAIN = RULES.add(
    "SETTLING_CERTAIN",
    20.0,
    unit="twice the log likelihood ratio",
    decides="from here on an exponential is a column; below, the fits with and without it are mixed by their odds",
    without="lower, a walk is called a warm-up in some per cent of records and K is only a bound; higher, limits of K "
    "are too wide after a warm-up",
    origin="odds of 10^3 for nine time constants",
    benchmark="real_effects.py --only warm-up",
)
CERTAIN = RULES.add(
    "CERTAIN",
    30.0,
    unit="twice the log likelihood ratio",
    decides="from here on a step is a column, and an oscillation whose coefficients are left out is reported",
    without="a walk is broken into steps, and K vanishes",
    origin="10^-7 by chance (Wilks 1938), at any of a thousand places",
    benchmark="real_effects.py",
)
MOST_TERMS = RULES.add(
    "MOST_TERMS",
    12,
    unit="rounds",
    decides="the search for columns and oscillations ends after this number of rounds",
    without="on a moving platform each round finds another step, and a fit takes seconds",
    origin="a record with more than 12 steps and oscillations is not at rest; it is stated as `search_ended`",
    benchmark="",
)
SEARCHED = RULES.add(
    "SEARCHED",
    256,
    unit="coefficients",
    decides="single coefficients in which columns are sought, and which stay single beside a column with a wide "
    "spectrum",
    without="with 48 a step in a short record looks like a walk, and the bends of a short warm-up look alike",
    origin="1,024 blocks have 341 single coefficients at most; the spectrum of a step falls with the frequency",
    benchmark="real_effects.py",
)
BEYOND_SINGLE = RULES.add(
    "BEYOND_SINGLE",
    0.05,
    unit="of the power of a column",
    decides="a column has a wide spectrum if more of its power, by the frequency, lies beyond `SINGLE` coefficients",
    without="the temperature, its square and its cube, alike in 48 coefficients, are large numbers of opposite sign",
    origin="in 562 blocks a step has 0.4, an exponential 0.33 to 0.0005 from a hundredth to a third of the record, a "
    "cycle 0.001 at most",
    benchmark="temperature.py",
)
SETTLING_TIMES = RULES.add(
    "SETTLING_TIMES",
    (0.008, 0.015, 0.03, 0.05, 0.08, 0.13, 0.2, 0.32, 0.5),
    unit="of the segment",
    decides="time constants of an exponential that are tried",
    without="a settling between two of them leaves power in the lowest coefficients",
    origin="the derivative by the time constant is a column, too: neighbours a factor of 1.6 to 2 apart cover "
    "what lies between",
    benchmark="real_effects.py --only warm-up",
)
SETTLING_SHARES = np.array(SETTLING_TIMES)
COEFFICIENTS_PER_COLUMN = RULES.add(
    "COEFFICIENTS_PER_COLUMN",
    6,
    unit="coefficients",
    decides="single coefficients of a segment that its drift, or an exponential, needs",
    without="a record of many short segments spends all coefficients on drifts and has none for the noise",
    origin="one in six: limits grow by 10 %",
    benchmark="real_effects.py",
)
STEP_WIDTHS = RULES.add(
    "STEP_WIDTHS",
    (1, 4, 16),
    unit="blocks",
    decides="widths before and after a place whose means are compared for a step",
    without="with single blocks a small step of a long segment is not among the candidates",
    origin="chosen: powers of four",
    benchmark="real_effects.py",
)
STEP_PLACES = RULES.add(
    "STEP_PLACES",
    2,
    unit="places",
    decides="candidates for a step of each width",
    without="with one, an outlying block hides the step",
    origin="chosen",
    benchmark="",
)

# --- statement: what is said of the terms ----------------------------------------------------------------------

LEAST_B_K_S = RULES.add(
    "LEAST_B_K_S",
    10.0,
    unit="s",
    decides="B and K are pending before",
    without="a filter, a vibration and the start of a stream look like B and K for some seconds",
    origin="chosen: ten periods of a vibration of 1 Hz",
    benchmark="real_effects.py",
)
EVIDENCE = RULES.add(
    "EVIDENCE",
    4.8,
    unit="twice the log likelihood ratio",
    decides="a coefficient is measured; else its 97.5 % quantile is an upper bound",
    without="at 0 noise alone is measured as B and K in half of the records",
    origin="1.4 % false detections: half of the records without the term have the best value at zero (Chernoff 1954). "
    "Of N^2 and Q^2 it is the square over that of the standard error",
    benchmark="real_effects.py",
)
MOST_OUTSIDE = RULES.add(
    "MOST_OUTSIDE",
    3,
    unit="octaves",
    decides="the drawn model misses the curve where it is outside of its limits at this number of octaves, or at the "
    "longest two; B, K and M that decide it there become bounds",
    without="a coefficient is stated of a noise of another kind, whose curve is beside the model",
    origin="of noise that the model has, 9 of 400 channels miss by chance",
    benchmark="markov.py",
)
COLUMN_SLACK = RULES.add(
    "COLUMN_SLACK",
    0.05,
    unit="of the Allan deviation of the columns",
    decides="the drawn model may be outside of the limits of the curve by as much",
    without="a strong temperature, known to a per cent, misses limits that are narrower, and N, B and K become bounds",
    origin="chosen: a column describes what moves the mean to some per cent",
    benchmark="temperature.py",
)
SAME_PERIOD = RULES.add(
    "SAME_PERIOD",
    0.2,
    unit="relative difference",
    decides="two oscillations with closer periods are one",
    without="what is left of an oscillation beside its columns is named as a second one",
    origin="an oscillation of four cycles lies at the eighth coefficient: half a coefficient is 6 % of its period",
    benchmark="",
)
VISIBLE = RULES.add(
    "VISIBLE",
    0.1,
    unit="of the Allan variance",
    decides="from here on lines (`vibration`) or a drift (`ramp`) are named, and a temperature explains a share",
    without="each hum of a microvolt is a caveat",
    origin="5 % of the deviation: about the width of the line of a figure",
    benchmark="",
)
ALIAS_WIDTHS = RULES.add(
    "ALIAS_WIDTHS",
    3.0,
    unit="widths of the line",
    decides="distance up to which a slow oscillation is the alias of a line",
    without="a strong hum is named twice, once with a false period",
    origin="the share of a Gaussian line beyond is 0.3 %",
    benchmark="",
)
ALIAS_SHARE = RULES.add(
    "ALIAS_SHARE",
    0.1,
    unit="of the oscillation",
    decides="least part of it that the line must leave behind the average of a block",
    without="any line would hide any oscillation at its alias",
    origin="chosen",
    benchmark="",
)
SLOPE_TOLERANCE = RULES.add(
    "SLOPE_TOLERANCE",
    0.2,
    unit="slope",
    decides="a classical reading is taken where the slope of the curve is this near to the nominal one",
    without="a flat curve has a reading of N",
    origin="halfway to the next nominal slope is 0.25",
    benchmark="",
)
RENEWAL_GROWTH = RULES.add(
    "RENEWAL_GROWTH",
    1.02,
    unit="of the length",
    decides="a fit is computed again when the record has grown by this factor; in between the last one holds",
    without="a daemon spends its time on fits that change nothing",
    origin="limits shrink by 1 % meanwhile",
    benchmark="daemon_cost.py",
)

# --- curve, times, scatter -----------------------------------------------------------------------------------

LAGS = RULES.add(
    "LAGS",
    12,
    unit="clusters",
    decides="lags over which the covariance of differences is summed",
    without="fewer: the limits of flicker are too narrow",
    origin="that of flicker falls with the fourth power of the lag",
    benchmark="",
)
LINE_WIDTHS = RULES.add(
    "LINE_WIDTHS",
    2.2,
    unit="widths",
    decides="half of the band by which the drawn model represents a line",
    without="a line as one frequency oscillates with tau, the measured curve does not: its frequency wanders",
    origin="97 % of a Gaussian line",
    benchmark="",
)
LINE_NODES = np.linspace(-LINE_WIDTHS, LINE_WIDTHS, 23)
FREQUENCIES = RULES.add(
    "FREQUENCIES",
    60,
    unit="frequencies",
    decides="points of the integral of the Fisher information, even in the logarithm",
    without="times are off by the error of the integral",
    origin="30 or 240 change times by 1.4 %",
    benchmark="sensitivity.py",
)
LOWEST_HALF_CYCLES = RULES.add(
    "LOWEST_HALF_CYCLES",
    1.5,
    unit="half cycles per record",
    decides="lowest frequency that counts in `time_to`",
    without="constant and drift take the lowest two coefficients: with 0.5 the promised time is a fifth too short",
    origin="half a cycle is the constant, one is the drift",
    benchmark="sensitivity.py",
)
WIDTH_OVER_BOUND = RULES.add(
    "WIDTH_OVER_BOUND",
    1.15,
    unit="",
    decides="half-widths of B and K that a longer record is expected to have, over those of the Cramér-Rao bound",
    without="a half-width that is wide or narrow by chance shifts the whole prediction: half of the lengths that are "
    "promised for B are wrong by more than a factor of 1.5",
    origin="medians over simulated records are 1.03 to 1.25, the larger ones while the half-width is above 20 %",
    benchmark="remaining_time.py",
)
WIDTH_MEMORY = RULES.add(
    "WIDTH_MEMORY",
    1.5,
    unit="",
    decides="power of the ratio of two lengths of a record with which the longer one keeps what its half-width has "
    "beyond the expected one",
    without="0: the prediction jumps with each half-width; infinite: it does not learn from the record",
    origin="1 to 2 are alike; with 0.5 or 4, up to 10 % fewer lengths promised for B are within a factor of 1.5",
    benchmark="remaining_time.py",
)
PROMISED = RULES.add(
    "PROMISED",
    2.5,
    unit="requested half-widths",
    decides="B and K with a wider half-width have no time until they are precise enough",
    without="B and K that show early are those that are estimated too high: their times are too short",
    origin="of the lengths promised for B, 92 and 82 % are within a factor of 1.5 with 2.5, and 88 and 79 % with 3, "
    "for two K",
    benchmark="remaining_time.py",
)
NEGLECTED_P = RULES.add(
    "NEGLECTED_P",
    0.25,
    unit="probability",
    decides="a higher degree of the bias curve, or the variance between quarters, counts where chance makes as much in "
    "fewer records",
    without="at 0.05 limits beside a neglected term hold 88 %, at 0.25 92 %",
    origin="Bancroft 1944; Biometrics 20, 1964",
    benchmark="temperature.py",
)
