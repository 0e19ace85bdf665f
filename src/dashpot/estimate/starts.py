"""Where to start a search when nobody guesses: rigs of sensible size, drawn at random (THEORY §4, ml)."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.estimate.method import Prepared
from dashpot.estimate.output import Outlook, measured, predict
from dashpot.model.elements import Kind


def candidates(data: Prepared, view: Outlook, count: int, rng: np.random.Generator) -> tuple[Real, Real]:
    """`count` draws of ψ, (count, M), and of the channels' signs, (count, channels).

    Masses are drawn around the mass that known parameters or measured forces imply, springs and dampers from natural
    frequencies and damping ratios spread over the band of the data.  Guesses and priors of the model narrow the draw.
    The first candidate is the middle of every range.
    """
    spread = rng.standard_normal((count, len(view.names)))
    spread[0] = 0.0
    uniform = rng.random((count, len(view.names)))
    uniform[0] = 0.5
    omega = view.omega
    low, high = 0.5 * np.min(omega), 2.0 * np.max(omega)
    mass = _typical_mass(data, view)
    psi = np.ones((count, len(view.names)))
    by_name = {element.name: element for element in data.model.elements}
    for j, unknown in enumerate(data.model.unknowns):
        m = mass * 10 ** (0.5 * spread[:, j])
        rate = low * (high / low) ** uniform[:, j]
        ratio = 10 ** rng.uniform(-2.5, 0.0, count)
        ratio[0] = 0.05
        kind = by_name[unknown.name].kind
        if unknown.prior is not None and unknown.sd is not None:
            psi[:, j] = unknown.prior + unknown.sd * np.clip(spread[:, j], -1, 1)
        elif unknown.guess is not None:
            psi[:, j] = unknown.guess * np.exp(0.3 * spread[:, j])
        elif kind in (Kind.MASS, Kind.INERTER):
            psi[:, j] = m
        elif kind is Kind.SPRING:
            psi[:, j] = m * rate**2
        elif kind is Kind.DAMPER:
            psi[:, j] = 2 * ratio * m * rate
        else:
            psi[:, j] = 2 * ratio * m * rate**2
        if unknown.lower is not None or unknown.upper is not None:
            psi[:, j] = np.clip(psi[:, j], unknown.lower, unknown.upper)
    if view.delays:
        psi[:, view.m + view.gains :] = 0.0
    sign = np.ones((count, len(view.channels)))
    return _calibrated(data, view, psi, sign, rng)


def _typical_mass(data: Prepared, view: Outlook) -> float:
    """The mass that known parameters imply at the middle of the band, else measured force over acceleration."""
    omega = float(np.exp(np.mean(np.log(view.omega))))
    power = {Kind.MASS: 0, Kind.INERTER: 0, Kind.DAMPER: 1, Kind.SPRING: 2, Kind.HYSTERETIC: 2}
    known = []
    for element in data.model.elements:
        number = element.value if element.value is not None else element.guess
        if number is not None and number > 0:
            known.append(number / omega ** power[element.kind])
    masses = [e.value for e in data.model.elements if e.kind is Kind.MASS and e.value is not None and e.value > 0]
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


def _calibrated(
    data: Prepared, view: Outlook, psi: Real, sign: Real, rng: np.random.Generator
) -> tuple[Real, Real]:
    """Gains and signs that suit each candidate: by regression on what it predicts, where the inputs are known."""
    if not view.gains and not np.any(view.flips):
        return psi, sign
    soft = measured(data, view, 1.0)
    if view.gains:
        psi[:, view.m : view.m + view.gains] = 10 ** (0.5 * rng.standard_normal((len(psi), view.gains)))
    if np.any(view.flips):
        sign[:, view.flips] = rng.choice([-1.0, 1.0], size=(len(psi), int(np.sum(view.flips))))
    if soft.q is None:
        if view.gains:
            psi[:, view.m : view.m + view.gains] *= rng.choice([-1.0, 1.0], size=(len(psi), view.gains))
        return psi, sign
    with np.errstate(all="ignore"):
        at = predict(view, soft, psi, sign)
    predicted = soft.y - at.r
    weight = 1.0 / np.maximum(np.abs(soft.y) ** 2, 1e-300) * (np.abs(soft.y) > 0)
    along = np.sum((np.conj(predicted) * soft.y).real * weight, axis=-2)
    power = np.sum(np.abs(predicted) ** 2 * weight, axis=-2)
    flip = view.flips & (along < 0)
    sign = np.where(flip, -sign, sign)
    for k in range(view.gains):
        own = view.gain == k
        ratio = np.sum(along[:, own], axis=-1) / np.maximum(np.sum(power[:, own], axis=-1), 1e-300)
        usable = np.isfinite(ratio) & (ratio != 0)
        psi[:, view.m + k] *= np.where(usable, ratio, 1.0)
    return psi, sign
