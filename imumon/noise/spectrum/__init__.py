"""Welch sums of a stream: what the fit and the display take from its spectrum."""

from imumon.noise.spectrum.spectrum import PowerSpectrum, SpectrumAccumulator

__all__ = ["PowerSpectrum", "SpectrumAccumulator"]
