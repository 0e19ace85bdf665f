"""State spaces of identified rigs, with what the uncertainty of the parameters makes of them.

M ẍ + C ẋ + K x = F u̇ + G u + J ü + S f is made a state space whose matrices are proper, whatever the base is given as.
A damper to the base needs u̇ and a mass that hangs on it ü, so that a channel may depend on derivatives of what is
given.  The input is therefore u, u̇ or ü, w = u^(d); lower derivatives are states, and higher ones are taken out of the
states by shifts:

    x = ξ + β₀ w      ẋ = η + β₁ w + β₀ ẇ      z = (ξ, η, lower derivatives of u)

With d = 0, β₀ = M⁻¹J, β₁ = M⁻¹F − M⁻¹C β₀; with d = 1, β₀ = 0, β₁ = M⁻¹J; with d = 2 both vanish.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real
from dashpot.channel import MOTIONS, Quantity
from dashpot.errors import UsageError
from dashpot.export.formats import ExportOptions, Written
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.io.atomic import write_bytes, write_text
from dashpot.io.json_document import optional_library, to_json
from dashpot.io.words import choose_from
from dashpot.model.dynamics import matrices, require_masses
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, channel_unit, observation_model
from dashpot.units import si_unit

DERIVATIVES = {"K": 0, "C": 1, "M": 2}
SUFFIXES = ("", "_rate", "_acceleration")  # of an input's name, by what is given of it

Matrix = np.ndarray[Any, Any]  # real, or complex where a slope is taken by a complex step


@dataclass(frozen=True)
class Signals:
    """Signals as Z z + Σ_k W_k w^(k): Z (..., signals, states), W (..., 3, signals, inputs)."""

    Z: Matrix
    W: Matrix

    def times(self, factors: Matrix) -> Signals:
        """Combinations of the signals, `factors` (..., combinations, signals)."""
        return Signals(factors @ self.Z, factors[..., None, :, :] @ self.W)

    def __add__(self, other: Signals) -> Signals:
        return Signals(self.Z + other.Z, self.W + other.W)

    @property
    def improper(self) -> Bools:
        """Which inputs have derivatives in which signals, (signals, inputs)."""
        size = np.max(np.abs(self.W), axis=(-3, -2), keepdims=True)
        return np.any((np.abs(self.W) > 1e-12 * size)[..., 1:, :, :], axis=-3)  # else of rounding

    @property
    def direct(self) -> Matrix:
        """W₀, (..., signals, inputs)."""
        return self.W[..., 0, :, :]


@dataclass(frozen=True)
class Realisation:
    """ż = A z + B w and the motion: x, ẋ, ẍ of coordinates, u, u̇, ü of moved points, f.

    A (..., states, states), B (..., states, inputs); `shifts` (β₀, β₁), each (..., n, r).
    """

    A: Matrix
    B: Matrix
    coordinates: tuple[Signals, Signals, Signals]
    moved: tuple[Signals, Signals, Signals]
    shifts: tuple[Matrix, Matrix]


def realisation(model: Model, p: Matrix, orders: Ints) -> Realisation:
    """A state space of the rig with parameters p (..., elements) that is driven by u^(d), d of `orders` (r,), and f.

    Raises ModelError if a coordinate has no mass.  p may be complex: slopes are taken by complex steps.
    """
    n, r, s = model.n, len(orders), model.S.shape[1]
    lead = p.shape[:-1]
    rig = matrices(model, p)
    require_masses(rig.M)
    S = np.broadcast_to(model.S, (*lead, n, s))
    everything = np.linalg.solve(rig.M, np.concatenate([rig.K, rig.C, rig.G, rig.F, rig.J, S], axis=-1))
    stiffness, damping, by_u, by_rate, by_acceleration, by_force = np.split(
        everything, np.cumsum([n, n, r, r, r]), axis=-1
    )
    by_derivative = (by_u, by_rate, by_acceleration)
    beta0 = by_acceleration * (orders == 0)
    beta1 = (by_rate - damping @ by_acceleration) * (orders == 0) + by_acceleration * (orders == 1)
    states, inputs = 2 * n + int(np.sum(orders)), r + s
    # u, u̇ and ü: states as far as they are below the derivative that is given, else inputs and their derivatives
    count = len(orders)
    first = 2 * n + np.concatenate([[0], np.cumsum(orders)]).astype(int)
    signals = []
    for k in range(3):
        Z, W = np.zeros((count, states)), np.zeros((3, count, inputs))
        for j, order in enumerate(orders.tolist()):
            if k < order:
                Z[j, first[j] + k] = 1.0
            else:
                W[k - order, j, j] = 1.0
        signals.append(Signals(Z, W))
    moved = signals[0], signals[1], signals[2]
    A = np.zeros((*lead, states, states), dtype=everything.dtype)
    B = np.zeros((*lead, states, inputs), dtype=everything.dtype)
    A[..., :n, n : 2 * n] = np.eye(n)
    A[..., n : 2 * n, : 2 * n] = -np.concatenate([stiffness, damping], axis=-1)
    given = sum(by_derivative[d] * (orders == d) for d in range(3))
    B[..., :n, :r] = beta1
    B[..., n : 2 * n, :] = np.concatenate([given - stiffness @ beta0 - damping @ beta1, by_force], axis=-1)
    for d in range(2):  # where u^(d) is a state, it acts on the masses, and its own derivative is u^(d + 1)
        A[..., n : 2 * n, :] += by_derivative[d] @ moved[d].Z
        A += moved[d].Z.T @ moved[d + 1].Z
        B += moved[d].Z.T @ moved[d + 1].direct
    rows = np.eye(2 * n, states)
    nothing = np.zeros((*lead, n, inputs), dtype=everything.dtype)
    of_inputs = [np.concatenate([beta, np.zeros((*lead, n, s))], axis=-1) for beta in (beta0, beta1)]
    coordinates = (
        Signals(rows[:n], np.stack([of_inputs[0], nothing, nothing], axis=-3)),
        Signals(rows[n:], np.stack([of_inputs[1], of_inputs[0], nothing], axis=-3)),
        Signals(A[..., n : 2 * n, :], np.stack([B[..., n : 2 * n, :], of_inputs[1], of_inputs[0]], axis=-3)),
    )
    return Realisation(A, B, coordinates, moved, (beta0, beta1))


def channel_signals(view: ObservationModel, p: Matrix, rig: Realisation) -> Signals:
    """What the channels show, calibrations left out: one signal each."""
    model = view.model
    r, outputs = len(model.displacement_inputs), len(view.channels)
    W = np.zeros((3, outputs, rig.B.shape[-1]))
    W[0, :, r:] = view.on_q[:, r:]
    total = Signals(np.zeros((outputs, rig.A.shape[-1])), W)
    for letter, d in DERIVATIVES.items():
        at, x, u = (view.derivative == d)[:, None], rig.coordinates[d], rig.moved[d]
        total = total + x.times(view.on_x * at) + u.times(view.on_q[:, :r] * at)
        index = model.by_matrix[letter]
        if len(index) and view.has_forces:
            elongation = x.times(model.B[index]) + u.times(model.D[index])
            total = total + elongation.times(view.force[:, index] * p[..., None, index])
    return total


def proper_orders(view: ObservationModel, p: Real, least: Sequence[int]) -> Ints:
    """The least derivatives of the moved points, `least` (r,) at least, by which every channel is proper."""
    orders = np.array(least, dtype=np.int64)
    while True:
        improper = channel_signals(view, p, realisation(view.model, p, orders)).improper
        raised = np.minimum(orders + np.any(improper, axis=0)[: len(orders)], 2)
        if np.array_equal(raised, orders):
            return orders
        orders = raised


@dataclass(frozen=True)
class Port:
    """An input or output: its name, what it is ("displacement" … "force"), and its SI unit."""

    name: str
    quantity: str
    unit: str


@dataclass(frozen=True)
class StateSpace(Frozen):
    """ż = A z + B w, y = C z + D w; SI units.

    name        of the rig
    inputs      displacement inputs (u, u_rate or u_acceleration, whichever makes all outputs proper), then forces
    outputs     channels that do not measure inputs alone, as ideal sensors
    states      displacements and velocities of the coordinates (minus a share of w if `shifts` is not 0), then
                those of the moved points that are not given: u, or u and its rate
    parameters, values (m,), covariance (m, m)   the unknowns
    slopes      ∂A, ∂B, ∂C, ∂D by each of them, (m, …)
    shifts      (β₀, β₁): x = z₁ + β₀ w, ẋ = z₂ + β₁ w + β₀ ẇ
    """

    name: str
    A: Real
    B: Real
    C: Real
    D: Real
    states: tuple[str, ...]
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    parameters: tuple[str, ...]
    values: Real
    covariance: Real
    slopes: tuple[Real, Real, Real, Real]
    shifts: tuple[Real, Real]

    def __repr__(self) -> str:
        names = ", ".join(f"{port.name} ({port.quantity})" for port in self.inputs)
        seen = ", ".join(port.name for port in self.outputs)
        return f"<StateSpace {len(self.states)} states, from {names} to {seen}>"

    def response(self, omega: Real) -> Complex:
        """C (jω − A)⁻¹ B + D at ω (lines,), rad/s; (lines, outputs, inputs)."""
        system = 1j * np.asarray(omega)[:, None, None] * np.eye(len(self.A)) - self.A
        response: Complex = self.C @ np.linalg.solve(
            system, np.broadcast_to(self.B, (len(system), *self.B.shape))
        )
        return response + self.D

    def to_json(self) -> str:
        """The matrices, names and units, values and covariance of the parameters, and slopes by them as JSON."""
        letters = "ABCD"
        content = {
            "dashpot": "state space",
            "model": self.name,
            **{letter: getattr(self, letter).tolist() for letter in letters},
            "states": list(self.states),
            "inputs": [vars(port) for port in self.inputs],
            "outputs": [vars(port) for port in self.outputs],
            "parameters": dict(zip(self.parameters, self.values.tolist(), strict=True)),
            "order": list(self.parameters),
            "covariance": self.covariance.tolist(),
            "slopes": {
                f"d{letter}": part.tolist() for letter, part in zip(letters, self.slopes, strict=True)
            },
            "shifts": [part.tolist() for part in self.shifts],
        }
        return to_json(content)

    def to_mat(self) -> bytes:
        """The same as a MATLAB file (version 5): A, B, C, D, names as cell arrays, dA … as (…, …, parameters)."""
        from scipy.io import savemat

        content: dict[str, Any] = {letter: getattr(self, letter) for letter in "ABCD"}
        for what, ports in (("input", self.inputs), ("output", self.outputs)):
            for field in ("name", "quantity", "unit"):
                content[f"{what}_{field}"] = _cells(getattr(port, field) for port in ports)
        content |= {"state_name": _cells(self.states), "parameter_name": _cells(self.parameters)}
        content |= {"parameter_value": self.values[:, None], "parameter_covariance": self.covariance}
        content |= {f"d{a}": np.moveaxis(part, 0, -1) for a, part in zip("ABCD", self.slopes, strict=True)}
        content |= {"beta0": self.shifts[0], "beta1": self.shifts[1], "model": self.name}
        out = BytesIO()
        savemat(cast("Any", out), content, do_compression=True)
        return out.getvalue()

    def to_control(self) -> Any:
        """A StateSpace of python-control.  Raises UsageError without it (extra "control")."""
        control = optional_library("control", "control", "to_control")
        names = {"states": list(self.states), "name": "rig"}
        names |= {
            "inputs": [port.name for port in self.inputs],
            "outputs": [port.name for port in self.outputs],
        }
        return control.ss(self.A, self.B, self.C, self.D, **names)


def _cells(texts: Iterable[str]) -> np.ndarray[Any, Any]:
    """Texts as a cell array of MATLAB, a column."""
    return np.array([*texts, None], dtype=object)[:-1, None]


def write_state_space(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write the state space as JSON or, by its ending, as a MATLAB file.  Raises as `state_space_of`."""
    system = state_space_of(rig, options.given)
    if Path(path).suffix.lower() == ".mat":
        write_bytes(path, system.to_mat())
    else:
        write_text(path, system.to_json())
    return Written((path,))


def state_space_of(rig: IdentifiedRig, given: str | Mapping[str, str] | None = None) -> StateSpace:
    """The state space of a rig from its inputs to its channels, which are SI quantities; calibrations are left out.

    given  as what displacement inputs are given, "displacement", "velocity" or "acceleration", of all or by name.
           Without it as they are measured, differentiated as often as it takes to make all channels proper.

    Raises ModelError for nonlinear and hysteretic elements and for coordinates without mass, UsageError if a channel
    would depend on derivatives of what is given, or there is no channel that shows more than inputs.
    """
    rig.require_viscous("a state space")
    model, channels = rig.model, rig.outputs
    if not channels:
        raise UsageError(
            "all channels measure inputs only, so there is no output", cure="list channels of the coordinates"
        )
    view = observation_model(model, channels, np.zeros(1))
    asked = dict.fromkeys(model.displacement_inputs, given) if isinstance(given, str) else dict(given or {})
    for name, quantity in asked.items():
        if name not in model.displacement_inputs:
            cure = choose_from(model.displacement_inputs)
            raise UsageError(f"{name} is not a displacement input of the rig", cure=cure)
        if quantity not in MOTIONS:
            raise UsageError(f"an input cannot be given as {quantity}", cure=f"give {', '.join(MOTIONS)}")
    # How often a point is differentiated in its own channel, by name, where it has one
    measured: dict[str, int] = {}
    for channel in rig.channels:
        if channel.quantity is not Quantity.FORCE and len(channel.of) == 1:
            (name,) = channel.of
            measured[name] = min(channel.quantity.derivative, measured.get(name, 2))
    least = [
        MOTIONS.index(Quantity(asked[name])) if name in asked else measured.get(name, 0)
        for name in model.displacement_inputs
    ]
    orders = proper_orders(view, rig.p, least)
    for name, order, start in zip(model.displacement_inputs, orders.tolist(), least, strict=True):
        if order != start and name in asked:
            raise UsageError(
                f"some channel depends on the {MOTIONS[order]} of {name}",
                cure=f"give {name} as {MOTIONS[order]}",
            )
    parts, shifts = _matrices(view, rig.p, orders)
    states, inputs = [*model.coordinates, *(f"{name}_rate" for name in model.coordinates)], []
    for name, order in zip(model.displacement_inputs, orders.tolist(), strict=True):
        states += [name, f"{name}_rate"][:order]
        quantity = MOTIONS[order].value
        unit = si_unit(quantity, name in model.angles)
        inputs.append(Port(f"{name}{SUFFIXES[order]}", quantity, unit))
    for source in model.inputs:
        if source.kind == "force":
            unit = si_unit("force", bool(source.at) and set(source.at) <= set(model.angles))
            inputs.append(Port(source.name, "force", unit))
    return StateSpace(
        model.name,
        *parts,
        tuple(states),
        tuple(inputs),
        tuple(Port(c.name, c.quantity.value, channel_unit(model, c)) for c in channels),
        rig.names,
        rig.theta,
        rig.covariance,
        _slopes(rig, view, orders, parts),
        shifts,
    )


Parts = tuple[Matrix, Matrix, Matrix, Matrix]


def _matrices(view: ObservationModel, p: Matrix, orders: Ints) -> tuple[Parts, tuple[Matrix, Matrix]]:
    """(A, B, C, D) and the shifts at parameters p (..., elements)."""
    found = realisation(view.model, p, orders)
    seen = channel_signals(view, p, found)
    return (found.A, found.B, seen.Z, seen.direct), found.shifts


def _slopes(rig: IdentifiedRig, view: ObservationModel, orders: Ints, parts: Parts) -> Parts:
    """∂A, ∂B, ∂C and ∂D by the unknowns, (m, …), by complex steps: exact to rounding."""
    m = len(rig.theta)
    if not m:
        A, B, C, D = (np.zeros((0, *part.shape)) for part in parts)
        return A, B, C, D
    step = 1e-25 * np.where(rig.theta == 0, 1.0, np.abs(rig.theta))
    moved, _ = _matrices(view, rig.p + 1j * (rig.model.T * step).T, orders)
    A, B, C, D = (
        np.broadcast_to(part, (m, *at.shape)).imag / step[:, None, None]
        for part, at in zip(moved, parts, strict=True)
    )
    return A, B, C, D
