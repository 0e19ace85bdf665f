"""Modes of the frame from the earthquake, without a rig: beside its free vibration (3.77, 11.20, 16.67 Hz)."""

import numpy as np
import pytest

import dashpot
from tests.real.recordings import EXAMPLES, needs_recordings

FOLDER = EXAMPLES / "02_shake_table"


@pytest.mark.long
@needs_recordings
def test_the_frame_in_the_earthquake() -> None:
    rig = dashpot.read_rig(FOLDER / "rig.toml")
    found = dashpot.modes(str(FOLDER / "earthquake.toml"), rig=rig, band=(1, 20))
    for free in (3.77, 11.20, 16.67):  # the frame is softer the further it moves: up to 3 % in the earthquake
        assert np.min(np.abs(found.frequency_hz / free - 1)) < 0.03
    highest = found.shapes[int(np.argmin(np.abs(found.frequency_hz - 16.6)))].real
    assert np.sign(highest).tolist() in ([-1, 1, -1], [1, -1, 1])
    assert found.chi2 > 1.5 * found.dof  # it is not linear, and the fit says so
