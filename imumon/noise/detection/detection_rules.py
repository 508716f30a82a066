"""Rules of the detection: every threshold between a sample and the decision to exclude it.

A row says what its number decides, what goes wrong without it, and where the number comes from; see
`imumon.noise.rule_table`. No other module of this package has a threshold.

The unit of time is the *frame* of ten *parts*, about 1 s and 0.1 s. "Sigma" is a standard deviation of the usual
noise. `python benchmarks/sensitivity.py noise.detection` halves and doubles each number.
"""

from __future__ import annotations

from scipy.special import ndtr

from imumon.noise.rule_table import RuleTable
from imumon.noise.validity_groups import LEAST_SHARE, ROUNDING

RULES = RuleTable()

# ---------------------------------------------------------------------- time: frames and memories

PARTS = RULES.add(
    "PARTS",
    10,
    unit="parts of a frame",
    decides="a part, about 0.1 s, is the shortest time that is excluded with margins; ten of them are a frame",
    without="one knock of 20 ms costs a whole second, or every sample needs a threshold of its own",
    origin="a knock on a table rings for about 0.1 s; ten means give their deviation to 24 %",
    benchmark="sensitivity.py",
)
INDEPENDENT_SAMPLES = RULES.add(
    "INDEPENDENT_SAMPLES",
    100,
    unit="samples of a frame",
    decides="how many samples of a frame count as independent, at most, in the noise that its mean must have",
    without="behind the filter of a sensor, neighbouring samples are alike: rest at 400 Hz counts as motion",
    origin="a filter that ends at 50 Hz leaves 2 · 50 Hz · 1 s of them (Nyquist)",
    benchmark="test_guard_motion.py",
)
KNOWN_SHARE = RULES.add(
    "KNOWN_SHARE",
    LEAST_SHARE,
    unit="of the samples of a frame",
    decides="a frame with fewer usable samples is unknown: it is not learned from, and excluded only if everything is",
    without="the mean of a few samples scatters more, is called unusual, and losses become motion",
    origin="the share from which a block of the Allan variance counts, too (`validity_groups`)",
    benchmark="test_guard_motion.py",
)
FIRST_FRAMES = RULES.add(
    "FIRST_FRAMES",
    4,
    unit="frames",
    decides="the first frames of a record are assessed together, and rest is not doubted before",
    without="a record that begins with a knock takes the knock for its usual noise",
    origin="one of four may be disturbed, and the median of the others still shows the noise",
    benchmark="test_guard.py",
)
LEVEL_FRAMES = RULES.add(
    "LEVEL_FRAMES",
    8,
    unit="frames",
    decides="the level of a channel is the median of the means of the last quiet frames",
    without="a longer memory calls the random walk of a bias a knock; a shorter one follows a single bad frame",
    origin="a median of eight is moved by no three of them, and a random walk goes sqrt(8) steps in that time",
    benchmark="guards.py",
)
MEMORY_FRAMES = RULES.add(
    "MEMORY_FRAMES",
    128,
    unit="frames",
    decides="usual noise is that of the last 128 quiet frames; counts of repeats halve every 128, of outliers at 128",
    without="no noise that changes would become usual, or the usual noise itself would be uncertain",
    origin="two minutes: the median of 128 deviations is right to 10 %, and half of them may be disturbed",
    benchmark="sensitivity.py",
)

# ---------------------------------------------------------------------- usual noise (baseline.py)

UNUSUAL_SIGMA = RULES.add(
    "UNUSUAL_SIGMA",
    7.0,
    unit="sigma",
    decides="a sample, a mean or the logarithm of a deviation farther off is not usual; it also sets UNUSUAL_CHANCE",
    without="at 5 sigma, noise is excluded every hour; at 10, a knock of the size of the noise stays",
    origin="chosen between the two; Gaussian noise exceeds it with 3e-12: less than one sample in a month at 800 Hz",
    benchmark="guards.py",
)
LEAST_UNUSUAL_RATIO = RULES.add(
    "LEAST_UNUSUAL_RATIO",
    1.5,
    unit="times the usual deviation",
    decides="a frame is not unusual by its deviation before it exceeds this",
    without="at high rates, deviations scatter by 1 %, and every harmless change of the noise is excluded",
    origin="1.5 times for one second adds 7e-6 to N of a day: less matters little",
    benchmark="guards.py",
)
ERROR_MARGIN = RULES.add(
    "ERROR_MARGIN",
    3.0,
    unit="standard errors",
    decides="how much wider a threshold is while its scale, or a count, is uncertain itself",
    without="thresholds from the first frames are too narrow by chance, and exclude noise",
    origin="Gaussian: one of 700 scales is farther off",
    benchmark="test_guard_motion.py",
)
MAD_ERROR = RULES.add(
    "MAD_ERROR",
    1.2,
    unit="relative standard error times sqrt(n)",
    decides="how uncertain a deviation is that rests on n median absolute distances",
    without="see ERROR_MARGIN",
    origin="1 / sqrt(2 · 0.37): the efficiency is 37 % (Rousseeuw and Croux, J. Am. Stat. Assoc. 88, 1993)",
    benchmark="test_guard_motion.py",
)
MOST_SCATTER = RULES.add(
    "MOST_SCATTER",
    3.0,
    unit="times the scatter of white noise",
    decides="the logarithms of deviations scatter from frame to frame; more than this does not widen their thresholds",
    without="knock after knock widens the thresholds until knocks are usual",
    origin="chosen: flicker noise and drift scatter less, and half of the frames disturbed scatter more",
    benchmark="test_guard_reasons.py",
)
COARSE_STEPS = RULES.add(
    "COARSE_STEPS",
    3.0,
    unit="quantisation steps",
    decides="a channel that is mostly constant may be off by this; its sigma is less than a third of a step",
    without="every step of a coarse channel is more than 7 sigma and is excluded as a knock",
    origin="chosen: one step of noise to each side, and one of drift",
    benchmark="test_guard.py",
)
ROUNDING_SHARE = RULES.add(
    "ROUNDING_SHARE",
    ROUNDING,
    unit="of the level",
    decides="distances below are rounding",
    without="a constant axis, whose sigma is 0, is disturbed by the last bit of its mean",
    origin="a thousand times the precision of a double (`validity_groups`)",
    benchmark="test_guard.py",
)
LOCATED_SHARE = RULES.add(
    "LOCATED_SHARE",
    0.5,
    unit="of the parts of a frame",
    decides="up to this, single parts are excluded instead of the whole unusual frame",
    without="a knock of 0.1 s costs a second; if most parts are off, the rest is too short to be called quiet",
    origin="chosen: the other half still has five means",
    benchmark="sensitivity.py",
)
REFERENCE_SHARE = RULES.add(
    "REFERENCE_SHARE",
    0.5,
    unit="of the samples of a frame",
    decides="a frame with fewer valid samples is no reference for the size of the next disturbance",
    without="the few samples between two knocks would measure the second one",
    origin="chosen: half a frame gives level and deviation to 10 % at 100 Hz",
    benchmark="test_guard.py",
)
MARGIN_BEFORE = RULES.add(
    "MARGIN_BEFORE",
    PARTS // 2,
    unit="parts of 0.1 s",
    decides="so much is excluded before the first part that is unusual",
    without="the onset stays: a hand that comes near begins below the threshold",
    origin="chosen: half a frame. The guard holds one frame back, so more than a whole one is impossible",
    benchmark="guards.py",
)
MARGIN_AFTER = RULES.add(
    "MARGIN_AFTER",
    PARTS,
    unit="parts of 0.1 s",
    decides="so much is excluded after the last part that is unusual",
    without="the end stays: a table rings down below the threshold, and the filter of the sensor settles",
    origin="chosen: a frame, ten times as long as a table rings (PARTS)",
    benchmark="guards.py",
)

# ---------------------------------------------------------------------- rest and motion (baseline.py, disturbance.py)

READY_FRAMES = RULES.add(
    "READY_FRAMES",
    2,
    unit="quiet frames",
    decides="with fewer, the usual noise is unknown, and nothing is unusual",
    without="the second frame of a record is compared with a single one",
    origin="a scatter needs two",
    benchmark="test_guard.py",
)
REST_FRAMES = RULES.add(
    "REST_FRAMES",
    16,
    unit="frames",
    decides="rest is judged by the last ones; as many at a new level or with a new noise are tried as the baseline",
    without="a tilted table or a started engine stays excluded for all time",
    origin="scales from sixteen frames are right to 20 %",
    benchmark="test_guard.py",
)
REST_FACTOR = RULES.add(
    "REST_FACTOR",
    2.2,
    unit="times the deviation that white noise predicts",
    decides="up to this Allan deviation of the frames, noise of any size is rest",
    without="the noise of a cheap sensor, 1 to 5 deg/s, is motion",
    origin="2.5 for three axes and sixteen frames, wider by n^-1/2 for n differences; a recorded hand exceeds 2.9",
    benchmark="guards.py",
)
REST_LIMIT_GYRO = RULES.add(
    "REST_LIMIT_GYRO",
    1.5e-3,
    unit="rad/s, Allan deviation at 1 s",
    decides="up to this, a gyroscope is at rest, whatever its spectrum",
    without="flicker noise above the white noise, or a running engine, is motion",
    origin="two to three times the consumer grade; a parked car with its engine running stays below, a drive does not",
    benchmark="guards.py",
)
REST_LIMIT_ACCEL = RULES.add(
    "REST_LIMIT_ACCEL",
    3e-2,
    unit="m/s^2, Allan deviation at 1 s",
    decides="the same for an accelerometer",
    without="see REST_LIMIT_GYRO",
    origin="see REST_LIMIT_GYRO",
    benchmark="guards.py",
)
SHAKEN_FACTOR = RULES.add(
    "SHAKEN_FACTOR",
    20.0,
    unit="times REST_LIMIT_GYRO and REST_LIMIT_ACCEL",
    decides="above this Allan deviation at 1 s, a sensor is shaken, whatever its spectrum",
    without="a shaker or a drone, whose motion is white, is rest",
    origin="chosen: 0.03 rad/s, 100 deg/sqrt(h), is more than the noise of any sensor",
    benchmark="test_guard_reasons.py",
)
TURN_RATE = RULES.add(
    "TURN_RATE",
    0.1,
    unit="rad/s, length of the level of a gyroscope",
    decides="above, it is turned",
    without="a steady turn is rest: noise does not distinguish it from a bias",
    origin="more than the bias of a sensor: 5.7 deg/s",
    benchmark="test_guard.py",
)
WINDOW_FRAMES = RULES.add(
    "WINDOW_FRAMES",
    10,
    unit="frames, about s",
    decides="motion is recognised by the unusual ones among the last ten; a gap empties this window",
    without="two knocks of an hour would count together, or every pause would end motion",
    origin="chosen: longer than a knock with its echo",
    benchmark="sensitivity.py",
)
MOTION_FRAMES = RULES.add(
    "MOTION_FRAMES",
    8,
    unit="unusual frames of WINDOW_FRAMES",
    decides="from here on everything is excluded, also the frames between that look quiet",
    without="a moving sensor that is quiet for a moment counts for that moment",
    origin="chosen: a knock and its echo take fewer, and two quiet moments in ten seconds do not end motion",
    benchmark="sensitivity.py",
)
SEVERAL_AXES = RULES.add(
    "SEVERAL_AXES",
    2,
    unit="axes",
    decides="this many unusual axes of a frame can be motion; fewer only if a mean has changed",
    without="an axis whose noise grows is called motion, and the sensor loses its grade",
    origin="a body that moves turns and accelerates more than one axis",
    benchmark="test_outliers.py",
)
RETURN_FRAMES = RULES.add(
    "RETURN_FRAMES",
    WINDOW_FRAMES // 2,
    unit="frames, about s",
    decides="a disturbance or motion ends when these, in a row, show nothing unusual; unknown ones count",
    without="a car at a crossing is at rest for two seconds",
    origin="chosen: half of the window",
    benchmark="sensitivity.py",
)
PAUSE_FRAMES = RULES.add(
    "PAUSE_FRAMES",
    2,
    unit="frames, about s",
    decides="after this many in a row that the old baseline calls usual, the search for a new rest starts again",
    without="two long bursts of noise and the pause between them become the baseline, and the next burst is usual",
    origin="a noise that is usual to the old baseline in one of five frames has two in a row once in half a minute",
    benchmark="sample_errors.py",
)
MOST_UNUSUAL_CANDIDATES = RULES.add(
    "MOST_UNUSUAL_CANDIDATES",
    WINDOW_FRAMES - MOTION_FRAMES,
    unit="frames of REST_FRAMES",
    decides="a new baseline may call this many of the frames that it is made of unusual",
    without="an engine that runs with a few knocks is never rest, or a restless hand is",
    origin="motion leaves as many usual frames in its window",
    benchmark="guards.py",
)

# ---------------------------------------------------------------------- outliers (outliers.py)

OUTLIER_NOISE_SHARE = RULES.add(
    "OUTLIER_NOISE_SHARE",
    0.01,
    unit="of the samples of a channel",
    decides="above, its outliers are its noise and stay in the statistics",
    without="N of a sensor with heavy tails is that of its best samples, several times too small",
    origin="chosen: an error of the transmission is rarer; 1 % of ten sigma doubles N^2",
    benchmark="test_outliers.py",
)
NOISY_CHANCE = RULES.add(
    "NOISY_CHANCE",
    3e-4,
    unit="probability",
    decides="a far sample is a knock, and no outlier, if chance makes as much noise beside it in this share of frames",
    without="of a burst only the tallest samples are excluded: N is 0.3 % too high with one of five sigma a minute",
    origin="a quarter of what stays of bursts of 0.1 to 1 s without it stays; with 1e-3 a twentieth, but one single "
    "outlier of a hundred of a coarse axis is a knock",
    benchmark="sample_errors.py",
)
TAIL_BEGIN = RULES.add(
    "TAIL_BEGIN",
    6.0 / UNUSUAL_SIGMA,
    unit="of the limit of an outlier",
    decides="a frame whose largest sample is between here and the limit counts as one with a tail",
    without="nearer to the noise, Gaussian samples count: 6e-7 of them exceed 5 standard deviations",
    origin="6 standard deviations: in a day at 800 Hz, Gaussian noise has 0.1 such samples",
    benchmark="sample_errors.py",
)
TAIL_SHARE = RULES.add(
    "TAIL_SHARE",
    0.3,
    unit="of the frames with an outlier",
    decides="from here on, frames with a tail show that the outliers of the channel are its noise, and they stay",
    without="N of noise with the tails of Student's t(3) is 11 % low, and no limit holds",
    origin="t(3) has 0.6, t(4) 0.9; half a per cent of ten deviations has 0.13, bit errors of any size 0",
    benchmark="sample_errors.py",
)
LEAST_TAIL_FRAMES = RULES.add(
    "LEAST_TAIL_FRAMES",
    10,
    unit="frames",
    decides="frames with a tail, and frames with an outlier, that a channel with heavy tails has at least",
    without="bit errors of nine deviations, of which a tenth falls short of the limit, count as noise by chance",
    origin="with a share of a tenth, 33 outliers have ten such frames in 0.2 % of records",
    benchmark="sample_errors.py",
)
TAIL_REACH = RULES.add(
    "TAIL_REACH",
    5.0,
    unit="limits of an outlier",
    decides="farther samples are excluded also where the tails are heavy",
    without="one bit error of 1 rad/s triples N of a sensor with heavy tails",
    origin="35 standard deviations: beyond, t(4) has 0.3 % of its variance; t(3), whose N no record shows, has 12 %",
    benchmark="sample_errors.py",
)
KNOCK_RUN = RULES.add(
    "KNOCK_RUN",
    3,
    unit="samples",
    decides="this many outliers in a row, or nearly, are a knock where outliers are rare",
    without="a knock is excluded sample by sample, without margins and on one sensor",
    origin="a bit error changes no three samples in a row",
    benchmark="test_guard.py",
)
COINCIDENCE_SAMPLES = RULES.add(
    "COINCIDENCE_SAMPLES",
    3,
    unit="samples",
    decides="outliers of gyroscope and accelerometer within this are a knock, unless both have many",
    without="a short knock of both sensors is two outliers, and its ringing stays",
    origin="one sample to each side: the filters of the two sensors delay by different times",
    benchmark="test_outliers.py",
)
COINCIDENCE_FACTOR = RULES.add(
    "COINCIDENCE_FACTOR",
    9.0,
    unit="times the share of outliers of each sensor",
    decides="from which shares on a coincidence is chance: 0.12 % in both sensors, if in the same sample",
    without="where both sensors have outliers as noise, their chance coincidences are knocks",
    origin="COINCIDENCE_SAMPLES squared, on each share: 81 in the product of two (`OutlierDetector._coincide`)",
    benchmark="test_outliers.py",
)
OUTLIER_EVENT_FRAMES = RULES.add(
    "OUTLIER_EVENT_FRAMES",
    60,
    unit="frames",
    decides="outliers of a sensor within this time are one disturbance",
    without="a noisy cable floods the events",
    origin="chosen: a minute",
    benchmark="test_outliers.py",
)

# ---------------------------------------------------------------------- repeats (stuck.py)

UNUSUAL_CHANCE = RULES.add(
    "UNUSUAL_CHANCE",
    float(ndtr(-UNUSUAL_SIGMA)),
    unit="probability",
    decides="repeats, or outliers in a row or of two sensors at once, that are less probable are not chance",
    without="a magnetometer that is read three times for each value is stuck, and rare outliers by chance are a knock",
    origin="ndtr(-UNUSUAL_SIGMA), 1.3e-12: that of an unusual sample, to one side. `fit_rules.CHANCE` is another rule",
    benchmark="test_guard.py",
)
STUCK_SAMPLES = RULES.add(
    "STUCK_SAMPLES",
    5,
    unit="repeats in a row",
    decides="fewer are not stuck, however rare repeats are",
    without="a sample that a driver sends twice is a fault of the sensor",
    origin="chosen: drivers repeat one or two samples while they wait",
    benchmark="sensitivity.py",
)
STUCK_AXIS_FRAMES = RULES.add(
    "STUCK_AXIS_FRAMES",
    2,
    unit="frames",
    decides="an axis that keeps its value so long, while other axes change, is stuck",
    without="a smooth signal keeps its rounded value where it turns, and is stuck",
    origin="chosen: shorter than any use of a stuck axis, longer than such a turn",
    benchmark="sensitivity.py",
)
NEVER_STUCK_SHARE = RULES.add(
    "NEVER_STUCK_SHARE",
    1.0 / 3.0,
    unit="of the samples",
    decides="an axis that usually repeats as often, or more, is never stuck",
    without="a coarse axis is stuck whenever its level lies in the middle of a step",
    origin="noise of 0.85 steps repeats so often; below, the share depends on the level",
    benchmark="test_guard.py",
)
HELD_AXIS_SHARE = RULES.add(
    "HELD_AXIS_SHARE",
    7.0 / 8.0,
    unit="of the samples",
    decides="an axis that usually repeats as often while others change, in steps of any size, decides no disturbance",
    without="one axis that is updated once a second makes a knock or motion of all axes of both sensors",
    origin="values of eight samples; noise of a third of a step, the least that is not coarse, repeats at most 78 %",
    benchmark="test_guard_silent.py",
)
ONE_AXIS_SHARE = RULES.add(
    "ONE_AXIS_SHARE",
    0.5,
    unit="of the repeats of the axis with most",
    decides="if the median axis repeats less, that axis alone is stuck, and the event names it",
    without="each stuck output is one of the whole sensor",
    origin="chosen: half, because an axis that hangs repeats always, the others by chance",
    benchmark="test_guard.py",
)
