"""Modes with their deviations: the kernel against NumPy, and where it leaves them to NumPy."""

import numpy as np
import pytest

from dashpot.estimate.inference.uncertainty import mode_values
from dashpot.estimate.result import ModeValues
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.numerics.kernel import using
from tests.kernels import compiled
from tests.networks import network
from tests.rigs import random_rig

PARTS = ("eigenvalues", "frequency_hz", "damping_ratio", "frequency_sd", "damping_sd")


def _both(model: Model, theta: np.ndarray, covariance: np.ndarray) -> tuple[ModeValues, ModeValues]:
    with using("numpy"):
        twin = mode_values(model, theta, covariance)
    with using("compiled"):
        return mode_values(model, theta, covariance), twin


@pytest.mark.parametrize("seed", range(12))
def test_modes_of_the_kernel_are_those_of_numpy(seed: int) -> None:
    """Rigs of one to six coordinates with every kind of element, over-damped ones among them."""
    kernel = compiled()
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 1 + seed % 6, forces=1)
    model, theta = rig.model, rig.theta * np.exp(0.4 * rng.standard_normal(len(rig.theta)))
    root = 0.02 * theta[:, None] * rng.standard_normal((len(theta), len(theta)))
    modes, twin = _both(model, theta, root @ root.T)
    # Inerters couple masses: the kernel leaves such rigs to NumPy.
    coupled = any(element.kind is Kind.INERTER for element in model.elements)
    table = kernel.mode_values(model.B, model.letters, model.T, model.p0, theta, root @ root.T)
    assert coupled or table is not None
    for name in PARTS:
        np.testing.assert_allclose(getattr(modes, name), getattr(twin, name), rtol=1e-10, err_msg=name)
    np.testing.assert_allclose(modes.shapes, twin.shapes, atol=1e-10)


@pytest.mark.parametrize("damping", [0.0, 2.0, 60.0, 5000.0])
def test_modes_of_one_mass_are_the_formula(damping: float) -> None:
    """m = 2 kg, k = 800 N/m: λ = (−c ± √(c² − 4 m k)) / 2 m, two real ones above critical damping."""
    compiled()
    model = network("x", "u", "m@x c:x-u k:x-u")
    theta = np.array([2.0, damping, 800.0])
    with using("compiled"):
        modes = mode_values(model, theta, np.diag((0.01 * theta) ** 2))
    root = np.sqrt(complex(damping**2 - 6400))
    both = np.array([(-damping + root) / 4, (-damping - root) / 4])
    expected = both[:1] if root.imag else both
    np.testing.assert_allclose(modes.eigenvalues, expected[np.argsort(np.abs(expected))], rtol=1e-12)
    if not damping:  # var f / f² = (var k / k² + var m / m²) / 4
        np.testing.assert_allclose(modes.frequency_sd / modes.frequency_hz, 0.01 / np.sqrt(2), rtol=1e-12)


def test_no_damping_is_known_exactly() -> None:
    points = ("x", "y", "z")
    masses = (mass(f"m{p}", p) for p in points)
    springs = (
        between(f"k{p}", Kind.SPRING, p, to) for p, to in zip(points, ("y", "z", "ground"), strict=True)
    )
    model = Model(points, (Input("F", "force", {"x": 1.0}),), (*masses, *springs))
    theta = np.array([1.0, 2.0, 3.0, 4000.0, 5000.0, 6000.0])
    modes = mode_values(model, theta, np.diag((0.01 * theta) ** 2))
    assert np.all(modes.damping_sd == 0)
    assert np.all(modes.frequency_sd > 1e-3 * modes.frequency_hz)


def test_what_the_kernel_leaves_to_numpy() -> None:
    """A coordinate without mass, and a rigid-body motion: the same modes by either choice."""
    kernel = compiled()
    for parts in ("m1@x m2@y k:x-y c:x-y", "m@x k1:x-y k2:y-ground c:x-ground"):
        model, theta = network("x y", "F@x", parts), np.array([2.0, 3.0, 500.0, 4.0])
        covariance = np.diag((0.01 * theta) ** 2)
        assert kernel.mode_values(model.B, model.letters, model.T, model.p0, theta, covariance) is None
        modes, twin = _both(model, theta, covariance)
        for name in (*PARTS, "shapes"):
            np.testing.assert_array_equal(getattr(modes, name), getattr(twin, name))
