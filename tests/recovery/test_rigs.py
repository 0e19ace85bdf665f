"""Random rigs, unlike the paper's, by Monte Carlo: spread against the bound, bias, coverage and χ² of every estimator.

Seeds are stated with each rig.  4,000 draws give a spread to 1.1 %, a share of 95 % to 0.34 points; limits on the
worst of some 10 unknowns are 4 of those, limits on their mean 2 (unknowns of a rig are correlated).
"""

from dataclasses import dataclass

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables, OptimalIV
from dashpot.estimate.linear.least_squares import HarmonicLeastSquares, WeightedLeastSquares
from dashpot.estimate.result import Estimate
from tests.rigs import Rig, channels, covariance, noisy, random_rig

D, V, A = Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION
DRAWS = 4000


@dataclass(frozen=True)
class Case:
    """A rig by its seed, and its test: what is measured, noise of the channels and of the inputs."""

    seed: int
    n: int
    displacements: int
    forces: int
    quantities: tuple[Quantity, ...]
    noise: float
    inputs: float = 0.0
    draws: int = DRAWS

    def __str__(self) -> str:
        seen = "".join(quantity.value[0] for quantity in self.quantities)
        return f"{self.n}x-{self.displacements}u-{self.forces}f-{seen}"

    def rig(self) -> Rig:
        return random_rig(
            np.random.default_rng(self.seed), self.n, displacements=self.displacements, forces=self.forces,
            worst=100.0,
        )  # fmt: skip

    def spectrum(self, rig: Rig) -> Spectrum:
        rng = np.random.default_rng([self.seed, 1])
        seen = channels(rig, self.quantities, rng)
        return noisy(
            rig, seen, covariance(rig, seen, self.noise, inputs=self.inputs, correlation=0.4), rng, self.draws
        )


CASES = (
    Case(1, 1, 2, 0, (D, V), 0.02, 0.01),
    Case(2, 2, 0, 1, (V, A, D), 0.02, 0.02),
    Case(3, 3, 0, 2, (D,), 0.02),
    Case(4, 3, 1, 1, (A,), 0.02, 0.01),
    Case(5, 4, 2, 0, (D, A), 0.01),
    Case(6, 5, 2, 1, (A,), 0.01, 0.005),
    Case(7, 6, 1, 0, (D, V), 0.01, 0.0, 2000),
)


def coverage(estimate: Estimate, truth: np.ndarray) -> np.ndarray:
    """Share of 95 % intervals that hold the truth, by unknown."""
    low, high = estimate.interval()
    return np.asarray(np.mean((low <= truth) & (truth <= high), axis=0))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_oiv_sits_on_the_bound_and_its_intervals_hold(case: Case) -> None:
    """Noisy inputs, correlated channels, mixtures of displacement, velocity and acceleration."""
    rig = case.rig()
    estimate = identify(rig.model, case.spectrum(rig), OptimalIV())
    assert np.mean(estimate.converged) == 1.0
    error = estimate.values / rig.theta - 1
    spread = np.std(error, axis=0)
    bound = np.sqrt(np.mean(estimate.bound_sd**2, axis=0)) / rig.theta
    assert np.sqrt(np.mean(spread**2) / np.mean(bound**2)) < 1.05
    se = 1 / np.sqrt(2 * case.draws)
    assert np.all(np.abs(spread / bound - 1) < 4 * se + 0.01)
    assert np.all(np.abs(np.mean(error, axis=0)) < 0.15 * spread)
    share = coverage(estimate, rig.theta)
    points = np.sqrt(0.95 * 0.05 / case.draws)
    assert np.all(np.abs(share - 0.95) < 4 * points + 0.002), share
    assert abs(np.mean(share) - 0.95) < 2.5 * points
    dof = estimate.fit.dof
    assert abs(np.mean(estimate.fit.chi2) / dof - 1) < 4 * np.sqrt(2 / dof / case.draws) + 0.002
    for level in (0.05, 0.5):
        sd = np.sqrt(level * (1 - level) / case.draws)
        assert abs(np.mean(estimate.fit.p < level) - level) < 4 * sd + 0.002


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", [CASES[1], *(pytest.param(case, marks=pytest.mark.long) for case in CASES[2:4])], ids=str
)
def test_other_methods_know_their_spread(case: Case) -> None:
    """iv, hls and wls about their own mean; iv has no bias to speak of, and χ² is the model's, not the method's."""
    rig = case.rig()
    spectrum = case.spectrum(rig)
    for method in (InstrumentalVariables(), HarmonicLeastSquares(), WeightedLeastSquares()):
        estimate = identify(rig.model, spectrum, method)
        assert np.mean(estimate.converged) > 0.999, method
        good = estimate.converged
        spread = np.std(estimate.values[good], axis=0)
        stated = np.sqrt(np.mean(estimate.noise_sd[good] ** 2, axis=0))
        # hls shrinks what noise has drowned, and its spread with it: there the stated one is too wide, never too small.
        assert np.all(stated / spread > 0.92), method
        if method != HarmonicLeastSquares():
            assert np.all(stated / spread < 1.08), method
        if method == InstrumentalVariables():
            assert np.all(np.abs(np.mean(estimate.values[good], axis=0) - rig.theta) < 0.2 * spread)
            assert abs(np.mean(coverage(estimate, rig.theta)) - 0.95) < 0.01
        assert abs(np.mean(estimate.fit.chi2) / estimate.fit.dof - 1) < 0.01, method


@pytest.mark.parametrize(("seed", "n", "displacements", "forces", "noise"), [
    (5, 6, 1, 0, 0.02),  # accelerations alone: the compensated start lost 3 % of these searches
    (9, 4, 2, 1, 0.05),
    (29, 6, 2, 1, 0.03),
])  # fmt: skip
def test_searches_end_where_the_truth_leads(
    seed: int, n: int, displacements: int, forces: int, noise: float
) -> None:
    """On hard rigs no automatic start ends in a minimum that lies above the one near the truth."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, n, displacements=displacements, forces=forces, worst=100.0)
    seen = channels(rig, (A,), rng)
    spectrum = noisy(rig, seen, covariance(rig, seen, noise, inputs=noise / 2, correlation=0.4), rng, 300)
    estimate = identify(rig.model, spectrum, OptimalIV())
    assert np.all(estimate.converged)
    # χ² of the truth has `unknowns` more degrees of freedom; the minimum below it is no higher than chance allows.
    assert np.mean(estimate.fit.p < 1e-4) < 0.01
