"""Cost, slope and information of whole records: two passes over their lines, in memory that does not grow with them.

The first pass fits the loads and polynomials of each record to what the rig's own motion leaves; the second takes the
slopes under the whole motion, loads included, and what the same columns explain of them.  `objective.predict` says the
same line by line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.measured import kernel_channels
from dashpot.estimate.likelihood.record_passes import EndProducts, EndsFitted, NumpyPasses, RecordPieces
from dashpot.model.dynamics import kernel_rig
from dashpot.model.observation import calibrated_transfer
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.small_systems import independent, with_known_last

# The passes over the lines of whole records in the compiled kernel: twins of those in `record_passes.py`.


def compiled_passes(pieces: RecordPieces, psi: Real, sign: Real) -> CompiledPasses | None:
    """The kernel's passes at ψ (K, M) with signs (K, channels); None if NumPy is to do the work or must."""
    core = kernel()
    # Kernels before 0.2 know settled lines only, and none samples that are not measured.
    if core is None or not hasattr(core, "Records") or pieces.ends.missing:
        return None
    if id(core) not in pieces.compiled:
        pieces.compiled[id(core)] = _records(core, pieces)
    records = pieces.compiled[id(core)]
    return None if records is None else CompiledPasses(records, pieces, np.array(psi), np.array(sign))


@dataclass(frozen=True)
class CompiledPasses:
    """Those of the kernel, which knows powers of jω where NumPy has orthonormal polynomials."""

    records: Any
    pieces: RecordPieces
    psi: Real
    sign: Real

    def of_columns(self) -> EndProducts:
        """As of `NumpyPasses`."""
        columns, basis = self.records.columns(self.psi, self.sign, self._folded, threads())
        return self._products(columns[:, :, :-1], basis)

    def of_slopes(self, fit: EndsFitted) -> tuple[Real, EndProducts]:
        """As of `NumpyPasses`."""
        products, columns, basis = self.records.slopes(*self._under(fit), self._folded_slopes(fit), threads())
        return products, self._products(columns, basis)

    def by_line(self, fit: EndsFitted, z: Real, t: Real) -> tuple[Real, Real, Real]:
        """As of `NumpyPasses`."""
        information, scores, cost = self.records.by_line(
            *self._under(fit), self._folded_slopes(fit), _numbers(z), self._of_powers(t), threads()
        )
        return information, scores, cost

    def residuals(self, fit: EndsFitted) -> Complex:
        """As of `NumpyPasses`."""
        return self.records.residuals(*self._under(fit), threads())

    def _under(self, fit: EndsFitted) -> tuple[Real, Real, Real | None, Real, Real]:
        """ψ, signs, what sampling folds back, and the coefficients of the ends."""
        t = self._of_powers(fit.t[..., None])
        return self.psi, self.sign, self._folded, _numbers(fit.z), t

    def _products(self, columns: Real, of_powers: Real) -> EndProducts:
        """With the orthonormal polynomials, from those with powers (K, records, channels, terms, w)."""
        if not self.pieces.terms:
            return EndProducts(columns, of_powers)
        return EndProducts(columns, np.swapaxes(self.pieces.orthogonal[0], -1, -2) @ of_powers)

    def _of_powers(self, t: Real) -> Real:
        """Coefficients of powers from those of the orthonormal polynomials (K, records, channels, terms, w)."""
        return _numbers(self.pieces.orthogonal[0] @ t if self.pieces.terms else t)

    @cached_property
    def _sampled(self) -> Any:
        return self.pieces.ends.sampled_loads(self.psi)

    @cached_property
    def _folded(self) -> Real | None:
        """What sampling adds to the loads, (K, records, channels, 2, n, powers)."""
        if self._sampled is None:
            return None
        return _numbers(np.transpose(self._sampled.terms, (0, 1, 4, 2, 5, 3)))

    def _folded_slopes(self, fit: EndsFitted) -> Real | None:
        """The same by the unknowns of the rig, under the loads: (K, records, channels, unknowns, powers)."""
        if self._sampled is None:
            return None
        n = self.pieces.ends.n
        loads = fit.z[..., : 2 * n].reshape(*fit.z.shape[:2], 2, n)
        return _numbers(np.einsum("krlpcjm,krlj->krcmp", self._sampled.slopes, loads))


def _records(core: Any, pieces: RecordPieces) -> Any | None:
    """The kernel's view of the records; None if it does not know the rig."""
    ends = pieces.ends
    view = ends.rig
    owners = [(record, lines) for record, lines in pieces.owners if len(lines)]
    # 8: lines that the kernel may take at once: records are filled up to a multiple
    spare = [-len(lines) % 8 for _, lines in owners]
    index = np.concatenate(
        [np.pad(lines, (0, s), "edge") for (_, lines), s in zip(owners, spare, strict=True)]
    )
    line = np.concatenate(
        [np.pad(lines, (0, s), constant_values=-1) for (_, lines), s in zip(owners, spare, strict=True)]
    )
    start = np.cumsum([0, *(len(lines) + s for (_, lines), s in zip(owners, spare, strict=True))])
    rig = kernel_rig(
        core, view.model, view.omega[index], None if view.experiment is None else view.experiment[index]
    )
    if rig is None:
        return None
    inside = line >= 0
    sd = root = None
    if pieces.root is None:
        variance = np.diagonal(pieces.W, axis1=-2, axis2=-1).real[:, index]
        sd = _numbers(np.swapaxes(np.sqrt(variance), -1, -2) * inside)
    else:
        root = _planar(np.moveaxis(pieces.root[:, index], 1, -1) * inside)
    by_input = None
    if len(pieces.of_inputs):
        by_input = _planar(np.moveaxis(ends.by_input[index][:, :, pieces.of_inputs], 0, -1))
    powers = pieces.powers if pieces.terms else np.zeros(0, dtype=np.int64)
    return core.Records(
        rig, start, np.array([record for record, _ in owners], dtype=np.int64), line, _numbers(ends.s[index].imag),
        ends.loads, np.ascontiguousarray(pieces.used), by_input, ends.channel[pieces.fitted],
        ends.power[pieces.fitted], powers, _planar(np.swapaxes(pieces.y[:, index], -1, -2)), sd, root,
        None if pieces.q is None else _planar(np.swapaxes(pieces.q[:, index], -1, -2)), *kernel_channels(view),
    )  # fmt: skip


def _planar(values: Complex) -> Real:
    """Complex numbers (…, lines) as real parts and imaginary ones, (…, 2, lines)."""
    return np.stack([values.real, values.imag], axis=-2)


def _numbers(values: Real | Ints) -> Real:
    return np.ascontiguousarray(values, dtype=np.float64)


Passes = NumpyPasses | CompiledPasses


@dataclass(frozen=True)
class RecordSums:
    """Cost (K,), minus half its slope (K, M) and information (K, M, M) of all lines at K values of ψ, priors left
    out."""

    cost: Real
    gradient: Real
    information: Real


def record_sums(pieces: RecordPieces, psi: Real, sign: Real) -> RecordSums:
    """Both passes at ψ (K, M) with signs (K, channels)."""
    passes = _passes(pieces, psi, sign)
    fit, (products, of_ends) = _fit(pieces, passes), _slopes(pieces, passes)
    left = 2 * (products - of_ends.explained(fit))
    M = psi.shape[-1]
    # Where the ends explain more than there is, what is left is rounding of numbers that are far too large.
    lost = left[:, M, M] < -1e-6 * products[:, M, M]
    return RecordSums(np.where(lost, np.inf, left[:, M, M]), left[:, :M, M], left[:, :M, :M])


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


def shown_by_ends(pieces: RecordPieces, psi: Real, sign: Real) -> Complex:
    """Loads, polynomials and errors of samples that are not measured, as they fit best at ψ (K, M) with signs
    (K, channels), in the channels: (K, lines, channels), 0 at settled lines.

    What `objective.predict` calls `at_ends`; for rigs that are `small`.  Some lines at a time.
    """
    ends, n = pieces.ends, pieces.ends.n
    fit, first_input = ends_fitted(pieces, psi, sign), 2 * n + len(pieces.of_inputs)
    loads = np.zeros((*fit.z.shape[:2], ends.count))  # and polynomials, in the order of the ends
    loads[..., : 2 * n] = fit.z[..., : 2 * n]
    loads[..., 2 * n + pieces.of_inputs] = fit.z[..., 2 * n : first_input]
    loads[..., 2 * n + pieces.fitted] = fit.z[..., first_input : first_input + len(pieces.fitted)]
    if pieces.terms:
        powers = (pieces.orthogonal[0] @ fit.t[..., None])[..., 0]
        alone = np.setdiff1d(np.arange(len(ends.channel)), pieces.of_inputs)
        order = np.searchsorted(pieces.powers, ends.power[alone])
        loads[..., 2 * n + alone] = powers[:, :, ends.channel[alone], order]
    folded = ends.sampled_loads(psi)
    out = np.zeros((len(psi), len(ends.s), len(ends.rig.channels)), dtype=np.complex128)
    for record, lines in enumerate(ends.lines):
        of_record = loads[:, record]
        for at in np.split(lines, range(20_000, len(lines), 20_000)):
            s = ends.s[at]
            view = ends.view.at(at)
            G, by_load = np.split(calibrated_transfer(view, psi, sign).G, [ends.inputs], axis=-1)
            load = of_record[:, None, :n] + s[:, None] * of_record[:, None, n : 2 * n]
            shown = np.einsum("klcj,klj->klc", by_load, load)
            shown += np.einsum("klcq,lqp,kp->klc", G, ends.by_input[at], of_record[:, 2 * n :], optimize=True)
            for k, (channel, power) in enumerate(zip(ends.channel, ends.power, strict=True)):
                shown[..., channel] += s**power * of_record[:, None, 2 * n + k]
            if folded is not None and ends.loads[record]:
                shown += np.einsum("kcjl,kj->klc", folded.at(record, s), of_record[:, : 2 * n])
            out[:, at] = shown
        of = ends.unmeasured[record]
        errors = fit.z[:, record, pieces.count - ends.missing :][:, : len(of.channel)]
        out[:, lines] += np.einsum("lcz,kz->klc", of.in_channels(out.shape[2]), errors)
    return out


def information_under(pieces: RecordPieces, psi: Real, sign: Real, ends: EndsFitted) -> Real:
    """Information (K, M, M) of all lines, were the motion that of such ends."""
    products, of_ends = _passes(pieces, psi, sign).of_slopes(ends)
    M = psi.shape[-1]
    return 2 * (products - of_ends.explained(ends))[:, :M, :M]


def _passes(pieces: RecordPieces, psi: Real, sign: Real) -> Passes:
    passes: Passes = compiled_passes(pieces, psi, sign) or NumpyPasses(pieces, psi, sign)
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
            f, of = pieces.count, passes.of_columns()
            shared = of.basis[..., :f]
            left, known = of.left(shared), pieces.precision
            size = np.diagonal(of.columns[..., :f], axis1=-2, axis2=-1)
            if known is None:
                B, rank = independent(left[..., :f], size)
            else:
                B, rank = with_known_last(left[..., :f], size, known, pieces.ends.missing)
            total = np.sum(rank, axis=-1) + (pieces.orthogonal[1] if pieces.terms else 0)
            side, own = left[..., f], of.basis[..., f]
            z = (B @ (np.swapaxes(B, -1, -2) @ side[..., None]))[..., 0]
            t = own - (shared @ z[:, :, None, :, None])[..., 0]
            pieces.latest["fit"] = EndsFitted(pieces, z, t, B, shared, side, own, total)
    return pieces.latest["fit"]


def _slopes(pieces: RecordPieces, passes: Passes) -> tuple[Real, EndProducts]:
    """What the second pass says; far from any rig it may not be finite."""
    if "slopes" not in pieces.latest:
        fit = _fit(pieces, passes)
        with np.errstate(over="ignore", invalid="ignore"):
            pieces.latest["slopes"] = passes.of_slopes(fit)
    return pieces.latest["slopes"]
