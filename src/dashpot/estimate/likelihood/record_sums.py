"""Cost, slope and information of whole records: two passes over their lines, in memory that does not grow with them.

The first pass fits the loads and polynomials of each record to what the rig's own motion leaves; the second takes the
slopes under the whole motion, loads included, and what the same columns explain of them.  All of it goes through
products of real rows, once for each piece of lines.  `objective.predict` says the same line by line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.record_motion import PieceAt, evaluated
from dashpot.estimate.likelihood.record_pieces import KEPT, NO_RECORD, RecordPiece, RecordPieces
from dashpot.numerics.projection import independent


@dataclass(frozen=True)
class RecordSums:
    """Cost (K,), minus half its slope (K, M) and information (K, M, M) of all lines at K values of ψ, priors left out;
    rank (K,): how many independent columns the ends have taken out of the data."""

    cost: Real
    gradient: Real
    information: Real
    rank: Ints


@dataclass(frozen=True)
class EndsFitted:
    """What the first pass found of each record's ends.

    z (K, records, f) coefficients of loads and polynomials, t (K, records, channels, terms) of each channel's own
    polynomials; B (K, records, f, f) makes what those leave of the columns orthonormal; shared (K, records, channels,
    terms, f): how the columns stand in the channel's own polynomials
    """

    z: Real
    t: Real
    B: Real
    shared: Real
    rank: Ints


@dataclass(frozen=True)
class _Products:
    """Products of the columns of each record with rows (K, channels, w, lines), summed over its lines.

    columns (K, records, f, w), basis (K, records, channels, terms, w)
    """

    columns: Real
    basis: Real

    @staticmethod
    def zero(pieces: RecordPieces, K: int, width: int) -> _Products:
        records, channels = len(pieces.ends.lines), len(pieces.ends.rig.channels)
        return _Products(
            np.zeros((K, records, pieces.count, width)),
            np.zeros((K, records, channels, pieces.terms, width)),
        )

    def add(self, at: PieceAt, rows: Complex) -> None:
        """Those of one more piece."""
        F, values = _real(at.columns), _real(rows)
        basis = None if at.piece.basis is None else _real(at.piece.basis)
        for record, part in at.piece.segments:
            if record == NO_RECORD:
                continue
            wide = slice(2 * part.start, 2 * part.stop)
            of_record = np.swapaxes(values[..., wide], -1, -2)
            self.columns[:, record] += np.sum(F[..., wide] @ of_record, axis=1)
            if basis is not None:
                self.basis[:, record] += basis[..., wide] @ of_record

    def left(self, shared: Real) -> Real:
        """Products with what the channels' own polynomials leave of the columns, (K, records, f, w)."""
        left: Real = self.columns - np.sum(np.swapaxes(shared, -1, -2) @ self.basis, axis=2)
        return left

    def explained(self, fit: EndsFitted) -> Real:
        """What the columns of all records explain of the products of the rows with each other, (K, w, w)."""
        projected = np.swapaxes(fit.B, -1, -2) @ self.left(fit.shared)
        by_basis = np.sum(np.swapaxes(self.basis, -1, -2) @ self.basis, axis=(1, 2))
        total: Real = np.sum(np.swapaxes(projected, -1, -2) @ projected, axis=1) + by_basis
        return total

    def coefficients(self, fit: EndsFitted) -> tuple[Real, Real]:
        """Of the columns (K, records, f, w) and of the channels' own polynomials (K, records, channels, terms, w)."""
        z = fit.B @ (np.swapaxes(fit.B, -1, -2) @ self.left(fit.shared))
        return z, self.basis - fit.shared @ z[:, :, None]


def record_sums(pieces: RecordPieces, psi: Real, sign: Real) -> RecordSums:
    """Both passes at ψ (K, M) with signs (K, channels)."""
    kept = _kept(pieces, psi, sign)
    fit = _fitted(pieces, psi, sign, kept)
    K, M = psi.shape
    products, of = np.zeros((K, M + 1, M + 1)), _Products.zero(pieces, K, M + 1)
    for at in kept or evaluated(pieces, psi, sign):
        rows = _slopes_and_residual(at, fit)
        real = _real(rows)
        products += np.sum(real @ np.swapaxes(real, -1, -2), axis=1)
        of.add(at, rows)
    products = 2 * (products - of.explained(fit))
    return RecordSums(products[:, M, M], products[:, :M, M], products[:, :M, :M], fit.rank)


def by_record_line(pieces: RecordPieces, psi: Real, sign: Real) -> tuple[Real, Real, Real]:
    """Information (K, lines, M, M), minus half the slope (K, lines, M) and cost (K, lines) of each line."""
    kept = _kept(pieces, psi, sign)
    fit = _fitted(pieces, psi, sign, kept)
    (K, M), lines = psi.shape, len(pieces.ends.rig.omega)
    of = _Products.zero(pieces, K, M + 1)
    for at in kept or evaluated(pieces, psi, sign):
        of.add(at, _slopes_and_residual(at, fit))
    z, t = of.coefficients(fit)
    information, scores, cost = np.empty((K, lines, M, M)), np.empty((K, lines, M)), np.empty((K, lines))
    for at in kept or evaluated(pieces, psi, sign):
        rows = _slopes_and_residual(at, fit) - _at_ends(at.piece, at.columns, z, t)
        flat = np.moveaxis(rows, -1, 1)
        products = 2 * (np.conj(np.swapaxes(flat, -1, -2)) @ flat).real
        at_lines = at.piece.lines
        information[:, at_lines], scores[:, at_lines] = products[..., :M, :M], products[..., :M, M]
        cost[:, at_lines] = products[..., M, M]
    return information, scores, cost


def record_residuals(pieces: RecordPieces, psi: Real, sign: Real) -> tuple[Complex, Ints]:
    """Whitened residuals (K, lines, channels) of the whole motion, and the rank of the columns taken out (K,)."""
    kept = _kept(pieces, psi, sign)
    fit = _fitted(pieces, psi, sign, kept)
    shape = (len(psi), len(pieces.ends.rig.omega), len(pieces.ends.rig.channels))
    residual = np.empty(shape, dtype=np.complex128)
    for at in kept or evaluated(pieces, psi, sign):
        left = at.residual - _at_ends(at.piece, at.columns, fit.z[..., None], fit.t[..., None])[:, :, 0]
        residual[:, at.piece.lines] = np.swapaxes(left, -1, -2)
    return residual, fit.rank


def _kept(pieces: RecordPieces, psi: Real, sign: Real) -> list[PieceAt]:
    """The pieces at ψ where they are few enough to be kept from pass to pass, else none."""
    return list(evaluated(pieces, psi, sign)) if len(psi) * pieces.numbers <= KEPT / 2 else []


def _fitted(pieces: RecordPieces, psi: Real, sign: Real, kept: list[PieceAt]) -> EndsFitted:
    """The first pass."""
    f, K = pieces.count, len(psi)
    of = _Products.zero(pieces, K, f + 1)
    for at in kept or evaluated(pieces, psi, sign):
        of.add(at, np.concatenate([at.columns, at.residual[:, :, None]], axis=2))
    shared = of.basis[..., :f]
    left = of.left(shared)
    B, rank = independent(left[..., :f], np.diagonal(of.columns[..., :f], axis1=-2, axis2=-1))
    z = (B @ (np.swapaxes(B, -1, -2) @ left[..., f, None]))[..., 0]
    t = of.basis[..., f] - (shared @ z[:, :, None, :, None])[..., 0]
    return EndsFitted(z, t, B, shared, np.sum(rank, axis=-1) + pieces.apart_rank)


def _slopes_and_residual(at: PieceAt, fit: EndsFitted) -> Complex:
    """Slopes under the whole motion and the residual beside its loads, (K, channels, M + 1, lines)."""
    K, f = len(at.psi), fit.z.shape[-1]
    z = np.zeros((K, f, len(at.piece.s)))
    for record, part in at.piece.segments:
        if record != NO_RECORD:
            z[..., part] = fit.z[:, record, :, None]
    ends = _at_ends(at.piece, at.columns, fit.z[..., None], fit.t[..., None])
    return np.concatenate([at.slopes(z), at.residual[:, :, None] - ends], axis=2)


def _at_ends(piece: RecordPiece, columns: Complex, z: Real, t: Real) -> Complex:
    """What the ends add to the channels, whitened, with coefficients z (K, records, f, w) and t: (K, channels, w,
    lines)."""
    K, channels, _, lines = columns.shape
    out = np.zeros((K, channels, z.shape[-1], lines), dtype=np.complex128)
    F, total = _real(columns), _real(out)
    basis = None if piece.basis is None else _real(piece.basis)
    for record, part in piece.segments:
        if record == NO_RECORD:
            continue
        wide = slice(2 * part.start, 2 * part.stop)
        total[..., wide] = np.swapaxes(z[:, record], -1, -2)[:, None] @ F[..., wide]
        if basis is not None:
            total[..., wide] += np.swapaxes(t[:, record], -1, -2) @ basis[..., wide]
    return out


def _real(values: Complex) -> Real:
    """Complex rows as twice as many real numbers."""
    real: Real = np.ascontiguousarray(values).view(np.float64)
    return real
