"""imumon: live noise figures of an inertial sensor.

A VN-100 sends bytes. A codec finds samples. A monitor feeds running statistics and is asked for a report.
A bus carries it. A screen draws it. Three things cross boundaries: bytes, SampleBlock, Report.

  cli/           words on the command line
  daemon/        the loop: read, feed, ask, publish, save
  replay.py      the same loop over a file
  emulator/      a VN-100 on a pseudo-terminal
  tui/           the live screen
  datasheet/     a report in, documents out
  doctor/        one check a line, each with its cure
  sources/       where bytes come from: ports and recordings
  monitor/       samples in, report out
  bus/           reports on Zenoh, and back
  config.py      settings, with errors a user can act on
  checkpoint.py  the state on disk, atomically
  words.py       what caveats and grades mean, for people
  sensors/       bytes to samples and back, no I/O
  noise/         Allan variance, fit, grade, guards: pure mathematics
  timeline.py    the sensor's clock: which tick each sample is
  report.py      what is published; standard library only
  samples.py     what crosses from sensors to the monitor
  units.py       SI to the units people read
  heap.py        memory that was freed, given back
"""

__version__ = "0.1.0"
