"""Long studies: what the documents state as measured, and what a change of the mathematics must not move.

`python -m benchmarks` runs those of the first group in a quarter of an hour. The others take minutes to days. A
constant of `imumon/noise` names the one that shows its effect; a table of a document is written by `document_tables`.

| script | what it measures | where it is stated |
|---|---|---|
| `accuracy` | errors and limits of N, B and K beside the bounds and other tools | docs/ACCURACY.md |
| `cascade` | what a sample costs, and the exactness of the sums | docs/PERFORMANCE.md |
| `codec` | bytes of a VN-100 per second | docs/PERFORMANCE.md |
| `daemon_cost` | pipeline of a running daemon: share of a core, time of a fit, state | docs/ACCURACY.md |
| `memory` | a day of one channel beside allantools: time and memory | docs/PERFORMANCE.md |
| `record_length` | length of a record until N, B and K are precise enough | README.md |
| `remaining_time` | time that is promised until N, B and K are precise enough | `noise/fit/time_to_precision.py` |
| `replay` | whole `imumon replay` beside other readers of the same files | docs/PERFORMANCE.md |
| `resolution` | how far limits move with coarser or finer grids and steps of the fit | `noise/fit/likelihood.py` |
| `scaling` | cost and state against the length of a record | docs/PERFORMANCE.md |
| `soak` | a daemon for minutes at 800 Hz, or for days in time-lapse: memory, counters | docs/SERVICE.md |
| **the estimator** | | |
| `real_effects` | limits of N, B and K on records with what real sensors add | docs/ACCURACY.md |
| `holes` | what holes in a record do to limits of N, B and K | docs/ACCURACY.md |
| `stamps` | rate, losses and limits with host stamps that jitter | docs/ACCURACY.md |
| `sample_errors` | limits where samples are outliers, clipped, rounded, counts or a walk | docs/ACCURACY.md |
| `threshold` | limits of short records in which B or K just shows | docs/ACCURACY.md |
| `markov` | what is stated of Gauss–Markov, popcorn and other noise | docs/ACCURACY.md |
| `growing` | what is drawn of a record at each length of two days, with a temperature | docs/ACCURACY.md |
| `model_law` | octaves whose limits do not hold the drawn model | exit code |
| `temperature` | limits of the bias against the temperature | docs/ACCURACY.md |
| `wander` | combined limits of sensors whose N and B wander | docs/ACCURACY.md |
| `filters` | Kalman filters with the exported numbers: NEES | docs/FILTERS.md |
| `gtsam_filters` | the same in GTSAM | docs/FILTERS.md |
| `sensitivity` | which published number moves with which constant | docs/ACCURACY.md |
| **decisions and real recordings** | | |
| `guards` | what guards save, cost and find | docs/ACCURACY.md |
| `history_study` | false alarms and power of the comparison of days | docs/HISTORY.md |
| `python_cost` | processor time, memory and import of `imumon.analyse` | docs/PYTHON.md |
| `records` | coverage of the limits of a combination of records | docs/PYTHON.md |
| `recordings` | two recordings as tables and figures | docs/ACCURACY.md, docs/THEORY.md |
| `consistency` | agreement of the parts of real recordings | docs/ACCURACY.md |
| **the program** | | |
| `screen` | processor time and memory of the screen | docs/PERFORMANCE.md |
| `stall` | an hour at 800 Hz with a slow disk (`slow_disk.c`) and a stopped viewer: samples lost | docs/SERVICE.md |
| `doors` | connections that say nothing: samples lost, saves, answers, memory, end | SECURITY.md |
| `mutations` | damaged files of each kind that is read: what becomes of them | |
| `fleet` | 20 daemons with one router | docs/SERVICE.md |
| `ros2_hour` | a ROS 2 topic at 1 kHz for an hour | docs/ROS2.md |
| `example` | makes docs/example: the datasheet of a day | docs/example |
| **used by others** | | |
| `bounds` | Cramér–Rao bounds of N, B and K | |
| `document_tables` | tables of the documents, from the results | |
| `figures` | one table for the figures of all | |
| `lapse` | a daemon in time-lapse whose emulator can be asked | |
| `peers` | other tools that find N, B and K | |
| `sensor_effects` | the cells of `real_effects` and `model_law` | |
| `simulated` | records of known truth | |
"""
