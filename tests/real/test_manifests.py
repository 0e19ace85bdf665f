"""The raw recordings of all four sets, each read by the manifest of its example and identified with its rig."""

import numpy as np
import pytest

from dashpot.data.readers import read
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.model.rigfile import read_rig
from tests.real.recordings import EXAMPLES, needs_recordings

pytestmark = needs_recordings
QUICK = MaximumLikelihood(starts=4, candidates=100, rounds=1)


def test_the_beam() -> None:
    folder = EXAMPLES / "03_tip_mass"
    rig = read_rig(folder / "rig.toml")
    lines = read(folder / "test.toml", rig.channels).spectrum()
    table = read(folder / "amplitudes.csv", rig.channels).spectrum()
    assert lines.frequency_hz == pytest.approx(table.frequency_hz, rel=1e-7)
    assert np.nanmax(np.abs(lines.amplitudes - table.amplitudes) / table.sd()) < 0.01
    found = identify(rig.model, lines, QUICK)
    assert found["k"].value == pytest.approx(6610, rel=0.1)


def test_the_motor_bench() -> None:
    folder = EXAMPLES / "04_motor_bench"
    rig = read_rig(folder / "rig.toml")
    lines = read(folder / "test.toml", rig.channels).spectrum()
    table = read(folder / "amplitudes.csv", rig.channels).spectrum()
    assert list(lines.frequency_hz) == list(range(11, 251))
    assert np.max(np.abs(lines.amplitudes - table.amplitudes) / table.sd()) < 1e-3
    found = identify(rig.model, lines, QUICK)
    assert found["J2"].value / found["J1"].value == pytest.approx(1, abs=0.01)


def test_the_shaken_frame() -> None:
    folder = EXAMPLES / "02_shake_table"
    rig = read_rig(folder / "rig_bending.toml")
    lines = read(folder / "test.toml", rig.channels).spectrum()
    found = identify(rig.model, lines, QUICK)
    late = found["x3.delay"]
    assert late.value == pytest.approx(1.77e-3, abs=3 * late.sd)
    swinging = found.modes.frequency_hz[found.modes.frequency_hz > 1]
    assert swinging == pytest.approx([3.767, 11.20, 16.67], rel=0.02)


def test_the_silverbox() -> None:
    # Figures of an independent fit of the best linear approximation: m 5.371e-6, d 2.292e-4, k 1.025, f0 69.5 Hz.
    folder = EXAMPLES / "11_silverbox"
    rig = read_rig(folder / "rig.toml")
    lines = read(folder / "test.toml", rig.channels).spectrum()
    assert lines.lines == 1342
    found = identify(rig.model, lines.select(np.arange(0, 1342, 7)))
    assert found["m"].value == pytest.approx(5.371e-6, rel=0.01)
    assert found["k"].value == pytest.approx(1.025, rel=0.01)
    assert found["c"].value == pytest.approx(2.292e-4, rel=0.06)
    assert bool(found.fit.rejected)  # the spring stiffens
