"""The likelihood of the harmonics of nonlinear rigs: the same Prediction as for linear ones (THEORY §9).

The response at each ψ is found by harmonic balance, on the branch of the measured motion or of the last response.
Inputs measured with noise are unknowns of each dwell, found by Gauss and Newton's steps and projected out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen, hermitian
from dashpot.errors import ConvergenceError, DataError
from dashpot.estimate.nonlinear.dwells import (
    DwellLines,
    Predicted,
    WarmStart,
    dwells_of,
    measured_elongations,
)
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.network import Model
from dashpot.model.nonlinear.compiled import compiled_channels, compiled_rig
from dashpot.model.nonlinear.continuation import grown_from_rest
from dashpot.model.nonlinear.harmonic_balance import (
    SETTLED,
    harmonic_unit_forces,
    periodic_response,
    samples_of,
    slopes,
)
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.model.observation import (
    ObservationModel,
    calibration_factors,
    calibration_slopes,
    channel_amplitudes,
)

if TYPE_CHECKING:
    from dashpot.estimate.likelihood.chunks import Measured


# Dwells of rigs far from linear, whose motion Newton's method misses where nobody has measured it.


POINTS = 400  # on the way of each


def regained(model: Model, theta: Real, drive: Drive, last: Real, converged: Bools) -> Real | None:
    """The `last` elongations (N, e, W) with those of dwells that have not converged (N,) found from rest.

    Their drive is raised slowly.  theta (K, unknowns) of K repeats, one after another in the dwells.  None where none
    of them is found.
    """
    delta, gained = last.copy(), False
    dwells = len(delta) // len(theta)
    for row in np.flatnonzero(~converged)[:6]:  # dwells that are followed
        try:
            alone = drive.rows(np.arange(len(delta)) == row)
            delta[row] = grown_from_rest(model, theta[row // dwells], alone, points=POINTS)
        except ConvergenceError:
            continue
        gained = True
    return delta if gained else None


# What uncalibrated channels show of settled dwells at given parameters and inputs, with slopes (THEORY §9).


@dataclass(frozen=True)
class ShownLines:
    """Channels at the lines of K repeats, (K, lines, channels, …), and the elongations behind them.

    Y and its slopes dY along θ and, where inputs are noisy, along the inputs' lines of the dwell, (…, m + Q); delta
    (K dwells, e, W), its slopes d_delta (…, m) along θ, and which dwells have a response, converged (K dwells,).
    """

    Y: Complex
    dY: Complex
    delta: Real
    d_delta: Real
    converged: Bools


def shown_lines(
    view: ObservationModel, dwells: DwellLines, p: Real, constants: Real, q: Complex, start: Real | None,
    *, noisy: bool, grow: bool,
) -> ShownLines:  # fmt: skip
    """The channels of a view at parameters p (K, elements) and inner constants (K, G).

    q (K, lines, r + s): the inputs, along which slopes are wanted as well if `noisy`; start as `Periodic.delta` or
    None; grow: whether the drive of dwells that Newton's method loses is raised step by step.
    """
    compiled = _compiled(view, dwells, p, constants, q, start, noisy)
    if compiled is not None and (not grow or np.all(compiled.converged)):
        return compiled
    model: Model = view.model
    K, R, r, m = len(p), len(dwells.omega), model.D.shape[1], view.m
    by_dwell = np.repeat(p, R, axis=0)
    drive = dwells.drive(q, r)
    at = periodic_response(model, by_dwell, np.repeat(constants, R, axis=0), drive, start, grow=grow)
    a = harmonic_unit_forces(model, drive, at)
    X, forces = dwells.lines(at.X, K), dwells.lines(a, K)
    Y = channel_amplitudes(view, X, q, p[:, None, :] * forces)
    along_p, along_g, along = _directions(view, dwells, q.shape[-1], noisy)
    every = None if along is None else np.tile(along, (K, 1, 1, 1))
    along_U, along_f = (None, None) if every is None else (every[:, :, :r], every[:, :, r:])
    slope = slopes(model, by_dwell, drive, at, a, along_p, along_g, along_U, along_f)
    d_forces = p[:, None, :, None] * dwells.lines(slope.unit_forces, K)
    d_forces[..., :m] += forces[..., None] * model.T
    dY = view.rates[..., None] * (view.on_x @ dwells.lines(slope.X, K)) + view.force @ d_forces
    if noisy:
        dY[..., m:] += _straight_through(view, dwells, q.shape[-1])
    return ShownLines(Y, dY, at.delta, slope.delta[..., :m], at.converged)


def _directions(
    view: ObservationModel, dwells: DwellLines, inputs: int, noisy: bool
) -> tuple[Real, Real, Complex | None]:
    """Directions of the parameters (elements, m + Q), the constants (G, m + Q) and the inputs.

    Those of the inputs (dwells, H + 1, inputs, m + Q) are None unless they are `noisy`.
    """
    model = view.model
    along_p, along_g = model.T, model.constants_map[0]
    if not noisy:
        return along_p, along_g, None
    directions = dwells.input_directions(inputs)
    along = np.concatenate([np.zeros((*directions.shape[:-1], view.m)), directions], axis=-1)
    widen = [(0, 0), (0, directions.shape[-1])]
    return np.pad(along_p, widen), np.pad(along_g, widen), along


def _compiled(
    view: ObservationModel, dwells: DwellLines, p: Real, constants: Real, q: Complex, start: Real | None, noisy: bool
) -> ShownLines | None:  # fmt: skip
    """By the kernel; None where NumPy is to do the work or must."""
    times = samples_of(view.model, dwells.orders)
    rig = compiled_rig(view.model, times)
    if rig is None:
        return None
    directions = _directions(view, dwells, q.shape[-1], noisy)
    Y, dY, delta, d_delta, error = compiled_channels(
        rig, view.model, (p, constants, q, start), (dwells.omega, dwells.dwell, dwells.order, dwells.orders), times,
        directions, (view.rates, view.on_x, view.on_q, view.force),
    )  # fmt: skip
    if noisy:
        dY[..., view.m :] += _straight_through(view, dwells, q.shape[-1])
    return ShownLines(Y, dY, delta, d_delta[..., : view.m], error <= SETTLED)


def _straight_through(view: ObservationModel, dwells: DwellLines, inputs: int) -> Complex:
    """What channels show of the inputs' lines themselves, (lines, channels, Q)."""
    along = dwells.input_directions(inputs)[dwells.dwell, dwells.order]
    return view.rates[..., None] * (view.on_q @ along)


INNER = 6  # steps for the inputs of one ψ
SETTLED_OBJECTIVE = 1e-9  # standard deviations
BLIND = 1e-12  # relative precision of "zero" for inputs that no channel of a dwell sees


@dataclass(frozen=True)
class NonlinearPart:
    """What the likelihood of a nonlinear rig needs beside the amplitudes.

    start (K, dwells, e, W): elongations to start from, None where they were not measured; q (K, lines, r + s): the
    inputs to start from; repeat (K,): which repeats these are; patient: whether lost dwells are followed from rest
    where nothing else tells their motion; raised: whether the drive of those that Newton's method loses is raised step
    by step, which takes long.
    """

    dwells: DwellLines
    start: Real | None
    q: Complex
    repeat: Ints
    warm: WarmStart
    patient: bool = True
    raised: bool = True

    def pick(self, rows: Ints) -> NonlinearPart:
        """Some of the repeats, rows (k,)."""
        start = None if self.start is None else self.start[rows]
        return replace(self, start=start, q=self.q[rows], repeat=self.repeat[rows])

    def with_harmonics(self, orders: int) -> NonlinearPart:
        """The same with that many harmonics of the response, without memory of earlier responses."""
        start = None if self.start is None else _with_orders(self.start, orders)
        return replace(self, dwells=self.dwells.with_orders(orders), start=start, warm=WarmStart())

    def widened(self, orders: int) -> NonlinearPart:
        """As `with_harmonics`, but next to the last responses, which stay on their branches."""
        delta = {repeat: _with_orders(last, orders) for repeat, last in self.warm.delta.items()}
        return replace(self.with_harmonics(orders), warm=WarmStart(delta, dict(self.warm.inputs)))


def _with_orders(delta: Real, orders: int) -> Real:
    """Elongations (..., W) with that many harmonics, 0 those that they have not, (..., 2 orders + 1)."""
    kept = min(delta.shape[-1], 2 * orders + 1)
    wide = np.zeros((*delta.shape[:-1], 2 * orders + 1))
    wide[..., :kept] = delta[..., :kept]
    return wide


@dataclass(frozen=True)
class Evaluated:
    """The channels at one ψ and given inputs, (K, lines, channels, …).

    delta (K dwells, e, W): elongations, and d_delta (…, m) their slopes; converged (K dwells,): which have a response.
    """

    predicted: Complex
    J: Complex
    G: Complex
    delta: Real
    d_delta: Real
    converged: Bools


def evaluate(
    view: ObservationModel,
    part: NonlinearPart,
    psi: Real,
    sign: Real,
    q: Complex,
    start: Real | None,
    noisy: bool,
) -> Evaluated:
    """Channels, their slopes along ψ and, where the inputs are `noisy`, along the inputs' lines of the dwell.

    psi (K, M), sign (K, channels), q (K, lines, r + s), start as `Periodic.delta` or None.
    """
    model, dwells, K, m = view.model, part.dwells, len(psi), view.m
    theta = psi[:, :m]
    constants = model.inner_constants(theta)
    impossible = np.any(constants[:, must_be_positive(model)] <= 0, axis=-1)
    constants = np.where(impossible[:, None], 1.0, constants)
    p = model.parameters(theta)
    at = shown_lines(view, dwells, p, constants, q, start, noisy=noisy, grow=part.raised)
    kappa = calibration_factors(view, psi, sign)
    predicted, dY = kappa * at.Y, kappa[..., None] * at.dY
    if not np.all(at.converged):
        # A dwell without a response shows nothing: a large residual, but a finite one that leaves the others in charge.
        lost = ~at.converged.reshape(K, -1)[:, dwells.dwell]
        predicted = np.where(lost[..., None], 0.0, predicted)
        dY = np.where(lost[..., None, None], 0.0, dY)
    if np.any(impossible):
        predicted = np.where(impossible[:, None, None], np.nan, predicted)
    J = dY[..., :m]
    if view.gains or view.delays:
        J = np.concatenate([J, calibration_slopes(view, psi, predicted)], axis=-1)
    return Evaluated(predicted, J, dY[..., m:], at.delta, at.d_delta, at.converged)


def must_be_positive(model: Model) -> Ints:
    """Indices of inner constants that make sense above 0 only, (k,)."""
    positive = [
        j
        for j, (element, constant) in enumerate(model.constants)
        if element.force_law is not None and constant.name in element.force_law.positive
    ]
    return np.array(positive, dtype=np.int64)


def measured_part(data: Measured) -> NonlinearPart:
    """The nonlinear part of data that have one."""
    assert data.nonlinear is not None
    return data.nonlinear


def predict_harmonics(
    view: ObservationModel, data: Measured, part: NonlinearPart, psi: Real, sign: Real
) -> Predicted:
    """What a Prediction holds, for measured harmonics at ψ (K, M): r, weighted, J, PJ, q and cost_per_line.

    J is what noisy inputs leave of the slopes.
    """
    known = len(part.repeat) == len(psi)
    if not known or len(psi) > 1:
        return _predicted(view, data, part, psi, sign, known)
    which = b"".join(numbers.tobytes() for numbers in (part.repeat, psi, sign, data.y, data.W))
    latest = part.warm.latest
    if latest is None or latest[0] != which:
        latest = part.warm.latest = which, _predicted(view, data, part, psi, sign, known)
    return latest[1]


def _predicted(
    view: ObservationModel, data: Measured, part: NonlinearPart, psi: Real, sign: Real, known: bool
) -> Predicted:
    """As `predict_harmonics`; `known`: whether ψ are those of the repeats, whose last responses are near."""
    noisy = data.q is None
    q, start = _begin(data, part, psi[:, : view.m], known)
    now = evaluate(view, part, psi, sign, q, start, noisy)
    if known and part.patient and start is None and not np.all(now.converged):
        drive = part.dwells.drive(q, view.model.D.shape[1])
        delta = regained(view.model, psi[:, : view.m], drive, now.delta, now.converged)
        now = now if delta is None else evaluate(view, part, psi, sign, q, delta, noisy)
    for turn in range(INNER if noisy else 0):
        residual = data.y - now.predicted
        normal, gain = _normal(data, part, now, residual)
        step = _solved(normal, gain[..., None])[..., 0]
        size = np.sqrt(np.abs(np.sum(step * gain, axis=-1)))
        directions = part.dwells.input_directions(q.shape[-1])[part.dwells.dwell, part.dwells.order]
        if turn == INNER - 1 or not np.nanmax(size, initial=0.0) > SETTLED_OBJECTIVE:
            break
        change = np.einsum("lqu,klu->klq", directions, step[:, part.dwells.dwell])
        q = q + np.nan_to_num(change)
        now = evaluate(view, part, psi, sign, q, now.delta, noisy)
    residual = data.y - now.predicted
    J = now.J
    if noisy:
        normal, _ = _normal(data, part, now, residual)
        mixed = part.dwells.by_dwell((2 * hermitian(now.G) @ (data.W @ J)).real)
        share = _solved(normal, mixed)
        J = J - now.G @ share[:, part.dwells.dwell]
    weighted = (data.W @ residual[..., None])[..., 0]
    cost: Real = 2 * np.sum((np.conj(residual) * weighted).real, axis=-1)
    if known:
        _keep(part, now, psi[:, : view.m], q, cost)
    return residual, weighted, J, data.W @ J, q, cost


def nonlinear_part(data: Prepared, y: Complex, q: Complex | None) -> NonlinearPart:
    """Dwells, measured elongations and inputs of prepared data; y (K, lines, channels), q (K, lines, r + s) if known.

    Raises DataError where an input is not measured, or the lines do not belong to dwells.
    """
    dwells = dwells_of(data.model, data.spectrum)
    inputs = _measured_inputs(data.view, y) if q is None else q
    start = None if data.states is None else measured_elongations(data.model, dwells, data.states)
    return NonlinearPart(dwells, start, inputs, frozen(range(len(y)), np.int64), WarmStart())


def _measured_inputs(view: ObservationModel, y: Complex) -> Complex:
    """Inputs as the channels that show nothing else measure them, (K, lines, r + s)."""
    alone = view.inputs_alone & (view.gain < 0) & (view.delay < 0) & ~view.flips
    C = view.direct_q * alone[:, None]
    if np.any(np.linalg.matrix_rank(C) < C.shape[-1]):
        raise DataError(
            "an input of a rig with nonlinear elements is not measured at every line",
            cure="give its channel, with its calibration; where it was at rest, write 0",
        )
    return np.einsum("lqc,klc->klq", np.linalg.pinv(C), y * alone)


def _begin(data: Measured, part: NonlinearPart, theta: Real, known: bool) -> tuple[Complex, Real | None]:
    """Inputs and elongations to start from at θ (K, m): those near the last ones of each repeat, or the measured."""
    K = len(theta)
    q = part.q if data.q is None else data.q
    q = np.broadcast_to(q, (K, *q.shape[1:]))
    start = part.start
    W = 2 * part.dwells.orders + 1
    if known and all(
        int(k) in part.warm.delta and part.warm.delta[int(k)].shape[-1] == W for k in part.repeat
    ):
        start = np.stack([part.warm.near(int(k), at) for k, at in zip(part.repeat, theta, strict=True)])
        if data.q is None:
            q = np.stack([part.warm.inputs[int(k)] for k in part.repeat])
    if start is None:
        return q, None
    start = np.broadcast_to(start, (K, *start.shape[1:]))
    return q, start.reshape(-1, *start.shape[2:])


def _keep(part: NonlinearPart, now: Evaluated, theta: Real, q: Complex, cost: Real) -> None:
    R = len(part.dwells.omega)
    delta = now.delta.reshape(-1, R, *now.delta.shape[1:])
    slope = now.d_delta.reshape(*delta.shape, -1)
    total = np.sum(cost, axis=-1)
    for row, repeat in enumerate(part.repeat.tolist()):
        if total[row] < part.warm.cost.get(repeat, np.inf):
            part.warm.cost[repeat] = float(total[row])
            part.warm.delta[repeat], part.warm.inputs[repeat] = delta[row], q[row]
            part.warm.along[repeat] = theta[row], slope[row]


def _normal(data: Measured, part: NonlinearPart, now: Evaluated, residual: Complex) -> tuple[Real, Real]:
    """Normal matrix and right side for the inputs of each dwell, (K, dwells, Q, Q) and (K, dwells, Q)."""
    WG = data.W @ now.G
    per_line = 2 * (hermitian(now.G) @ WG).real
    gain = 2 * (hermitian(WG) @ residual[..., None]).real[..., 0]
    normal, right = part.dwells.by_dwell(per_line), part.dwells.by_dwell(gain)
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
    largest = np.max(diagonal, axis=-1, keepdims=True)
    soft = np.where(diagonal > 1e-14 * largest, BLIND * diagonal, np.where(largest > 0, largest, 1.0))
    return normal + soft[..., None] * np.eye(normal.shape[-1]), right


def _solved(normal: Real, right: Real) -> Real:
    """normal⁻¹ right, NaN where singular or not finite."""
    finite = np.all(np.isfinite(normal), axis=(-2, -1), keepdims=True)
    safe = np.where(finite, normal, np.eye(normal.shape[-1]))
    return np.linalg.solve(safe, np.where(finite, right, np.nan)).astype(np.float64)
