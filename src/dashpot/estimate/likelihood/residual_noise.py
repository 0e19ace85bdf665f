"""The noise of data that do not tell it themselves, from what the model leaves over of them."""

from __future__ import annotations

from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.record_noise import with_record_noise
from dashpot.estimate.likelihood.table_noise import with_table_noise
from dashpot.estimate.method import Method
from dashpot.model.network import Model


def with_residual_noise(model: Model, spectrum: Spectrum, method: Method) -> tuple[Spectrum, Method]:
    """The spectrum with the noise of whole records, or of amplitudes given without any.

    The method begins at the fit whose residuals show it where that of records is.  Both are as they are where noise is
    known.  `identify` does it first; what judges a fit wants the same spectrum.
    """
    if spectrum.records:
        return with_record_noise(model, spectrum, method)
    return with_table_noise(model, spectrum, method), method
