"""Welch sums of a stream: what the fit and the display take from its spectrum."""

from imumon.noise.spectrum.power_spectrum import PowerSpectrum
from imumon.noise.spectrum.spectrum_accumulator import SpectrumAccumulator

__all__ = ["PowerSpectrum", "SpectrumAccumulator"]
