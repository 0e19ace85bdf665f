"""A Spectrum as labelled arrays of xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dashpot.io.optional import optional_library

if TYPE_CHECKING:
    from dashpot.data.spectrum import Spectrum


def labelled_spectrum(spectrum: Spectrum) -> Any:
    """An xarray Dataset: amplitude (…, line, channel), covariance (…, line, channel, other); … repeats.

    SI units.  Coordinates: frequency_hz, experiment, samples, dof and noise of each line, quantity of each channel.
    Repeats that have one covariance share it.  Raises UsageError without xarray.
    """
    xarray = optional_library("xarray", "analysis", "to_xarray")
    repeats = [f"repeat_{axis}" for axis in range(len(spectrum.batch))]
    shared = spectrum.covariance.shape[:-3] != spectrum.batch
    V = spectrum.covariance.reshape(spectrum.covariance.shape[-3:]) if shared else spectrum.covariance
    names = [channel.name for channel in spectrum.channels]
    return xarray.Dataset(
        {
            "amplitude": ([*repeats, "line", "channel"], spectrum.amplitudes),
            "covariance": ([*([] if shared else repeats), "line", "channel", "other"], V),
        },
        coords={
            "channel": names,
            "other": names,
            "quantity": ("channel", [channel.quantity.value for channel in spectrum.channels]),
            "frequency_hz": ("line", spectrum.frequency_hz),
            "experiment": ("line", spectrum.experiment),
            "samples": ("line", spectrum.samples),
            "dof": ("line", spectrum.dof),
            "noise": ("line", list(spectrum.noise)),
        },
    )
