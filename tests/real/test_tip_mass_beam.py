"""The cantilever with two tip masses from its raw files: one stiffness and one gain from both sets."""

from pathlib import Path

import numpy as np
import pytest

from dashpot.data.readers import read
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.rigfile import read_rig
from tests.real.recordings import EXAMPLES, RAW, needs_recordings, tables

EXAMPLE = EXAMPLES / "03_tip_mass"
FILES = RAW / "tip_mass_beam"
HANDBOOK = 6610.0  # N/m, 3EI/L³


def estimate(rig_file: str) -> Estimate:
    rig = read_rig(EXAMPLE / rig_file)
    return identify(rig.model, read(str(EXAMPLE / "amplitudes.csv"), rig.channels).spectrum())


def test_one_stiffness_and_one_gain() -> None:
    found = estimate("rig.toml")
    assert found.method == "ml"
    assert bool(found.converged)
    assert found.names == ("k", "c", "F1.gain")
    assert found["k"].value == pytest.approx(HANDBOOK, rel=0.1)
    assert 1.5 < found["F1.gain"].value < 4
    # A sixth of the band by itself tells another gain: of a rig that does not fit the interval knows it.
    low, high = found["F1.gain"].interval95
    assert low < 1 < 4 < high
    # 16 lines of two channels, one input each: 32 real equations, three unknowns.
    assert found.fit.dof == 32 - 3
    assert bool(found.fit.rejected)
    assert found.basis == "model misfit"


def test_a_mass_that_was_not_weighed() -> None:
    plain, more = estimate("rig.toml"), estimate("rig_more_mass.toml")
    assert bool(more.converged)
    assert float(more.fit.misfit) < 0.3 * float(plain.fit.misfit)
    assert more["ms"].value > 0
    # Force over acceleration changes its sign between 11 and 12 Hz (heavy) and between 14 and 15 Hz (light).
    assert 11 < more.modes.frequency_hz[0] < 12
    assert 14 < more.modes.frequency_hz[1] < 15


@needs_recordings
def test_the_table_is_what_the_raw_files_give(tmp_path: Path) -> None:
    again, kept = tables(EXAMPLE, FILES, tmp_path)
    assert again.frequency_hz == pytest.approx(kept.frequency_hz, rel=1e-7)
    assert again.frequency_hz == pytest.approx(
        [3, 6, 9, 11, 12, 15, 18, 21, 3, 6, 9, 12, 14, 15, 18, 21], rel=2e-4
    )
    measured = np.isfinite(kept.amplitudes)
    assert np.array_equal(measured, np.isfinite(again.amplitudes))
    assert np.array_equal(measured[:, 0], kept.experiment == 0)
    away = np.abs(again.amplitudes - kept.amplitudes)[measured] / kept.sd()[measured]
    assert np.max(away) < 0.01
