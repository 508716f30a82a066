"""imumon: live noise characterization of an inertial sensor.

A source delivers blocks of samples. A record feeds its statistics with them and returns a report. The bus carries the
report to the screen and to other tools. SampleBlock and Report are the types that cross package boundaries.

  cli/           commands: arguments, output, exit codes
  daemon/        the loop: read, feed, report, publish, save
  tui/           terminal UI, also in a browser
  doctor/        checks of port, device, Zenoh, state and service
  api/           `imumon.analyse`, its result, and the loop over a recording
  documents/     report to datasheet, figures and settings of other software; published limits of sensors
  history/       reports over months: store, query, change over days; metrics
  bus/           Zenoh: publisher, subscriber, queries
  sources/       where samples come from: devices, their contract and registry, and files
  record/        one record: sample blocks to report
  checkpoint.py  the saved state on disk
  config/        settings, with an error per fault
  grid/          each sample's place in time: sample clock, host stamps
  noise/         Allan variance, fit, detection, statistics: mathematics on arrays
  ros2/          ROS 2 without ROS: messages, keys, nodes over Zenoh and DDS
  files.py       files that other users may have prepared
  model/         words that all packages share: samples, report, coefficients, units, errors, texts
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.3.0"

if TYPE_CHECKING:
    from imumon.api import ImumonError, Live, Measurement, analyse, combine, compare, load, simulate

__all__ = ["ImumonError", "Live", "Measurement", "analyse", "combine", "compare", "load", "simulate"]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use: numpy and scipy take longer than most commands."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from imumon import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
