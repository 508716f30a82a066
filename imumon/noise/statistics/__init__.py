"""Statistics of a signal beside its Allan deviation: moments, histogram, power spectrum, envelope.

Each is an accumulator of bounded size with `update` and `result`. They are independent of each other, except
that the power spectrum uses `spectral_lines` to find the lines in it.
"""
