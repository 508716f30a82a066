"""What is in a signal beside its Allan deviation: moments, histogram, spectrum with lines, strip chart.

Each is an accumulator of bounded size: `update`, then `result`. None knows another, but for
the spectrum, which asks `lines` what stands out of it.
"""
