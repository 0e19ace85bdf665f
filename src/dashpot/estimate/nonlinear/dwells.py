"""Lines of a spectrum as harmonics of dwells, and the motion that was measured at them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real, frozen
from dashpot.data.spectrum import SettledDwell, Spectrum, WholeRecord
from dashpot.errors import DataError
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.network import Model
from dashpot.model.nonlinear.harmonics import Drive, real_of

REACH = 0.3  # of the elongations, by which slopes may move them
FEWEST = {True: 7, False: 15}  # harmonics to begin with, of laws that are smooth and that are not


Predicted = tuple[Complex, Complex, Complex, Complex, Complex, Real]  # as a Prediction of the likelihood


@dataclass(frozen=True)
class DwellLines:
    """How lines belong to dwells.

    omega (dwells,) fundamentals, rad/s; dwell, order, slot (lines,): the dwell of a line, the multiple of its
    fundamental, and its place among the dwell's lines; slots: lines of the dwell that has most; orders: harmonics H
    of the response.
    """

    omega: Real
    dwell: Ints
    order: Ints
    slot: Ints
    slots: int
    orders: int

    def with_orders(self, orders: int) -> DwellLines:
        """The same lines with another number of harmonics in the response."""
        return replace(self, orders=orders)

    def drive(self, q: Complex, r: int) -> Drive:
        """What drives all dwells of K repeats one after another, for the inputs' lines q (K, lines, r + s)."""
        repeats = len(q)
        harmonics = np.zeros((repeats, len(self.omega), self.orders + 1, q.shape[-1]), dtype=np.complex128)
        harmonics[:, self.dwell, self.order] = q
        flat = harmonics.reshape(-1, *harmonics.shape[2:])
        return Drive(np.tile(self.omega, repeats), flat[..., :r], flat[..., r:])

    def input_directions(self, inputs: int) -> Complex:
        """Real unit changes of the inputs' lines, (dwells, H + 1, inputs, Q), Q = 2 · inputs · slots."""
        along = np.zeros(
            (len(self.omega), self.orders + 1, inputs, self.slots, inputs, 2), dtype=np.complex128
        )
        for i in range(inputs):
            along[self.dwell, self.order, i, self.slot, i] = [1.0, 1j]
        return along.reshape(len(self.omega), self.orders + 1, inputs, -1)

    def lines(self, harmonics: Complex, repeats: int) -> Complex:
        """Lines (K, lines, …) out of harmonics (K · dwells, H + 1, …)."""
        apart = harmonics.reshape(repeats, len(self.omega), *harmonics.shape[1:])
        return apart[:, self.dwell, self.order]

    def by_dwell(self, lines: Real) -> Real:
        """Sums over the lines of each dwell: (K, lines, …) → (K, dwells, …)."""
        total = np.zeros((len(lines), len(self.omega), *lines.shape[2:]), dtype=lines.dtype)
        for slot in range(self.slots):
            at = np.flatnonzero(self.slot == slot)
            total[:, self.dwell[at]] += lines[:, at]
        return total


def dwells_of(model: Model, spectrum: Spectrum) -> DwellLines:
    """The dwells that the lines of a spectrum belong to.

    Raises DataError where lines are of a whole record, or a line is not a multiple of its dwell's fundamental.
    """
    if any(isinstance(shared, WholeRecord) for shared in spectrum.stretches):
        raise DataError(
            "a nonlinear element needs the samples of a whole record, not its lines",
            cure="give the record itself, or settled dwells with their harmonics",
        )
    groups: dict[tuple[int, int], int] = {}
    dwell, order, fundamental = [], [], []
    for line, number in enumerate(spectrum.stretch.tolist()):
        shared = spectrum.stretches[number]
        assert isinstance(shared, SettledDwell)
        base = shared.fundamental_hz
        key = (number, -1) if base is not None else (number, line)
        if key not in groups:
            groups[key] = len(groups)
            fundamental.append(float(spectrum.frequency_hz[line]) if base is None else base)
        multiple = 1 if base is None else float(spectrum.frequency_hz[line]) / base
        if abs(multiple - round(multiple)) > 1e-6 * max(multiple, 1) or round(multiple) < 1:
            raise DataError(
                f"{spectrum.frequency_hz[line]:g} Hz is not a multiple of the {base:g} Hz of its dwell",
                cure="give each dwell its own frequency",
            )
        dwell.append(groups[key])
        order.append(round(multiple))
    taken: dict[int, int] = {}
    slot = []
    for group in dwell:
        slot.append(taken.get(group, 0))
        taken[group] = slot[-1] + 1
    smooth = all(e.force_law is None or e.force_law.smooth for e in model.elements)
    highest = max(order, default=1)
    return DwellLines(
        frozen(2 * np.pi * np.array(fundamental), np.float64), frozen(dwell, np.int64), frozen(order, np.int64),
        frozen(slot, np.int64), max(taken.values(), default=1), max(FEWEST[smooth], 2 * highest + 1),
    )  # fmt: skip


def measured_elongations(model: Model, dwells: DwellLines, states: States) -> Real:
    """Elongations of the nonlinear elements as measured, (K, dwells, e, W); 0 at harmonics that were not measured."""
    chosen = model.nonlinear
    lines = states.X @ model.B[chosen].T + states.U @ model.D[chosen].T
    harmonics = np.zeros((len(lines), len(dwells.omega), dwells.orders + 1, len(chosen)), dtype=np.complex128)
    harmonics[:, dwells.dwell, dwells.order] = lines
    return real_of(np.moveaxis(harmonics, 2, -1))


@dataclass
class WarmStart:
    """The last responses of each repeat, from which the next ones start: they stay on their branch.

    along: θ of a response and the slopes of its elongations there, (dwells, e, W, unknowns).  latest: the last
    prediction of a single repeat, (which, and what was predicted): searches come back to their ends.
    """

    delta: dict[int, Real] = field(default_factory=dict)
    inputs: dict[int, Complex] = field(default_factory=dict)
    cost: dict[int, float] = field(default_factory=dict)
    along: dict[int, tuple[Real, Real]] = field(default_factory=dict)
    latest: tuple[bytes, Predicted] | None = None

    def take(self, other: WarmStart, repeat: int) -> None:
        """The last response of a repeat from another one's memory in place of its own."""
        self.delta[repeat], self.inputs[repeat] = other.delta[repeat], other.inputs[repeat]
        self.cost[repeat], self.along[repeat] = other.cost[repeat], other.along[repeat]
        self.latest = None

    def near(self, repeat: int, theta: Real) -> Real:
        """Elongations (dwells, e, W) to start from at θ (unknowns,): the last ones, moved along their slopes.

        Not those of dwells that would move far: slopes say nothing of that.
        """
        delta = self.delta[repeat]
        if repeat not in self.along:
            return delta
        at, slope = self.along[repeat]
        size = np.max(np.abs(delta), axis=(1, 2), keepdims=True)
        with np.errstate(invalid="ignore"):
            change = slope @ (theta - at)
            close = np.max(np.abs(change), axis=(1, 2), keepdims=True) <= REACH * size
        return np.where(close, delta + change, delta)
