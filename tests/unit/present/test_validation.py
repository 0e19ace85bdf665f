"""Words of predictions: by how many per cent the motion is missed, and whether that is noise."""

import numpy as np

from dashpot.check.validation import RecordPrediction, within_noise


def predicted(fit: tuple[float, float], chi2: tuple[float, float]) -> tuple[RecordPrediction, ...]:
    """Two channels of 50 lines."""
    lines = np.zeros((50, 2), dtype=complex)
    dof = np.full(2, 100.0)
    sizes = np.array(fit), np.array(chi2), dof
    return (RecordPrediction(("x1", "x2"), ("m", "m"), np.arange(50.0), lines, lines, *sizes, 0.0, 0),)


def test_of_many_channels_one_may_stray_as_chance_has_it() -> None:
    """Twenty channels: the largest χ² of noise alone is beyond the 1 % of a single one in one of five tests."""
    rng = np.random.default_rng(3)
    kept = [within_noise(predicted((0.9, 0.9), (a, b)) * 10) for a, b in rng.chisquare(100, size=(200, 2))]
    assert np.mean(np.array(kept, dtype=bool)) > 0.97
