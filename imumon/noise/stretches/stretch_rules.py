"""Rules of warm-ups and changes: what the parts of a record, and the days of a history, say of the sensor.

The thresholds of `warmup`, `change` and `day_change`. docs/THEORY.md prints this table.
"""

from __future__ import annotations

from imumon.noise.rule_table import RuleTable

RULES = RuleTable()

# --- warm-up: what the beginning of a record is excluded for -----------------------------------------------------

CANDIDATES_S = RULES.add(
    "CANDIDATES_S",
    (120.0, 300.0, 600.0, 1200.0, 2400.0, 3600.0, 5400.0),
    unit="s",
    decides="possible ends of a warm-up; beyond the last one, the temperature shows no warm-up",
    without="with fewer, more is excluded than settles; a finer grid excludes little less",
    origin="chosen",
    benchmark="real_effects.py --only warm-up",
)
DECISION_LENGTH = RULES.add(
    "DECISION_LENGTH",
    2.5,
    unit="of a candidate",
    decides="length of the record at which the candidate is decided",
    without="a shorter record does not show its exponential; in a longer one, the decision comes late",
    origin="chosen",
    benchmark="real_effects.py --only warm-up",
)
STILL = RULES.add(
    "STILL",
    0.22,
    unit="of the record",
    decides="time constant up to which a settling is over at the end of the record",
    without="what is excluded ends before the settling does, or a settling that is over is never excluded",
    origin="of a shorter one at most 1 % remains at the end, and a sixth at a candidate that is decided there",
    benchmark="real_effects.py --only warm-up",
)
WARMING_DEGC = RULES.add(
    "WARMING_DEGC",
    1.0,
    unit="degC",
    decides="a temperature that rises by less shows no warm-up",
    without="the noise of the thermometer is reported as a warm-up",
    origin="chosen",
    benchmark="",
)
HIGHEST_SHARE = RULES.add(
    "HIGHEST_SHARE",
    0.1,
    unit="of the rise",
    decides="a last mean of the temperature that is farther below the highest shows no warm-up",
    without="a cycle of the ambient temperature is reported as a warm-up",
    origin="chosen",
    benchmark="",
)

# --- changes: has the sensor become another one? -----------------------------------------------------------------

CHANGE_SIGMA = RULES.add(
    "CHANGE_SIGMA",
    5.0,
    unit="standard errors",
    decides="an hour differs from the hours before, or a record from a baseline, beyond chance",
    without="chance makes changes: there are 27 comparisons an hour, over years",
    origin="6e-7 by chance",
    benchmark="",
)
LEAST_CHANGE_N = RULES.add(
    "LEAST_CHANGE_N",
    0.05,
    unit="relative change",
    decides="a smaller change of N is none, however significant; also between days",
    without="a long record reports differences that no user acts on",
    origin="chosen",
    benchmark="",
)
LEAST_CHANGE_B = RULES.add(
    "LEAST_CHANGE_B",
    0.5,
    unit="relative change",
    decides="a smaller change of B is none, however significant; also between days",
    without="hours of a sensor whose flicker noise wanders are reported as changes",
    origin="B of the same sensor varies by as much",
    benchmark="",
)
DAYS_BEFORE = RULES.add(
    "DAYS_BEFORE",
    7,
    unit="days",
    decides="a day with fewer days before it is no step",
    without="the scatter of the days is not known, and any difference may be a step",
    origin="chosen",
    benchmark="history_study.py",
)
DAYS_KEPT = RULES.add(
    "DAYS_KEPT",
    90,
    unit="days",
    decides="days of the history that are compared",
    without="an old step is reported again every day, and hides a new one",
    origin="chosen",
    benchmark="history_study.py",
)
ALARM = RULES.add(
    "ALARM",
    1e-5,
    unit="probability",
    decides="a step between days is reported that chance makes less often, over all days of a series",
    without="a sensor with nine channels has 18 series, each of which is tested every day",
    origin="chosen; days that resemble each other more than neighbours show make steps likelier: of 30 days of a "
    "random walk, 2.6 % give one",
    benchmark="history_study.py",
)
LEAST_DAYS_SPAN_DEGC = RULES.add(
    "LEAST_DAYS_SPAN_DEGC",
    1.0,
    unit="degC",
    decides="the temperature is a regressor of the days where their standard deviation is above it",
    without="a temperature that hardly varies gets a large slope, which takes the step",
    origin="chosen",
    benchmark="history_study.py",
)
STRONGEST = RULES.add(
    "STRONGEST",
    0.9,
    unit="correlation",
    decides="greatest correlation of neighbouring days that the standard error of a step counts with",
    without="with a larger one, no step can be seen",
    origin="chosen: the standard error is then 4.4 times as large, sqrt((1 + r) / (1 - r))",
    benchmark="history_study.py",
)
LEAST_SCATTER = RULES.add(
    "LEAST_SCATTER",
    2e-3,
    unit="of the value",
    decides="scatter of the days that is assumed at least",
    without="days that agree by chance make any difference a step",
    origin="chosen: a shorter record than the variations of the sensor would show less",
    benchmark="history_study.py",
)
LEAST_DOF = RULES.add(
    "LEAST_DOF",
    8.0,
    unit="degrees of freedom",
    decides="degrees that Student's t has at least where days are strongly correlated",
    without="the quantile of few degrees is so large that no step can be seen",
    origin="chosen",
    benchmark="history_study.py",
)
