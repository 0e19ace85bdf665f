"""What can be found of a rig from the channels it has, before any data (THEORY §5).

The rank is exact (see `structure`); what it lacks is described by the directions that nothing shows (see
`directions`).  This is local identifiability; of exchanges that a whole rig allows only that of unseen coordinates is
looked for.  Its sentences: `deficiencies`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dashpot.arrays import Complex, Frozen, Real, random_generator
from dashpot.channel import Channel, Quantity
from dashpot.check.structure import (
    DRAWS,
    Deficiency,
    Deficient,
    Draw,
    LinePattern,
    LinesAtHand,
    enough_lines,
    exact,
    floating,
    generic_lines,
    lines_of,
    loads_at_ends,
    nominal,
    right_vectors,
    spaced,
    view_of,
)
from dashpot.data.record import Record
from dashpot.data.spectrum import SettledDwell, Spectrum
from dashpot.errors import DashpotError, IdentifiabilityError, ModelError, UsageError
from dashpot.estimate.nonlinear.objective import NonlinearPart, WarmStart, evaluate, nonlinear_part
from dashpot.estimate.nonlinear.record_problem import begun_problem
from dashpot.estimate.nonlinear.records import arranged
from dashpot.estimate.preparation import prepare
from dashpot.model.elements import Element, Kind
from dashpot.model.modes import typical_sizes
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.model.observation import measures_input, observation_model
from dashpot.numerics import finite_field as field

# Exchanges of unseen coordinates that a whole rig allows: the data cannot say which is which.


Shape = tuple[Kind, frozenset[tuple[str, float]]]  # of an element


def permutation_ambiguities(model: Model, channels: Sequence[Channel]) -> tuple[tuple[str, str], ...]:
    """Pairs of coordinates that no channel and no force touches, with elements alike whose values are all unknown."""
    touched = {point for channel in channels for point in channel.of}
    touched |= {point for given in model.inputs for point in given.at}
    for element in model.elements:
        if element.name in touched:
            touched |= set(element.along)
    hidden = [x for x in model.coordinates if x not in touched][:40]  # unseen coordinates looked at
    tied = {e.same_as for e in model.elements} | {e.name for e in model.elements if e.same_as is not None}
    shapes = {_shape(e, e.along) for e in model.elements}
    pairs = []
    for i, first in enumerate(hidden):
        for second in hidden[i + 1 :]:
            moved = [e for e in model.elements if (first in e.along) != (second in e.along)]
            if not moved or any(e.value is not None or e.name in tied for e in moved):
                continue
            swap = {first: second, second: first}
            if all(_has_image(e, swap, shapes) for e in moved):
                pairs.append((first, second))
    return tuple(pairs)


def _shape(element: Element, along: Mapping[str, float]) -> Shape:
    return element.kind, frozenset(along.items())


def _has_image(element: Element, swap: Mapping[str, str], shapes: set[Shape]) -> bool:
    """Whether the rig has the element that this one becomes when two coordinates are exchanged."""
    image = {swap.get(point, point): factor for point, factor in element.along.items()}
    turned = {point: -factor for point, factor in image.items()}
    return _shape(element, image) in shapes or _shape(element, turned) in shapes


KEPT = 16  # rigs, with their channels and patterns of lines, whose rank is remembered


@dataclass(frozen=True)
class Structure(Frozen):
    """Whether the unknowns ψ (those of the rig, then gains and delays) can be found from the channels.

    rank: how many independent combinations can; nominal (M,): ψ at which directions are given;
    permutation_ambiguities: pairs of unseen coordinates whose parameters may be swapped; prior_dependent: names of the
    unknowns without whose stated sd nothing would fix them.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rank: int
    nominal: Real
    deficiencies: tuple[Deficiency, ...]
    permutation_ambiguities: tuple[tuple[str, str], ...] = ()
    prior_dependent: tuple[str, ...] = ()

    @property
    def identifiable(self) -> bool:
        """Whether every unknown can be found, in a neighbourhood."""
        return self.rank == len(self.names)


def structure(
    model: Model, channels: Sequence[Channel], spectrum: Spectrum | None = None, seed: int = 0
) -> Structure:
    """What the channels can tell of the unknowns; with `spectrum`, also whether its lines are enough.

    Inputs that no channel measures are unknown at every line.  Raises IdentifiabilityError if the rig has no
    steady response, DataError if a channel measures something that the rig lacks, UsageError for nonlinear rigs.
    """
    if len(model.nonlinear):
        raise UsageError(
            "a rig with nonlinear elements cannot be checked without data",
            cure="identify it: its intervals show what the data determine",
        )
    rng = random_generator(seed)
    view = view_of(model, channels)
    names = view.names
    # Random rigs of the highest rank found: one where that is full, else DRAWS
    enough = _lines_enough(model, channels, len(names), rng)
    draws, ranks = list[Draw](), list[int]()
    for _ in range(DRAWS):
        draws.append(exact(model, channels, enough, rng))
        ranks.append(field.rank(draws[-1].rows))
        if ranks[0] == len(draws[0].psi):
            break
    draws = [draw for draw, rank in zip(draws, ranks, strict=True) if rank == max(ranks)]
    rank = field.rank(draws[0].rows)
    psi, rate = nominal(model, channels)
    dependent = []  # unknowns with a prior whose loss would leave something undetermined
    for name in (unknown.name for unknown in view.unknowns if unknown.sd is not None and rank == len(names)):
        elements = tuple(replace(e, value=None, sd=None) if e.name == name else e for e in model.elements)
        free, loose = replace(model, elements=elements), [channel.without_prior(name) for channel in channels]
        looser = view_of(free, loose)
        draw = exact(free, loose, _lines_enough(free, loose, len(looser.names), rng), rng)
        if field.rank(draw.rows) < len(looser.names):
            dependent.append(name)
    base = Structure(
        names, view.units, rank, psi, (), permutation_ambiguities(model, channels), tuple(dependent)
    )
    if rank < len(names):
        rig = Deficient(model, tuple(channels), names, draws, psi, rate, rng)
        return replace(base, deficiencies=tuple(rig.deficiencies()))
    if spectrum is not None:
        return _with_lines(base, model, channels, lines_of(model, spectrum), rate, rng)
    return base


@lru_cache(maxsize=KEPT)
def determines(model: Model, channels: tuple[Channel, ...], lines: LinePattern) -> bool:
    """Whether such lines determine every unknown.  Raises as `structure`.

    Some of the lines are tried first: the others can only add.  What some lines say of a rig is kept, so that the next
    data of it are not worked out again, however many lines they have.
    """
    unknowns = len(view_of(model, channels).names)
    some = lines.spread(2 + -(-(unknowns + loads_at_ends(model)) // max(len(channels), 1)))
    return any(_rank(model, channels, chosen) == unknowns for chosen in (some, lines))


@lru_cache(maxsize=KEPT)
def _rank(model: Model, channels: tuple[Channel, ...], lines: LinePattern) -> int:
    """How many combinations of the unknowns such lines determine, at one random rig."""
    return field.rank(exact(model, channels, lines, np.random.default_rng(0)).rows)


def is_large(model: Model) -> bool:
    """Whether exact ranks would take minutes, or do not exist: nonlinear laws have none in a finite field."""
    # 300_000_000: above it exact ranks take too long for a check before each identification
    return bool(len(model.nonlinear)) or _work(model) > 300_000_000


def parallel_unknowns(model: Model, channels: Sequence[Channel]) -> tuple[tuple[str, ...], ...]:
    """Unknowns whose sum alone can be found, in groups: elements of a kind that join the same points.

    It needs no ranks, so it is for rigs of any size.  Priors, ties and channels of an element's own force tell them
    apart, or may.
    """
    referred = {point for channel in channels if channel.quantity is Quantity.FORCE for point in channel.of}
    referred |= {element.same_as for element in model.elements if element.same_as is not None}
    free = {unknown.name for unknown in model.unknowns if unknown.sd is None} - referred
    groups: dict[object, list[str]] = {}
    for element in model.elements:
        if element.name in free and element.force_law is None:
            first = element.along[min(element.along)]
            ratios = frozenset((point, round(part / first, 12)) for point, part in element.along.items())
            groups.setdefault((element.kind, element.only, abs(first), ratios), []).append(element.name)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)


def _work(model: Model) -> int:
    return model.n**2 * len(model.unknowns) ** 2


def _lines_enough(
    model: Model, channels: Sequence[Channel], unknowns: int, rng: np.random.Generator
) -> LinePattern:
    """Lines enough that more add nothing to the rank; of large rigs hardly more than it takes.

    Each further line at random adds no more than the one before, so where twice as many add nothing, none will.
    """
    most = enough_lines(model, channels, unknowns)
    # 2_000_000: coordinates² · unknowns² above which lines are counted that add to the rank
    if _work(model) <= 2_000_000:
        return most
    equations = unknowns + loads_at_ends(model)
    count, before = 2 * -(-equations // (2 * max(len(channels), 1))) + 2, -1
    while count < len(most.frequency):
        lines = generic_lines(model, channels, count, conjugates=False)
        rank = field.rank(exact(model, channels, lines, rng).rows)
        if rank in (before, unknowns):
            return lines
        before, count = rank, 2 * count
    return most


def _with_lines(
    base: Structure,
    model: Model,
    channels: Sequence[Channel],
    lines: LinePattern,
    rate: float,
    rng: np.random.Generator,
) -> Structure:
    """The verdict on the lines at hand, where more lines would determine everything."""
    M = len(base.names)
    if determines(model, tuple(channels), lines):
        return base
    draw = exact(model, channels, lines, rng)
    rank = field.rank(draw.rows)
    if rank == M:  # the first random point was unlucky
        return base
    reduced, pivots = field.echelon(draw.rows)
    free = [j for j in range(M) if j not in set(pivots)]
    involved = [j for j in range(M) if j in free or np.any(reduced[: len(pivots), free][pivots.index(j)])]
    slopes = floating(model, channels, lines, base.nominal, rate, rng)
    scale = np.where(base.nominal == 0, 1.0, base.nominal)
    # How many more lines, with all channels and inputs, of each experiment at hand would do
    longer = (lines + generic_lines(model, channels, k, kinds=lines.kinds) for k in range(1, M + 1))
    ranks = (field.rank(exact(model, channels, each, rng).rows) for each in longer)
    missing = (more for more, each in enumerate(ranks, start=1) if each == M)
    deficiency = Deficiency(
        "lines",
        tuple(base.names[j] for j in involved),
        right_vectors(slopes * scale)[rank:] * scale,
        np.zeros((0, len(involved))),
        lines=LinesAtHand(
            len(lines.frequency),
            len(np.unique(lines.frequency)),
            next(missing, None),
            model.differs and 0 not in lines.kinds,
        ),
    )
    return replace(base, rank=rank, deficiencies=(deficiency,))


# What can be found of a rig with nonlinear elements, by the rank of the slopes of its settled motions (THEORY §9).
#
# There is no exact rank: a nonlinear law has no finite field. Slopes come from the harmonic balance at nominal values,
# at many frequencies and two sizes of the drive, or at the lines and inputs of data; columns are scaled by the
# unknowns.

FREQUENCIES = 12  # of the drive, around the rig's own
SIZES = (1.0, 0.4)  # of the drive
NOMINAL = 1e-3  # amplitude of displacement inputs, m


def nonlinear_structure(
    model: Model, channels: Sequence[Channel], spectrum: Spectrum | None = None
) -> Structure:
    """Whether the unknowns can be found from the channels; with `spectrum` from its lines and inputs.

    Raises IdentifiabilityError if no settled motion, or no finite one, is found at the nominal values, DataError
    where an input is not measured.
    """
    if not channels:
        raise ModelError(
            "no channels are listed", cure="list the measured channels under [channels] in the rig file"
        )
    with np.errstate(all="ignore"):  # laws may overflow, which is refused below
        if not model.inputs and spectrum is None:
            view = view_of(model, channels)
            psi = np.concatenate([_nominal(model, NOMINAL), view.nominal_calibrations])
            rows: Real = _slopes_let_go(model, channels, psi)
        else:
            given = _settled_test(model, channels) if spectrum is None else spectrum
            data = prepare(model, given)
            view = data.view
            part = nonlinear_part(data, np.nan_to_num(given.amplitudes)[None], None)
            elongation = float(np.max(np.abs(part.q)[..., : model.D.shape[1]], initial=0.0))
            psi = np.concatenate([_nominal(model, elongation or NOMINAL), view.nominal_calibrations])
            J = _slopes(model, given, part, psi)
            rows = np.concatenate([J.real, J.imag])
    scale = np.where(psi == 0, 1.0, psi)
    rows = rows * scale
    if not np.all(np.isfinite(rows)):
        raise IdentifiabilityError(
            "a law is not finite at the nominal values of the rig",
            cure="give initial guesses of the unknowns, or use a law that is finite there",
        )
    known = np.diag(np.where(view.prior_precision > 0, np.linalg.norm(rows), 0.0))
    _, s, Vh = np.linalg.svd(np.concatenate([rows, known]), full_matrices=False)
    # 1e-7: singular value over the largest below which a combination shows nothing
    rank = int(np.sum(s > 1e-7 * s[0])) if s[0] > 0 else 0
    deficiencies = []
    for vector in Vh[rank:]:  # directions that no channel shows; an unknown alone has no effect at all
        # 1e-3: part of a direction from which an unknown belongs to it
        part = np.abs(vector) > 1e-3 * np.max(np.abs(vector))
        chosen = tuple(name for name, there in zip(view.names, part, strict=True) if there)
        direction = np.where(part, vector, 0.0) * scale
        deficiencies.append(Deficiency("mixed", chosen, direction[None], np.zeros((0, len(chosen)))))
    return Structure(view.names, view.units, rank, psi, tuple(deficiencies))


def _settled_test(model: Model, channels: Sequence[Channel]) -> Spectrum:
    """Dwells around the rig's own frequencies, driven in two sizes; only their inputs mean something.

    A force input is as large as moves the typical spring by NOMINAL.
    """
    sizes, rate = typical_sizes(model)
    force = next(size for kind, size in sizes.items() if kind.value == "spring") * NOMINAL
    base = rate / (2 * np.pi) * np.geomspace(0.3, 2.0, FREQUENCIES)
    lines, dwell, amplitude = [], [], []
    for number, (f, size) in enumerate((f, size) for size in SIZES for f in base):
        for order in (1, 2, 3):  # harmonics that are looked at
            lines.append(order * f)
            dwell.append(number)
            amplitude.append(size if order == 1 else 0.0)
    omega = 2 * np.pi * np.array(lines)
    q = np.concatenate(
        [np.full(len(model.displacement_inputs), NOMINAL), np.full(len(model.force_inputs), force)]
    )
    view = observation_model(model, channels, omega)
    shown: Complex = np.einsum("lcq,lq->lc", view.direct_q, np.array(amplitude)[:, None] * q)
    moving = [not measures_input(model, channel) for channel in channels]
    shown[:, moving] = 1.0
    count, width = len(lines), len(channels)
    noise = np.array([1e-3 if moves else 0.0 for moves in moving])
    return Spectrum(
        tuple(channels), np.array(lines), shown,
        np.broadcast_to(np.diag(noise).astype(np.complex128), (count, width, width)), np.ones(count, dtype=int),
        np.full(count, np.inf), ("given",) * count, np.zeros(count, dtype=int), stretch=np.array(dwell),
        stretches=tuple(SettledDwell(float(f)) for _ in SIZES for f in base),
    )  # fmt: skip


def _nominal(model: Model, elongation: float) -> Real:
    """θ near priors and guesses, elsewhere typical values, nonlinear forces a share of the linear ones."""
    sizes, rate = typical_sizes(model)
    stiffness = next(size for kind, size in sizes.items() if kind.value == "spring")
    kinds = {element.name: element for element in model.elements}
    constants = {f"{e.name}.{c.name}": (e, c) for e, c in model.constants}
    values = []
    for unknown in model.unknowns:
        if unknown.nominal:
            values.append(unknown.nominal)
        elif unknown.name in constants:
            element, constant = constants[unknown.name]
            assert element.force_law is not None
            metre, second = element.force_law.exponents[1].get(constant.name, (0.0, 0.0))
            values.append(0.3 * elongation ** (metre + second) * (elongation * rate) ** -second)
        elif kinds[unknown.name].force_law is not None:
            values.append(np.nan)
        else:
            values.append(sizes[kinds[unknown.name].kind])
    theta = np.array(values) * spaced(len(values), 0.9, 1.1)
    # Open parameters of nonlinear elements such that they pull with 0.2 of the linear force, where nothing tells
    filled = np.where(np.isfinite(theta), theta, 1.0)
    q = np.zeros((1, len(model.nonlinear), 3))
    q[0, :, 1] = elongation
    a = alternate(model, model.inner_constants(filled)[None], np.array([rate]), q, 256, slopes=False).a
    unit = np.max(np.abs(complex_of(a))[0], axis=-1)
    for row, index in enumerate(model.nonlinear):
        for j in np.flatnonzero(model.T[index]):
            if not np.isfinite(theta[j]):
                filled[j] = 0.2 * stiffness * elongation / (unit[row] if unit[row] > 0 else 1.0)
    return filled


def _slopes_let_go(model: Model, channels: Sequence[Channel], psi: Real) -> Real:
    """Slopes of all channels along ψ in a motion from NOMINAL elongations on, its start being unknown; (rows, M).

    Raises IdentifiabilityError if no motion follows at ψ.
    """
    samples, rate = 600, typical_sizes(model)[1]  # of a record of some 20 typical periods
    time = np.arange(samples) * 2 * np.pi / rate / 30
    measured = np.random.default_rng(0).standard_normal((samples, len(channels)))  # is no matter
    data = arranged(model, Record(tuple(channels), time, measured))
    problem, _ = begun_problem(model, (data,), psi[: len(model.unknowns)], np.ones(len(channels)))
    start = problem.begun[0].copy()
    start[: model.n] = NOMINAL * spaced(model.n, 0.7, 1.3)
    at = np.concatenate([psi, start[problem.constants.starts]])
    _, J = replace(problem, begun=(start,)).residual(0, at)
    if J is None:
        raise IdentifiabilityError(
            "no motion is found at the nominal values of the rig", cure="give initial guesses of the unknowns"
        )
    flat = J.reshape(-1, J.shape[-1])
    by_start = np.linalg.svd(flat[:, len(psi) :], full_matrices=False)[0]
    return flat[:, : len(psi)] - by_start @ (by_start.T @ flat[:, : len(psi)])


def _slopes(model: Model, spectrum: Spectrum, part: NonlinearPart, psi: Real) -> Complex:
    """Slopes of the moving channels along ψ, (rows, M), each channel of size 1."""
    view = observation_model(model, spectrum.channels, spectrum.omega)
    fresh = replace(part, start=None, warm=WarmStart())
    at = evaluate(view, fresh, psi[None], np.ones((1, len(view.channels))), part.q[:1], None, False)
    lost = ~at.converged[part.dwells.dwell]
    if np.all(lost):
        raise IdentifiabilityError(
            "no steady state is found at the nominal values of the rig",
            cure="give initial guesses of the unknowns",
        )
    J, y = at.J[0], at.predicted[0]
    there = np.isfinite(spectrum.amplitudes) & ~lost[:, None]
    moving = np.array([not measures_input(model, channel) for channel in spectrum.channels])
    size = np.sqrt(np.mean(np.abs(np.where(there, y, 0.0)) ** 2, axis=0))
    scaled = J / np.where(size > 0, size, 1.0)[:, None]
    return scaled[:, moving][there[:, moving]]


def blind_laws(model: Model, spectrum: Spectrum) -> Structure | None:
    """The structure where unknowns of nonlinear elements, alone or with others, leave no trace; None if all do.

    Such data would keep an iteration busy for nothing.
    """
    laws = {element.name for element in model.elements if element.force_law is not None}
    laws |= {f"{element.name}.{constant.name}" for element, constant in model.constants}
    try:
        structure = nonlinear_structure(model, spectrum.channels, spectrum)
    except DashpotError:  # the nominal motion says nothing; the search may find its own
        return None
    blind = tuple(deficiency for deficiency in structure.deficiencies if laws.intersection(deficiency.names))
    return replace(structure, deficiencies=blind) if blind else None
