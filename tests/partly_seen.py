# ruff: noqa: E501
"""Rigs that are seen in part, for tests of maximum likelihood: what their channels show, noise, and the bound by brute force.

Everything here is computed from `study.simulate` and finite differences, nothing from the code under test.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.study.simulate import Dwells, clean_amplitudes
from tests import rigs

A, F = Quantity.ACCELERATION, Quantity.FORCE
K, C, M = Kind.SPRING, Kind.DAMPER, Kind.MASS


def _values(text: str) -> dict[str, float]:
    """Numbers by name."""
    return {name: float(value) for name, value in (word.split("=") for word in text.split())}


@dataclass(frozen=True)
class Bench:
    """A rig with its truth and a test of it: channels with their noise relative to what they show, and calibrations.

    `noise` by channel name (0: exact), "" for all others; `gains`, `delays`, `signs` are what the channels truly have.
    U (lines, r) in m, f (lines, s) in N.
    """

    name: str
    model: Model
    truth: Mapping[str, float]
    channels: tuple[Channel, ...]
    frequency_hz: Real
    U: Complex
    f: Complex
    noise: Mapping[str, float] = field(default_factory=lambda: {"": 0.01})
    gains: Mapping[str, float] = field(default_factory=dict)
    delays: Mapping[str, float] = field(default_factory=dict)
    signs: Mapping[str, float] = field(default_factory=dict)

    @property
    def lines(self) -> int:
        return len(self.frequency_hz)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns, as an Estimate has them."""
        return (
            *(unknown.name for unknown in self.model.unknowns),
            *(f"{name}.gain" for name in self.gains),
            *(f"{name}.delay" for name in self.delays),
        )

    @property
    def psi(self) -> Real:
        """True unknowns: of the rig, gains, delays."""
        rig = [self.truth[unknown.name] for unknown in self.model.unknowns]
        return np.array([*rig, *self.gains.values(), *self.delays.values()])

    @property
    def q(self) -> Complex:
        """True inputs, (lines, r + s)."""
        return np.concatenate([self.U, self.f], axis=-1)

    def shown(self, psi: Real, q: Complex | None = None) -> Complex:
        """What the channels show without noise, (lines, channels)."""
        U, f = (self.U, self.f) if q is None else np.split(q, [self.U.shape[-1]], axis=-1)
        m, count = len(self.model.unknowns), len(self.gains)
        ones = np.ones(self.lines)
        test = Dwells(self.frequency_hz, ones, ones, U, f)
        Y = clean_amplitudes(self.model, self.model.parameters(psi[:m]), self.channels, test)
        gains = dict(zip(self.gains, psi[m : m + count], strict=True))
        delays = dict(zip(self.delays, psi[m + count :], strict=True))
        names = [channel.name for channel in self.channels]
        kappa = np.array([gains.get(name, 1.0) * self.signs.get(name, 1.0) for name in names])
        late = np.array([delays.get(name, 0.0) for name in names])
        return Y * kappa * np.exp(-1j * test.omega[:, None] * late)

    def covariance(self, correlation: float = 0.0) -> Complex:
        """V (lines, channels, channels): half of each channel's noise follows its amplitude, half is even.

        Noisy channels have one correlation coefficient, turned by phases that differ from pair to pair.
        """
        Y = np.abs(self.shown(self.psi))
        level = np.array([self.noise.get(channel.name, self.noise[""]) for channel in self.channels])
        sd = level * (0.5 * Y + 0.5 * np.sqrt(np.mean(Y**2, axis=0)))
        turn = np.exp(1j * np.arange(len(self.channels)))
        R = correlation * np.outer(turn, turn.conj())
        np.fill_diagonal(R, 1.0)
        return sd[:, :, None] * R * sd[:, None, :]

    def spectrum(
        self, rng: np.random.Generator | None = None, draws: int | None = None, correlation: float = 0.0
    ) -> Spectrum:
        """The test's spectrum, which states its noise; without `rng` the noise is absent."""
        V = self.covariance(correlation)
        Y = self.shown(self.psi)
        if rng is not None:
            Y = Y + rigs.complex_noise(rng, V, draws)
        return rigs.stated(self.channels, self.frequency_hz, Y, V)

    def slopes(self, step: float = 1e-5) -> Complex:
        """∂(what is shown)/∂ψ by central differences with Richardson's correction, (lines, channels, unknowns)."""
        columns = []
        for j, value in enumerate(self.psi):
            size = abs(value) if value else 1e-3
            rough, fine = (self._difference(j, h * size) for h in (2 * step, step))
            columns.append((4 * fine - rough) / 3)
        return np.stack(columns, axis=-1)

    def _difference(self, j: int, h: float) -> Complex:
        up, down = self.psi, self.psi
        up[j], down[j] = up[j] + h, down[j] - h
        return (self.shown(up) - self.shown(down)) / (2 * h)

    def information(self, correlation: float = 0.0) -> Real:
        """Fisher information of ψ, (unknowns, unknowns): inputs that are measured with noise are unknowns as well.

        The inputs' real and imaginary parts at each line are written out as unknowns and eliminated by Schur.
        """
        V, J = self.covariance(correlation), self.slopes()
        noisy = [c for c, channel in enumerate(self.channels) if self.noise.get(channel.name, self.noise[""])]
        W = np.linalg.inv(V[:, noisy][:, :, noisy])
        J = J[:, noisy]
        inputs = {*self.model.displacement_inputs, *self.model.force_inputs}
        loose = any(set(self.channels[c].of) <= inputs and self.channels[c].name in inputs for c in noisy)
        count = self.q.shape[-1] if loose else 0
        total = np.zeros((J.shape[-1], J.shape[-1]))
        per_input = [
            self.shown(self.psi, np.broadcast_to(np.eye(self.q.shape[-1])[i].astype(complex), self.q.shape))[
                :, noisy
            ]
            for i in range(count)
        ]
        for line in range(self.lines):
            nuisance = [factor * column[line] for column in per_input for factor in (1, 1j)]
            G = np.stack([*J[line].T, *nuisance], axis=-1)
            own = 2 * (G.conj().T @ W[line] @ G).real
            k = J.shape[-1]
            total += own[:k, :k]
            if nuisance:
                total -= own[:k, k:] @ np.linalg.solve(own[k:, k:], own[k:, :k])
        return total

    def bound_sd(self) -> Real:
        """Standard deviations at the Cramér-Rao bound, at the truth, priors not counted; (unknowns,)."""
        information = self.information()
        scale = 1 / np.sqrt(np.diag(information))
        covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        return np.sqrt(np.diag(covariance))


def _model(
    coordinates: str,
    inputs: tuple[Input, ...],
    elements: list[Element],
    values: Mapping[str, float],
    known: str = "",
) -> Model:
    given = [
        replace(element, value=values[element.name]) if element.name in known.split() else element
        for element in elements
    ]
    return Model(tuple(coordinates.split()), inputs, tuple(given))


def _still(frequency_hz: Real) -> Complex:
    return np.zeros((len(frequency_hz), 0), dtype=complex)


def _even(frequency_hz: Real, size: float = 1.0) -> Complex:
    return np.full((len(frequency_hz), 1), size, dtype=complex)


def third_of_six() -> Bench:
    """Six masses of 0.6 to 5 kg in a chain on a shaken base, accelerometers on two of them."""
    values = {
        "m1": 5.0, "m2": 0.8, "m3": 2.5, "m4": 0.6, "m5": 1.4, "m6": 3.0,
        "k1": 9000.0, "k2": 3000.0, "k3": 12000.0, "k4": 1600.0, "k5": 5000.0, "k6": 2400.0, "c1": 25.0, "c2": 4.0, "c3": 9.0,
    }  # fmt: skip
    points = ["u", "x1", "x2", "x3", "x4", "x5", "x6"]
    elements = [mass(f"m{i}", f"x{i}") for i in range(1, 7)]
    elements += [between(f"k{i}", K, points[i - 1], points[i]) for i in range(1, 7)]
    elements += [between("c1", C, "u", "x1"), between("c2", C, "x1", "x2"), between("c3", C, "x2", "x3")]
    elements += [between(f"c{i}", C, points[i - 1], points[i], same_as="c2") for i in (4, 5, 6)]
    f = np.geomspace(1.2, 24, 25)
    channels = (Channel("a2", {"x2": 1}, A), Channel("a5", {"x5": 1}, A), Channel("u", {"u": 1}))
    model = _model("x1 x2 x3 x4 x5 x6", (Input("u"),), elements, values, "k1")
    return Bench(
        "a third of six", model, values, channels, f, _even(f, 0.01), _still(f), {"": 0.003, "u": 0.0}
    )


def force_at_one_point() -> Bench:
    """Five masses on a branched frame, lightly damped, pushed at one point; accelerometers there and at two ends."""
    values = {
        "m1": 1.0, "m2": 8.0, "m3": 2.0, "m4": 0.8, "m5": 3.0,
        "k1": 30000.0, "k2": 8000.0, "k3": 20000.0, "k4": 4000.0, "k5": 9000.0, "k6": 3000.0, "c1": 15.0, "c3": 12.0, "c5": 2.5, "c6": 40.0,
    }  # fmt: skip
    elements = [mass(f"m{i}", f"x{i}") for i in range(1, 6)]
    joints = {
        "k1": "x1 ground",
        "k2": "x1 x2",
        "k3": "x2 x3",
        "k4": "x2 x4",
        "k5": "x4 x5",
        "k6": "x3 ground",
    }
    elements += [between(name, K, *ends.split()) for name, ends in joints.items()]
    joints = {"c1": "x1 ground", "c3": "x2 x3", "c5": "x4 x5", "c6": "x3 ground"}
    elements += [between(name, C, *ends.split()) for name, ends in joints.items()]
    f = np.geomspace(2, 34, 22)
    channels = (
        Channel("a2", {"x2": 1}, A), Channel("a3", {"x3": 1}, A), Channel("a5", {"x5": 1}, A), Channel("p", {"p": 1}, F),
    )  # fmt: skip
    model = _model("x1 x2 x3 x4 x5", (Input("p", "force", {"x2": 1.0}),), elements, values)
    return Bench(
        "force at one point", model, values, channels, f, _still(f), _even(f, 20.0), {"": 0.003, "p": 0.0}
    )


def noisy_base() -> Bench:
    """Four masses on a base whose motion is measured with noise, by an accelerometer like those on two of the masses."""
    values = _values("m1=2 m2=0.5 m3=4 m4=1 k1=5000 k2=2500 k3=9000 k4=1500 c1=30 c2=2 c3=14 c4=5")
    points = ["u", "x1", "x2", "x3", "x4"]
    elements = [mass(f"m{i}", f"x{i}") for i in range(1, 5)]
    elements += [between(f"k{i}", K, points[i - 1], points[i]) for i in range(1, 5)]
    elements += [between(f"c{i}", C, points[i - 1], points[i]) for i in range(1, 5)]
    f = np.geomspace(1.5, 20, 22)
    channels = (
        Channel("a2", {"x2": 1}, A), Channel("a4", {"x4": 1}, A), Channel("gap", {"x3": 1, "x1": -1}),
        Channel("u", {"u": 1}, A),
    )  # fmt: skip
    model = _model("x1 x2 x3 x4", (Input("u"),), elements, values, "m1")
    return Bench("noisy base", model, values, channels, f, _even(f, 0.01), _still(f), {"": 0.005})


def reaction() -> Bench:
    """Three masses on a base, nothing known: the force that moves the base is measured, and two accelerations."""
    values = _values("m1=0.7 m2=6 m3=1.5 k1=12000 k2=2500 k3=6000 c1=5 c2=45 c3=3 c4=8")
    points = ["u", "x1", "x2", "x3"]
    elements = [mass(f"m{i}", f"x{i}") for i in range(1, 4)]
    elements += [between(f"k{i}", K, points[i - 1], points[i]) for i in range(1, 4)]
    elements += [between(f"c{i}", C, points[i - 1], points[i]) for i in range(1, 4)]
    elements.append(between("c4", C, "x2", "ground"))
    f = np.geomspace(1.5, 28, 20)
    channels = (
        Channel("a1", {"x1": 1}, A), Channel("a3", {"x3": 1}, A), Channel("R", {"u": 1}, F), Channel("u", {"u": 1}),
    )  # fmt: skip
    model = _model("x1 x2 x3", (Input("u"),), elements, values)
    return Bench(
        "reaction force", model, values, channels, f, _even(f, 0.01), _still(f), {"": 0.02, "u": 0.0}
    )


def pitch_and_bounce() -> Bench:
    """A body on two axles: bounce, pitch and both wheels, two roads of one profile, the rear one later."""
    values = _values("mb=1200 J=1500 mf=60 mr=110 kf=18000 kr=42000 cf=900 cr=3200 tf=160000 tr=220000")
    front, rear = {"z": 1.0, "phi": -1.1}, {"z": 1.0, "phi": 1.6}
    elements = [
        mass("mb", "z"), mass("J", "phi"), mass("mf", "yf"), mass("mr", "yr"),
        Element("kf", K, {**front, "yf": -1.0}), Element("kr", K, {**rear, "yr": -1.0}),
        Element("cf", C, {**front, "yf": -1.0}), Element("cr", C, {**rear, "yr": -1.0}),
        between("tf", K, "yf", "uf"), between("tr", K, "yr", "ur"),
    ]  # fmt: skip
    f = np.geomspace(0.5, 18, 20)
    channels = (
        Channel("af", front, A), Channel("ar", rear, A), Channel("wf", {"yf": 1}, A),
        Channel("uf", {"uf": 1}), Channel("ur", {"ur": 1}),
    )  # fmt: skip
    inputs = (Input("uf"), Input("ur"))
    given = [replace(e, value=values[e.name]) if e.name == "tf" else e for e in elements]
    model = Model(("z", "phi", "yf", "yr"), inputs, tuple(given), angles=frozenset({"phi"}))
    U = 0.01 * np.stack([np.ones(len(f)), np.exp(-2j * np.pi * f * 0.13)], axis=-1)
    return Bench(
        "pitch and bounce", model, values, channels, f, U, _still(f), {"": 0.02, "uf": 0.0, "ur": 0.0}
    )


def calibrations() -> Bench:
    """Three masses on a base; one channel's gain, another's delay and a third's sign are unknown."""
    values = _values("m1=4 m2=0.6 m3=1.5 k1=2500 k2=6000 k3=900 c1=20 c2=3 c3=6")
    points = ["u", "x1", "x2", "x3"]
    elements = [mass(f"m{i}", f"x{i}") for i in range(1, 4)]
    elements += [between(f"k{i}", K, points[i - 1], points[i]) for i in range(1, 4)]
    elements += [between(f"c{i}", C, points[i - 1], points[i]) for i in range(1, 4)]
    f = np.geomspace(1, 20, 20)
    channels = (
        Channel("a3", {"x3": 1}, A, gain=None), Channel("a1", {"x1": 1}, A, delay=None),
        Channel("x2", {"x2": 1}, sign=None), Channel("u", {"u": 1}),
    )  # fmt: skip
    model = _model("x1 x2 x3", (Input("u"),), elements, values, "k2")
    return Bench(
        "gain, delay and sign", model, values, channels, f, _even(f, 0.01), _still(f), {"": 0.01, "u": 0.0},
        gains={"a3": 1.7}, delays={"a1": 0.002}, signs={"x2": -1.0},
    )  # fmt: skip


def two(
    c3: float = 4.0, noise: float = 0.02, full: bool = False, known: str = "k1", **limits: float | None
) -> Bench:
    """Two masses on a shaken base with two dampers to ground, seen at one point twice over; c3 may have limits."""
    values = {"m1": 2.0, "m2": 1.0, "k1": 4000.0, "k2": 3000.0, "c1": 20.0, "c2": 8.0, "c3": c3, "c4": 10.0}
    elements = [
        mass("m1", "x1"), mass("m2", "x2"),
        between("k1", K, "u", "x1"), between("k2", K, "x1", "x2"),
        between("c1", C, "u", "x1"), between("c2", C, "x1", "x2"),
        between("c3", C, "x1", "ground", **limits), between("c4", C, "x2", "ground"),
    ]  # fmt: skip
    elements = [replace(e, value=values[e.name]) if e.name in known.split() else e for e in elements]
    f = np.geomspace(2, 16, 14)
    channels = (Channel("a1", {"x1": 1}, A), Channel("x2", {"x2": 1}), Channel("u", {"u": 1}))
    if full:
        channels = (Channel("x1", {"x1": 1}), *channels[1:])
    model = Model(("x1", "x2"), (Input("u"),), tuple(elements))
    U, none = np.full((14, 1), 0.01 + 0j), np.zeros((14, 0), dtype=complex)
    return Bench("two", model, values, channels, f, U, none, {"": noise, "u": 0.0})


BENCHES = (third_of_six, force_at_one_point, noisy_base, reaction, pitch_and_bounce, calibrations)
