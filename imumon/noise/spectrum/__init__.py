"""Welch sums of a stream: what the fit and the display take from its spectrum.

`spectrum_accumulator` states the model and does the work; `level_sums` is the layout of its levels and the sums of one,
`half_band` the filter between two. `expectation` is what N, B and K make of the sums, and `leakage` what
missing samples add to it. `power_spectrum` is the density
that people see, `spectral_lines` finds the lines in it.
"""

from imumon.noise.spectrum.power_spectrum import PowerSpectrum
from imumon.noise.spectrum.spectrum_accumulator import SpectrumAccumulator

__all__ = ["PowerSpectrum", "SpectrumAccumulator"]
