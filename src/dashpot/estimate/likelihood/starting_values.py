"""Where to start a search when nobody guesses: rigs of sensible size, drawn at random (THEORY §4, ml)."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.estimate.likelihood.chunks import Measured, Piece, Sums, pieces
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.dynamics import amplitudes, unit_forces
from dashpot.model.elements import Kind
from dashpot.model.observation import ObservationModel, calibration_factors, channel_amplitudes, small

SCATTER = (0.03, 0.1, 0.2, 0.35, 0.6)  # decades by which the elements of one candidate differ


def candidates(data: Prepared, count: int, rng: np.random.Generator) -> tuple[Real, Real]:
    """`count` draws of ψ, (count, M), and of the channels' signs, (count, channels).

    Each candidate has a mass, a natural frequency and a damping ratio of its own, around which its elements scatter
    by little or much: rigs are mostly built of parts alike, and among rigs of like parts a search finds its way.  The
    mass is drawn around what known parameters or measured forces imply, the frequency from the band of the data.
    Guesses and priors of the model narrow the draw; the first candidate is the middle of every range.
    """
    view = data.view
    low, high = np.min(view.omega), 1.5 * np.max(view.omega)
    middle = _typical_mass(data)
    masses = middle * 10 ** (0.3 * rng.standard_normal(count))
    rates = low * (high / low) ** rng.random(count)
    ratios = 10 ** rng.uniform(-2.3, 0.0, count)
    decades = rng.choice(SCATTER, count)[:, None] * rng.standard_normal((count, len(view.names)))
    masses[0], rates[0], ratios[0], decades[0] = middle, np.sqrt(low * high), 0.05, 0.0
    size = {kind: kind.law.typical_size(masses, rates, ratios) for kind in Kind}
    kinds = {element.name: element.kind for element in data.model.elements}
    psi = np.ones((count, len(view.names)))
    for j, unknown in enumerate(data.model.unknowns):
        if unknown.prior is not None and unknown.sd is not None:
            psi[:, j] = unknown.prior + unknown.sd * np.clip(decades[:, j], -1, 1)
        elif unknown.guess is not None:
            psi[:, j] = unknown.guess * 10 ** (0.3 * decades[:, j])
        else:
            psi[:, j] = size[kinds[unknown.name]] * 10 ** decades[:, j]
        if unknown.lower is not None or unknown.upper is not None:
            psi[:, j] = np.clip(psi[:, j], unknown.lower, unknown.upper)
    if view.delays:
        psi[:, view.m + view.gains :] = 0.0
    return _calibrated(data, psi, np.ones((count, len(view.channels))), rng)


def neighbours(
    psi: Real, sign: Real, view: ObservationModel, count: int, rng: np.random.Generator
) -> tuple[Real, Real]:
    """`count` draws around the rigs already found, near which the right minimum may lie.

    Some scatter all parameters, some exchange two of a kind (chains seen at few points are nearly the same with two
    of their parts exchanged), some change two parameters by much.
    """
    origin = rng.integers(0, len(psi), count)
    moved = psi[origin].copy()
    kinds = {element.name: element.kind for element in view.model.elements}
    alike = np.array(
        [[kinds[a.name] == kinds[b.name] for b in view.model.unknowns] for a in view.model.unknowns]
    )
    pairs = np.argwhere(np.triu(alike, 1))
    for row in moved:
        move = rng.integers(0, 3)
        if move == 0 and len(pairs):
            i, j = pairs[rng.integers(0, len(pairs))]
            row[[i, j]] = row[[j, i]]
            row[: view.m] *= 10 ** (0.03 * rng.standard_normal(view.m))
        elif move == 1 and view.m > 1:
            row[rng.choice(view.m, 2, replace=False)] *= 10 ** (0.4 * rng.standard_normal(2))
        else:
            row[: view.m] *= 10 ** (rng.choice(SCATTER[1:3]) * rng.standard_normal(view.m))
    return moved, sign[origin]


def _typical_mass(data: Prepared) -> float:
    """The mass that known parameters imply at the middle of the band, else measured force over acceleration."""
    view = data.view
    omega = float(np.exp(np.mean(np.log(view.omega))))
    known = []
    for element in data.model.elements:
        number = element.value if element.value is not None else element.guess
        if number is not None and number > 0:
            # Which share of critical damping a damper has is not known: it counts as an impedance.
            known.append(number / element.law.typical_size(1.0, omega, 0.5))
    masses = [
        e.value for e in data.model.elements if e.kind is Kind.MASS and e.value is not None and e.value > 0
    ]
    if masses:
        return float(np.exp(np.mean(np.log(masses))))
    size = np.mean(np.abs(np.nan_to_num(data.spectrum.amplitudes)), axis=0)
    force = [i for i, c in enumerate(view.channels) if c.quantity is Quantity.FORCE]
    motion = [i for i, c in enumerate(view.channels) if c.quantity is not Quantity.FORCE]
    if force and motion and np.any(size[:, force]) and not known:
        rate = np.array([2 - view.channels[i].quantity.derivative for i in motion])
        acceleration = np.max(size[:, motion] * view.omega[:, None] ** rate, axis=-1)
        pushed = np.max(size[:, force], axis=-1)
        usable = (acceleration > 0) & (pushed > 0)
        if np.any(usable):
            return float(np.exp(np.median(np.log(pushed[usable] / acceleration[usable]))))
    return float(np.exp(np.mean(np.log(known)))) if known else 1.0


def _calibrated(data: Prepared, psi: Real, sign: Real, rng: np.random.Generator) -> tuple[Real, Real]:
    """Gains and signs that suit each candidate: by regression on what it predicts, where the inputs are known."""
    view = data.view
    if not view.gains and not np.any(view.flips):
        return psi, sign
    soft = measured(data, 1.0)
    if view.gains:
        psi[:, view.m : view.m + view.gains] = 10 ** (0.5 * rng.standard_normal((len(psi), view.gains)))
    if np.any(view.flips):
        sign[:, view.flips] = rng.choice([-1.0, 1.0], size=(len(psi), int(np.sum(view.flips))))
    if soft.q is None:
        if view.gains:
            psi[:, view.m : view.m + view.gains] *= rng.choice([-1.0, 1.0], size=(len(psi), view.gains))
        return psi, sign
    with np.errstate(all="ignore"):
        sums = Sums(len(psi))
        for piece in pieces(view, soft, len(psi)):
            sums.add(piece.rows, _likeness(piece, psi[piece.rows], sign[piece.rows]))
        along, power = sums.totals
    flip = view.flips & (along < 0)
    sign = np.where(flip, -sign, sign)
    for k in range(view.gains):
        with_gain = view.gain == k
        ratio = np.sum(along[:, with_gain], axis=-1) / np.maximum(
            np.sum(power[:, with_gain], axis=-1), 1e-300
        )
        usable = np.isfinite(ratio) & (ratio != 0)
        psi[:, view.m + k] *= np.where(usable, ratio, 1.0)
    return psi, sign


def _response(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> Complex:
    """The channels under known inputs without their slopes, which many candidates would spend most time on."""
    model, q = view.model, data.q
    assert q is not None
    r = len(model.displacement_inputs)
    p, U, f = model.parameters(psi[..., : view.m]), q[..., :r], q[..., r:]
    X = amplitudes(model, p, view.omega, U, f)
    forces = np.zeros(len(model.elements), dtype=complex)
    if view.has_forces:
        forces = p[..., None, :] * unit_forces(model, view.omega, X, U)
    return calibration_factors(view, psi, sign) * channel_amplitudes(view, X, q, forces)


def _likeness(piece: Piece, psi: Real, sign: Real) -> tuple[Real, Real]:
    """Products of prediction and data, and of the prediction with itself, in units of the data; (K, channels) each."""
    y = piece.data.y
    if piece.data.ends is None and piece.data.nonlinear is None and small(piece.view.model):
        predicted = _response(piece.view, piece.data, psi, sign)
    else:
        predicted = y - predict(piece.view, piece.data, psi, sign).r
    weight = 1.0 / np.maximum(np.abs(y) ** 2, 1e-300) * (np.abs(y) > 0)
    along = np.sum((np.conj(predicted) * y).real * weight, axis=-2)
    return along, np.sum(np.abs(predicted) ** 2 * weight, axis=-2)
