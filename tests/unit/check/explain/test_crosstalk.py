"""A part of one channel in another."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.examine import diagnose
from tests.unit.check.explain.test_diagnose import clean


@pytest.mark.slow
@pytest.mark.parametrize(("into", "source"), [("d_x1", "d_x2"), ("d_x1", "u")])
def test_cross_talk_is_named_and_not_an_element(into: str, source: str) -> None:
    """The sensor of one mass, or of the base, in that of the first mass: 5 % of its rms."""
    model, spectrum = clean("paper", np.random.default_rng(3))
    Y = np.array(spectrum.amplitudes)
    a, b = spectrum.index(into), spectrum.index(source)
    share = 0.05 * np.sqrt(np.mean(np.abs(Y[:, a]) ** 2) / np.mean(np.abs(Y[:, b]) ** 2))
    Y[:, a] += share * Y[:, b]
    best = diagnose(model, replace(spectrum, amplitudes=Y))[0]
    assert (best.kind, best.of) == ("crosstalk", (into, source))
    assert best.number == pytest.approx(share, rel=0.2)
    assert best.remaining < 1.5
    assert "cross-talk" in best.text
