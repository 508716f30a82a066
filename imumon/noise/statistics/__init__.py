"""Statistics of a signal beside its Allan deviation: moments, histogram, power spectrum, envelope.

Each is an accumulator of bounded size with `update` and `result`. They are independent of each other; only the
power spectrum uses `spectral_lines`.
"""
