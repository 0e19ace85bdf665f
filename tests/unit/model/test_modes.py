"""Modes: those of many rigs are those of each, and their slopes are those of differences."""

import numpy as np
import pytest

from dashpot.model.elements import Kind
from dashpot.model.modes import eigenmodes, eigenpairs, mode_sensitivities
from tests.rigs import Rig, random_rig


def swinging(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and shapes of the modes that swing, by frequency."""
    found = eigenmodes(rig.model, rig.p)
    there = found.eigenvalues.imag > 1e-6 * np.abs(found.eigenvalues)
    return found.eigenvalues[there], found.shapes[there]


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_slopes_of_eigenvalues_and_shapes_are_those_of_differences(n: int) -> None:
    """All kinds of elements, levers and ties: to 1e-6 of the largest of each mode, by central differences."""
    rng = np.random.default_rng(40 + n)
    for _ in range(3):
        rig = random_rig(rng, n, displacements=1)
        p = rig.p
        values, shapes = swinging(rig)
        shapes = shapes / np.linalg.norm(shapes, axis=-1, keepdims=True)
        dlam, dphi = mode_sensitivities(rig.model, p, values, shapes)
        for e in range(len(p)):
            h = 1e-5 * p[e]
            ends = []
            for sign in (1, -1):
                q = p.copy()
                q[e] += sign * h
                lam, phi = (a[0] for a in eigenpairs(rig.model, q[None]))
                at = [int(np.argmin(np.abs(lam - value))) for value in values]
                own = phi[at]
                # Scaled so that φᴴ stays the same along φ, as the slope has it.
                own = own / np.einsum("ki,ki->k", np.conj(shapes), own)[:, None]
                ends.append((lam[at], own))
            slope = (ends[0][0] - ends[1][0]) / (2 * h)
            assert np.allclose(dlam[:, e] * p[e], slope * p[e], atol=1e-6 * np.max(np.abs(values)))
            turned = (ends[0][1] - ends[1][1]) / (2 * h)
            reach = max(1.0, float(np.max(np.abs(dphi[..., e]))) * p[e])
            assert np.allclose(dphi[..., e] * p[e], turned * p[e], atol=1e-6 * reach)


def test_eigenpairs_are_those_of_one_rig_at_a_time() -> None:
    rng = np.random.default_rng(3)
    for n in (1, 2, 4):
        rig = random_rig(rng, n, displacements=1)
        p = rig.p * np.exp(0.1 * rng.standard_normal((4, len(rig.p))))
        values, shapes = eigenpairs(rig.model, p)
        for k in range(4):
            own = eigenmodes(rig.model, p[k])
            for value, shape in zip(own.eigenvalues, own.shapes, strict=True):
                if value.imag <= 1e-6 * abs(value):
                    continue
                j = int(np.argmin(np.abs(values[k] - value)))
                assert abs(values[k, j] - value) < 1e-9 * abs(value)
                cosine = (
                    abs(np.vdot(shapes[k, j], shape)) / np.linalg.norm(shapes[k, j]) / np.linalg.norm(shape)
                )
                assert cosine > 1 - 1e-9


def test_a_rig_that_overflows_has_no_modes_and_costs_the_others_nothing() -> None:
    rig = random_rig(np.random.default_rng(4), 3, displacements=1)
    assert np.all(rig.p > 0)
    p = np.stack([rig.p, rig.p, rig.p])
    masses = [i for i, kind in enumerate(rig.model.kinds) if kind is Kind.MASS]
    p[1] = 1e308
    p[1, masses] = np.geomspace(1e-300, 1e300, len(masses))
    with np.errstate(all="ignore"):
        values, shapes = eigenpairs(rig.model, p)
    assert not np.any(np.isfinite(values[1]))
    own = eigenpairs(rig.model, rig.p[None])
    for k in (0, 2):
        assert np.array_equal(values[k], own[0][0])
        assert np.array_equal(shapes[k], own[1][0])


def test_a_rig_without_dampers_has_no_damping_but_for_negative_springs() -> None:
    """It had 1e-16, and now and then an "unstable" mode of -1.6e-16."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        rig = random_rig(rng, 4, displacements=1)
        springs = np.array([kind in (Kind.MASS, Kind.SPRING) for kind in rig.model.kinds])
        found = eigenmodes(rig.model, np.where(springs, rig.p, 0.0))
        assert not np.any(found.damping_ratio)
    falling = eigenmodes(
        rig.model, np.where(np.array(rig.model.kinds) == Kind.SPRING, -rig.p, rig.p * springs)
    )
    assert np.all(falling.eigenvalues.imag == 0)
