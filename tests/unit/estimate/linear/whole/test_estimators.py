"""Estimators against slow twins, against each other, and against repeats.

Spreads over R repeats have a relative standard error of 1/√(2R), shares of intervals one of √(0.95 · 0.05 / R):
1.1 % and 0.34 points at 4,000, where the limits below are about 4 of them.
"""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.inference.uncertainty import mode_values
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.gram import auxiliary, gram, gram_force, information, known_side, regressors
from dashpot.estimate.linear.instrumental_variables import OptimalIV
from dashpot.estimate.linear.least_squares import LeastSquares
from dashpot.estimate.preparation import channels_correlate, noise_quality
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import response, sensitivities, unit_forces
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.numerics.small_systems import solve_scaled
from tests.networks import network
from tests.rigs import states

SEED = 20
TRUTH = {"m1": 2.0, "m2": 0.8, "k1": 3000.0, "c1": 15.0, "c2": 6.0}
HZ = np.linspace(1, 16, 14)
U = 0.01


def _rig(**changes: Element) -> Model:
    elements = {
        "m1": mass("m1", "x1"),
        "m2": mass("m2", "x2"),
        "k1": between("k1", Kind.SPRING, "x1", "u"),
        "k2": between("k2", Kind.SPRING, "x1", "x2", value=1500.0),
        "c1": between("c1", Kind.DAMPER, "x1", "u"),
        "c2": between("c2", Kind.DAMPER, "x1", "x2"),
    }
    return Model(("x1", "x2"), (Input("u"),), tuple((elements | changes).values()))


CHANNELS = (
    Channel("x1", {"x1": 1.0}),
    Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
    Channel("v2", {"x2": 1.0}, Quantity.VELOCITY),
    Channel("u", {"u": 1.0}),
)


def _clean() -> np.ndarray:
    """Noise-free amplitudes of CHANNELS, (lines, 4)."""
    model, omega = _rig(), 2 * np.pi * HZ
    X = response(model, model.parameters(model.theta(TRUTH)), omega, np.full((len(HZ), 1), U + 0j))
    return np.stack([X[:, 0], -(omega**2) * X[:, 1], 1j * omega * X[:, 1], np.full(len(HZ), U)], axis=-1)


def _factor(base: float = 0.0, shared: float = 0.0) -> np.ndarray:
    """L with V = L Lᴴ of the amplitudes: 3 % noise, `base` noise of the input, `shared` by all noisy channels."""
    size = np.abs(_clean())
    sd = 0.03 * size * np.array([1, 1, 1, base / 0.03])
    L = sd[:, :, None] * np.eye(4)
    common = shared * sd[:, :, None] * np.array([1, 0, 0, 0])[None, None, :]
    return np.concatenate([L, common[:, :, :1]], axis=-1)


def _draws(repeats: int, base: float = 0.0, shared: float = 0.0, seed: int = SEED) -> Spectrum:
    rng = np.random.default_rng(seed)
    L = _factor(base, shared)
    shape = (repeats, len(HZ), L.shape[-1])
    wobble = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)
    noisy = _clean() + np.einsum("lij,klj->kli", L, wobble)
    return _spectrum(noisy, L @ np.swapaxes(L, -1, -2))


def _spectrum(amplitudes: np.ndarray, V: np.ndarray, noise: str = "given", dof: float = np.inf) -> Spectrum:
    lines = len(HZ)
    return Spectrum(
        CHANNELS, HZ, amplitudes, V, np.ones(lines, dtype=int), np.full(lines, dof), (noise,) * lines,
        np.zeros(lines, dtype=int),
    )  # fmt: skip


def _truth(estimate: Estimate) -> np.ndarray:
    return np.array([TRUTH[name] for name in estimate.names])


# ------------------------------------------------------------------------------------------ against slow twins


def test_the_gram_is_the_normal_matrix_of_the_stacked_regressors() -> None:
    rng = np.random.default_rng(SEED)
    forced = Input("f", "force", {"x2": 1.0})
    model = Model(("x1", "x2"), (Input("u"), forced), _rig().elements)
    a = rng.standard_normal((7, 6)) + 1j * rng.standard_normal((7, 6))
    w = rng.standard_normal((7, 6)) + 1j * rng.standard_normal((7, 6))
    f = rng.standard_normal((7, 1)) + 1j * rng.standard_normal((7, 1))
    weight = rng.random(7) + 0.5
    A = np.concatenate([np.sqrt(c) * model.B.T * row for c, row in zip(weight, a, strict=True)])
    W = np.concatenate([np.sqrt(c) * model.B.T * row for c, row in zip(weight, w, strict=True)])
    force = np.concatenate([np.sqrt(c) * model.S @ row for c, row in zip(weight, f, strict=True)])
    N, r = gram(model, w, a, weight), gram_force(model, w, f, weight)
    np.testing.assert_allclose(N, (W.conj().T @ A).real, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(r, (W.conj().T @ force).real, rtol=1e-12, atol=1e-12)
    theta = np.linalg.solve(
        (W @ model.T).conj().T.real @ (A @ model.T).real + (W @ model.T).imag.T @ (A @ model.T).imag,
        ((W @ model.T).conj().T @ (force - A @ model.p0)).real,
    )
    np.testing.assert_allclose(
        solve_scaled(model.T.T @ N @ model.T, (r - N @ model.p0) @ model.T), theta, rtol=1e-9
    )
    stacked = np.concatenate([*regressors(model, a)])
    np.testing.assert_allclose(stacked, np.concatenate([model.B.T * row for row in a]) @ model.T, rtol=1e-12)
    side = known_side(model, a, f)
    np.testing.assert_allclose(side[0], model.S @ f[0] - (model.B.T * a[0]) @ model.p0, rtol=1e-12)


def test_the_auxiliary_amplitudes_satisfy_the_model_and_follow_an_exact_input() -> None:
    model = _rig()
    spectrum = _draws(1, base=0.05)
    V = spectrum.covariance[None]
    data = states(model, spectrum, V)
    p = model.parameters(model.theta(TRUTH))[None]
    at = auxiliary(model, p, data)
    phi = model.factors(spectrum.omega)
    np.testing.assert_allclose(
        (p[:, None] * at.w) @ model.B, 0, atol=1e-9 * np.max(np.abs(p[:, None] * at.w))
    )
    exact = _draws(1)
    data = states(model, exact, exact.covariance[None])
    X = response(model, p, exact.omega, data.U)
    np.testing.assert_allclose(
        auxiliary(model, p, data).w, unit_forces(model, exact.omega, X, data.U), rtol=1e-9, atol=1e-12
    )
    assert phi.shape == (len(HZ), 6)


def test_the_equation_error_has_the_covariance_that_is_stated() -> None:
    """20,000 draws: the largest of 14 · 4 entries is within 5 standard errors of 0.7 %."""
    model = _rig()
    spectrum = _draws(20_000, base=0.05, shared=0.7)
    data = states(model, spectrum, spectrum.covariance[None])
    p = model.parameters(model.theta(TRUTH))[None]
    at = auxiliary(model, p, data)
    found = np.einsum("kli,klj->lij", at.e, at.e.conj()) / len(at.e)
    scale = np.sqrt(np.einsum("lii->li", at.Se[0]).real)
    away = np.abs(found - at.Se[0]) / (scale[:, :, None] * scale[:, None, :])
    assert np.max(away) < 0.035


def test_information_is_that_of_the_output_error() -> None:
    """2 Re Jᴴ V⁻¹ J of the measured channels, J from the closed-form sensitivities."""
    model = _rig()
    spectrum = _draws(1)
    omega = spectrum.omega
    p = model.parameters(model.theta(TRUTH))
    Uh = np.full((len(HZ), 1), U + 0j)
    X = response(model, p, omega, Uh)
    dX = sensitivities(model, p, omega, X, Uh) @ model.T
    J = np.stack([dX[:, 0], -(omega**2)[:, None] * dX[:, 1], 1j * omega[:, None] * dX[:, 1]], axis=1)
    V = spectrum.covariance[:, :3, :3]
    expected = np.sum(2 * (np.conj(np.swapaxes(J, 1, 2)) @ np.linalg.solve(V, J)).real, axis=0)
    clean = replace(spectrum, amplitudes=_clean()[None])
    data = states(model, clean, spectrum.covariance[None])
    found = np.sum(information(model, auxiliary(model, p[None], data)), axis=-3)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.max(expected))


@pytest.mark.parametrize("kind", ["blocks", "periods"])
def test_noise_quality_is_that_of_drawn_covariances(kind: str) -> None:
    """E[Ŵ V Ŵ] and E[Ŵ] over 40,000 Wishart matrices, 4 channels, 30 degrees of freedom: to 2 %, 4 standard errors."""
    rng = np.random.default_rng(SEED)
    q, nu = 4, 30
    z = rng.standard_normal((40_000, nu, q))
    W = np.linalg.inv(np.swapaxes(z, 1, 2) @ z / nu)
    mean, square = np.trace(np.mean(W, axis=0)) / q, np.trace(np.mean(W @ W, axis=0)) / q
    given = _spectrum(_clean(), np.broadcast_to(np.eye(4), (len(HZ), 4, 4)), "white", nu)
    quality = noise_quality(given, np.array([True]))
    assert quality.inflation[0, 0] == pytest.approx(square / mean, rel=0.02)
    assert quality.shrink[0, 0] == pytest.approx(1 / mean, rel=0.02)
    K = nu // 2
    y = (rng.standard_normal((40_000, K, q)) + 1j * rng.standard_normal((40_000, K, q))) / np.sqrt(2)
    W = np.linalg.inv(np.conj(np.swapaxes(y, 1, 2)) @ y / K)
    mean, square = (np.trace(np.mean(W, axis=0)).real / q, np.trace(np.mean(W @ W, axis=0)).real / q)
    blocks = noise_quality(replace(given, noise=(kind,) * len(HZ)), np.array([True]))
    assert blocks.inflation[0, 0] == pytest.approx(square / mean, rel=0.02)
    assert blocks.shrink[0, 0] == pytest.approx(1 / mean, rel=0.02)


@pytest.mark.parametrize("shared", [0.0, 0.8])
def test_correlation_of_channels_is_found_where_it_is(shared: float) -> None:
    """At 1 %: 400 repeats of independent channels give 4 ± 2 alarms; of strongly correlated ones, none is missed."""
    rng = np.random.default_rng(SEED)
    z = rng.standard_normal((400, len(HZ), 40, 4)) + shared * rng.standard_normal((400, len(HZ), 40, 1))
    R = np.swapaxes(z, -1, -2) @ z / 40
    found = channels_correlate(_spectrum(np.broadcast_to(_clean(), (400, 14, 4)), R, "white", 40))
    assert np.mean(found) < 0.035 if shared == 0 else np.all(found)


# ------------------------------------------------------------------------------------------ against each other


def test_a_channel_that_is_missing_at_some_lines_only_costs_its_information() -> None:
    spectrum = _draws(1)
    holes = np.array(spectrum.amplitudes[0])
    holes[:5, 2] = np.nan
    partial = identify(_rig(), replace(spectrum, amplitudes=holes))
    full = identify(_rig(), replace(spectrum, amplitudes=spectrum.amplitudes[0]))
    assert np.all(partial.sd > full.sd * 0.98)
    assert np.all(np.abs(partial.values - _truth(partial)) < 5 * partial.sd)


# ------------------------------------------------------------------------------------------ against repeats


# ------------------------------------------------------------------------------------------ contracts


def test_an_estimate_survives_json() -> None:
    spectrum = _draws(1)
    rig = _rig(c2=between("c2", Kind.DAMPER, "x1", "x2", same_as="c1", times=0.4))
    estimate = identify(rig, replace(spectrum, amplitudes=spectrum.amplitudes[0]))
    again = Estimate.from_json(estimate.to_json())
    assert again.to_json() == estimate.to_json()
    np.testing.assert_array_equal(again.covariance, estimate.covariance)
    assert again.parameters()["c2"].value == pytest.approx(0.4 * estimate["c1"].value)
    assert again.parameters()["k2"].known
    with pytest.raises(DataError, match="not a dashpot estimate"):
        Estimate.from_json(estimate.to_json()[:-40])
    with pytest.raises(ValueError, match="read-only"):
        estimate.values[0] = 1.0


def test_what_cannot_be_done_is_refused() -> None:
    spectrum = _draws(1)
    model = _rig()
    with pytest.raises(UsageError, match="every parameter"):
        identify(Model(("x1",), (Input("u"),), (between("k", Kind.SPRING, "x1", "u", value=1.0),)), spectrum)
    with pytest.raises(DataError, match="no frequency lines"):
        identify(model, spectrum.select([]))
    half = Spectrum(
        CHANNELS[2:], HZ, spectrum.amplitudes[..., 2:], spectrum.covariance[:, 2:, 2:], spectrum.samples,
        spectrum.dof, spectrum.noise, spectrum.experiment,
    )  # fmt: skip
    assert isinstance(automatic(model, half), MaximumLikelihood)
    assert isinstance(automatic(model, spectrum), OptimalIV)
    for name in ("oiv", "hls", "wls", "iv", "tls", "cls"):
        with pytest.raises(DataError, match="no channel measures x1") as caught:
            identify(model, half, name)
        assert "ml" in caught.value.problems[0].cure
    with pytest.raises(UsageError, match="hls"):
        identify(model, spectrum, LeastSquares())


def test_a_mode_whose_variance_is_rounding_has_no_standard_deviation():
    """Where only k/m is known, and m and k for themselves hardly at all, the digits of the frequency's sd are lost."""
    model = network("x", "u", "m@x k:x-u")
    theta = np.array([2.0, 3000.0])
    relative = np.array([[1.0, 1.0], [1.0, 1.0]])
    scale = np.outer(theta, theta)
    root = mode_values(model, theta, 0.01**2 * np.eye(2) * scale)
    assert root.frequency_sd == pytest.approx(root.frequency_hz * 0.01 / np.sqrt(2))
    assert np.all(np.isnan(mode_values(model, theta, 1e20 * relative * scale).frequency_sd))
    assert np.all(mode_values(model, theta, 0 * scale).frequency_sd == 0)
