"""Random rigs with planted deficiencies: each is reported with a direction that nothing shows; sound rigs are not.

Directions are checked against the response itself, by finite differences, not against the slopes that found them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.check.deficiencies import require_identifiable
from dashpot.check.identifiability import Structure, structure
from dashpot.errors import IdentifiabilityError
from dashpot.model.dynamics import response
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Model
from tests.rigs import Rig, channels, perfect, random_rig

Case = tuple[Model, tuple[Channel, ...], set[str]]
RIGS = 8  # of each kind: 64 deficient ones


def shown(model: Model, seen: Sequence[Channel], psi: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """What motion channels show at ψ = (θ, gains), over the input's channel where that has a gain; (lines, channels).

    Frequencies and forces go with the rig `middle`, not with ψ.
    """
    names = [unknown.name for unknown in model.unknowns]
    m = len(names)
    gains = dict(zip([c.name for c in seen if c.gain is None], psi[m:], strict=True))
    p = model.parameters(middle[:m])
    stiff, heavy = (
        np.median([x for x, k in zip(p, model.kinds, strict=True) if k is kind])
        for kind in (Kind.SPRING, Kind.MASS)
    )
    omega = np.sqrt(stiff / heavy) * np.geomspace(0.2, 3, 2 * m + 4)
    rng = np.random.default_rng(1)
    shapes = ((len(omega), len(model.displacement_inputs)), (len(omega), len(model.force_inputs)))
    U, f = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape) for shape in shapes)
    X = response(model, model.parameters(psi[:m]), omega, U, f * stiff)
    points = dict(zip(model.coordinates, X.T, strict=True)) | dict(
        zip(model.displacement_inputs, U.T, strict=True)
    )
    columns = []
    for channel in seen:
        if set(channel.of) <= set(points):
            motion = sum(factor * points[name] for name, factor in channel.of.items())
            columns.append(
                gains.get(channel.name, 1.0) * (1j * omega) ** channel.quantity.derivative * motion
            )
    driven = gains.get("u1", 1.0)
    return np.stack(columns, axis=-1) / driven


def assert_true_directions(model: Model, seen: Sequence[Channel], found: Structure) -> None:
    """Along each direction the channels stay, to first order; along the parameters one by one they do not."""
    y = shown(model, seen, found.nominal, found.nominal)
    size = np.max(np.abs(y), axis=0)
    size = np.where(size > 0, size, 1.0)

    def slope(direction: np.ndarray) -> float:
        step = 1e-5 / np.max(np.abs(direction / found.nominal))
        ahead, behind = (
            shown(model, seen, found.nominal + h * direction, found.nominal) for h in (step, -step)
        )
        return float(np.max(np.abs((ahead - behind) / 2e-5 / size)))

    whole = max(slope(np.eye(len(found.nominal))[j] * x) for j, x in enumerate(found.nominal))
    count = 0
    for one in found.deficiencies:
        moved = np.any(one.directions != 0, axis=0)
        assert {name for name, m in zip(found.names, moved, strict=True) if m} == set(one.names)
        for direction in one.directions:
            assert slope(direction) < 1e-6 * whole, one.names
            count += 1
    directions = np.concatenate([one.directions for one in found.deficiencies]) / found.nominal
    assert np.linalg.matrix_rank(directions, 1e-9) == count == len(found.names) - found.rank


def deficient(rng: np.random.Generator, **settings: object) -> Rig:
    chosen = {
        "n": int(rng.integers(1, 6)),
        "displacements": int(rng.integers(0, 3)),
        "forces": int(rng.integers(0, 2)),
    }
    chosen |= settings
    if not chosen["displacements"] and not chosen["forces"]:
        chosen["forces"] = 1
    return random_rig(rng, **chosen)  # type: ignore[arg-type]


def parallel(rng: np.random.Generator) -> Case:
    """One or two more elements where there is one of unknown value already, stretched a little differently."""
    rig = deficient(rng)
    free = [e for e in rig.model.elements if e.value is None and e.same_as is None]
    free = [e for e in free if all(other.same_as != e.name for other in rig.model.elements)]
    if not free:
        return parallel(rng)
    first = free[int(rng.integers(len(free)))]
    more = [
        replace(
            first, name=f"again{i}", along={x: b * float(rng.choice([1.0, -1.0, 0.5, 0.37])) for x, b in one}
        )
        for i in range(int(rng.integers(1, 3)))
        for one in [list(first.along.items())]
    ]
    more = [replace(e, along={x: first.along[x] * _factor(e, first) for x in first.along}) for e in more]
    model = replace(rig.model, elements=(*rig.model.elements, *more))
    return model, channels(rig), {first.name, *(e.name for e in more)}


def _factor(e: object, first: object) -> float:
    x = next(iter(first.along))  # type: ignore[attr-defined]
    return float(e.along[x] / first.along[x])  # type: ignore[attr-defined]


def no_scale(rng: np.random.Generator) -> Case:
    """Displacements go in, and no parameter is known."""
    rig = deficient(rng, displacements=int(rng.integers(1, 3)), forces=0, known=0.0)
    model = replace(rig.model, elements=tuple(replace(e, value=None) for e in rig.model.elements))
    return model, channels(rig), {unknown.name for unknown in model.unknowns}


def idle_leaf(rng: np.random.Generator) -> Case:
    """A spring and a damper to a coordinate that carries no mass and that no channel sees."""
    rig = deficient(rng)
    at = str(rng.choice(rig.model.coordinates))
    more = (between("k_leaf", Kind.SPRING, at, "leaf"), between("c_leaf", Kind.DAMPER, at, "leaf"))
    model = replace(
        rig.model, coordinates=(*rig.model.coordinates, "leaf"), elements=(*rig.model.elements, *more)
    )
    return model, channels(rig), {"k_leaf", "c_leaf"}


def in_series(rng: np.random.Generator) -> Case:
    """Two springs (or dampers) in series through a coordinate without mass that no channel sees."""
    rig = deficient(rng)
    kind = Kind(rng.choice(["spring", "damper"]))
    ends = [*rig.model.coordinates, "ground"]
    one, two = (str(x) for x in rng.choice(ends, 2, replace=False))
    more = (between("first", kind, one, "joint"), between("second", kind, "joint", two))
    model = replace(
        rig.model, coordinates=(*rig.model.coordinates, "joint"), elements=(*rig.model.elements, *more)
    )
    return model, channels(rig), {"first", "second"}


def hidden_mass(rng: np.random.Generator) -> Case:
    """A mass behind an unknown spring, on an unknown spring to ground, where an unknown spring to ground stands too."""
    rig = deficient(rng, levers=False, ties=False)
    at = str(rng.choice(rig.model.coordinates))
    elements = tuple(
        e for e in rig.model.elements if not (e.kind is Kind.SPRING and dict(e.along) == {at: 1.0})
    )
    more = (
        mass("m_hidden", "hidden"), between("k_hidden", Kind.SPRING, at, "hidden"),
        between("k_back", Kind.SPRING, "hidden", "ground"), between("k_front", Kind.SPRING, at, "ground"),
    )  # fmt: skip
    model = replace(rig.model, coordinates=(*rig.model.coordinates, "hidden"), elements=(*elements, *more))
    return model, channels(rig), {"m_hidden", "k_hidden", "k_back", "k_front"}


def on_the_base(rng: np.random.Generator) -> Case:
    """A mass that moves with the base, whose force nobody measures."""
    rig = deficient(rng, displacements=1, forces=0)
    model = replace(rig.model, elements=(*rig.model.elements, mass("m_table", "u1")))
    return model, channels(rig), {"m_table"}


def all_gains(rng: np.random.Generator) -> Case:
    """Every amplifier of a shaken rig of unknown gain."""
    rig = deficient(rng, displacements=1, forces=0)
    seen = tuple(replace(c, gain=None) for c in channels(rig))
    return rig.model, seen, {f"{c.name}.gain" for c in seen}


def apart(rng: np.random.Generator) -> Case:
    """A part of its own that nothing drives."""
    rig = deficient(rng)
    more = (mass("m_far", "far"), between("k_far", Kind.SPRING, "far", "ground"))
    model = replace(
        rig.model, coordinates=(*rig.model.coordinates, "far"), elements=(*rig.model.elements, *more)
    )
    return model, (*channels(rig), Channel("far", {"far": 1.0})), {"m_far", "k_far"}


PLANTED = [parallel, no_scale, idle_leaf, in_series, hidden_mass, on_the_base, all_gains, apart]


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTED, ids=lambda plant: plant.__name__)
def test_planted_deficiencies_are_reported_with_true_directions(
    plant: Callable[[np.random.Generator], Case],
) -> None:
    rng = np.random.default_rng(11)
    for _ in range(RIGS):
        model, seen, involved = plant(rng)
        found = structure(model, seen)
        assert not found.identifiable
        reported = {name for one in found.deficiencies for name in one.names}
        assert involved <= reported
        if plant is not no_scale:  # nothing but what was planted
            assert reported == involved or plant in (hidden_mass, in_series)
        if plant is not apart:
            assert_true_directions(model, seen, found)
        with pytest.raises(IdentifiabilityError) as refused:
            require_identifiable(model, seen)
        assert len(refused.value.problems) == len(found.deficiencies)
        assert all(problem.cure for problem in refused.value.problems)


def test_sound_rigs_are_not_refused() -> None:
    """Rigs whose noise-free regressor has full rank in floating point, by a wide margin."""
    rng = np.random.default_rng(12)
    for _ in range(40):
        rig = deficient(rng, n=int(rng.integers(1, 7)))
        found = structure(rig.model, channels(rig), perfect(rig, channels(rig)))
        assert found.identifiable
        assert found.deficiencies == ()


@pytest.mark.slow
def test_partly_seen_rigs_are_judged_as_floating_point_does() -> None:
    """Channels left out at random; where singular values of finite differences leave no doubt, so must the verdict."""
    rng = np.random.default_rng(13)
    doubtful = sound = 0
    for _ in range(80):
        rig = deficient(rng, n=int(rng.integers(2, 5)), levers=False)
        seen = channels(rig)
        inputs = {*rig.model.displacement_inputs, *rig.model.force_inputs}
        kept = [c for c in seen if set(c.of) <= inputs or rng.random() < 0.5]
        if len(kept) == len(inputs):
            continue
        found = structure(rig.model, kept)
        at = np.abs(found.nominal)
        columns = [
            (shown(rig.model, kept, at + h, at) - shown(rig.model, kept, at - h, at)) / 2e-5
            for h in np.diag(1e-5 * at)
        ]
        J = np.stack(columns, axis=-1).reshape(-1, len(at))
        s = np.linalg.svd(np.concatenate([J.real, J.imag]), compute_uv=False)
        if s[-1] > 1e-6 * s[0]:
            sound += 1
            assert found.identifiable
        elif s[-1] < 1e-9 * s[0]:
            assert not found.identifiable
        else:
            doubtful += 1
    assert sound > 26
    assert doubtful < 20
