"""Passes over the lines of whole records in NumPy, piece by piece: what `record_sums` asks for, in rows of products.

The compiled kernel makes the same passes (`record_sums.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.estimate.likelihood.boundary_loads import RecordEnds, SampledLoads
from dashpot.model.dynamics import stiffness_over_lines
from dashpot.model.observation import ObservationModel, calibration_factors, calibration_slopes
from dashpot.numerics.small_systems import FREE, independent, whitening_steps

# Lines of whole records in pieces: what stays the same while a search moves through the unknowns.
#
# Lines stand on the last axis throughout, so that every product runs over long rows, and a row of complex
# numbers read as twice as many real ones is a row of the real least squares that boundary loads and
# polynomials are.


NUMBERS = 250_000  # complex numbers of a piece, 4 MB: what a processor's cache holds
KEPT = (
    16_000_000  # complex numbers of all pieces, 256 MB, up to which they are kept from one step to the next
)
NO_RECORD = -1


@dataclass(frozen=True)
class Weights:
    """W = Rᴴ R of the channels' noise: `sd` (K or 1, channels, lines), 1/σ, where it is diagonal, else `root` R,
    (K or 1, channels, channels, lines)."""

    sd: Real | None
    root: Complex | None

    @staticmethod
    def of(W: Complex, root: Complex | None, lines: slice | Ints) -> Weights:
        """Those of some lines; W and root (K or 1, lines, channels, channels)."""
        if root is None:
            variance = np.diagonal(W[:, lines], axis1=-2, axis2=-1).real
            return Weights(np.ascontiguousarray(np.swapaxes(np.sqrt(variance), -1, -2)), None)
        return Weights(None, np.ascontiguousarray(np.moveaxis(root[:, lines], 1, -1)))

    def whitened(self, values: Complex) -> Complex:
        """R values, of (K, channels, columns, lines)."""
        if self.sd is not None:
            return values * self.sd[:, :, None, :]
        assert self.root is not None
        out = self.root[:, :, 0, None, :] * values[:, None, 0]
        for c in range(1, values.shape[1]):
            out = out + self.root[:, :, c, None, :] * values[:, None, c]
        return out


@dataclass(frozen=True)
class RecordPiece:
    """Some lines of a spectrum with whole records, whatever the unknowns are.

    view      the channels of the rig at these lines
    segments  (record, lines of the piece): which of the lines are whose; NO_RECORD of settled ones
    s         (lines,) jω over the record's highest ω
    rates     (channels, lines); factors (elements, lines)
    y         (K or 1, channels, lines), whitened
    q         (K or 1, r + s, lines) where exact channels give the inputs, else None
    loaded    (lines,) whether the line's record has boundary loads
    by_input  (r + s, polynomials, lines) of exact inputs that follow from a channel's polynomial, else None
    columns   (K or 1, channels, polynomials + k, lines): those fitted with the loads, and samples that are not
              measured, whitened
    basis     (K or 1, channels, terms, lines): orthonormal polynomials of each channel in each record, taken out first
    """

    view: ObservationModel
    lines: slice | Ints
    segments: tuple[tuple[int, slice], ...]
    s: Complex
    rates: Complex
    factors: Complex
    weights: Weights
    y: Complex
    q: Complex | None
    loaded: Bools
    by_input: Complex | None
    columns: Complex | None
    basis: Complex | None

    @cached_property
    def segments_with_loads(self) -> tuple[tuple[int, slice], ...]:
        """Those of records that have boundary loads."""
        return tuple((record, part) for record, part in self.segments if self.loaded[part.start])


@dataclass(frozen=True)
class RecordPieces:
    """All lines of a spectrum with whole records, in pieces.

    y (K, lines, channels), W (K or 1, lines, channels, channels), root with rootᴴ root = W where W is not diagonal,
    q (K, lines, r + s) or None: as Measured has them.
    """

    ends: RecordEnds
    y: Complex
    W: Complex
    root: Complex | None
    q: Complex | None

    @cached_property
    def apart(self) -> bool:
        """Whether each channel's polynomials can be taken out of it alone: no noise and no input joins channels."""
        return self.root is None and self.q is not None

    @cached_property
    def of_inputs(self) -> Ints:
        """Indices of the polynomials of channels that give exact inputs, (k,)."""
        return np.flatnonzero(np.any(self.ends.by_input != 0, axis=(0, 1)))

    @cached_property
    def fitted(self) -> Ints:
        """Indices of the polynomials fitted with the loads, (k,): of those that each channel has alone none."""
        if self.apart:
            return np.zeros(0, dtype=np.int64)
        silent = set(self.of_inputs.tolist())
        return np.array([k for k in range(len(self.ends.channel)) if k not in silent], dtype=np.int64)

    @property
    def count(self) -> int:
        """Columns fitted together: two loads for each coordinate, polynomials, and samples that are not measured."""
        return 2 * self.ends.rig.model.n + len(self.of_inputs) + len(self.fitted) + self.ends.missing

    @cached_property
    def precision(self) -> Real | None:
        """What is known of the columns beforehand, (records, columns, columns); None if it is nothing."""
        if not self.ends.missing:
            return None
        out = np.zeros((len(self.ends.lines), self.count, self.count))
        first = self.count - self.ends.missing
        for number, of in enumerate(self.ends.unmeasured):
            its = slice(first, first + len(of.channel))
            out[number, its, its] = of.precision
        return out

    @cached_property
    def terms(self) -> int:
        """Polynomials of a channel that are taken out of it alone."""
        return len(self.powers) if self.apart else 0

    @cached_property
    def powers(self) -> Ints:
        """The powers of jω among the polynomials, (k,), ascending."""
        return np.unique(self.ends.power)

    @cached_property
    def used(self) -> Bools:
        """Which columns each record has, (records, columns)."""
        n, ends = self.ends.rig.model.n, self.ends
        loads = np.repeat(ends.loads[:, None], 2 * n, axis=1)
        counts = np.array([len(of.channel) for of in ends.unmeasured])
        its = np.arange(ends.missing) < counts[:, None]
        return np.concatenate([loads, ends.terms[:, self.of_inputs], ends.terms[:, self.fitted], its], axis=1)

    def __iter__(self) -> Iterator[RecordPiece]:
        for number in range(len(self._parts)):
            yield self._kept[number] if self._constant <= KEPT else self._piece(number)

    @property
    def numbers(self) -> int:
        """Complex numbers that all lines take on the way to their slopes."""
        return len(self.ends.rig.omega) * self._each

    @cached_property
    def _kept(self) -> list[RecordPiece]:
        return [self._piece(number) for number in range(len(self._parts))]

    @cached_property
    def _constant(self) -> int:
        """Complex numbers of all pieces."""
        view = self.ends.rig
        fitted = len(self.fitted) + self.ends.missing
        each = len(view.channels) * (2 + self.terms + fitted) + len(view.model.elements) + 4
        return len(view.omega) * each * len(self.W)

    @cached_property
    def _each(self) -> int:
        view = self.ends.rig
        elements, channels = len(view.model.elements), len(view.channels)
        return channels * (2 * elements + 2 * self.count + self.terms + len(view.names)) + 4 * view.model.n**2

    @cached_property
    def compiled(self) -> dict[int, Any]:
        """What the compiled kernel has made of these lines, by kernel."""
        return {}

    @cached_property
    def latest(self) -> dict[str, Any]:
        """What the passes said at the last ψ (`record_sums`)."""
        return {}

    @property
    def owners(self) -> list[tuple[int, Ints]]:
        """The lines of each record, and those of none."""
        outside = np.ones(len(self.ends.rig.omega), dtype=bool)
        for lines in self.ends.lines:
            outside[lines] = False
        return [*enumerate(self.ends.lines), (NO_RECORD, np.flatnonzero(outside))]

    @cached_property
    def _parts(self) -> list[tuple[slice | Ints, tuple[tuple[int, slice], ...]]]:
        """Lines and segments of each piece: records one after another, long ones cut."""
        most = max(1, NUMBERS // self._each)
        parts: list[tuple[slice | Ints, tuple[tuple[int, slice], ...]]] = []
        chosen: list[Ints] = []
        segments: list[tuple[int, slice]] = []
        filled = 0
        for record, lines in self.owners:
            for first in range(0, len(lines), most):
                few = lines[first : first + most]
                if filled + len(few) > most:
                    parts.append((_compact(np.concatenate(chosen)), tuple(segments)))
                    chosen, segments, filled = [], [], 0
                chosen.append(few)
                segments.append((record, slice(filled, filled + len(few))))
                filled += len(few)
        parts.append((_compact(np.concatenate(chosen)), tuple(segments)))
        return parts

    def _piece(self, number: int) -> RecordPiece:
        lines, segments = self._parts[number]
        ends = self.ends
        view = ends.rig.at_lines(lines) if isinstance(lines, slice) else ends.rig.at(lines)
        weights, s = Weights.of(self.W, self.root, lines), ends.s[lines]
        y = np.ascontiguousarray(np.swapaxes(self.y[:, lines], -1, -2))
        loaded = np.zeros(len(view.omega), dtype=bool)
        for record, part in segments:
            loaded[part] = record != NO_RECORD and bool(ends.loads[record])
        by_input = columns = basis = None
        if len(self.of_inputs):
            by_input = np.moveaxis(ends.by_input[lines][:, :, self.of_inputs], 0, -1)
        if len(self.fitted) or ends.missing:  # columns with the loads
            fitted = len(self.fitted)
            columns = np.zeros((1, len(view.channels), fitted + ends.missing, len(s)), dtype=np.complex128)
            powers = _powers(s, ends.power[self.fitted])
            columns[0, ends.channel[self.fitted], np.arange(fitted)] = powers
            numbers = np.arange(len(ends.s))[lines]
            for record, part in segments:
                if record != NO_RECORD and len(ends.unmeasured[record].channel):
                    of, at = ends.unmeasured[record], np.searchsorted(ends.lines[record], numbers[part])
                    its = fitted + np.arange(len(of.channel))
                    columns[0, of.channel[:, None], its[:, None], np.arange(len(s))[part]] = of.columns[at].T
            columns = weights.whitened(columns)
        if self.terms:  # orthonormal polynomials of each channel in each record
            assert weights.sd is not None
            powers = _powers(s, self.powers) * weights.sd[:, :, None, :]
            basis = np.zeros_like(powers)
            for record, part in segments:
                if record != NO_RECORD:
                    basis[..., part] = np.swapaxes(self.orthogonal[0][:, record], -1, -2) @ powers[..., part]
        return RecordPiece(
            view,
            lines,
            segments,
            s,
            np.ascontiguousarray(view.rates.T),
            np.ascontiguousarray(view.factors.T),
            weights,
            weights.whitened(y[:, :, None, :])[:, :, 0],
            None if self.q is None else np.ascontiguousarray(np.swapaxes(self.q[:, lines], -1, -2)),
            loaded,
            by_input,
            columns,
            basis,
        )

    @cached_property
    def orthogonal(self) -> tuple[Real, Ints]:
        """What makes the polynomials orthonormal over the lines of each record, (K or 1, records, channels, terms,
        terms), and how many there are, (K or 1,)."""
        ends, channels = self.ends, len(self.ends.rig.channels)
        products = np.zeros((len(self.W), len(ends.lines), channels, self.terms, self.terms))
        # Re(conj(jσ)ᵖ (jσ)^q) is σ^(p + q) or its negative, and 0 where only one of the powers is odd.
        apart = self.powers - self.powers[:, None]
        turn = np.where(apart % 2 == 0, 1 - np.abs(apart) % 4, 0)
        height, of = np.unique(self.powers + self.powers[:, None], return_inverse=True)
        for record, lines in enumerate(ends.lines):
            for first in range(0, len(lines), NUMBERS // 10):
                few = lines[first : first + NUMBERS // 10]
                weight = np.diagonal(self.W[:, few], axis1=-2, axis2=-1).real
                moments = np.swapaxes(weight, -1, -2) @ ends.s[few, None].imag ** height
                products[:, record] += turn * moments[..., of.reshape(turn.shape)]
        # Which polynomials each channel has in each record: (records, channels, terms)
        alone = np.setdiff1d(np.arange(len(ends.channel)), self.of_inputs)
        used = np.zeros(products.shape[1:-1], dtype=bool)
        used[:, ends.channel[alone], np.searchsorted(self.powers, ends.power[alone])] = ends.terms[:, alone]
        products = np.where(used[..., :, None] & used[..., None, :], products, 0.0)
        B, rank = independent(products)
        return B, np.sum(rank, axis=(1, 2))


def _powers(s: Complex, powers: Ints) -> Complex:
    """Powers of s, (powers, lines); 0 at lines of no record, where s is 0."""
    inside = s != 0
    safe = np.where(inside, s, 1.0)
    return np.ascontiguousarray(np.where(inside, safe ** powers[:, None], 0.0))


def _compact(lines: Ints) -> slice | Ints:
    """Lines that follow each other as a slice, which copies nothing."""
    first, last = int(lines[0]), int(lines[-1])
    return slice(first, last + 1) if np.array_equal(lines, np.arange(first, last + 1)) else lines


# The rig at one piece of a whole record's lines: what its ends add to the channels, what they leave, and
# slopes.
#
# As `objective.predict` says it line by line, with the lines on the last axis. A channel's response to a
# force at a coordinate is also the adjoint that its slopes are made of, so that boundary loads come for
# nothing.


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
        """By Gram and Schmidt; an input that cannot be told from the others has no direction of its own."""
        basis, count = np.zeros_like(G), G.shape[2]
        triangle = np.zeros((len(G), count, count, G.shape[-1]), dtype=np.complex128)
        for j in range(count):
            left = G[:, :, j]
            for i in range(j):
                triangle[:, i, j] = np.sum(np.conj(basis[:, :, i]) * left, axis=1)
                left = left - basis[:, :, i] * triangle[:, None, i, j]
            square, whole = (np.sum(np.abs(part) ** 2, axis=1) for part in (left, G[:, :, j]))
            # 1e-12, squared, of an input's size: what other inputs leave of it is rounding
            seen = square > 1e-12 * whole
            size = np.sqrt(np.where(seen, square, 1.0))
            basis[:, :, j] = np.where(seen[:, None], left / size[:, None], 0.0)
            triangle[:, j, j] = np.where(seen, size, 0.0)
        return EstimatedInputs(basis, triangle, adjoint_times(basis, values))

    def without(self, values: Complex) -> Complex:
        """What the inputs leave of values (K, channels, columns, lines)."""
        return values - columns_times(self.basis, adjoint_times(self.basis, values))

    def amplitudes(self, z: Real) -> Complex:
        """The inputs (K, q, lines), given the columns with the coefficients z (K, columns, lines)."""
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
        pushes = over_rows(model.pushes, unit_forces).reshape(
            len(z), n, model.T.shape[1], unit_forces.shape[-1]
        )
        J = columns_times(self.by_load, pushes)
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
    both = stiffness_over_lines(model, p, view.omega, view.experiment)
    Z = _inverse(both[:, :, :n])
    by_load, G = _observed(piece, p, Z)
    force = view.force[:, :, None].astype(np.complex128)[None] if view.has_forces else None
    pushed = np.broadcast_to(model.S[:, :, None], (K, n, model.S.shape[1], both.shape[-1]))
    driven = np.concatenate([-both[:, :, n:], pushed], axis=2) if pushed.shape[2] else -both[:, :, n:]
    if driven.shape[2]:
        G = G + columns_times(by_load, driven)
    response = None
    if view.gains or view.delays or not np.all(sign == 1):
        kappa = np.swapaxes(calibration_factors(view, psi, sign), -1, -2)[:, :, None]
        by_load, G = by_load * kappa, G * kappa
        force = None if force is None else force * kappa
        response = np.concatenate([G, by_load], axis=2) if view.gains or view.delays else None
    F = _of_ends(pieces, piece, by_load, G, folded)
    data = np.broadcast_to(piece.y[:, :, None], (K, len(view.channels), 1, len(view.omega)))
    G = piece.weights.whitened(G)
    if piece.q is not None:
        known = np.broadcast_to(piece.q, (K, *piece.q.shape[1:]))[:, :, None]
        residual = data - columns_times(G, known) if known.shape[1] else data
        return PieceAt(piece, psi, Z, driven, by_load, force, response, None, F, residual[:, :, 0], folded)
    together = np.concatenate([F, data], axis=2)
    inputs = EstimatedInputs.of(G, together)
    left = together - columns_times(inputs.basis, inputs.coefficients)
    return PieceAt(
        piece, psi, Z, driven, by_load, force, response, inputs, left[:, :, :-1], left[:, :, -1], folded
    )


def _of_ends(
    pieces: RecordPieces, piece: RecordPiece, by_load: Complex, G: Complex, folded: SampledLoads | None
) -> Complex:
    """Whitened columns of loads and polynomials in all records, (K, channels, f, lines), 0 where one lacks them."""
    loads = np.concatenate([by_load * piece.loaded, (piece.s * piece.loaded) * by_load], axis=2)
    if folded is not None:
        for record, part in piece.segments_with_loads:
            loads[..., part] += folded.at(record, piece.s[part])
    columns = [loads]
    if piece.by_input is not None:
        columns.append(
            columns_times(G, np.broadcast_to(piece.by_input, (len(by_load), *piece.by_input.shape)))
        )
    white = piece.weights.whitened(np.concatenate(columns, axis=2))
    if piece.columns is not None:
        polynomials = np.broadcast_to(piece.columns, (len(by_load), *piece.columns.shape[1:]))
        white = np.concatenate([white, polynomials], axis=2)
    for record, part in piece.segments:
        if record == NO_RECORD:
            white[..., part] = 0.0
        elif not np.all(pieces.used[record]):
            white[..., part] *= pieces.used[record][:, None]
    return white


def _observed(piece: RecordPiece, p: Real, Z: Complex) -> tuple[Complex, Complex]:
    """What the channels show of a force at each coordinate (K, channels, n, lines), and of the inputs themselves
    (K, channels, r + s, lines)."""
    view = piece.view
    model, rates = view.model, piece.rates
    K, n, lines = len(Z), Z.shape[1], Z.shape[-1]
    shown = over_rows(view.on_x, Z.reshape(K, n, n * lines))
    by_load = shown.reshape(K, len(view.on_x), n, lines) * rates[:, None]
    direct = np.repeat((view.on_q[:, :, None] * rates[:, None])[None], K, axis=0)
    if view.has_forces:
        rows = view.force[:, :, None] * (p[:, :, None] * piece.factors)[:, None]
        by_load = by_load + columns_times(over_rows(model.B.T, rows), Z)
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
    return (matrix @ np.ascontiguousarray(values).view(np.float64)).view(np.complex128)


def columns_times(columns: Complex, coefficients: Complex) -> Complex:
    """Σ_q columns (K, c, q, lines) · coefficients (K, q, f, lines), (K, c, f, lines)."""
    shape = (*columns.shape[:2], coefficients.shape[2], columns.shape[-1])
    total: Complex = np.zeros(shape, dtype=np.complex128)
    for q in range(columns.shape[2]):
        total += columns[:, :, q, None] * coefficients[:, None, q]
    return total


def adjoint_times(columns: Complex, values: Complex) -> Complex:
    """Σ_c conj(columns (K, c, q, lines)) · values (K, c, f, lines), (K, q, f, lines)."""
    total: Complex = np.conj(columns[:, 0])[:, :, None] * values[:, 0, None]
    for c in range(1, columns.shape[1]):
        total = total + np.conj(columns[:, c])[:, :, None] * values[:, c, None]
    return total


@dataclass(frozen=True)
class EndsFitted:
    """What the first pass found of each record's ends.

    z (K, records, f) coefficients of loads and the other columns, t (K, records, channels, terms) of each channel's own
    polynomials; B (K, records, f, f) makes what those leave of the columns orthonormal, with what is known of them
    beforehand; shared (K, records, channels, terms, f): how the columns stand in the channel's own polynomials
    side (K, records, f), own (K, records, channels, terms): products of the residual, from which z and t are made
    others (K,): rank without the columns of samples that are not measured
    """

    pieces: RecordPieces
    z: Real
    t: Real
    B: Real
    shared: Real
    side: Real
    own: Real
    others: Ints

    @cached_property
    def steps(self) -> tuple[Real, Real | float]:
        """B and step of each of its directions by which what is left is white (`whitening_steps`)."""
        known = self.pieces.precision
        return (self.B, 1.0) if known is None else whitening_steps(self.B, known)

    @property
    def rank(self) -> Ints:
        """How many degrees of freedom the columns take, (K,): those of samples that are partly known take none."""
        if not self.pieces.ends.missing:
            return self.others
        count = sum(len(of.channel) for of in self.pieces.ends.unmeasured)
        return self.others + count - np.sum(np.less_equal(self.steps[1], FREE), axis=(-2, -1))

    def whitening(self, side: Real, own: Real) -> tuple[Real, Real]:
        """Coefficients (K, records, f, w) of columns with such products with rows, and of the polynomials, by which
        what is left of the rows is white."""
        B, step = self.steps
        along = np.swapaxes(B, -1, -2) @ side
        z = B @ (along * np.broadcast_to(step, along.shape[:-1])[..., None])
        return z, own - self.shared @ z[:, :, None]

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
        return self.columns - np.sum(np.swapaxes(shared, -1, -2) @ self.basis, axis=2)

    def explained(self, fit: EndsFitted) -> Real:
        """What the columns of all records explain of the products of the rows with each other, (K, w, w)."""
        projected = np.swapaxes(fit.B, -1, -2) @ self.left(fit.shared)
        by_basis = np.sum(np.swapaxes(self.basis, -1, -2) @ self.basis, axis=(1, 2))
        return np.sum(np.swapaxes(projected, -1, -2) @ projected, axis=1) + by_basis

    def coefficients(self, fit: EndsFitted) -> tuple[Real, Real]:
        """Of the columns (K, records, f, w) and of the channels' own polynomials (K, records, channels, terms, w)."""
        return fit.whitening(self.left(fit.shared), self.basis)


@dataclass(frozen=True)
class NumpyPasses:
    """Passes over all lines at ψ (K, M) with signs (K, channels)."""

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
        """Products with the columns themselves and, last, the residual of the rig without its ends: w = f + 1."""
        of = _nothing(self.pieces, len(self.psi), self.pieces.count + 1)
        for at in self._each():
            _add(of, at, np.concatenate([at.columns, at.residual[:, :, None]], axis=2))
        return of

    def of_slopes(self, fit: EndsFitted) -> tuple[Real, EndProducts]:
        """Products (K, w, w) of slopes and, last, residual under the whole motion; with the columns: w = M + 1."""
        K, M = self.psi.shape
        products, of = np.zeros((K, M + 1, M + 1)), _nothing(self.pieces, K, M + 1)
        for at in self._each():
            rows = _slopes_and_residual(at, fit)
            real = _real(rows)
            products += np.sum(real @ np.swapaxes(real, -1, -2), axis=1)
            _add(of, at, rows)
        return products, of

    def by_line(self, fit: EndsFitted, z: Real, t: Real) -> tuple[Real, Real, Real]:
        """Information (K, lines, M, M), minus half the slope and cost of each line, of what the ends with coefficients
        z (K, records, f, M + 1) and t (K, records, channels, terms, M + 1) leave of slopes and residual."""
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
        """Whitened residuals of the whole motion, (K, lines, channels)."""
        ends = self.pieces.ends
        residual = np.empty((len(self.psi), len(ends.rig.omega), len(ends.rig.channels)), dtype=np.complex128)
        for at in self._each():
            left = (
                at.residual
                - _at_ends(at.piece, at.columns, *fit.whitening(fit.side[..., None], fit.own[..., None]))[
                    :, :, 0
                ]
            )
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
    """Slopes under the whole motion and the residual without its loads, (K, channels, M + 1, lines)."""
    K, f = len(at.psi), fit.z.shape[-1]
    z = np.zeros((K, f, len(at.piece.s)))
    for record, part in at.piece.segments:
        if record != NO_RECORD:
            z[..., part] = fit.z[:, record, :, None]
    # What is known of samples that are not measured counts with the products of the rows: they stay in
    z_free = np.array(fit.z[..., None])
    z_free[:, :, f - fit.pieces.ends.missing :] = 0.0
    ends = _at_ends(at.piece, at.columns, z_free, fit.t[..., None])
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
    return np.ascontiguousarray(values).view(np.float64)
