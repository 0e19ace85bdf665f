"""The channels as functions of the unknowns: y = κ G(θ) q + noise, for any linear set of channels (THEORY §4, ml).

q = (U, f) are the inputs' true amplitudes, unknown at each line unless exact channels measure them; they enter
linearly and are solved for line by line (variable projection).  κ_c = sign · gain · e^{−jωτ} is what is unknown in a
channel's calibration.  Reaction forces and forces in elements are channels like any other: Σ e_i p_i a_i.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, structural_rank
from scipy.sparse.linalg import splu

from dashpot.arrays import Bools, Complex, Ints, Real, frozen, hermitian
from dashpot.channel import Channel, Quantity
from dashpot.errors import DataError
from dashpot.estimate.method import Prepared
from dashpot.estimate.preparation.state_reconstruction import is_direct, measurement
from dashpot.model.dynamics import stiffness
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_small

SPARSE_FROM = 48  # coordinates: above it a factorisation of the sparse pattern beats dense stacks
FLOOR = 1e-6  # relative noise that exact channels of coordinates are given, so that weights stay finite
BLIND = 1e-12  # relative precision of "zero" for inputs that no channel of a line sees


@dataclass(frozen=True)
class ObservationModel:
    """What the channels see of the rig, and the unknown calibrations: constants of one search.

    direct_x (lines, channels, n), direct_q (lines, channels, r + s): motions and applied forces
    force    (channels, elements): factors of p_i a_i in force channels
    gain, delay (channels,): index into the gains and delays that are estimated, −1 where known
    flips    (channels,): whether the sign is to be found
    """

    model: Model
    channels: tuple[Channel, ...]
    omega: Real
    direct_x: Complex
    direct_q: Complex
    force: Real
    gain: Ints
    delay: Ints
    flips: Bools

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns ψ = (θ, gains, delays)."""
        owners = [self.channels[int(np.argmax(self.gain == k))].name for k in range(self.gains)]
        late = [self.channels[int(np.argmax(self.delay == k))].name for k in range(self.delays)]
        theta = [unknown.name for unknown in self.model.unknowns]
        return (*theta, *(f"{name}.gain" for name in owners), *(f"{name}.delay" for name in late))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of ψ."""
        theta = [unknown.unit for unknown in self.model.unknowns]
        return (*theta, *["1"] * self.gains, *["s"] * self.delays)

    @property
    def gains(self) -> int:
        """Number of unknown gains."""
        return int(np.max(self.gain, initial=-1)) + 1

    @property
    def delays(self) -> int:
        """Number of unknown delays."""
        return int(np.max(self.delay, initial=-1)) + 1

    @property
    def m(self) -> int:
        """Number of unknowns of the rig itself."""
        return len(self.model.unknowns)

    @cached_property
    def has_forces(self) -> bool:
        """Whether some channel measures a force that depends on the parameters."""
        return bool(np.any(self.force))


def observation_model(model: Model, channels: Sequence[Channel], omega: Real) -> ObservationModel:
    """What `channels` see of `model` at `omega`.  Raises DataError where a channel measures what the rig has not."""
    C = measurement(model, [_known(channel) for channel in channels], omega)
    n = model.n
    force = np.zeros((len(channels), len(model.elements)))
    elements = {element.name: i for i, element in enumerate(model.elements)}
    moved = {name: j for j, name in enumerate(model.displacement_inputs)}
    for c, channel in enumerate(channels):
        if channel.quantity is not Quantity.FORCE:
            continue
        for name, factor in channel.of.items():
            if name in elements:
                force[c, elements[name]] += factor
            elif name in moved:
                force[c] += factor * model.D[:, moved[name]]
            elif name not in model.force_inputs:
                raise DataError(
                    f"channel {channel.name} measures the force of {name}, which the rig has not",
                    cure="name an input or elements",
                )
    names = {channel.name: c for c, channel in enumerate(channels)}
    gain, delay = np.full(len(channels), -1), np.full(len(channels), -1)
    for c, channel in enumerate(channels):
        if channel.gain is None and channel.same_gain_as is None:
            gain[c] = int(np.max(gain)) + 1
        if channel.delay is None:
            delay[c] = int(np.max(delay)) + 1
    for c, channel in enumerate(channels):
        if channel.same_gain_as is not None:
            owner = names.get(channel.same_gain_as)
            if owner is None or gain[owner] < 0:
                raise DataError(
                    f"channel {channel.name} shares the gain of {channel.same_gain_as}, which has no unknown gain",
                    cure='name a channel with gain = "unknown"',
                )
            gain[c] = gain[owner]
    flips = np.array([channel.sign is None and channel.gain is not None for channel in channels])
    return ObservationModel(
        model, tuple(channels), frozen(omega, np.float64), C[..., :n], C[..., n:], force, gain, delay, flips
    )  # fmt: skip


def _known(channel: Channel) -> Channel:
    """The channel as if its calibration were known; forces that depend on the parameters see nothing directly."""
    return Channel(channel.name, channel.of, channel.quantity)


@dataclass(frozen=True)
class Measured:
    """Amplitudes of K repeats, arranged for the likelihood.

    y (K, lines, channels), 0 where not measured; W (K or 1, lines, channels, channels) the inverse covariance, 0
    where not measured; q (K, lines, r + s) where exact channels give the inputs, else None.
    """

    y: Complex
    W: Complex
    q: Complex | None
    rows: int

    def pick(self, rows: Ints) -> Measured:
        """Some of the repeats."""
        if len(self.y) == 1:
            return self  # many starts of one repeat
        W = self.W if len(self.W) == 1 else self.W[rows]
        return Measured(self.y[rows], W, None if self.q is None else self.q[rows], self.rows)


def measured(data: Prepared, view: ObservationModel, softness: float = 0.0) -> Measured:
    """The data with inverse covariances; `softness` adds that relative noise to every channel (for starts)."""
    spectrum, model = data.spectrum, data.model
    present = np.all(np.isfinite(spectrum.amplitudes), axis=0)
    y = np.nan_to_num(spectrum.amplitudes)
    V = data.covariance
    inputs = {*model.displacement_inputs, *model.force_inputs}
    diagonal = np.diagonal(V, axis1=-2, axis2=-1).real
    silent = np.all(diagonal == 0, axis=0)
    drive = np.array([set(c.of) <= inputs and is_direct(model, c) for c in spectrum.channels])
    exact = present & silent & drive
    q = _exact_inputs(view, y, exact)
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
    return Measured(y * present, W, q, 2 * count)


def _exact_inputs(view: ObservationModel, y: Complex, exact: Bools) -> Complex | None:
    """Inputs from exact channels, (K, lines, r + s); None where they do not determine them at every line."""
    C = view.direct_q * exact[..., None]
    count = C.shape[-1]
    scale = np.max(np.abs(C), axis=-1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        C = np.where(scale > 0, C / scale, 0.0)
        right = np.where(scale[..., 0] > 0, y * exact / np.where(scale[..., 0] > 0, scale[..., 0], 1.0), 0.0)
    if np.any(np.linalg.matrix_rank(C) < count):
        return None
    q: Complex = np.einsum("lqc,...lc->...lq", np.linalg.pinv(C), right)
    return q


def directly_driven(view: ObservationModel, data: Measured) -> Measured | None:
    """The data with inputs as the channels that measure nothing else show them, noise or not; None where none do."""
    if data.q is not None:
        return data
    alone = np.any(view.direct_q, axis=-1) & ~np.any(view.direct_x, axis=-1) & np.all(data.y != 0, axis=0)
    calibrated = (view.gain < 0) & (view.delay < 0) & ~view.flips
    q = _exact_inputs(view, data.y, alone & calibrated)
    return None if q is None else Measured(data.y, data.W, q, data.rows)


def _inputs_seen(view: ObservationModel, present: Bools) -> Ints:
    """How many inputs each line's channels can tell apart: the generic rank of G there.

    A channel sees an input that reaches its coordinates through elements; a force on another rig of the same model,
    or on a part that is connected only to moved inputs, it does not.
    """
    model, B = view.model, abs(view.model.sparse_B)
    count, part = connected_components(B.T @ B, directed=False)
    member = sparse.csr_array((np.ones(model.n), (np.arange(model.n), part)), shape=(model.n, count))
    driven = np.concatenate([B.T @ abs(model.D), abs(model.S)], axis=1)
    looking = np.max(np.abs(view.direct_x), axis=0, initial=0.0) + abs(view.force) @ B
    direct = np.max(np.abs(view.direct_q), axis=0, initial=0.0)
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
    PJ = Π J with Π = W − W G (Gᴴ W G)⁻¹ Gᴴ W; q̂ (K, lines, r + s); cost_per_line (K, lines)
    """

    r: Complex
    weighted: Complex
    J: Complex
    PJ: Complex
    q: Complex
    cost_per_line: Real

    def information(self) -> Real:
        """2 Re Jᴴ Π J of each line, (K, lines, M, M)."""
        return 2 * (hermitian(self.J) @ self.PJ).real


def predict(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> Prediction:
    """Evaluate the channels at ψ (K, M) with signs (K, channels).

    ∂X/∂p_i = −D⁻¹ b_iᵀ a_i is never formed: one adjoint solve per channel, D being symmetric, gives all its slopes,
    −(B D⁻¹ cᵀ)_i a_i.
    """
    model, m = view.model, view.m
    p = model.parameters(psi[:, :m])
    kappa = _calibration(view, psi, sign)
    looking, direct_q = view.direct_x, view.direct_q
    if view.has_forces:
        rows = view.force * (p[:, None, :] * model.factors(view.omega))[..., None, :]
        looking = looking + (rows @ model.B if small(model) else _by_sparse(rows, model.sparse_B))
        direct_q = np.broadcast_to(direct_q, (*rows.shape[:-1], direct_q.shape[-1])).copy()
        direct_q[..., : model.D.shape[1]] += rows @ model.D
    seen, back, stretch = _transfer(
        model, p, view.omega, np.broadcast_to(looking, (len(psi), *looking.shape[-3:]))
    )
    G = kappa[..., None] * (direct_q + seen)
    q, half = _inputs(G, data)
    predicted = np.einsum("...cq,...q->...c", G, q)
    residual = data.y - predicted
    a = model.factors(view.omega) * np.einsum("...eq,...q->...e", stretch, q)
    slope = (
        view.force * a[..., None, :] - back * a[..., None, :] if view.has_forces else -back * a[..., None, :]
    )
    J = np.concatenate(
        [kappa[..., None] * (slope @ model.T), *_calibration_slopes(view, psi, predicted)], axis=-1
    )
    weighted = (data.W @ residual[..., None])[..., 0]
    PJ = data.W @ J
    if half is not None:
        PJ = PJ - half @ (hermitian(G) @ PJ)
    cost: Real = 2 * np.sum((np.conj(residual) * weighted).real, axis=-1)
    return Prediction(residual, weighted, J, PJ, q, cost)


def _transfer(model: Model, p: Real, omega: Real, looking: Complex) -> tuple[Complex, Complex, Complex]:
    """(c D⁻¹ [R S], B D⁻¹ cᵀ transposed, elongations per unit of input), for channels c that look at coordinates.

    Shapes (K, lines, channels, r + s), (K, lines, channels, elements), (K, lines, elements, r + s).
    """
    if not small(model):
        return _transfer_sparse(model, p, omega, looking)
    channels = looking.shape[-2]
    both = stiffness(model, p, omega)
    S = np.broadcast_to(model.S.astype(np.complex128), (*both.shape[:-1], model.S.shape[1]))
    sides = [np.swapaxes(looking, -1, -2), -both[..., model.n :], S]
    solved = solve_small(both[..., : model.n], np.concatenate(sides, axis=-1))
    X = solved[..., channels:]
    stretch = model.B @ X
    stretch[..., : model.D.shape[1]] += model.D
    return looking @ X, np.swapaxes(model.B @ solved[..., :channels], -1, -2), stretch


def _transfer_sparse(
    model: Model, p: Real, omega: Real, looking: Complex
) -> tuple[Complex, Complex, Complex]:
    B, D = model.sparse_B, model.D
    Bt = B.T.tocsr()
    indices, indptr, A = model.assembly
    repeats, lines, channels = looking.shape[:3]
    r, forces, sides = D.shape[1], model.S.astype(np.complex128), channels + D.shape[1] + model.S.shape[1]
    pulled = np.empty((repeats, lines, len(model.elements), sides), dtype=np.complex128)
    seen = np.empty((repeats, lines, channels, sides - channels), dtype=np.complex128)
    for line, factors in enumerate(model.factors(omega)):
        for k in range(repeats):
            weight = p[k] * factors
            D_k = sparse.csc_array((A @ weight, indices, indptr), shape=(model.n, model.n))
            right = np.concatenate([looking[k, line].T, -(Bt @ (weight[:, None] * D)), forces], axis=1)
            try:
                factorised = splu(D_k, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
                solved = factorised.solve(right)
            except RuntimeError:  # exactly singular
                solved = np.full_like(right, np.nan)
            pulled[k, line] = B @ solved
            seen[k, line] = looking[k, line] @ solved[:, channels:]
    stretch = pulled[..., channels:]
    stretch[..., :r] += D
    return seen, np.swapaxes(pulled[..., :channels], -1, -2), stretch


def small(model: Model) -> bool:
    """Whether stacks of full matrices beat factorisations of the sparse pattern."""
    return model.n < SPARSE_FROM


def _by_sparse(rows: Complex, matrix: sparse.csr_array) -> Complex:
    """rows (..., elements) times a sparse matrix (elements, n)."""
    flat: Complex = np.asarray(rows.reshape(-1, rows.shape[-1]) @ matrix)
    return flat.reshape(*rows.shape[:-1], matrix.shape[1])


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


def _calibration(view: ObservationModel, psi: Real, sign: Real) -> Complex:
    """κ of each channel, (K, lines, channels)."""
    kappa = np.broadcast_to(
        sign[:, None, :].astype(np.complex128), (len(psi), len(view.omega), sign.shape[-1])
    )
    if view.gains:
        gains = psi[:, view.m : view.m + view.gains]
        kappa = kappa * np.where(view.gain >= 0, gains[:, view.gain], 1.0)[:, None, :]
    if view.delays:
        delays = psi[:, view.m + view.gains :]
        late = np.where(view.delay >= 0, delays[:, view.delay], 0.0)
        kappa = kappa * np.exp(-1j * view.omega[:, None] * late[:, None, :])
    return kappa


def _calibration_slopes(view: ObservationModel, psi: Real, predicted: Complex) -> list[Complex]:
    """∂y/∂gain = y / gain and ∂y/∂τ = −jω y, each (K, lines, channels, count)."""
    slopes = []
    if view.gains:
        own = view.gain[:, None] == np.arange(view.gains)
        gains = psi[:, view.m : view.m + view.gains]
        slopes.append(predicted[..., None] * own / gains[:, None, None, :])
    if view.delays:
        own = view.delay[:, None] == np.arange(view.delays)
        slopes.append(-1j * view.omega[:, None, None] * predicted[..., None] * own)
    return slopes
