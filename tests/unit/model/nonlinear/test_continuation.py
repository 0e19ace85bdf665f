"""Curves through folds, stability and backbones, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.special import ellipk

from dashpot.channel import Channel
from dashpot.errors import ConvergenceError, UsageError
from dashpot.model.elements import Kind, between
from dashpot.model.modes import eigenmodes
from dashpot.model.nonlinear import continuation
from dashpot.model.nonlinear import continuation as stability
from dashpot.model.nonlinear.continuation import (
    amplitude_sweep,
    backbone,
    channel_harmonics,
    floquet_multipliers,
    followed,
    frequency_sweep,
    stable_motions,
    swing,
)
from dashpot.model.nonlinear.force_law import force_law
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.model.nonlinear.harmonics import Drive
from tests.networks import network
from tests.nonlinear_rigs import two_masses

DUFFING = np.array([1.0, 1.0, 0.05, 1.0])


def duffing(law="cubic"):
    joint = between("k3", Kind.SPRING, "x", "ground")
    return network("x", "f@x", "m@x k:x-ground c:x-ground", replace(joint, force_law=force_law(law)))


def pushed(omega, force, orders):
    f = np.zeros((1, orders + 1, 1), dtype=complex)
    f[0, 1, 0] = force
    return Drive(np.array([omega]), np.zeros((1, orders + 1, 0), dtype=complex), f)


@pytest.mark.slow
def test_folds_of_a_duffing_oscillator_stand_where_one_harmonic_has_them():
    """F = (1 − ω² + 3/4 A)² A + c² ω² A − f² = 0 with A = a², and ∂F/∂A = 0 (Nayfeh and Mook 1979, section 4.1)."""

    def equations(z):
        squares, A = z
        s = 1 - squares + 0.75 * A
        return [s**2 * A + 0.0025 * squares * A - 0.09, s**2 + 1.5 * A * s + 0.0025 * squares]

    curve = followed(duffing(), DUFFING, frequency_sweep(pushed(0.8, 0.3, 1), 3.0))
    assert len(curve.folds) == 2
    for fold in curve.folds:
        omega, size = curve.drive.omega[fold], np.abs(curve.motion.X[fold, 1, 0])
        exact = fsolve(equations, [omega**2, size**2], xtol=1e-12)
        assert omega == pytest.approx(np.sqrt(exact[0]), rel=1e-3)
    assert curve.along[0] == 0
    assert curve.along[-1] == 1


def test_a_curve_along_the_amplitude_turns_twice_where_three_motions_are_possible():
    curve = followed(duffing(), DUFFING, amplitude_sweep(pushed(2.0, 0.1, 3), 30.0))
    force = np.abs(curve.drive.f[:, 1, 0])
    assert len(curve.folds) == 2
    assert force[curve.folds[0]] > force[curve.folds[1]]
    middle = slice(int(curve.folds[0]) + 1, int(curve.folds[1]) - 1)
    assert not np.any(curve.stable[middle])
    assert np.all(curve.stable[: int(curve.folds[0]) - 1])
    assert np.all(curve.stable[int(curve.folds[1]) + 1 :][:20])


def test_multipliers_are_those_of_the_modes_where_the_nonlinear_force_is_nothing():
    model, theta = two_masses("cubic")
    theta = np.where(np.arange(len(theta)) == 5, 0.0, theta)
    U = np.zeros((1, 4, 1), dtype=complex)
    U[0, 1] = 1e-3
    drive = Drive(np.array([2 * np.pi * 3.0]), U, np.zeros((1, 4, 0), dtype=complex))
    at = periodic_response(model, model.parameters(theta)[None], np.zeros((1, 0)), drive)
    found = floquet_multipliers(model, theta, drive, at)[0]
    linear = replace(model, elements=model.elements[:-1])
    poles = eigenmodes(linear, linear.parameters(theta[:5])).eigenvalues
    expected = np.exp(np.concatenate([poles, np.conj(poles)]) / 3.0)
    assert np.allclose(np.sort(np.abs(found)), np.sort(np.abs(expected)), rtol=1e-9)


def driven(model, theta, amplitude, orders):
    """The drive and the motions of a base that moves at 3 and at 7 Hz."""
    U = np.zeros((2, orders + 1, 1), dtype=complex)
    U[:, 1] = amplitude
    drive = Drive(2 * np.pi * np.array([3.0, 7.0]), U, np.zeros((2, orders + 1, 0), dtype=complex))
    rows = np.tile(model.parameters(theta), (2, 1)), np.tile(model.inner_constants(theta), (2, 1))
    return drive, periodic_response(model, *rows, drive)


@pytest.mark.parametrize("law", ["jenkins", "coulomb", "bouc-wen"])
def test_motions_that_lose_energy_are_stable(law):
    model, theta = two_masses(law)
    drive, at = driven(model, theta, 1e-3, orders=21)
    assert np.all(stable_motions(model, theta, drive, at))


def test_the_backbone_of_a_duffing_oscillator_is_elliptic():
    """ω = π √(1 + A²) / (2 K(A² / 2 (1 + A²))) for m = k = k₃ = 1 (Nayfeh and Mook 1979, section 2.2)."""
    model = duffing()
    curve = backbone(model, DUFFING, 0, 2.0, orders=9)
    channels = (Channel("x", {"x": 1.0}),)
    size = swing(channel_harmonics(model, model.parameters(DUFFING), channels, curve.drive, curve.motion))[
        :, 0
    ]
    expected = np.pi * np.sqrt(1 + size**2) / (2 * ellipk(size**2 / (2 * (1 + size**2))))
    assert np.max(np.abs(curve.drive.omega / expected - 1)) < 1e-7


def test_a_rig_without_a_nonlinear_spring_has_no_backbone():
    with pytest.raises(UsageError, match="no nonlinear spring"):
        backbone(duffing("v**3"), DUFFING, 0, 1.0)


@pytest.mark.parametrize("law", ["cubic", "v*abs(v)", "coulomb"])
def test_multipliers_along_the_motion_are_those_of_integration(law, monkeypatch):
    model, theta = two_masses(law)
    drive, at = driven(model, theta, 2e-3, orders=11)
    along = floquet_multipliers(model, theta, drive, at)
    monkeypatch.setattr(stability, "_along_motions", stability._integrated)
    integrated = floquet_multipliers(model, theta, drive, at)
    assert np.allclose(np.abs(along), np.abs(integrated), rtol=0, atol=1e-6)
    assert np.all(np.abs(along) < 1)


def test_a_curve_that_winds_on_and_on_is_refused(monkeypatch):
    monkeypatch.setattr(continuation, "TURNS", 20)
    monkeypatch.setattr(continuation, "ROWS", 20)
    with pytest.raises(ConvergenceError, match="cannot be followed"):
        followed(duffing(), DUFFING, frequency_sweep(pushed(0.8, 0.3, 1), 3.0))
