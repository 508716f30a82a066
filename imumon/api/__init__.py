"""Analysis of samples for programs: what `imumon.analyse` and the commands `replay` and `report` call.

record_analysis  `analyse`: a file, arrays or a DataFrame to a measurement
sensor_arrays    arguments of a call as named arrays
measurement      the result, `load`
live             `Live`: the same for samples that come block by block
combination      `combine` and `compare`: several records
simulation       `simulate`: noise with known truth
curve_table      the Allan deviation of a channel as arrays or a DataFrame
document_report  a report with the days of the history in its limits, for a document
replay           a recording as samples of a record; its options are `replay_options`
replayed_record  the record of one recording, and its report
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imumon.api.combination import combine, compare
    from imumon.api.live import Live
    from imumon.api.measurement import Measurement, load
    from imumon.api.record_analysis import analyse
    from imumon.api.simulation import simulate
    from imumon.model.errors import ImumonError

OWNERS = {
    "ImumonError": "imumon.model.errors",
    "Live": "imumon.api.live",
    "Measurement": "imumon.api.measurement",
    "analyse": "imumon.api.record_analysis",
    "combine": "imumon.api.combination",
    "compare": "imumon.api.combination",
    "load": "imumon.api.measurement",
    "simulate": "imumon.api.simulation",
}
"""Module of each public name. It is imported at its first use: `import imumon` takes milliseconds."""

__all__ = ["ImumonError", "Live", "Measurement", "analyse", "combine", "compare", "load", "simulate"]


def __getattr__(name: str) -> Any:
    """Import the module of a public name."""
    if name not in OWNERS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(OWNERS[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
