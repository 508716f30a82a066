"""History: what a sensor did over months, in one SQLite file per device.

history      `History`: what a daemon keeps of its reports, and its answers
store        the SQLite file: periods, events, power-ups; its name and errors
schema       its tables, and how each version comes from the one before
selection    which rows are asked for
rows         published form of the rows: JSON, CSV
power_ups    when the sensor was switched on, and its bias each time
repeatability  scatter of N, B and K between days
day_changes  each day compared with the days before it
metrics      the newest reports as numbers for Prometheus

`History` is imported from its module: it tests for changes, which reading the file does not need.

docs/HISTORY.md describes rows, sizes and questions.
"""

from imumon.history.selection import Selection
from imumon.history.store import HistoryError, HistoryStore

__all__ = ["HistoryError", "HistoryStore", "Selection"]
