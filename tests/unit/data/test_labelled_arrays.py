"""Amplitudes as labelled arrays."""

import numpy as np
import pytest

from dashpot.data.spectrum import Spectrum
from tests.partly_seen import noisy_base


@pytest.fixture(scope="module")
def batch() -> Spectrum:
    return noisy_base().spectrum(np.random.default_rng(3), 2)


def test_amplitudes_are_found_by_name_and_line(batch: Spectrum) -> None:
    pytest.importorskip("xarray")
    data = batch.to_xarray()
    a, b = batch.index("a4"), batch.index("u")
    assert np.array_equal(data["amplitude"].sel(channel="a4"), batch.amplitudes[..., a])
    cross = data["covariance"].sel(channel="a4", other="u")
    assert np.array_equal(np.ravel(cross), np.ravel(batch.covariance[..., a, b]))
    assert np.array_equal(data["frequency_hz"], batch.frequency_hz)
    one = batch.derived(amplitudes=batch.amplitudes[1]).to_xarray()
    assert one["amplitude"].dims == ("line", "channel")
