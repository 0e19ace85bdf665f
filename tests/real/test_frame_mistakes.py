"""Mistakes in the frame's own data: a rig that is only nearly right must not hide their cause."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.examine import diagnose
from dashpot.data.readers import read
from dashpot.model.rigfile import read_rig
from tests.mistakes import times
from tests.real.recordings import EXAMPLES

EXAMPLE = EXAMPLES / "02_shake_table"


@pytest.mark.long
@pytest.mark.parametrize("rig_file", ["rig.toml", "rig_bending.toml"])
def test_the_late_sensor_is_named_first(rig_file: str) -> None:
    """The clock of x3 is 1.77 ms late by free vibration; the chain is wrong by eleven times the noise beside that."""
    rig = read_rig(EXAMPLE / rig_file)
    channels = tuple(replace(channel, delay=0.0) for channel in rig.channels)
    spectrum = read(str(EXAMPLE / "amplitudes.csv"), channels).spectrum()
    best = diagnose(rig.model, spectrum)[0]
    assert (best.kind, best.of) == ("delay", ("x3",))
    assert best.number == pytest.approx(1.77e-3, rel=0.2)


SCALED = {"sign": ("x1", -1.0), "unit": ("x2", 1000.0)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "mistake", ["sign", *(pytest.param(m, marks=pytest.mark.long) for m in ("dwell", "unit", "swap"))]
)
def test_mistakes_in_the_frames_amplitudes_are_named_first(mistake: str) -> None:
    # The chain lacks the springs that represent bending, which explain more than an exchange of channels does.
    rig = read_rig(EXAMPLE / ("rig_bending.toml" if mistake == "swap" else "rig.toml"))
    spectrum = read(str(EXAMPLE / "amplitudes.csv"), rig.channels).spectrum()
    names = [channel.name for channel in spectrum.channels]
    expected: tuple[str, tuple[str, ...]]
    if mistake in SCALED:
        name, factor = SCALED[mistake]
        spectrum = times(spectrum, names.index(name), factor)
        expected = ("sign" if mistake == "sign" else "unit", (name,))
    else:
        Y = np.array(spectrum.amplitudes)
        if mistake == "swap":
            Y[:, [names.index("x1"), names.index("x3")]] = Y[:, [names.index("x3"), names.index("x1")]]
            expected = ("swap", ("x1", "x3"))
        else:
            Y[0, 1:] *= 0.01
            expected = ("dwell", (f"{spectrum.frequency_hz[0]:g} Hz",))
        spectrum = replace(spectrum, amplitudes=Y)
    best = diagnose(rig.model, spectrum)[0]
    assert (best.kind, best.of) == expected
