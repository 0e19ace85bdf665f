"""Agreement of the parts of the band: by linear models whose scores are drawn, and by one that changes within it."""

import numpy as np

from dashpot.arrays import Real
from dashpot.estimate.inference.time_course import BandStability, band_stability

LINES, UNKNOWNS = 600, 3
F = np.linspace(1.0, 10.0, LINES)


def stability(repeats: int, apart: float, seed: int = 0) -> tuple[BandStability, Real]:
    """Lines y = a·θ + e of unit noise, fitted by least squares; above the middle of the band θ₁ is larger by `apart` of
    its standard deviations.  With the stability, θ̂ (repeats, unknowns)."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(LINES, UNKNOWNS)) * np.linspace(1, 3, LINES)[:, None]
    information = a[:, :, None] * a[:, None, :]
    total = np.sum(information, axis=0)
    sd = np.sqrt(np.diagonal(np.linalg.inv(total)))
    y = rng.normal(size=(repeats, LINES)) + a[:, 0] * np.where(F > 5.5, apart * sd[0], 0.0)
    theta = y @ a @ np.linalg.inv(total)
    scores = (y - theta @ a.T)[:, :, None] * a
    everything = np.broadcast_to(information, (repeats, *information.shape))
    return band_stability(F, everything, scores, np.zeros((UNKNOWNS, UNKNOWNS))), theta


def test_noise_alone_makes_the_parts_differ_as_stated() -> None:
    # 600 draws: a share of 5 % has a standard error of 0.9 points.
    found, theta = stability(600, 0.0)
    assert abs(np.mean(found.p < 0.05) - 0.05) < 0.03
    assert abs(np.mean(found.p < 0.5) - 0.5) < 0.07
    assert np.mean(found.disagree) < 0.01
    # Leaving out parts gives the variance of the estimate: the mean of 600 with five degrees of freedom, to 3 %.
    scatter = np.mean(np.diagonal(found.covariance, axis1=1, axis2=2), axis=0)
    np.testing.assert_allclose(scatter, np.var(theta, axis=0), rtol=0.15)


def test_a_parameter_that_changes_within_the_band_is_found_and_counted() -> None:
    found, _ = stability(40, 25.0)
    assert np.all(found.disagree)
    assert np.all(found.apart[:, 0] > 2)
    noise = np.broadcast_to(np.eye(UNKNOWNS) * 1e-12, (40, UNKNOWNS, UNKNOWNS))
    many = np.full((40, UNKNOWNS), 100.0)
    wide, degrees = found.widened(noise, many, found.disagree)
    np.testing.assert_allclose(
        np.diagonal(wide, axis1=1, axis2=2), np.diagonal(found.covariance, axis1=1, axis2=2), rtol=1e-9
    )
    (notice,) = found.notices(("k1", "k2", "c1"))
    assert notice.code == "bands_disagree"
    assert notice.of[0] == "k1"
    assert "parts of the band disagree" in notice.text
    calm, _ = stability(1, 0.0)
    assert calm.notices(("k1", "k2", "c1")) == []
    np.testing.assert_array_equal(degrees, 5)  # of six parts
    covariance, degrees = calm.widened(noise[:1], many[:1], calm.disagree)
    np.testing.assert_array_equal(covariance, noise[:1])
    np.testing.assert_array_equal(degrees, many[:1])


def test_an_unknown_of_which_nothing_is_known_is_no_disagreement() -> None:
    """As one that a reversed sensor has let run away: it was an internal error."""
    found, _ = stability(3, 0.0)

    def beside(matrix: Real) -> Real:
        return np.pad(matrix, [(0, 0)] * (matrix.ndim - 2) + [(0, 1), (0, 1)])

    scores = np.pad(found.scores, [(0, 0), (0, 0), (0, 1)])
    with_nothing = BandStability(beside(found.information), scores, beside(found.total))
    np.testing.assert_allclose(with_nothing.p, found.p)
