"""The alternating frequency-time transform: harmonics of elongations → one period in time → unit forces → harmonics.

For laws without a state the slope is diagonal in time: ∂a/∂q = Γ⁺ (φ_d Γ + φ_v Γ̇).  Laws with a state are followed
over the periods until they repeat, and their slopes with them (THEORY §9).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.model.network import Model
from dashpot.model.nonlinear.expression import Expression, Node
from dashpot.model.nonlinear.force_law import ForceLaw, Operator
from dashpot.model.nonlinear.harmonics import Drive, rates_of_orders
from dashpot.numerics.kernel import kernel_function, threads

if TYPE_CHECKING:
    from dashpot.model.observation import ObservationModel


@dataclass(frozen=True)
class Alternated:
    """Harmonics of the unit forces: a (N, e, W), slope ∂a/∂q (N, e, W, W), by_constant: (N, W, G) and states: (N, times
    or 0) for each element."""

    a: Real
    slope: Real
    by_constant: tuple[Real, ...]
    states: tuple[Real, ...] = ()

    def rows(self, keep: Bools | Ints) -> Alternated:
        """That of some of the dwells."""
        by_constant = tuple(part[keep] for part in self.by_constant)
        return Alternated(self.a[keep], self.slope[keep], by_constant, tuple(z[keep] for z in self.states))

    def put(self, rows: Ints, other: Alternated) -> None:
        """Write `other` into some of the dwells, rows (k,)."""
        self.a[rows], self.slope[rows] = other.a, other.slope
        for mine, new in zip(
            (*self.by_constant, *self.states), (*other.by_constant, *other.states), strict=True
        ):
            mine[rows] = new


@lru_cache(maxsize=32)
def period_basis(orders: int, times: int) -> tuple[Real, Real, Real]:
    """(Γ, Γ̇ at ω = 1, Γ⁺): period from harmonics (times, W), its rate, and harmonics from a period (W, times)."""
    angle = 2 * np.pi * np.outer(np.arange(times), np.arange(1, orders + 1)) / times
    h = np.arange(1, orders + 1)
    there, rate = np.ones((times, 2 * orders + 1)), np.zeros((times, 2 * orders + 1))
    there[:, 1::2], there[:, 2::2] = np.cos(angle), -np.sin(angle)
    rate[:, 1::2], rate[:, 2::2] = -h * np.sin(angle), -h * np.cos(angle)
    back = 2 / times * there.T
    back[0] = 1 / times
    return frozen(there, np.float64), frozen(rate, np.float64), frozen(back, np.float64)


def alternate(
    model: Model,
    constants: Real,
    omega: Real,
    q: Real,
    times: int,
    *,
    slopes: bool = True,
    start: Alternated | None = None,
) -> Alternated:
    """Harmonics of the unit forces of the nonlinear elements at elongations q (N, e, W), and their slopes.

    constants (N, inner constants), omega (N,) rad/s; `times` instants of a period, even; `start`: the transform at
    elongations nearby, whose states are a first guess.
    """
    N, e, W = q.shape
    rig = None if slopes else compiled_rig(model, times)
    if rig is not None:
        nothing = tuple(np.zeros((N, 0)) for _ in range(e))
        return Alternated(
            compiled_forces(rig, constants, omega, q, times), np.empty((0, e, W, W)), (), nothing
        )
    there, rate, back = period_basis((W - 1) // 2, times)
    a = np.empty_like(q)
    slope = np.empty((N, e, W, W) if slopes else (0, e, W, W))
    by_constant, states = [], []
    for row, (law, own) in enumerate(zip(model.laws, model.constant_slices, strict=True)):
        d, v = q[:, row] @ there.T, omega[:, None] * (q[:, row] @ rate.T)
        g = constants[:, own]
        if law.has_state:
            begun = None if start is None else start.states[row]
            force, state, along, inner = _with_state(law, d, v, g, omega, there, rate, slopes, begun)
            states.append(state)
            a[:, row] = force @ back.T
            if slopes:
                slope[:, row] = back @ along
                by_constant.append(back @ inner)
            continue
        states.append(np.zeros((N, 0)))
        at = law(d, v, d, g)
        a[:, row] = np.broadcast_to(at.value, d.shape) @ back.T
        if slopes:
            # ∂φ/∂d, ∂φ/∂v (N, times) and ∂φ/∂g (N, times, G) of a law without a state
            zero = np.zeros_like(d)
            by_d = np.broadcast_to(at.slopes.get("d", zero), d.shape)
            by_v = np.broadcast_to(at.slopes.get("v", zero), d.shape)
            columns = [np.broadcast_to(at.slopes.get(name, zero), d.shape) for name in law.constant_names]
            by_g = np.stack(columns, -1) if columns else np.zeros((*d.shape, 0))
            slope[:, row] = modulated(by_d, (W - 1) // 2)
            if "v" in at.slopes:
                # Along q for slopes along the harmonics of dδ/d(ωt): Re X_h goes with −h Im, Im with h Re
                by_rate = modulated(by_v * omega[:, None], (W - 1) // 2)
                h = np.arange(1, (W + 1) // 2)
                turned = np.zeros_like(by_rate)
                turned[..., 1::2], turned[..., 2::2] = h * by_rate[..., 2::2], -h * by_rate[..., 1::2]
                slope[:, row] += turned
            by_constant.append(back @ by_g)
    return Alternated(a, slope, tuple(by_constant), tuple(states))


def modulated(g: Real, orders: int) -> Real:
    """Γ⁺ diag(g) Γ for g (N, times), (N, W, W): products of cosines and sines are harmonics of g at i ± j.

    cos iα cos jα = (cos (i − j)α + cos (i + j)α)/2 and so on, so that one transform of g tells all.
    """
    N, times = g.shape
    spectrum = np.fft.fft(g, axis=1) / times
    c, s = spectrum.real, -spectrum.imag
    h = np.arange(1, orders + 1)
    less, more = (h[:, None] - h) % times, (h[:, None] + h) % times
    both = np.empty((N, 2 * orders + 1, 2 * orders + 1))
    both[:, 0, 0] = c[:, 0]
    both[:, 0, 1::2], both[:, 0, 2::2] = c[:, h], -s[:, h]
    both[:, 1::2, 0], both[:, 2::2, 0] = 2 * c[:, h], -2 * s[:, h]
    both[:, 1::2, 1::2], both[:, 2::2, 2::2] = c[:, less] + c[:, more], c[:, less] - c[:, more]
    both[:, 1::2, 2::2], both[:, 2::2, 1::2] = s[:, less] - s[:, more], -s[:, less] - s[:, more]
    return both


def _with_state(
    law: ForceLaw,
    d: Real,
    v: Real,
    g: Real,
    omega: Real,
    there: Real,
    rate: Real,
    slopes: bool,
    start: Real | None,
) -> tuple[Real, Real, Real, Real]:
    """(force, state (N, times), ∂force/∂q (N, times, W), ∂force/∂g (N, times, G)) when the state repeats."""
    N, times = d.shape
    W, G = there.shape[1], g.shape[1]
    compiled = compiled_laws((law,)) if law.rate is not None else None
    if compiled is not None:
        begun = None if start is None or start.shape != d.shape else _numbers(start)
        dwells = (_numbers(part) for part in (d, v, g, omega, there, rate))
        z, force, total = compiled.settled(0, *dwells, slopes, begun, threads())
        return force, z, total[..., :W], total[..., W:]
    along = {"d": there[None], "v": omega[:, None, None] * rate}
    if law.operator:
        z, tangents = _operated(law, d, g, there, slopes)
    else:
        z, stays, jump = _rated(law, d, v, g, omega, start)
    at = law(d, v, z, g)
    force = np.broadcast_to(at.value, d.shape)
    if not slopes:
        return force, z, np.zeros((N, times, 0)), np.zeros((N, times, 0))
    if not law.operator:
        # dz at the next instant: `stays` times dz now, and what motion and constants add on the way.
        added = np.zeros((N, times, W + G))
        for name in ("d", "v"):
            for factor, shift in ((jump.get(f"{name} now"), 0), (jump.get(f"{name} next"), -1)):
                if factor is not None:
                    added[..., :W] += factor[..., None] * np.roll(along[name], shift, axis=1)
        for j, name in enumerate(law.constant_names):
            if name in jump:
                added[..., W + j] += jump[name]
        tangents = repeating(stays, added)
    by_z = np.broadcast_to(at.slopes.get("z", np.zeros_like(d)), d.shape)
    total = by_z[..., None] * tangents
    for name in ("d", "v"):
        if name in at.slopes:
            total[..., :W] += np.broadcast_to(at.slopes[name], d.shape)[..., None] * along[name]
    for j, name in enumerate(law.constant_names):
        if name in at.slopes:
            total[..., W + j] += at.slopes[name]
    return force, z, total[..., :W], total[..., W:]


def repeating(stays: Real, added: Real) -> Real:
    """The periodic solution of y_{k+1} = stays_k y_k + added_k, (N, times, Q), for stays (N, times)."""
    N, times, Q = added.shape
    total, kept = np.zeros((N, Q)), np.ones(N)
    for k in range(times):
        total = stays[:, k, None] * total + added[:, k]
        kept = kept * stays[:, k]
    loose = np.abs(1 - kept) < 1e-12  # what never slips keeps what it began with: nothing
    y = np.where(loose[:, None], 0.0, total / np.where(loose, 1.0, 1 - kept)[:, None])
    solution = np.empty((N, times, Q))
    for k in range(times):
        solution[:, k] = y
        y = stays[:, k, None] * y + added[:, k]
    return solution


Jumps = dict[
    str, Real
]  # what the next state gains by d and v now and next, and by constants, each (N, times)


def operated_states(law: ForceLaw, d: Real, g: Real) -> Real:
    """The state of stop or play along a history d (samples,) that begins with none, (samples,); constants g (G,)."""
    sliders, stop, total = law.sliders(g), law.operator == "stop", np.zeros(len(d))
    for weight, width in zip(sliders.weights.tolist(), sliders.widths.tolist(), strict=True):
        z, states, before = 0.0, [], float(d[0])
        for now in d.tolist():
            z = min(max(z + now - before, -width), width) if stop else min(max(z, now - width), now + width)
            before = now
            states.append(z)
        total += weight * np.array(states)
    return total


def rated_states(law: ForceLaw, d: Real, v: Real, step_s: float, g: Real) -> Real:
    """The state of a law along a history d, v (samples,) that begins with none, by the trapezoidal rule; (samples,).

    All samples at once, by Newton's method; g (constants,), step_s between samples.
    """
    from scipy.linalg import solve_banded

    assert law.rate is not None
    compiled = compiled_laws((law,))
    if compiled is not None:
        return compiled.history(0, _numbers(d), _numbers(v), _numbers(g), step_s)
    z, half, size = np.zeros_like(d), step_s / 2, max(float(np.max(np.abs(d))), 1e-300)
    bands, missing = np.ones((2, len(d))), np.zeros_like(d)
    for turn in range(60):
        at = law.rate(law.values(d, v, z, g))
        value, by_z = (np.broadcast_to(part, d.shape) for part in (at.value, at.slopes.get("z", 0.0)))
        missing[1:] = np.diff(z) - half * (value[1:] + value[:-1])
        bands[0, 1:], bands[1, :-1] = 1 - half * by_z[1:], -1 - half * by_z[:-1]
        change = solve_banded((1, 0), bands, missing)
        z = z - (change if turn < 20 else 0.5 * change)
        if not np.max(np.abs(change)) > 1e-9 * size:  # of the elongation
            break
    return z


def _operated(law: ForceLaw, d: Real, g: Real, there: Real, slopes: bool) -> tuple[Real, Real]:
    """Stop and play, exact where the elongation does not turn between two instants: the state, and its tangents
    (N, times, W + G) along harmonics and constants.  Sums of operators are worked through side by side."""
    N, times = d.shape
    W, G = there.shape[1], g.shape[1]
    sliders, stop = law.sliders(g), law.operator == "stop"
    J = sliders.weights.shape[1]
    wide, width = np.repeat(d, J, axis=0), sliders.widths.reshape(N * J)
    z, states = np.zeros(N * J), np.zeros((N * J, times))
    following = np.roll(wide, -1, axis=1)
    moves = (following - wide).T if stop else np.zeros((times, N * J))
    low, high = (
        np.broadcast_to(side, (times, N * J))
        for side in ((-width, width) if stop else (following.T - width, following.T + width))
    )
    for _ in range(2):  # they repeat from the second period on
        for k in range(times):
            states[:, k] = z
            z = np.minimum(np.maximum(z + moves[k], low[k]), high[k])
    each = states.reshape(N, J, times)
    total = np.einsum("nj,njt->nt", sliders.weights, each)
    if not slopes:
        return total, np.zeros((N, times, 0))
    free, centre = (states + following - wide, np.zeros_like(wide)) if stop else (states, following)
    above, below = free > centre + width[:, None], free < centre - width[:, None]
    inside = (~(above | below)).astype(float)
    edge = above.astype(float) - below.astype(float)
    now, later = (-inside, inside) if stop else (None, 1 - inside)
    added = np.zeros((N * J, times, W + G))
    added[..., :W] = later[..., None] * np.roll(there, -1, axis=0)
    if now is not None:
        added[..., :W] += now[..., None] * there
    added[..., W:] = edge[..., None] * sliders.by_widths.reshape(N * J, 1, G)
    tangents = repeating(inside, added).reshape(N, J, times, W + G)
    tangent = np.einsum("nj,njtq->ntq", sliders.weights, tangents)
    tangent[..., W:] += np.einsum("njt,njg->ntg", each, sliders.by_weights)
    return total, tangent


def _rated(
    law: ForceLaw, d: Real, v: Real, g: Real, omega: Real, start: Real | None
) -> tuple[Real, Real, Jumps]:
    """dz/dt = g(z, d, v) by the trapezoidal rule, all instants of the period at once by Newton's method."""
    assert law.rate is not None
    times = d.shape[1]
    half = (np.pi / (omega * times))[:, None]
    z = np.zeros_like(d) if start is None or start.shape != d.shape else start
    size = np.maximum(np.max(np.abs(d), axis=1, keepdims=True), 1e-300)
    for turn in range(40):
        at = law.rate(law.values(d, v, z, g))
        value = np.broadcast_to(at.value, d.shape)
        by_z = np.broadcast_to(at.slopes.get("z", np.zeros_like(d)), d.shape)
        scale = 1 - half * np.roll(by_z, -1, axis=1)
        missing = np.roll(z, -1, axis=1) - z - half * (value + np.roll(value, -1, axis=1))
        change = repeating((1 + half * by_z) / scale, (-missing / scale)[..., None])[..., 0]
        z = z + (change if turn < 10 else 0.5 * change)
        if np.max(np.abs(change) / size) <= 1e-11:  # of the elongation
            break
    gains = {}
    for name, slope in at.slopes.items():
        if name == "z":
            continue
        now = np.broadcast_to(slope, d.shape) * half
        if name in ("d", "v"):
            gains[f"{name} now"], gains[f"{name} next"] = now / scale, np.roll(now, -1, axis=1) / scale
        else:
            gains[name] = (now + np.roll(now, -1, axis=1)) / scale
    return z, (1 + half * by_z) / scale, gains


# Laws in the compiled kernel, whose twins are the functions of the same names in NumPy.
#
# The kernel balances small rigs whose laws are functions of d and v; of laws with a state it follows those of one.


CODES = (
    *(
        "number",
        "name",
        "where",
        "min",
        "max",
        "negative",
        "whole power",
        "abs",
        "sign",
        "tanh",
        "exp",
        "log",
    ),
    *("sqrt", "sin", "cos", "+", "-", "*", "/", "**"),
)
_CODE = {symbol: code for code, symbol in enumerate(CODES)}

Step = tuple[int, int, float]  # code, which name or exponent, number


def compiled_rig(model: Model, times: int = 8) -> Any | None:
    """The kernel's rig for periods of `times` instants, None where NumPy is to do the work or must; kept."""
    make = kernel_function("NonlinearRig")
    if make is None or times % 8 or not len(model.nonlinear):
        return None
    key = ("compiled", id(make))
    if key not in model.views:
        model.views[key] = None
        # 47: coordinates, above which rigs are sparse
        if 0 < model.n <= 47 and not any(law.has_state or len(law.constants) > 30 for law in model.laws):
            ends = [0, *(inner.stop for inner in model.constant_slices)]
            counts = (_numbers(each, np.int64) for each in (model.nonlinear, ends))
            programs = _programs([(law.expression, law.constant_names) for law in model.laws])
            model.views[key] = make(
                _numbers(model.B), _numbers(model.D), _numbers(model.S), *counts, *programs
            )
    return model.views[key]


def compiled_laws(laws: tuple[ForceLaw, ...]) -> Any | None:
    """The kernel's laws with their states, None where NumPy is to do the work or must; the last ones are kept."""
    make = kernel_function("StateLaws")
    if make is None or not laws or any(law.states > 1 or len(law.constants) > 29 for law in laws):
        return None
    known = ((law.expression, law.rate, law.operator, law.constant_names) for law in laws)
    return _made(make, tuple(known))


@lru_cache(maxsize=64)
def _made(
    make: Any, laws: tuple[tuple[Expression, Expression | None, Operator, tuple[str, ...]], ...]
) -> Any:
    ends = np.cumsum([0, *(len(names) for *_, names in laws)])
    operators = [("", "stop", "play").index(operator) for _, _, operator, _ in laws]
    forces = [(force, (*names, "z")) for force, *_, names in laws]
    rates = [(rate, (*names, "z")) for _, rate, _, names in laws]
    return make(_numbers(ends, np.int64), _numbers(operators, np.int64), *_programs([*forces, *rates]))


def _programs(expressions: Sequence[tuple[Expression | None, tuple[str, ...]]]) -> tuple[Any, ...]:
    """Where the steps of each expression begin and end, and code, which and number of all steps.

    With the names that an expression may have in addition to d and v; none is no steps.
    """
    programs = []
    for expression, others in expressions:
        names = {name: place for place, name in enumerate(("d", "v", *others))}
        programs.append([] if expression is None else list(_program(expression.tree, names)))
    code, which, number = zip(*(step for program in programs for step in program), strict=True)
    starts = np.cumsum([0, *map(len, programs)])
    return *(_numbers(each, np.int64) for each in (starts, code, which)), _numbers(number)


def _program(node: Node, names: dict[str, int]) -> Iterator[Step]:
    """The steps of an expression, operands first."""
    power = node.operands[1] if node.symbol == "**" else None
    # 8 is the highest power that is multiplied out
    if power is not None and power.symbol == "number" and power.number in range(1, 9):
        yield from _program(node.operands[0], names)
        yield _CODE["whole power"], int(power.number), 0.0
        return
    for operand in node.operands:
        yield from _program(operand, names)
    yield _CODE[node.symbol], names.get(node.name, 0), node.number


def factors_of_orders(model: Model, omega: Real, orders: int) -> Complex:
    """φ of all elements at every harmonic of dwells at `omega` (N,), (N, H + 1, elements); the last ones are kept."""
    key = ("factors", orders, omega.tobytes())
    if key not in model.views:
        model.views[key] = model.factors((omega[:, None] * rates_of_orders(orders)).imag)
    return model.views[key]


def compiled_forces(rig: Any, constants: Real, omega: Real, q: Real, times: int) -> Real:
    """Harmonics of the unit forces of the nonlinear elements at elongations q (N, e, W), (N, e, W)."""
    return rig.unit_forces(_numbers(constants), _numbers(omega), _numbers(q), times, threads())


def compiled_start(rig: Any, model: Model, p: Real, constants: Real, drive: Drive, times: int) -> Real:
    """Elongations (N, e, W) with each nonlinear element replaced by its secant."""
    return rig.linear_start(*_dwells(model, p, constants, drive), times, threads())


def compiled_balance(
    rig: Any,
    model: Model,
    p: Real,
    constants: Real,
    drive: Drive,
    q: Real,
    times: int,
    hopeless: Bools | None,
) -> tuple[Any, ...]:
    """The linear part, its free elongations, and q, unit forces, slopes, slopes by constants and errors at the end."""
    return rig.solve(*_dwells(model, p, constants, drive), _numbers(q), times, hopeless, threads())


def compiled_slopes(
    rig: Any,
    model: Model,
    p: Real,
    drive: Drive,
    linear: tuple[Complex, Complex, Complex],
    forces: Alternated,
    a: Complex,
    along: tuple[Real, Real, Complex | None, Complex | None],
) -> tuple[Complex, Complex, Real]:
    """Slopes of X, the unit forces and the elongations; `linear`: inverse, receptance and share."""
    along_p, along_constants, *inputs = along
    by_constant = np.concatenate(forces.by_constant, axis=-1)
    return rig.slopes(
        *_dwells(model, p, np.zeros((len(p), by_constant.shape[-1])), drive),
        *linear,
        forces.slope,
        by_constant,
        np.ascontiguousarray(a),
        _numbers(along_p),
        _numbers(along_constants),
        *(None if part is None else np.ascontiguousarray(part) for part in inputs),
        threads(),
    )


def compiled_channels(
    rig: Any,
    view: ObservationModel,
    at: tuple[Real, Real, Complex, Real | None],
    dwells: tuple[Real, Ints, Ints, int],
    times: int,
    along: tuple[Real, Real, Complex | None],
) -> tuple[Complex, Complex, Real, Real, Real]:
    """Channels at the lines of dwells, their slopes, the elongations, their slopes and errors.

    at: p (K, elements), constants (K, G), inputs (K, lines, r + s) and elongations to start from or None; dwells: ω
    (R,), dwell and order of each line, H; along: directions of p, the constants and the inputs (R, H + 1, r + s, Q).
    """
    p, constants, q, start = at
    omega, dwell, order, orders = dwells
    along_p, along_g, inputs = along
    r = view.model.D.shape[1]
    parts = (None, None) if inputs is None else (inputs[:, :, :r], inputs[:, :, r:])
    return rig.lines(
        _numbers(p),
        _numbers(constants),
        _numbers(omega),
        factors_of_orders(view.model, omega, orders),
        np.ascontiguousarray(q),
        None if start is None else _numbers(start),
        times,
        _numbers(along_p),
        _numbers(along_g),
        *(None if part is None else np.ascontiguousarray(part) for part in parts),
        _numbers(dwell, np.int64),
        _numbers(order, np.int64),
        np.ascontiguousarray(view.rates),
        *map(_numbers, (view.on_x, view.on_q, view.force)),
        threads(),
    )


def _dwells(model: Model, p: Real, constants: Real, drive: Drive) -> tuple[Any, ...]:
    phi = factors_of_orders(model, drive.omega, drive.orders)
    inputs = (np.ascontiguousarray(part) for part in (drive.U, drive.f))
    return (_numbers(p), _numbers(constants), _numbers(drive.omega), phi, *inputs)


def _numbers(values: Any, dtype: type = np.float64) -> Any:
    return np.ascontiguousarray(values, dtype=dtype)
