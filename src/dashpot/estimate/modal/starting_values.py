"""Where the search of rigs with measured modes starts."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real, hermitian
from dashpot.data.modal_data import ModalData
from dashpot.estimate.modal.pairing import MeasuredModes
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_scaled


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


def random_rigs(model: Model, data: ModalData, count: int, rng: np.random.Generator) -> Real:
    """`count` rigs of like parts whose frequencies are those of the data, (count, unknowns)."""
    rate = 2 * np.pi * float(np.exp(np.mean(np.log(data.frequency_hz))))
    ratio = float(np.nanmean(np.abs(data.damping_ratio))) if np.any(np.isfinite(data.damping_ratio)) else 0.01
    per_mass = {kind: kind.law.typical_size(1.0, rate, ratio) for kind in Kind}
    known = [
        np.log(value / per_mass[element.kind])
        for element, value in zip(model.elements, model.p0, strict=True)
        if value > 0 and element.kind is not Kind.DAMPER
    ]
    known += [
        np.log(u.prior) for u in model.unknowns if u.prior is not None and u.prior > 0 and u.unit == "kg"
    ]
    mass = float(np.exp(np.mean(known))) if known else 1.0
    kinds = {element.name: element.kind for element in model.elements}
    spread = np.repeat([0.3, 1.0, 2.0], -(-count // 3))[:count, None]
    theta = np.empty((count, len(model.unknowns)))
    scatter = np.exp(spread * rng.standard_normal(theta.shape))
    masses = mass * np.exp(0.7 * rng.standard_normal(count))
    for j, unknown in enumerate(model.unknowns):
        if unknown.prior is not None and unknown.sd is not None:
            theta[:, j] = unknown.prior
        elif unknown.guess is not None:
            theta[:, j] = unknown.guess * scatter[:, j] ** 0.3
        else:
            theta[:, j] = masses * per_mass[kinds[unknown.name]] * scatter[:, j]
    return theta
