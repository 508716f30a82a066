"""Parts of a record: what each of them says, by the same fit.

`parts` returns the sums between two places of a record. `sums` decides where the places are, and holds all that is
added up over one record. `warmup`, `quarters`, `stretches` and `change` are what it asks: has the sensor settled, how
much does a coefficient move, what did each hour show, did an hour differ from those before. `change` asks the
last of whole days of the history.

| word | here |
|---|---|
| place | samples of the grid before it |
| part | from one marked place to another, or to now |
| stretch | an hour or a day of the record, at a multiple of its length |
| quarter | a fourth of the record, from the end of its warm-up on |
"""

from imumon.noise.stretches.sums import Sums

__all__ = ["Sums"]
