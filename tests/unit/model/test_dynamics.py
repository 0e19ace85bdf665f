"""Dynamics: laws of physics, closed forms against finite differences, and rigs with known answers."""

from typing import Any

import numpy as np
import pytest

from dashpot.errors import ModelError
from dashpot.model.dynamics import (
    dynamic_stiffness,
    elongations,
    matrices,
    response,
    sensitivities,
    stiffness,
    unit_forces,
)
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Input, Model
from dashpot.numerics.small_systems import solve_small
from tests.networks import network


def spring(name: str, first: str, second: str = "ground", **known: Any) -> Element:
    return between(name, Kind.SPRING, first, second, **known)


def damper(name: str, first: str, second: str = "ground", **known: Any) -> Element:
    return between(name, Kind.DAMPER, first, second, **known)


PAPER = network("x1 x2", "u", "m1@x1 m2@x2 k1:x1-x2 k2:x2-u c1:x1-x2 c2:x2-u c3:x1-ground c4:x2-ground")
PAPER_P = np.array([3.0, 2.7, 4600.0, 4600.0, 30.0, 40.0, 90.0, 50.0])

# Every kind of element, levers, two displacement inputs with masses and inerters on them, two forces
RICH = Model(
    ("a", "b", "c"),
    (Input("u"), Input("f", "force", {"b": 1.0}), Input("v"), Input("g", "force", {"a": 1.0, "c": -0.5})),
    (
        mass("m1", "a"),
        Element("m2", Kind.MASS, {"b": 0.6, "c": 0.4}),
        mass("mu", "u"),
        Element("ml", Kind.MASS, {"c": 0.5, "v": 0.5}),
        between("i1", Kind.INERTER, "a", "v"),
        between("i2", Kind.INERTER, "b", "c"),
        spring("k1", "a", "b"),
        spring("k2", "b", "u"),
        Element("k3", Kind.SPRING, {"a": 1.0, "b": -1.6, "c": 0.6}),
        spring("k4", "c", "v"),
        damper("c1", "b", "c"),
        Element("c2", Kind.DAMPER, {"a": 0.5, "c": 0.5, "u": -1.0}),
        damper("c3", "c"),
        between("h1", Kind.HYSTERETIC, "a", "u"),
        between("h2", Kind.HYSTERETIC, "b", "ground"),
    ),
)
RICH_P = np.array([2.0, 3.0, 1.0, 0.7, 0.4, 0.6, 900.0, 1500.0, 400.0, 700.0, 6.0, 8.0, 5.0, 60.0, 90.0])
OMEGA = np.array([0.3, 4.0, 11.0, 19.0, 47.0])


def drive(model: Model, lines: int, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Random amplitudes of the inputs."""
    rng = np.random.default_rng(7)

    def amplitudes(count: int) -> np.ndarray:
        shape = (*batch, lines, count)
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    return amplitudes(len(model.displacement_inputs)), amplitudes(len(model.force_inputs))


@pytest.mark.parametrize(("model", "p"), [(PAPER, PAPER_P), (RICH, RICH_P)], ids=["paper", "rich"])
class TestLaws:
    def test_forces_balance(self, model: Model, p: np.ndarray) -> None:
        """Bᵀ (p ∘ a) = S f.  THEORY (E)."""
        U, f = drive(model, len(OMEGA))
        X = response(model, p, OMEGA, U, f)
        left = (p * unit_forces(model, OMEGA, X, U)) @ model.B
        np.testing.assert_allclose(left, f @ model.S.T, atol=1e-9 * np.max(np.abs(p)))

    def test_maxwell_reciprocity(self, model: Model, p: np.ndarray) -> None:
        compliance = np.linalg.inv(dynamic_stiffness(model, p, OMEGA))
        np.testing.assert_allclose(compliance, np.swapaxes(compliance, -1, -2), rtol=1e-9, atol=1e-16)

    def test_power_of_the_inputs_is_dissipated(self, model: Model, p: np.ndarray) -> None:
        """½ Re(F̄ · jωδ) of forces and reactions = Σ ½ c |ωδ|² + ½ ω h |δ|² of the dampers."""
        U, f = drive(model, len(OMEGA))
        X = response(model, p, OMEGA, U, f)
        forces = p * unit_forces(model, OMEGA, X, U)
        reactions = forces @ model.D
        speed = 1j * OMEGA[:, None]
        supplied = 0.5 * np.sum((np.conj(reactions) * speed * U).real, axis=-1)
        supplied += 0.5 * np.sum((np.conj(f @ model.S.T) * speed * X).real, axis=-1)
        stretch = np.abs(elongations(model, X, U)) ** 2
        i = model.by_matrix
        lost = 0.5 * OMEGA**2 * (stretch[:, i["C"]] @ p[i["C"]]) + 0.5 * OMEGA * (
            stretch[:, i["H"]] @ p[i["H"]]
        )
        np.testing.assert_allclose(supplied, lost, rtol=1e-9)

    def test_negative_frequencies_are_conjugate(self, model: Model, p: np.ndarray) -> None:
        U, f = drive(model, len(OMEGA))
        X = response(model, p, OMEGA, U, f)
        np.testing.assert_allclose(response(model, p, -OMEGA, U.conj(), f.conj()), X.conj(), rtol=1e-12)

    def test_matrices_make_the_same_dynamic_stiffness(self, model: Model, p: np.ndarray) -> None:
        """K + jωC − ω²M + jH and G + jωF − ω²J.  Paper eq. 1."""
        parts, w = matrices(model, p), OMEGA[:, None, None]
        own = parts.K + 1j * w * parts.C - w**2 * parts.M + 1j * parts.H
        np.testing.assert_allclose(dynamic_stiffness(model, p, OMEGA), own, rtol=1e-12)
        hysteretic = -np.einsum("i,ij,ik->jk", *(one[model.by_matrix["H"]] for one in (p, model.B, model.D)))
        driven = parts.G + 1j * w * parts.F - w**2 * parts.J + 1j * hysteretic
        np.testing.assert_allclose(-stiffness(model, p, OMEGA)[..., model.n :], driven, rtol=1e-12)

    def test_batches_are_loops(self, model: Model, p: np.ndarray) -> None:
        rng = np.random.default_rng(5)
        batch = p * rng.uniform(0.5, 1.5, size=(3, 2, len(p)))
        U, f = drive(model, len(OMEGA), 3, 2)
        X = response(model, batch, OMEGA, U, f)
        S = sensitivities(model, batch, OMEGA, X, U)
        M = matrices(model, batch).M
        for i in np.ndindex(3, 2):
            one = response(model, batch[i], OMEGA, U[i], f[i])
            np.testing.assert_allclose(X[i], one, rtol=1e-12)
            np.testing.assert_allclose(
                S[i], sensitivities(model, batch[i], OMEGA, one, U[i]), rtol=1e-10, atol=1e-15
            )
            np.testing.assert_array_equal(M[i], matrices(model, batch[i]).M)

    def test_sensitivities_of_the_response(self, model: Model, p: np.ndarray) -> None:
        U, f = drive(model, len(OMEGA))
        S = sensitivities(model, p, OMEGA, response(model, p, OMEGA, U, f), U)
        for i, step in enumerate(1e-5 * p):
            more, less = p.copy(), p.copy()
            more[i] += step
            less[i] -= step
            slope = (response(model, more, OMEGA, U, f) - response(model, less, OMEGA, U, f)) / (2 * step)
            np.testing.assert_allclose(S[..., i], slope, atol=2e-8 * np.max(np.abs(slope)))

    def test_sensitivities_of_the_eigenvalues(self, model: Model, p: np.ndarray) -> None:
        S = eigenmodes(model, p).sensitivity
        for i, step in enumerate(1e-5 * p):
            more, less = p.copy(), p.copy()
            more[i] += step
            less[i] -= step
            slope = (eigenmodes(model, more).eigenvalues - eigenmodes(model, less).eigenvalues) / (2 * step)
            np.testing.assert_allclose(S[:, i], slope, atol=1e-6 * np.max(np.abs(S[:, i])) + 1e-12)

    def test_modes_solve_the_eigenvalue_problem(self, model: Model, p: np.ndarray) -> None:
        parts, found = matrices(model, p), eigenmodes(model, p)
        for value, shape in zip(found.eigenvalues, found.shapes, strict=True):
            terms = [value**2 * parts.M @ shape, value * parts.C @ shape, (parts.K + 1j * parts.H) @ shape]
            np.testing.assert_allclose(sum(terms), 0, atol=1e-9 * np.max(np.abs(terms)))
            assert np.max(np.abs(shape)) == pytest.approx(1.0)


def _pair(a: float, b: float, c: float) -> list[complex]:
    """Roots of a s² + b s + c with no negative imaginary part, the slowest first."""
    roots = np.roots([a, b, c])
    return sorted(roots[roots.imag >= 0].tolist(), key=abs)


# Rigs whose eigenvalues are known, by what is special about them.
KNOWN: dict[str, tuple[str | list[Element], list[complex]]] = {
    **{f"one mass, c = {c}": (f"m@x=1 k:x-ground=100 c:x-ground={c}", _pair(1, c, 100)) for c in (0, 3, 20, 50)},
    "an inerter is a mass between points": ("m@x=1 b:x-ground=3 k:x-ground=100", [5j]),
    "hysteretic: m λ² + k (1 + jη) = 0": ("m@x=2 k:x-ground=100 h:x-ground=5", [1j * np.sqrt((100 + 5j) / 2)]),
    # Maxwell's element: m s² + k c s / (k + c s) = 0, so s = 0 and m c s² + m k s + k c = 0.
    "no mass between spring and damper": ("m@x=3 k:x-y=100 c:y-ground=5", [0, *_pair(15, 300, 500)]),
    "no mass between two springs": ("m@x=3 k1:x-y=100 k2:y-ground=25", [1j * np.sqrt(20 / 3)]),
    # Springs at the ends of a massless lever, m at the point 0.3 a + 0.7 b: in series, seen through the arms.
    "a mass on a lever": (
        [
            Element("m", Kind.MASS, {"a": 0.3, "b": 0.7}, value=3.0), spring("k", "a", value=100.0),
            spring("q", "b", value=5.0),
        ],
        [1j * np.sqrt(1 / (0.3**2 / 100 + 0.7**2 / 5) / 3)],
    ),
    # m, J on two springs k at ±d: √(2k/m) and √(2kd²/J), coordinates of different size.
    "bounce and pitch": (
        [
            mass("m", "x", value=1200.0), mass("J", "pitch", value=2000.0),
            Element("front", Kind.SPRING, {"x": 1.0, "pitch": 1.4}, value=3e4),
            Element("rear", Kind.SPRING, {"x": 1.0, "pitch": -1.4}, value=3e4),
        ],
        [1j * np.sqrt(6e4 / 1200), 1j * np.sqrt(6e4 * 1.4**2 / 2000)],
    ),
    "coordinates of very different size": (
        "m@x=1e4 k:x-ground=1e6 m2@y=1e-7 k2:y-ground=1e-4", [10j, 1j * np.sqrt(1000)],
    ),
    "a free body has a double zero": ("m@x=3 m2@y=3 k:x-y=100", [0, 0, 1j * np.sqrt(200 / 3)]),
    "a free body with a damper": ("m@x=3 m2@y=3 k:x-y=100 c:x-y=1", [0, 0, *_pair(3, 2, 200)]),
    "a spring and a damper without mass": ("k:x-ground=10 c:x-ground=5", [-2.0]),
    "a spring alone": ("k:x-ground=10", []),
}  # fmt: skip


class TestKnownRigs:
    def one(self, *elements: Element) -> np.ndarray:
        points = dict.fromkeys(point for element in elements for point in element.along)
        model = Model(tuple(points), (), elements)
        found = eigenmodes(model, model.p0)
        with np.errstate(all="raise"):
            assert np.all(np.isfinite(found.damping_ratio))
        return np.asarray(found.eigenvalues)

    def test_the_rig_of_the_paper(self) -> None:
        found = eigenmodes(PAPER, PAPER_P)
        np.testing.assert_allclose(found.eigenvalues, [-16.0460 + 18.6229j, -26.1762 + 60.3144j], atol=5e-5)
        magnitude = np.hypot([16.0460, 26.1762], [18.6229, 60.3144])
        np.testing.assert_allclose(found.frequency_hz, magnitude / (2 * np.pi), rtol=1e-5)
        np.testing.assert_allclose(found.damping_ratio, [16.0460, 26.1762] / magnitude, rtol=1e-5)

    def test_the_matrices_of_the_paper(self) -> None:
        parts = matrices(PAPER, PAPER_P)
        np.testing.assert_array_equal(parts.M, [[3.0, 0], [0, 2.7]])
        np.testing.assert_array_equal(parts.C, [[120.0, -30], [-30, 120]])
        np.testing.assert_array_equal(parts.K, [[4600.0, -4600], [-4600, 9200]])
        np.testing.assert_array_equal(parts.F, [[0.0], [40]])
        np.testing.assert_array_equal(parts.G, [[0.0], [4600]])

    def test_the_base_moves_the_rig_along_when_slow(self) -> None:
        free = PAPER_P * np.where([e.name in ("c3", "c4") for e in PAPER.elements], 0.0, 1.0)
        X = response(PAPER, free, np.array([1e-6]), np.ones((1, 1), complex))
        np.testing.assert_allclose(X, 1.0, rtol=1e-9)

    @pytest.mark.parametrize(("parts", "expected"), KNOWN.values(), ids=KNOWN)
    def test_eigenvalues_in_closed_form(self, parts: str | list[Element], expected: list[complex]) -> None:
        found = self.one(
            *(
                network("x y" if "y" in parts else "x", "", parts).elements
                if isinstance(parts, str)
                else parts
            )
        )
        np.testing.assert_allclose(
            found, expected, rtol=1e-6 if "c:x-ground=20" in parts else 1e-9, atol=1e-9
        )

    def test_hysteretic_loss_does_not_depend_on_the_frequency(self) -> None:
        model = Model(
            ("x",), (Input("f", "force", {"x": 1.0}),), (between("h", Kind.HYSTERETIC, "x", "ground"),)
        )
        X = response(
            model,
            np.array([5.0]),
            OMEGA,
            np.zeros((len(OMEGA), 0), complex),
            np.ones((len(OMEGA), 1), complex),
        )
        np.testing.assert_allclose(X[:, 0], -0.2j)

    def test_a_rig_of_zeros(self) -> None:
        with pytest.raises(ModelError, match="no modes"):
            self.one(spring("k", "x", value=0.0))


class TestSolve:
    @pytest.mark.parametrize("n", [1, 2, 3, 5])
    def test_against_lapack(self, n: int) -> None:
        rng = np.random.default_rng(n)
        matrix = rng.normal(size=(4, 3, n, n)) + 1j * rng.normal(size=(4, 3, n, n))
        right = rng.normal(size=(4, 3, n, 2)) + 0j
        np.testing.assert_allclose(solve_small(matrix, right), np.linalg.solve(matrix, right), rtol=1e-9)

    @pytest.mark.parametrize("n", [1, 2, 3])
    def test_singular(self, n: int) -> None:
        matrix = np.ones((2, n, n)) * np.array([1.0, 0.0])[:, None, None] + 0j
        matrix[0] += np.eye(n)
        found = solve_small(matrix, np.ones((2, n, 1), complex))
        np.testing.assert_allclose(found[0], 1 / (n + 1))
        assert np.all(np.isnan(found[1]))

    def test_an_undamped_resonance(self) -> None:
        model = Model(("x",), (Input("u"),), (mass("m", "x"), spring("k", "x", "u")))
        with pytest.raises(ModelError, match="no steady state"):
            response(model, np.array([1.0, 100.0]), np.array([10.0]), np.ones((1, 1), complex))
