"""Rig files to start from: they read back, and the data they ask for identify them."""

import pytest

from dashpot.errors import ModelError
from dashpot.model.rigfile import parse_rig
from dashpot.model.rigfile.writer import Chain, starter_text


@pytest.mark.parametrize("masses", [1, 2, 5])
@pytest.mark.parametrize("drive", ["base", "force"])
def test_they_read_back(masses, drive):
    rig = parse_rig(starter_text(Chain('A "rig"', masses, drive, "velocity", "mm/s", known=1.5)), "rig.toml")
    assert rig.model.name == 'A "rig"'
    assert len(rig.model.coordinates) == masses
    assert len(rig.model.unknowns) == 3 * masses - 1
    assert len(rig.channels) == masses + 1
    assert rig.channels[0].scale == pytest.approx(1e-3)


def test_numbers_out_of_range():
    for chain in (Chain(masses=0), Chain(masses=51), Chain(known=-1.0)):
        with pytest.raises(ModelError):
            starter_text(chain)
