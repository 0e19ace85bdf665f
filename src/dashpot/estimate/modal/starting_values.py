"""Where the search of rigs with measured modes starts."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from scipy.optimize import brentq

from dashpot.arrays import Real, hermitian
from dashpot.data.modal_data import ModalData
from dashpot.estimate.modal.pairing import MeasuredModes
from dashpot.model.elements import Kind
from dashpot.model.modes import eigenpairs
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_scaled

NEAR, AFAR = 0.15, 1.0  # of the spreads, nepers: parts are mostly alike
MOST_SCALINGS, FARTHER = 12, 3.0  # steps in search of the size of like parts, nepers of frequency


def guessed(model: Model, repeats: int) -> Real | None:
    """Guesses and priors, (repeats, unknowns); None where some unknown has neither."""
    choices = [u.prior if u.guess is None else u.guess for u in model.unknowns]
    if any(choice is None for choice in choices):
        return None
    return np.tile(np.array(choices, dtype=float), (repeats, 1))


def linear_start(model: Model, data: ModalData, view: MeasuredModes) -> Real | None:
    """Least squares on (λ²M + λC + K + jH) φ = 0 at the measured λ and φ; None where some coordinate is not seen."""
    if not np.all(view.present) or set(data.points) != set(model.coordinates):
        return None
    lam = data.eigenvalues
    phi = data.shapes @ view.look
    phi = phi / np.linalg.norm(phi, axis=-1, keepdims=True)
    a = model.pole_factors(lam) * (phi @ model.B.T) / np.abs(lam)[..., None] ** 2
    Phi = np.einsum("kli,in,iu->klnu", a, model.B, model.T, optimize=True)
    h = -np.einsum("kli,in,i->kln", a, model.B, model.p0, optimize=True)
    flat, side = Phi.reshape(len(a), -1, len(model.unknowns)), h.reshape(len(a), -1)
    N, r = (hermitian(flat) @ flat).real, (hermitian(flat) @ side[..., None])[..., 0].real
    # A weak prior, in the units of the fit, keeps what the equation alone does not fix near what is known of it.
    weak = 1e-6 * np.diagonal(N, axis1=-2, axis2=-1) * (model.prior_precision > 0)
    theta = solve_scaled(N + weak[..., None] * np.eye(N.shape[-1]), r + weak * model.prior_mean)
    return theta if np.all(np.isfinite(theta)) else None


def like_parts(model: Model, data: ModalData) -> Real:
    """The rig whose unknowns of a kind are all alike and whose first frequency is the first of the data, (unknowns,).

    What is known keeps its value; guesses and priors theirs.  Springs, dampers and the like are scaled, masses only
    where nothing else can be; where that does not lead to the first frequency, usual values are what it is.
    """
    theta = usual_parts(model, data)
    kinds = {element.name: element.kind for element in model.elements}
    free = np.array([unknown.prior is None and unknown.guess is None for unknown in model.unknowns])
    inert = np.array([kinds[unknown.name].law.power == 2 for unknown in model.unknowns])
    power = np.array([2.0 - kinds[unknown.name].law.power for unknown in model.unknowns])
    scaled = free & ~inert
    turned = 1.0
    if not np.any(scaled & (power == 2)):
        scaled, power, turned = free & inert, np.full(len(theta), 2.0), -1.0
    if not np.any(scaled):
        return theta
    wanted = float(np.min(data.frequency_hz))

    def scaled_by(size: float) -> Real:
        """The rig with its unknowns e^size as quick on their own."""
        return np.where(scaled, theta * np.exp(turned * power * size), theta)

    def too_quick(size: float) -> float:
        return float(np.log(_first_frequency(model, scaled_by(size)) / wanted))

    size = _root(too_quick)
    return theta if size is None else scaled_by(size)


def _root(rising: Callable[[float], float]) -> float | None:
    """Where a rising function is 0; None where it is nowhere, or has no value."""
    at_zero = rising(0.0)
    if not np.isfinite(at_zero) or at_zero == 0:
        return 0.0 if at_zero == 0 else None
    low = high = 0.0
    for _ in range(MOST_SCALINGS):
        low, high = (low - FARTHER, low) if at_zero > 0 else (high, high + FARTHER)
        there = rising(low if at_zero > 0 else high)
        if not np.isfinite(there):
            return None
        if (there > 0) != (at_zero > 0):
            with suppress(ValueError):  # no value on the way
                return float(brentq(rising, low, high, xtol=1e-12))
            return None
    return None


def _first_frequency(model: Model, theta: Real) -> float:
    """The lowest frequency that swings, Hz; NaN where there is none."""
    with np.errstate(all="ignore"):
        values, _ = eigenpairs(model, model.parameters(theta)[None])
    swings = values[0][np.isfinite(values[0]) & (values[0].imag > 1e-6 * np.abs(values[0]))]
    return float(np.min(np.abs(swings))) / (2 * np.pi) if len(swings) else np.nan


def usual_parts(model: Model, data: ModalData) -> Real:
    """A usual value of every unknown, (m,): its guess or prior, else that of its kind beside the known ones."""
    per_mass, mass = _sizes(model, data)
    kinds = {element.name: element.kind for element in model.elements}
    return np.array(
        [
            unknown.prior
            if unknown.prior is not None and unknown.sd is not None
            else unknown.guess
            if unknown.guess is not None
            else mass * per_mass[kinds[unknown.name]]
            for unknown in model.unknowns
        ],
        dtype=float,
    )


def random_rigs(model: Model, data: ModalData, count: int, rng: np.random.Generator) -> Real:
    """`count` rigs near that of like parts with the first frequency of the data, and of random size, half of each.

    (count, unknowns); what has a guess or a prior stays near it.
    """
    usual, middle = usual_parts(model, data), like_parts(model, data)
    near = np.arange(count) % 2 == 0
    spread = np.where(near, NEAR, AFAR)[:, None] * np.repeat([0.3, 1.0, 2.0], -(-count // 3))[:count, None]
    shared = np.where(near, 1.0, np.exp(0.7 * rng.standard_normal(count)))
    scatter = np.exp(spread * rng.standard_normal((count, len(usual))))
    theta = np.empty((count, len(usual)))
    for j, unknown in enumerate(model.unknowns):
        if unknown.prior is not None and unknown.sd is not None:
            theta[:, j] = unknown.prior
        elif unknown.guess is not None:
            theta[:, j] = unknown.guess * scatter[:, j] ** 0.3
        else:
            theta[:, j] = np.where(near, middle[j], shared * usual[j]) * scatter[:, j]
    return theta


def _sizes(model: Model, data: ModalData) -> tuple[dict[Kind, float], float]:
    """Usual values of each kind for a mass of 1 kg that swings as the data do, and the mass that known parts imply."""
    rate = 2 * np.pi * float(np.exp(np.mean(np.log(data.frequency_hz))))
    ratio = float(np.nanmean(np.abs(data.damping_ratio))) if np.any(np.isfinite(data.damping_ratio)) else 0.01
    per_mass = {kind: float(kind.law.typical_size(1.0, rate, ratio)) for kind in Kind}
    known = [
        np.log(value / per_mass[element.kind])
        for element, value in zip(model.elements, model.p0, strict=True)
        if value > 0 and element.kind is not Kind.DAMPER
    ]
    known += [
        np.log(u.prior) for u in model.unknowns if u.prior is not None and u.prior > 0 and u.unit == "kg"
    ]
    return per_mass, float(np.exp(np.mean(known))) if known else 1.0
