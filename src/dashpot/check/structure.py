"""What channels say about the unknowns of a rig, to first order, at a random rig and random frequencies, exactly.

y = κ G(θ, s) q with s = jω; what the inputs q explain is taken out line by line.  A rig without inputs moves because
it was let go: q = a + s b is then an impulse and a doublet at each coordinate (THEORY §8, W), the same for all lines,
and what these explain is taken out of all lines together.  A line of measured amplitudes and
its conjugate are two points of the field, (s, j) and (−s, −j): the unknowns are real.  The twin in floating point
gives the numbers of a direction whose unknowns the exact one has found.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real
from dashpot.channel import RUNS, Channel, Quantity, channels_of, kind_of
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError, ModelError, Problem
from dashpot.estimate.method import Method
from dashpot.io.words import listed, with_values
from dashpot.model.modes import typical_sizes
from dashpot.model.network import Model, pushed_everywhere
from dashpot.model.observation import (
    ObservationModel,
    calibrated_transfer,
    is_direct,
    measures_input,
    observation_model,
)
from dashpot.numerics import finite_field as field
from dashpot.numerics.finite_field import PRIME, ROOT

# Whether anything fixes the size of the forces.
#
# With displacement inputs alone, (E) reads Bᵀ (p ∘ a) = 0: p and 2p move alike. One known parameter other
# than 0, one applied force, or one measured force sets the scale; of parts that share no coordinate and no
# tie, each needs its own.


def free_scales(model: Model, channels: Sequence[Channel]) -> tuple[tuple[str, ...], ...]:
    """Groups of unknowns whose common scale nothing fixes, whatever the data; () where all is fixed.

    A known value of 0 fixes nothing, a value with an sd does.  A force that is applied or measured counts only where
    a channel of known gain measures it.  Necessary, not sufficient, for identifiability.
    """
    parts = _parts(model)
    fixed = set()
    for i, element in enumerate(model.elements):
        root = model.elements[model.ties[i].root]
        if root.value is not None and root.value != 0:
            fixed.add(parts[("element", element.name)])
    # Names of the force inputs, displacement inputs and elements whose force a channel of known gain measures
    measured_forces = {
        name
        for channel in channels
        if channel.quantity is Quantity.FORCE and channel.gain is not None
        for name in channel.of
    }
    # What a force acts on: the coordinates of an applied one, an element, the elements at an input
    applied = {given.name: given.at for given in model.inputs if given.kind == "force"}
    for name in measured_forces:
        touching = [("element", e.name) for e in model.elements if e.name == name or name in e.along]
        ends = [("point", x) for x in applied[name]] if name in applied else touching
        fixed |= {parts[end] for end in ends}
    groups: dict[int, list[str]] = {}
    inner = {f"{element.name}.{constant.name}" for element, constant in model.constants}
    for unknown in model.unknowns:
        if unknown.name in inner:
            continue  # constants of a law do not scale its force
        part = parts[("element", unknown.name)]
        if part not in fixed:
            groups.setdefault(part, []).append(unknown.name)
    return tuple(tuple(group) for group in groups.values())


def require_scale(model: Model, channels: Sequence[Channel], where: str | None = None) -> None:
    """Raises IdentifiabilityError if some forces scale together, one problem for each part of the rig."""
    groups = free_scales(model, channels)
    if not groups:
        return
    whole = len(groups) == 1 and len(groups[0]) == len(model.unknowns)
    problems = []
    for group in groups:
        if len(group) == 1:
            what = (
                f"any value of {group[0]} gives the same motion: there is no known force to compare it with"
            )
        elif whole:
            what = (
                "no mass, stiffness or force is "
                f"known{' and the drive is a displacement' if model.inputs else ''}, so the scale of the forces "
                f"is not fixed: {listed(group)} times any factor give the same motion"
            )
        else:
            what = f"the forces of {listed(group)} scale together: times any factor they give the same motion"
        cure = f"{with_values(group)}, or measure a force (such as the one that moves an input)"
        problems.append(Problem(what, where, cure))
    raise IdentifiabilityError(problems)


Node = tuple[str, str]


def require_scale_seen(
    method: type[Method], model: Model, channels: Sequence[Channel], where: str | None = None
) -> None:
    """Raises IdentifiabilityError if the channels that the method uses leave the scale of the forces free."""
    if method.traits.by_output:
        return
    if free_scales(model, [channel for channel in channels if is_direct(model, channel)]):
        raise IdentifiabilityError(
            f"the method {method.name} does not use the channel that fixes the scale of the forces",
            where,
            "use the method ml",
        )


def _parts(model: Model) -> dict[Node, int]:
    """Which connected part each coordinate and element belongs to; inputs do not connect, for they are prescribed."""
    leader: dict[Node, Node] = {}

    def find(node: Node) -> Node:
        leader.setdefault(node, node)
        while leader[node] != node:
            leader[node] = leader[leader[node]]
            node = leader[node]
        return node

    coordinates = set(model.coordinates)
    for element in model.elements:
        node = ("element", element.name)
        find(node)
        for point in element.along:
            if point in coordinates:
                leader[find(("point", point))] = find(node)
        if element.same_as is not None:
            leader[find(("element", element.same_as))] = find(node)
    for given in model.inputs:
        for first, second in zip(list(given.at), list(given.at)[1:], strict=False):
            leader[find(("point", first))] = find(("point", second))
    number: dict[Node, int] = {}
    return {node: number.setdefault(find(node), len(number)) for node in list(leader)}


def spaced(count: int, least: float, most: float) -> Real:
    """Numbers (count,) between two, no two alike however many there are: steps of the golden section."""
    return least + (most - least) * np.modf(np.arange(1, count + 1) * (np.sqrt(5) - 1) / 2)[0]


@dataclass(frozen=True, eq=False)
class LinePattern(Frozen):
    """The lines of a test: which share a frequency, what is measured, what is driven; inputs are (U, f).

    frequency (lines,) numbers the distinct frequencies; present (lines, channels); driven (lines, inputs); experiment
    (lines,) in which one each was measured, of a rig that differs by experiment.  With `conjugates`, each is measured
    amplitudes, which are two points of the field; else each is one point of its own.
    Patterns of the same numbers are equal, and serve as keys.
    """

    frequency: Ints
    present: Bools
    driven: Bools
    conjugates: bool = True
    experiment: Ints | None = None

    @cached_property
    def _numbers(self) -> tuple[object, ...]:
        arrays = [self.frequency, self.present, self.driven]
        arrays += [] if self.experiment is None else [self.experiment]
        return (self.conjugates, *((array.shape, array.tobytes()) for array in arrays))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LinePattern) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def kinds(self) -> list[int]:
        """Numbers of the experiments that lines are of, 0 of none."""
        return [0] if self.experiment is None else np.unique(kind_of(self.experiment)).tolist()

    def spread(self, count: int) -> LinePattern:
        """`count` of the lines at the most, evenly spread over them."""
        some = np.unique(np.linspace(0, len(self.frequency) - 1, count).astype(int))
        frequency = np.unique(self.frequency[some], return_inverse=True)[1]
        experiment = None if self.experiment is None else self.experiment[some]
        return LinePattern(frequency, self.present[some], self.driven[some], self.conjugates, experiment)

    def __add__(self, other: LinePattern) -> LinePattern:
        """These lines and others, at frequencies of their own."""
        here, there = self.experiment, other.experiment
        return LinePattern(
            np.concatenate([self.frequency, int(np.max(self.frequency)) + 1 + other.frequency]),
            np.concatenate([self.present, other.present]),
            np.concatenate([self.driven, other.driven]),
            self.conjugates,
            None if here is None or there is None else np.concatenate([here, there]),
        )


def generic_lines(
    model: Model,
    channels: Sequence[Channel],
    count: int,
    conjugates: bool = True,
    kinds: Sequence[int] | None = None,
) -> LinePattern:
    """`count` lines of different frequencies with every channel measured and every input driven.

    As many again for each experiment of the rig, or of those by number (`kinds`), with the channels that it has.
    """
    numbers = np.arange(1 + len(model.experiments)) if kinds is None else np.asarray(kinds)
    names = (None, *model.experiments)
    there = np.array([[c in channels_of(channels, names[k]) for c in channels] for k in numbers], dtype=bool)
    present = np.repeat(there.reshape(len(numbers), len(channels)), count, axis=0)
    lines = count * len(numbers)
    driven = np.ones((lines, len(model.inputs)), dtype=bool)
    experiment = np.repeat(numbers, count) * RUNS if model.experiments else None
    return LinePattern(np.arange(lines), present, driven, conjugates, experiment)


def enough_lines(model: Model, channels: Sequence[Channel], unknowns: int) -> LinePattern:
    """Points enough that more add nothing: one equation at each may be all, and undamped rigs know s² alone."""
    hysteretic = any(element.law.hysteretic for element in model.elements)
    count = (unknowns + loads_at_ends(model) + 2) * (2 if hysteretic else 1)
    return generic_lines(model, channels, count, conjugates=False)


def loads_at_ends(model: Model) -> int:
    """How many loads at the ends of its record move a rig without inputs."""
    return 0 if model.inputs else 2 * model.n


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
    experiment = spectrum.experiment // RUNS * RUNS if model.experiments else None
    return LinePattern(frequency.astype(np.int64), present, driven, experiment=experiment)


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

    Raises IdentifiabilityError if the rig has no steady response, whatever its parameters.
    """
    free, model = not model.inputs, model if model.inputs else pushed_everywhere(model)
    view = view_of(model, channels)
    m, M = view.m, len(view.names)
    psi = rng.integers(1, PRIME, M)
    psi[M - view.delays :] = 1
    times = field.residues([tie.times for tie in model.ties])
    column = np.where(np.any(model.T, axis=1), np.argmax(model.T != 0, axis=1), -1)
    p = np.where(column >= 0, times * psi[column] % PRIME, field.residues(model.p0.tolist()))
    s = rng.integers(1, PRIME, int(np.max(lines.frequency)) + 1)[lines.frequency]
    present, experiment = lines.present, lines.experiment
    driven = np.ones((len(s), model.n), dtype=bool) if free else lines.driven
    j = np.where(np.arange(len(s)) % 2, PRIME - ROOT, ROOT)
    if lines.conjugates:
        s = np.concatenate([s, PRIME - s])
        j = np.repeat([ROOT, PRIME - ROOT], len(lines.frequency))
        present, driven = np.concatenate([present, present]), np.concatenate([driven, driven])
        experiment = None if experiment is None else np.concatenate([experiment, experiment])
    laws = [_to_the_power(s, e.law.power) * (j if e.law.hysteretic else 1) % PRIME for e in model.elements]
    law = np.stack(laws, axis=-1)  # φ, j being √−1 in the field
    for rig, some in model.by_experiment(experiment):
        law[some] *= rig.acts
    q = rng.integers(1, PRIME, driven.shape) * driven
    if free:
        q = (q[0] + q[-1] * s[:, None]) % PRIME
    G, y, J = _channels(model, view, p, law, s, q)
    by_theta = np.zeros((*y.shape, m), dtype=np.int64)
    for e in np.flatnonzero(column >= 0):
        by_theta[..., column[e]] = (by_theta[..., column[e]] + J[..., e] * times[e]) % PRIME
    # ∂y/∂gain = y / gain and ∂y/∂τ = −s y
    by_calibration = np.zeros((*y.shape, view.gains + view.delays), dtype=np.int64)
    per_gain = field.inverse(psi[view.m : view.m + view.gains])
    for k in range(view.gains):
        by_calibration[..., k] = y * (view.gain == k) * int(per_gain[k]) % PRIME
    for k in range(view.delays):
        by_calibration[..., view.gains + k] = (PRIME - s)[:, None] * y % PRIME * (view.delay == k)
    slopes = np.concatenate([by_theta, by_calibration], axis=-1) * present[..., None]
    whole = np.concatenate([G * present[..., None], slopes], axis=-1)
    if free:
        loads = whole[..., : model.n]
        whole = np.concatenate([loads, loads * s[:, None, None] % PRIME, whole[..., model.n :]], axis=-1)
        whole = whole.reshape(1, -1, whole.shape[-1])
    inputs = whole.shape[-1] - M
    rows = [np.eye(len(view.names), dtype=np.int64)[view.prior_precision > 0]]
    for line in whole:
        reduced, pivots = field.echelon(line, inputs)
        rows.append(reduced[len(pivots) :, inputs:])
    return Draw(np.concatenate(rows), psi)


def _channels(
    model: Model, view: ObservationModel, p: Ints, law: Ints, s: Ints, q: Ints
) -> tuple[Ints, Ints, Ints]:
    """(G, y = G q, slopes of y by the elements at fixed q) with calibrations 1, which only scale the rows.

    The exact twin of `model.observation.transfer`: p (elements,), law (lines, elements) φ, s (lines,) in place of jω,
    q (lines, r + s).
    """
    moving = len(model.displacement_inputs)
    B = np.zeros((len(model.elements), model.n), dtype=np.int64)
    D, S = (np.zeros((rows, len(model.inputs)), dtype=np.int64) for rows in (len(B), model.n))
    for e, element in enumerate(model.elements):
        along = {}
        if element.along:
            # Factors modulo PRIME; their ratios count to twelve digits, for rounding must not tell levers apart.
            first = min(element.along)
            lead = field.residue(element.along[first])
            along = {
                point: lead * field.residue(float(f"{factor / element.along[first]:.12g}")) % PRIME
                for point, factor in element.along.items()
            }
        B[e] = [along.get(point, 0) for point in model.coordinates]
        D[e, :moving] = [along.get(point, 0) for point in model.displacement_inputs]
    for i, k in np.argwhere(model.S):
        S[i, moving + k] = field.residue(model.S[i, k])
    rig = _FieldRig(B, D, p * law % PRIME, S)
    Z, R = rig.stiffness()
    C, G = rig.channels(view, s)
    solved, regular = field.solve_modulo(Z, np.concatenate([R, np.swapaxes(C, 1, 2)], axis=-1))
    if not np.any(regular):
        loose = np.flatnonzero(np.any(field.null_space(Z[0]) != 0, axis=0))
        names = listed(model.coordinates[i] for i in loose)
        raise IdentifiabilityError(
            f"the rig has no steady-state response: {names} can move without any force, whatever the parameters",
            cure="add a mass, spring or damper there, or remove a coordinate",
        )
    solved = solved * regular[:, None, None]
    X, adjoint = solved[..., : R.shape[-1]], solved[..., R.shape[-1] :]
    for i in range(model.n):
        G = (G + C[:, :, i, None] * X[:, None, i, :]) % PRIME
    G = G * regular[:, None, None]
    x = np.sum(X * q[:, None, :] % PRIME, axis=-1) % PRIME
    y = np.sum(G * q[:, None, :] % PRIME, axis=-1) % PRIME
    J = rig.slopes(view, law, x, q, adjoint)
    return G, y, J * regular[:, None, None]


@dataclass(frozen=True)
class _FieldRig:
    """A rig in the field: elongations of the elements by coordinates B (elements, n) and inputs D (elements, r + s).

    strength (lines, elements) p φ; S (n, r + s) how forces act.
    """

    B: Ints
    D: Ints
    strength: Ints
    S: Ints

    def pulls(self, e: int) -> tuple[Ints, Ints, Ints, Ints]:
        """Of an element the coordinates and inputs that it moves with, and what it pulls on each, (lines, those)."""
        i, k = np.flatnonzero(self.B[e]), np.flatnonzero(self.D[e])
        by_x, by_q = (self.strength[:, e, None] * part % PRIME for part in (self.B[e, i], self.D[e, k]))
        return i, k, by_x, by_q

    def stiffness(self) -> tuple[Ints, Ints]:
        """Dynamic stiffness (lines, n, n), and the forces per unit of each input (lines, n, r + s)."""
        n = len(self.S)
        Z = np.zeros((len(self.strength), n, n), dtype=np.int64)
        R = np.tile(self.S, (len(self.strength), 1, 1))
        for e, b in enumerate(self.B):
            i, k, by_x, by_q = self.pulls(e)
            at = i[:, None]
            Z[:, at, i] = (Z[:, at, i] + b[at] * by_x[:, None]) % PRIME
            R[:, at, k] = (R[:, at, k] - b[at] * by_q[:, None]) % PRIME
        return Z, R

    def channels(self, view: ObservationModel, s: Ints) -> tuple[Ints, Ints]:
        """What the channels show of coordinates (lines, channels, n), and of inputs (lines, channels, r + s)."""
        n, inputs = self.S.shape
        C = np.zeros((len(s), len(view.channels), n), dtype=np.int64)
        G = np.zeros((len(s), len(view.channels), inputs), dtype=np.int64)
        for c, e in np.argwhere(view.force):
            i, k, by_x, by_q = self.pulls(e)
            sign = field.residue(view.force[c, e])
            C[:, c, i] = (C[:, c, i] + by_x * sign) % PRIME
            G[:, c, k] = (G[:, c, k] + by_q * sign) % PRIME
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
        for e, (b, d) in enumerate(zip(self.B, self.D, strict=True)):
            i, k = np.flatnonzero(b), np.flatnonzero(d)
            elongation = np.sum(x[:, i] * b[i] % PRIME, axis=1) + np.sum(q[:, k] * d[k] % PRIME, axis=1)
            effect = -np.sum(adjoint[:, i] * b[i, None] % PRIME, axis=1)
            for c in np.flatnonzero(view.force[:, e]):
                effect[:, c] += field.residue(view.force[c, e])
            J[:, :, e] = (effect % PRIME) * (law[:, e] * (elongation % PRIME) % PRIME)[:, None] % PRIME
        return J


def _to_the_power(s: Ints, power: int) -> Ints:
    result = np.ones_like(s)
    for _ in range(power):
        result = result * s % PRIME
    return result


# The same in floating point


def nominal(model: Model, channels: Sequence[Channel]) -> tuple[Real, float]:
    """(ψ, typical ω): near priors and guesses where there are any, near what known values suggest elsewhere; delays 0.

    No two alike: symmetry would hide directions that other values have, or show more than there are.
    """
    view = view_of(model, channels)
    size, rate = typical_sizes(model)
    values = []
    kinds = {element.name: element.kind for element in model.elements}
    for unknown in model.unknowns:
        values.append(unknown.nominal or size[kinds[unknown.name]])
    calibrations = view.nominal_calibrations.tolist()
    values += calibrations[: view.gains]
    return np.array([*(np.array(values) * spaced(len(values), 0.8, 1.25)), *calibrations[view.gains :]]), rate


def floating(
    model: Model,
    channels: Sequence[Channel],
    lines: LinePattern,
    psi: Real,
    rate: float,
    rng: np.random.Generator,
) -> Real:
    """The rows of `exact` at ψ, real, each channel of size 1; frequencies around `rate` (rad/s) and inputs at random.

    Columns are slopes by ψ itself.  psi (M,).  Raises ModelError if sizes are too far apart for floating point.
    """
    distinct = int(np.max(lines.frequency)) + 1
    grid = rate * np.geomspace(0.25, 3.0, distinct) * np.exp(rng.uniform(-0.05, 0.05, distinct))
    omega = grid[lines.frequency]
    free, model = not model.inputs, model if model.inputs else pushed_everywhere(model)
    shape = (len(omega), len(model.inputs))
    drawn = np.exp(rng.uniform(-0.5, 0.5, shape) + 2j * np.pi * rng.random(shape))
    s = 1j * omega / rate
    q: Complex = drawn[0].real + drawn[-1].real * s[:, None] if free else drawn * lines.driven
    view = observation_model(model, channels, omega, lines.experiment)
    rig = calibrated_transfer(view, psi, np.ones(len(channels)))
    G, y, J = rig.G, rig.amplitudes(q), rig.slopes(q)
    level = np.maximum(np.abs(y), 1e-6 * np.max(np.abs(y), axis=0, initial=0.0))
    level = np.where(lines.present, np.where(level > 0, level, 1.0), np.inf)
    G, J = G / level[..., None], J / level[..., None]
    if free:  # real loads: real and imaginary parts are rows of their own
        G, J = (
            part.reshape(1, -1, part.shape[-1]) for part in (np.concatenate([G, s[:, None, None] * G], -1), J)
        )
        G, J = (np.concatenate([part.real, part.imag], axis=1) for part in (G, J))
    rows = [np.diag(np.where(psi == 0, 1.0, 1 / np.where(psi == 0, 1.0, psi)))[view.prior_precision > 0]]
    for g, by_psi in zip(G, J, strict=True):
        size = np.linalg.norm(g, axis=0)
        g = g / np.where(size > 0, size, 1.0)
        if not np.all(np.isfinite(g)):
            raise ModelError(
                "the rig's values differ too much in size for floating point",
                cure="check units and sizes of the values",
            )
        u, s, _ = np.linalg.svd(g, full_matrices=False)
        u = u[:, s > 1e-10 * max(float(s[0]) if s.size else 0.0, 1e-300)]
        by_psi = by_psi - u @ (u.conj().T @ by_psi)
        rows += [by_psi.real, by_psi.imag]
    return np.concatenate(rows)


# Directions of the unknowns that leave every channel unchanged, sorted by what they mean (THEORY §5).
#
# To first order, at any rig: δθ = c (only sums can be found), δθ = c θ (only ratios and products), δθ = c
# θ² (only sums of reciprocals: elements in series), constants c all of them; what is left changes with the
# rig and is stated at its nominal values.


Sort = Literal["unseen", "sum", "scale", "series", "mixed", "lines"]

DRAWS = 3  # random rigs that a constant direction must hold at


@dataclass(frozen=True)
class LinesAtHand:
    """Data whose lines are too few: `lines` at `frequencies` different ones.

    `missing` more with all channels and inputs would do, None where no number does.  `without_base`: they are of
    experiments in which the rig differs, and none of the rig as it stands.
    """

    lines: int
    frequencies: int
    missing: int | None
    without_base: bool = False


@dataclass(frozen=True)
class Deficiency(Frozen):
    """Unknowns that cannot be told apart.

    directions    (k, M): δψ at the nominal ψ, in the unknowns' units, that nothing shows
    combinations  (c, names): coefficients of what can be found: of sums of the unknowns (sum), of their logarithms
                  (scale), of their reciprocals (series); (0, names) elsewhere
    sensors       further sensors, each of which would show all the directions
    lines         where it is the lines at hand that do not suffice
    """

    sort: Sort
    names: tuple[str, ...]
    directions: Real
    combinations: Real
    sensors: tuple[Channel, ...] = ()
    lines: LinesAtHand | None = None


@dataclass(frozen=True)
class Deficient:
    """A rig whose unknowns `names` (M,) cannot all be found: random rigs `draws`, nominal `psi` (M,), rad/s `rate`."""

    model: Model
    channels: tuple[Channel, ...]
    names: tuple[str, ...]
    draws: list[Draw]
    psi: Real
    rate: float
    rng: np.random.Generator

    def deficiencies(self) -> list[Deficiency]:
        """What cannot be told apart, with the sensors that would help."""
        rows, M = self.draws[0].rows, len(self.names)
        unseen = [j for j in range(M) if not np.any(rows[:, j])]
        rest = [j for j in range(M) if j not in set(unseen)]
        scale = np.where(self.psi == 0, 1.0, self.psi)
        none, names = np.zeros((0, len(unseen))), tuple(self.names[j] for j in unseen)
        described = [Deficiency("unseen", names, np.eye(M)[unseen] * scale, none)] if unseen else []
        explained = np.zeros((0, M), dtype=np.int64)
        count = M - field.rank(rows) - len(unseen)
        sorts: tuple[Sort, ...] = ("sum", "scale", "series")
        for power, sort in enumerate(sorts):
            if len(explained) == count:
                break
            explained, constants = self._explained(explained, rest, power)
            described += [self._described(sort, power, block) for block in _blocks(constants)]
        if len(explained) < count:
            _, fixed = field.echelon(explained)
            open_ones = [j for j in rest if j not in set(fixed)]
            described += [self._described("mixed", 0, block) for block in _blocks(self._circuits(open_ones))]
        sensors = self._sensors(described)
        return [
            replace(deficiency, sensors=more) for deficiency, more in zip(described, sensors, strict=True)
        ]

    def _explained(self, explained: Ints, columns: list[int], power: int) -> tuple[Ints, list[Ints]]:
        """`explained` with the directions δψ = c ψ^power that it has not yet, unseen at every draw, and their c."""
        powers = [_to_the_power(draw.psi, power) for draw in self.draws]
        rows = [draw.rows * by % PRIME for draw, by in zip(self.draws, powers, strict=True)]
        new = []
        for vector in field.null_space(np.concatenate(rows)[:, columns]):
            constant = np.zeros(len(self.names), dtype=np.int64)
            constant[columns] = vector
            direction = constant * powers[0] % PRIME
            more = np.concatenate([explained, direction[None]])
            if field.rank(more) == len(more):
                explained = more
                new.append(constant)
        return explained, new

    def _circuits(self, columns: list[int]) -> list[Ints]:
        """A basis of the unseen directions among some unknowns, of small support."""
        rows = self.draws[0].rows
        pool: list[Ints] = []
        for turn in range(12):  # orders of the unknowns tried for short descriptions
            order = np.array(columns) if turn == 0 else self.rng.permutation(columns)
            for vector in field.null_space(rows[:, order]):
                whole = np.zeros(len(self.names), dtype=np.int64)
                whole[order] = vector
                pool.append(whole)
        pool.sort(key=lambda vector: int(np.count_nonzero(vector)))
        chosen: list[Ints] = []
        for vector in pool:
            if field.rank(np.array([*chosen, vector])) > len(chosen):
                chosen.append(vector)
        return chosen

    def _numbers(self, vector: Ints, power: int, draws: int) -> Real:
        """The constants of a direction whose unknowns are known, (M,), the largest 1."""
        support = np.flatnonzero(vector)
        lines = enough_lines(self.model, self.channels, len(self.names))
        scale = np.where(self.psi == 0, 1.0, self.psi)
        rows = []
        for turn in range(draws):
            shift = np.exp(self.rng.uniform(-0.4, 0.4, len(scale))) if turn else np.ones(len(scale))
            at = self.psi * shift
            slopes = floating(self.model, self.channels, lines, at, self.rate, self.rng)
            rows.append((slopes * np.where(self.psi == 0, 1.0, at * shift ** (power - 1.0)))[:, support])
        stacked = np.concatenate(rows)
        size = np.linalg.norm(stacked, axis=0)
        v = right_vectors(stacked / size)[-1] / size
        v = v / v[np.argmax(np.abs(v))]
        whole = np.zeros(len(self.names))
        whole[support] = np.where(np.abs(v) < 1e-9, 0.0, v)
        return whole  # δψ = v ψ^power scale^(1 − power)

    def _described(self, sort: Sort, power: int, block: list[Ints]) -> Deficiency:
        columns = sorted({int(j) for vector in block for j in np.flatnonzero(vector)})
        names = tuple(self.names[j] for j in columns)
        relative = np.array([self._numbers(v, power, 1 if sort == "mixed" else DRAWS) for v in block])
        scale = np.where(self.psi == 0, 1.0, self.psi)
        if sort == "mixed":
            return Deficiency(sort, names, relative * scale, np.zeros((0, len(columns))))
        # Sums have the physical constants, ratios the relative ones, reciprocals δ(1/θ) = −c.
        constants = relative[:, columns] * scale[columns] ** (1.0 - power)
        # Combinations that do not change along any of the vectors, in echelon form.
        size = np.max(np.abs(constants), axis=0)
        scaled = constants / size
        Vh = np.linalg.svd(scaled)[2]
        rows = Vh[np.linalg.matrix_rank(scaled, 1e-6) :] / size
        for column in range(rows.shape[1]):
            done = column if column < len(rows) else len(rows)
            if done == len(rows):
                break
            chosen = done + int(np.argmax(np.abs(rows[done:, column])))
            if abs(rows[chosen, column]) * size[column] < 1e-6:
                continue
            rows[[done, chosen]] = rows[[chosen, done]]
            rows[done] /= rows[done, column]
            others = np.arange(len(rows)) != done
            rows[others] -= rows[others, column][:, None] * rows[done]
        small = np.abs(rows * size) < 1e-6 * np.max(
            np.abs(rows * size), axis=1, initial=1e-300, keepdims=True
        )
        return Deficiency(sort, names, relative * scale, np.where(small, 0.0, rows))

    def _sensors(self, found: Sequence[Deficiency]) -> list[tuple[Channel, ...]]:
        """For each deficiency, single further sensors that show all its directions; calibrations are not mended so."""
        elements = {element.name for element in self.model.elements}
        sensors: list[list[Channel]] = [[] for _ in found]
        scale = np.where(self.psi == 0, 1.0, self.psi)
        # Sensors that might be added: motions, applied forces, reaction forces
        motion = {
            next(iter(c.of)) for c in self.channels if c.quantity is not Quantity.FORCE and len(c.of) == 1
        }
        force = {next(iter(c.of)) for c in self.channels if c.quantity is Quantity.FORCE and len(c.of) == 1}
        points = (*self.model.displacement_inputs, *self.model.coordinates)
        forces = (*self.model.force_inputs, *self.model.displacement_inputs)
        candidates = [
            *(Channel("…", {name: 1.0}) for name in points if name not in motion),
            *(Channel("…", {name: 1.0}, Quantity.FORCE) for name in forces if name not in force),
        ]
        for channel in candidates[:40]:  # further sensors tried as a cure
            more = (*self.channels, channel)
            lines = enough_lines(self.model, more, len(self.names))
            slopes = floating(self.model, more, lines, self.psi, self.rate, self.rng)
            size = float(np.max(np.linalg.norm(slopes * scale, axis=0)))
            for k, deficiency in enumerate(found):
                shown = np.linalg.svd(slopes @ deficiency.directions.T, compute_uv=False)
                # 1e-7: part of the largest slope from which a further sensor shows a direction
                if shown[-1] > 1e-7 * size and elements & set(deficiency.names):
                    sensors[k].append(channel)
        return [tuple(more) for more in sensors]


def right_vectors(matrix: Real) -> Real:
    """All right singular vectors, (columns, columns), without the left ones of a tall matrix."""
    tall = matrix.shape[0] >= matrix.shape[1]
    return np.linalg.svd(matrix, full_matrices=not tall)[2]


def _blocks(vectors: Iterable[Ints]) -> list[list[Ints]]:
    """Directions that share an unknown, together."""
    blocks: list[tuple[set[int], list[Ints]]] = []
    for vector in vectors:
        support, members = set(np.flatnonzero(vector).tolist()), [vector]
        apart = []
        for other, vectors_of_other in blocks:
            if other & support:
                support |= other
                members = vectors_of_other + members
            else:
                apart.append((other, vectors_of_other))
        blocks = [*apart, (support, members)]
    return [members for _, members in blocks]
