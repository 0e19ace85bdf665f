"""Words of predictions: by how many per cent the motion is missed, and whether that is noise."""

import numpy as np
import pytest

from dashpot.check.validation import RecordPrediction, within_noise
from dashpot.present.validation import is_poor, next_validation_steps, prediction_in_words


def predicted(fit: tuple[float, float], chi2: tuple[float, float]) -> tuple[RecordPrediction, ...]:
    """Two channels of 50 lines."""
    lines = np.zeros((50, 2), dtype=complex)
    dof = np.full(2, 100.0)
    sizes = np.array(fit), np.array(chi2), dof
    return (RecordPrediction(("x1", "x2"), ("m", "m"), np.arange(50.0), lines, lines, *sizes, 0.0, 0),)


@pytest.mark.parametrize(
    ("fit", "chi2", "within", "says"),
    [
        ((0.98, 0.97), (101.0, 95.0), True, "within the noise of the sensors: the largest difference is 3.0"),
        ((0.98, 0.97), (101.0, 400.0), False, "x2 differs by 2.0 × the noise"),
        ((0.98, 0.2), (101.0, 9000.0), False, "Poorly predicted: measured and predicted differ by 80 %"),
        ((0.98, 0.97), (np.nan, np.nan), None, "whether that is more than noise cannot be said"),
    ],
)
def test_what_is_said_follows_fit_and_noise(
    fit: tuple[float, float], chi2: tuple[float, float], within: bool | None, says: str
) -> None:
    predictions = predicted(fit, chi2)
    assert within_noise(predictions) is within
    assert says in prediction_in_words(predictions)
    assert is_poor(predictions) == (min(fit) < 0.5)
    assert ("noise-record" in next_validation_steps(predictions)[0]) == (within is None)


def test_of_many_channels_one_may_stray_as_chance_has_it() -> None:
    """Twenty channels: the largest χ² of noise alone is beyond the 1 % of a single one in one of five tests."""
    rng = np.random.default_rng(3)
    kept = [within_noise(predicted((0.9, 0.9), (a, b)) * 10) for a, b in rng.chisquare(100, size=(200, 2))]
    assert np.mean(np.array(kept, dtype=bool)) > 0.97
