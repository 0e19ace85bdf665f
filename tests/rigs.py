"""Random rigs for tests: identifiable networks with inputs, what their channels would show, noisy spectra and records.

Everything is a function of a numpy Generator, so a test that states its seed states its rig.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ModelError
from dashpot.estimate.linear.gram import regressors
from dashpot.estimate.preparation import States, states_if_seen
from dashpot.model.dynamics import response, unit_forces
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Input, Model
from dashpot.model.observation import observation_model
from tests.networks import network

ALL_KINDS = frozenset(Kind)
PAPER_KINDS = frozenset({Kind.SPRING, Kind.DAMPER, Kind.MASS})


@dataclass(frozen=True)
class Rig:
    """A model with its true unknowns and a test of it: lines (Hz) with amplitudes of the inputs, U (m) and f (N)."""

    model: Model
    theta: Real
    frequency_hz: Real
    U: Complex
    f: Complex

    @property
    def omega(self) -> Real:
        """rad/s, (lines,)."""
        return 2 * np.pi * self.frequency_hz

    @property
    def lines(self) -> int:
        return len(self.frequency_hz)

    @cached_property
    def p(self) -> Real:
        """True parameters, (elements,)."""
        return self.model.parameters(self.theta)

    @cached_property
    def X(self) -> Complex:
        """True amplitudes of the coordinates, (lines, n), m."""
        return response(self.model, self.p, self.omega, self.U, self.f)

    @cached_property
    def a(self) -> Complex:
        """True unit forces, (lines, elements)."""
        return unit_forces(self.model, self.omega, self.X, self.U)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(unknown.name for unknown in self.model.unknowns)

    def knowing(self, changes: Mapping[str, Mapping[str, float | None]]) -> Rig:
        """The same rig with other knowledge: element name → {"value": …, "sd": …, "guess": …}."""
        truth = dict(zip((e.name for e in self.model.elements), self.p.tolist(), strict=True))
        elements = tuple(
            replace(element, **changes[element.name]) if element.name in changes else element  # type: ignore[arg-type]
            for element in self.model.elements
        )
        model = replace(self.model, elements=elements)
        return replace(self, model=model, theta=np.array([truth[unknown.name] for unknown in model.unknowns]))


@dataclass
class _Builder:
    """Elements of a random rig as they are thrown, with their true values."""

    rng: np.random.Generator
    elements: list[Element] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    count: dict[str, int] = field(default_factory=dict)

    def name(self, letter: str) -> str:
        self.count[letter] = self.count.get(letter, 0) + 1
        return f"{letter}{self.count[letter]}"

    def add(self, element: Element, value: float) -> None:
        self.elements.append(element)
        self.values.append(value)

    def between(self, kind: Kind, first: str, second: str, value: float) -> None:
        self.add(between(self.name(kind.value[0]), kind, first, second), value)

    def spread(self, low: float, high: float) -> float:
        """Log-uniform."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))


def random_rig(
    rng: np.random.Generator,
    n: int,
    *,
    displacements: int = 1,
    forces: int = 0,
    kinds: frozenset[Kind] = ALL_KINDS,
    levers: bool = True,
    ties: bool = True,
    known: float = 0.25,
    lines: int | None = None,
    same_phase: bool = False,
    worst: float = 1e3,
    attempts: int = 200,
) -> Rig:
    """A rig of n coordinates whose unknowns a noise-free test determines.

    Every coordinate has a mass and hangs, by a spring and mostly a damper, on an input, the ground or an earlier
    coordinate; further springs, dampers, inerters, hysteretic dampers and levers join random points.  A share `known`
    of the parameters has its value given (at least one without force inputs).  Natural frequencies are some Hz.

    Identifiable means: the noise-free regressor, its columns scaled by the true values, has singular values within a
    factor `worst`.  Throws rigs until one is; raises RuntimeError after `attempts`.
    """
    for _ in range(attempts):
        rig = _throw(rng, n, displacements, forces, kinds, levers, ties, known, lines, same_phase)
        if rig is not None and condition(rig) < worst:
            return rig
    raise RuntimeError(f"no identifiable rig of {n} coordinates in {attempts} attempts")


def plain_rig(rng: np.random.Generator, n: int) -> Rig:
    """A random rig of masses, dampers and springs between points, none tied to another, tested at 25 lines."""
    return random_rig(rng, n, kinds=PAPER_KINDS, levers=False, ties=False, lines=25, worst=100)


def condition(rig: Rig) -> float:
    """Largest over smallest singular value of the noise-free regressor, columns scaled by the true values."""
    Phi = regressors(rig.model, rig.a) * rig.theta
    flat = Phi.reshape(-1, Phi.shape[-1])
    s = np.linalg.svd(np.concatenate([flat.real, flat.imag]), compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0 else np.inf


def _throw(
    rng: np.random.Generator,
    n: int,
    displacements: int,
    forces: int,
    kinds: frozenset[Kind],
    levers: bool,
    ties: bool,
    known: float,
    lines: int | None,
    same_phase: bool,
) -> Rig | None:
    build = _Builder(rng)
    x = [f"x{i + 1}" for i in range(n)]
    u = [f"u{i + 1}" for i in range(displacements)]
    m0, w0 = build.spread(0.3, 3.0), 2 * np.pi * build.spread(2.0, 6.0)
    k0 = m0 * w0**2
    for coordinate in x:
        build.add(mass(build.name("m"), coordinate), m0 * build.spread(0.4, 2.5))
    anchors = [*u, "ground"] if u else ["ground"]
    for i, coordinate in enumerate(x):
        # A tree from the anchors: each input is used, and most coordinates form a chain.
        if i < len(anchors) and i < displacements:
            below = anchors[i]
        else:
            below = x[i - 1] if i and rng.random() < 0.7 else str(rng.choice([*anchors, *x[:i]]))
        build.between(Kind.SPRING, coordinate, below, k0 * build.spread(0.4, 2.5))
        if rng.random() < 0.8:
            build.between(Kind.DAMPER, coordinate, below, 2 * build.spread(0.03, 0.3) * m0 * w0)
        if Kind.HYSTERETIC in kinds and rng.random() < 0.25:
            build.between(Kind.HYSTERETIC, coordinate, below, k0 * build.spread(0.03, 0.3))
    points = [*x, *u, "ground"]
    for one in u[n:]:  # more inputs than coordinates
        build.between(Kind.SPRING, str(rng.choice(x)), one, k0 * build.spread(0.4, 2.5))
    for _ in range(int(rng.integers(1, n + 2))):
        first = str(rng.choice(x))
        second = str(rng.choice([point for point in points if point != first]))
        choice = Kind(rng.choice(sorted(kinds - {Kind.MASS})))
        value = {
            Kind.SPRING: k0 * build.spread(0.2, 1.0),
            Kind.DAMPER: 2 * build.spread(0.03, 0.3) * m0 * w0,
            Kind.HYSTERETIC: k0 * build.spread(0.03, 0.3),
            Kind.INERTER: m0 * build.spread(0.1, 0.6),
        }[choice]
        build.between(choice, first, second, value)
    if levers and n >= 2 and rng.random() < 0.6:
        one, two = rng.choice(x, size=2, replace=False)
        part = float(rng.uniform(0.2, 0.8))
        along = {str(one): part, str(two): 1 - part}
        if u and rng.random() < 0.7:
            along[str(rng.choice(u))] = -1.0
        kind = Kind.SPRING if rng.random() < 0.5 else Kind.DAMPER
        size = k0 if kind is Kind.SPRING else 0.2 * m0 * w0
        build.add(Element(build.name("lever"), kind, along), size * build.spread(0.4, 2.5))
    elements, values = _knowledge(build, forces, ties, known)
    inputs = [Input(name) for name in u]
    for i in range(forces):
        at = {str(rng.choice(x)): 1.0}
        if n > 1 and rng.random() < 0.3:
            at[str(rng.choice([c for c in x if c not in at]))] = float(rng.choice([-1.0, 0.5]))
        inputs.append(Input(f"f{i + 1}", "force", at))
    try:
        model = Model(tuple(x), tuple(inputs), elements, "random rig")
    except ModelError:
        return None
    if not model.unknowns:
        return None
    truth = dict(zip((e.name for e in elements), values, strict=True))
    theta = np.array([truth[unknown.name] for unknown in model.unknowns])
    own = eigenmodes(model, model.parameters(theta)).frequency_hz
    count = max(6, int(np.ceil(2 * len(theta) / n)) + 2) if lines is None else lines
    grid = np.geomspace(0.4 * max(own.min(), 0.05 * own.max()), 1.3 * own.max(), count)
    frequency = grid * np.exp(rng.uniform(-0.05, 0.05, count))
    U = _drive(rng, count, displacements, same_phase) * 0.01
    f = _drive(rng, count, forces, same_phase) * 0.01 * k0
    rig = Rig(model, theta, frequency, U, f)
    moving = np.max(np.abs(rig.X), axis=0)
    return (
        rig if np.all(moving > 1e-9 * np.max(moving)) else None
    )  # some coordinate may hang on the ground alone


def _knowledge(
    build: _Builder, forces: int, ties: bool, known: float
) -> tuple[tuple[Element, ...], list[float]]:
    """Ties some elements of a kind to an earlier one and gives some of the others their value."""
    rng, elements, values = build.rng, list(build.elements), list(build.values)
    if ties:
        for i, element in enumerate(elements):
            mates = [j for j in range(i) if elements[j].kind == element.kind and elements[j].same_as is None]
            if mates and rng.random() < 0.15:
                root = int(rng.choice(mates))
                times = float(rng.choice([1.0, 2.0, 0.5]))
                elements[i] = replace(element, same_as=elements[root].name, times=times)
                values[i] = times * values[root]
    free = [i for i, element in enumerate(elements) if element.same_as is None]
    chosen = [i for i in free if rng.random() < known]
    if not forces and not chosen:
        chosen = [int(rng.choice(free))]
    for i in chosen:
        elements[i] = replace(elements[i], value=values[i])
    return tuple(elements), values


def _drive(rng: np.random.Generator, lines: int, inputs: int, same_phase: bool) -> Complex:
    """Amplitudes of size near 1: real ratios and one phase (as paper eq. 2), or every one its own."""
    size = np.exp(rng.uniform(-0.5, 0.5, (lines, inputs)))
    if same_phase:
        return -1j * size
    phase = rng.uniform(0, 2 * np.pi, (lines, inputs))
    return size * np.exp(1j * phase)


# ------------------------------------------------------------------------------------------------ what is measured


def channels(
    rig: Rig,
    quantities: Sequence[Quantity] = (Quantity.DISPLACEMENT,),
    rng: np.random.Generator | None = None,
) -> tuple[Channel, ...]:
    """Every coordinate in each of the quantities, then every input; in random order where `rng` is given."""
    found = [
        Channel(f"{quantity.value[0]}_{name}", {name: 1.0}, quantity)
        for quantity in quantities
        for name in rig.model.coordinates
    ]
    found += [Channel(name, {name: 1.0}) for name in rig.model.displacement_inputs]
    found += [Channel(name, {name: 1.0}, Quantity.FORCE) for name in rig.model.force_inputs]
    if rng is not None:
        found = [found[int(i)] for i in rng.permutation(len(found))]
    return tuple(found)


def amplitudes(rig: Rig, chosen: Sequence[Channel]) -> Complex:
    """What the channels show without noise, (lines, channels), SI.  Motions and applied forces."""
    points = dict(zip(rig.model.coordinates, rig.X.T, strict=True))
    points |= dict(zip(rig.model.displacement_inputs, rig.U.T, strict=True))
    points |= dict(zip(rig.model.force_inputs, rig.f.T, strict=True))
    columns = []
    for channel in chosen:
        total = sum(factor * points[name] for name, factor in channel.of.items())
        power = 0 if channel.quantity is Quantity.FORCE else channel.quantity.derivative
        columns.append((1j * rig.omega) ** power * total)
    return np.stack(columns, axis=-1)


def covariance(
    rig: Rig, chosen: Sequence[Channel], relative: float, *, inputs: float = 0.0, correlation: float = 0.0
) -> Complex:
    """V (lines, channels, channels): each channel's noise is `relative` (of its rms over the lines and of its own size,
    half each; `inputs` for the inputs), with one correlation coefficient, turned by random-looking phases.
    """
    Y = np.abs(amplitudes(rig, chosen))
    size = 0.5 * Y + 0.5 * np.sqrt(np.mean(Y**2, axis=0))
    driven = {*rig.model.displacement_inputs, *rig.model.force_inputs}
    sd = size * np.array([inputs if set(c.of) <= driven else relative for c in chosen])
    turn = np.exp(1j * np.arange(len(chosen)))
    R = correlation * np.outer(turn, turn.conj())
    np.fill_diagonal(R, 1.0)
    return sd[:, :, None] * R * sd[:, None, :]


def perfect(rig: Rig, chosen: Sequence[Channel], V: Complex | None = None) -> Spectrum:
    """The noise-free spectrum; its stated covariance is V, 0 where not given."""
    Y = amplitudes(rig, chosen)
    return stated(chosen, rig.frequency_hz, Y, np.zeros((*Y.shape, len(chosen))) if V is None else V)


def stated(
    chosen: Sequence[Channel], hz: ArrayLike, Y: Complex, V: Complex | Real, experiment: ArrayLike = 0
) -> Spectrum:
    """Amplitudes Y (…, lines, channels) at the lines, with the covariance V that they state."""
    lines = Y.shape[-2]
    return Spectrum(
        tuple(chosen), np.asarray(hz), Y, V, np.ones(lines, dtype=int), np.full(lines, np.inf), ("given",) * lines,
        np.broadcast_to(experiment, lines),
    )  # fmt: skip


def of_unknown_noise(spectrum: Spectrum) -> Spectrum:
    """The same amplitudes, of whose noise nothing is known."""
    nothing = np.full_like(spectrum.covariance, np.nan)
    return replace(spectrum, covariance=nothing, noise=("unknown",) * spectrum.lines)


def complex_noise(rng: np.random.Generator, V: Complex, draws: int | None = None) -> Complex:
    """Circular Gaussian noise with E[Δ Δᴴ] = V, (draws, lines, channels); draws None: one, without the axis."""
    values, vectors = np.linalg.eigh(V)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    shape = (() if draws is None else (draws,)) + V.shape[:-1]
    white = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    return np.einsum("...ij,...j->...i", root, white)


def states(model: Model, spectrum: Spectrum, V: Complex) -> States:
    """Coordinates and inputs as the channels show them, all of which must be seen; V (…, lines, channels, channels)."""
    seen = states_if_seen(observation_model(model, spectrum.channels, spectrum.omega), spectrum, V)
    assert seen is not None
    return seen


def noisy(
    rig: Rig, chosen: Sequence[Channel], V: Complex, rng: np.random.Generator, draws: int | None = None
) -> Spectrum:
    """Spectra with noise of covariance V, which they state; leading axis `draws`, none where it is None."""
    clean = perfect(rig, chosen, V)
    return replace(clean, amplitudes=clean.amplitudes + complex_noise(rng, V, draws))


def records(
    rig: Rig,
    chosen: Sequence[Channel],
    rng: np.random.Generator,
    *,
    samples: int = 64,
    periods: float = 1.0,
    relative: float = 0.05,
    jitter: float = 0.0,
) -> list[Record]:
    """One dwell for each line, `samples` over `periods` periods, white noise `relative` to each motion's amplitude.

    Inputs are exact.  `jitter` moves sample times by that part of a step.
    """
    Y = amplitudes(rig, chosen)
    driven = {*rig.model.displacement_inputs, *rig.model.force_inputs}
    noise = relative * np.abs(Y) * np.array([not set(channel.of) <= driven for channel in chosen])
    found = []
    for line, (f, omega) in enumerate(zip(rig.frequency_hz, rig.omega, strict=True)):
        step = periods / f / samples
        time = step * (np.arange(samples) + jitter * rng.uniform(-0.5, 0.5, samples))
        clean = (Y[line] * np.exp(1j * omega * time)[:, None]).real
        values = clean + noise[line] * rng.standard_normal(clean.shape)
        found.append(Record(tuple(chosen), time, values, float(f)))
    return found


# ------------------------------------------------------------------------------------------------ named rigs


CASE_3 = "1 1.5 2 2.25 2.5 2.75 3 3.25 3.5 3.75 4 5 6 7 8 8.5 9 9.5 10 10.5 11 11.5 12 13 14"  # Hz


def paper_rig(frequency_hz: Sequence[float] | None = None) -> Rig:
    """The rig of Yamane (1989), Table 1, k1 and k2 known; by default its CASE 3, u = sin ωt of 1 m."""
    model = network(
        "x1 x2",
        "u",
        "m1@x1 m2@x2 c1:x1-x2 c2:x2-u c3:x1-ground c4:x2-ground k1:x1-x2=4600 k2:x2-u=4600",
        name="Yamane 1989",
    )
    f = np.array(CASE_3.split() if frequency_hz is None else frequency_hz, dtype=float)
    theta = np.array([3.0, 2.7, 30.0, 40.0, 90.0, 50.0])
    return Rig(model, theta, f, np.full((len(f), 1), -1j), np.zeros((len(f), 0), dtype=complex))


def measured(rig: Rig, noise: float = 0.03, seed: int = 1) -> Spectrum:
    """Displacements of all coordinates with noise of this share of each, drawn by this seed."""
    seen = channels(rig)
    return noisy(rig, seen, covariance(rig, seen, noise), np.random.default_rng(seed))
