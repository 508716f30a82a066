"""imumon: live noise figures of an inertial sensor.

A device delivers blocks of samples. The pipeline updates running statistics and makes reports. The bus publishes
them, and the terminal UI shows them. The types in `samples` and `report` cross package boundaries, nothing else.

  cli/           commands: parse arguments, print results, map errors to exit codes
  daemon/        the loop: read, feed, report, publish, save
  replay/        the same loop over a recording
  tui/           terminal UI
  datasheet/     report to documents, figures, tables and configuration snippets
  doctor/        checks of port, device, bus, state and service
  recordings/    files as sources of samples
  bus/           Zenoh session: publisher, subscriber, queryable
  devices/       device contract, registry and drivers
  pipeline/      samples in, report out
  config/        settings: file and command line, with all faults at once
  checkpoint.py  saved state, written atomically
  noise/         mathematics on arrays: Allan variance, fit, grading, detection
  messages.py    texts for caveats, grades and reasons
  timebase/      clock values and host stamps to a grid of samples
  report.py      published data model; standard library only
  samples.py     types that devices deliver
  units.py       SI units and readable units
  errors.py      base class of errors that a user may see
"""

__version__ = "0.1.0"
