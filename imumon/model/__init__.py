"""Words that all packages share: samples, report, coefficients, units, errors, and the texts of caveats.

One word, one meaning. Where two things need a word, each has its own.

block        samples that arrive together (`SampleBlock`); in `noise/blocks`, a block mean is that of a fixed number;
             not: a datasheet has elements
record       all samples of one stream since its first one, with what follows from them (`record/record.py`); not: a
             recording is a file
history      what a sensor did over months, in its SQLite file; not: samples before the newest one
signal       minimum and maximum of a channel per column of time (`report.Signal`); not: a signal of the operating
             system has its name: SIGTERM
state        of a device (`report.State`: starting, running, ...), or what is saved of a record
status       of a coefficient: measured, upper bound, indistinct, pending; others have a noun before it
             (`CheckStatus`, `ConnectionStatus`)
step         from one sample to the next, in ticks of the grid; of the history: an hour or a day
stretch      an hour or a day of a record: a part with finer blocks, which is fitted alone (`noise/stretches`)
period       a stretch as a row of the history (`HistoryPeriod`); `period_s` is the time between two reports
hour         a stretch of an hour that is compared with all before it
quarter      a fourth of a record, for the scatter of a coefficient
window       what slides or is open: the last minute of `LossWindow`, the samples that a filter averages
segment      of a Welch spectrum; of block means, those between two breaks
section      of the samples of the Allan cascade, those between two breaks
place        number of a sample on the grid, lost samples included; `steps` are the differences of places
frame        about 1 s of samples that the guard assesses together; a part of it is a tenth
part         of a frame; of a recording, one of its files; of a record, from one marked place to another or to now;
             not: a spectrum has levels
term         a random process of the noise model: N, B, K or Q, an object of `noise/fit/model.py`; its power is the
             square of its coefficient
regressor    what moves the mean and is not random: drift, temperature, settling, step, oscillation; a column of the
             model
observation  a number that the likelihood compares with the model: a band of the spectrum or a single cosine
             coefficient
event        what happened once; an alarm is a number that is above its limit, a caveat what limits the meaning of
             numbers
"""
