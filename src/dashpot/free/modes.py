"""Modes without a rig: poles, shapes and their covariance from a rational model fitted by maximum likelihood.

Lines of a record, or responses, are sums of residues over poles that all outputs share, with terms for modes outside
the band and for the ends of records.  Given the poles all else is linear, so that Gauss-Newton moves the poles alone
(variable projection: Golub and Pereyra, Inverse Problems 19, 2003).  Poles are added one at a time, each where it
explains most, as long as the evidence asks for them (BIC); those that are tried come from least-squares complex
frequency fits (Peeters et al., Shock and Vibration 11, 2004), which also give the stabilisation picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.data.modal_data import ModalData, of_eigenvalues
from dashpot.data.noise import smoothed
from dashpot.data.readers import Reading
from dashpot.errors import DataError
from dashpot.free import MOST_MODES
from dashpot.free.response import (
    LEAST_APART,
    Band,
    MeasuredResponse,
    Parted,
    RecordLines,
    doubled,
    in_units,
    invertible,
    likelihood_by_others,
    line_noise,
    local_response,
    parted,
    record_lines,
    response_of,
)
from dashpot.io.json_document import data_frame
from dashpot.io.words import counted, joined
from dashpot.notices import Notice

HIGHEST_DAMPING = 0.8  # of what is reported as a mode: broader poles stand for what lies outside the band
STABLE = (
    0.01,
    0.1,
)  # relative changes of frequency and damping ratio from one order to the next, as is usual


@dataclass(frozen=True)
class Stabilisation(Frozen):
    """Poles of least-squares fits of growing order: each one's order, frequency, Hz, damping ratio, and whether the
    order below has it too, (poles,)."""

    order: Ints
    frequency_hz: Real
    damping_ratio: Real
    stable: Bools


@dataclass(frozen=True)
class MeasuredModes:
    """Modes of a test, in order of their frequency.

    inputs, outputs  channels; points: the names of the outputs in shapes
    eigenvalues    λ (modes,), 1/s, and their covariance (modes, 2, 2) of (Re λ, Im λ)
    shapes         (modes, outputs): displacements, the largest 1; shape_sd of real and imaginary part, each
    participation  (modes, inputs): residue of the largest output per unit of each input, as H = Σ φ pᵀ / (s − λ) + …;
                   without inputs (modes, 0); and its standard deviation, participation_sd
    frequency, measured, modelled  (lines,), (lines, outputs), …: data and fit, for figures (of the first record)
    chi2, dof      of the fit, with the noise known beforehand; NaN if it was not
    order          number of poles of the model; poles that are not modes in the band are not reported
    stabilisation  poles of least-squares fits of growing order
    real           whether shapes were held real
    notes          notices on the result
    """

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    eigenvalues: Complex
    covariance: Real
    shapes: Complex
    shape_sd: Real
    participation: Complex
    participation_sd: Real
    frequency: Real
    measured: Complex
    modelled: Complex
    chi2: float
    dof: float
    order: int
    stabilisation: Stabilisation
    real: bool = False
    notes: tuple[Notice, ...] = ()
    points: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if not self.points:
            object.__setattr__(self, "points", tuple(channel.name for channel in self.outputs))
        freeze(self)

    def __repr__(self) -> str:
        found = ", ".join(f"{f:.5g} Hz" for f in self.frequency_hz)
        return f"<MeasuredModes: {found}>"

    @cached_property
    def modal_data(self) -> ModalData:
        """As input of `identify` and `compare`, by the names of the points."""
        V = np.array([2 * np.diag(sd**2) for sd in self.shape_sd]).astype(np.complex128)
        return of_eigenvalues(self.points, self.eigenvalues, self.covariance, self.shapes, V)

    @property
    def frequency_hz(self) -> Real:
        """|λ| / 2π, (modes,)."""
        return self.modal_data.frequency_hz

    @property
    def damping_ratio(self) -> Real:
        """−Re λ / |λ|, (modes,)."""
        return self.modal_data.damping_ratio

    @property
    def frequency_sd(self) -> Real:
        """Hz."""
        return np.sqrt(self.modal_data.covariance[:, 0, 0])

    @property
    def damping_sd(self) -> Real:
        """Standard deviation of the damping ratios."""
        return np.sqrt(self.modal_data.covariance[:, 1, 1])

    def to_dataframe(self) -> Any:
        """A pandas DataFrame with a row for each mode: frequency, damping, and the shape at each point, complex.

        Raises UsageError without pandas (extra "analysis").
        """
        columns: dict[str, Any] = {
            "mode": np.arange(1, 1 + len(self.eigenvalues)),
            "frequency_hz": self.frequency_hz,
            "frequency_sd": self.frequency_sd,
            "damping_ratio": self.damping_ratio,
            "damping_sd": self.damping_sd,
        }
        for k, name in enumerate(self.points):
            columns |= {name: self.shapes[:, k], f"{name}_sd": self.shape_sd[:, k]}
        return data_frame(columns, "mode")

    def to_dict(self) -> dict[str, object]:
        """The modes for JSON, which `identify` and `compare --modal` read."""
        modes = []
        for k in range(len(self.eigenvalues)):
            shape = zip(self.points, self.shapes[k], self.shape_sd[k], strict=True)
            into = zip(self.inputs, self.participation[k], self.participation_sd[k], strict=True)
            modes.append(
                {
                    "frequency_hz": {"value": self.frequency_hz[k], "sd": self.frequency_sd[k]},
                    "damping_ratio": {"value": self.damping_ratio[k], "sd": self.damping_sd[k]},
                    "shape": {name: {"re": x.real, "im": x.imag, "sd": sd} for name, x, sd in shape},
                    "participation": {c.name: {"re": x.real, "im": x.imag, "sd": sd} for c, x, sd in into},
                }
            )
        return {
            "modes": modes,
            "normalisation": "largest entry of each shape is 1",
            "fit": {"chi2": self.chi2, "dof": self.dof, "poles": self.order},
            "notes": [{"code": note.code, "text": note.text} for note in self.notes],
        }


def measured_modes(
    reading: Reading | MeasuredResponse,
    inputs: Sequence[str],
    outputs: Sequence[str],
    band_hz: Band | None = None,
    *,
    most: int = MOST_MODES,
    real: bool = False,
) -> MeasuredModes:
    """The modes that data of any kind show in a band; without `inputs` records are free decays.

    Raises as `frequency_response`, and DataError if no mode is found.
    """
    data = reading if isinstance(reading, MeasuredResponse) else parted(reading, inputs, outputs)
    if isinstance(data, Parted) and data.records:
        channels, notes = data.records[0].channels, data.notes
        inputs_of, outputs_of = channels[: data.inputs], channels[data.inputs :]
        if data.inputs and band_hz is None:
            sets = _of_response(local_response(data.records, data.inputs, every_line=False))
        else:
            parts = [record_lines(record, data.inputs) for record in data.records]
            sets = _of_lines(
                parts, *(band_hz or (0.0, 0.9 * float(min(part.frequency_hz[-1] for part in parts))))
            )
    else:
        found = response_of(data, band_hz) if isinstance(data, Parted) else data
        inputs_of, outputs_of, notes, sets = found.inputs, found.outputs, found.notes, _of_response(found)
    fit, stabilisation, first = _by_evidence(sets, most)
    if isinstance(data, Parted) and data.records and not data.inputs:
        _require_decay(sets, fit, outputs_of)
    kept, left = _modes_among(fit, sets)
    if not len(kept):
        f = sets[0].frequency_hz
        raise DataError(
            f"no mode is visible from {f.min():.4g} to {f.max():.4g} Hz",
            cure="record longer, choose a band about a resonance, or check the channels",
        )
    if left:
        text = (
            f"{counted(left, 'further pole')} of the fit left out: outside the band, or too uncertain to be a "
            "mode"
        )
        notes = (*notes, Notice("poles_left_out", text))
    one, nu = sets[0], len(inputs_of)
    each: Any = zip(*(_shape(fit, k, outputs_of, nu, real, one.unit) for k in kept), strict=True)
    shapes, shape_sd, into, into_sd = (np.array(values) for values in each)
    return MeasuredModes(
        tuple(inputs_of),
        tuple(outputs_of),
        fit.poles[kept] * one.unit,
        np.array([fit.covariance[np.ix_(at, at)] for at in (2 * kept[:, None] + np.arange(2))]) * one.unit**2,
        shapes,
        shape_sd,
        into[:, :nu],
        into_sd[:, :nu],
        one.frequency_hz,
        one.outputs,
        one.outputs - fit.residuals[0],
        *first,
        len(fit.poles),
        stabilisation,
        real,
        tuple(dict.fromkeys(notes)),
    )


FREELY = 0.1  # of a channel's power, that a free decay explains at the least: buried in noise of three times its size


def _require_decay(sets: Sequence[_Set], fit: _Fit, outputs: Sequence[Channel]) -> None:
    """Raises DataError where poles explain next to nothing of any record without inputs: something drove the rig."""
    power = sum(np.sum(np.abs(one.outputs) ** 2, axis=0) for one in sets)
    left = sum(np.sum(np.abs(r) ** 2, axis=0) for r in fit.residuals)
    most = float(np.max(1 - left / np.maximum(power, np.finfo(float).tiny)))
    if most < FREELY:
        raise DataError(
            f"{joined(channel.name for channel in outputs)} do not move as in a free decay: it explains "
            f"{100 * max(most, 0.0):.0f} % of the motion",
            cure="name what drives the rig as an input, or record while it moves freely",
        )


# The data: lines of records with their inputs and ends, or responses, whose input is 1.


@dataclass(frozen=True)
class _Set:
    """Lines of one record, or of responses: outputs (lines, q) = Σ of inputs (lines, columns) times rational functions.

    noise      (lines, q, q), E[Δ Δᴴ]; `known`: or only what weighs the lines until residuals show it
    step       sampling step of a record, s, whose ends have terms of their own; 0 of responses
    unit       rad/s of s = 1 in the fit
    """

    frequency_hz: Real
    inputs: Complex
    outputs: Complex
    noise: Complex
    step: float
    unit: float
    known: bool = True

    @cached_property
    def precision(self) -> Complex:
        """Inverse of the noise, which is at least the rounding of each line, and of no combination of outputs none."""
        floor = 1e-24 * np.mean(np.abs(self.outputs) ** 2, axis=1) + 1e-300
        size = np.sqrt(np.diagonal(self.noise, axis1=1, axis2=2).real + floor[:, None])
        spread, directions = np.linalg.eigh(self.noise / (size[:, :, None] * size[:, None, :]))
        root = directions / np.sqrt(np.maximum(spread, LEAST_APART))[:, None, :] / size[:, :, None]
        return np.asarray(root @ np.conj(np.swapaxes(root, 1, 2)), dtype=np.complex128)

    @cached_property
    def s(self) -> Complex:
        """jω in the unit of the fit."""
        return (2j * np.pi / self.unit * self.frequency_hz).astype(np.complex128)

    @cached_property
    def back(self) -> Complex:
        """e^{−sΔ}, (lines,): one sampling step back."""
        return np.exp(-self.s * self.unit * self.step)

    @cached_property
    def ends(self) -> Complex:
        """Terms of a record's ends, in addition to those of poles, (lines, ENDS)."""
        return np.column_stack([self.s[:, None] ** np.arange(ENDS - 1), 1 / (1 - self.back)])


def _of_response(found: MeasuredResponse) -> list[_Set]:
    """Lines of the records that responses are local models of; or the responses, where they share no data."""
    if found.records:
        return _of_lines(found.records, float(found.frequency_hz[0]), float(found.frequency_hz[-1]))
    one = found.independent()
    units = in_units(one.inputs, one.outputs)
    values = (one.values / units).reshape(len(one.values), -1)
    known = bool(np.all(np.isfinite(one.covariance)))
    noise = one.covariance / np.outer(units.ravel(), units.ravel())
    if not known:
        size = 1e-4 * np.mean(np.abs(values) ** 2, axis=0)
        noise = np.broadcast_to(np.diag(size).astype(np.complex128), (len(values), len(size), len(size)))
    ones = np.ones((len(values), 1), dtype=np.complex128)
    unit = 2 * np.pi * float(np.max(one.frequency_hz))
    return [_Set(one.frequency_hz, ones, values, noise, 0.0, unit, known)]


def _of_lines(parts: Sequence[RecordLines], low: float, high: float) -> list[_Set]:
    """Lines of records from `low` to `high` Hz, with the noise that local models show."""
    noise = line_noise(parts, low, high)
    sets = []
    for part, level in zip(parts, noise, strict=True):
        f = part.frequency_hz
        inside, step = (f >= low) & (f <= high), part.duration_s / part.samples
        sets.append(_Set(f[inside], part.inputs[inside], part.outputs[inside], level, step, 2 * np.pi * high))
    return sets


# The model.

RESIDUAL_POWERS = (
    (-2, 0, 2),
    (0, 2),
    (-2, 0),
    (0,),
    (),
)  # of s, real: modes below, direct or between, and above
ROUNDING = 1e-15  # of sums over lines, relative to their size, for each unknown
ENDS = 4  # terms of a record's ends, in addition to those of poles: 1, s, s², and a drift's 1/(1 − e^{−sΔ})


@dataclass(frozen=True)
class _Fit:
    """Poles (m,) in the sets' unit, coefficients (q, columns), χ², its real data and unknowns, and the joint covariance
    of (Re λ, Im λ of each pole, coefficients of each output)."""

    poles: Complex
    coefficients: Real
    chi2: float
    data: int
    unknowns: int
    residuals: list[Complex]
    powers: tuple[int, ...]
    covariance: Real
    columns: int

    @property
    def dof(self) -> int:
        """Degrees of freedom."""
        return max(1, self.data - self.unknowns)


def _bases(one: _Set, poles: Complex) -> tuple[Complex, Complex]:
    """(lines, poles) 1/(s − λ) of responses and 1/(1 − e^{(λ − s)Δ}) of the ends of records, the latter times Δ.

    The second is exact for what a sampled record of finite length shows of a decay.  Slopes in λ: the square of the
    first, and of the second its square less Δ times itself.
    """
    plain: Complex = 1 / (one.s[:, None] - poles)
    if not one.step:
        return plain, plain[:, :0]
    delta = one.unit * one.step
    return plain, np.asarray(delta / (1 - np.exp(poles * delta) * one.back[:, None]))


def _design(sets: Sequence[_Set], poles: Complex, powers: Sequence[int]) -> list[Complex]:
    """Columns (lines, …) of each set: of each input the residues and the powers, of each record its own ends."""
    records = sum(1 for one in sets if one.step)
    designs, number = [], 0
    for one in sets:
        # With conjugate poles, per real and imaginary part of the residue: (lines, poles, 2)
        both = zip(_bases(one, poles), _bases(one, np.conj(poles)), strict=True)
        plain, ends = (np.stack([a + b, 1j * (a - b)], axis=-1) for a, b in both)
        lines = len(one.s)
        s = one.s[:, None]
        of_input = np.concatenate([plain.reshape(lines, -1), s ** np.array(powers, dtype=float)], axis=1)
        blocks = [one.inputs[:, c, None] * of_input for c in range(one.inputs.shape[1])]
        for record in range(records):
            own = of_input
            if one.step:
                own = np.concatenate([ends.reshape(lines, -1), one.ends], axis=1)
            blocks.append(own if one.step and record == number else np.zeros_like(own))
        number += bool(one.step)
        designs.append(
            np.concatenate(blocks, axis=1) if blocks else np.zeros((lines, 0), dtype=np.complex128)
        )
    return designs


def _sums(sets: Sequence[_Set], X: Sequence[Complex]) -> Real:
    """Σ over lines of Re(Xᴴ P X), (q·a, q·a), of columns (lines, a) that all outputs share."""
    q, a = sets[0].outputs.shape[1], X[0].shape[1]
    total = np.zeros((q, a, q, a))
    for one, A in zip(sets, X, strict=True):
        P = one.precision
        rows = _stacked([A])
        for i in range(q):
            for j in range(i + 1):
                if np.any(P[:, i, j]):
                    total[i, :, j] += rows.T @ _stacked([P[:, i, j, None] * A])
    for i in range(q):
        for j in range(i):
            total[j, :, i] = total[i, :, j].T
    return total.reshape(q * a, q * a)


def _slopes(sets: Sequence[_Set], poles: Complex, coefficients: Real, powers: int) -> list[Complex]:
    """How the outputs of each set move with Re λ and Im λ of each pole, (lines, q, 2m)."""
    m, q, nu = len(poles), len(coefficients), sets[0].inputs.shape[1]
    slopes, number = [], 0
    per_input = 2 * m + powers
    for one in sets:
        (plain, ends), (below, ends_below) = _bases(one, poles), _bases(one, np.conj(poles))
        blocks = [(plain**2, below**2, one.inputs[:, c, None], c * per_input) for c in range(nu)]
        if one.step:
            delta, at = one.unit * one.step, nu * per_input + number * (2 * m + ENDS)
            blocks.append(
                (ends * (ends - delta), ends_below * (ends_below - delta), np.ones((1, 1), np.complex128), at)
            )
            number += 1
        J = np.zeros((len(one.s), q, m, 2), dtype=np.complex128)
        for above, under, factor, at in blocks:
            R = coefficients[:, at : at + 2 * m].reshape(q, m, 2) @ np.array([1, 1j])
            first = (factor * above)[:, None] * R
            second = (factor * under)[:, None] * np.conj(R)
            J[..., 0] += first + second
            J[..., 1] += 1j * (first - second)
        slopes.append(J.reshape(len(one.s), q, 2 * m))
    return slopes


def _solved(
    sets: Sequence[_Set], poles: Complex, powers: tuple[int, ...], full: bool = False
) -> tuple[_Fit, Real]:
    """The coefficients for given poles, and the Gauss-Newton step and information of the poles as (2m, 2m + 1)."""
    X = _design(sets, poles, powers)
    q, count, m = sets[0].outputs.shape[1], X[0].shape[1], len(poles)
    size = np.sqrt(sum(np.sum(np.abs(A) ** 2, axis=0) for A in X)) + 1e-300
    X = [A / size for A in X]
    N = _sums(sets, X)
    weighed = [(one.precision @ one.outputs[..., None])[..., 0] for one in sets]
    rhs = np.sum([(np.conj(A.T) @ w).real for A, w in zip(X, weighed, strict=True)], axis=0).T.ravel()
    scale = np.sqrt(np.maximum(np.diagonal(N), 1e-300))
    N = N / np.outer(scale, scale) + 1e-13 * np.eye(len(N))
    inverse = np.linalg.inv(N) / np.outer(scale, scale)
    theta = (inverse @ rhs).reshape(q, count)
    residuals = [one.outputs - A @ theta.T for one, A in zip(sets, X, strict=True)]
    chi2 = 2 * sum(
        float(np.vdot(e, (one.precision @ e[..., None])[..., 0]).real)
        for one, e in zip(sets, residuals, strict=True)
    )
    slopes = _slopes(sets, poles, theta / size, len(powers))
    weighed_J = [one.precision @ J for one, J in zip(sets, slopes, strict=True)]
    pp = sum(
        np.einsum("lip,lir->pr", np.conj(J), W, optimize=True).real
        for J, W in zip(slopes, weighed_J, strict=True)
    )
    lp = sum(
        np.einsum("la,lip->iap", np.conj(A), W, optimize=True).real for A, W in zip(X, weighed_J, strict=True)
    ).reshape(q * count, 2 * m)
    gradient = sum(
        np.einsum("lip,li->p", np.conj(W), e, optimize=True).real
        for W, e in zip(weighed_J, residuals, strict=True)
    )
    tied = inverse @ lp
    S = pp - lp.T @ tied
    data = 2 * q * sum(len(one.s) for one in sets)
    covariance = np.zeros((0, 0))
    if full:
        # What the lines do not tell stays uncertain by the rounding of sums: never a variance of 0 or below
        joint = np.block([[pp, lp.T], [lp, N * np.outer(scale, scale)]])
        back = np.sqrt(np.maximum(np.diagonal(joint), 1e-300))
        told = joint / np.outer(back, back) + ROUNDING * len(joint) * np.eye(len(joint))
        root = solve_triangular(np.linalg.cholesky(told), np.eye(len(joint)), lower=True)
        back *= np.concatenate([np.ones(2 * m), np.tile(size, q)])
        covariance = root.T @ root / np.outer(back, back) / 2
    unknowns = 2 * m + q * count
    fit = _Fit(poles, theta / size, chi2, data, unknowns, residuals, powers, covariance, count)
    return fit, np.column_stack([S, gradient]) if m else np.zeros((0, 1))


def _refined(sets: Sequence[_Set], poles: Complex, powers: tuple[int, ...], within: float = 1e-4) -> _Fit:
    """The fit `within` so much χ² of the nearest minimum: Levenberg-Marquardt in the poles alone."""
    fit, normal = _solved(sets, poles, powers)
    damping = 1e-3
    for _ in range(30 if len(poles) else 0):
        S, g = normal[:, :-1], normal[:, -1]
        size = np.diagonal(S) + 1e-12 * np.max(np.diagonal(S))
        step = np.linalg.solve(S + damping * np.diag(size), g).reshape(-1, 2)
        trial = fit.poles + step[:, 0] + 1j * step[:, 1]
        expected = float(g @ step.ravel())
        sound = np.all(trial.imag > 0) and np.all(np.abs(step) < 0.2)
        if sound:
            other, its = _solved(sets, trial, powers)
        if sound and np.isfinite(other.chi2) and other.chi2 < fit.chi2:
            done = fit.chi2 - other.chi2 < within or expected < 1e-6
            fit, normal, damping = other, its, max(damping / 10, 1e-9)
            if done:
                break
        elif damping > 1e8 or expected < 1e-9:
            break
        else:
            damping *= 10
    return fit


# Which poles: those that least-squares fits of many orders have are tried, the best first.


def _least_squares_poles(sets: Sequence[_Set]) -> Stabilisation:
    """Poles of common-denominator fits in z⁻¹ of orders 2, 4, …, (least-squares complex frequency, lowest terms 1)."""
    highest = max(float(np.max(one.frequency_hz)) for one in sets)
    lines = sum(len(one.s) for one in sets)
    columns = sets[0].inputs.shape[1] + sum(1 for one in sets if one.step)
    most = int(min(40, lines // (columns + 1) - 1))  # orders of the stabilisation picture
    delta = 0.95 / (2 * highest)  # s: the band reaches nearly round the half circle
    n = most + 1
    q = sets[0].outputs.shape[1]
    turns = [np.exp(-2j * np.pi * one.frequency_hz[:, None] * delta * np.arange(n)) for one in sets]
    parts = []  # of each output: R (columns, n, columns, n), S (columns, n, n), T (n, n)
    records = [k for k, one in enumerate(sets) if one.step]
    for i in range(q):
        R, S, T = np.zeros((columns, n, columns, n)), np.zeros((columns, n, n)), np.zeros((n, n))
        for k, (one, turn) in enumerate(zip(sets, turns, strict=True)):
            w = 1 / np.sqrt(
                np.maximum(one.noise[:, i, i].real, 1e-24 * np.abs(one.outputs[:, i]) ** 2 + 1e-300)
            )
            ends = [np.ones(len(w)) if k == record else np.zeros(len(w)) for record in records]
            U = np.column_stack([one.inputs, *ends]) * w[:, None]
            A = (U[:, :, None] * turn[:, None, :]).reshape(len(w), -1)
            B = -(w * one.outputs[:, i])[:, None] * turn
            R += (np.conj(A.T) @ A).real.reshape(R.shape)
            S += (np.conj(A.T) @ B).real.reshape(S.shape)
            T += (np.conj(B.T) @ B).real
        parts.append((R, S, T))
    orders, found, damping, stable = [], [], [], []
    before = np.zeros(0, dtype=np.complex128)
    for order in range(2, most + 1, 2):
        n = order + 1
        M = np.zeros((n, n))
        for R, S, T in parts:
            square = R[:, :n, :, :n].reshape(columns * n, columns * n)
            side = S[:, :n, :n].reshape(columns * n, n)
            size = np.sqrt(np.maximum(np.diagonal(square), 1e-300))
            scaled = square / np.outer(size, size) + 1e-12 * np.eye(len(square))
            M += T[:n, :n] - side.T @ (np.linalg.solve(scaled, side / size[:, None]) / size[:, None])
        a = np.concatenate([-np.linalg.lstsq(M[:-1, :-1], M[:-1, -1], rcond=None)[0], [1.0]])
        roots = np.roots(a[::-1])
        roots = roots[np.abs(roots) > 0]
        poles = -np.log(roots.astype(np.complex128)) / delta
        poles = poles[(poles.imag > 0) & (poles.real < 0)]
        f, z = np.abs(poles) / (2 * np.pi), -poles.real / np.maximum(np.abs(poles), 1e-300)
        near = (
            (np.abs(before[None, :]) / (2 * np.pi) / f[:, None] - 1)
            if len(before)
            else np.full((len(f), 1), np.inf)
        )
        ratio = (-before.real / np.abs(before) / z[:, None] - 1) if len(before) else near
        stable += np.any((np.abs(near) < STABLE[0]) & (np.abs(ratio) < STABLE[1]), axis=1).tolist()
        orders += [order] * len(f)
        found += f.tolist()
        damping += z.tolist()
        before = poles
    return Stabilisation(
        np.array(orders, dtype=np.int64), np.array(found), np.array(damping), np.array(stable, dtype=bool)
    )


def _gains(sets: Sequence[_Set], fit: _Fit, candidates: Complex) -> Real:
    """By how much χ² falls with each candidate added to the present poles, (k,), to rank them.

    The noise between outputs is left out, and how it goes over the lines is that of their geometric mean.
    """
    each = [np.diagonal(one.precision, axis1=1, axis2=2).real ** 0.5 for one in sets]  # (lines, q)
    size = np.exp(np.mean(np.log(np.concatenate(each)), axis=0))
    weights = [np.exp(np.mean(np.log(w / size), axis=1))[:, None] for w in each]
    X = _stacked([w * A for w, A in zip(weights, _design(sets, fit.poles, fit.powers), strict=True)])
    Q = np.linalg.qr(X / (np.linalg.norm(X, axis=0) + 1e-300))[0].astype(np.float32)
    e = _stacked([w * size * one for w, one in zip(weights, fit.residuals, strict=True)]).astype(np.float32)
    nu, gains = sets[0].inputs.shape[1], np.zeros(len(candidates))
    for first in range(0, len(candidates), TOGETHER):
        some = candidates[first : first + TOGETHER]
        m = len(some)
        # Of each input and each record the residues of every candidate, without the polynomials of the ends
        columns = [2 * m] * nu + [2 * m + ENDS] * sum(1 for one in sets if one.step)
        starts = np.cumsum([0, *columns])[:-1]
        of = (starts[None, :, None] + 2 * np.arange(m)[:, None, None] + np.arange(2)).reshape(-1)
        z = _stacked([w * A[:, of] for w, A in zip(weights, _design(sets, some, ()), strict=True)])
        z = (z / np.maximum(np.linalg.norm(z, axis=0), 1e-300)).astype(np.float32)  # ranks need no more
        z = z - Q @ (Q.T @ z)
        z = z / np.maximum(np.linalg.norm(z, axis=0), np.float32(1e-6))
        z3 = np.moveaxis(z.reshape(len(z), m, -1), 1, 0)
        G = np.swapaxes(z3, 1, 2) @ z3 + np.float32(1e-5) * np.eye(z3.shape[2], dtype=np.float32)
        b = (z.T @ e).reshape(m, -1, e.shape[1])
        gains[first : first + m] = 2 * np.sum(b * np.linalg.solve(G, b), axis=(1, 2))
    return gains


TOGETHER = 20  # candidates: memory of a few records
ENOUGH = 0.1  # of χ², within which fits of other orders are compared: the evidence asks for tens


def _stacked(parts: Sequence[Complex]) -> Real:
    """Real and imaginary parts of several sets as rows of one array."""
    return np.concatenate([half for part in parts for half in (part.real, part.imag)])


def _by_evidence(sets: list[_Set], most: int) -> tuple[_Fit, Stabilisation, tuple[float, float]]:
    """The fit with as many poles as BIC asks for, the terms outside the band likewise; and χ² with the noise as given.

    Where the fit leaves more than the noise, that is what a further pole has to beat.
    """
    stabilisation = _least_squares_poles(sets)
    f = np.unique(np.concatenate([one.frequency_hz for one in sets]))
    low, high = float(f[0]), float(f[-1])
    inside = (stabilisation.frequency_hz > low) & (stabilisation.frequency_hz < high)
    inside &= stabilisation.damping_ratio < HIGHEST_DAMPING
    order = stabilisation.order[inside]
    keep = order >= np.max(order, initial=0) - 12  # the highest orders, which have all the modes
    hz, zeta = stabilisation.frequency_hz[inside][keep], stabilisation.damping_ratio[inside][keep]
    # Between them every hundredth of the band, as sharp as the lines allow to see and as broad as usual modes
    grid = np.linspace(low, high, 100)
    spacing = float(np.median(np.diff(f))) if len(f) > 1 else 0.0
    sharp = np.clip(spacing / np.maximum(grid, 1e-300), 1e-3, 0.05)
    hz = np.concatenate([hz, grid, grid])
    zeta = np.concatenate([zeta, sharp, np.full(100, 0.02)])
    candidates = 2 * np.pi * hz * (-zeta + 1j * np.sqrt(1 - zeta**2)) / sets[0].unit
    known = sets[0].known
    fit = _refined(sets, np.zeros(0, dtype=np.complex128), RESIDUAL_POWERS[0])
    # A pole that is added leaves less to most others: gains of before are bounds, until the first of a round fails
    gains = np.full(len(candidates), np.inf)
    while len(fit.poles) < most:
        tried, better, fresh = candidates[:0], None, np.zeros(len(candidates), dtype=bool)
        while better is None and len(tried) < 3:
            apart = np.all(np.abs(tried[:, None] - candidates) >= 0.02 * np.abs(candidates), axis=0)
            best = int(np.argmax(np.where(apart, gains, -1.0)))
            if not fresh[best] or (len(tried) and not np.all(fresh)):
                old = np.flatnonzero(~fresh)
                some = old[np.argsort(-gains[old], kind="stable")[: None if len(tried) else TOGETHER]]
                gains[some], fresh[some] = _gains(sets, fit, candidates[some]), True
                continue
            if not apart[best]:
                break
            tried = np.append(tried, candidates[best])
            other = _refined(sets, np.append(fit.poles, candidates[best]), fit.powers, ENOUGH)
            if other.dof > 1 and _pays(other, fit, known):
                better = other
        if better is None:
            break
        fit = better
    for powers in RESIDUAL_POWERS[1:]:
        other = _refined(sets, fit.poles, powers, ENOUGH)
        if not _pays(fit, other, known):
            fit = other
    first = (fit.chi2, float(fit.dof)) if known else (np.nan, float(fit.dof))
    for _ in range(2):
        sets[:] = _with_noise_of(sets, _solved(sets, fit.poles, fit.powers, full=True)[0])
        fit = _refined(sets, fit.poles, fit.powers)
    fit, _ = _solved(sets, fit.poles, fit.powers, full=True)
    # Where the noise is that of residuals already, they say nothing more
    scale = max(1.0, fit.chi2 / fit.dof) if known and not sets[0].step else 1.0
    return replace(fit, covariance=fit.covariance * scale), stabilisation, first


def _pays(larger: _Fit, smaller: _Fit, known: bool) -> bool:
    """Whether the terms that one fit has more are worth it (BIC)."""
    level = larger.chi2 / larger.dof
    level = max(1.0, level) if known else level
    return smaller.chi2 - larger.chi2 > level * (larger.unknowns - smaller.unknowns) * np.log(larger.data)


def _with_noise_of(sets: Sequence[_Set], fit: _Fit) -> list[_Set]:
    """The sets with the noise that the fit (with its covariance) leaves, where it was not known, and of records.

    E[Δ Δᴴ] of a line is that of its residual and of what the fit took, J Σ Jᴴ; its mean over neighbouring lines, so
    many that each line is likeliest by the mean of the others, between outputs or without.  An inverse of such a mean
    over n lines of q outputs is n / (n − q) too large, and what it weighs scatters by as much more (moments of the
    inverse complex Wishart distribution: Maiwald and Kraus, IEE Proceedings Radar 147, 2000): both are in the noise.
    """
    if sets[0].known and not sets[0].step:
        return list(sets)
    shown = []
    for one, e, taken in zip(sets, fit.residuals, _taken(sets, fit), strict=True):
        floor = 1e-24 * np.mean(np.abs(one.outputs) ** 2) + 1e-300
        outer = np.einsum("li,lj->lij", e, np.conj(e)) + taken * (fit.chi2 / fit.dof)
        shown.append(invertible(outer + floor * np.eye(e.shape[1])))
    longest, q = max(map(len, shown)), shown[0].shape[1]
    apart: list[Complex] = [np.diagonal(outer, axis1=1, axis2=2)[..., None, None] for outer in shown]
    choices = []
    for half in [*doubled(7, longest), longest]:  # lines on either side
        for outers, size in ((apart, 1), (shown, q)):
            counts = [min(2 * half + 1, len(outer)) for outer in outers]
            if min(counts) < 4 * size + 2:  # of the others too few for an inverse
                continue
            levels = [smoothed(outer, half) for outer in outers]
            likely = sum(map(likelihood_by_others, outers, levels, counts))
            whole = [level if level.ndim == 3 else level[..., 0] * np.eye(q) for level in levels]
            choices.append(
                (likely, [n_l * (n / (n - size)) ** 2 for n_l, n in zip(whole, counts, strict=True)])
            )
    _, best = max(choices, key=lambda choice: choice[0])
    return [replace(one, noise=noise) for one, noise in zip(sets, best, strict=True)]


def _taken(sets: Sequence[_Set], fit: _Fit) -> list[Complex]:
    """J Σ Jᴴ of each line (lines, q, q): the part of its noise that went into poles and coefficients."""
    q, count = fit.coefficients.shape
    m2 = 2 * len(fit.poles)
    X = _design(sets, fit.poles, fit.powers)
    pp, pc = fit.covariance[:m2, :m2], fit.covariance[:m2, m2:].reshape(m2, q, count)
    cc = fit.covariance[m2:, m2:].reshape(q, count, q, count)
    found = []
    for A, J in zip(X, _slopes(sets, fit.poles, fit.coefficients, len(fit.powers)), strict=True):
        taken = np.einsum("lip,ljp->lij", J @ pp, np.conj(J))
        for j in range(q):
            crossed = np.einsum("lip,lp->li", J, np.conj(A) @ pc[:, j].T)
            taken[:, :, j] += crossed
            taken[:, j, :] += np.conj(crossed)
            for i in range(q):
                taken[:, i, j] += np.einsum("la,la->l", A @ cc[i, :, j, :], np.conj(A))
        found.append(taken)
    return found


def _modes_among(fit: _Fit, sets: Sequence[_Set]) -> tuple[Ints, int]:
    """Numbers of the poles that are modes, by frequency, and how many others there are.

    A mode swings, lies in the band, and its eigenvalue is known to a tenth, its damping to its own size.
    """
    f = np.abs(fit.poles) * sets[0].unit / (2 * np.pi)
    zeta = -fit.poles.real / np.abs(fit.poles)
    low = min(float(np.min(one.frequency_hz)) for one in sets)
    high = max(float(np.max(one.frequency_hz)) for one in sets)
    sd = (
        np.sqrt(np.maximum(np.diagonal(fit.covariance)[: 2 * len(f)], 0)).reshape(-1, 2)
        / np.abs(fit.poles)[:, None]
    )
    there = (f > low) & (f < high) & (zeta < HIGHEST_DAMPING) & (zeta > -3 * sd[:, 0])
    there &= (sd[:, 1] < 0.1) & (sd[:, 0] < np.clip(np.abs(zeta), 0.01, 0.1))
    order = np.argsort(f, kind="stable")
    return order[there[order]], int(np.sum(~there))


# Shapes: the residues of a mode are φ pᵀ, of inputs and of the ends of records alike.


def _shape(
    fit: _Fit, k: int, outputs: Sequence[Channel], nu: int, real: bool, unit: float
) -> tuple[Complex, Real, Complex, Real]:
    """Shape of pole k, its sd, its participations (columns,), their sd: least of Σ (R − φ pᵀ)ᵀ V⁻¹ (R − φ pᵀ).

    V is the covariance of the residues R (outputs, columns).  `real`: φ is, up to the factor p.
    """
    m, ny = len(fit.poles), len(outputs)
    q, count = fit.coefficients.shape
    pairs = q // ny  # responses: pairs of output and input, one column each
    per_input, per_end = 2 * m + len(fit.powers), 2 * m + ENDS
    into = 1 if pairs > 1 or nu == 0 else nu
    starts = [c * per_input for c in range(into if nu else 0)]
    starts += list(range(len(starts) * per_input, count, per_end))
    places = np.array([[start + 2 * k, start + 2 * k + 1] for start in starts])  # (columns, 2)
    at = (np.arange(q)[:, None, None] * count + places).reshape(ny, -1, 2)  # (outputs, columns, re and im)
    # As displacements: what a derivative has more is a factor λ, to which residues are rotated
    rates = [0 if c.quantity is Quantity.FORCE else c.quantity.derivative for c in outputs]
    factor = (fit.poles[k] * unit) ** -np.array(rates, dtype=float)
    turn = np.array([[[f.real, -f.imag], [f.imag, f.real]] for f in factor])  # (outputs, 2, 2)
    R = np.einsum("iab,icb->ica", turn, fit.coefficients.ravel()[at])
    V = fit.covariance[np.ix_(2 * m + at.ravel(), 2 * m + at.ravel())]
    shaped = V.reshape(*at.shape, *at.shape)
    V = np.einsum("iab,icbjdf,jef->icajde", turn, shaped, turn).reshape(V.shape)
    size = np.sqrt(np.maximum(np.diagonal(V), 1e-300))
    # (values, values) of the residues in uncorrelated combinations of one sd, those without any left out
    spread, directions = np.linalg.eigh(V / np.outer(size, size))
    told = spread > 1e-15 * spread[-1] * len(spread)
    root = (directions[:, told] / np.sqrt(spread[told])).T / size
    Z = R[..., 0] + 1j * R[..., 1]
    columns = Z.shape[1]
    signal = np.sum(np.abs(Z) ** 2, axis=0) / np.sum(size.reshape(R.shape) ** 2, axis=(0, 2))
    phi = Z[:, int(np.argmax(signal))]
    reference = int(np.argmax(np.abs(phi)))
    phi = phi / phi[reference]
    phi[reference] = 1.0
    phi = phi.real + 0j if real else phi
    others = [i for i in range(ny) if i != reference]
    parts = 1 if real else 2
    free = parts * len(others)  # unknowns of the shape, before those of the participations

    def halves(values: Complex) -> Real:
        """(…, 2): real and imaginary parts."""
        return np.stack([values.real, values.imag], axis=-1)

    def split(x: Real) -> tuple[Complex, Complex]:
        """The shape and the participations of unknowns x."""
        shape = phi.copy()
        shape[others] = x[:free].reshape(-1, parts) @ np.array([1, 1j])[:parts]
        return shape, x[free::2] + 1j * x[free + 1 :: 2]

    def residual(x: Real) -> Real:
        """φ pᵀ − R in units of its sd."""
        moved: Real = root @ (halves(np.outer(*split(x))) - R).ravel()
        return moved

    def slope(x: Real) -> Real:
        """(values, unknowns) of the residual."""
        shape, p = split(x)
        J = np.zeros((ny, columns, 2, free + 2 * columns))
        for part in range(parts):
            J[others, :, :, np.arange(part, free, parts)] = halves(p * 1j**part)
        for c in range(columns):
            for part in range(2):
                J[:, c, :, free + 2 * c + part] = halves(shape * 1j**part)
        moved: Real = root @ J.reshape(-1, J.shape[-1])
        return moved

    x = np.concatenate([halves(phi[others])[:, :parts].ravel(), halves(Z[reference]).ravel()])
    x = least_squares(residual, x, slope, x_scale="jac").x
    phi, p = split(x)
    J = slope(x)
    # of shapes without a unit, and of participations of any size
    size = np.linalg.norm(J, axis=0) + 1e-150
    W = np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / np.outer(size, size)
    sd = np.zeros(ny)
    variance = np.diagonal(W)
    of_phi = variance[: parts * len(others)].reshape(-1, parts)
    sd[others] = np.sqrt(np.maximum(np.mean(of_phi, axis=1), 0))
    p_sd = np.sqrt(np.maximum(variance[parts * len(others) :].reshape(-1, 2).mean(axis=1), 0))
    return phi, sd, p * unit, p_sd * unit
