"""Rules of the temperature: when it is a column of the fit, and which bias curve is stated.

The thresholds of the columns of temperature in `regressors` and `slow_terms`, and of `bias_curve`. docs/THEORY.md
prints this table after that of `fit_rules`.
"""

from __future__ import annotations

from imumon.noise.rule_table import RuleTable

RULES = RuleTable()

# --- columns: what the temperature explains --------------------------------------------------------------------

LEAST_SPAN_DEGC = RULES.add(
    "LEAST_SPAN_DEGC",
    0.3,
    unit="degC",
    decides="the temperature is a column from this range on",
    without="the noise of a thermometer with a step of 0.1 degC is a column that takes power from K",
    origin="chosen: three steps of a thermometer that reports tenths of a degree",
    benchmark="temperature.py",
)
TEMPERATURE_SNR = RULES.add(
    "TEMPERATURE_SNR",
    3.0,
    unit="ratio",
    decides="the temperature is a column where its bend, as means of four blocks, exceeds their noise by this factor",
    without="a column of noise has a slope biased towards zero, and what it leaves raises K",
    origin="at 3 the bias of the slope is 10 % (errors in variables)",
    benchmark="temperature.py",
)
THERMOMETER_SIGMA = RULES.add(
    "THERMOMETER_SIGMA",
    3.0,
    unit="standard deviations",
    decides="a band of the temperature counts where its power exceeds the noise of the thermometer by as much",
    without="the noise of the thermometer enters the model of the channel, times the slope",
    origin="chosen",
    benchmark="temperature.py",
)
COLLINEAR = RULES.add(
    "COLLINEAR",
    0.95,
    unit="correlation",
    decides="a temperature slope is stated where its estimate is less correlated with that of the drift",
    without="slope and drift are two large numbers of opposite sign that say nothing each",
    origin="0.95: the error of the slope is three times as large as without the drift",
    benchmark="temperature.py",
)
BEND_CHANCE = RULES.add(
    "BEND_CHANCE",
    0.05,
    unit="probability",
    decides="the effect of the temperature is bent where noise alone bends as much in this share of records",
    without="a bend that is missed raises K, a bend that is kept in doubt may hide it: the second is worse",
    origin="usual level of a test of which neither error is much worse than the other",
    benchmark="temperature.py",
)
BOTH_WAYS = RULES.add(
    "BOTH_WAYS",
    0.15,
    unit="of the span",
    decides="the temperature has turned when it has come back by this much; hysteresis needs this share of blocks and "
    "of span in each direction",
    without="noise of the thermometer counts as directions, and hysteresis is fitted where none can be seen",
    origin="chosen: above the noise of a thermometer, below the swing of a room",
    benchmark="temperature.py",
)

# --- bias curve: what is stated of the mean over the temperature -----------------------------------------------

SPAN_PER_DEGREE_DEGC = RULES.add(
    "SPAN_PER_DEGREE_DEGC",
    2.0,
    unit="degC",
    decides="span of temperatures that each degree above the first needs",
    without="a cubic through 1 degC is extrapolated to 40 degC by whoever compensates with it",
    origin="sensors bend little within 2 degC",
    benchmark="temperature.py",
)
LOWEST_DEGC = RULES.add(
    "LOWEST_DEGC",
    -60.0,
    unit="degC",
    decides="below, a temperature is implausible and no bias curve is stated",
    without="a wrong unit or a broken thermometer gives a curve",
    origin="sensors are rated from -55 degC on (Murata SCHA634)",
    benchmark="",
)
HIGHEST_DEGC = RULES.add(
    "HIGHEST_DEGC",
    110.0,
    unit="degC",
    decides="above, a temperature is implausible and no bias curve is stated",
    without="see LOWEST_DEGC: Fahrenheit, kelvin and counts pass",
    origin="sensors are rated to 110 degC at most (Murata SCHA634)",
    benchmark="",
)
JUMP_SHARE = RULES.add(
    "JUMP_SHARE",
    0.5,
    unit="of the span",
    decides="a temperature that changes more between two blocks, and by JUMP_DEGC, is an error of the thermometer",
    without="a plug that is pulled makes a line through two clouds of points",
    origin="chosen: no sensor warms by half of its span within a block",
    benchmark="",
)
JUMP_DEGC = RULES.add(
    "JUMP_DEGC",
    2.0,
    unit="degC",
    decides="least jump of a temperature that counts as one, see JUMP_SHARE",
    without="the steps of a coarse thermometer count as jumps",
    origin="chosen: twenty steps of a tenth of a degree",
    benchmark="",
)
POINTS = RULES.add(
    "POINTS",
    9,
    unit="temperatures",
    decides="points of the bias curve",
    without="a cubic is drawn with corners",
    origin="chosen for the figure and the size of the report",
    benchmark="",
)
