"""Measured modes of large rigs: computed on few motions, they are those of the whole rig, and so is what they tell."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.modal_data import ModalData, independent_modes
from dashpot.estimate import modal
from dashpot.estimate.modal import ModeProblem, identify_modal, mode_residuals, wider_span
from dashpot.model.elements import Element, Kind
from dashpot.model.modes import eigenpairs
from dashpot.model.network import Model

TRUE = np.array([1.15, 0.8, 1.3])


def chain(n: int, damping: Kind | None, held: bool) -> Model:
    """A rod in three parts of unknown stiffness, with or without damping in proportion, at one end or free."""
    points = [f"x{i}" for i in range(n)]
    parts = [Element(f"m{i}", Kind.MASS, {x: 1.0}, value=0.1) for i, x in enumerate(points)]
    for i in range(0 if held else 1, n):
        along = {points[i]: 1.0, points[i - 1]: -1.0} if i else {points[0]: 1.0}
        part = min(3 * i // n, 2)
        first = f"k{part}" not in {one.name for one in parts}
        stiffness = {"guess": 1e4} if first else {"same_as": f"k{part}"}
        parts.append(Element(f"k{part}" if first else f"k{part}_{i}", Kind.SPRING, along, **stiffness))
        if damping is not None:
            size = 0.4 if damping is Kind.DAMPER else 150.0
            parts.append(Element(f"c{i}", damping, along, value=size * (1 + (i % 7 == 0))))
    return Model(tuple(points), (), tuple(parts))


def modes_of(model: Model, seen: list[int], count: int, damped: bool) -> ModalData:
    """The lowest modes that swing of the chain with the true stiffnesses, at some points."""
    values, shapes = eigenpairs(model, model.parameters(1e4 * TRUE[None]))
    order = np.argsort(np.where(values[0].imag > 1e-3 * np.abs(values[0]) + 1e-3, np.abs(values[0]), np.inf))
    lam, phi = values[0, order[:count]], shapes[0, order[:count]][:, seen]
    phi = phi / phi[np.arange(count), np.argmax(np.abs(phi), axis=1)][:, None]
    hz, zeta = np.abs(lam) / (2 * np.pi), -lam.real / np.abs(lam)
    none = np.full(count, np.nan)
    ratios = (zeta, 0.02 * zeta) if damped else (none, none)
    points = tuple(model.coordinates[i] for i in seen)
    return independent_modes(points, (hz, 1e-4 * hz), ratios, (phi, np.full(phi.shape, 0.01)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damping", "held"),
    [
        (None, True),
        (None, False),
        (Kind.DAMPER, True),
        pytest.param(Kind.HYSTERETIC, True, marks=pytest.mark.long),
    ],
)
def test_a_rig_on_few_motions_gives_what_the_whole_one_does(
    damping: Kind | None, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = chain(110, damping, held)
    data = modes_of(model, [3, 40, 77, 109], 4, damping is not None)
    found = identify_modal(model, data)
    assert found.converged
    assert [note.code for note in found.notes] == ["reduced_model"]
    monkeypatch.setattr(modal, "SPAN_FROM", 1000)
    whole = modal._estimate(
        ModeProblem.of(model, data), *modal.deepest_minima(ModeProblem.of(model, data), 0, 0), ()
    )
    sd = np.sqrt(np.diagonal(whole.covariance))
    assert np.all(np.abs(found.values - whole.values) < 1e-3 * sd)
    np.testing.assert_allclose(found.values, 1e4 * TRUE, rtol=1e-6)
    assert np.allclose(found.covariance / np.outer(sd, sd), whole.covariance / np.outer(sd, sd), atol=2e-3)


def test_a_span_is_exact_where_it_was_made_and_says_what_it_misses_elsewhere() -> None:
    model = chain(110, Kind.DAMPER, True)
    data = modes_of(model, [3, 40, 77, 109], 4, True)
    problem = ModeProblem.of(model, data)
    here, there = 1e4 * np.ones(3), 1e4 * TRUE
    V, _ = wider_span(problem, here, np.zeros((model.n, 0)))
    assert V.shape[1] < 60
    exact = problem.evaluate(here[None], np.zeros(1, dtype=int))
    near = problem.on(V).evaluate(here[None], np.zeros(1, dtype=int))
    assert near.cost == pytest.approx(exact.cost, rel=1e-7)
    np.testing.assert_allclose(near.gradient, exact.gradient, rtol=1e-4)
    np.testing.assert_allclose(near.symmetric, exact.symmetric, rtol=1e-3)
    # Elsewhere: what is said to be missed is missed
    _, missed = wider_span(problem, there, V)
    values, shapes = problem.on(V).eigenpairs(there[None])
    at = problem.on(V).pair(values, shapes)[0]
    truth = data.eigenvalues
    away = np.abs(values[0, at] / truth - 1)
    assert np.max(away) > 1e-9
    np.testing.assert_allclose(missed, away, rtol=0.2, atol=1e-10)


def test_residuals_of_a_large_rig_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    model = chain(110, Kind.DAMPER, True)
    data = modes_of(model, [3, 40, 77, 109], 4, True)
    data = replace(data, frequency_hz=data.frequency_hz * (1 + 1e-3))
    near = mode_residuals(model, data, 1e4 * TRUE)
    monkeypatch.setattr(modal, "SPAN_FROM", 1000)
    whole = mode_residuals(model, data, 1e4 * TRUE)
    np.testing.assert_allclose(near.frequency, whole.frequency, rtol=1e-6)
    np.testing.assert_allclose(near.shape, whole.shape, atol=1e-7)
