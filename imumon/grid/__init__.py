"""Time base: which tick of the sample clock each sample belongs to.

Statistics over tau need samples at equal steps. Real streams lose samples, deliver them late, twice or in batches, and
stamp them with clocks of any quality. This package gives each sample its place on a grid of equal intervals.

interval         the interval of a grid, from the steps between stamps
sample_clock     steps of the grid, from the clock of a stream
stamp_kinds      what the stamps of a stream or of a recording are: the table of kinds, and the decision
stamp_placement  steps of the grid, from stamps that are late
counter_wraps    times of a counter, continued over its wraps
live_stamps      the same for rows that arrive one after the other


The model of stamps
-------------------
A sensor takes a sample at each tick of its clock. Tick k is at

    t(k) = t0 + k T                               T: the sampling interval, s

The samples that arrive are counted by i. Sample i belongs to tick k(i), its place on the grid. Its step is

    step(i) = k(i) - k(i - 1)

and all that the statistics need: 1 is the next sample, n > 1 is a gap in which n - 1 samples were lost. Its stamp is

    s(i) = q round((t(k(i)) + d(i)) / q) - w(i) P

d(i)   deviation. Of a sample clock it is jitter: far below T, and of either sign. Of a host it is a delay: positive,
       alike for rows that arrive together, and up to many T.
q      resolution to which a stamp is written, such as 1 ms of a counter; mostly far below T.
P      period after which a counter wraps, such as 2^32 us; w(i) counts the wraps so far.

Besides, each of these happens to real streams:

duplicate   a sample arrives twice: s(i) = s(i - 1), and the step is 0.
wrong       a stamp that passed its checksum, or was made before the clock was set, has nothing to do with t.
set         the clock of a host is set: t0 changes, and the steps are as before.
restart     the device begins to count again: t0 changes, and how many ticks passed is unknown (`BREAK`).
rate        the device is configured to another rate: T changes, and another grid begins.


Rules
-----
1. Time is that of the sample clock, never that of arrival, if the stream has one.
2. What stamps are is decided once, from the first rows (`stamp_kinds.decide`), and checked later.
3. The interval is the slope of a line through the stamps over the index of the samples (`interval`). With x, y the
   index and the stamps less their means, and n samples,

       T = sum(x y) / sum(x^2),    standard error^2 = sum((y - T x)^2) / (n - 2) / sum(x^2)

   (linear regression; Draper and Smith 1998, Applied Regression Analysis, chapter 1). The mean of single steps is
   biased: a step that jitter makes long looks like a lost sample and is left out.
4. Of a sample clock, step(i) = round((s(i) - s(i - 1)) / T - phase), where the phase is the mean deviation of the last
   `REFERENCE_SAMPLES` samples from the grid: one late stamp adds no sample (`sample_clock`).
5. Of a host, a late row is not lost if later rows catch up: the smallest delay within the next second decides
   (`stamp_placement`).
6. A gap that no clock measures has an unknown length. Nothing is guessed across it.


Example
-------
A sensor at 40 Hz loses sample 2, and the stamp of sample 4 is 6 ms late:

>>> import numpy as np
>>> from imumon.model.samples import SampleBlock, Stream
>>> from imumon.grid.sample_clock import SampleClock
>>> stream = Stream("unknown", ("gyro/x",), "example", "startup")
>>> stamps = 25_000_000 * np.array([0, 1, 3, 4, 5, 6]) + 1_000_000 * np.array([0, 0, 0, 6, 0, 0])
>>> block = SampleBlock(stream, np.zeros((6, 1)), stamps, np.zeros(6, np.int64))
>>> placed = SampleClock("startup", 0.025).place(block, final=True)
>>> placed[0].steps.tolist()
[1, 1, 2, 1, 1, 1]
"""
