"""Noise that is louder at some times of a whole record than at others, as where it grows with the motion.

Lines of a record are independent where its noise has one size throughout.  Where it has not, neighbouring lines are
correlated, and what is seen at a loud time tells less of a parameter than its lines say: with noise in proportion to
the motion of a stepped sine, standard deviations from the lines alone are 5 to 20 % too small.  In time such noise is
independent from sample to sample.  So the covariance of the scores is summed over blocks of time, each with the power
that the residual has there (the sandwich of Huber and White), and one Gauss-Newton step with samples weighted by that
power leads to the estimate that the noise allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.conditioning.still import smoothed
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord, history_of_lines, samples_of_squares
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.estimate.likelihood.record_sums import record_residuals, rows_by_line
from dashpot.estimate.method import Solution
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.observation import small
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import QuadraticModel
from dashpot.numerics.small_systems import scaled_inverse
from dashpot.numerics.variance_tests import equal_variances

BLOCKS = 48  # of a record
LINES_EACH = 20  # of a block at the least: each tells its power by two numbers
FEWEST = 6  # blocks that can be compared
LEVEL = 0.01  # of the test whether a channel is as loud in all blocks
QUIETEST = 0.01  # of the mean power: what blocks are weighted by at the least
FAR = 1e-3  # p-value of a step that noise does not explain
UNEVEN = "noise_in_time"


@dataclass(frozen=True)
class EvenNoise:
    """What the lines of one repeat say of M unknowns: information (M, M) and gradient (M,) of all of them, and the
    covariance (M, M) and its degrees of freedom (M,) where noise is even, with what estimating its size costs."""

    information: Real
    gradient: Real
    covariance: Real
    dof: Real


@dataclass(frozen=True)
class EstimateInTime:
    """An estimate of M unknowns as a step (M,) from the one that weighs lines, with its covariance (M, M) and the
    degrees of freedom of that, (M,)."""

    step: Real
    covariance: Real
    dof: Real


@dataclass(frozen=True)
class NoiseInTime:
    """Blocks of time of those channels of whole records whose noise is not even; for M unknowns.

    products (blocks, M + 1, M + 1) of whitened slopes and, last, residual, which sum to those of the lines; power
    (blocks,) of the residual over its mean in the record, and the degrees of freedom `dof` (blocks,) behind it
    """

    products: Real
    power: Real
    dof: Real

    @property
    def weight(self) -> Real:
        """Of the samples of each block, (blocks,)."""
        return 1 / np.maximum(self.power, QUIETEST)

    def bound(self, lines: EvenNoise) -> Real:
        """The least covariance that the noise allows, (M, M); 1/power of few samples is too large on the mean."""
        return scaled_inverse(
            lines.information + self._more(self.weight * (self.dof - 2) / self.dof)[:-1, :-1]
        )

    def of_lines(self, lines: EvenNoise) -> EstimateInTime:
        """The estimate that weighs lines."""
        bread = scaled_inverse(lines.information)
        return self._estimate(lines, bread, np.zeros(len(bread)), self.power)

    def of_samples(self, lines: EvenNoise) -> EstimateInTime:
        """The estimate that weighs samples by the noise at their time."""
        more = self._more(self.weight)
        bread = scaled_inverse(lines.information + more[:-1, :-1])
        # Weights and powers are of the same few samples: moments of inverse χ².
        size = self.weight**2 * self.power * self.dof / (self.dof - 4)
        return self._estimate(lines, bread, bread @ (lines.gradient + more[:-1, -1]), size)

    def notice(self) -> Notice:
        """What is to be said of it."""
        return Notice(
            UNEVEN,
            f"residuals change in time: at their loudest they have {np.max(self.power):.2g} times their mean power",
        )

    def _more(self, weight: Real) -> Real:
        """What weights add to the products of the lines, (M + 1, M + 1)."""
        more: Real = np.einsum("b,bij->ij", weight - 1, self.products)
        return more

    def _estimate(self, lines: EvenNoise, bread: Real, step: Real, size: Real) -> EstimateInTime:
        """With the inverse of its information, and the size of the scores' covariance in each block."""
        scores = lines.information @ lines.covariance @ lines.information + self._more(size)[:-1, :-1]
        covariance = bread @ scores @ bread
        of_blocks = bread @ self.products[:, :-1, :-1] @ bread
        shares = size[:, None] * np.diagonal(of_blocks, axis1=-2, axis2=-1)
        with np.errstate(divide="ignore"):
            dof = np.diagonal(covariance) ** 2 / np.sum(shares**2 / self.dof[:, None], axis=0)
        return EstimateInTime(step, covariance, np.minimum(lines.dof, dof))


@dataclass(frozen=True)
class CountedInTime:
    """Estimates of K repeats of M unknowns with what the noise in time makes of them.

    step (K, M) from those that weigh lines; covariance and bound (K, M, M); dof (K, M); uneven: the repeats' noise
    """

    step: Real
    covariance: Real
    bound: Real
    dof: Real
    uneven: tuple[NoiseInTime | None, ...]


def counted_in_time(
    data: Prepared, solution: Solution, sums: QuadraticModel, covariance: Real, bound: Real, dof: Real
) -> CountedInTime:
    """The estimates of whole records with their noise in time, where that is not even.

    sums: at the solution; covariance, bound (K, M, M) and dof (K, M) are those of even noise.
    """
    step, uneven = np.zeros(solution.theta.shape), _noise_in_time(data, solution)
    covariance, bound, dof = covariance.copy(), bound.copy(), np.array(dof)
    for k, noise in enumerate(uneven):
        if noise is None:
            continue
        lines = EvenNoise(sums.symmetric[k], sums.gradient[k], covariance[k], dof[k])
        of_lines, of_samples = noise.of_lines(lines), noise.of_samples(lines)
        held = solution.bounds is not None
        best = of_lines if held or _is_far(of_samples.step, of_lines.covariance) else of_samples
        step[k], covariance[k], dof[k], bound[k] = best.step, best.covariance, best.dof, noise.bound(lines)
    return CountedInTime(step, covariance, bound, dof, tuple(uneven))


def _is_far(step: Real, covariance: Real) -> bool:
    """Whether noise does not explain that loud and quiet times differ: the model does not fit, and has no better end.

    The step's own covariance is less than that of the estimate it begins at.
    """
    return not chdtrc(len(step), step @ scaled_inverse(covariance) @ step) > FAR


def _noise_in_time(data: Prepared, solution: Solution) -> list[NoiseInTime | None]:
    """Of each repeat; None where its noise is even."""
    spectrum, theta = data.spectrum, solution.theta
    exact, sign = measured(data), spectrum.signs(solution.signs, len(theta))
    if exact.ends is None or not small(data.model):
        return [None] * len(theta)
    results: list[NoiseInTime | None] = []
    for repeat in range(len(theta)):
        one = slice(repeat, repeat + 1)
        at = exact.pick(one).record_pieces, theta[one], sign[one]
        residual, _ = record_residuals(*at)
        uneven = _uneven_channels(residual[0], spectrum, np.flatnonzero(~data.view.inputs_alone))
        if not uneven:
            results.append(None)
            continue
        rows = rows_by_line(*at)[0]
        blocks = [of.products(rows) for of in uneven]
        results.append(NoiseInTime(*(np.concatenate(part) for part in zip(*blocks, strict=True))))
    return results


@dataclass(frozen=True)
class _Channel:
    """An output at the lines of one record, which are its `orders`, to be looked at in so many blocks of time.

    dof: of the power in each block
    """

    lines: Ints
    orders: Ints
    channel: int
    blocks: int
    dof: float

    @staticmethod
    def of(
        residual: Complex, stretch: WholeRecord, spectrum: Spectrum, lines: Ints, channel: int
    ) -> _Channel | None:
        """None where there are too few of the lines with residuals (lines of all, channels) to compare blocks."""
        lines = lines[residual[lines, channel] != 0]
        blocks = min(BLOCKS, len(lines) // LINES_EACH)
        if blocks < FEWEST:
            return None
        # Where inputs are noisy, too, residuals are louder at some lines, which then tell more than others.
        loud = smoothed(np.abs(residual[lines, channel]) ** 2 + 0j, LINES_EACH // 2).real
        dof = 2 * np.sum(loud) ** 2 / np.sum(loud**2) / blocks
        return _Channel(lines, stretch.orders(spectrum.frequency_hz[lines]), channel, blocks, float(dof))

    def histories(self, rows: Complex) -> list[Real]:
        """Rows (lines of all, channels, ...) in time: those of each block, (samples, ...)."""
        samples = samples_of_squares(self.orders)
        begins = np.linspace(0, samples, self.blocks, endpoint=False).astype(np.int64)
        return np.split(history_of_lines(rows[self.lines, self.channel], self.orders, samples), begins[1:])

    def p_even(self, residual: Complex) -> float:
        """p-value of residuals (lines of all, channels) that are as loud in all blocks."""
        power = np.array([np.mean(part**2) for part in self.histories(residual)])
        return equal_variances(power, self.dof)

    def products(self, rows: Complex) -> tuple[Real, Real, Real]:
        """Products, power and degrees of freedom of each block; rows (lines of all, channels, M + 1)."""
        parts = self.histories(rows)
        products = np.stack([part.T @ part for part in parts])
        power = products[:, -1, -1] / np.array([len(part) for part in parts])
        scale = 4 / sum(len(part) for part in parts)
        return products * scale, power / np.mean(power), np.full(self.blocks, self.dof)


def _uneven_channels(residual: Complex, spectrum: Spectrum, outputs: Ints) -> list[_Channel]:
    """Outputs of records whose residuals (lines, channels) are not as loud in all blocks of time."""
    sought = np.array(spectrum.noise) == RESIDUAL
    compared = []
    for number in spectrum.records:
        stretch = spectrum.stretches[number]
        assert isinstance(stretch, WholeRecord)
        lines = np.flatnonzero((spectrum.stretch == number) & sought)
        of_record = [_Channel.of(residual, stretch, spectrum, lines, int(channel)) for channel in outputs]
        compared += [each for each in of_record if each is not None]
    return [each for each in compared if each.p_even(residual) < LEVEL / len(compared)]
