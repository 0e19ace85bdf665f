"""Intervals of rigs that do not fit, against those that the ratio of residuals to noise would give."""

from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.model.dynamics import response
from dashpot.model.elements import Kind, between
from tests.rigs import Rig, channels, covariance, noisy, random_rig


def with_a_forgotten_spring(seed: int) -> tuple[Rig, Spectrum]:
    """A random rig of two coordinates, and a test of it with one spring more, a tenth of the median one."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 2, worst=100.0)
    springs = [k for element, k in zip(rig.model.elements, rig.p, strict=True) if element.kind is Kind.SPRING]
    extra = between("forgotten", Kind.SPRING, rig.model.coordinates[0], "ground")
    true = replace(rig.model, elements=(*rig.model.elements, extra))
    moved = replace(rig)
    p = np.append(rig.p, 0.1 * np.median(np.abs(springs)))
    moved.__dict__["X"] = response(true, p, rig.omega, rig.U, rig.f)
    seen = channels(rig, (Quantity.DISPLACEMENT,), rng)
    return rig, noisy(moved, seen, covariance(rig, seen, 0.01), rng, 1)


def test_intervals_of_a_misfit_count_how_far_parts_of_the_band_move_the_unknowns() -> None:
    by_parts: list[bool] = []
    by_ratio: list[bool] = []
    for seed in range(40):
        rig, spectrum = with_a_forgotten_spring(seed)
        estimate = identify(rig.model, spectrum)
        if not estimate.fit.rejected[0]:
            continue
        away = np.abs(estimate.values - rig.theta)[0]
        ratio = estimate.noise_sd[0] * estimate.fit.misfit[0]
        by_ratio += (away < stdtrit(estimate.fit.dof, 0.975) * ratio).tolist()
        by_parts += (away < stdtrit(estimate.dof, 0.975) * estimate.sd)[0].tolist()
        assert np.all(estimate.sd[0] > 0.999 * ratio)
    assert len(by_parts) > 100
    # Measured: 92 and 65 %.
    assert np.mean(by_parts) > 0.85 > 0.8 > np.mean(by_ratio)


def test_repeats_that_do_not_fit_are_widened_as_if_alone() -> None:
    rig, spectrum = with_a_forgotten_spring(1)
    clean = replace(spectrum, covariance=spectrum.covariance * 1e4)
    alone = identify(rig.model, spectrum)
    three = replace(
        spectrum,
        amplitudes=np.repeat(spectrum.amplitudes, 3, axis=0),
        covariance=np.stack(
            [
                np.broadcast_to(s.covariance, (1, *s.covariance.shape[-3:]))[0]
                for s in (clean, spectrum, clean)
            ]
        ),
    )
    together = identify(rig.model, three)
    assert together.fit.rejected.tolist() == [False, True, False]
    np.testing.assert_allclose(together.sd[1], alone.sd[0], rtol=1e-6)
    assert together.dof[1].tolist() == alone.dof[0].tolist()
    np.testing.assert_array_equal(together.sd[0], together.noise_sd[0])
