"""Whole records in the likelihood: the projection against one large least squares, slopes against differences."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.spectrum import Spectrum, WholeRecord, concatenate
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.preparation import Prepared, prepare
from dashpot.model.dynamics import dynamic_stiffness, stiffness
from dashpot.model.observation import observation_model
from tests.whole_rigs import WholeTest, chain, record_of, with_ends


def two_records(*, noisy_base: bool = True, seed: int = 1) -> tuple[WholeTest, Spectrum]:
    """A rig of two coordinates, seen by a velocity and an acceleration, its base by its velocity; two noisy records."""
    rng = np.random.default_rng(seed)
    model, theta = chain(2, 0.05, seed=seed)
    spectra = []
    for k, kind in enumerate(("random", "hammer")):
        test = record_of(
            model, theta, kind, decay_times=1.5, quantities=(Quantity.VELOCITY, Quantity.ACCELERATION),
            input_quantity=Quantity.VELOCITY, seed=seed + k,
        )  # fmt: skip
        sd = 0.05 * test.size
        sd[-1] *= noisy_base
        record = test.noisy(rng, sd)
        lines = with_ends(whole_record(record, band_hz=(0.2, 40.0)), polynomial=2 + k)
        V = np.broadcast_to(np.diag(4 * sd**2 / len(record.time)).astype(complex), lines.covariance.shape)
        spectra.append(replace(lines, covariance=V, noise=("given",) * lines.lines))
    return test, concatenate(spectra)


def flat(spectrum: Spectrum) -> Spectrum:
    return replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=spectrum.covariance[None])


def prepared(test: WholeTest, spectrum: Spectrum) -> Prepared:
    one = flat(spectrum)
    return prepare(test.model, one)


def by_one_least_squares(test: WholeTest, spectrum: Spectrum, theta: Real) -> float:
    """χ² with all inputs, loads and polynomials solved for in one real system, written out line by line."""
    model = test.model
    p = model.parameters(theta)
    view = observation_model(model, spectrum.channels, spectrum.omega)
    D = dynamic_stiffness(model, p, spectrum.omega)
    R = -stiffness(model, p, spectrum.omega)[..., model.n :]
    total, n = 0.0, model.n
    for number in spectrum.records:
        shared = spectrum.stretches[number]
        assert isinstance(shared, WholeRecord)
        lines = np.flatnonzero(spectrum.stretch == number)
        top = spectrum.omega[lines].max()
        terms = [(c, k) for c in range(len(view.channels) - 1) for k in range(shared.polynomial)]
        terms.append((len(view.channels) - 1, 0))  # a velocity of the base has one end term
        rows, right = [], []
        inputs = 2 * len(lines)
        for i, line in enumerate(lines):
            jw = 1j * spectrum.omega[line]
            to_x = np.linalg.solve(D[line], np.hstack([R[line], np.eye(n), jw * np.eye(n)]))
            C = (jw**view.derivative)[:, None] * view.on_x
            shown = C @ to_x
            shown[:, :1] += (jw**view.derivative)[:, None] * view.on_q
            sd = np.sqrt(np.diagonal(spectrum.covariance[line]).real / 2)
            columns = np.zeros((len(sd), inputs + 2 * n + len(terms)), dtype=complex)
            columns[:, 2 * i], columns[:, 2 * i + 1] = shown[:, 0], 1j * shown[:, 0]
            columns[:, inputs : inputs + 2 * n] = shown[:, 1:]
            for j, (c, k) in enumerate(terms):
                columns[c, inputs + 2 * n + j] = (jw / top) ** k
            scaled = columns / sd[:, None]
            rows += [scaled.real, scaled.imag]
            y = spectrum.amplitudes[line] / sd
            right += [y.real, y.imag]
        A, b = np.concatenate(rows), np.concatenate(right)
        A = A / np.linalg.norm(A, axis=0)
        total += float(np.sum((b - A @ np.linalg.lstsq(A, b, rcond=1e-8)[0]) ** 2))
    return total


def test_the_cost_is_that_of_one_large_least_squares() -> None:
    test, spectrum = two_records()
    data = prepared(test, spectrum)
    view = observation_model(test.model, spectrum.channels, spectrum.omega)
    exact = measured(data)
    for factor in (1.0, 1.02):
        theta = test.theta * factor
        at = predict(view, exact, theta[None], np.ones((1, len(spectrum.channels))))
        expected = by_one_least_squares(test, spectrum, theta)
        assert np.sum(at.cost_per_line) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("noisy_base", [True, False])
def test_slopes_are_those_of_the_cost(noisy_base: bool) -> None:
    test, spectrum = two_records(noisy_base=noisy_base)
    data = prepared(test, spectrum)
    view = observation_model(test.model, spectrum.channels, spectrum.omega)
    exact = measured(data)
    assert (exact.q is not None) == (not noisy_base)
    sign = np.ones((1, len(spectrum.channels)))
    theta = test.theta * 1.01
    at = predict(view, exact, theta[None], sign)
    slope = -2 * 2 * np.sum((np.conj(at.J) * at.weighted[..., None]).real, axis=(0, 1, 2))
    for j, value in enumerate(theta):
        step = np.zeros(len(theta))
        step[j] = 1e-4 * value
        up, down = (
            float(np.sum(predict(view, exact, (theta + s * step)[None], sign).cost_per_line)) for s in (1, -1)
        )
        assert slope[j] == pytest.approx((up - down) / (2 * step[j]), rel=2e-5)


def test_exact_inputs_are_the_limit_of_small_noise() -> None:
    test, spectrum = two_records(noisy_base=False)
    V = np.array(spectrum.covariance)
    V[:, -1, -1] = (1e-6 * np.mean(np.abs(spectrum.amplitudes[:, -1]))) ** 2
    view = observation_model(test.model, spectrum.channels, spectrum.omega)
    sign = np.ones((1, len(spectrum.channels)))
    costs = [
        float(np.sum(predict(view, measured(prepared(test, lines)), test.theta[None], sign).cost_per_line))
        for lines in (spectrum, replace(spectrum, covariance=V))
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-4)


def test_repeats_are_projected_each_by_itself() -> None:
    test, spectrum = two_records()
    other = replace(spectrum, amplitudes=spectrum.amplitudes * 1.5 + 1e-5)
    both = replace(
        spectrum,
        amplitudes=np.stack([spectrum.amplitudes, other.amplitudes]),
        covariance=spectrum.covariance[None],
    )
    view = observation_model(test.model, spectrum.channels, spectrum.omega)
    sign = np.ones((2, len(spectrum.channels)))
    data = prepare(test.model, both)
    together = predict(view, measured(data), np.stack([test.theta, 1.1 * test.theta]), sign)
    for k, (lines, factor) in enumerate(((spectrum, 1.0), (other, 1.1))):
        alone = predict(view, measured(prepared(test, lines)), factor * test.theta[None], sign[:1])
        np.testing.assert_allclose(together.cost_per_line[k], alone.cost_per_line[0], rtol=1e-6)
