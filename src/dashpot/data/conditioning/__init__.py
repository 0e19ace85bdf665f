"""From records to amplitudes: settings, harmonic regression, noise, drive frequency, steady state."""
