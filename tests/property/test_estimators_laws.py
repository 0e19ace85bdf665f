"""Laws that every estimator obeys on random rigs: order, units, repeats, superfluous knowledge, hard numbers."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, DataError, IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.gram import auxiliary, known_side, regressors
from dashpot.estimate.linear.instrumental_variables import DefiniteOptimalIV, InstrumentalVariables, OptimalIV
from dashpot.estimate.linear.least_squares import HarmonicLeastSquares, WeightedLeastSquares
from dashpot.estimate.linear.total_least_squares import CompensatedLeastSquares, TotalLeastSquares
from dashpot.estimate.method import Method
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import unit_forces
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from tests.rigs import Rig, channels, covariance, noisy, paper_rig, perfect, random_rig, states

D, V, A = Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION
METHODS = (
    HarmonicLeastSquares(), WeightedLeastSquares(), TotalLeastSquares(), CompensatedLeastSquares(),
    InstrumentalVariables(), OptimalIV(),
)  # fmt: skip
SEEDS = st.integers(0, 2**32 - 1)
INPUTS = st.sampled_from([(1, 0), (2, 0), (0, 1), (1, 1)])


def random_test(seed: int, n: int, inputs: tuple[int, int], draws: int | None = None) -> tuple[Rig, Spectrum]:
    """A rig with noisy inputs, correlated channels and two looks at every coordinate, in random order."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, n, displacements=inputs[0], forces=inputs[1], worst=50.0)
    seen = channels(rig, (D, A), rng)
    V_ = covariance(rig, seen, 0.005, inputs=0.002, correlation=0.3)
    return rig, noisy(rig, seen, V_, rng, draws)


def assert_same(
    one: Estimate, other: Estimate, scale: float | np.ndarray = 1.0, tolerance: float = 1e-6
) -> None:
    """Values to a millionth of a standard deviation, standard deviations and χ² alike."""
    theirs = [other.names.index(name) for name in one.names]
    assert np.max(np.abs(one.values - other.values[..., theirs] / scale) / one.noise_sd) < tolerance
    np.testing.assert_allclose(one.noise_sd, other.noise_sd[..., theirs] / scale, rtol=tolerance)
    np.testing.assert_allclose(one.bound_sd, other.bound_sd[..., theirs] / scale, rtol=1e-5)
    np.testing.assert_allclose(one.fit.chi2, other.fit.chi2, rtol=1e-5, atol=1e-9)


def with_channels(spectrum: Spectrum, order: np.ndarray) -> Spectrum:
    return replace(
        spectrum,
        channels=tuple(spectrum.channels[int(i)] for i in order),
        amplitudes=spectrum.amplitudes[..., order],
        covariance=spectrum.covariance[..., order, :][..., order],
    )


@given(seed=SEEDS, n=st.integers(1, 5), inputs=INPUTS)
@settings(max_examples=10)
def test_order_of_lines_channels_elements_and_coordinates_does_not_matter(
    seed: int, n: int, inputs: tuple[int, int]
) -> None:
    rig, spectrum = random_test(seed, n, inputs)
    rng = np.random.default_rng(seed + 1)
    mixed = with_channels(
        spectrum.select(rng.permutation(spectrum.lines)), rng.permutation(len(spectrum.channels))
    )
    model = rig.model
    shuffled = Model(
        tuple(model.coordinates[int(i)] for i in rng.permutation(model.n)),
        tuple(model.inputs[int(i)] for i in rng.permutation(len(model.inputs))),
        tuple(model.elements[int(i)] for i in rng.permutation(len(model.elements))),
    )
    for method in METHODS:
        assert_same(identify(model, spectrum, method), identify(shuffled, mixed, method))


@pytest.mark.slow
@given(seed=SEEDS, n=st.integers(1, 5), inputs=INPUTS)
@settings(max_examples=6)
def test_a_batch_is_its_repeats(seed: int, n: int, inputs: tuple[int, int]) -> None:
    """Also with a covariance of its own for every repeat."""
    rig, spectrum = random_test(seed, n, inputs, draws=6)
    size = np.random.default_rng(seed).uniform(0.5, 2.0, (6, 1, 1, 1))
    for batch in (spectrum, replace(spectrum, covariance=spectrum.covariance * size)):
        for method in METHODS:
            whole = identify(rig.model, batch, method)
            folded = identify(
                rig.model,
                replace(
                    batch,
                    amplitudes=batch.amplitudes.reshape(2, 3, *batch.amplitudes.shape[1:]),
                    covariance=batch.covariance
                    if batch.covariance.ndim == 3
                    else batch.covariance.reshape(2, 3, *batch.covariance.shape[1:]),
                ),
                method,
            )
            np.testing.assert_array_equal(folded.values, whole.values.reshape(2, 3, -1))
            for k in (0, 5):
                own = batch.covariance if batch.covariance.ndim == 3 else batch.covariance[k]
                single = identify(
                    rig.model, replace(batch, amplitudes=batch.amplitudes[k], covariance=own), method
                )
                assert np.max(np.abs(whole.values[k] - single.values) / single.noise_sd) < 1e-6
                np.testing.assert_allclose(whole.noise_sd[k], single.noise_sd, rtol=1e-6)
                np.testing.assert_allclose(whole.fit.chi2[k], single.fit.chi2, rtol=1e-5)


@pytest.mark.slow
@given(
    seed=SEEDS,
    n=st.integers(1, 4),
    inputs=INPUTS,
    length=st.sampled_from([1e-6, 1e-3, 1e3, 1e6]),
    force=st.sampled_from([1e-6, 1e3, 1e9]),
    second=st.sampled_from([1e-2, 1e2]),
)
@settings(max_examples=15)
def test_units_do_not_matter(
    seed: int, n: int, inputs: tuple[int, int], length: float, force: float, second: float
) -> None:
    """Any consistent units: N, mm and t; lines 10,000 times as fast; forces in nN."""
    rig, spectrum = random_test(seed, n, inputs)
    size = {
        Kind.SPRING: force / length, Kind.HYSTERETIC: force / length, Kind.DAMPER: force * second / length,
        Kind.MASS: force * second**2 / length, Kind.INERTER: force * second**2 / length,
    }  # fmt: skip
    elements = tuple(
        e if e.value is None else replace(e, value=e.value * size[e.kind]) for e in rig.model.elements
    )
    other = replace(rig.model, elements=elements)
    unit = np.array([
        force if c.quantity is Quantity.FORCE else length * second ** -c.quantity.derivative
        for c in spectrum.channels
    ])  # fmt: skip
    scaled = replace(
        spectrum,
        frequency_hz=spectrum.frequency_hz / second,
        amplitudes=spectrum.amplitudes * unit,
        covariance=spectrum.covariance * unit[:, None] * unit,
    )
    kinds = {e.name: e.kind for e in rig.model.elements}
    scale = np.array([size[kinds[name]] for name in rig.names])
    for method in METHODS:
        one, two = identify(rig.model, spectrum, method), identify(other, scaled, method)
        assert_same(one, two, scale, 1e-5)


@given(seed=SEEDS, n=st.integers(1, 4), inputs=INPUTS)
@settings(max_examples=8)
def test_the_gradient_of_the_likelihood_vanishes_and_its_curvature_is_the_covariance(
    seed: int, n: int, inputs: tuple[int, int]
) -> None:
    """Σ eᴴ Ω(θ) e by itself, differentiated by finite differences at the estimate of oiv."""
    rig, spectrum = random_test(seed, n, inputs)
    estimate = identify(rig.model, spectrum)
    data = states(
        rig.model, replace(spectrum, amplitudes=spectrum.amplitudes[None]), spectrum.covariance[None]
    )
    root = np.linalg.cholesky(estimate.noise_covariance)  # without what a misfit by chance adds

    def cost(step: np.ndarray) -> float:
        theta = estimate.values + root @ step
        return float(auxiliary(rig.model, rig.model.parameters(theta)[None], data).cost()[0])

    m = len(rig.theta)
    h = 0.05
    middle = cost(np.zeros(m))
    for j in range(m):
        ahead, behind = cost(h * np.eye(m)[j]), cost(-h * np.eye(m)[j])
        assert abs(ahead - behind) / (2 * h) < 0.02
        # Fisher's information is the expected curvature; that of one draw differs by the size of the noise.
        assert (ahead + behind - 2 * middle) / h**2 == pytest.approx(2.0, rel=0.15)
    assert estimate.fit.chi2 == pytest.approx(middle, rel=1e-6)


@given(seed=SEEDS, n=st.integers(1, 4), inputs=INPUTS, method=st.sampled_from(METHODS))
@settings(max_examples=12)
def test_a_prior_is_one_more_row_of_least_squares(
    seed: int, n: int, inputs: tuple[int, int], method: Method
) -> None:
    """Weighted least squares with a row (θ_j − value)/sd, by QR; sd as large as the data's own, noise small."""
    rig, spectrum = random_test(seed, n, inputs)
    quiet = 1e-4
    spectrum = replace(
        spectrum,
        amplitudes=perfect(rig, spectrum.channels).amplitudes * (1 - quiet) + spectrum.amplitudes * quiet,
        covariance=spectrum.covariance * quiet**2,
    )
    free = identify(rig.model, spectrum, OptimalIV())
    j = int(np.argmax(free.sd / rig.theta))
    value, sd = float(free.values[j] + 2 * free.sd[j]), float(free.sd[j])
    held = rig.knowing({rig.names[j]: {"value": value, "sd": sd}})
    found = identify(held.model, spectrum, method)
    data = states(
        rig.model, replace(spectrum, amplitudes=spectrum.amplitudes[None]), spectrum.covariance[None]
    )
    at = auxiliary(rig.model, rig.p[None], data)
    a = unit_forces(rig.model, spectrum.omega, data.X, data.U)[0]
    # Rows e / sd(e) of real and imaginary parts; E[e eᴴ] = Se, so each part has half of it.
    whiten = np.linalg.inv(np.linalg.cholesky(at.Se[0])) * np.sqrt(2)
    Phi, h = (
        whiten @ regressors(rig.model, a),
        np.einsum("lij,lj->li", whiten, known_side(rig.model, a, data.f[0])),
    )
    rows = np.concatenate([Phi.real.reshape(-1, len(rig.theta)), Phi.imag.reshape(-1, len(rig.theta))])
    right = np.concatenate([h.real.ravel(), h.imag.ravel()])
    rows = np.concatenate([rows, np.eye(len(rig.theta))[j : j + 1] / sd])
    right = np.append(right, value / sd)
    Q, R = np.linalg.qr(rows)
    slow = np.linalg.solve(R, Q.T @ right)
    if method in (WeightedLeastSquares(), OptimalIV()):
        assert np.max(np.abs(found.values - slow) / found.noise_sd) < 0.01
        inverse = np.linalg.inv(R)
        np.testing.assert_allclose(found.noise_sd, np.linalg.norm(inverse, axis=1), rtol=1e-3)
    # Unweighted sums weigh the prior by the mean variance of the equation error: near the best, not on it.
    assert abs(found.values[j] - value) < 3 * abs(free.values[j] - value) + 5 * sd
    assert found.noise_sd[j] < sd * (1.1 if method in (WeightedLeastSquares(), OptimalIV()) else 2.0)


def test_a_prior_weighs_against_noise_of_unknown_size() -> None:
    """The residuals say how large the noise is, and only then what the prior is worth: as if the noise were given."""
    rng = np.random.default_rng(3)
    rig = random_rig(rng, 3, displacements=1, worst=50.0)
    seen = channels(rig, (D,))
    size = np.sqrt(np.mean(np.abs(perfect(rig, seen).amplitudes) ** 2, axis=0))
    driven = np.array([not set(c.of) <= set(rig.model.displacement_inputs) for c in seen])
    V_ = np.broadcast_to(np.diag((1e-3 * size * driven) ** 2), (rig.lines, len(seen), len(seen)))
    spectrum = noisy(rig, seen, V_, rng)
    free = identify(rig.model, spectrum)
    j = int(np.argmax(free.sd / rig.theta))
    held = rig.knowing({rig.names[j]: {"value": rig.theta[j], "sd": float(free.sd[j])}})
    given_ = identify(held.model, spectrum)
    blind = identify(held.model, replace(spectrum, covariance=np.full(V_.shape, np.nan)))
    scale = np.sqrt(float(given_.fit.chi2) / given_.fit.dof)
    assert blind.basis == "residuals"
    assert np.max(np.abs(blind.values - given_.values) / given_.sd) < 0.3
    np.testing.assert_allclose(blind.sd, given_.sd * scale, rtol=0.3)
    assert blind.sd[j] < free.sd[j]


def test_a_superfluous_channel_that_is_hardly_exact_changes_hardly_anything() -> None:
    rng = np.random.default_rng(8)
    rig = random_rig(rng, 3, forces=1, worst=50.0)
    seen = channels(rig, (D,))
    V_ = covariance(rig, seen, 0.01, inputs=0.01)
    spectrum = noisy(rig, seen, V_, rng)
    more = (*seen, Channel("gap", {"x1": 1.0, "x2": -1.0}, V))
    Y = perfect(rig, more).amplitudes
    wide = np.zeros((rig.lines, len(more), len(more)), dtype=complex)
    wide[:, : len(seen), : len(seen)] = V_
    wide[:, -1, -1] = (1e6 * np.abs(Y[:, -1])) ** 2
    with_gap = replace(
        perfect(rig, more, wide), amplitudes=np.concatenate([spectrum.amplitudes, Y[:, -1:] * 3], axis=-1)
    )
    assert_same(identify(rig.model, spectrum), identify(rig.model, with_gap), tolerance=1e-4)


# ------------------------------------------------------------------------------------------ hard numbers


@pytest.mark.parametrize("level", [0.35, 0.7, 1.0])
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_noise_as_large_as_the_signal_gives_numbers_or_says_why_not(level: float, method: Method) -> None:
    """35 to 100 % on every amplitude of the paper's rig and of harder ones: finite, or told not to have converged."""
    for rig in (paper_rig(), random_rig(np.random.default_rng(0), 4, displacements=1)):
        rng = np.random.default_rng(1)
        seen = channels(rig, (D, V))
        spectrum = noisy(rig, seen, covariance(rig, seen, level), rng, 20)
        estimate = identify(rig.model, spectrum, method)
        settled = estimate.converged
        if method != InstrumentalVariables():  # the paper's iteration has no guard and may circle for ever
            assert np.mean(settled) > 0.5
        assert np.all(np.isfinite(estimate.values[settled]))
        assert not np.any(estimate.noise_sd < 0)


@pytest.mark.slow
@pytest.mark.parametrize("method", [*METHODS, DefiniteOptimalIV()], ids=lambda method: method.name)
def test_too_few_data_are_refused(method: Method) -> None:
    """One line gives four real equations for six unknowns."""
    rig = paper_rig([3.0])
    seen = channels(rig, (D,))
    with pytest.raises((IdentifiabilityError, DataError)):
        identify(rig.model, noisy(rig, seen, covariance(rig, seen, 0.01), np.random.default_rng(0)), method)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_as_many_data_as_unknowns(method: Method) -> None:
    """No degree of freedom is left: the fit is perfect, and no p-value is claimed."""
    rig = paper_rig([3.0, 6.0, 9.5]).knowing({"m1": {"value": 3.0}})
    rig = replace(rig, frequency_hz=rig.frequency_hz[:2], U=rig.U[:2], f=rig.f[:2])
    rig = rig.knowing({"m2": {"value": 2.7}})
    seen = channels(rig, (D,))
    estimate = identify(
        rig.model, noisy(rig, seen, covariance(rig, seen, 0.01), np.random.default_rng(0)), method
    )
    assert estimate.fit.dof == 4
    assert np.all(np.abs(estimate.values - rig.theta) < 6 * estimate.noise_sd)


def test_frequencies_over_four_decades() -> None:
    """0.01 to 100 Hz on a rig of 3 and 10 Hz: the equation error spans eight decades."""
    rig = paper_rig(np.geomspace(0.01, 100, 40))
    rng = np.random.default_rng(4)
    seen = channels(rig, (D,))
    exact = identify(rig.model, perfect(rig, seen))
    np.testing.assert_allclose(exact.values, rig.theta, rtol=1e-8)
    V_ = covariance(rig, seen, 0.01)
    estimate = identify(rig.model, noisy(rig, seen, V_, rng))
    assert np.all(np.abs(estimate.values - rig.theta) < 4.5 * estimate.sd)
    assert not estimate.fit.rejected


def test_lines_at_an_undamped_resonance() -> None:
    """Beside a resonance without damping amplitudes are a million times as large as elsewhere."""
    rig = paper_rig(np.linspace(1, 14, 20))
    light = {f"c{i}": {"value": 1e-6} for i in range(1, 5)}
    rig = rig.knowing(light)
    truth = dict(zip((e.name for e in rig.model.elements), rig.p.tolist(), strict=True))
    truth |= dict.fromkeys(light, 1e-6)
    rig = replace(rig, theta=np.array([truth[name] for name in rig.names]))
    pole = float(_undamped(rig))
    rig = replace(rig, frequency_hz=np.append(rig.frequency_hz[:-1], pole * (1 + 1e-6)))
    seen = channels(rig, (D,))
    for method in METHODS:
        if method == CompensatedLeastSquares():  # has nothing to take out where no noise is stated
            continue
        estimate = identify(rig.model, perfect(rig, seen), method)
        # Unweighted, that one line holds all but 1e-12 of the sums.
        limit = 1e-6 if method.traits.weighted else 1e-4
        np.testing.assert_allclose(estimate.values, rig.theta, rtol=limit)


def _undamped(rig: Rig) -> float:
    from dashpot.model.modes import eigenmodes

    found: np.ndarray = eigenmodes(rig.model, rig.model.parameters(rig.theta)).frequency_hz
    return float(found[0])


def break_nan(spectrum: Spectrum) -> Spectrum:
    Y = np.array(spectrum.amplitudes)
    Y[..., 2, 0] = np.nan
    return replace(spectrum, amplitudes=Y)


def break_inf(spectrum: Spectrum) -> Spectrum:
    Y = np.array(spectrum.amplitudes)
    Y[..., 2, 0] = np.inf
    return replace(spectrum, amplitudes=Y)


def break_zero(spectrum: Spectrum) -> Spectrum:
    return replace(spectrum, amplitudes=np.zeros_like(spectrum.amplitudes))


@pytest.mark.parametrize("damage", [break_nan, break_inf, break_zero])
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_damaged_amplitudes_are_refused_in_words(
    damage: Callable[[Spectrum], Spectrum], method: Method
) -> None:
    """One look at each coordinate: a hole, an infinity, silence."""
    rig = paper_rig()
    seen = channels(rig, (D,))
    spectrum = noisy(rig, seen, covariance(rig, seen, 0.01), np.random.default_rng(0))
    with pytest.raises(DashpotError):
        identify(rig.model, damage(spectrum), method)
