"""Cost, slope and information of whole records: two passes over their lines, in memory that does not grow with them.

The first pass fits the loads and polynomials of each record to what the rig's own motion leaves; the second takes the
slopes under the whole motion, loads included, and what the same columns explain of them.  `objective.predict` says the
same line by line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.record_kernel import compiled_passes
from dashpot.estimate.likelihood.record_passes import EndProducts, EndsFitted, NumpyPasses, Passes
from dashpot.estimate.likelihood.record_pieces import RecordPieces
from dashpot.numerics.projection import independent

ROUNDING = 1e-6  # of the power of a residual, below 0, beyond which it is no number


@dataclass(frozen=True)
class RecordSums:
    """Cost (K,), minus half its slope (K, M) and information (K, M, M) of all lines at K values of ψ, priors left out;
    rank (K,): how many independent columns the ends have taken out of the data."""

    cost: Real
    gradient: Real
    information: Real
    rank: Ints


def record_sums(pieces: RecordPieces, psi: Real, sign: Real) -> RecordSums:
    """Both passes at ψ (K, M) with signs (K, channels)."""
    passes = _passes(pieces, psi, sign)
    fit, (products, of_ends) = _fit(pieces, passes), _slopes(pieces, passes)
    left = 2 * (products - of_ends.explained(fit))
    M = psi.shape[-1]
    # Where the ends explain more than there is, what is left is rounding of numbers that are far too large.
    lost = left[:, M, M] < -ROUNDING * products[:, M, M]
    return RecordSums(np.where(lost, np.inf, left[:, M, M]), left[:, :M, M], left[:, :M, :M], fit.rank)


def by_record_line(pieces: RecordPieces, psi: Real, sign: Real) -> tuple[Real, Real, Real]:
    """Information (K, lines, M, M), minus half the slope (K, lines, M) and cost (K, lines) of each line."""
    passes = _passes(pieces, psi, sign)
    fit, (_, of_ends) = _fit(pieces, passes), _slopes(pieces, passes)
    return passes.by_line(fit, *of_ends.coefficients(fit))


def rows_by_line(pieces: RecordPieces, psi: Real, sign: Real) -> Complex:
    """Whitened slopes and, last, residual that the ends leave of each line: (K, lines, channels, M + 1)."""
    passes = _passes(pieces, psi, sign)
    fit, (_, of_ends) = _fit(pieces, passes), _slopes(pieces, passes)
    lines, channels = len(pieces.ends.rig.omega), len(pieces.ends.rig.channels)
    rows = np.empty((len(psi), lines, channels, psi.shape[-1] + 1), dtype=np.complex128)
    for at, of_lines in NumpyPasses(pieces, psi, sign).rows(fit, *of_ends.coefficients(fit)):
        rows[:, at] = np.moveaxis(of_lines, -1, 1)
    return rows


def record_residuals(pieces: RecordPieces, psi: Real, sign: Real) -> tuple[Complex, Ints]:
    """Whitened residuals (K, lines, channels) of the whole motion, and the rank of the columns taken out (K,)."""
    passes = _passes(pieces, psi, sign)
    fit = _fit(pieces, passes)
    return passes.residuals(fit), fit.rank


def ends_rank(pieces: RecordPieces, psi: Real, sign: Real) -> Ints:
    """The rank of the columns taken out, (K,), alone."""
    return _fit(pieces, _passes(pieces, psi, sign)).rank


def ends_fitted(pieces: RecordPieces, psi: Real, sign: Real) -> EndsFitted:
    """The loads and polynomials of each record that fit best."""
    return _fit(pieces, _passes(pieces, psi, sign))


def information_under(pieces: RecordPieces, psi: Real, sign: Real, ends: EndsFitted) -> Real:
    """Information (K, M, M) of all lines, were the motion that of such ends."""
    products, of_ends = _passes(pieces, psi, sign).of_slopes(ends)
    M = psi.shape[-1]
    information: Real = 2 * (products - of_ends.explained(ends))[:, :M, :M]
    return information


def _passes(pieces: RecordPieces, psi: Real, sign: Real) -> Passes:
    compiled = compiled_passes(pieces, psi, sign)
    passes: Passes = NumpyPasses(pieces, psi, sign) if compiled is None else compiled
    # Where a search ends its sums are asked for again, and then its residuals: what the passes said there is kept.
    at = (type(passes), psi.tobytes(), sign.tobytes())
    if pieces.latest.get("at") != at:
        pieces.latest.clear()
        pieces.latest["at"] = at
    return passes


def _fit(pieces: RecordPieces, passes: Passes) -> EndsFitted:
    """What the first pass says; far from any rig it may not be finite."""
    if "fit" not in pieces.latest:
        with np.errstate(over="ignore", invalid="ignore"):
            pieces.latest["fit"] = _fitted(pieces, passes)
    fit: EndsFitted = pieces.latest["fit"]
    return fit


def _slopes(pieces: RecordPieces, passes: Passes) -> tuple[Real, EndProducts]:
    """What the second pass says; far from any rig it may not be finite."""
    if "slopes" not in pieces.latest:
        fit = _fit(pieces, passes)
        with np.errstate(over="ignore", invalid="ignore"):
            pieces.latest["slopes"] = passes.of_slopes(fit)
    slopes: tuple[Real, EndProducts] = pieces.latest["slopes"]
    return slopes


def _fitted(pieces: RecordPieces, passes: Passes) -> EndsFitted:
    """The first pass."""
    f, of = pieces.count, passes.of_columns()
    shared = of.basis[..., :f]
    left = of.left(shared)
    B, rank = independent(left[..., :f], np.diagonal(of.columns[..., :f], axis1=-2, axis2=-1))
    z = (B @ (np.swapaxes(B, -1, -2) @ left[..., f, None]))[..., 0]
    t = of.basis[..., f] - (shared @ z[:, :, None, :, None])[..., 0]
    return EndsFitted(z, t, B, shared, np.sum(rank, axis=-1) + pieces.apart_rank)
