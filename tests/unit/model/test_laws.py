"""Laws of elements: what each kind declares, and that the dynamics rests on it alone."""

import numpy as np
import pytest

from dashpot import Element, Input, Kind, Model
from dashpot.model.dynamics import dynamic_stiffness, matrices
from dashpot.model.elements import MATRICES, Law

OMEGA = np.array([-7.0, 0.0, 0.5, 30.0])


def test_unit_forces_are_those_of_the_table_of_theory() -> None:
    expected = {
        Kind.SPRING: np.ones(4),
        Kind.DAMPER: 1j * OMEGA,
        Kind.MASS: -(OMEGA**2),
        Kind.INERTER: -(OMEGA**2),
        Kind.HYSTERETIC: 1j * np.sign(OMEGA),
    }
    for kind, phi in expected.items():
        np.testing.assert_allclose(kind.law.factor(OMEGA), phi, rtol=1e-15, atol=0)


@pytest.mark.parametrize("kind", list(Kind))
def test_the_law_at_a_pole_on_the_imaginary_axis_is_the_law_at_that_frequency(kind: Kind) -> None:
    omega = OMEGA[OMEGA > 0]
    np.testing.assert_allclose(kind.law.pole_factor(1j * omega), kind.law.factor(omega), rtol=1e-15)


@pytest.mark.parametrize("kind", list(Kind))
def test_the_unit_force_of_a_law_times_its_unit_is_a_force(kind: Kind) -> None:
    """In units of L, T and M of their own, p φ(ω) δ is M L / T² whatever the kind."""
    time = {"N/m": 2, "N·s/m": 1, "kg": 0}[kind.law.unit()]
    assert time == 2 - kind.law.power


@pytest.mark.parametrize("kind", list(Kind))
def test_each_kind_enters_the_matrix_that_it_declares_and_no_other(kind: Kind) -> None:
    model = Model(("x",), (Input("f", "force", {"x": 1.0}),), (Element("p", kind, {"x": 1.0}, value=3.0),))
    parts = matrices(model, np.array([3.0]))
    for letter in MATRICES:
        assert getattr(parts, letter)[0, 0] == (3.0 if letter == kind.law.matrix else 0.0)
    np.testing.assert_allclose(
        dynamic_stiffness(model, np.array([3.0]), OMEGA)[:, 0, 0], 3 * kind.law.factor(OMEGA), rtol=1e-15
    )


def test_typical_sizes_make_a_rig_with_that_frequency_and_damping() -> None:
    mass, rate, ratio = 3.0, 25.0, 0.04
    m, c, k = (kind.law.typical_size(mass, rate, ratio) for kind in (Kind.MASS, Kind.DAMPER, Kind.SPRING))
    pole = np.roots([m, c, k])[0]
    assert abs(pole) == pytest.approx(rate)
    assert -pole.real / abs(pole) == pytest.approx(ratio)
    H = Kind.HYSTERETIC.law.typical_size(mass, rate, ratio)
    assert pytest.approx(c * rate) == H  # the same loss at resonance


def test_a_law_is_a_value() -> None:
    assert Kind.MASS.law == Law(2, "M", "mass")
    assert Element("k", Kind.SPRING, {"x": 1.0}).law is Kind.SPRING.law
    with pytest.raises(AttributeError):
        Kind.MASS.law.power = 1  # type: ignore[misc]
