"""The likelihood of measured amplitudes: y = κ G(θ) q + noise, for any linear set of channels (THEORY §4, ml).

What the channels show is `model.observation`'s; here are the data, their weights, and q = (U, f), the inputs' true
amplitudes, unknown at each line unless exact channels measure them: they enter linearly and are solved for line by
line (variable projection).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, structural_rank

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian
from dashpot.estimate.likelihood.boundary_loads import RecordEnds, projector, record_ends, whitener
from dashpot.estimate.nonlinear.objective import NonlinearPart, nonlinear_part, predict_harmonics
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.observation import (
    ObservationModel,
    calibrated_transfer,
    is_direct,
    measures_input,
)
from dashpot.numerics.small_systems import solve_small

FLOOR = 1e-6  # relative noise that exact channels of coordinates are given, so that weights stay finite
BLIND = 1e-12  # relative precision of "zero" for inputs that no channel of a line sees


@dataclass(frozen=True)
class Measured:
    """Amplitudes of K repeats, arranged for the likelihood.

    y (K, lines, channels), 0 where not measured; W (K or 1, lines, channels, channels) the inverse covariance, 0
    where not measured; q (K, lines, r + s) where exact channels give the inputs, else None; `rows` real equations.
    `ends`: the columns that whole records bring, and `root` with rootᴴ root = W, where there are whole records.
    """

    y: Complex
    W: Complex
    q: Complex | None
    rows: int
    ends: RecordEnds | None = None
    root: Complex | None = None
    nonlinear: NonlinearPart | None = None

    def pick(self, rows: Ints) -> Measured:
        """Some of the repeats."""
        if len(self.y) == 1:
            return self  # many starts of one repeat
        W = self.W if len(self.W) == 1 else self.W[rows]
        root = self.root if self.root is None or len(self.root) == 1 else self.root[rows]
        q = None if self.q is None else self.q[rows]
        part = None if self.nonlinear is None else self.nonlinear.pick(rows)
        return Measured(self.y[rows], W, q, self.rows, self.ends, root, part)


def measured(data: Prepared, view: ObservationModel, softness: float = 0.0) -> Measured:
    """The data with inverse covariances; `softness` adds that relative noise to every channel (for starts)."""
    spectrum, model = data.spectrum, data.model
    present = np.all(np.isfinite(spectrum.amplitudes), axis=0)
    y = np.nan_to_num(spectrum.amplitudes)
    V = data.covariance
    diagonal = np.diagonal(V, axis1=-2, axis2=-1).real
    silent = np.all(diagonal == 0, axis=0)
    drive = np.array([measures_input(model, c) and is_direct(model, c) for c in spectrum.channels])
    exact = present & silent & drive
    by_channel = _from_exact(view, exact)
    q = None if by_channel is None else np.einsum("lqc,...lc->...lq", by_channel, y)
    if q is not None:
        present = present & ~exact
    size = np.mean(np.abs(y), axis=0)
    size = np.maximum(size, 1e-3 * np.max(size, axis=0, initial=0.0))
    size = np.where(size > 0, size, 1.0)
    extra = (FLOOR**2 + softness**2) * size**2
    kept = np.where(diagonal > FLOOR**2 * size**2, softness**2 * size**2, extra)
    both = present[:, :, None] & present[:, None, :]
    scaled = (V + kept[..., None] * np.eye(V.shape[-1])) / (size[:, :, None] * size[:, None, :])
    scaled = np.where(both, scaled, np.eye(V.shape[-1]))
    # The weight is used as such, over and over.
    W = np.linalg.inv(scaled) / (size[:, :, None] * size[:, None, :])
    W = np.where(both, (W + hermitian(W)) / 2, 0.0)
    count = int(np.sum(present)) - (0 if q is not None else int(np.sum(_inputs_seen(view, present))))
    ends = record_ends(view, spectrum, by_channel)
    part = nonlinear_part(data, view, y, q) if len(model.nonlinear) else None
    return Measured(y * present, W, q, 2 * count, ends, None if ends is None else whitener(W), part)


def _from_exact(view: ObservationModel, exact: Bools) -> Complex | None:
    """Inputs by the exact channels, (lines, r + s, channels); None where they do not give them at every line."""
    C = view.direct_q * exact[..., None]
    count = C.shape[-1]
    scale = np.max(np.abs(C), axis=-1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        C = np.where(scale > 0, C / scale, 0.0)
        unit = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1.0), 0.0)[..., 0] * exact
    if np.any(np.linalg.matrix_rank(C) < count):
        return None
    by_channel: Complex = np.linalg.pinv(C) * unit[:, None, :]
    return by_channel


def directly_driven(view: ObservationModel, data: Measured) -> Measured | None:
    """The data with inputs as the channels that measure nothing else show them, noise or not; None where none do."""
    if data.q is not None:
        return data
    alone = view.inputs_alone & np.any(view.direct_q, axis=-1) & np.all(data.y != 0, axis=0)
    calibrated = (view.gain < 0) & (view.delay < 0) & ~view.flips
    by_channel = _from_exact(view, alone & calibrated)
    if by_channel is None:
        return None
    q = np.einsum("lqc,...lc->...lq", by_channel, data.y)
    return Measured(data.y, data.W, q, data.rows)


def _inputs_seen(view: ObservationModel, present: Bools) -> Ints:
    """How many inputs each line's channels can tell apart: the generic rank of G there.

    A channel sees an input that reaches its coordinates through elements; a force on another rig of the same model,
    or on a part that is connected only to moved inputs, it does not.
    """
    model, B = view.model, abs(view.model.sparse_B)
    count, part = connected_components(B.T @ B, directed=False)
    member = sparse.csr_array((np.ones(model.n), (np.arange(model.n), part)), shape=(model.n, count))
    driven = np.concatenate([B.T @ abs(model.D), abs(model.S)], axis=1)
    looking = np.abs(view.on_x) + abs(view.force) @ B
    direct = np.abs(view.on_q)
    direct[:, : model.D.shape[1]] += abs(view.force) @ abs(model.D)
    sees = ((looking @ member > 0).astype(float) @ (member.T @ driven > 0) > 0) | (direct > 0)
    patterns, which = np.unique(present, axis=0, return_inverse=True)
    ranks = [int(structural_rank(sparse.csr_array(sees & pattern[:, None]))) for pattern in patterns]
    found: Ints = np.array(ranks, dtype=np.int64)[which.ravel()]
    return found


@dataclass(frozen=True)
class Prediction:
    """Channels, residuals and slopes at one ψ.

    r (K, lines, channels) residual y − κ G q̂; weighted (…) Π y = W r; J (…, M) slope of κ G q at fixed q;
    PJ = Π J with Π = W − W G (Gᴴ W G)⁻¹ Gᴴ W; q̂ (K, lines, r + s); cost_per_line (K, lines).  Of whole records the
    boundary loads and polynomials are taken out of r, and out of J; `columns` counts those that are not dependent, and
    `at_ends` (K, lines, channels) is what they add to the channels.
    """

    r: Complex
    weighted: Complex
    J: Complex
    PJ: Complex
    q: Complex
    cost_per_line: Real
    columns: int = 0
    at_ends: Complex | None = None

    def information(self) -> Real:
        """2 Re Jᴴ Π J of each line, (K, lines, M, M)."""
        return 2 * (hermitian(self.J) @ self.PJ).real


def predict(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> Prediction:
    """Evaluate the channels at ψ (K, M) with signs (K, channels)."""
    if data.ends is not None and data.root is not None:
        return _predict_records(view, data, data.ends, data.root, psi, sign)
    if data.nonlinear is not None:
        return Prediction(*predict_harmonics(view, data, data.nonlinear, psi, sign))
    rig = calibrated_transfer(view, psi, sign)
    q, half = _inputs(rig.G, data)
    J = rig.slopes(q)
    PJ = data.W @ J
    if half is not None:
        PJ = PJ - half @ (hermitian(rig.G) @ PJ)
    return _prediction(data, data.y - rig.amplitudes(q), J, PJ, q)


def _prediction(
    data: Measured, residual: Complex, J: Complex, PJ: Complex, q: Complex, columns: int = 0
) -> Prediction:
    weighted = (data.W @ residual[..., None])[..., 0]
    cost: Real = 2 * np.sum((np.conj(residual) * weighted).real, axis=-1)
    return Prediction(residual, weighted, J, PJ, q, cost, columns)


def _predict_records(
    view: ObservationModel, data: Measured, ends: RecordEnds, root: Complex, psi: Real, sign: Real
) -> Prediction:
    """As `predict`, with boundary loads and polynomials of whole records projected out after the inputs.

    Slopes are those under the whole motion: the loads found are inputs of the larger rig.
    """
    rig = calibrated_transfer(ends.view, psi, sign)
    G, by_load = np.split(rig.G, [ends.inputs], axis=-1)
    driven, half = _inputs(G, data)

    def without_inputs(columns: Complex) -> Complex:
        return columns if half is None else columns - G @ (hermitian(half) @ columns)

    polynomials = ends.polynomials() + G @ ends.by_input
    columns = np.concatenate([by_load, ends.s[:, None, None] * by_load, polynomials], axis=-1)
    free = without_inputs(columns)
    of_ends = projector(ends, root @ free)
    residual = data.y - np.einsum("...cq,...q->...c", G, driven)
    found = of_ends.coefficients(root @ residual[..., None])[..., 0]
    residual = residual - np.einsum("...cz,...z->...c", free, found)
    n = ends.n
    load = found[..., :n] + ends.s[:, None] * found[..., n : 2 * n]
    q = driven + np.einsum("lqp,...lp->...lq", ends.by_input, found[..., 2 * n :])
    if half is not None:
        q = q - np.einsum("...cq,...cz,...z->...q", np.conj(half), columns, found)
    motion = np.concatenate([q, load], axis=-1)
    J = without_inputs(rig.slopes(motion))
    J = J - free @ of_ends.coefficients(root @ J)
    at_ends = np.einsum("...cz,...z->...c", columns, found)
    prediction = _prediction(data, residual, J, data.W @ J, q, int(of_ends.rank[0]))
    return replace(prediction, at_ends=at_ends)


def _inputs(G: Complex, data: Measured) -> tuple[Complex, Complex | None]:
    """(q̂, W G (Gᴴ W G)⁻¹) where the inputs are estimated, (exact q, None) where they are known.

    An input that no channel of a line sees is 0 there (it was not driven): the smallest precision is added to it.
    """
    if data.q is not None:
        return data.q, None
    WG = data.W @ G
    normal = hermitian(G) @ WG
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1).real
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    outer = scale[..., :, None] * scale[..., None, :]
    regular = normal / outer + BLIND * np.eye(normal.shape[-1])
    half = hermitian(solve_small(regular, hermitian(WG / scale[..., None, :]))) / scale[..., None, :]
    q: Complex = np.einsum("...cq,...c->...q", np.conj(half), data.y)
    return q, half
