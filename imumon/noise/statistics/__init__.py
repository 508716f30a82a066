"""Statistics of a signal beside its Allan deviation: moments, histogram, power spectrum, envelope.

Each is an accumulator of bounded size with `update` and `result`, independent of the others:

| module | question | model |
|---|---|---|
| `moments` | mean, spread, shape, correlation | central moments that join exactly (Chan, Golub & LeVeque 1979) |
| `histogram` | how are the values distributed? | counts on a lattice that coarsens with the range |
| `distribution_shape` | is that Gaussian, or quantised? | effect sizes beyond their sampling errors |
| `differences` | do a few samples dominate N? | median against mean square of neighbouring differences |
| `extreme_values` | is it clipped? | visits of the least and the greatest value |
| `envelope` | what does the signal look like? | minimum and maximum in columns of time |

Three of them know an excess kurtosis, and they differ: that of `moments` is of all samples, drift included; that of
`distribution_shape` is of the binned values, corrected for the width of a bin; `differences.fast_kurtosis` is about
slow changes, and widens the limits of N.

>>> import numpy as np
>>> from imumon.noise.statistics.moments import Moments
>>> moments = Moments(1)
>>> moments.update(np.array([[1.0], [2.0], [6.0], [7.0]]))
>>> moments.result().channels[0].mean
4.0
"""
