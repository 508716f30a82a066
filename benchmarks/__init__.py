"""Long studies: what the documents state as measured, and what a change of the mathematics must not move.

`python -m benchmarks` runs the first group in a quarter of an hour. The others take minutes to hours. A table of a
document is written by `document_tables`.

| script | what it measures | where it is stated |
|---|---|---|
| `accuracy` | errors and limits of N, B and K beside the bounds and other tools | docs/ACCURACY.md |
| `cascade` | what a sample and a day cost, growth with the length, exactness of the sums | docs/PERFORMANCE.md |
| `daemon_cost` | pipeline of a running daemon: share of a core, time of a fit, state | docs/dev/ACCURACY.md |
| `replay` | whole `imumon replay` beside other readers of the same files | docs/PERFORMANCE.md |
| `soak` | a daemon for minutes at 800 Hz, or for days in time-lapse: memory, counters | docs/SERVICE.md |
| **the estimator** | | |
| `real_effects` | limits of N, B and K on records with what real sensors add | docs/dev/ACCURACY.md |
| `markov` | what is stated of Gauss–Markov, popcorn and other noise | docs/dev/ACCURACY.md |
| `holes` | what holes in a record do to limits of N, B and K | docs/dev/ACCURACY.md |
| `sample_errors` | limits where samples or their stamps are wrong | docs/dev/ACCURACY.md |
| `wander` | combined limits of sensors whose N and B wander | docs/dev/ACCURACY.md |
| `record_length` | length of a record until N, B and K are precise enough | README.md |
| `filters` | Kalman filters with the exported numbers: NEES | docs/FILTERS.md |
| **history and real recordings** | | |
| `history_study` | false alarms and power of the comparison of days | docs/HISTORY.md |
| `recordings` | real recordings as tables and figures, and the agreement of their parts | docs/dev/ACCURACY.md |
| `example` | makes docs/example: the datasheet of a day | docs/example |
| **used by others** | | |
| `document_tables` | tables of the documents, from the results; figures of all benchmarks | |
| `comparison` | figures of two versions side by side, every night beside the last release | |
| `simulated` | records of known truth, and the Cramér–Rao bounds of N, B, K and M in them | |
"""
