"""Least squares and instruments on measured harmonics: Yasuda and Watanabe's kind of test, a cubic spring and quadratic
damping of a two-coordinate rig."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.nonlinear.regression import harmonic_equations
from dashpot.estimate.preparation import prepare
from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.force_law import force_law
from tests.nonlinear_rigs import motions, noisy, settled, two_masses

FREQUENCIES = [2, 3, 4, 5, 6, 7, 8, 9.5, 11, 12.5, 14]
ALL = motions("x1", "x2", "u")


def rig():
    """The upper mass hangs on a cubic spring and a quadratic damper as well."""
    model, theta = two_masses("cubic")
    damper = replace(between("cq", Kind.DAMPER, "x2", "u"), force_law=force_law("v*abs(v)", damper=True))
    return replace(model, elements=(*model.elements, damper)), np.array([*theta, 400.0])


@pytest.mark.parametrize(
    ("method", "within"), [("ls", 1e-3), ("hls", 1e-3), ("wls", 1e-3), ("iv", 2e-3), ("oiv", 1e-6)]
)
def test_exact_harmonics_give_the_parameters_back(method, within):
    model, theta = two_masses("cubic")
    orders = (1, 3, 5, 7, 9, 11) if method in ("ls", "hls", "wls") else (1, 3)
    estimate = identify(model, settled(model, theta, ALL, FREQUENCIES, orders=orders), method)
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < within


@pytest.mark.slow
def test_the_noise_of_the_equation_is_that_of_draws():
    model, theta = rig()
    exact = settled(model, theta, ALL, FREQUENCIES[:4])
    repeats = 4000
    spectrum = noisy(exact, 1e-4, repeats, 7)
    equations = harmonic_equations(prepare(model, spectrum))
    Phi, h = equations.regression(equations.motion.unit_forces(equations.constants))
    e = np.einsum("krau,u->kra", Phi, theta) - h
    e = e - np.mean(e, axis=0)
    drawn = np.einsum("kra,krb->rab", e, e) / repeats
    stated = equations.rows(np.array([0])).noise(theta[None])[0]
    size = np.sqrt(np.diagonal(stated, axis1=-2, axis2=-1))
    # 4,000 draws: correlations scatter by 0.016; 0.09 is beyond the largest of 600.
    assert np.max(np.abs(drawn - stated) / (size[:, :, None] * size[:, None, :])) < 0.09


@pytest.mark.long
def test_least_squares_are_biased_by_noise_and_optimal_instruments_are_not():
    model, theta = rig()
    exact = settled(model, theta, ALL, FREQUENCIES, orders=(1, 3))
    repeats = 20
    spectrum = noisy(exact, 0.004, repeats, 11)
    away = {}
    for method in ("ls", "oiv"):
        estimate = identify(model, spectrum, method)
        assert np.mean(estimate.converged) > 0.98
        errors = estimate.values - theta
        sd = np.std(errors, axis=0)
        away[method] = np.abs(np.mean(errors, axis=0)) / (sd / np.sqrt(repeats))
        ratio = sd / np.sqrt(np.mean(estimate.sd**2, axis=0))
        if method != "ls":  # 20 draws: a ratio scatters by 0.16
            assert np.all(np.abs(ratio - 1) < 0.6), method
    assert np.max(away["ls"]) > 5  # standard errors
    assert np.max(away["oiv"]) < 4


@pytest.mark.parametrize("method", ["ls", "hls", "wls", "iv"])
def test_constants_inside_laws_are_refused(method):
    model, theta = two_masses("coulomb")
    with pytest.raises(UsageError, match=r"q\.v0"):
        identify(model, settled(model, theta, ALL, FREQUENCIES), method)


def test_calibrations_are_refused():
    model, theta = two_masses("cubic")
    twice = (*ALL, replace(ALL[0], name="again"))
    spectrum = settled(model, theta, twice, FREQUENCIES)
    channels = (*ALL, replace(twice[-1], gain=None))
    with pytest.raises(UsageError, match="calibration"):
        identify(model, replace(spectrum, channels=channels), "oiv")
