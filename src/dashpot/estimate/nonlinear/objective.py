"""The likelihood of the harmonics of nonlinear rigs: the same Prediction as for linear ones (THEORY §9).

Lines belong to dwells.  The response at each ψ is found by harmonic balance, on the branch of the measured motion or of
the last response.  Inputs measured with noise are unknowns of each dwell, found by Gauss and Newton's steps and
projected out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen, hermitian
from dashpot.data.spectrum import SettledDwell, Spectrum, WholeRecord
from dashpot.errors import ConvergenceError, DataError
from dashpot.estimate.preparation import Prepared, States, states_if_seen
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import compiled_channels, compiled_rig
from dashpot.model.nonlinear.continuation import grown_from_rest
from dashpot.model.nonlinear.harmonic_balance import (
    SETTLED,
    harmonic_unit_forces,
    periodic_response,
    samples_of,
    slopes,
)
from dashpot.model.nonlinear.harmonics import Drive, real_of
from dashpot.model.observation import (
    ObservationModel,
    calibration_factors,
    calibration_slopes,
    channel_amplitudes,
    observation_model,
)

if TYPE_CHECKING:
    from dashpot.estimate.likelihood.measured import Measured

FEWEST = {True: 7, False: 15}  # harmonics to begin with, of laws that are smooth and that are not

Predicted = tuple[Complex, Complex, Complex, Complex, Complex, Real]  # as a Prediction of the likelihood


# Lines of a spectrum as harmonics of dwells, and the motion that was measured at them.


@dataclass(frozen=True)
class DwellLines:
    """How lines belong to dwells.

    omega (dwells,) fundamentals, rad/s; dwell, order, slot (lines,): the dwell of a line, the multiple of its
    fundamental, and its place among the dwell's lines; slots: lines of the dwell that has most; orders: harmonics H
    of the response.
    """

    omega: Real
    dwell: Ints
    order: Ints
    slot: Ints
    slots: int
    orders: int

    def drive(self, q: Complex, r: int) -> Drive:
        """What drives all dwells of K repeats one after another, for the inputs' lines q (K, lines, r + s)."""
        repeats = len(q)
        harmonics = np.zeros((repeats, len(self.omega), self.orders + 1, q.shape[-1]), dtype=np.complex128)
        harmonics[:, self.dwell, self.order] = q
        flat = harmonics.reshape(-1, *harmonics.shape[2:])
        return Drive(np.tile(self.omega, repeats), flat[..., :r], flat[..., r:])

    def input_directions(self, inputs: int) -> Complex:
        """Real unit changes of the inputs' lines, (dwells, H + 1, inputs, Q), Q = 2 · inputs · slots."""
        along = np.zeros(
            (len(self.omega), self.orders + 1, inputs, self.slots, inputs, 2), dtype=np.complex128
        )
        for i in range(inputs):
            along[self.dwell, self.order, i, self.slot, i] = [1.0, 1j]
        return along.reshape(len(self.omega), self.orders + 1, inputs, -1)

    def lines(self, harmonics: Complex, repeats: int) -> Complex:
        """Lines (K, lines, …) out of harmonics (K · dwells, H + 1, …)."""
        apart = harmonics.reshape(repeats, len(self.omega), *harmonics.shape[1:])
        return apart[:, self.dwell, self.order]

    def by_dwell(self, lines: Real) -> Real:
        """Sums over the lines of each dwell: (K, lines, …) → (K, dwells, …)."""
        total = np.zeros((len(lines), len(self.omega), *lines.shape[2:]), dtype=lines.dtype)
        for slot in range(self.slots):
            at = np.flatnonzero(self.slot == slot)
            total[:, self.dwell[at]] += lines[:, at]
        return total


def dwells_of(model: Model, spectrum: Spectrum) -> DwellLines:
    """The dwells that the lines of a spectrum belong to.

    Raises DataError if lines are of a whole record, or a line is not a multiple of its dwell's fundamental.
    """
    if any(isinstance(shared, WholeRecord) for shared in spectrum.stretches):
        raise DataError(
            "a nonlinear element needs the samples of a continuous record, not its frequency lines",
            cure="give the record itself, or settled dwells with their harmonics",
        )
    groups: dict[tuple[int, int], int] = {}
    taken: list[int] = []  # lines of each dwell so far
    dwell, order, slot, fundamental = [], [], [], []
    for line, number in enumerate(spectrum.stretch.tolist()):
        shared = spectrum.stretches[number]
        assert isinstance(shared, SettledDwell)
        frequency, base = float(spectrum.frequency_hz[line]), shared.fundamental_hz
        key = (number, -1) if base is not None else (number, line)
        if key not in groups:
            groups[key] = len(groups)
            fundamental.append(frequency if base is None else base)
            taken.append(0)
        multiple = 1 if base is None else frequency / base
        if abs(multiple - round(multiple)) > 1e-6 * max(multiple, 1) or round(multiple) < 1:
            raise DataError(
                f"{frequency:g} Hz is not a multiple of {base:g} Hz, the drive frequency of its dwell",
                cure="give each dwell its own frequency",
            )
        dwell.append(groups[key])
        order.append(round(multiple))
        slot.append(taken[groups[key]])
        taken[groups[key]] += 1
    orders = max(FEWEST[all(law.smooth for law in model.laws)], 2 * max(order, default=1) + 1)
    omega = frozen(2 * np.pi * np.array(fundamental), np.float64)
    dwells, multiples, slots = (frozen(numbers, np.int64) for numbers in (dwell, order, slot))
    return DwellLines(omega, dwells, multiples, slots, max(taken, default=1), orders)


def measured_elongations(model: Model, dwells: DwellLines, states: States) -> Real:
    """Elongations of the nonlinear elements as measured, (K, dwells, e, W); 0 at harmonics that were not measured."""
    chosen = model.nonlinear
    lines = states.X @ model.B[chosen].T + states.U @ model.D[chosen].T
    harmonics = np.zeros((len(lines), len(dwells.omega), dwells.orders + 1, len(chosen)), dtype=np.complex128)
    harmonics[:, dwells.dwell, dwells.order] = lines
    return real_of(np.moveaxis(harmonics, 2, -1))


@dataclass
class WarmStart:
    """The last responses of each repeat, from which the next ones start: they stay on their branch.

    along: θ of a response and the slopes of its elongations there, (dwells, e, W, unknowns).  latest: the last
    prediction of a single repeat, (which, and what was predicted): searches come back to their ends.
    """

    delta: dict[int, Real] = field(default_factory=dict)
    inputs: dict[int, Complex] = field(default_factory=dict)
    cost: dict[int, float] = field(default_factory=dict)
    along: dict[int, tuple[Real, Real]] = field(default_factory=dict)
    latest: tuple[bytes, Predicted] | None = None

    def take(self, other: WarmStart, repeat: int) -> None:
        """The last response of a repeat from another one's memory in place of its own."""
        self.delta[repeat], self.inputs[repeat] = other.delta[repeat], other.inputs[repeat]
        self.cost[repeat], self.along[repeat] = other.cost[repeat], other.along[repeat]
        self.latest = None

    def near(self, repeat: int, theta: Real) -> Real:
        """Elongations (dwells, e, W) to start from at θ (unknowns,): the last ones, moved along their slopes.

        Not those of dwells that would move by more than 0.3 of theirs: slopes contain no information on that.
        """
        delta = self.delta[repeat]
        if repeat not in self.along:
            return delta
        at, slope = self.along[repeat]
        size = np.max(np.abs(delta), axis=(1, 2), keepdims=True)
        with np.errstate(invalid="ignore"):
            change = slope @ (theta - at)
            close = np.max(np.abs(change), axis=(1, 2), keepdims=True) <= 0.3 * size
        return np.where(close, delta + change, delta)


# What channels show of settled dwells, with slopes (THEORY §9).


@dataclass(frozen=True)
class ShownLines:
    """Channels at the lines of K repeats, (K, lines, channels, …), and the elongations behind them.

    predicted, its slopes J along ψ and, where inputs are noisy, G along the inputs' lines of the dwell; delta
    (K dwells, e, W), its slopes d_delta (…, m) along θ, and which dwells have a response, converged (K dwells,).
    """

    predicted: Complex
    J: Complex
    G: Complex
    delta: Real
    d_delta: Real
    converged: Bools


def shown_lines(
    view: ObservationModel,
    dwells: DwellLines,
    p: Real,
    constants: Real,
    q: Complex,
    start: Real | None,
    *,
    noisy: bool,
    grow: bool,
) -> ShownLines:
    """The uncalibrated channels of a view at parameters p (K, elements) and inner constants (K, G), J along θ alone.

    q (K, lines, r + s): the inputs, along which slopes are wanted as well if `noisy`; start as `Periodic.delta` or
    None; grow: whether the drive of dwells that Newton's method loses is raised step by step.
    """
    model, K, R, r = view.model, len(p), len(dwells.omega), view.model.D.shape[1]
    along_p, along_g, along = model.T, model.constants_map[0], None
    by_inputs: tuple[Complex | None, Complex | None] = (None, None)
    if noisy:
        directions = dwells.input_directions(q.shape[-1])
        along = np.concatenate([np.zeros((*directions.shape[:-1], view.m)), directions], axis=-1)
        widen = [(0, 0), (0, directions.shape[-1])]
        along_p, along_g = np.pad(along_p, widen), np.pad(along_g, widen)
    times = samples_of(model, dwells.orders)
    rig = compiled_rig(model, times)
    if rig is not None:
        lines = (dwells.omega, dwells.dwell, dwells.order, dwells.orders)
        Y, dY, delta, d_delta, error = compiled_channels(
            rig, view, (p, constants, q, start), lines, times, (along_p, along_g, along)
        )
        converged: Bools = error <= SETTLED
    if rig is None or (grow and not np.all(converged)):
        by_dwell = np.repeat(p, R, axis=0)
        drive = dwells.drive(q, r)
        at = periodic_response(model, by_dwell, np.repeat(constants, R, axis=0), drive, start, grow=grow)
        a = harmonic_unit_forces(model, drive, at)
        X, forces = dwells.lines(at.X, K), dwells.lines(a, K)
        Y = channel_amplitudes(view, X, q, p[:, None, :] * forces)
        if along is not None:
            tiled = np.tile(along, (K, 1, 1, 1))
            by_inputs = (tiled[:, :, :r], tiled[:, :, r:])
        slope = slopes(model, by_dwell, drive, at, a, along_p, along_g, *by_inputs)
        d_forces = p[:, None, :, None] * dwells.lines(slope.unit_forces, K)
        d_forces[..., : view.m] += forces[..., None] * model.T
        dY = view.rates[..., None] * (view.on_x @ dwells.lines(slope.X, K)) + view.force @ d_forces
        delta, d_delta, converged = at.delta, slope.delta, at.converged
    if noisy:  # what channels show of the inputs' lines themselves
        dY[..., view.m :] += view.rates[..., None] * (view.on_q @ directions[dwells.dwell, dwells.order])
    return ShownLines(Y, dY[..., : view.m], dY[..., view.m :], delta, d_delta[..., : view.m], converged)


@dataclass(frozen=True)
class NonlinearPart:
    """What the likelihood of a nonlinear rig needs in addition to the amplitudes.

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
        return replace(self, dwells=replace(self.dwells, orders=orders), start=start, warm=WarmStart())

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


def nonlinear_part(data: Prepared, y: Complex, q: Complex | None) -> NonlinearPart:
    """Dwells, measured elongations and inputs of prepared data; y (K, lines, channels), q (K, lines, r + s) if known.

    Without q, inputs are those that the channels which show nothing else measure.  Raises DataError if an input is
    not measured, or the lines do not belong to dwells.
    """
    dwells, view = dwells_of(data.model, data.spectrum), data.view
    if q is None:
        alone = view.inputs_alone & view.calibration_known
        C = view.direct_q * alone[:, None]
        if np.any(np.linalg.matrix_rank(C) < C.shape[-1]):
            raise DataError(
                "an input of a rig with nonlinear elements is not measured at every line",
                cure="add its channel, with a known calibration; where it was at rest, enter 0",
            )
        q = np.einsum("lqc,klc->klq", np.linalg.pinv(C), y * alone)
    start = None if data.states is None else measured_elongations(data.model, dwells, data.states)
    return NonlinearPart(dwells, start, q, frozen(range(len(y)), np.int64), WarmStart())


def evaluate(
    view: ObservationModel,
    part: NonlinearPart,
    psi: Real,
    sign: Real,
    q: Complex,
    start: Real | None,
    noisy: bool,
) -> ShownLines:
    """Channels, their slopes along ψ and, where the inputs are `noisy`, along the inputs' lines of the dwell.

    psi (K, M), sign (K, channels), q (K, lines, r + s), start as `Periodic.delta` or None.
    """
    model, dwells, K = view.model, part.dwells, len(psi)
    theta = psi[:, : view.m]
    constants = model.inner_constants(theta)
    impossible = np.any(constants[:, must_be_positive(model)] <= 0, axis=-1)
    constants = np.where(impossible[:, None], 1.0, constants)
    p = model.parameters(theta)
    at = shown_lines(view, dwells, p, constants, q, start, noisy=noisy, grow=part.raised)
    kappa = calibration_factors(view, psi, sign)
    predicted, J, G = kappa * at.predicted, kappa[..., None] * at.J, kappa[..., None] * at.G
    if not np.all(at.converged):
        # A dwell without a response shows nothing: a large residual, but a finite one that leaves the others in charge.
        lost = ~at.converged.reshape(K, -1)[:, dwells.dwell]
        predicted = np.where(lost[..., None], 0.0, predicted)
        J, G = (np.where(lost[..., None, None], 0.0, slope) for slope in (J, G))
    if np.any(impossible):
        predicted = np.where(impossible[:, None, None], np.nan, predicted)
    if view.gains or view.delays:
        J = np.concatenate([J, calibration_slopes(view, psi, predicted)], axis=-1)
    return replace(at, predicted=predicted, J=J, G=G)


def must_be_positive(model: Model) -> Ints:
    """Indices of inner constants that make sense above 0 only, (k,)."""
    laws = [(element.force_law, constant.name) for element, constant in model.constants]
    return np.array([j for j, (law, name) in enumerate(laws) if law and name in law.positive], dtype=np.int64)


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
    noisy, theta, dwells = data.q is None, psi[:, : view.m], part.dwells
    q, start = _begin(data, part, theta, known)
    now = evaluate(view, part, psi, sign, q, start, noisy)
    if known and part.patient and start is None and not np.all(now.converged):
        drive = dwells.drive(q, view.model.D.shape[1])
        delta = regained(view.model, theta, drive, now.delta, now.converged)
        now = now if delta is None else evaluate(view, part, psi, sign, q, delta, noisy)
    for _ in range(5 if noisy else 0):  # steps for the inputs, at most
        normal, gain = _normal(data, part, now, data.y - now.predicted)
        step = _solved(normal, gain[..., None])[..., 0]
        size = np.sqrt(np.abs(np.sum(step * gain, axis=-1)))
        if not np.nanmax(size, initial=0.0) > 1e-9:  # standard deviations
            break
        directions = dwells.input_directions(q.shape[-1])[dwells.dwell, dwells.order]
        q = q + np.nan_to_num(np.einsum("lqu,klu->klq", directions, step[:, dwells.dwell]))
        now = evaluate(view, part, psi, sign, q, now.delta, noisy)
    residual = data.y - now.predicted
    J = now.J
    if noisy:
        normal, _ = _normal(data, part, now, residual)
        mixed = dwells.by_dwell((2 * hermitian(now.G) @ (data.W @ J)).real)
        J = J - now.G @ _solved(normal, mixed)[:, dwells.dwell]
    weighted = (data.W @ residual[..., None])[..., 0]
    cost: Real = 2 * np.sum((np.conj(residual) * weighted).real, axis=-1)
    if known:
        # The responses of the repeats that are better than their last ones are remembered.
        delta = now.delta.reshape(-1, len(dwells.omega), *now.delta.shape[1:])
        slope, total = now.d_delta.reshape(*delta.shape, -1), np.sum(cost, axis=-1)
        for row, repeat in enumerate(part.repeat.tolist()):
            if total[row] < part.warm.cost.get(repeat, np.inf):
                part.warm.cost[repeat] = float(total[row])
                part.warm.delta[repeat], part.warm.inputs[repeat] = delta[row], q[row]
                part.warm.along[repeat] = theta[row], slope[row]
    return residual, weighted, J, data.W @ J, q, cost


def regained(model: Model, theta: Real, drive: Drive, last: Real, converged: Bools) -> Real | None:
    """The `last` elongations (N, e, W) with those of up to six dwells that have not converged (N,) found from rest.

    Newton's method misses the motion of rigs far from linear where nobody has measured it: their drive is raised
    slowly.  theta (K, unknowns) of K repeats, one after another in the dwells.  None where none of them is found.
    """
    delta, gained = last.copy(), False
    dwells = len(delta) // len(theta)
    for row in np.flatnonzero(~converged)[:6]:
        try:
            alone = drive.rows(np.arange(len(delta)) == row)
            delta[row] = grown_from_rest(model, theta[row // dwells], alone, points=400)
        except ConvergenceError:
            continue
        gained = True
    return delta if gained else None


def _begin(data: Measured, part: NonlinearPart, theta: Real, known: bool) -> tuple[Complex, Real | None]:
    """Inputs and elongations to start from at θ (K, m): those near the last ones of each repeat, or the measured."""
    K, warm = len(theta), part.warm
    q = part.q if data.q is None else data.q
    q = np.broadcast_to(q, (K, *q.shape[1:]))
    start, W = part.start, 2 * part.dwells.orders + 1
    repeats = part.repeat.tolist()
    if known and all(k in warm.delta and warm.delta[k].shape[-1] == W for k in repeats):
        start = np.stack([warm.near(k, at) for k, at in zip(repeats, theta, strict=True)])
        if data.q is None:
            q = np.stack([warm.inputs[k] for k in repeats])
    if start is None:
        return q, None
    start = np.broadcast_to(start, (K, *start.shape[1:]))
    return q, start.reshape(-1, *start.shape[2:])


def _normal(data: Measured, part: NonlinearPart, now: ShownLines, residual: Complex) -> tuple[Real, Real]:
    """Normal matrix and right side for the inputs of each dwell, (K, dwells, Q, Q) and (K, dwells, Q)."""
    WG = data.W @ now.G
    per_line = 2 * (hermitian(now.G) @ WG).real
    gain = 2 * (hermitian(WG) @ residual[..., None]).real[..., 0]
    normal, right = part.dwells.by_dwell(per_line), part.dwells.by_dwell(gain)
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
    largest = np.max(diagonal, axis=-1, keepdims=True)
    # Inputs that no channel of a dwell sees stay: their "zero" has a relative precision of 1e-12.
    soft = np.where(diagonal > 1e-14 * largest, 1e-12 * diagonal, np.where(largest > 0, largest, 1.0))
    return normal + soft[..., None] * np.eye(normal.shape[-1]), right


def _solved(normal: Real, right: Real) -> Real:
    """normal⁻¹ right, NaN where singular or not finite."""
    finite = np.all(np.isfinite(normal), axis=(-2, -1), keepdims=True)
    safe = np.where(finite, normal, np.eye(normal.shape[-1]))
    return np.linalg.solve(safe, np.where(finite, right, np.nan)).astype(np.float64)


# What a nonlinear rig predicts of measured harmonics, on the branch of the measured motion.


def _at_estimate(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
) -> tuple[ObservationModel, Measured, NonlinearPart, Real, Real]:
    """View, lines as the likelihood has them, ψ (1, M) and signs (1, channels), as for `predicted_lines`."""
    from dashpot.estimate.likelihood.objective import measured

    flat = replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=V[None], moments=None)
    view = observation_model(model, spectrum.channels, spectrum.omega)
    states = states_if_seen(view, flat, V[None])
    exact = measured(Prepared(view, flat, V[None], states, True, np.ones(1, dtype=bool)))
    part = measured_part(exact)
    if part.dwells.orders < 31:
        part = part.with_harmonics(31)
    psi = np.array([*theta, *(calibrations[name] for name in view.names[view.m :])])
    sign = np.array([calibrations.get(f"{channel.name}.sign", 1.0) for channel in spectrum.channels])
    return view, exact, part, psi[None], sign[None]


def predicted_lines(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
) -> tuple[Complex, Complex]:
    """(channels (lines, channels), inputs (lines, r + s)) at θ for a spectrum, noise V (lines, channels, channels).

    `calibrations`: NAME.gain and NAME.delay that an estimate found.  Inputs with noise are those that suit best.
    """
    view, exact, part, psi, sign = _at_estimate(model, theta, spectrum, V, calibrations)
    residual, _, _, _, q, _ = predict_harmonics(view, exact, part, psi, sign)
    shown: Complex = exact.y[0] - residual[0]
    # Exact channels of inputs take no part in the likelihood; they show what drives.
    alone = view.inputs_alone & ~np.any(np.diagonal(exact.W[0], axis1=-2, axis2=-1), axis=0)
    shown[:, alone] = np.einsum("lcq,lq->lc", view.direct_q, q[0])[:, alone]
    return shown, q[0]


def noise_of_measured_inputs(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
) -> Real:
    """Variance that the channels get, through the rig, from the noise of the inputs' channels, (lines, channels).

    To first order about the motion at θ; V takes the inputs as exact, the noise is that of `spectrum`.
    """
    view, exact, part, psi, sign = _at_estimate(model, theta, spectrum, V, calibrations)
    q, dwells = predict_harmonics(view, exact, part, psi, sign)[4], part.dwells
    G = evaluate(view, part, psi, sign, q, part.warm.delta[0], True).G[0]
    alone = view.inputs_alone
    back = np.linalg.pinv(view.direct_q * alone[:, None])
    noise = np.where(alone[:, None] & alone, np.nan_to_num(spectrum.covariance), 0.0)
    of_inputs = np.einsum("lic,lcd,lid->li", back, noise, back.conj()).real
    # Each real change of a dwell's inputs is the real or imaginary part of one input at one line.
    parts = np.abs(dwells.input_directions(q.shape[-1])[dwells.dwell, dwells.order]) ** 2
    of_parts = dwells.by_dwell(np.einsum("liq,li->lq", parts, of_inputs / 2)[None])[0]
    return np.einsum("lcq,lq->lc", np.abs(G) ** 2, of_parts[dwells.dwell])
