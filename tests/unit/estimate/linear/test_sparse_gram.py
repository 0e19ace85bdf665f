"""The Gram on the pattern of meeting elements: the dense twin, the truth without noise, intervals that hold."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dashpot.errors import DataError, IdentifiabilityError, UsageError
from dashpot.estimate.linear.gram import regressors
from dashpot.estimate.linear.sparse_gram import MeetingPairs, SeenMotion, identify_seen
from dashpot.model.dynamics import amplitudes, stiffness, unit_forces
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from tests.rigs import random_rig

NOISE = 0.01


def chain(n: int) -> tuple[Model, np.ndarray]:
    """Masses on a chain of springs, each on a known spring and a damper to the shaken base; and the truth."""
    rng = np.random.default_rng(n)
    numbers = range(1, n + 1)
    elements = [mass(f"m{i}", f"x{i}") for i in numbers]
    elements += [between(f"k{i}", Kind.SPRING, f"x{i}", f"x{i + 1}" if i < n else "ground") for i in numbers]
    elements += [between(f"c{i}", Kind.DAMPER, f"x{i}", "u") for i in numbers]
    elements += [between(f"f{i}", Kind.SPRING, f"x{i}", "u", value=3000.0) for i in numbers]
    model = Model(tuple(f"x{i}" for i in numbers), (Input("u"),), tuple(elements))
    size = {"m": 1.0, "k": 4000.0, "c": 30.0}
    return model, np.array([size[u.name[0]] * np.exp(rng.uniform(-0.5, 0.5)) for u in model.unknowns])


def seen(model: Model, theta: np.ndarray, lines: int = 12) -> SeenMotion:
    """Its exact motion on a base moved by 10 mm, with the variances that noise of 1 % will have."""
    omega = 2 * np.pi * np.linspace(4, 22, lines)
    U, f = np.full((lines, 1), 0.01 + 0j), np.zeros((lines, 0), dtype=complex)
    X = amplitudes(model, model.parameters(theta), omega, U, f)
    return SeenMotion(omega, X, U, f, (NOISE * np.abs(X)) ** 2, np.zeros((lines, 1)), np.zeros((lines, 0)))


def noisy(motion: SeenMotion, rng: np.random.Generator) -> SeenMotion:
    draw = rng.standard_normal(motion.X.shape) + 1j * rng.standard_normal(motion.X.shape)
    return replace(motion, X=motion.X + np.sqrt(motion.var_X / 2) * draw)


@pytest.mark.parametrize("seed", range(3))
def test_the_normal_matrix_is_that_of_the_dense_regressors(seed: int) -> None:
    """Random rigs with levers, ties and hysteretic dampers; any instruments, any weights."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 4, displacements=1, forces=seed % 2)
    lines = len(rig.omega)

    def some(*shape: int) -> np.ndarray:
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    X, U = some(lines, 4), some(lines, 1)
    a = unit_forces(rig.model, rig.omega, X, U)
    w, weight = some(*a.shape), rng.random((lines, 4))
    Phi, Psi = (regressors(rig.model, forces) for forces in (a, w))
    dense = np.einsum("lnj,ln,lnk->jk", np.conj(Psi), weight, Phi).real + np.diag(rig.model.prior_precision)
    N = MeetingPairs.of(rig.model).normal(rig.model, w, a, weight)
    np.testing.assert_allclose(N.toarray(), dense, rtol=1e-10, atol=1e-12 * np.max(np.abs(dense)))


def test_without_noise_the_truth() -> None:
    model, theta = chain(40)
    motion = replace(seen(model, theta), var_X=np.zeros((12, 40)))
    found = identify_seen(model, motion)
    assert found.converged
    np.testing.assert_allclose(found.values, theta, rtol=1e-6)
    assert np.isnan(found.sd).all()


def test_applied_forces_fix_the_scale() -> None:
    model, theta = chain(15)
    pushed = Model(
        model.coordinates, (*model.inputs, Input("p", "force", {"x3": 1.0, "x9": -2.0})), model.elements
    )
    omega = 2 * np.pi * np.linspace(4, 22, 9)
    U, f = np.full((9, 1), 0.01 + 0j), np.full((9, 1), 20.0 + 5j)
    X = amplitudes(pushed, pushed.parameters(theta), omega, U, f)
    small = 1e-12 * np.abs(X) ** 2
    found = identify_seen(pushed, SeenMotion(omega, X, U, f, small, np.zeros((9, 1)), np.full((9, 1), 1e-6)))
    np.testing.assert_allclose(found.values, theta, rtol=1e-5)


def test_standard_deviations_are_those_of_the_sandwich() -> None:
    """N⁻¹ (½ Σ Re Ψᴴ W Cov(e) W Ψ) N⁻ᵀ, multiplied out with full matrices at the estimate."""
    model, theta = chain(6)
    motion = noisy(seen(model, theta), np.random.default_rng(5))
    motion = replace(motion, var_U=np.full((12, 1), 1e-9))
    names = [unknown.name for unknown in model.unknowns]
    found = identify_seen(model, motion, names)
    p = model.parameters(found.values)
    X = amplitudes(model, p, motion.omega, motion.U, motion.f)
    Psi = regressors(model, unit_forces(model, motion.omega, X, motion.U))
    Phi = regressors(model, unit_forces(model, motion.omega, motion.X, motion.U))
    both = stiffness(model, p, motion.omega)
    Se = np.einsum(
        "lij,lj,lkj->lik", both, np.concatenate([motion.var_X, motion.var_U], axis=1), np.conj(both)
    )
    W = 1 / np.diagonal(Se, axis1=1, axis2=2).real
    inverse = np.linalg.inv(np.einsum("lnj,ln,lnk->jk", np.conj(Psi), W, Phi).real)
    middle = np.einsum("lnj,ln,lnm,lm,lmk->jk", np.conj(Psi), W, Se, W, Psi).real / 2
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(inverse @ middle @ inverse.T)), rtol=1e-8)


@pytest.mark.long
def test_errors_have_the_size_that_is_stated() -> None:
    """100 draws of ten coordinates, seed 1: squared errors over stated variances, to 3.5 standard errors."""
    model, theta = chain(10)
    exact, rng = seen(model, theta), np.random.default_rng(1)
    names = [unknown.name for unknown in model.unknowns]
    z = []
    for _ in range(100):
        found = identify_seen(model, noisy(exact, rng), names)
        assert found.converged
        z.append((found.values - theta) / found.sd)
    per_draw = np.mean(np.square(z), axis=1)
    assert abs(np.mean(per_draw) - 1) < 3.5 * np.std(per_draw) / 10
    assert np.std(per_draw) / 10 < 0.04  # so that sd wrong by 10 % shows
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.03)


def test_its_json_leaves_out_what_would_not_fit() -> None:
    model, theta = chain(10)
    found = identify_seen(model, noisy(seen(model, theta), np.random.default_rng(2)), ["k3", "m1"])
    content = json.loads(found.to_json())
    assert content["covariance"] is None
    assert content["parameters"]["k3"]["sd"] == pytest.approx(float(found.sd[12]))
    assert content["parameters"]["k4"]["sd"] is None
    assert content["parameters"]["k4"]["value"] == pytest.approx(theta[13], rel=0.2)
    assert found.residual == pytest.approx(np.sqrt(1 - 30 / 240), abs=0.15)


def test_what_cannot_be_found_is_said() -> None:
    model, theta = chain(5)
    motion = seen(model, theta)
    with pytest.raises(UsageError, match="q7 is not an unknown"):
        identify_seen(model, motion, ["q7"])
    with pytest.raises(DataError, match="X has a gap"):
        replace(motion, X=np.full_like(motion.X, np.nan))
    with pytest.raises(IdentifiabilityError):
        identify_seen(model, replace(motion, X=np.zeros_like(motion.X), U=np.zeros_like(motion.U)))
