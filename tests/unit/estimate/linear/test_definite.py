"""Free symmetric M, C, K: against the entries of the true matrices, plain least squares, Monte Carlo, and the cone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from dashpot.channel import Quantity
from dashpot.errors import ModelError
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.gram import auxiliary
from dashpot.estimate.linear.instrumental_variables import (
    DefiniteOptimalIV,
    FreeMatrices,
    OptimalIV,
    matrices_of,
)
from dashpot.estimate.linear.least_squares import HarmonicLeastSquares
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Kind, between, mass
from dashpot.model.matrix_elements import free_model
from dashpot.model.network import Input, Model
from tests.rigs import Rig, channels, covariance, noisy, perfect, states

X = ("x1", "x2", "x3")
CHAIN = [("x1", "x2"), ("x2", "x3")]
K = 1000.0 * np.array([[3.0, -1.5, 0.0], [-1.5, 2.7, -1.2], [0.0, -1.2, 1.2]])
M = np.array([[2.0, 0.3, 0.0], [0.3, 1.5, 0.2], [0.0, 0.2, 1.0]])
C = 2e-3 * K + 0.4 * M


def truth(model, M, C, K) -> np.ndarray:
    """θ of free_model that has these matrices, solved from the entries."""
    target = np.concatenate([a[np.triu_indices(len(M))] for a in (M, C, K)])
    eye = np.eye(len(model.unknowns))
    parts = matrices(model, model.parameters(eye))
    upper = np.triu_indices(len(M))
    L = np.concatenate([a[:, *upper] for a in (parts.M, parts.C, parts.K)], axis=1).T
    theta, *_ = np.linalg.lstsq(L, target, rcond=None)
    assert np.allclose(L @ theta, target)
    return theta


def definite(found: FreeMatrices) -> np.ndarray:
    """Whether M, C and K are positive semidefinite to rounding, (...,)."""
    values = [np.linalg.eigvalsh(matrix) for matrix in (found.M, found.C, found.K)]
    return np.all([each[..., 0] >= -1e-12 * np.abs(each[..., -1]) for each in values], axis=0)


def rig_of(model, M=M, C=C, K=K, lines=14, level=2.0) -> Rig:
    f = np.geomspace(1.5, 14.0, lines)
    force = level * np.exp(1j * np.arange(lines))[:, None] * np.ones((1, len(model.force_inputs)))
    force = force * np.exp(1j * np.outer(np.arange(lines), np.arange(force.shape[1])))
    return Rig(model, truth(model, M, C, K), f, np.zeros((lines, 0), dtype=complex), force)


def at(*points: str) -> list[Input]:
    return [Input(f"f{i + 1}", "force", {x: 1.0}) for i, x in enumerate(points)]


@pytest.mark.parametrize("pairs", [None, {"M": CHAIN, "C": CHAIN, "K": CHAIN}])
def test_exact_data_of_one_force_give_all_matrices_back(pairs) -> None:
    """One force is enough where all coordinates are measured at enough frequencies; all symmetric or tridiagonal."""
    model = free_model(X, at("x3"), pairs=pairs)
    assert len(model.unknowns) == (18 if pairs is None else 15)
    rig = rig_of(model)
    found = matrices_of(model, identify(model, perfect(rig, channels(rig))))
    for name, true in (("M", M), ("C", C), ("K", K)):
        assert np.allclose(getattr(found, name), true, rtol=1e-6, atol=1e-8 * np.max(true))
    assert definite(found)


def test_least_squares_is_that_of_okuma_and_nagamatsu_written_out() -> None:
    """(−ω²M + jωC + K) X = f as linear equations in the upper triangles, real over imaginary part."""
    model = free_model(X, at("x1", "x3"))
    rig = rig_of(model)
    ch = channels(rig)
    spectrum = noisy(rig, ch, covariance(rig, ch, 0.01), np.random.default_rng(1))
    rows, right = [], []
    upper = list(zip(*np.triu_indices(3), strict=True))
    for line, w in enumerate(rig.omega):
        x, f = spectrum.amplitudes[line, :3], model.S @ spectrum.amplitudes[line, 3:]
        block = np.zeros((3, 18), dtype=complex)
        for g, law in enumerate((-(w**2), 1j * w, 1.0)):
            for e, (i, j) in enumerate(upper):
                block[i, 6 * g + e] += law * x[j]
                if i != j:
                    block[j, 6 * g + e] += law * x[i]
        rows += [block.real, block.imag]
        right += [f.real, f.imag]
    A = np.concatenate(rows)
    size = np.linalg.norm(A, axis=0)
    entries = np.linalg.lstsq(A / size, np.concatenate(right), rcond=None)[0] / size
    found = matrices_of(model, identify(model, spectrum, HarmonicLeastSquares()))
    for g, name in enumerate("MCK"):
        own = getattr(found, name)
        assert np.allclose(
            [own[i, j] for i, j in upper],
            entries[6 * g : 6 * g + 6],
            rtol=1e-6,
            atol=1e-9 * np.max(np.abs(own)),
        )


def test_entries_have_the_covariance_that_the_intervals_count() -> None:
    """From `covariance`, which counts the misfit too: of uncorrelated unknowns that meet in an entry, variances add."""
    model = free_model(X, at("x3"), pairs={"M": [], "C": CHAIN, "K": CHAIN})
    rig = rig_of(model, np.diag([2.0, 1.5, 1.0]))
    ch = channels(rig)
    estimate = identify(model, noisy(rig, ch, covariance(rig, ch, 0.01), np.random.default_rng(6)))
    names = [unknown.name for unknown in model.unknowns]
    apart = replace(estimate, covariance=np.diag(np.arange(1.0, len(names) + 1)))
    variance = dict(zip(names, np.arange(1.0, len(names) + 1), strict=True))
    sd = matrices_of(model, apart).sd("K")
    assert sd[0, 0] == pytest.approx(np.sqrt(variance["k_x1"] + variance["k_x1_x2"]))
    assert sd[0, 1] == sd[1, 0] == pytest.approx(np.sqrt(variance["k_x1_x2"]))
    assert sd[0, 2] == 0


def test_entries_have_the_spread_and_the_coverage_they_state() -> None:
    """2,500 draws: sd of every entry to 5 % (standard error 1.4 %), at the bound; 95 % intervals in 94 to 96 %, to
    twice the binomial error of 0.44 points."""
    pairs = {"M": [], "C": CHAIN, "K": CHAIN}
    model = free_model(X, at("x1", "x3"), pairs=pairs)
    rig = rig_of(model, np.diag([2.0, 1.5, 1.0]))
    ch = channels(rig)
    draws = identify(model, noisy(rig, ch, covariance(rig, ch, 0.02), np.random.default_rng(8), 2500))
    found = matrices_of(model, draws)
    assert found.K.shape == (2500, 3, 3)
    for name, true in (("M", np.diag([2.0, 1.5, 1.0])), ("C", C), ("K", K)):
        sd, error = found.sd(name), getattr(found, name) - (true if name != "C" else C)
        moved = sd[0] > 0
        if name == "C":
            moved &= np.abs(C) > 0
        assert np.allclose(error.std(0)[moved] / np.median(sd, axis=0)[moved], 1, atol=0.05)
        covered = 100 * np.mean(np.abs(error) <= 1.959964 * sd, axis=0)[moved]
        assert np.all((covered >= 94) & (covered <= 96)), (name, covered)


WEAK = 2e-4 * K  # damping that the noise often makes indefinite


@pytest.fixture(scope="module")
def weak():
    """60 draws of a rig with so little damping that C̑ often is not definite: (rig, spectrum, free, on the cone)."""
    pairs = {"M": [], "C": CHAIN, "K": CHAIN}
    model = free_model(X, at("x3"), pairs=pairs)
    rig = rig_of(model, np.diag([2.0, 1.5, 1.0]), WEAK)
    ch = channels(rig)
    spectrum = noisy(rig, ch, covariance(rig, ch, 0.05), np.random.default_rng(3), 60)
    return (
        rig,
        spectrum,
        identify(model, spectrum, OptimalIV()),
        identify(model, spectrum, DefiniteOptimalIV()),
    )


def test_on_the_cone_all_matrices_are_definite_and_definite_ones_are_not_touched(weak) -> None:
    rig, _, free, held = weak
    inside = definite(matrices_of(rig.model, free))
    assert 10 <= np.sum(inside) <= 50  # both kinds are there
    assert np.all(held.converged)
    assert np.all(definite(matrices_of(rig.model, held)))
    assert np.array_equal(held.values[inside], free.values[inside])
    assert np.all(np.max(np.abs(held.values - free.values)[~inside], axis=-1) > 0)


@pytest.mark.slow
def test_on_the_cone_the_likelihood_is_the_largest_that_a_cholesky_parametrisation_finds(weak) -> None:
    """Another way to the same point, from the truth: L of M = LLᵀ … as unknowns (a chain has no fill-in).

    χ² at its end is not below that on the cone by more than 0.001, nor above it by more than 0.1: at a matrix that is
    singular its slope is 0 on all sides, and it creeps.
    """
    rig, spectrum, free, held = weak
    model = rig.model

    def theta_of(q: np.ndarray) -> np.ndarray:
        c, k = (np.diag(part[:3]) + np.diag(part[3:], -1) for part in (q[3:8], q[8:]))
        return truth(model, np.diag(q[:3] ** 2), c @ c.T / 10, k @ k.T * 1000)

    start = np.concatenate([np.sqrt([2.0, 1.5, 1.0]), _factor(10 * WEAK), _factor(K / 1000)])
    assert np.allclose(theta_of(start), rig.theta)
    for k in np.flatnonzero(~definite(matrices_of(model, free)))[:4]:
        own = replace(spectrum, amplitudes=spectrum.amplitudes[k : k + 1])
        seen = states(model, own, own.covariance[None])

        def residuals(theta: np.ndarray, seen=seen) -> np.ndarray:
            at = auxiliary(model, model.parameters(theta[None]), seen)
            white = np.linalg.solve(np.linalg.cholesky(at.Se[0]), at.e[0][..., None]).ravel()
            return np.sqrt(2) * np.concatenate([white.real, white.imag])

        best = least_squares(lambda q: residuals(theta_of(q)), start, x_scale="jac", max_nfev=60)
        cost = [float(np.sum(residuals(e.values[k]) ** 2)) for e in (held, free)]
        assert cost[0] > cost[1] + 0.01
        assert -0.001 < 2 * best.cost - cost[0] < 0.1


def _factor(matrix: np.ndarray) -> np.ndarray:
    L = np.linalg.cholesky(matrix)
    return np.concatenate([np.diag(L), np.diag(L, -1)])


def test_on_the_cone_intervals_hold_the_truth_at_least_as_often(weak) -> None:
    """60 draws, 13 unknowns: 780 intervals, binomial error 0.8 points; those of C, where the cone helps, nearly always.

    With 1,000 draws: M and K 95.2 to 96.5 %, C 100 %.
    """
    rig, _, _, held = weak
    low, high = held.interval()
    covered = 100 * np.mean((low <= rig.theta) & (rig.theta <= high), axis=0)
    assert np.mean(covered) > 95
    assert np.all(covered > 90)
    assert np.min(covered[[name.startswith("c") for name in held.names]]) >= 98


def test_the_cone_is_reached_from_far_off() -> None:
    """All entries free, sharp resonances: the frequencies are known to 1e-6, and the start inside is 1,000 sd away."""
    model = free_model(X, at("x3"))
    rig = rig_of(model, C=1e-5 * K, lines=20, level=5.0)
    ch = channels(rig)
    spectrum = noisy(rig, ch, covariance(rig, ch, 0.01), np.random.default_rng(5), 12)
    free, held = identify(model, spectrum, OptimalIV()), identify(model, spectrum, DefiniteOptimalIV())
    outside = ~definite(matrices_of(model, free))
    assert np.sum(outside) >= 8
    assert np.all(held.converged)
    assert np.all(definite(matrices_of(model, held)))
    assert np.all(held.fit.chi2 - free.fit.chi2 < 30)


def test_chi2_is_that_of_the_definite_matrices(weak) -> None:
    rig, _, free, held = weak
    outside = ~definite(matrices_of(rig.model, free))
    assert np.any(outside)
    assert np.all(held.fit.chi2[outside] > free.fit.chi2[outside] + 1e-6)
    np.testing.assert_allclose(held.fit.chi2[~outside], free.fit.chi2[~outside], rtol=1e-6)


@pytest.mark.slow
def test_on_the_cone_a_batch_is_its_repeats(weak) -> None:
    """To a ten-thousandth of a standard deviation: cones are scaled by the batch, and the barrier knows their scale."""
    rig, spectrum, free, held = weak
    for k in np.flatnonzero(~definite(matrices_of(rig.model, free)))[:5]:
        alone = identify(rig.model, replace(spectrum, amplitudes=spectrum.amplitudes[k]), DefiniteOptimalIV())
        assert bool(alone.converged)
        assert np.max(np.abs(alone.values - held.values[k]) / held.sd[k]) < 1e-4


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_on_the_cone_units_of_force_do_not_matter(weak, factor: float) -> None:
    """Forces in other units: all parameters in those, to a ten-thousandth of a standard deviation."""
    rig, spectrum, _, held = weak
    forces = np.array([channel.quantity == Quantity.FORCE for channel in spectrum.channels])
    by = np.where(forces, factor, 1.0)
    other = replace(
        spectrum, amplitudes=(spectrum.amplitudes * by)[:8], covariance=spectrum.covariance * np.outer(by, by)
    )
    found = identify(rig.model, other, DefiniteOptimalIV())
    assert np.all(found.converged)
    assert np.max(np.abs(found.values / factor - held.values[:8]) / held.sd[:8]) < 1e-4


def test_letters_choose_the_matrices_that_are_held(weak) -> None:
    """Only C leaves the cone here: held to K and M alone, nothing changes."""
    rig, spectrum, free, _ = weak
    few = replace(spectrum, amplitudes=spectrum.amplitudes[:8])
    assert np.array_equal(identify(rig.model, few, DefiniteOptimalIV("MK")).values, free.values[:8])


def test_a_floating_ring_is_held_on_what_its_springs_span() -> None:
    """Three masses in a ring of springs, nothing to ground: K is singular for good, whatever its springs."""
    x = ("x1", "x2", "x3")
    ring = [("k1", "x1", "x2"), ("k2", "x2", "x3"), ("k3", "x3", "x1")]
    model = Model(
        x, (Input("f", "force", {"x1": 1.0}),),
        (*(mass(f"m{i}", at) for i, at in enumerate(x)), *(between(k, Kind.SPRING, a, b) for k, a, b in ring),
         between("c", Kind.DAMPER, "x1", "x2")),
    )  # fmt: skip
    f = np.geomspace(1.5, 14.0, 14)
    theta = np.array([1.0, 2.0, 1.5, 900.0, 700.0, 1200.0, 0.01])
    rig = Rig(model, theta, f, np.zeros((14, 0), dtype=complex), np.full((14, 1), 5.0 + 0j))
    ch = channels(rig)
    spectrum = noisy(rig, ch, covariance(rig, ch, 0.05), np.random.default_rng(2), 20)
    free, held = identify(model, spectrum, OptimalIV()), identify(model, spectrum, DefiniteOptimalIV())
    negative = free.values[:, 6] < 0
    assert 3 <= np.sum(negative) <= 17
    assert np.all(held.converged)
    assert np.array_equal(held.values[~negative], free.values[~negative])
    assert np.all((held.values[negative, 6] > 0) & (held.values[negative, 6] < 1e-4 * held.sd[negative, 6]))


def test_with_no_matrix_to_hold_the_free_estimate_is_the_answer() -> None:
    """Hysteretic dampers are in none of M, C and K: where they alone are unknown, there is no cone."""
    parts = (mass("m", "x1", value=2.0), between("k", Kind.SPRING, "x1", "ground", value=900.0))
    model = Model(
        ("x1",), (Input("f", "force", {"x1": 1.0}),), (*parts, between("h", Kind.HYSTERETIC, "x1", "ground"))
    )
    f = np.geomspace(1.5, 14.0, 8)
    rig = Rig(model, np.array([40.0]), f, np.zeros((8, 0), dtype=complex), np.full((8, 1), 5.0 + 0j))
    ch = channels(rig)
    spectrum = noisy(rig, ch, covariance(rig, ch, 0.05), np.random.default_rng(3))
    free, held = identify(model, spectrum, OptimalIV()), identify(model, spectrum, DefiniteOptimalIV())
    assert np.array_equal(held.values, free.values)


def test_bad_pairs_and_letters_are_refused() -> None:
    with pytest.raises(ModelError, match="not a pair"):
        free_model(X, at("x1"), pairs={"K": [("x1", "y")]})
    with pytest.raises(ModelError, match="not a matrix"):
        free_model(X, at("x1"), letters="MQ")
    model = free_model(X, at("x1"), letters="MK")
    assert {u.name[0] for u in model.unknowns} == {"m", "k"}
    rig = rig_of(free_model(X, at("x1", "x3")))
    other = identify(rig.model, perfect(rig, channels(rig)))
    with pytest.raises(ModelError, match="another model"):
        matrices_of(model, other)
