"""Periodic motions followed along the frequency or the size of the drive, through folds (THEORY §9).

Pseudo-arclength continuation in (δ, λ), λ the share of the way from the first to the last frequency or amplitude: the
predictor goes along the tangent, Newton's method returns to the curve on the plane across it (Keller 1977; Seydel 2010,
Practical Bifurcation and Stability Analysis, chapter 4).  A fold is where λ turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.channel import Channel
from dashpot.errors import ConvergenceError, ModelError, UsageError
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate, period_basis
from dashpot.model.nonlinear.force_law import Constant
from dashpot.model.nonlinear.harmonic_balance import (
    Balance,
    Balanced,
    Periodic,
    balance,
    harmonic_unit_forces,
    periodic_at,
    periodic_response,
    samples_of,
    secant_of,
    solved,
)
from dashpot.model.nonlinear.harmonics import Drive, complex_of, joined_drives, real_of
from dashpot.model.nonlinear.integration import NODES, Forcing, Integrator, forcing, propagator
from dashpot.model.observation import channel_amplitudes, observation_model
from dashpot.numerics.small_systems import solve_scaled

# Stability of periodic motions: Floquet multipliers from the linearised motion over one period (THEORY §9).
#
# The product of the tangents of all steps of a period is the monodromy matrix. Where no law has a state the tangents
# follow from the slopes of the laws along the motion of the harmonic balance, all steps and dwells at once. States of
# laws are states of the motion: there the period is cut into segments, integrated side by side from the states of the
# harmonic balance. Source: Nayfeh and Balachandran (1995), Applied Nonlinear Dynamics, section 3.2.

SEGMENTS = 32  # of a period, integrated side by side


def floquet_multipliers(model: Model, theta: Real, drive: Drive, at: Periodic) -> Complex:
    """Multipliers of the state over one period, (N, states), largest first; NaN where the response did not converge.

    theta (unknowns,) of all N dwells.  Raises ModelError if the motion cannot be integrated: a coordinate without
    mass, or a hysteretic damper.
    """
    times = max(128, 4 * (drive.orders + 1))
    times += -times % SEGMENTS
    if any(law.has_state for law in model.laws):
        monodromy = _integrated(model, theta, drive, at, times)
    else:
        monodromy = _along_motions(model, theta, drive, at, times)
    # Multipliers, largest first, (N, states); infinite where the matrix is not finite
    finite = np.all(np.isfinite(monodromy), axis=(-2, -1))
    values = np.linalg.eigvals(np.where(finite[:, None, None], monodromy, 0.0)).astype(np.complex128)
    order = np.argsort(-np.abs(values), axis=-1, kind="stable")
    return np.where(
        at.converged[:, None],
        np.where(finite[:, None], np.take_along_axis(values, order, axis=-1), np.inf),
        np.nan,
    )


def _along_motions(model: Model, theta: Real, drive: Drive, at: Periodic, times: int) -> Real:
    """Monodromy matrices of a rig whose laws have no state, (N, 2 n, 2 n), from the slopes of the laws."""
    p, Bn = model.parameters(theta), model.B[model.nonlinear]
    n, nodes = model.n, 4 * len(model.nonlinear)
    constants = model.inner_constants(theta)
    N, e, W = at.delta.shape
    there, rate, _ = period_basis((W - 1) // 2, times)
    angle = 2 * np.pi / times * np.arange((W + 1) // 2)
    by_d, by_v = np.zeros((2, N, times, len(NODES), e))
    for row, (law, inner) in enumerate(zip(model.laws, model.constant_slices, strict=True)):
        g = np.broadcast_to(constants[inner], (N, inner.stop - inner.start))
        for node, share in enumerate(NODES):
            q = real_of(complex_of(at.delta[:, row]) * np.exp(1j * share * angle))
            d, v = q @ there.T, drive.omega[:, None] * (q @ rate.T)
            slopes = law(d, v, d, g).slopes
            by_d[..., node, row], by_v[..., node, row] = slopes.get("d", 0.0), slopes.get("v", 0.0)
    by_d, by_v = by_d.reshape(N, times, -1), by_v.reshape(N, times, -1)
    monodromy = np.empty((len(drive.omega), 2 * n, 2 * n))
    with np.errstate(all="ignore"):
        for row, omega in enumerate(drive.omega):
            step = propagator(model, p, 2 * np.pi / (float(omega) * times))
            pulled = np.moveaxis(step.Wn, 1, 2).reshape(4, 2 * n, nodes)
            reach_d, reach_v = ((Bn @ part).reshape(nodes, -1) for part in (pulled[:, :n], pulled[:, n:]))
            free_d, free_v = ((Bn @ part).reshape(nodes, -1) for part in (step.E[:, :n], step.E[:, n:]))
            d, v = by_d[row][..., None], by_v[row][..., None]
            forces = solved(np.eye(nodes) - d * reach_d - v * reach_v, d * free_d + v * free_v)
            monodromy[row] = _product(step.E[3] + pulled[3] @ forces)
    return monodromy


def _product(tangents: Real) -> Real:
    """The last of (times, n, n) times … times the first, pair by pair."""
    while len(tangents) > 1:
        if len(tangents) % 2:
            tangents = np.concatenate([tangents, np.eye(tangents.shape[-1])[None]])
        tangents = tangents[1::2] @ tangents[::2]
    return tangents[0]


def stable_motions(model: Model, theta: Real, drive: Drive, at: Periodic) -> Bools | None:
    """Whether each motion returns to itself after a small disturbance, (N,); None if that cannot be told."""
    try:
        multipliers = floquet_multipliers(model, theta, drive, at)
    except ModelError:
        return None
    with np.errstate(invalid="ignore"):
        return np.abs(multipliers[:, 0]) <= 1 + 1e-6  # rounding of what does not decay


def _integrated(model: Model, theta: Real, drive: Drive, at: Periodic, times: int) -> Real:
    """Monodromy matrices by integration from the states of the harmonic balance, (N, states, states)."""
    first = np.arange(0, times, times // SEGMENTS)
    rows = []
    for row in range(len(drive.omega)):
        # The integrator of one dwell over a period; the spline of its inputs goes on beyond both ends
        there, _, _ = period_basis(drive.orders, times)
        inputs = np.concatenate([drive.U[row], drive.f[row]], axis=-1)
        period = there @ real_of(inputs.T).T
        lead = times // 4
        longer = np.concatenate([period[-lead:], period, period[: lead + 1]])
        step = 2 * np.pi / (drive.omega[row] * times)
        whole = forcing(step, longer)
        machine = Integrator(model, theta, Forcing(step, whole.coefficients[lead : lead + times]), 1)
        # Coordinates, their rates and the states of laws at the instants of the period, (times, states)
        there, rate, _ = period_basis(drive.orders, times)
        q = real_of(at.X[row].T).T
        parts = [there @ q, drive.omega[row] * (rate @ q)]
        for state in at.forces.states:
            if state.shape[1]:
                instants = np.arange(times) * state.shape[1] / times
                parts.append(
                    np.interp(instants, np.arange(state.shape[1]), state[row], period=state.shape[1])[:, None]
                )
        state = np.concatenate(parts, axis=1)[first]
        slope = np.zeros((len(first), machine.states, machine.states))
        slope[:] = np.eye(machine.states)
        with np.errstate(all="ignore"):
            for step in range(times // SEGMENTS):
                stepped = machine.advance(state, slope, first + step, False)
                state, slope = stepped.state, stepped.slope
            rows.append(_product(slope))
    return np.array(rows)


FIRST, SMALLEST, LARGEST = 0.01, 1e-6, 0.05  # steps, of the way
POINTS = 3000  # on one curve at most
TURNS = 450  # of Newton's method on one curve, or more while they have few equations:
ROWS = 80_000  # so many in all
WEAKEST = 0.01  # of the drive, from which a first point is followed where nothing else leads to it
DIFFERENCE = 1e-6  # step of λ for slopes along it


@dataclass(frozen=True)
class ResponseBranch:
    """A curve of periodic motions, P points in the order in which they were found.

    drive and motion of the points; along (P,): λ; stable (P,), None where the motion cannot be integrated; folds (…,):
    the points at which λ turns.
    """

    drive: Drive
    motion: Periodic
    along: Real
    stable: Bools | None
    folds: Ints


DriveAt = Callable[[float], Drive]  # the drive of one dwell at a share λ of the way


def frequency_sweep(drive: Drive, last: float) -> DriveAt:
    """From the frequency of `drive`, one dwell, to `last` (rad/s), evenly in its logarithm."""
    ratio = last / float(drive.omega[0])
    return lambda share: Drive(drive.omega * ratio**share, drive.U, drive.f)


def amplitude_sweep(drive: Drive, last: float) -> DriveAt:
    """From the amplitudes of `drive`, one dwell, to `last` times them."""
    return lambda share: drive.scaled(1 + share * (last - 1))


def followed(
    model: Model, theta: Real, drive_at: DriveAt, start: Real | None = None, *, points: int = POINTS
) -> ResponseBranch:
    """The motions from λ = 0 to λ = 1, through every fold on the way; from `start` (e, W) or the linear response.

    Raises ConvergenceError if there is no response at λ = 0, or the curve cannot be followed to its end.
    """
    tracer = _Tracer(model, theta, drive_at)
    q = tracer.first(start)
    path = tracer.trace(q, points)
    drives = [drive_at(share) for _, share in path]
    drive = joined_drives(drives)
    delta = np.array([point for point, _ in path])
    along = np.array([share for _, share in path])
    at = tracer.whole(drive, delta)
    turns = np.diff(np.sign(np.diff(along)))
    folds = frozen(np.flatnonzero(turns) + 1, np.int64)
    stable = stable_motions(model, theta, drive, at)
    return ResponseBranch(drive, at, frozen(along, np.float64), stable, folds)


def grown_from_rest(model: Model, theta: Real, drive: Drive, *, points: int = POINTS) -> Real:
    """Elongations (e, W) of the motion that the drive of one dwell leads to when it is raised slowly, through folds.

    theta (unknowns,).  Raises ConvergenceError if it cannot be followed.
    """
    tracer = _Tracer(model, theta, amplitude_sweep(drive.scaled(WEAKEST), 1 / WEAKEST))
    return tracer.trace(tracer.first(None), points)[-1][0]


class _Tracer:
    """Residual, its slopes and steps along one curve of one rig."""

    def __init__(self, model: Model, theta: Real, drive_at: DriveAt) -> None:
        self.model, self.theta, self.drive_at = model, theta, drive_at
        self.p, self.constants = model.parameters(theta)[None], model.inner_constants(theta)[None]
        orders = drive_at(0.0).orders
        self.times = samples_of(model, orders)
        self.turns_left = max(TURNS, ROWS // (len(model.nonlinear) * (2 * orders + 1)))

    def first(self, start: Real | None) -> Real:
        """Elongations at λ = 0, (e, W), followed from a weak drive where Newton's method misses them.

        Raises ConvergenceError.
        """
        begun, drive = None if start is None else start[None], self.drive_at(0.0)
        at = periodic_response(self.model, self.p, self.constants, drive, begun)
        first: Real = at.delta[0]
        if not at.converged[0]:
            grown = _Tracer(self.model, self.theta, amplitude_sweep(drive.scaled(WEAKEST), 1 / WEAKEST))
            weak = periodic_response(self.model, self.p, self.constants, drive.scaled(WEAKEST))
            if not weak.converged[0]:
                raise ConvergenceError(
                    "harmonic balance finds no response at the first point",
                    cure="start elsewhere, or reduce the drive",
                )
            first = grown.trace(weak.delta[0], POINTS)[-1][0]
            self.turns_left = grown.turns_left
        return first

    def equations(self, share: float, secant: Complex) -> Balance:
        """The equations at λ."""
        return balance(self.model, self.p, self.drive_at(share), secant)

    def state(self, q: Real, share: float) -> tuple[Real, Real, Complex]:
        """(residual (eW,), ∂/∂q (eW, eW), the share of the laws in the linear part) at one point."""
        forces = alternate(self.model, self.constants, self.drive_at(share).omega, q[None], self.times)
        secant = secant_of(self.p[:, self.model.nonlinear], forces.a, q[None])
        equations = self.equations(share, secant)
        return equations.residual(q[None], forces.a).ravel(), equations.matrix(forces.slope)[0], secant

    def along(self, q: Real, share: float, secant: Complex) -> Real:
        """∂residual/∂λ, (eW,)."""
        sides = []
        for step in (DIFFERENCE, -DIFFERENCE):
            omega = self.drive_at(share + step).omega
            unit = alternate(self.model, self.constants, omega, q[None], self.times, slopes=False).a
            sides.append(self.equations(share + step, secant).residual(q[None], unit).ravel())
        return (sides[0] - sides[1]) / (2 * DIFFERENCE)

    def corrected(self, guess: Real, plane: Real, size: float, by_share: Real) -> _Corrected | None:
        """The point of the curve on the plane across `plane` through `guess`, (eW + 1,), in (q / size, λ).

        The slope along λ is renewed once, which costs a step at most.  None where steps do not shrink.
        """
        point = guess.copy()
        for turn in range(10):  # Newton's method, at most
            self.turns_left -= 1
            r, by_q, secant = self.state(size * point[:-1].reshape(self.shape), float(point[-1]))
            if turn == 1:
                by_share = self.along(size * point[:-1].reshape(self.shape), float(point[-1]), secant)
            matrix = np.concatenate([by_q * size, by_share[:, None]], axis=1)
            step = _solved(np.concatenate([matrix, plane[None]]), np.append(-r, -plane @ (point - guess)))
            if step is None or np.linalg.norm(step) > 1.0:
                return None
            point = point + step
            if np.max(np.abs(step)) <= 1e-8:  # of the elongation
                return _Corrected(point, turn + 1, by_q, secant)
        return None

    def trace(self, q: Real, points: int) -> list[tuple[Real, float]]:
        """Points (δ, λ) from λ = 0 to λ = 1.  Raises ConvergenceError if the curve cannot be followed."""
        self.shape = q.shape
        size = self._size(q)
        point = np.append(q.ravel() / size, 0.0)
        _, by_q, secant = self.state(q, 0.0)
        by_share = self.along(q, 0.0, secant)
        direction = _tangent(by_q * size, by_share, np.eye(len(point))[-1])
        step, path = FIRST, [(q, 0.0)]
        while len(path) < points and self.turns_left > 0 and direction is not None and step >= SMALLEST:
            target, plane = point + step * direction, direction
            ending = target[-1] >= 1.0
            if ending:  # the last point lies on λ = 1 itself
                target, plane = point + direction * (1.0 - point[-1]) / direction[-1], np.eye(len(point))[-1]
            end = self.corrected(target, plane, size, by_share)
            ahead = None
            if end is not None:
                q = size * end.point[:-1].reshape(self.shape)
                slope = self.along(q, float(end.point[-1]), end.secant)
                ahead = _tangent(end.by_q * size, slope, direction)
            # A step is halved where the tangent turns by more than 26°.
            if end is None or ahead is None or float(ahead @ direction) < 0.9:
                step /= 2
                continue
            path.append((q, float(end.point[-1])))
            if ending:
                return path
            if end.point[-1] < 0:
                break
            larger = self._size(q) / size
            size *= larger
            point, by_share = np.append(end.point[:-1] / larger, end.point[-1]), slope
            direction = _tangent(end.by_q * size, by_share, ahead)
            step = min(step * (1.5 if end.turns <= 4 else 1.0), LARGEST)
        raise ConvergenceError(
            f"the response curve cannot be followed beyond {100 * path[-1][1]:.3g} % of the way",
            cure="use a shorter range, more harmonics or a smaller drive",
        )

    @staticmethod
    def _size(q: Real) -> float:
        """What elongations count in: a step of 1 is as far as the whole way of λ."""
        size = float(np.linalg.norm(q))
        return size if size > 0 else 1.0

    def whole(self, drive: Drive, delta: Real) -> Periodic:
        """The motions at points of the curve."""
        count = len(delta)
        p, constants = np.repeat(self.p, count, axis=0), np.repeat(self.constants, count, axis=0)
        forces = alternate(self.model, constants, drive.omega, delta, self.times)
        equations = balance(self.model, p, drive, secant_of(p[:, self.model.nonlinear], forces.a, delta))
        return periodic_at(self.model, Balanced(equations, delta, forces, np.zeros(count)))


@dataclass(frozen=True)
class _Corrected:
    """A point of the curve, (eW + 1,), the Newton steps it took, and the slopes with which the last was made."""

    point: Real
    turns: int
    by_q: Real
    secant: Complex


def _tangent(by_q: Real, by_share: Real, before: Real) -> Real | None:
    """Unit direction of the curve, (eW + 1,), on from `before`; None if it has none."""
    matrix = np.concatenate([np.concatenate([by_q, by_share[:, None]], axis=1), before[None]])
    direction = _solved(matrix, np.eye(len(before))[-1])
    return None if direction is None else direction / np.linalg.norm(direction)


def _solved(matrix: Real, right: Real) -> Real | None:
    """matrix⁻¹ right, None where it is singular or not finite."""
    try:
        solution: Real = np.linalg.solve(matrix, right).astype(np.float64)
    except np.linalg.LinAlgError:
        return None
    return solution if np.all(np.isfinite(solution)) else None


# What channels show of periodic motions of nonlinear rigs: harmonics, and their largest value over a
# period.


# Backbones: free undamped periodic motions of a nonlinear rig, their frequency against their size (THEORY §9).
#
# Dampers and laws that dissipate are left out and inputs stand still.  The motion is even in time, so that only real
# parts of harmonics are unknown: of (K − h² ω² M) X_h + Bᵀ p a_h = 0 these and ω, at a given size of one elongation.
# Source: Kerschen et al. (2009), Mechanical Systems and Signal Processing 23, 170 (nonlinear normal modes).


def channel_harmonics(
    model: Model, p: Real, channels: Sequence[Channel], drive: Drive, at: Periodic
) -> Complex:
    """Harmonics of the channels' quantities, (N, H + 1, channels), SI units; p (N, elements) or (elements,).

    Raises DataError if a channel measures something that the rig lacks.
    """
    N, orders = len(drive.omega), drive.orders
    omega = (drive.omega[:, None] * np.arange(orders + 1)).ravel()
    view = observation_model(model, channels, omega)
    inputs = np.concatenate([drive.U, drive.f], axis=-1).reshape(len(omega), -1)
    strength = np.broadcast_to(p, (N, len(model.elements)))[:, None]
    forces = (strength * harmonic_unit_forces(model, drive, at)).reshape(len(omega), -1)
    X = at.X.reshape(len(omega), model.n)
    return channel_amplitudes(view, X, inputs, forces).reshape(N, orders + 1, len(channels))


def swing(harmonics: Complex) -> Real:
    """Half of what each channel moves from its lowest to its highest value, (N, channels), of (N, H + 1, channels)."""
    orders = harmonics.shape[1] - 1
    there, _, _ = period_basis(orders, 16 * (orders + 1))  # instants of a period
    period = np.einsum("tw,ncw->ntc", there, real_of(np.moveaxis(harmonics, 1, -1)))
    return (np.max(period, axis=1) - np.min(period, axis=1)) / 2


SMALLEST = 1e-3  # of the largest size: where the curve begins


@dataclass(frozen=True)
class Backbone:
    """Free motions, small to large, of the `rig` without what dissipates: drive (no input, ω of each) and motion of P
    points."""

    rig: Model
    drive: Drive
    motion: Periodic


def backbone(model: Model, theta: Real, mode: int, largest: float, *, orders: int = 7) -> Backbone:
    """The motions that start from a `mode` (0 is the lowest) until an elongation has the fundamental `largest`, m.

    The elongation is that of the nonlinear spring that moves most in the mode.  Ends earlier where the curve cannot be
    followed.  Raises UsageError if the rig has no nonlinear spring that keeps energy, or no such mode.
    """
    from scipy.linalg import eigh

    free = _undamped(model, theta)
    p, constants = free.p0[None], free.constants_map[1][None]
    parts = matrices(free, p[0])
    zero = np.zeros((1, len(free.nonlinear), 3))
    tangent = alternate(free, constants, np.ones(1), zero, 32).slope[0, :, 1, 1]
    Bn = free.B[free.nonlinear]
    K = parts.K + Bn.T @ ((p[0][free.nonlinear] * tangent)[:, None] * Bn)
    if np.linalg.matrix_rank(parts.M) < free.n or not 0 <= mode < free.n:
        raise UsageError(
            f"there is no mode {mode + 1}", cure=f"it has {free.n}; every coordinate needs a mass"
        )
    squares, shapes = eigh(K, parts.M)
    shape: Real = shapes[:, mode]
    if squares[mode] <= 0 or not np.any(np.abs(Bn @ shape) > 1e-9 * np.max(np.abs(shape))):
        raise UsageError(
            f"mode {mode + 1} does not oscillate, or does not involve a nonlinear spring",
            cure="choose another mode",
        )
    omega = float(np.sqrt(squares[mode]))
    delta = free.B[free.nonlinear] @ shape
    row = int(np.argmax(np.abs(delta)))
    solver = _FreeMotion(free, p, constants, orders, row)
    X = np.zeros((model.n, orders + 1))
    X[:, 1] = SMALLEST * largest * shape / delta[row]
    points: list[tuple[Real, float]] = []
    sizes = np.geomspace(SMALLEST * largest, largest, 60)
    for size, ratio in zip(sizes, np.append(1.0, sizes[1:] / sizes[:-1]), strict=True):
        ended = solver.solved(ratio * X, omega, float(size))
        if ended is None:
            break
        X, omega = ended
        points.append((X, omega))
    if not points:
        raise UsageError(
            "the backbone curve of this mode cannot be followed", cure="give a smaller amplitude"
        )
    drive = joined_drives([solver.still(omega) for _, omega in points])
    return Backbone(free, drive, solver.motion(drive, np.array([X for X, _ in points])))


def _undamped(model: Model, theta: Real) -> Model:
    """The rig at θ, all values known, without what dissipates.  Raises UsageError if no nonlinear spring is left."""
    values, constants = model.parameters(theta).tolist(), model.inner_constants(theta).tolist()
    slices = iter(model.constant_slices)
    elements = []
    for element, value in zip(model.elements, values, strict=True):
        law = element.force_law
        if law is not None:
            inner = constants[next(slices)]
            named = [Constant(name, number) for name, number in zip(law.constant_names, inner, strict=True)]
            kept = not law.has_state and "v" not in law.expression.names
            law = law.with_constants(named) if kept else None
        else:
            kept = element.kind not in (Kind.DAMPER, Kind.HYSTERETIC)
        elements.append(
            Element(element.name, element.kind, element.along, value=value if kept else 0.0, force_law=law)
        )
    if not any(element.force_law is not None for element in elements):
        raise UsageError(
            "the rig has no nonlinear spring, so its backbone curves are straight",
            cure="leave out --backbone",
        )
    return replace(model, elements=tuple(elements))


class _FreeMotion:
    """Newton's method for one point of a backbone; unknown are ω and the real parts of the coordinates' harmonics."""

    def __init__(self, model: Model, p: Real, constants: Real, orders: int, row: int) -> None:
        self.model, self.p, self.constants, self.orders, self.row = model, p, constants, orders, row
        self.times = samples_of(model, orders)
        parts = matrices(model, p[0])
        self.M, self.K = parts.M, parts.K
        self.Bn = model.B[model.nonlinear]
        self.even = np.array([0, *range(1, 2 * orders + 1, 2)])  # places of the real parts

    def still(self, omega: float) -> Drive:
        """No input at all, at ω."""
        r, s = len(self.model.displacement_inputs), len(self.model.force_inputs)
        shape = (1, self.orders + 1)
        return Drive(
            np.array([omega]),
            np.zeros((*shape, r), dtype=np.complex128),
            np.zeros((*shape, s), dtype=np.complex128),
        )

    def elongations(self, X: Real) -> Real:
        """Of the nonlinear elements, (1, e, W), for real harmonics X (n, H + 1)."""
        q = np.zeros((1, len(self.Bn), 2 * self.orders + 1))
        q[0][:, self.even] = self.Bn @ X
        return q

    def solved(self, X: Real, omega: float, size: float) -> tuple[Real, float] | None:
        """(X, ω) whose elongation `row` has the fundamental `size`, None where Newton's method does not settle."""
        n, count = len(X), X.size
        condition = np.zeros((n, self.orders + 1))
        condition[:, 1] = self.Bn[self.row]
        for _ in range(20):  # Newton's method, at most
            r, by_X, by_log = self._slopes(X, omega)
            square = np.zeros((count + 1, count + 1))
            square[:count, :count], square[:count, count] = by_X, by_log / size
            square[count, :count] = condition.ravel()
            missing = np.append(-r, size - float(np.sum(condition * X)))
            step = solve_scaled(square, missing) if np.all(np.isfinite(square)) else missing * np.nan
            if not np.all(np.isfinite(step)):
                return None
            step = step * min(1.0, 0.2 * size / max(abs(float(step[-1])), 1e-300))
            X = X + step[:-1].reshape(X.shape)
            omega *= 1 + float(step[-1]) / size
            if np.max(np.abs(step)) <= 1e-10 * size:
                return X, omega
        return None

    def _slopes(self, X: Real, omega: float) -> tuple[Real, Real, Real]:
        """(K − h² ω² M) X_h + Bᵀ p a_h, (n (H + 1),), with slopes along X and ln ω."""
        n, columns = X.shape
        squares = (np.arange(columns) * omega) ** 2
        forces = alternate(self.model, self.constants, np.array([omega]), self.elongations(X), self.times)
        strength = self.p[0, self.model.nonlinear]
        pull = self.Bn.T @ (strength[:, None] * forces.a[0][:, self.even])
        r = self.K @ X - (self.M @ X) * squares + pull
        slope = strength[:, None, None] * forces.slope[0][:, self.even][:, :, self.even]
        by_X = np.einsum("ei,ehk,ej->ihjk", self.Bn, slope, self.Bn)
        h = np.arange(columns)
        linear = self.K[:, :, None] - self.M[:, :, None] * squares
        by_X[:, h, :, h] += np.moveaxis(linear, -1, 0)
        by_log = (-2 * (self.M @ X) * squares).ravel()
        return r.ravel(), by_X.reshape(n * columns, n * columns), by_log

    def motion(self, drive: Drive, X: Real) -> Periodic:
        """The whole motions at points X (P, n, H + 1) of the curve."""
        count = len(X)
        delta = np.concatenate([self.elongations(point) for point in X])
        p, constants = np.repeat(self.p, count, axis=0), np.repeat(self.constants, count, axis=0)
        forces = alternate(self.model, constants, drive.omega, delta, self.times)
        # A damper's share in the linear part keeps it regular at its own resonance; the motion does not depend on it.
        damper = 1j * drive.omega[:, None] ** 2 * float(np.max(np.abs(self.M)))
        equations = balance(self.model, p, drive, np.repeat(damper, len(self.Bn), axis=1))
        return periodic_at(self.model, Balanced(equations, delta, forces, np.zeros(count)))
