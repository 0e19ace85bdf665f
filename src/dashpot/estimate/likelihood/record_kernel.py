"""The passes over the lines of whole records in the compiled kernel: twins of those in `record_passes.py`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.estimate.likelihood.compiled import kernel_channels
from dashpot.estimate.likelihood.record_passes import EndProducts, EndsFitted
from dashpot.estimate.likelihood.record_pieces import RecordPieces
from dashpot.model.kernel_rig import kernel_rig
from dashpot.numerics.kernel import kernel, threads

LANES = 8  # lines that the kernel may take at once: records are filled up to a multiple


def compiled_passes(pieces: RecordPieces, psi: Real, sign: Real) -> CompiledPasses | None:
    """The kernel's passes at ψ (K, M) with signs (K, channels); None where NumPy is to do the work or must."""
    core = kernel()
    # Kernels before 0.2 know settled lines only.
    if core is None or not hasattr(core, "Records"):
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
        """As `Passes` says."""
        columns, basis = self.records.columns(self.psi, self.sign, self._folded, threads())
        return self._products(columns[:, :, :-1], basis)

    def of_slopes(self, fit: EndsFitted) -> tuple[Real, EndProducts]:
        """As `Passes` says."""
        products, columns, basis = self.records.slopes(*self._under(fit), self._folded_slopes(fit), threads())
        return products, self._products(columns, basis)

    def by_line(self, fit: EndsFitted, z: Real, t: Real) -> tuple[Real, Real, Real]:
        """As `Passes` says."""
        information, scores, cost = self.records.by_line(
            *self._under(fit), self._folded_slopes(fit), _numbers(z), self._of_powers(t), threads()
        )
        return information, scores, cost

    def residuals(self, fit: EndsFitted) -> Complex:
        """As `Passes` says."""
        residuals: Complex = self.records.residuals(*self._under(fit), threads())
        return residuals

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
    """The kernel's view of the records; None where it does not know the rig."""
    ends = pieces.ends
    view = ends.rig
    owners = [(record, lines) for record, lines in pieces.owners if len(lines)]
    spare = [-len(lines) % LANES for _, lines in owners]
    index = np.concatenate(
        [np.pad(lines, (0, s), "edge") for (_, lines), s in zip(owners, spare, strict=True)]
    )
    line = np.concatenate(
        [np.pad(lines, (0, s), constant_values=-1) for (_, lines), s in zip(owners, spare, strict=True)]
    )
    start = np.cumsum([0, *(len(lines) + s for (_, lines), s in zip(owners, spare, strict=True))])
    rig = kernel_rig(core, view.model, view.omega[index])
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
