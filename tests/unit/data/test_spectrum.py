"""What a Spectrum refuses: numbers that no measurement gives."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from tests.partly_seen import two


def measured() -> Spectrum:
    return two(full=True).spectrum(np.random.default_rng(1), draws=2)


@pytest.mark.parametrize("value", [np.inf, -np.inf, complex(0, np.inf)])
def test_infinite_amplitudes(value: complex) -> None:
    spectrum = measured()
    amplitudes = np.array(spectrum.amplitudes)
    amplitudes[1, 3, 1] = value
    with pytest.raises(DataError, match="an infinite amplitude of x2 at line 4"):
        replace(spectrum, amplitudes=amplitudes)
    amplitudes[:, 3, 1] = np.nan  # not measured
    assert replace(spectrum, amplitudes=amplitudes).lines == spectrum.lines


def test_negative_variances() -> None:
    spectrum = measured()
    covariance = np.array(spectrum.covariance)
    covariance[2, 0, 0] *= -1
    with pytest.raises(DataError, match="a negative variance of x1 at line 3"):
        replace(spectrum, covariance=covariance)
