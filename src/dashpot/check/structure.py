"""What channels say about the unknowns of a rig, to first order, at a random rig and random frequencies, exactly.

y = κ G(θ, s) q with s = jω; what the inputs q explain is taken out line by line.  A line of measured amplitudes and
its conjugate are two points of the field, (s, j) and (−s, −j): the unknowns are real.  The twin in floating point
gives the numbers of a direction whose unknowns the exact one has found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError, ModelError
from dashpot.io.words import listed
from dashpot.model.laws import Law
from dashpot.model.network import Model
from dashpot.model.observation import (
    ObservationModel,
    calibrated_transfer,
    measures_input,
    observation_model,
)
from dashpot.model.typical_values import typical
from dashpot.numerics import finite_field as field
from dashpot.numerics.finite_field import PRIME, ROOT

GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class LinePattern:
    """The lines of a test: which share a frequency, what is measured, what is driven; inputs are (U, f).

    frequency (lines,) numbers the distinct frequencies; present (lines, channels); driven (lines, inputs).  With
    `conjugates`, each is measured amplitudes, which are two points of the field; else each is one point of its own.
    """

    frequency: Ints
    present: Bools
    driven: Bools
    conjugates: bool = True


def generic_lines(model: Model, channels: int, count: int, conjugates: bool = True) -> LinePattern:
    """`count` lines of different frequencies with every channel measured and every input driven."""
    present, driven = np.ones((count, channels), dtype=bool), np.ones((count, len(model.inputs)), dtype=bool)
    return LinePattern(np.arange(count), present, driven, conjugates)


def enough_lines(model: Model, channels: int, unknowns: int) -> LinePattern:
    """Points enough that more add nothing: one equation at each may be all, and undamped rigs know s² alone."""
    hysteretic = any(element.law.hysteretic for element in model.elements)
    return generic_lines(model, channels, (unknowns + 2) * (2 if hysteretic else 1), conjugates=False)


def lines_of(model: Model, spectrum: Spectrum) -> LinePattern:
    """The lines of data: an input is idle where an exact channel of it alone shows 0."""
    finite = np.isfinite(spectrum.amplitudes).reshape(-1, spectrum.lines, len(spectrum.channels))
    present = np.all(finite, axis=0)
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    quiet = np.all(variance.reshape(-1, *present.shape) == 0, axis=0)
    zero = np.all((spectrum.amplitudes == 0).reshape(-1, *present.shape), axis=0)
    driven = np.ones((spectrum.lines, len(model.inputs)), dtype=bool)
    for j, name in enumerate((*model.displacement_inputs, *model.force_inputs)):
        for c, channel in enumerate(spectrum.channels):
            if measures_input(model, channel) and set(channel.of) == {name}:
                driven[:, j] &= ~(present & quiet & zero)[:, c]
    _, frequency = np.unique(spectrum.frequency_hz, return_inverse=True)
    return LinePattern(frequency.astype(np.int64), present, driven)


@dataclass(frozen=True)
class Draw:
    """One random rig: slopes by the unknowns ψ = (θ, gains, delays), inputs taken out, (rows, M); and its ψ, (M,).

    A delay counts as 1 in ψ: only its shifts have a meaning.  Rows of priors are included.
    """

    rows: Ints
    psi: Ints


def view_of(model: Model, channels: Sequence[Channel]) -> ObservationModel:
    """The constants of the channels, at no frequency in particular."""
    return observation_model(model, channels, np.ones(1))


def exact(model: Model, channels: Sequence[Channel], lines: LinePattern, rng: np.random.Generator) -> Draw:
    """Slopes at one random rig; known parameters have their values.

    Raises IdentifiabilityError where the rig has no steady response, whatever its parameters.
    """
    view = view_of(model, channels)
    m, M = view.m, len(view.names)
    psi = rng.integers(1, PRIME, M)
    psi[M - view.delays :] = 1
    times = field.residues([tie.times for tie in model.ties])
    column = np.where(np.any(model.T, axis=1), np.argmax(model.T != 0, axis=1), -1)
    p = np.where(column >= 0, times * psi[column] % PRIME, field.residues(model.p0.tolist()))
    s = rng.integers(1, PRIME, int(np.max(lines.frequency)) + 1)[lines.frequency]
    present, driven = lines.present, lines.driven
    j = np.where(np.arange(len(s)) % 2, PRIME - ROOT, ROOT)
    if lines.conjugates:
        s = np.concatenate([s, PRIME - s])
        j = np.repeat([ROOT, PRIME - ROOT], len(lines.frequency))
        present, driven = np.concatenate([present, present]), np.concatenate([driven, driven])
    law = np.stack([_law_in_field(element.law, s, j) for element in model.elements], axis=-1)
    G, y, J = _channels(model, view, p, law, s, driven, rng)
    by_theta = np.zeros((*y.shape, m), dtype=np.int64)
    for e in np.flatnonzero(column >= 0):
        by_theta[..., column[e]] = (by_theta[..., column[e]] + J[..., e] * times[e]) % PRIME
    slopes = np.concatenate([by_theta, _calibration_slopes(view, psi, s, y)], axis=-1) * present[..., None]
    whole = np.concatenate([G * present[..., None], slopes], axis=-1)
    inputs = G.shape[-1]
    rows = [_priors(model, M)]
    for line in whole:
        reduced, pivots = field.echelon(line, inputs)
        rows.append(reduced[len(pivots) :, inputs:])
    return Draw(np.concatenate(rows), psi)


def _calibration_slopes(view: ObservationModel, psi: Ints, s: Ints, y: Ints) -> Ints:
    """∂y/∂gain = y / gain and ∂y/∂τ = −s y, (lines, channels, gains + delays)."""
    slopes = np.zeros((*y.shape, view.gains + view.delays), dtype=np.int64)
    per_gain = field.inverse(psi[view.m : view.m + view.gains])
    for k in range(view.gains):
        slopes[..., k] = y * (view.gain == k) * int(per_gain[k]) % PRIME
    for k in range(view.delays):
        slopes[..., view.gains + k] = (PRIME - s)[:, None] * y % PRIME * (view.delay == k)
    return slopes


def _law_in_field(law: Law, s: Ints, j: Ints) -> Ints:
    """φ at the points s of the field, j being √−1 there; the shape of s."""
    phi = _to_the_power(s, law.power)
    return phi * j % PRIME if law.hysteretic else phi


def _channels(
    model: Model, view: ObservationModel, p: Ints, law: Ints, s: Ints, driven: Bools, rng: np.random.Generator
) -> tuple[Ints, Ints, Ints]:
    """(G, y = G q, slopes of y by the elements at fixed q) with calibrations 1, which only scale the rows.

    The exact twin of `model.observation.transfer`: p (elements,), law (lines, elements) φ, s (lines,) in place of jω.
    """
    rig = _field_rig(model, p * law % PRIME)
    D, R = rig.stiffness()
    C, G = rig.channels(view, s)
    solved, regular = field.solve(D, np.concatenate([R, np.swapaxes(C, 1, 2)], axis=-1))
    if not np.any(regular):
        raise _unheld(model, D[0])
    solved = solved * regular[:, None, None]
    X, adjoint = solved[..., : R.shape[-1]], solved[..., R.shape[-1] :]
    for i in range(model.n):
        G = (G + C[:, :, i, None] * X[:, None, i, :]) % PRIME
    G = G * regular[:, None, None]
    q = rng.integers(1, PRIME, (len(s), R.shape[-1])) * driven
    x = np.sum(X * q[:, None, :] % PRIME, axis=-1) % PRIME
    y = np.sum(G * q[:, None, :] % PRIME, axis=-1) % PRIME
    J = rig.slopes(view, law, x, q, adjoint)
    return G, y, J * regular[:, None, None]


@dataclass(frozen=True)
class _FieldRig:
    """A rig in the field: elongations of the elements as (coordinate, factor) and (input, factor), and p φ.

    strength (lines, elements); S (n, r + s) how forces act.
    """

    along_x: list[list[tuple[int, int]]]
    along_q: list[list[tuple[int, int]]]
    strength: Ints
    S: Ints

    def stiffness(self) -> tuple[Ints, Ints]:
        """Dynamic stiffness (lines, n, n), and the forces per unit of each input (lines, n, r + s)."""
        n = len(self.S)
        D = np.zeros((len(self.strength), n, n), dtype=np.int64)
        R = np.tile(self.S, (len(self.strength), 1, 1))
        for e, ends in enumerate(self.along_x):
            for i, b in ends:
                pull = self.strength[:, e] * b % PRIME
                for k, other in ends:
                    D[:, i, k] = (D[:, i, k] + pull * other) % PRIME
                for k, other in self.along_q[e]:
                    R[:, i, k] = (R[:, i, k] - pull * other) % PRIME
        return D, R

    def channels(self, view: ObservationModel, s: Ints) -> tuple[Ints, Ints]:
        """What the channels show of coordinates (lines, channels, n), and of inputs (lines, channels, r + s)."""
        n, inputs = self.S.shape
        C = np.zeros((len(s), len(view.channels), n), dtype=np.int64)
        G = np.zeros((len(s), len(view.channels), inputs), dtype=np.int64)
        for c, e in np.argwhere(view.force):
            push = self.strength[:, e] * field.residue(view.force[c, e]) % PRIME
            for i, b in self.along_x[e]:
                C[:, c, i] = (C[:, c, i] + push * b) % PRIME
            for k, d in self.along_q[e]:
                G[:, c, k] = (G[:, c, k] + push * d) % PRIME
        for target, on in ((C, view.on_x), (G, view.on_q)):
            for c, i in np.argwhere(on):
                rate = _to_the_power(s, int(view.derivative[c]))
                target[:, c, i] = (target[:, c, i] + rate * field.residue(on[c, i])) % PRIME
        return C, G

    def slopes(self, view: ObservationModel, law: Ints, x: Ints, q: Ints, adjoint: Ints) -> Ints:
        """∂y/∂p at fixed q, (lines, channels, elements).

        x (lines, n), q (lines, r + s), adjoint (lines, n, channels).
        """
        J = np.zeros((len(x), adjoint.shape[-1], law.shape[1]), dtype=np.int64)
        for e in range(law.shape[1]):
            elongation = np.zeros(len(x), dtype=np.int64)
            effect = np.zeros((len(x), adjoint.shape[-1]), dtype=np.int64)
            for i, b in self.along_x[e]:
                elongation = (elongation + b * x[:, i]) % PRIME
                effect = (effect - b * adjoint[:, i, :]) % PRIME
            for k, d in self.along_q[e]:
                elongation = (elongation + d * q[:, k]) % PRIME
            for c in np.flatnonzero(view.force[:, e]):
                effect[:, c] = (effect[:, c] + field.residue(view.force[c, e])) % PRIME
            J[:, :, e] = effect * (law[:, e] * elongation % PRIME)[:, None] % PRIME
        return J


def _field_rig(model: Model, strength: Ints) -> _FieldRig:
    x = {name: i for i, name in enumerate(model.coordinates)}
    moved = {name: i for i, name in enumerate(model.displacement_inputs)}
    along = [_proportions(element.along) for element in model.elements]
    S = np.zeros((model.n, len(model.inputs)), dtype=np.int64)
    for i, k in np.argwhere(model.S):
        S[i, len(moved) + k] = field.residue(model.S[i, k])
    return _FieldRig(
        [[(x[point], b) for point, b in ends.items() if point in x] for ends in along],
        [[(moved[point], d) for point, d in ends.items() if point in moved] for ends in along],
        strength,
        S,
    )


def _to_the_power(s: Ints, power: int) -> Ints:
    result = np.ones_like(s)
    for _ in range(power):
        result = result * s % PRIME
    return result


def _proportions(along: Mapping[str, float]) -> dict[str, int]:
    """Factors modulo PRIME; their ratios count to twelve digits, for rounding must not tell levers apart."""
    if not along:
        return {}
    first = min(along)
    lead = field.residue(along[first])
    return {
        point: lead * field.residue(float(f"{factor / along[first]:.12g}")) % PRIME
        for point, factor in along.items()
    }


def _priors(model: Model, columns: int) -> Ints:
    known = np.flatnonzero(model.prior_precision)
    rows = np.zeros((len(known), columns), dtype=np.int64)
    rows[np.arange(len(known)), known] = 1
    return rows


def _unheld(model: Model, D: Ints) -> IdentifiabilityError:
    loose = np.flatnonzero(np.any(field.null_space(D) != 0, axis=0))
    names = listed(model.coordinates[i] for i in loose)
    return IdentifiabilityError(
        f"the rig has no steady response: {names} can move with no force at all, whatever the parameters",
        cure="attach another mass, spring or damper there, or remove a coordinate",
    )


# The same in floating point


def nominal(model: Model, channels: Sequence[Channel]) -> tuple[Real, float]:
    """(ψ, typical ω): near priors and guesses where there are any, near what known values suggest elsewhere; delays 0.

    No two alike: symmetry would hide directions that other values have, or show more than there are.
    """
    view = view_of(model, channels)
    size, rate = typical(model)
    values = []
    kinds = {element.name: element.kind for element in model.elements}
    for unknown in model.unknowns:
        choices = (unknown.prior, unknown.guess)
        given = next((v for v in choices if v is not None and v != 0), None)
        values.append(size[kinds[unknown.name]] if given is None else given)
    values += [1.0] * view.gains
    apart = 0.8 + 0.45 * np.modf(np.arange(1, len(values) + 1) * GOLDEN)[0]
    return np.array([*(np.array(values) * apart), *[0.0] * view.delays]), rate


def floating(
    model: Model,
    channels: Sequence[Channel],
    lines: LinePattern,
    psi: Real,
    rate: float,
    rng: np.random.Generator,
) -> Real:
    """The rows of `exact` at ψ, real, each channel of size 1; frequencies around `rate` (rad/s) and inputs at random.

    Columns are slopes by ψ itself.  psi (M,).  Raises ModelError where sizes are too far apart for floating point.
    """
    distinct = int(np.max(lines.frequency)) + 1
    grid = rate * np.geomspace(0.25, 3.0, distinct) * np.exp(rng.uniform(-0.05, 0.05, distinct))
    omega = grid[lines.frequency]
    shape = lines.driven.shape
    q = np.exp(rng.uniform(-0.5, 0.5, shape) + 2j * np.pi * rng.random(shape)) * lines.driven
    view = observation_model(model, channels, omega)
    rig = calibrated_transfer(view, psi, np.ones(len(channels)))
    G, y, J = rig.G, rig.amplitudes(q), rig.slopes(q)
    level = np.maximum(np.abs(y), 1e-6 * np.max(np.abs(y), axis=0, initial=0.0))
    level = np.where(lines.present, np.where(level > 0, level, 1.0), np.inf)
    G, J = G / level[..., None], J / level[..., None]
    rows = [np.diag(np.where(psi == 0, 1.0, 1 / np.where(psi == 0, 1.0, psi)))[: len(model.unknowns)][
        model.prior_precision > 0
    ]]  # fmt: skip
    for g, by_psi in zip(G, J, strict=True):
        size = np.linalg.norm(g, axis=0)
        g = g / np.where(size > 0, size, 1.0)
        if not np.all(np.isfinite(g)):
            raise ModelError(
                "the rig's numbers differ too much in size for floating point",
                cure="check units and sizes of the values",
            )
        u, s, _ = np.linalg.svd(g, full_matrices=False)
        u = u[:, s > 1e-10 * max(float(s[0]) if s.size else 0.0, 1e-300)]
        by_psi = by_psi - u @ (u.conj().T @ by_psi)
        rows += [by_psi.real, by_psi.imag]
    return np.concatenate(rows)
