"""Rules of the distribution: whether values are Gaussian, which outliers they have, and where a sensor is clipped.

The thresholds of `distribution_shape`, `differences` and `extreme_values`. docs/THEORY.md prints this table.
"""

from __future__ import annotations

from imumon.noise.rule_table import RuleTable

RULES = RuleTable()


# --- shape: what the verdict is -------------------------------------------------------------------------------

GAUSSIAN_DISTANCE = RULES.add(
    "GAUSSIAN_DISTANCE",
    0.025,
    unit="Kolmogorov distance",
    decides="up to here a distribution counts as Gaussian",
    without="long records reject every distribution: no sensor is exactly Gaussian",
    origin="chosen: probabilities are right to 2.5 %",
    benchmark="",
)
GAUSSIAN_SKEWNESS = RULES.add(
    "GAUSSIAN_SKEWNESS",
    0.25,
    unit="skewness",
    decides="up to here a distribution counts as Gaussian",
    without="see GAUSSIAN_DISTANCE: every long record is skewed",
    origin="chosen",
    benchmark="",
)
GAUSSIAN_KURTOSIS = RULES.add(
    "GAUSSIAN_KURTOSIS",
    0.5,
    unit="excess kurtosis",
    decides="up to here a distribution counts as Gaussian",
    without="see GAUSSIAN_DISTANCE: every long record has heavy or light tails",
    origin="chosen",
    benchmark="",
)
DISTANCE_ERROR = RULES.add(
    "DISTANCE_ERROR",
    1.5,
    unit="1/sqrt(n)",
    decides="sampling error of the distance that is allowed beside GAUSSIAN_DISTANCE",
    without="short records are not Gaussian by chance",
    origin="chosen",
    benchmark="",
)
MOMENT_ERRORS = RULES.add(
    "MOMENT_ERRORS",
    4.0,
    unit="standard errors",
    decides="errors of skewness, kurtosis and a ratio of deviations that chance may make; a mode rises by more",
    without="short records have verdicts by chance",
    origin="chosen",
    benchmark="",
)
QUANTISED_STEPS = RULES.add(
    "QUANTISED_STEPS",
    1.5,
    unit="quantisation steps",
    decides="a channel with a smaller standard deviation is called quantised",
    without="a distribution of two or three levels is compared with a bell",
    origin="chosen",
    benchmark="",
)
FEW_LEVELS = RULES.add(
    "FEW_LEVELS",
    8,
    unit="levels",
    decides="a channel with more, whose step could not be learned, is not called quantised; with fewer in a "
    "standard deviation, a median is sought between levels",
    without="the least difference of many levels may be several steps",
    origin="chosen",
    benchmark="",
)
MODE_HEIGHT = RULES.add(
    "MODE_HEIGHT",
    0.1,
    unit="of the highest count",
    decides="a mode rises above the valleys beside it by as much",
    without="each ripple of the histogram is a mode",
    origin="chosen",
    benchmark="",
)
MODE_WIDTH = RULES.add(
    "MODE_WIDTH",
    0.25,
    unit="of the standard deviation",
    decides="width of the kernel that smooths the counts before modes are sought",
    without="with a narrower one, noise of the counts makes modes; with a wider one, two modes become one",
    origin="chosen",
    benchmark="",
)
LEARN_SAMPLES = RULES.add(
    "LEARN_SAMPLES",
    256,
    unit="samples",
    decides="the step of a quantised channel is read from this many; with fewer there is no verdict and no median",
    without="a step is learned from values that chance has left out",
    origin="chosen",
    benchmark="",
)

# --- differences: outliers of the noise -----------------------------------------------------------------------

REPEATED = RULES.add(
    "REPEATED",
    0.25,
    unit="of the differences",
    decides="with a larger share of zeros, the sensor is slower than its samples: their median is not used",
    without="the robust deviation of repeated values is far too small, and all changes are outliers",
    origin="rounding to LEAST_STEPS gives a tenth",
    benchmark="",
)
LEAST_STEPS = RULES.add(
    "LEAST_STEPS",
    3.0,
    unit="quantisation steps",
    decides="outliers are judged where the Allan deviation of one sample has at least as many",
    without="the median of fewer levels says little",
    origin="chosen",
    benchmark="",
)
LEAST_EXCESS = RULES.add(
    "LEAST_EXCESS",
    0.05,
    unit="of the deviation",
    decides="a deviation that exceeds the robust one by more disagrees with it",
    without="long records report outliers that change nothing",
    origin="chosen",
    benchmark="",
)

# --- extreme values: the range of the sensor ------------------------------------------------------------------

LEAST_VISITS = RULES.add(
    "LEAST_VISITS",
    5,
    unit="visits",
    decides="with fewer, an extreme value is no limit of the range",
    without="values with fine steps meet once in a while by chance",
    origin="chosen",
    benchmark="",
)
ABOVE_NEXT = RULES.add(
    "ABOVE_NEXT",
    1.25,
    unit="of the samples beside",
    decides="an extreme value with more visits is a limit of the range, which gathers what lies beyond",
    without="the last level of a coarse sensor is called its range",
    origin="steps of a sixth of the deviation give 2.8 for a range of one deviation, 1.4 for one of three, "
    "where N is 0.3 % low",
    benchmark="",
)
NEXT_ERRORS = RULES.add(
    "NEXT_ERRORS",
    4.0,
    unit="standard errors",
    decides="chance may change a number of samples by this many of its errors",
    without="a level with few samples is called a limit of the range by chance",
    origin="chosen",
    benchmark="",
)
MOST_RISE = RULES.add(
    "MOST_RISE",
    1.1,
    unit="of the samples of the bin within",
    decides="with more samples in the outer bin, the density rises outwards: there is no limit of the range",
    without="the turning points of a sine, which have many samples, are called a range",
    origin="chosen",
    benchmark="",
)
LEAST_LEVELS = RULES.add(
    "LEAST_LEVELS",
    4,
    unit="quantisation steps",
    decides="with fewer from the least to the greatest value, nothing is said of a range",
    without="where levels are few, the outermost one may be the usual one",
    origin="chosen",
    benchmark="",
)
