"""Cost, slope and information of whole records: two passes over their lines, in memory that does not grow with them.

The first pass fits the loads and polynomials of each record to what the rig's own motion leaves; the second takes the
slopes under the whole motion, loads included, and what the same columns explain of them.  `objective.predict` says the
same line by line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.record_kernel import compiled_passes
from dashpot.estimate.likelihood.record_passes import EndProducts, EndsFitted, NumpyPasses, Passes
from dashpot.estimate.likelihood.record_pieces import RecordPieces
from dashpot.numerics.projection import independent


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
    at = _at(pieces, psi, sign)
    products, of_ends = at.slopes
    products = 2 * (products - of_ends.explained(at.fit))
    M = psi.shape[-1]
    return RecordSums(products[:, M, M], products[:, :M, M], products[:, :M, :M], at.fit.rank)


def by_record_line(pieces: RecordPieces, psi: Real, sign: Real) -> tuple[Real, Real, Real]:
    """Information (K, lines, M, M), minus half the slope (K, lines, M) and cost (K, lines) of each line."""
    at = _at(pieces, psi, sign)
    return at.passes.by_line(at.fit, *at.slopes[1].coefficients(at.fit))


def record_residuals(pieces: RecordPieces, psi: Real, sign: Real) -> tuple[Complex, Ints]:
    """Whitened residuals (K, lines, channels) of the whole motion, and the rank of the columns taken out (K,)."""
    at = _at(pieces, psi, sign)
    return at.passes.residuals(at.fit), at.fit.rank


def ends_rank(pieces: RecordPieces, psi: Real, sign: Real) -> Ints:
    """The rank of the columns taken out, (K,), alone."""
    return _at(pieces, psi, sign).fit.rank


class _At:
    """The passes at one ψ and what they have said there, asked once each."""

    def __init__(self, pieces: RecordPieces, passes: Passes) -> None:
        self.pieces, self.passes = pieces, passes

    @cached_property
    def fit(self) -> EndsFitted:
        return _fitted(self.pieces, self.passes)

    @cached_property
    def slopes(self) -> tuple[Real, EndProducts]:
        return self.passes.of_slopes(self.fit)


def _at(pieces: RecordPieces, psi: Real, sign: Real) -> _At:
    passes = compiled_passes(pieces, psi, sign)
    # Those of NumPy keep their pieces, which are not to outlast a call.
    if passes is None:
        return _At(pieces, NumpyPasses(pieces, psi, sign))
    key = (psi.tobytes(), sign.tobytes())
    if key not in pieces.latest:
        pieces.latest.clear()
        pieces.latest[key] = _At(pieces, passes)
    at: _At = pieces.latest[key]
    return at


def _fitted(pieces: RecordPieces, passes: Passes) -> EndsFitted:
    """The first pass."""
    f, of = pieces.count, passes.of_columns()
    shared = of.basis[..., :f]
    left = of.left(shared)
    B, rank = independent(left[..., :f], np.diagonal(of.columns[..., :f], axis1=-2, axis2=-1))
    z = (B @ (np.swapaxes(B, -1, -2) @ left[..., f, None]))[..., 0]
    t = of.basis[..., f] - (shared @ z[:, :, None, :, None])[..., 0]
    return EndsFitted(z, t, B, shared, np.sum(rank, axis=-1) + pieces.apart_rank)
