"""Inputs that were measured with noise: what is known of them, and what their noise does to the outputs (THEORY §9).

The true inputs are unknowns like others, as many as there are samples.  Minimised away, to first order around the
motion that they give, they leave the residuals of the outputs with the covariance V = I + A Aᵀ: A carries noise of the
inputs to the channels, by the motion's own slopes.  V is never formed: conjugate gradients solve with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from dashpot.arrays import Ints, Real
from dashpot.model.nonlinear.chain_solver import ChainSolver
from dashpot.model.nonlinear.tangent import Tangent

HALF_WINDOW = 60  # lines of a cosine transform over which an input's own spectrum is smoothed
ENDS = 8  # samples by which the slopes at the ends of an input are told
SOLVED = 1e-8  # of a column: what the conjugate gradients leave
MOST = 200  # of their steps
EXACT = 1e-9  # of an input's size: noise below it is none


@dataclass(frozen=True)
class KnownInputs:
    """What the measurement says of the inputs of a record, before the outputs: mean (samples, q) and independent errors
    of its lines, `spread` (samples, q), the standard deviations of the coefficients of an orthonormal cosine transform;
    sd (q,) those of the white noise of the samples.
    """

    mean: Real
    spread: Real
    sd: Real

    def moved(self, white: Real) -> Real:
        """The inputs with errors (samples, q) in standard deviations, (samples, q)."""
        inputs: Real = self.mean + idct(self.spread * white, axis=0, norm="ortho")
        return inputs


def known_inputs(measured: Real, sd: Real) -> KnownInputs:
    """From measured inputs (samples, q) with white noise of standard deviations sd (q,).

    Where a part of the band holds no more than noise the input is at rest there: each line is weighed by how far the
    spectrum around it stands out (Wiener 1949).
    """
    lines, smooth = cosine_lines(measured)
    moving = np.maximum(around(lines**2, HALF_WINDOW) - sd**2, 0.0)
    total = moving + sd**2
    share = np.where(total > 0, moving / np.where(total > 0, total, 1.0), 1.0)
    return KnownInputs(smooth + idct(share * lines, axis=0, norm="ortho"), np.sqrt(share) * sd, sd)


def cosine_lines(measured: Real) -> tuple[Real, Real]:
    """Cosine transform of inputs less a smooth course, and that course, both (samples, q)."""
    smooth = _course(measured)
    lines: Real = dct(measured - smooth, axis=0, norm="ortho")
    return lines, smooth


def around(power: Real, half_window: int) -> Real:
    """Mean over the nearest 2·half_window + 1 lines (axis 0), fewer at the ends."""
    N = len(power)
    total = np.concatenate([np.zeros((1, *power.shape[1:])), np.cumsum(power, axis=0)])
    first = np.maximum(np.arange(N) - half_window, 0)
    last = np.minimum(np.arange(N) + half_window + 1, N)
    mean: Real = (total[last] - total[first]) / (last - first).reshape(-1, *[1] * (power.ndim - 1))
    return mean


def _course(measured: Real) -> Real:
    """The parabola whose slopes at the ends are those of the signal: less it, a cosine transform has no steps."""
    N = len(measured)
    count = min(ENDS, N)
    basis = np.linalg.pinv(np.vander(np.arange(count) + 0.5, 3, increasing=True))
    first, last = basis[1] @ measured[:count], -basis[1] @ measured[::-1][:count]
    t = np.arange(N)[:, None]
    parabola: Real = first * t + (last - first) * t**2 / (2 * max(N - 1, 1))
    return parabola


class NotSolvedError(Exception):
    """The conjugate gradients do not come to an end: a motion that hangs too much on its inputs."""


@dataclass(frozen=True, eq=False)
class OutputCovariance:
    """V = I + A Aᵀ of one record's residuals, in standard deviations: weight (channels,) are gains over these."""

    tangent: Tangent
    weight: Real
    known: KnownInputs

    def reach(self, white: Real) -> Real:
        """A w: errors of the inputs (samples, q, K) in standard deviations, as the channels show them."""
        moved = idct(self.known.spread[..., None] * white, axis=0, norm="ortho")
        shown: Real = self.weight[:, None] * self.tangent.times(moved)
        return shown

    def back(self, residual: Real) -> Real:
        """Aᵀ r, (samples, q, K), of residuals (samples, channels, K)."""
        back = self.tangent.transposed(self.weight[:, None] * residual)
        white: Real = self.known.spread[..., None] * dct(back, axis=0, norm="ortho")
        return white

    def solve(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K).  Raises NotSolvedError."""
        z = np.zeros_like(columns)
        size = np.sqrt(_squares(columns))
        active = np.flatnonzero(size > 0)
        left = columns[..., active]
        near = self._white.solve(left)
        way, gain = near, np.sum(left * near, axis=(0, 1))
        for _ in range(MOST):
            if not len(active):
                return z
            pushed = way + self.reach(self.back(way))
            step = gain / np.sum(way * pushed, axis=(0, 1))
            z[..., active] += step * way
            left = left - step * pushed
            open_ = np.sqrt(_squares(left)) > SOLVED * size[active]
            active, left, way, gain = active[open_], left[..., open_], way[..., open_], gain[open_]
            near = self._white.solve(left)
            after = np.sum(left * near, axis=(0, 1))
            way, gain = near + after / gain * way, after
            if not np.all(np.isfinite(gain)):
                break
        raise NotSolvedError

    @cached_property
    def _white(self) -> ChainSolver:
        """V⁻¹ were the errors of the inputs white in the whole band, which is near enough to begin with."""
        size = np.sqrt(np.mean(self.known.mean**2, axis=0))
        sd = np.maximum(self.known.sd, EXACT * np.where(size > 0, size, 1.0))
        return ChainSolver(self.tangent, self.weight, sd)


@dataclass(frozen=True)
class InputErrors:
    """Errors of a record's inputs that were likeliest at psi (M,), in standard deviations.

    white (samples, q), and their slopes along ψ (samples, q, M).
    """

    psi: Real
    white: Real
    along: Real

    def at(self, psi: Real) -> Real:
        """At a ψ nearby, (samples, q)."""
        errors: Real = self.white + self.along @ (psi - self.psi)
        return errors


@dataclass(frozen=True)
class NormalEquations:
    """Of the unknowns `chosen` (P,): squared residuals, minus half their slope (P,), half their curvature (P, P)."""

    chosen: Ints
    cost: float
    gradient: Real
    matrix: Real


@dataclass(frozen=True, eq=False)
class LinearisedRecord:
    """Residuals (samples, channels) of the motion that the inputs give as they are known, to first order around the
    motion with their errors; slopes (samples, channels, P) of what is shown along the unknowns `chosen` (P,).

    drifting: channels whose mean says nothing.
    """

    covariance: OutputCovariance
    residual: Real
    slopes: Real
    chosen: Ints
    drifting: Ints

    def weighed(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K) less what constants of the drifting channels explain of them."""
        return self._without_means(self.covariance.solve(columns))

    def _without_means(self, solved: Real) -> Real:
        if not len(self.drifting):
            return solved
        matrix = np.sum(self._means, axis=0)[self.drifting]
        left: Real = solved - self._means @ np.linalg.solve(matrix, np.sum(solved, axis=0)[self.drifting])
        return left

    @cached_property
    def _means(self) -> Real:
        """V⁻¹ of a constant in each drifting channel, (samples, channels, drifting)."""
        constants = np.zeros((*self.residual.shape, len(self.drifting)))
        constants[:, self.drifting, range(len(self.drifting))] = 1.0
        return self.covariance.solve(constants)

    @cached_property
    def score(self) -> Real:
        """V⁻¹ of the residuals, (samples, channels)."""
        return self.weighed(self.residual[..., None])[..., 0]

    @cached_property
    def weighed_slopes(self) -> Real:
        """V⁻¹ of the slopes, (samples, channels, P)."""
        return self.weighed(self.slopes)

    @property
    def cost(self) -> float:
        """The least of squared residuals and squared errors of the inputs."""
        return float(np.sum(self.residual * self.score))

    def errors(self) -> Real:
        """The likeliest errors of the inputs, (samples, q)."""
        errors: Real = self.covariance.back(self.score[..., None])[..., 0]
        return errors

    def errors_along(self) -> Real:
        """Their slopes along the unknowns, (samples, q, P)."""
        return -self.covariance.back(self.weighed_slopes)

    def normal_equations(self) -> NormalEquations:
        """Those of the unknowns, the errors of the inputs being eliminated."""
        gradient = np.einsum("ncp,nc->p", self.slopes, self.score)
        matrix = np.tensordot(self.slopes, self.weighed_slopes, axes=([0, 1], [0, 1]))
        return NormalEquations(self.chosen, self.cost, gradient, (matrix + matrix.T) / 2)


def _squares(columns: Real) -> Real:
    total: Real = np.sum(columns**2, axis=(0, 1))
    return total
