"""Measured data: records of samples, spectra of complex amplitudes, and the readers that make them."""
