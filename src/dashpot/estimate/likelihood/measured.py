"""Measured amplitudes as the likelihood takes them: in chunks that fit the cache, or as the kernel sees them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.boundary_loads import RecordEnds
from dashpot.estimate.likelihood.record_passes import RecordPieces
from dashpot.model.dynamics import kernel_rig
from dashpot.model.observation import ObservationModel, small
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.levenberg_marquardt import QuadraticModel

if TYPE_CHECKING:
    from dashpot.estimate.nonlinear.objective import NonlinearPart

# Chunks of starts, repeats and lines: what is summed over lines is summed piece by piece, so that memory is bounded.
#
# A search from many starts evaluates many rigs at many lines at once; its arrays would grow with both.  Pieces of a few
# megabytes stay in the processor's cache as well.

PIECE = 500_000  # complex numbers that a piece works on at once, 8 MB


@dataclass(frozen=True)
class Measured:
    """Amplitudes of K repeats, arranged for the likelihood.

    y (K, lines, channels), 0 where not measured; W (K or 1, lines, channels, channels) the inverse covariance, 0
    where not measured; q (K, lines, r + s) where exact channels give the inputs, else None; `rows` real equations.
    `ends`: the columns that whole records bring; `root` with rootᴴ root = W where there are whole records and W is not
    diagonal.
    """

    y: Complex
    W: Complex
    q: Complex | None
    rows: int
    ends: RecordEnds | None = None
    root: Complex | None = None
    nonlinear: NonlinearPart | None = None

    @cached_property
    def record_pieces(self) -> RecordPieces:
        """The lines of whole records as their sums go through them; there must be some."""
        assert self.ends is not None
        return RecordPieces(self.ends, self.y, self.W, self.root, self.q)

    @cached_property
    def compiled(self) -> dict[object, tuple[Any, object]]:
        """What the compiled kernel has made of these data, by kernel and view."""
        return {}

    def pick(self, rows: Ints | slice) -> Measured:
        """Some of the repeats; the only one serves many starts."""
        if len(self.y) == 1:
            return self
        W = self.W if len(self.W) == 1 else self.W[rows]
        root = self.root if self.root is None or len(self.root) == 1 else self.root[rows]
        q = None if self.q is None else self.q[rows]
        part = None if self.nonlinear is None else self.nonlinear.pick(np.arange(len(self.y))[rows])
        return Measured(self.y[rows], W, q, self.rows, self.ends, root, part)

    def with_noise(self, size: Real) -> Measured:
        """With the covariance of each repeat multiplied by `size` (K,)."""
        size = size[:, None, None, None]
        return replace(self, W=self.W / size, root=None if self.root is None else self.root / np.sqrt(size))

    def rows_of(self, count: int) -> Ints:
        """Which repeat each of `count` parameter sets belongs to, (count,): its own, or the only one."""
        return np.arange(count) if len(self.y) > 1 else np.zeros(count, dtype=np.int64)

    def at_lines(self, lines: slice) -> Measured:
        """Some of the lines; not of whole records and of nonlinear rigs, whose lines belong together."""
        q = None if self.q is None else self.q[:, lines]
        return replace(self, y=self.y[:, lines], W=self.W[:, lines], q=q)


@dataclass(frozen=True)
class Piece:
    """Some rows (starts or repeats) at some lines."""

    rows: slice
    lines: slice
    view: ObservationModel
    data: Measured


def pieces(view: ObservationModel, data: Measured, count: int) -> Iterator[Piece]:
    """`count` rows at all lines in pieces of at most PIECE numbers.

    Rows are shared out first: the sum over the lines of one row stays in one piece as long as that fits.
    """
    total = len(view.omega)
    if data.nonlinear is not None:  # its dwells are computed one after the other anyway
        yield Piece(slice(0, count), slice(0, total), view, data)
        return
    # Complex numbers that one row at one line takes on the way to its slopes
    model, channels, elements = view.model, len(view.channels), len(view.model.elements)
    sides = channels + int(model.D.shape[1] + model.S.shape[1])
    if view.reduced is not None:
        k = view.reduced.size
        each = 3 * k * (k + sides) + channels * 4 * len(view.names)
    else:
        system = 3 * model.n * (model.n + sides) if small(model) else 2 * model.n * sides
        each = system + 2 * elements * sides + channels * (elements + 4 * len(view.names))
    # Lines of whole records belong together: what sums them cuts them itself.
    together = total if data.ends is not None else max(1, min(total, PIECE // each))
    rows = max(1, PIECE // (each * together))
    for row in range(0, count, rows):
        part = data if count <= rows else data.pick(slice(row, row + rows))
        for line in range(0, total, together):
            lines = slice(line, min(line + together, total))
            whole = together == total
            yield Piece(
                slice(row, min(row + rows, count)),
                lines,
                view if whole else view.at_lines(lines),
                part if whole else part.at_lines(lines),
            )


class Sums:
    """Sums over all lines of what its pieces give, (K, …) each: `totals` after the last `add`."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.totals: tuple[Real, ...] = ()

    def add(self, rows: slice, terms: tuple[Real, ...]) -> None:
        """The terms of one piece for some of the K rows."""
        if not self.totals and len(terms[0]) == self.count:
            self.totals = terms
            return
        if not self.totals:
            self.totals = tuple(np.zeros((self.count, *term.shape[1:])) for term in terms)
        for total, term in zip(self.totals, terms, strict=True):
            total[rows] += term


def compiled_output(view: ObservationModel, data: Measured) -> Any | None:
    """The kernel's view of the channels, made once for each `data`; None if NumPy is to do the work or must.

    This part of the kernel knows small linear rigs; nonlinear ones (`nonlinear/objective.py`) and whole records
    (`record_sums.py`) have parts of their own.
    """
    core = kernel()
    if core is None or data.ends is not None or data.nonlinear is not None or not small(view.model):
        return None
    cache = data.compiled
    key = (id(core), id(view))
    if key not in cache:
        cache.clear()
        output, rig = None, None
        if len(view.omega):
            rig = kernel_rig(core, view.model, view.omega, view.experiment)
        if rig is not None:
            q = None if data.q is None else np.ascontiguousarray(data.q)
            measured = np.ascontiguousarray(data.y), np.ascontiguousarray(data.W), q
            output = core.Output(rig, *measured, *kernel_channels(view))
        cache[key] = output, view
    return cache[key][0]


def kernel_channels(view: ObservationModel) -> tuple[Any, ...]:
    """What the channels show and the priors of ψ, in the kernel's order."""
    shown = view.derivative, view.on_x, view.on_q, view.force, view.gain, view.delay
    return *shown, bool(np.any(view.flips)), view.prior_precision, view.prior_mean


def compiled_local(
    output: Any, psi: Real, sign: Real, rows: Ints, weight: Real | None = None
) -> QuadraticModel:
    """Cost, slope and curvature at ψ (K, M) in the data of `rows`; of logarithms where they have a `weight`."""
    cost, gradient, information = output.evaluate(
        _numbers(psi), _numbers(sign), rows, weight, True, threads()
    )
    return QuadraticModel(cost, gradient, information, information)


def compiled_cost(output: Any, psi: Real, sign: Real, rows: Ints, weight: Real | None = None) -> Real:
    """The cost alone, (K,)."""
    return output.evaluate(_numbers(psi), _numbers(sign), rows, weight, False, threads())[0]


def _numbers(values: Real) -> Real:
    return np.ascontiguousarray(values, dtype=np.float64)
