"""The setup and its information: against differences, full matrices and the estimators' own; limits, bands, memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.design import test_setup
from dashpot.design import test_setup as harmonic_information
from dashpot.design.advise import drives_that_show
from dashpot.design.allocation import Criterion, optimise
from dashpot.design.test_setup import (
    Schedule,
    ShakerLimits,
    band_grid,
    dwell_information,
    fisher,
    nominal_setup,
    outputs,
    per_sample,
)
from dashpot.errors import DataError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.gram import auxiliary, information
from dashpot.estimate.nonlinear.objective import evaluate
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.observation import calibration_names
from tests.designs import light_setup, paper_setup
from tests.nonlinear_rigs import motions, settled, two_masses
from tests.rigs import Rig, channels, covariance, paper_rig, perfect, random_rig, stated, states


def test_settling_is_that_of_the_slowest_mode() -> None:
    """Real parts of the paper's eigenvalues: −16.05 and −26.2 1/s."""
    assert paper_setup().settling() == pytest.approx(np.log(1000) / 16.0467, rel=1e-3)


def test_limits_of_the_shaker_set_the_amplitudes() -> None:
    limits = ShakerLimits(stroke=0.01, velocity=0.2, acceleration=5.0, force=40.0)
    own = paper_setup(limits)
    f = np.geomspace(0.3, 25, 60)
    k = np.zeros(60, dtype=int)
    seen = own.seen(f, k)
    use = limits.use(2 * np.pi * f, seen.motion, seen.force)
    assert np.all(use <= 1)
    assert np.all(use > 1 - 1e-9)
    # A force limit alone holds nothing back where the rig does not push: here, nothing joins it to the base.
    rig = paper_rig()
    elements = tuple(replace(e, value=0.0) if e.name in ("k2", "c2") else e for e in rig.model.elements)
    loose = replace(rig.model, elements=elements)
    free = nominal_setup(loose, own.channels, rig.theta[[0, 1, 2, 4, 5]], limits=ShakerLimits(force=1))
    with pytest.raises(UsageError, match="none of its limits"):
        free.drive(f, k)


@pytest.mark.parametrize(("relative", "floor"), [(0.0, 1e-5), (0.1, 1e-6), (0.1, 0.0)])
def test_lines_some_at_a_time_are_lines_all_together(
    relative: float, floor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = light_setup(floor, relative)
    f = np.linspace(0.5, 25.0, 37)
    pattern = np.zeros(37, dtype=np.int64)
    together = setup.information(f, pattern)
    monkeypatch.setattr(test_setup, "CHUNK", 60)
    np.testing.assert_allclose(setup.information(f, pattern), together, rtol=1e-12)


def everything(rig: Rig) -> tuple[Channel, ...]:
    """Motions, differences, reactions, forces in elements, applied forces, unknown calibrations."""
    model = rig.model
    found = [*channels(rig, (Quantity.DISPLACEMENT, Quantity.ACCELERATION))]
    found += [Channel(f"reaction {u}", {u: 1.0}, Quantity.FORCE) for u in model.displacement_inputs]
    found += [Channel(f"in {e.name}", {e.name: 2.0}, Quantity.FORCE) for e in model.elements[-2:]]
    if model.n > 1:
        found.append(
            Channel("difference", {model.coordinates[0]: 1.0, model.coordinates[1]: -0.5}, Quantity.VELOCITY)
        )
    found.append(Channel("loose", {model.coordinates[0]: 1.0}, gain=None, delay=None))
    found.append(Channel("shared", {model.coordinates[-1]: 1.0}, gain=None, same_gain_as="loose"))
    return tuple(replace(c, relative_noise=0.05) for c in found)


def information_of(rig: Rig, spectrum: Spectrum) -> np.ndarray:
    """What the lines of data tell with the noise that they state, (lines, q, q)."""
    drive = np.concatenate([rig.U, rig.f], axis=-1)
    seen = outputs(rig.model, rig.p, spectrum.channels, spectrum.omega, drive)
    return fisher(seen.by_parameter, seen.by_input, spectrum.covariance, [c.name for c in spectrum.channels])


@pytest.mark.parametrize("seed", range(8))
def test_slopes_of_all_channels_against_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 1 + seed % 4, displacements=1 + seed % 2, forces=seed % 2)
    model, chosen = rig.model, everything(rig)
    drive = np.concatenate([rig.U, rig.f], axis=-1)
    seen = outputs(model, rig.p, chosen, rig.omega, drive)
    size = np.max(np.abs(seen.Y), axis=0)
    for j, value in enumerate(rig.theta):
        step = 1e-6 * value
        ends = []
        for sign in (1, -1):
            theta = rig.theta.copy()
            theta[j] += sign * step
            ends.append(outputs(model, model.parameters(theta), chosen, rig.omega, drive).Y)
        difference = (ends[0] - ends[1]) / (2 * step)
        scale = np.max(np.abs(seen.by_parameter[..., j]), initial=0.0)
        assert np.allclose(
            seen.by_parameter[..., j] / size, difference / size, atol=1e-6 * scale / size.min(), rtol=1e-5
        )
    for i in range(drive.shape[1]):
        moved = drive.copy()
        moved[:, i] += 1.0
        # Linear in the drive: the difference is exact.
        assert np.allclose(
            outputs(model, rig.p, chosen, rig.omega, moved).Y - seen.Y, seen.by_input[..., i], rtol=1e-8
        )
    gain, delay = len(rig.theta), len(rig.theta) + 1
    assert calibration_names(chosen) == ("loose.gain", "loose.delay")
    loose, shared = len(chosen) - 2, len(chosen) - 1
    assert np.allclose(seen.by_parameter[:, loose, gain], seen.Y[:, loose])
    assert np.allclose(seen.by_parameter[:, shared, gain], seen.Y[:, shared])
    assert np.allclose(seen.by_parameter[:, loose, delay], -1j * rig.omega * seen.Y[:, loose])
    assert not np.any(seen.by_parameter[:, shared, delay])


@pytest.mark.parametrize("inputs", [0.0, 0.05])
def test_all_sensors_as_the_estimators_count_them(inputs: float) -> None:
    """The equation of motion and the outputs hold the same information, exact and noisy inputs alike.

    To 1e-10 but for the guard of the equation of motion against singular weights, which is 1e-8 on stiff rigs.
    """
    rng = np.random.default_rng(4)
    for _ in range(25):
        rig = random_rig(rng, int(rng.integers(1, 5)), displacements=1, forces=int(rng.integers(0, 2)))
        chosen = channels(rig, (Quantity.DISPLACEMENT, Quantity.ACCELERATION))
        V = covariance(rig, chosen, 0.05, inputs=inputs, correlation=0.3 if inputs else 0.0)
        spectrum = perfect(rig, chosen, V)
        own = information_of(rig, spectrum)
        theirs = information(rig.model, auxiliary(rig.model, rig.p, states(rig.model, spectrum, V)))
        size = np.sqrt(np.diagonal(np.sum(theirs, axis=0)))
        assert np.max(np.abs(own - theirs) / np.outer(size, size)) < 3e-8


def test_few_sensors_as_maximum_likelihood_counts_them() -> None:
    """One displacement, the reaction and a noisy base: the bound of the estimator is the inverse of the sum."""
    rig = paper_rig(np.linspace(1, 14, 20).tolist())
    chosen = (
        Channel("x1", {"x1": 1.0}),
        Channel("F", {"u": 1.0}, Quantity.FORCE),
        Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
        Channel("u", {"u": 1.0}),
    )
    Y = outputs(rig.model, rig.p, chosen, rig.omega, rig.U).Y
    V = (0.01 * np.abs(Y) ** 2)[..., None] * np.eye(4) / 50
    spectrum = stated(chosen, rig.frequency_hz, Y, V)
    estimate = identify(rig.model, spectrum, MaximumLikelihood())
    total = np.sum(information_of(rig, spectrum), axis=0)
    bound = np.sqrt(np.diagonal(np.linalg.inv(total)))
    own = [estimate.names.index(u.name) for u in rig.model.unknowns]
    assert np.allclose(estimate.values[own], rig.theta, rtol=1e-5)
    assert np.allclose(estimate.bound_sd[own], bound, rtol=1e-4)


def test_noisy_inputs_cost_what_the_full_matrix_says() -> None:
    """Projecting the inputs out equals inverting the information of parameters and inputs together."""
    rng = np.random.default_rng(1)
    J = rng.standard_normal((1, 5, 3)) + 1j * rng.standard_normal((1, 5, 3))
    G = rng.standard_normal((1, 5, 2)) + 1j * rng.standard_normal((1, 5, 2))
    A = rng.standard_normal((5, 5)) + 1j * rng.standard_normal((5, 5))
    V = (A @ A.conj().T)[None]
    # Real unknowns: parameters, then real and imaginary parts of the inputs.
    slope = np.concatenate([J[0], G[0], 1j * G[0]], axis=1)
    whole = 2 * (slope.conj().T @ np.linalg.solve(V[0], slope)).real
    expected = np.linalg.inv(np.linalg.inv(whole)[:3, :3])
    assert np.allclose(fisher(J, G, V, "abcde")[0], expected, rtol=1e-10)


def test_exact_channels() -> None:
    rig = paper_rig()
    exact = (Channel("x1", {"x1": 1.0}), Channel("u", {"u": 1.0}), Channel("x2", {"x2": 1.0}, noise=1.0))
    seen = outputs(rig.model, rig.p, exact, rig.omega, rig.U)
    with pytest.raises(UsageError, match="x1 has no noise"):
        per_sample(rig.model, exact, seen)


def test_perfectly_correlated_noise_is_refused() -> None:
    J, G = np.ones((1, 2, 1), dtype=complex), np.zeros((1, 2, 0), dtype=complex)
    with pytest.raises(DataError, match="correlated"):
        fisher(J, G, np.ones((1, 2, 2), dtype=complex), "ab")


def test_relative_noise_makes_information_independent_of_amplitude() -> None:
    rig = paper_rig()
    relative = tuple(
        replace(c, relative_noise=0.1) if set(c.of) != {"u"} else c
        for c in channels(rig, tuple(Quantity)[:2])
    )
    M = [
        per_sample(rig.model, relative, outputs(rig.model, rig.p, relative, rig.omega, a * rig.U))
        for a in (1.0, 1e-4)
    ]
    assert np.allclose(M[0], M[1], rtol=1e-10)
    floors = tuple(replace(c, noise=0.1, relative_noise=0.0) if c.relative_noise else c for c in relative)
    M = [
        per_sample(rig.model, floors, outputs(rig.model, rig.p, floors, rig.omega, a * rig.U))
        for a in (1.0, 2.0)
    ]
    assert np.allclose(4 * M[0], M[1], rtol=1e-10)


FREQUENCIES = np.array([2, 3, 4, 5, 6, 7, 8, 9.5, 11, 12.5, 14])
ALL = motions("x1", "x2", "u")


def with_noise(*sd):
    return tuple(replace(channel, noise=s) for channel, s in zip(ALL, sd, strict=True))


@pytest.mark.parametrize("input_noise", [0.0, 1e-6])
def test_information_is_that_of_an_identification(input_noise):
    model, theta = two_masses("cubic")
    channels, samples = with_noise(2e-6, 3e-6, input_noise), 500
    each = dwell_information(
        model, theta[None], channels, 2 * np.pi * FREQUENCIES, np.full((len(FREQUENCIES), 1), 1e-3 + 0j)
    )
    expected = np.sqrt(np.diagonal(np.linalg.inv(samples * np.sum(each[0], axis=0))))
    exact = settled(model, theta, ALL, FREQUENCIES, orders=(1, 2, 3, 4, 5))
    V = 4 / samples * np.diag([channel.noise**2 for channel in channels]) + 0j
    data = replace(exact, covariance=np.broadcast_to(V, (exact.lines, 3, 3)))
    assert np.allclose(identify(model, data, "ml").bound_sd, expected, rtol=1e-3)


def test_a_dwell_on_a_fold_tells_nothing():
    """Slopes are infinite there, of the motion and of what the noise of the input does to it."""
    model, theta = two_masses("cubic")
    at = 2 * np.pi * FREQUENCIES[:2]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(harmonic_information, "evaluate", _on_a_fold)
        each = dwell_information(
            model, theta[None], with_noise(2e-6, 3e-6, 1e-6), at, np.full((2, 1), 1e-3 + 0j)
        )
    assert not np.any(each[0, 0])
    assert np.all(np.linalg.eigvalsh(each[0, 1])[-3:] > 0)


def _on_a_fold(*arguments):
    """What harmonic balance gives, with infinite slopes in the first dwell."""
    at = evaluate(*arguments)
    at.J[:, :5], at.G[:, :5] = np.nan, np.nan
    return at


def test_a_weak_drive_does_not_show_a_law():
    model, theta = two_masses("cubic")
    setup = nominal_setup(model, with_noise(2e-6, 2e-6, 0.0), theta, amplitude=1e-3)
    count = len(FREQUENCIES)
    schedule = Schedule(FREQUENCIES, np.zeros(count, dtype=np.int64), np.full(count, 100.0))
    assert drives_that_show(setup, schedule)[0].startswith("q ")
    faint = replace(setup, amplitude=1e-6)
    assert "q is not visible" in drives_that_show(faint, schedule)[0]


def test_limits_of_what_is_not_proportional_to_the_drive_are_refused():
    model, theta = two_masses("cubic")
    setup = nominal_setup(model, with_noise(2e-6, 2e-6, 0.0), theta, limits=ShakerLimits(force=10.0))
    with pytest.raises(UsageError, match="limit of force"):
        setup.drive(FREQUENCIES, np.zeros(len(FREQUENCIES), dtype=np.int64))
    moved = replace(setup, limits=ShakerLimits(stroke=1e-3, acceleration=4.0))
    drive = np.abs(moved.drive(FREQUENCIES, np.zeros(len(FREQUENCIES), dtype=np.int64))[:, 0])
    assert np.allclose(drive, np.minimum(1e-3, 4.0 / (2 * np.pi * FREQUENCIES) ** 2))


def test_undamped_resonances_are_no_place_to_dwell() -> None:
    """The response there is infinite: the search must not run into it."""
    from dashpot.model.elements import Kind, between, mass
    from dashpot.model.network import Input, Model

    elements = (mass("m", "x"), between("k", Kind.SPRING, "x", "u", value=400.0))
    model = Model(("x",), (Input("u"),), elements)
    own = nominal_setup(model, [Channel("x", {"x": 1.0}, noise=1e-3), Channel("u", {"u": 1.0})], {"m": 1.0})
    resonance = 20 / 2 / np.pi
    found = optimise(own, Criterion("A").terms(own), 100, band_grid(own, 1.0, 9.0))
    assert np.all(np.abs(found.frequency_hz / resonance - 1) > 0.0099)


def test_the_information_of_two_hundred_coordinates_is_made_some_lines_at_a_time() -> None:
    """40 lines, 200 sensors, 600 elements: slopes of all lines together would be 77 MB, several times."""
    n = 200
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    elements = [mass(f"m{i}", f"x{i}", value=1.0) for i in range(1, n + 1)]
    for letter, kind, size in (("k", Kind.SPRING, 400.0 * n**2), ("c", Kind.DAMPER, 0.25 * n**2)):
        for i in range(1, n + 1):
            known = {"guess": size} if i == 1 else {"same_as": f"{letter}1"}
            elements.append(between(f"{letter}{i}", kind, points[i - 1], points[i], **known))
    model = Model(tuple(points[1:]), (Input("u"),), tuple(elements))
    channels = (Channel("u", {"u": 1.0}), *(Channel(x, {x: 1.0}, relative_noise=0.01) for x in points[1:]))
    setup = nominal_setup(model, channels, {"k1": 400.0 * n**2, "c1": 0.25 * n**2})
    lines, pattern = np.geomspace(0.5, 20, 40), np.zeros(40, dtype=np.int64)
    few = setup.information(lines[::10], pattern[::10])
    tracemalloc.start()
    every = setup.information(lines, pattern)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 * 2**20
    assert np.allclose(every[:, ::10], few, rtol=1e-12, atol=0)
