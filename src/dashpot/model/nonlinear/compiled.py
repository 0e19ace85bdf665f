"""Harmonic balance in the compiled kernel, whose twins are the functions of the same names in NumPy.

The kernel knows small rigs whose laws are functions of d and v; laws with a state are NumPy's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.expression import Node
from dashpot.model.nonlinear.harmonics import Drive, rates_of_orders
from dashpot.numerics.kernel import kernel_function, threads

if TYPE_CHECKING:
    from dashpot.model.nonlinear.alternating import Alternated
    from dashpot.model.observation import ObservationModel

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
        model.views[key] = _compiled_rig(make, model)
    return model.views[key]


def _compiled_rig(make: Any, model: Model) -> Any | None:
    # 47: coordinates, above which rigs are sparse
    if not 0 < model.n <= 47 or any(law.has_state or len(law.constants) > 30 for law in model.laws):
        return None
    programs = []
    for law in model.laws:
        names = {name: place for place, name in enumerate(("d", "v", *law.constant_names))}
        programs.append(list(_program(law.expression.tree, names)))
    code, which, number = zip(*(step for program in programs for step in program), strict=True)
    ends = [0, *(inner.stop for inner in model.constant_slices)]
    starts = np.cumsum([0, *map(len, programs)])
    counts = (_numbers(each, np.int64) for each in (model.nonlinear, ends, starts, code, which))
    return make(_numbers(model.B), _numbers(model.D), _numbers(model.S), *counts, _numbers(number))


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
