"""Lines of whole records in pieces: what stays the same while a search moves through the unknowns.

Lines stand on the last axis throughout, so that every product runs over long rows, and a row of complex numbers read as
twice as many real ones is a row of the real least squares that boundary loads and polynomials are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.estimate.likelihood.boundary_loads import RecordEnds
from dashpot.model.observation import ObservationModel
from dashpot.numerics.projection import independent

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
    columns   (K or 1, channels, polynomials, lines): polynomials that are fitted with the loads, whitened
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
        """Columns that are fitted together: two loads for each coordinate, and polynomials."""
        return 2 * self.ends.rig.model.n + len(self.of_inputs) + len(self.fitted)

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
        return np.concatenate([loads, ends.terms[:, self.of_inputs], ends.terms[:, self.fitted]], axis=1)

    @cached_property
    def apart_used(self) -> Bools:
        """Which polynomials each channel has in each record, taken out of it alone: (records, channels, terms)."""
        ends, channels = self.ends, len(self.ends.rig.channels)
        used = np.zeros((len(ends.lines), channels, self.terms), dtype=bool)
        if self.apart:
            index = np.setdiff1d(np.arange(len(ends.channel)), self.of_inputs)
            used[:, ends.channel[index], np.searchsorted(self.powers, ends.power[index])] = ends.terms[
                :, index
            ]
        return used

    def __iter__(self) -> Iterator[RecordPiece]:
        for number in range(len(self._parts)):
            yield self._kept[number] if self._constant <= KEPT else self._piece(number)

    @property
    def numbers(self) -> int:
        """Complex numbers that all lines take on the way to their slopes."""
        return len(self.ends.rig.omega) * self._each

    @property
    def apart_rank(self) -> Ints:
        """How many polynomials are taken out of single channels, (K or 1,)."""
        return self.orthogonal[1] if self.terms else np.zeros(1, dtype=np.int64)

    @cached_property
    def _kept(self) -> list[RecordPiece]:
        return [self._piece(number) for number in range(len(self._parts))]

    @cached_property
    def _constant(self) -> int:
        """Complex numbers of all pieces."""
        view = self.ends.rig
        each = len(view.channels) * (2 + self.terms + len(self.fitted)) + len(view.model.elements) + 4
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
        view = (
            ends.rig.at_lines(lines)
            if isinstance(lines, slice)
            else replace(ends.rig, omega=ends.rig.omega[lines])
        )
        weights = Weights.of(self.W, self.root, lines)
        y = np.ascontiguousarray(np.swapaxes(self.y[:, lines], -1, -2))
        loaded = np.zeros(len(view.omega), dtype=bool)
        for record, part in segments:
            loaded[part] = record != NO_RECORD and bool(ends.loads[record])
        by_input = ends.by_input[lines][:, :, self.of_inputs] if len(self.of_inputs) else None
        s = ends.s[lines]
        return RecordPiece(
            view, lines, segments, s,
            np.ascontiguousarray(view.rates.T), np.ascontiguousarray(view.model.factors(view.omega).T), weights,
            weights.whitened(y[:, :, None, :])[:, :, 0],
            None if self.q is None else np.ascontiguousarray(np.swapaxes(self.q[:, lines], -1, -2)),
            loaded,
            None if by_input is None else np.moveaxis(by_input, 0, -1),
            self._columns(s, weights) if len(self.fitted) else None,
            self._basis(s, weights, segments) if self.terms else None,
        )  # fmt: skip

    def _columns(self, s: Complex, weights: Weights) -> Complex:
        """Polynomials that are fitted with the loads, whitened."""
        channel, power = self.ends.channel[self.fitted], self.ends.power[self.fitted]
        columns = np.zeros((1, len(self.ends.rig.channels), len(self.fitted), len(s)), dtype=np.complex128)
        columns[0, channel, np.arange(len(self.fitted))] = _powers(s, power)
        return weights.whitened(columns)

    def _basis(self, s: Complex, weights: Weights, segments: tuple[tuple[int, slice], ...]) -> Complex:
        """Orthonormal polynomials of each channel in each record."""
        assert weights.sd is not None
        powers = _powers(s, self.powers) * weights.sd[:, :, None, :]
        basis = np.zeros_like(powers)
        for record, part in segments:
            if record != NO_RECORD:
                basis[..., part] = np.swapaxes(self.orthogonal[0][:, record], -1, -2) @ powers[..., part]
        return basis

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
        used = self.apart_used[None]
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
