"""Samples that a channel has not measured are unknowns in a record's lines: against one large Gaussian likelihood."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.check.residuals import residuals
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import MISSING, Record
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.estimate.likelihood.boundary_loads import with_means_of_unmeasured
from dashpot.estimate.likelihood.objective import local, measured, nuisance_columns, per_line, predict
from dashpot.estimate.likelihood.record_sums import record_residuals, shown_by_ends
from dashpot.estimate.preparation import Prepared, prepare
from dashpot.model.observation import calibrated_transfer
from tests.whole_rigs import WholeTest, chain, record_of

GAPS = ((40, 43, 0), (90, 91, 0), (140, 146, 1), (200, 203, 2))


def with_gaps(
    *, noisy_base: bool, correlated: bool = False, known: bool = True
) -> tuple[WholeTest, Spectrum]:
    """A mass seen by displacement and velocity above a base, of which channels miss a few samples."""
    model, theta = chain(2, 0.08, seed=1)
    test = record_of(model, theta, "random", decay_times=1.0, samples_per_cycle=8.0)
    sd = 0.03 * test.size
    sd[-1] *= noisy_base
    record = test.noisy(np.random.default_rng(2), sd)
    status = np.zeros(record.values.shape, dtype=np.int64)
    for begin, end, c in GAPS[: 4 if noisy_base else 3]:
        status[begin:end, c] = MISSING
    spoilt = np.where(status != 0, 7.0 * test.size, record.values)
    lines = whole_record(replace(record, values=spoilt, status=status))
    V = np.diag(4 * sd**2 / len(record.time)).astype(complex)
    if correlated:
        V[0, 1] = V[1, 0] = 0.5 * np.sqrt(V[0, 0] * V[1, 1]).real
    (value,) = lines.stretches
    assert isinstance(value, WholeRecord)
    if not known:
        free = tuple(replace(of, precision=np.zeros(of.precision.shape)) for of in value.unmeasured)
        lines = replace(lines, stretches=(replace(value, unmeasured=free),))
    V = np.broadcast_to(V, lines.covariance.shape)
    return test, replace(lines, covariance=V, noise=("given",) * lines.lines)


def prepared(test: WholeTest, spectrum: Spectrum) -> Prepared:
    return prepare(
        test.model,
        replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=spectrum.covariance[None]),
    )


def gaussian(test: WholeTest, spectrum: Spectrum, psi: Real) -> float:
    """−2 ln L less ln det: V of all lines together, what is known of the samples in it; all else solved for."""
    (value,) = spectrum.stretches
    assert isinstance(value, WholeRecord)
    plain = replace(spectrum, stretches=(replace(value, unmeasured=()),))
    data = prepared(test, plain)
    ends = measured(data).ends
    assert ends is not None
    G, by_load = np.split(calibrated_transfer(ends.view, psi, np.ones((1, 3))).G[0], [1], axis=-1)
    lines, channels = spectrum.amplitudes.shape
    own = np.concatenate([by_load, ends.s[:, None, None] * by_load, ends.polynomials()], axis=-1)
    folded = ends.sampled_loads(psi)
    if folded is not None:
        own[:, :, : 2 * ends.n] += np.moveaxis(folded.at(0, ends.s), -1, 1)[0]
    own = own * ends.used(0)
    inputs = np.zeros((lines, channels, lines), dtype=complex)
    inputs[np.arange(lines), :, np.arange(lines)] = G[:, :, 0]
    free = np.concatenate([own, inputs, 1j * inputs], axis=-1).reshape(lines * channels, -1)
    V = np.zeros((lines, channels, lines, channels), dtype=complex)
    at = np.arange(lines)
    size = np.abs(spectrum.amplitudes).mean(axis=0)
    silent = np.where(np.diagonal(spectrum.covariance[0]).real == 0, (1e-6 * size) ** 2, 0.0)
    V[at, :, at, :] = spectrum.covariance + np.diag(silent)
    V = V.reshape(lines * channels, -1)
    real = np.block([[V.real, -V.imag], [V.imag, V.real]]) / 2
    for of in value.unmeasured:
        columns = np.zeros((lines, channels, len(of.samples)), dtype=complex)
        columns[:, spectrum.index(of.channel.name)] = of.columns(spectrum.omega, value)
        U = columns.reshape(lines * channels, -1)
        U2 = np.concatenate([U.real, U.imag])
        if np.any(of.precision):
            real = real + U2 @ np.linalg.inv(of.precision) @ U2.T
        else:
            free = np.concatenate([free, U], axis=1)
    L = np.linalg.cholesky(real)
    y = with_means_of_unmeasured(spectrum).ravel()
    white = [np.linalg.solve(L, np.concatenate([x.real, x.imag])) for x in (free, y)]
    A = white[0] / np.maximum(np.linalg.norm(white[0], axis=0), 1e-300)
    return float(np.sum((white[1] - A @ np.linalg.lstsq(A, white[1], rcond=1e-11)[0]) ** 2))


@pytest.mark.parametrize("kind", ["noisy base", "exact base", "correlated", "nothing known"])
def test_the_cost_is_that_of_one_gaussian_and_its_slope_belongs_to_it(kind: str) -> None:
    test, spectrum = with_gaps(
        noisy_base=kind != "exact base", correlated=kind == "correlated", known=kind != "nothing known"
    )
    data = prepared(test, spectrum)
    exact, signs = measured(data), np.ones((1, 3))
    psi = 1.02 * test.theta[None]
    at = local(data.view, exact, psi, signs)
    assert at.cost[0] == pytest.approx(gaussian(test, spectrum, psi), rel=1e-6)
    steps = np.diag(1e-5 * test.theta)
    apart = [
        local(data.view, exact, psi + step, signs).cost[0]
        - local(data.view, exact, psi - step, signs).cost[0]
        for step in steps
    ]
    slope = -np.array(apart) / 4e-5
    assert at.gradient[0] * test.theta == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.max(np.abs(slope)))
    # Line by line it is the same: of large rigs, and for evidence
    slow = predict(data.view, exact, psi, signs)
    assert np.sum(slow.cost_per_line) == pytest.approx(at.cost[0], rel=1e-8)
    assert np.sum(slow.information(), axis=1)[0] == pytest.approx(at.symmetric[0], rel=1e-6)
    information, scores, cost = per_line(data.view, exact, psi, signs)
    assert np.sum(cost) == pytest.approx(at.cost[0], rel=1e-8)
    assert np.sum(scores, axis=1)[0] == pytest.approx(at.gradient[0], rel=1e-6)
    assert np.sum(information, axis=1)[0] == pytest.approx(at.symmetric[0], rel=1e-6)
    white, rank = record_residuals(exact.record_pieces, psi, signs)
    assert 2 * np.sum(np.abs(white) ** 2) == pytest.approx(at.cost[0], rel=1e-8)
    assert rank[0] == slow.columns == nuisance_columns(data.view, exact, psi, signs)
    assert slow.at_ends is not None
    shown = shown_by_ends(exact.record_pieces, psi, signs)
    assert np.max(np.abs(shown - slow.at_ends)) < 1e-6 * np.max(np.abs(shown))


@pytest.mark.parametrize("known", [True, False])
def test_residuals_allow_for_samples_that_are_not_measured(known: bool) -> None:
    """Each channel is as far from what is predicted as its noise, its gaps included: they had been 28 times as far."""
    test, spectrum = with_gaps(noisy_base=True, known=known)
    assert residuals(test.model, test.theta, spectrum).rms() == pytest.approx(1, abs=0.15)


def test_what_stands_for_a_missing_sample_does_not_matter() -> None:
    """With nothing known beside the lines, the samples put in may be any."""
    test, spectrum = with_gaps(noisy_base=True, known=False)
    (value,) = spectrum.stretches
    assert isinstance(value, WholeRecord)
    shifted = np.array(spectrum.amplitudes)
    for of in value.unmeasured:
        c = spectrum.index(of.channel.name)
        shifted[:, c] += of.columns(spectrum.omega, value) @ (test.size[c] * np.arange(len(of.samples)))
    costs = []
    for lines in (spectrum, replace(spectrum, amplitudes=shifted)):
        data = prepared(test, lines)
        costs.append(local(data.view, measured(data), test.theta[None], np.ones((1, 3))).cost[0])
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)


def test_quiet_lines_say_how_well_a_missing_sample_is_known() -> None:
    """White noise in a channel that moves in the lowest lines: errors of what is put in are as large as stated."""
    rng = np.random.default_rng(5)
    test = record_of(*chain(1, 0.05), "random", decay_times=4.0, samples_per_cycle=30.0)
    at = np.array([100, 101, 102, 300, 400, 401])
    sd, z2 = 0.02 * test.size, []
    for _ in range(30):
        noisy = test.noisy(rng, sd)
        status = np.zeros(noisy.values.shape, dtype=np.int64)
        status[at, 0] = MISSING
        spoilt = np.where(status != 0, 0.0, noisy.values)
        lines = whole_record(Record(noisy.channels, noisy.time, spoilt, status=status))
        (value,) = lines.stretches
        assert isinstance(value, WholeRecord)
        (of,) = value.unmeasured
        whole = whole_record(noisy, band_hz=(lines.frequency_hz[0], lines.frequency_hz[-1]))
        off = whole.amplitudes[:, 0] - lines.amplitudes[:, 0]
        columns = of.columns(lines.omega, value)
        error = (
            -of.mean
            + np.linalg.lstsq(
                np.concatenate([columns.real, columns.imag]), np.concatenate([off.real, off.imag]), rcond=None
            )[0]
        )
        z2.append(error @ of.precision @ error)
    assert np.mean(z2) == pytest.approx(len(at), rel=0.3)  # 180 squares
