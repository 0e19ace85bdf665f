"""Nonlinear rigs for tests, and what settled dwells of them show."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.spectrum import SettledDwell, Spectrum
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.continuation import grown_from_rest
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.nonlinear.harmonic_balance import harmonic_unit_forces, periodic_response, settled_orders
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.model.observation import channel_amplitudes, measures_input, observation_model

LAWS: Mapping[str, tuple[Mapping[str, float], float]] = {
    "cubic": ({}, 1e9),
    "square": ({}, 4e5),
    "quintic": ({}, 1e14),
    "quadratic": ({}, 2e6),
    "v*abs(v)": ({}, 400.0),
    "v**3": ({}, 3000.0),
    "coulomb": ({"v0": 0.03}, 5.0),
    "stribeck": ({"v0": 0.03, "ratio": 1.4, "vs": 0.06}, 4.0),
    "gap": ({"gap": 5e-4}, 6000.0),
    "one-sided": ({"gap": 3e-4}, 3000.0),
    "bilinear": ({"ratio": 0.7}, 3000.0),
    "jenkins": ({"slip": 5e-4}, 4000.0),
    "backlash": ({"gap": 3e-4}, 3000.0),
    "bouc-wen": ({"gamma": 800.0, "delta": -300.0, "nu": 1.0}, 3000.0),
    "d**3 + b*d**2": ({"b": 2e-4}, 1e9),
}

# Every law in a row of two to five masses in turn
IN_ROWS = [(law, 2 + k % 4) for k, law in enumerate(LAWS)]


def two_masses(law: str, known: bool = False) -> tuple[Model, Real]:
    """Two masses on a shaken base with a nonlinear element from the upper to the base, and its true unknowns."""
    return chain(law, 2, known)


def chain(law: str, count: int, known: bool = False) -> tuple[Model, Real]:
    """Masses in a row, the last of which hangs on a shaken base by a nonlinear element too, and the true unknowns."""
    constants, p = LAWS[law]
    inner = [Constant(name, value if known else None) for name, value in constants.items()]
    last = f"x{count}"
    element = between("q", Kind.SPRING, last, "u")
    nonlinear = type(element)("q", Kind.SPRING, element.along, force_law=force_law(law, inner))
    along = (
        4600.0 if law == "bilinear" else None
    )  # in parallel with an unknown spring it has one slope too many
    points = [f"x{k}" for k in range(1, count + 1)]
    links = list(zip(points, [*points[1:], "u"], strict=True))
    model = Model(
        tuple(points),
        (Input("u"),),
        (
            *(mass(f"m{k}", point) for k, point in enumerate(points[:-1], 1)),
            mass(f"m{count}", last, value=2.7),
            *(between(f"k{k}", Kind.SPRING, *link) for k, link in enumerate(links[:-1], 1)),
            between(f"k{count}", Kind.SPRING, last, "u", value=along),
            *(between(f"c{k}", Kind.DAMPER, *link) for k, link in enumerate(links, 1)),
            nonlinear,
        ),
    )
    springs = [4600.0] * (count - bool(along))
    theta = [*[3.0] * (count - 1), *springs, *[20.0] * count, p, *([] if known else constants.values())]
    return model, np.array(theta)


def guessed(model: Model, theta: Real, factor: float = 1.05) -> Model:
    """The same rig with guesses beside the truth for its elements and the constants of their laws."""
    values = dict(zip([u.name for u in model.unknowns], factor * theta, strict=True))
    elements = []
    for element in model.elements:
        if element.name in values:
            element = replace(element, guess=values[element.name])
        law = element.force_law
        if law is not None:
            constants = [replace(c, guess=values.get(f"{element.name}.{c.name}")) for c in law.constants]
            element = replace(element, force_law=law.with_constants(constants))
        elements.append(element)
    return replace(model, elements=tuple(elements))


def motions(*points: str) -> tuple[Channel, ...]:
    """Displacements of the points."""
    return tuple(Channel(point, {point: 1.0}) for point in points)


def settled(
    model: Model,
    theta: Real,
    channels: Sequence[Channel],
    frequency_hz: Sequence[float],
    *,
    amplitude: float | Sequence[float] = 1e-3,
    orders: Sequence[int] = (1, 3),
    noise: float = 0.0,
    input_noise: float = 0.0,
    rng: np.random.Generator | None = None,
    most: int = 31,
) -> Spectrum:
    """Harmonics of settled dwells; noise is relative to each channel's rms fundamental."""
    f = np.asarray(frequency_hz, dtype=float)
    r = len(model.displacement_inputs)
    q = np.zeros((len(f), most + 1, r + len(model.force_inputs)), dtype=complex)
    q[:, 1] = np.broadcast_to(np.asarray(amplitude, dtype=float), (len(f),))[:, None]
    drive = Drive(2 * np.pi * f, q[..., :r], q[..., r:])
    p = np.tile(model.parameters(theta), (len(f), 1))
    constants = np.tile(model.inner_constants(theta), (len(f), 1))
    at, drive = settled_orders(model, p, constants, drive, tolerance=1e-9, most=most)
    for row in np.flatnonzero(~at.converged):  # far from linear: followed from rest
        at.delta[row] = grown_from_rest(model, theta, drive.rows(np.arange(len(f)) == row))
    if not np.all(at.converged):
        at = periodic_response(model, p, constants, drive, at.delta)
    assert np.all(at.converged)
    forces = p[:, None] * harmonic_unit_forces(model, drive, at)
    lines, Y = [], []
    for row, fundamental in enumerate(f):
        for order in orders:
            view = observation_model(model, channels, np.array([2 * np.pi * order * fundamental]))
            inputs = np.concatenate([drive.U[row, order], drive.f[row, order]])[None]
            Y.append(channel_amplitudes(view, at.X[row, order][None], inputs, forces[row, order][None])[0])
            lines.append(order * fundamental)
    amplitudes = np.array(Y)
    size = np.sqrt(np.mean(np.abs(amplitudes[:: len(orders)]) ** 2, axis=0))
    level = np.array([input_noise if measures_input(model, c) else noise for c in channels])
    sd = np.broadcast_to(level * size, amplitudes.shape)
    if rng is not None:
        draws = rng.standard_normal((2, *amplitudes.shape))
        amplitudes = amplitudes + sd * (draws[0] + 1j * draws[1])
    count = len(lines)
    return Spectrum(
        tuple(channels), np.array(lines), amplitudes, (2 * sd[..., None] ** 2) * np.eye(len(channels)) + 0j,
        np.ones(count, dtype=int), np.full(count, np.inf), ("given",) * count, np.zeros(count, dtype=int),
        stretch=np.repeat(np.arange(len(f)), len(orders)), stretches=tuple(SettledDwell(float(x)) for x in f),
    )  # fmt: skip


def noisy(spectrum: Spectrum, noise: float, repeats: int, seed: int) -> Spectrum:
    """Repeats of exact amplitudes with noise relative to each channel's rms; inputs, called u or f, are exact."""
    rng = np.random.default_rng(seed)
    size = np.sqrt(np.mean(np.abs(spectrum.amplitudes) ** 2, axis=0))
    sd = noise * size * np.array([channel.name not in ("u", "f") for channel in spectrum.channels])
    draws = rng.standard_normal((2, repeats, *spectrum.amplitudes.shape))
    V = np.broadcast_to(np.diag(2 * sd**2) + 0j, (spectrum.lines, len(sd), len(sd)))
    return replace(spectrum, amplitudes=spectrum.amplitudes + sd * (draws[0] + 1j * draws[1]), covariance=V)
