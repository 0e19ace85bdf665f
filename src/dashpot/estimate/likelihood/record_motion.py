"""The rig at one piece of a whole record's lines: what its ends add to the channels, what they leave, and slopes.

As `objective.predict` says it line by line, with the lines on the last axis.  A channel's response to a force at a
coordinate is also the adjoint that its slopes are made of, so that boundary loads come for nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.estimate.likelihood.record_pieces import NO_RECORD, RecordPiece, RecordPieces
from dashpot.estimate.likelihood.sampled_loads import SampledLoads
from dashpot.model.dynamics import stiffness_over_lines
from dashpot.model.observation import calibration_factors, calibration_slopes

UNSEEN = 1e-12  # squared, of an input's size: what other inputs leave of it is rounding


@dataclass(frozen=True)
class EstimatedInputs:
    """Inputs that are estimated line by line, of the whitened responses G (K, channels, q, lines).

    basis of G, orthonormal at each line; triangle (K, q, q, lines) with G = basis · triangle; coefficients
    (K, q, columns + 1, lines) of the columns and of the data in that basis
    """

    basis: Complex
    triangle: Complex
    coefficients: Complex

    @staticmethod
    def of(G: Complex, values: Complex) -> EstimatedInputs:
        """By Gram and Schmidt; an input that is not seen beside the others has no direction of its own."""
        basis, count = np.zeros_like(G), G.shape[2]
        triangle = np.zeros((len(G), count, count, G.shape[-1]), dtype=np.complex128)
        for j in range(count):
            left = G[:, :, j]
            for i in range(j):
                triangle[:, i, j] = np.sum(np.conj(basis[:, :, i]) * left, axis=1)
                left = left - basis[:, :, i] * triangle[:, None, i, j]
            square, whole = (np.sum(np.abs(part) ** 2, axis=1) for part in (left, G[:, :, j]))
            seen = square > UNSEEN * whole
            size = np.sqrt(np.where(seen, square, 1.0))
            basis[:, :, j] = np.where(seen[:, None], left / size[:, None], 0.0)
            triangle[:, j, j] = np.where(seen, size, 0.0)
        return EstimatedInputs(basis, triangle, adjoint_times(basis, values))

    def without(self, values: Complex) -> Complex:
        """What the inputs leave of values (K, channels, columns, lines)."""
        return values - times(self.basis, adjoint_times(self.basis, values))

    def amplitudes(self, z: Real) -> Complex:
        """The inputs (K, q, lines) beside columns with the coefficients z (K, columns, lines)."""
        right: Complex = self.coefficients[:, :, -1] - np.sum(
            self.coefficients[:, :, :-1] * z[:, None], axis=2
        )
        q: Complex = np.zeros_like(right)
        for j in reversed(range(right.shape[1])):
            rest = right[:, j] - np.sum(self.triangle[:, j, j + 1 :] * q[:, j + 1 :], axis=1)
            pivot = self.triangle[:, j, j]
            q[:, j] = np.where(pivot != 0, rest / np.where(pivot != 0, pivot, 1.0), 0.0)
        return q


@dataclass(frozen=True)
class PieceAt:
    """One piece at ψ (K, M), whitened, what estimated inputs explain taken out; lines last.

    Z (K, n, n, lines) D⁻¹; driven (K, n, r + s, lines) forces on the coordinates per unit of each input
    by_load (K, channels, n, lines): response to a force at each coordinate, not whitened
    force (K, channels, elements, lines): how channels show unit forces themselves, None where none does
    response (K, channels, r + s + n, lines) to inputs and loads, where calibrations are unknown, else None
    columns (K, channels, f, lines): loads and polynomials; residual (K, channels, lines) of the rig without them
    folded: what sampling adds to the loads, where that is known of a channel
    """

    piece: RecordPiece
    psi: Real
    Z: Complex
    driven: Complex
    by_load: Complex
    force: Complex | None
    response: Complex | None
    inputs: EstimatedInputs | None
    columns: Complex
    residual: Complex
    folded: SampledLoads | None

    def slopes(self, z: Real) -> Complex:
        """∂y/∂ψ under the whole motion with coefficients z (K, f, lines) of the columns: (K, channels, M, lines)."""
        piece, n = self.piece, self.Z.shape[1]
        view = piece.view
        model = view.model
        load = z[:, :n] + piece.s * z[:, n : 2 * n]
        if self.inputs is not None:
            q = self.inputs.amplitudes(z)
        elif piece.by_input is None:
            q = np.broadcast_to(_known(piece), (len(z), *_known(piece).shape[1:]))
        else:
            of_ends = z[:, None, 2 * n : 2 * n + piece.by_input.shape[1]]
            q = _known(piece) + np.sum(piece.by_input * of_ends, axis=2)
        force = load if not q.shape[1] else load + np.sum(self.driven * q[:, None], axis=2)
        X = np.sum(self.Z * force[:, None], axis=2)
        elongation = over_rows(model.B, X)
        if model.D.shape[1]:
            elongation = elongation + over_rows(model.D, q[:, : model.D.shape[1]])
        unit_forces = piece.factors * elongation
        # A change of an unknown is a force on the coordinates, which the channels show as any other: −Bᵀ (T ∘ a).
        pushes = over_rows(model.pushes, unit_forces).reshape(len(z), n, -1, unit_forces.shape[-1])
        J = times(self.by_load, pushes)
        if self.force is not None:
            J = J + over_rows(model.T.T, self.force * unit_forces[:, None])
        if self.folded is not None:
            for record, part in piece.segments_with_loads:
                J[..., part] += self.folded.slopes_at(record, piece.s[part], z[:, : 2 * n, part.start])
        if self.response is not None:
            shown = np.sum(self.response * np.concatenate([q, load], axis=1)[:, None], axis=2)
            by_calibration = calibration_slopes(view, self.psi, np.swapaxes(shown, -1, -2))
            J = np.concatenate([J, np.moveaxis(by_calibration, 1, -1)], axis=2)
        J = piece.weights.whitened(J)
        return J if self.inputs is None else self.inputs.without(J)


def _known(piece: RecordPiece) -> Complex:
    assert piece.q is not None
    return piece.q


def evaluated(pieces: RecordPieces, psi: Real, sign: Real) -> Iterator[PieceAt]:
    """Every piece at ψ (K, M) with signs (K, channels)."""
    folded = pieces.ends.sampled_loads(psi)
    for piece in pieces:
        yield _piece_at(pieces, piece, psi, sign, folded)


def _piece_at(
    pieces: RecordPieces, piece: RecordPiece, psi: Real, sign: Real, folded: SampledLoads | None
) -> PieceAt:
    view, K = piece.view, len(psi)
    model = view.model
    p = model.parameters(psi[:, : view.m])
    n = model.n
    both = stiffness_over_lines(model, p, view.omega)
    Z = _inverse(both[:, :, :n])
    by_load, G = _observed(piece, p, Z)
    force = view.force[:, :, None].astype(np.complex128)[None] if view.has_forces else None
    pushed = np.broadcast_to(model.S[:, :, None], (K, n, model.S.shape[1], both.shape[-1]))
    driven = np.concatenate([-both[:, :, n:], pushed], axis=2) if pushed.shape[2] else -both[:, :, n:]
    if driven.shape[2]:
        G = G + times(by_load, driven)
    response = None
    if view.gains or view.delays or not np.all(sign == 1):
        kappa = np.swapaxes(calibration_factors(view, psi, sign), -1, -2)[:, :, None]
        by_load, G = by_load * kappa, G * kappa
        force = None if force is None else force * kappa
        response = np.concatenate([G, by_load], axis=2) if view.gains or view.delays else None
    F = _masked(_of_ends(piece, by_load, G, folded), pieces, piece)
    data = np.broadcast_to(piece.y[:, :, None], (K, len(view.channels), 1, len(view.omega)))
    G = piece.weights.whitened(G)
    if piece.q is not None:
        known = np.broadcast_to(piece.q, (K, *piece.q.shape[1:]))[:, :, None]
        residual = data - times(G, known) if known.shape[1] else data
        return PieceAt(piece, psi, Z, driven, by_load, force, response, None, F, residual[:, :, 0], folded)
    together = np.concatenate([F, data], axis=2)
    inputs = EstimatedInputs.of(G, together)
    left = together - times(inputs.basis, inputs.coefficients)
    return PieceAt(
        piece, psi, Z, driven, by_load, force, response, inputs, left[:, :, :-1], left[:, :, -1], folded
    )


def _of_ends(piece: RecordPiece, by_load: Complex, G: Complex, folded: SampledLoads | None) -> Complex:
    """Whitened columns of loads and polynomials in all records, (K, channels, f, lines)."""
    loads = np.concatenate([by_load * piece.loaded, (piece.s * piece.loaded) * by_load], axis=2)
    if folded is not None:
        for record, part in piece.segments_with_loads:
            loads[..., part] += folded.at(record, piece.s[part])
    columns = [loads]
    if piece.by_input is not None:
        columns.append(times(G, np.broadcast_to(piece.by_input, (len(by_load), *piece.by_input.shape))))
    white = piece.weights.whitened(np.concatenate(columns, axis=2))
    if piece.columns is None:
        return white
    polynomials = np.broadcast_to(piece.columns, (len(by_load), *piece.columns.shape[1:]))
    return np.concatenate([white, polynomials], axis=2)


def _masked(columns: Complex, pieces: RecordPieces, piece: RecordPiece) -> Complex:
    """The columns with 0 where a record has them not."""
    if np.all(pieces.used) and all(record != NO_RECORD for record, _ in piece.segments):
        return columns
    columns = columns.copy()
    for record, part in piece.segments:
        if record == NO_RECORD:
            columns[..., part] = 0.0
        elif not np.all(pieces.used[record]):
            columns[..., part] *= pieces.used[record][:, None]
    return columns


def _observed(piece: RecordPiece, p: Real, Z: Complex) -> tuple[Complex, Complex]:
    """What the channels show of a force at each coordinate (K, channels, n, lines), and of the inputs themselves
    (K, channels, r + s, lines)."""
    view = piece.view
    model, rates = view.model, piece.rates
    K, n, lines = len(Z), Z.shape[1], Z.shape[-1]
    by_load = over_rows(view.on_x, Z.reshape(K, n, n * lines)).reshape(K, -1, n, lines) * rates[:, None]
    direct = np.repeat((view.on_q[:, :, None] * rates[:, None])[None], K, axis=0)
    if view.has_forces:
        rows = view.force[:, :, None] * (p[:, :, None] * piece.factors)[:, None]
        by_load = by_load + times(over_rows(model.B.T, rows), Z)
        if model.D.shape[1]:
            direct[:, :, : model.D.shape[1]] += over_rows(model.D.T, rows)
    return by_load, direct


def _inverse(D: Complex) -> Complex:
    """D⁻¹ of (K, n, n, lines); infinite or NaN where singular."""
    n = D.shape[1]
    with np.errstate(all="ignore"):
        if n == 1:
            return 1 / D
        if n == 2:
            inverse = np.empty(D.shape, dtype=np.complex128)
            scale = 1 / (D[:, 0, 0] * D[:, 1, 1] - D[:, 0, 1] * D[:, 1, 0])
            inverse[:, 0, 0], inverse[:, 0, 1] = D[:, 1, 1] * scale, -D[:, 0, 1] * scale
            inverse[:, 1, 0], inverse[:, 1, 1] = -D[:, 1, 0] * scale, D[:, 0, 0] * scale
            return inverse
    stacked: Complex = np.ascontiguousarray(np.moveaxis(D, -1, 1))
    try:
        solved: Complex = np.linalg.inv(stacked).astype(np.complex128)
    except np.linalg.LinAlgError:
        regular = np.linalg.slogdet(stacked)[0] != 0
        solved = np.linalg.inv(np.where(regular[..., None, None], stacked, np.nan)).astype(np.complex128)
    return np.ascontiguousarray(np.moveaxis(solved, 1, -1))


# Products with the lines last


def over_rows(matrix: Real, values: Complex) -> Complex:
    """matrix (a, b) times values (..., b, lines), as one product of real numbers."""
    product: Complex = (matrix @ np.ascontiguousarray(values).view(np.float64)).view(np.complex128)
    return product


def times(columns: Complex, coefficients: Complex) -> Complex:
    """Σ_q columns (K, c, q, lines) · coefficients (K, q, f, lines), (K, c, f, lines)."""
    total: Complex = columns[:, :, 0, None] * coefficients[:, None, 0]
    for q in range(1, columns.shape[2]):
        total = total + columns[:, :, q, None] * coefficients[:, None, q]
    return total


def adjoint_times(columns: Complex, values: Complex) -> Complex:
    """Σ_c conj(columns (K, c, q, lines)) · values (K, c, f, lines), (K, q, f, lines)."""
    total: Complex = np.conj(columns[:, 0])[:, :, None] * values[:, 0, None]
    for c in range(1, columns.shape[1]):
        total = total + np.conj(columns[:, c])[:, :, None] * values[:, c, None]
    return total
