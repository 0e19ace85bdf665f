"""Passes over the lines of whole records in NumPy, piece by piece: what `record_sums` asks for, in rows of products.

The compiled kernel makes the same passes (`record_kernel.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.record_motion import PieceAt, evaluated
from dashpot.estimate.likelihood.record_pieces import KEPT, NO_RECORD, RecordPiece, RecordPieces


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

    @property
    def covariance(self) -> Real:
        """Of z, (K, records, f, f), by the whitened noise."""
        return self.B @ np.swapaxes(self.B, -1, -2) / 2


@dataclass(frozen=True)
class EndProducts:
    """Products of the columns of each record with rows (K, channels, w, lines), summed over its lines.

    columns (K, records, f, w), basis (K, records, channels, terms, w)
    """

    columns: Real
    basis: Real

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


class Passes(Protocol):
    """Passes over all lines at ψ (K, M)."""

    def of_columns(self) -> EndProducts:
        """Products with the columns themselves and, last, the residual of the rig without its ends: w = f + 1."""
        ...

    def of_slopes(self, fit: EndsFitted) -> tuple[Real, EndProducts]:
        """Products (K, w, w) of slopes and, last, residual under the whole motion; with the columns: w = M + 1."""
        ...

    def by_line(self, fit: EndsFitted, z: Real, t: Real) -> tuple[Real, Real, Real]:
        """Information (K, lines, M, M), minus half the slope and cost of each line, of what the ends with coefficients
        z (K, records, f, M + 1) and t (K, records, channels, terms, M + 1) leave of slopes and residual."""
        ...

    def residuals(self, fit: EndsFitted) -> Complex:
        """Whitened residuals of the whole motion, (K, lines, channels)."""
        ...


@dataclass(frozen=True)
class NumpyPasses:
    """Those of NumPy, with signs (K, channels)."""

    pieces: RecordPieces
    psi: Real
    sign: Real

    @cached_property
    def _kept(self) -> list[PieceAt]:
        """The pieces at ψ where they are few enough to be kept from pass to pass, else none."""
        few = len(self.psi) * self.pieces.numbers <= KEPT / 2
        return list(evaluated(self.pieces, self.psi, self.sign)) if few else []

    def _each(self) -> Iterable[PieceAt]:
        return self._kept or evaluated(self.pieces, self.psi, self.sign)

    def of_columns(self) -> EndProducts:
        """As `Passes` says."""
        of = _nothing(self.pieces, len(self.psi), self.pieces.count + 1)
        for at in self._each():
            _add(of, at, np.concatenate([at.columns, at.residual[:, :, None]], axis=2))
        return of

    def of_slopes(self, fit: EndsFitted) -> tuple[Real, EndProducts]:
        """As `Passes` says."""
        K, M = self.psi.shape
        products, of = np.zeros((K, M + 1, M + 1)), _nothing(self.pieces, K, M + 1)
        for at in self._each():
            rows = _slopes_and_residual(at, fit)
            real = _real(rows)
            products += np.sum(real @ np.swapaxes(real, -1, -2), axis=1)
            _add(of, at, rows)
        return products, of

    def by_line(self, fit: EndsFitted, z: Real, t: Real) -> tuple[Real, Real, Real]:
        """As `Passes` says."""
        (K, M), lines = self.psi.shape, len(self.pieces.ends.rig.omega)
        information, scores, cost = np.empty((K, lines, M, M)), np.empty((K, lines, M)), np.empty((K, lines))
        for at, rows in self.rows(fit, z, t):
            flat = np.moveaxis(rows, -1, 1)
            products = 2 * (np.conj(np.swapaxes(flat, -1, -2)) @ flat).real
            information[:, at], scores[:, at] = products[..., :M, :M], products[..., :M, M]
            cost[:, at] = products[..., M, M]
        return information, scores, cost

    def rows(self, fit: EndsFitted, z: Real, t: Real) -> Iterator[tuple[slice | Ints, Complex]]:
        """Lines, and what the ends leave of their whitened slopes and, last, residual: (K, channels, M + 1, lines)."""
        for at in self._each():
            yield at.piece.lines, _slopes_and_residual(at, fit) - _at_ends(at.piece, at.columns, z, t)

    def residuals(self, fit: EndsFitted) -> Complex:
        """As `Passes` says."""
        ends = self.pieces.ends
        residual = np.empty((len(self.psi), len(ends.rig.omega), len(ends.rig.channels)), dtype=np.complex128)
        for at in self._each():
            left = at.residual - _at_ends(at.piece, at.columns, fit.z[..., None], fit.t[..., None])[:, :, 0]
            residual[:, at.piece.lines] = np.swapaxes(left, -1, -2)
        return residual


def _nothing(pieces: RecordPieces, K: int, width: int) -> EndProducts:
    records, channels = len(pieces.ends.lines), len(pieces.ends.rig.channels)
    return EndProducts(
        np.zeros((K, records, pieces.count, width)), np.zeros((K, records, channels, pieces.terms, width))
    )


def _add(of: EndProducts, at: PieceAt, rows: Complex) -> None:
    """Adds the products of one more piece."""
    F, values = _real(at.columns), _real(rows)
    basis = None if at.piece.basis is None else _real(at.piece.basis)
    for record, part in at.piece.segments:
        if record == NO_RECORD:
            continue
        wide = slice(2 * part.start, 2 * part.stop)
        of_record = np.swapaxes(values[..., wide], -1, -2)
        of.columns[:, record] += np.sum(F[..., wide] @ of_record, axis=1)
        if basis is not None:
            of.basis[:, record] += basis[..., wide] @ of_record


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
