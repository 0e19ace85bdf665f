"""The likelihood of measured amplitudes: y = κ G(θ) q + noise, for any linear set of channels (THEORY §4, ml).

What the channels show is `model.observation`'s; here are the data, their weights, and q = (U, f), the inputs' true
amplitudes, unknown at each line unless exact channels measure them: they enter linearly and are solved for line by
line (variable projection).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import structural_rank

from dashpot.arrays import Bools, Complex, Ints, Real, diagonal_matrices, frozen, hermitian, is_diagonal
from dashpot.estimate.likelihood.boundary_loads import (
    Projector,
    SampledLoads,
    projector,
    record_ends,
    whitener,
    with_means_of_unmeasured,
)
from dashpot.estimate.likelihood.measured import (
    Measured,
    Piece,
    Sums,
    compiled_local,
    compiled_output,
    pieces,
)
from dashpot.estimate.likelihood.record_sums import (
    by_record_line,
    ends_rank,
    record_residuals,
    record_sums,
    rows_by_line,
)
from dashpot.estimate.nonlinear.objective import nonlinear_part, predict_harmonics
from dashpot.estimate.preparation import Prepared
from dashpot.model.matrix_elements import free_names
from dashpot.model.observation import ObservationModel, Transfer, calibrated_transfer, small
from dashpot.model.reduced import ReducedTransfer
from dashpot.numerics.kernel import threads
from dashpot.numerics.levenberg_marquardt import QuadraticModel
from dashpot.numerics.small_systems import solve_small
from dashpot.unknowns import bounds_of

# Nuisance amplitudes of the likelihood: the inputs q = (U, f), which enter linearly and are solved for line
# by line.
#
# Where exact channels give them they are known; else they are estimated at each line with everything else.


def inputs_by_channel(view: ObservationModel, exact: Bools) -> Complex | None:
    """Inputs by the exact channels, (lines, r + s, channels); None if they do not give them at every line."""
    C = view.direct_q * exact[..., None]
    count = C.shape[-1]
    scale = np.max(np.abs(C), axis=-1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        C = np.where(scale > 0, C / scale, 0.0)
        unit = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1.0), 0.0)[..., 0] * exact
    if count == 1:
        power = np.sum(np.abs(C) ** 2, axis=-2, keepdims=True)
        if np.any(power == 0):
            return None
        return np.asarray(hermitian(C) / power * unit[:, None, :])
    if count and np.any(np.linalg.matrix_rank(C) < count):
        return None
    return np.linalg.pinv(C) * unit[:, None, :]


def inputs_seen(view: ObservationModel, present: Bools) -> Ints:
    """How many inputs each line's channels can tell apart: the generic rank of G there.

    present (lines, channels).
    """
    return _inputs_seen(view.sees.tobytes(), view.sees.shape, present.tobytes())


@lru_cache(maxsize=32)  # of suppositions about the same channels; a key has a byte for each amplitude
def _inputs_seen(sees: bytes, shape: tuple[int, int], present: bytes) -> Ints:
    shown = np.frombuffer(sees, dtype=np.bool_).reshape(shape)
    patterns, which = np.unique(
        np.frombuffer(present, dtype=np.bool_).reshape(-1, shape[0]), axis=0, return_inverse=True
    )
    ranks = [structural_rank(sparse.csr_array(shown & pattern[:, None])) for pattern in patterns]
    return frozen(np.array(ranks)[which.ravel()], np.int64)


def estimated_inputs(G: Complex, W: Complex, y: Complex) -> tuple[Complex, Complex]:
    """q̂ (K, lines, r + s) and W G (Gᴴ W G)⁻¹ of generalised least squares, y = G q with weights W, line by line.

    An input that no channel of a line sees is 0 there (it was not driven): the smallest precision is added to it.
    """
    WG = W @ G
    normal = hermitian(G) @ WG
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1).real
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    outer = scale[..., :, None] * scale[..., None, :]
    # 1e-12: relative precision of "zero" for inputs that no channel of a line sees
    regular = normal / outer + 1e-12 * np.eye(normal.shape[-1])
    half = hermitian(solve_small(regular, hermitian(WG / scale[..., None, :]))) / scale[..., None, :]
    q: Complex = np.einsum("...cq,...c->...q", np.conj(half), y)
    return q, half


FLOOR = 1e-6  # relative noise that exact channels of coordinates are given, so that weights stay finite


def measured(data: Prepared, softness: float = 0.0) -> Measured:
    """The data with inverse covariances; `softness` adds that relative noise to every channel (for starts)."""
    if softness:
        return _measured(data, softness)
    if "measured" not in data.kept:
        data.kept["measured"] = _measured(data, softness)
    return data.kept["measured"]


def _measured(data: Prepared, softness: float) -> Measured:
    view, spectrum = data.view, data.spectrum
    present = np.all(np.isfinite(spectrum.amplitudes), axis=0)
    y = with_means_of_unmeasured(spectrum)
    V = data.covariance
    diagonal = np.diagonal(V, axis1=-2, axis2=-1).real
    silent = np.all(diagonal == 0, axis=0)
    missing = {of.channel.name for value in spectrum.stretches for of in getattr(value, "unmeasured", ())}
    whole = np.array([channel.name not in missing for channel in spectrum.channels])
    exact = present & silent & view.inputs_alone & view.is_direct & whole
    by_channel = inputs_by_channel(view, exact)
    q = None if by_channel is None else np.einsum("lqc,...lc->...lq", by_channel, y)
    if q is not None:
        present = present & ~exact
    size = np.mean(np.abs(y), axis=0)
    size = np.maximum(size, 1e-3 * np.max(size, axis=0, initial=0.0))
    size = np.where(size > 0, size, 1.0)
    extra = (FLOOR**2 + softness**2) * size**2
    kept = np.where(diagonal > FLOOR**2 * size**2, softness**2 * size**2, extra)
    # (V + kept)⁻¹ (K or 1, lines, channels, channels), 0 where not measured; `variance` is the diagonal of the sum
    variance = diagonal + kept
    C = V.shape[-1]
    if is_diagonal(V):
        # What is too large for numbers has no weight, not the weight 0.
        finite = np.where(np.isfinite(variance), variance, np.nan)
        W = diagonal_matrices(np.where(present, 1 / np.where(present, finite, 1.0), 0.0))
    else:
        both = present[:, :, None] & present[:, None, :]
        scaled = (V + kept[..., None] * np.eye(C)) / (size[:, :, None] * size[:, None, :])
        scaled = np.where(both, scaled, np.eye(C))
        # The weight is used as such, over and over.
        W = np.linalg.inv(scaled) / (size[:, :, None] * size[:, None, :])
        W = np.where(both, (W + hermitian(W)) / 2, 0.0)
    count = int(np.sum(present)) - (0 if q is not None else int(np.sum(inputs_seen(view, present))))
    ends = record_ends(view, spectrum, by_channel)
    part = nonlinear_part(data, y, q) if len(view.model.nonlinear) else None
    root = None if ends is None or is_diagonal(W) else whitener(W)
    return Measured(y * present, W, q, 2 * count, ends, root, part)


def directly_driven(view: ObservationModel, data: Measured) -> Measured | None:
    """The data with inputs as the channels that measure nothing else show them, noise or not; None if none do."""
    if data.q is not None:  # logarithms know no noise that channels share
        return data if data.root is None else replace(data, W=data.W * np.eye(data.W.shape[-1]), root=None)
    alone = view.inputs_alone & np.any(view.direct_q, axis=-1) & np.all(data.y != 0, axis=0)
    calibrated = view.calibration_known
    by_channel = inputs_by_channel(view, alone & calibrated)
    if by_channel is None:
        return None
    q = np.einsum("lqc,...lc->...lq", by_channel, data.y)
    return Measured(data.y, data.W, q, data.rows)


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
    if data.ends is not None:
        # Boundary loads and polynomials of whole records are projected out after the inputs. Slopes are
        # those under the whole motion: the loads found are inputs of the larger rig
        fit = record_fit(view, data, psi, sign)
        J, n = fit.rig.slopes(fit.motion), data.ends.n
        if fit.folded is not None:
            for record in np.flatnonzero(data.ends.loads).tolist():
                at = data.ends.lines[record]
                of_record = fit.folded.slopes_at(record, data.ends.s[at], fit.loads[:, at[0], : 2 * n])
                J[:, at, :, : view.m] += np.moveaxis(of_record, -1, 1)
        J = fit.left_of(J)
        at_ends = np.einsum("...cz,...z->...c", fit.columns, fit.loads)
        q = fit.motion[..., : data.ends.inputs]
        return _prediction(data, fit.r, J, data.W @ J, q, int(fit.of_ends.rank[0]), at_ends)
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
    data: Measured,
    residual: Complex,
    J: Complex,
    PJ: Complex,
    q: Complex,
    columns: int = 0,
    at_ends: Complex | None = None,
) -> Prediction:
    weighted = (data.W @ residual[..., None])[..., 0]
    cost: Real = 2 * np.sum((np.conj(residual) * weighted).real, axis=-1)
    return Prediction(residual, weighted, J, PJ, q, cost, columns, at_ends)


@dataclass(frozen=True)
class RecordFit:
    """Inputs, boundary loads and polynomials of whole records as they fit at one ψ.

    rig      the channels under inputs and loads
    motion   (K, lines, r + s + n) inputs q̂ and loads
    r        (K, lines, channels) what they leave of the data
    G        (K, lines, channels, r + s); half: its W G (Gᴴ W G)⁻¹ where the inputs are estimated, else None
    columns  (K, lines, channels, 2 n + polynomials + k) of the ends, and of k samples that are not measured
    free     of the same shape: what the inputs leave of them
    loads    (K, lines, 2 n + polynomials + k) coefficients of the columns
    """

    rig: Transfer | ReducedTransfer
    motion: Complex
    r: Complex
    root: Complex
    G: Complex
    half: Complex | None
    columns: Complex
    free: Complex
    loads: Real
    of_ends: Projector
    folded: SampledLoads | None

    def left_of(self, columns: Complex) -> Complex:
        """What inputs and ends cannot do of columns in the channels, (K, lines, channels, any number)."""
        columns = _without_inputs(columns, self.G, self.half)
        return columns - self.free @ self.of_ends.coefficients(self.root @ columns, white=True)


def _without_inputs(columns: Complex, G: Complex, half: Complex | None) -> Complex:
    return columns if half is None else columns - G @ (hermitian(half) @ columns)


def record_fit(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> RecordFit:
    """What explains whole records best at ψ (K, M) with signs (K, channels); the data must have ends."""
    assert data.ends is not None
    ends, root = data.ends, np.sqrt(data.W) if data.root is None else data.root
    rig = calibrated_transfer(ends.view, psi, sign)
    G, by_load = np.split(rig.G, [ends.inputs], axis=-1)
    driven, half = _inputs(G, data)
    polynomials = ends.polynomials() + G @ ends.by_input
    columns = np.concatenate([by_load, ends.s[:, None, None] * by_load, polynomials], axis=-1)
    folded = ends.sampled_loads(psi)
    n = ends.n
    if folded is not None:
        for record in np.flatnonzero(ends.loads).tolist():
            at = ends.lines[record]
            columns[:, at, :, : 2 * n] += np.moveaxis(folded.at(record, ends.s[at]), -1, 1)
    every = columns
    if ends.missing:
        unmeasured = np.zeros((*columns.shape[1:3], ends.missing), dtype=np.complex128)
        for lines, of in zip(ends.lines, ends.unmeasured, strict=True):
            unmeasured[lines, :, : len(of.channel)] = of.in_channels(columns.shape[2])
        unmeasured = np.broadcast_to(unmeasured, (len(columns), *unmeasured.shape))
        every = np.concatenate([columns, unmeasured], axis=-1)
    free = _without_inputs(every, G, half)
    of_ends = projector(ends, root @ free)
    residual = data.y - np.einsum("...cq,...q->...c", G, driven)
    found = of_ends.coefficients(root @ residual[..., None])[..., 0]
    white = of_ends.coefficients(root @ residual[..., None], white=True)[..., 0]
    residual = residual - np.einsum("...cz,...z->...c", free, white)
    load = found[..., :n] + ends.s[:, None] * found[..., n : 2 * n]
    q = driven + np.einsum("lqp,...lp->...lq", ends.by_input, found[..., 2 * n : ends.count])
    if half is not None:
        q = q - np.einsum("...cq,...cz,...z->...q", np.conj(half), every, found)
    motion = np.concatenate([q, load], axis=-1)
    return RecordFit(rig, motion, residual, root, G, half, every, free, found, of_ends, folded)


def _inputs(G: Complex, data: Measured) -> tuple[Complex, Complex | None]:
    """(q̂, W G (Gᴴ W G)⁻¹) where the inputs are estimated, (exact q, None) where they are known."""
    return (data.q, None) if data.q is not None else estimated_inputs(G, data.W, data.y)


def bounds(view: ObservationModel, positive: bool) -> tuple[Real, Real]:
    """Lower and upper bounds of ψ, each (M,), as stated, and 0 for the parts of the rig where `positive`."""
    low, high = bounds_of(view.unknowns)
    if positive:
        free = free_names(view.model)
        parts = np.array([k < view.m and name not in free for k, name in enumerate(view.names)])
        low = np.where(parts, np.maximum(low, 0.0), low)
    return low, high


def local(
    view: ObservationModel,
    data: Measured,
    psi: Real,
    sign: Real,
    weight: Real | None = None,
    *,
    slopes: bool = True,
) -> QuadraticModel:
    """Cost, slope and curvature of −2 ln(likelihood) at ψ, (K, M); of logarithms where they have a weight.

    The residuals are then ρ = ln y − ln ŷ, `weight` is (lines, channels), and `data` must give the inputs.  Amplitude
    in nepers and phase in radians weigh alike at resonances and between them, so that the cost of a wrong resonance
    grows with its distance and has no minimum of its own: Sidman, DeAngelis and Verghese (1991), IEEE Transactions on
    Automatic Control 36, 1065.  Large residuals count by their size (pseudo-Huber).

    Without `slopes` only the cost is worth reading, which of logarithms of whole records takes a quarter of the time.
    """
    output = compiled_output(view, data)
    if output is not None:
        return compiled_local(output, psi, sign, data.rows_of(len(psi)), weight)
    sums = Sums(len(psi))
    for piece in pieces(view, data, len(psi)):
        at = psi[piece.rows], sign[piece.rows]
        if weight is None:
            sums.add(piece.rows, _sums(piece, *at))
        else:
            sums.add(piece.rows, _logarithmic_sums(piece, weight[piece.lines], slopes, *at))
    cost, gradient, information = sums.totals
    precision, away = view.prior_precision, psi - view.prior_mean
    cost = cost + np.sum(precision * away**2, axis=-1)
    if slopes:
        gradient, information = gradient - precision * away, information + np.diag(precision)
    return QuadraticModel(cost, gradient, information, information)


def _sums(piece: Piece, psi: Real, sign: Real) -> tuple[Real, Real, Real]:
    """Cost, minus half its slope, and information of the lines of a piece."""
    if piece.data.ends is not None and small(piece.view.model):
        sums = record_sums(piece.data.record_pieces, psi, sign)
        return sums.cost, sums.gradient, sums.information
    at = predict(piece.view, piece.data, psi, sign)
    M = psi.shape[-1]
    rows = at.J.shape[-3] * at.J.shape[-2]
    J = hermitian(at.J.reshape(*at.J.shape[:-3], rows, M))
    information = 2 * (J @ at.PJ.reshape(*at.PJ.shape[:-3], rows, M)).real
    gradient = 2 * (J @ at.weighted.reshape(*at.weighted.shape[:-2], rows, 1)).real[..., 0]
    return np.sum(at.cost_per_line, axis=-1), gradient, information


def per_line(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> tuple[Real, Real, Real]:
    """Information (K, lines, M, M), minus half the slope (K, lines, M) and cost (K, lines) of each line at ψ."""
    output = compiled_output(view, data)
    if output is not None and len(psi) == len(data.y):
        information, scores, cost = output.lines(
            np.ascontiguousarray(psi), np.ascontiguousarray(sign), threads()
        )
        return information, scores, cost
    K, lines, M = len(psi), len(view.omega), psi.shape[-1]
    information, scores, cost = np.empty((K, lines, M, M)), np.empty((K, lines, M)), np.empty((K, lines))
    for piece in pieces(view, data, K):
        some, signs = psi[piece.rows], sign[piece.rows]
        if piece.data.ends is not None and small(piece.view.model):
            terms = by_record_line(piece.data.record_pieces, some, signs)
        else:
            at = predict(piece.view, piece.data, some, signs)
            slope = 2 * (hermitian(at.J) @ at.weighted[..., None]).real[..., 0]
            terms = at.information(), slope, at.cost_per_line
        for whole, part in zip((information, scores, cost), terms, strict=True):
            whole[piece.rows, piece.lines] = part
    return information, scores, cost


def nuisance_columns(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> int:
    """How many independent columns the ends of whole records take out of the data.

    psi (K, M), sign (K, channels).
    """
    if data.ends is None:
        return 0
    one = data.pick(slice(0, 1))
    if small(view.model):
        return int(ends_rank(one.record_pieces, psi[:1], sign[:1])[0])
    return predict(view, one, psi[:1], sign[:1]).columns


def _logarithmic_sums(
    piece: Piece, weight: Real, slopes: bool, psi: Real, sign: Real
) -> tuple[Real, Real, Real]:
    data, y = piece.data, piece.data.y
    if data.ends is not None and small(piece.view.model):
        # Whitened, by noise that no channels share (`directly_driven`): to their ratio that is nothing.
        y = y * np.sqrt(np.diagonal(data.W, axis1=-2, axis2=-1).real)
        records = data.record_pieces, psi, sign
        columns = rows_by_line(*records) if slopes else record_residuals(*records)[0][..., None]
        J, shown = columns[..., :-1], y - columns[..., -1]
    else:
        at = predict(piece.view, data, psi, sign)
        J, shown = at.J, y - at.r
    rows, M = weight.size, J.shape[-1]
    large = 0.5  # nepers beyond which a residual of logarithms counts no longer by its square
    seen = (y != 0) & (weight > 0)
    with np.errstate(all="ignore"):
        rho = np.where(seen, np.log(np.where(seen, y, 1.0) / shown), 0.0)
        J = np.where(seen[..., None], J / shown[..., None], 0.0).reshape(len(psi), rows, M)
    stretch = np.sqrt(1 + np.abs(rho) ** 2 / large**2)
    cost = 4 * large**2 * np.sum(weight * (stretch - 1), axis=(-2, -1))
    weighted = hermitian(J) * (weight / stretch).reshape(len(psi), 1, rows)
    gradient = 2 * (weighted @ rho.reshape(len(psi), rows, 1)).real[..., 0]
    return cost, gradient, 2 * (weighted @ J).real
