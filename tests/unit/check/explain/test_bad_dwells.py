"""Dwells that are wrong in a way that has a name."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.examine import diagnose
from tests.unit.check.explain.test_contradictions import clean


@pytest.mark.slow
def test_two_dwells_with_each_others_label_are_named_together() -> None:
    model, spectrum = clean()
    f = spectrum.frequency_hz.copy()
    f[[8, 14]] = f[[14, 8]]
    first = diagnose(model, replace(spectrum, frequency_hz=f))[0]
    assert (first.kind, set(first.of)) == ("frequency", {f"{f[8]:g} Hz", f"{f[14]:g} Hz"})
    assert first.text.endswith("are swapped")


@pytest.mark.slow
def test_a_dwell_with_its_phases_the_other_way_says_so() -> None:
    model, spectrum = clean()
    Y = spectrum.amplitudes.copy()
    Y[9] = np.conj(Y[9])
    first = diagnose(model, replace(spectrum, amplitudes=Y))[0]
    label = f"{spectrum.frequency_hz[9]:g} Hz"
    assert (first.kind, first.of) == ("conjugate", (label,))
    assert first.text == f"the phases of the dwell at {label} have the opposite sign"
