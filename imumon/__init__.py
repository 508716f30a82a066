"""imumon: live noise characterization of an inertial sensor.

A device delivers sample blocks. The pipeline feeds running statistics and returns a report. The bus carries the
report to the screen and to other tools. SampleBlock and Report are the types that cross package boundaries.

  cli/           commands: arguments, output, exit codes
  api/           `imumon.analyse` and its result: what commands and other programs call
  daemon/        the loop: read, feed, report, publish, save
  replay/        the same loop over a recording
  tui/           terminal UI
  datasheet/     report to documents, figures and settings of other software
  doctor/        checks of port, device, Zenoh, state and service
  history/       reports over months: store, query, change over days; metrics
  recordings/    files as sources: raw captures, CSV, NumPy, ROS bags, PX4, ArduPilot
  ros2/          ROS 2 without ROS: messages, keys, nodes over Zenoh and DDS
  bus/           Zenoh: publisher, subscriber, queries
  devices/       the device contract, its registry, and the devices
  pipeline/      sample blocks to report
  references/    published limits of sensors, and checks against them
  config/        settings, with an error per fault
  checkpoint.py  the saved state on disk
  noise/         Allan variance, fit, detection, statistics: mathematics on arrays
  glossary.py    each word of screen and documents, explained
  messages.py    caveats, grades and reasons in words
  timebase/      sample clock: which tick each sample belongs to
  text_fields.py  numbers with names in lines of text
  filter_report.py  parameters for Kalman filters, as a message
  history_report.py  one period of the history, as a message
  column_names.py  quantity, axis and unit in the name of a column
  rest_sizes.py  what the numbers of a sensor at rest say about their unit
  cures.py       options in advice, as the caller types them
  readiness.py   which numbers of a report are precise enough
  report.py      published data model; standard library only
  saved_state.py  objects as bytes, and back
  report_json.py  JSON of its messages, with bounds for what comes from outside
  coefficients.py  table of N, B, K, Q and R, and the estimate of one
  samples.py     what devices and recordings deliver
  units.py       factors of units, and numbers as text
  ledger.py      what became of everything that was received
  errors.py      errors with code, message and cure
  system_errors.py  errors of the operating system, and what to do about them
  files.py       files that other users may have prepared
  clock.py       time of the host, and what a second of the record takes of it
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from imumon.api import Live, Measurement, analyse, combine, compare, load, simulate

__all__ = ["Live", "Measurement", "analyse", "combine", "compare", "load", "simulate"]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use: numpy and scipy take longer than most commands."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from imumon import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
