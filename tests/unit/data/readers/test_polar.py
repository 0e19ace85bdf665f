"""Phases in another unit than their columns say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import read
from dashpot.errors import DataError

CHANNELS = (Channel("x1", {"x1": 1.0}), Channel("u", {"u": 1.0}))
HZ = np.linspace(1.0, 10.0, 10)
PHASE = np.linspace(-0.02, -3.1, 10)  # of x1, in rad: through a resonance


def table(path: Path, phases: np.ndarray, unit: str, response: bool) -> Path:
    name = "x1/u" if response else "x1"
    head = f"frequency_hz,{name}_amplitude,{name}_phase{unit}" + ("" if response else ",u_re,u_im")
    rows = [f"{f},1.5,{phase}" + ("" if response else ",1,0") for f, phase in zip(HZ, phases, strict=True)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


@pytest.mark.parametrize("response", [False, True], ids=["amplitudes", "responses"])
def test_degrees_that_look_like_radians_are_noticed(tmp_path: Path, response: bool) -> None:
    """As radians or in degrees of a usual size nothing is said."""
    codes = {
        unit: [n.code for n in read(table(tmp_path / "t.csv", phases, unit, response), CHANNELS).notes]
        for unit, phases in (("", PHASE), ("_rad", PHASE), (" [deg]", np.degrees(PHASE)))
    }
    assert codes == {"": ["phase_unit"], "_rad": [], " [deg]": []}


@pytest.mark.parametrize("response", [False, True], ids=["amplitudes", "responses"])
def test_radians_that_are_degrees_are_refused(tmp_path: Path, response: bool) -> None:
    """Unwrapped radians of many turns are taken, in any order of the rows."""
    with pytest.raises(DataError, match=r"phases of up"):
        read(table(tmp_path / "t.csv", np.degrees(PHASE), "_rad", response), CHANNELS)
    unwrapped = read(table(tmp_path / "t.csv", 10 * PHASE, "_rad", response), CHANNELS)
    X = unwrapped.spectrum().amplitudes[:, 0]
    np.testing.assert_allclose(X, 1.5 * np.exp(10j * PHASE), rtol=1e-12)
    assert not unwrapped.notes


def test_amplitudes_in_decibels_are_read_where_they_say_so_and_refused_where_they_do_not(
    tmp_path: Path,
) -> None:
    size = np.geomspace(2.0, 0.1, 10)
    rows = [f"{f},{20 * np.log10(a)},{p},1,0" for f, a, p in zip(HZ, size, np.degrees(PHASE), strict=True)]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(["frequency_hz,x1_amplitude [dB],x1_phase,u_re,u_im", *rows]) + "\n")
    X = read(path, CHANNELS).spectrum().amplitudes[:, 0]
    np.testing.assert_allclose(X, size * np.exp(1j * PHASE), rtol=1e-9)
    path.write_text("\n".join(["frequency_hz,x1_amplitude,x1_phase,u_re,u_im", *rows]) + "\n")
    with pytest.raises(DataError, match=r"-20 is below"):
        read(path, CHANNELS)
