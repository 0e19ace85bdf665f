"""Bands, steps and places where no test can dwell."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.design.allocation import Criterion, optimise
from dashpot.design.test_setup import ShakerLimits, band_grid, drive_patterns, nominal_setup
from dashpot.errors import UsageError
from tests.designs import paper_setup


def test_only_multiples_of_a_step() -> None:
    own = paper_setup()
    found = optimise(own, Criterion("A").terms(own), 1, band_grid(own, 0.25, 25, 0.25))
    assert np.allclose(found.frequency_hz / 0.25, np.round(found.frequency_hz / 0.25))
    assert found.gap < 1e-6


def test_bad_bands_and_names() -> None:
    own = paper_setup()
    with pytest.raises(UsageError, match="not a band"):
        band_grid(own, 5, 2)
    with pytest.raises(UsageError, match="no multiple"):
        band_grid(own, 5.1, 5.2, 1.0)
    with pytest.raises(UsageError, match="'k9' is not an unknown"):
        Criterion("A", ("k9",)).terms(own)
    with pytest.raises(UsageError, match="no input 'v'"):
        drive_patterns(own.model, ["u,v"])
    with pytest.raises(UsageError, match="stroke"):
        ShakerLimits(stroke=-1.0)


def test_undamped_resonances_are_no_place_to_dwell() -> None:
    """The response there is infinite: the search must not run into it."""
    from dashpot.model.elements import Kind, between, mass
    from dashpot.model.network import Input, Model

    elements = (mass("m", "x"), between("k", Kind.SPRING, "x", "u", value=400.0))
    model = Model(("x",), (Input("u"),), elements)
    own = nominal_setup(model, [Channel("x", {"x": 1.0}, noise=1e-3), Channel("u", {"u": 1.0})], {"m": 1.0})
    resonance = 20 / 2 / np.pi
    found = optimise(own, Criterion("A").terms(own), 100, band_grid(own, 1.0, 9.0))
    assert np.all(np.abs(found.frequency_hz / resonance - 1) > 0.0099)
