"""Noise with heavy tails: Student's distribution, by pseudo-data of normal noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import t as student

import dashpot
from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ModelError
from dashpot.estimate.likelihood.heavy_tails import Tails
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.preparation import prepare
from dashpot.model.network import Model
from dashpot.model.rigfile import parse_rig, write_rig
from tests import rigs
from tests.two_masses import RIG
from tests.whole_rigs import chain, record_of


def table(seed: int, nu: float, *, known: bool) -> tuple[Model, Real, Spectrum]:
    """The paper's rig at 60 frequencies, 2 % noise with `nu` degrees of freedom in each motion."""
    rig = rigs.paper_rig(np.linspace(0.5, 20, 60).tolist())
    exact = rigs.perfect(rig, rigs.channels(rig, (Quantity.DISPLACEMENT,)))
    size = np.sqrt(np.mean(np.abs(exact.amplitudes) ** 2, axis=0)) * 0.02
    size[2:] = 0
    rng = np.random.default_rng([7, seed])
    parts = rng.standard_normal((2, *exact.amplitudes.shape)) / np.sqrt(2)
    stretched = np.sqrt((nu - 2) / rng.chisquare(nu, exact.amplitudes.shape))
    noisy = exact.amplitudes + size * (parts[0] + 1j * parts[1]) * stretched
    V = np.broadcast_to(np.diag(size**2).astype(complex), exact.covariance.shape)
    if known:
        return rig.model, rig.theta, replace(exact, amplitudes=noisy, covariance=V)
    return rig.model, rig.theta, rigs.of_unknown_noise(replace(exact, amplitudes=noisy))


def test_degrees_of_freedom_are_the_likeliest() -> None:
    """Against SciPy's fit of the same numbers; of normal numbers there are none to be had at p < 0.001."""
    rng = np.random.default_rng(3)
    u = rng.standard_t(4, 2000)
    found = Tails.of(u / np.std(u), known=False)
    nu, _, scale = student.fit(u / np.std(u), floc=0.0)
    assert found.freedom == pytest.approx(nu, rel=0.06)  # half a step of those that are tried
    assert found.scale == pytest.approx(scale, rel=0.02)
    assert found.gain > 10.8
    assert Tails.of(rng.standard_normal(2000), known=False).gain < 10.8
    pairs = rng.standard_normal(4000).view(complex) / np.sqrt(rng.chisquare(3, 2000) / 3)
    assert Tails.of(pairs, known=False).freedom == pytest.approx(3, rel=0.2)  # two standard deviations


def test_the_estimate_is_that_of_students_likelihood() -> None:
    """Written out: the density of each amplitude with the degrees of freedom that were found, and SciPy's minimum."""
    model, _, data = table(1, 3.0, known=True)
    found = dashpot.identify(replace(model, distribution="student"), data, method="ml")
    freedom = [
        float(note.text.partition(" degrees")[0].split()[-1])
        for note in found.notes
        if note.code == "heavy_tails"
    ]
    assert len(freedom) == 2
    prepared = prepare(model, data)
    exact, sign = measured(prepared), np.ones((1, len(data.channels)))
    variance = np.diagonal(data.covariance, axis1=1, axis2=2).real[:, :2]

    def minus_log(x: Real) -> float:
        psi = (found.values + x * found.sd)[None]
        power = 2 * np.abs(predict(prepared.view, exact, psi, sign).r[0][:, :2]) ** 2 / variance
        nu = np.array(freedom)
        return float(np.sum((nu + 2) / 2 * np.log1p(power / (nu - 2))))

    end = minimize(minus_log, np.zeros(len(found.values)), method="Nelder-Mead", options={"maxiter": 4000})
    assert np.all(np.abs(end.x) < 0.1)  # standard deviations


def test_a_rig_file_says_that_noise_may_have_heavy_tails() -> None:
    rig = parse_rig(RIG + '[noise]\ndistribution = "auto"\n')
    assert rig.model.distribution == "auto"
    assert parse_rig(write_rig(rig)).model == rig.model
    assert parse_rig(RIG).model.distribution == "normal"
    with pytest.raises(ModelError, match="distribution"):
        parse_rig(RIG + '[noise]\ndistribution = "cauchy"\n')
    with pytest.raises(ModelError, match="noise"):
        parse_rig("noise = 3\n" + RIG)


@pytest.mark.long
@pytest.mark.parametrize("known", [True, False])
def test_tables_with_heavy_tails_err_less_and_intervals_hold(known: bool) -> None:
    """120 draws of six unknowns: the share that 95 % intervals hold has a standard deviation below 1.5 points."""
    errors: dict[str, list[Real]] = {"normal": [], "auto": []}
    held = []
    for seed in range(120):
        for distribution, kept in errors.items():
            model, theta, data = table(seed, 3.0, known=known)
            found = dashpot.identify(replace(model, distribution=distribution), data)
            low, high = found.interval()
            kept.append((found.values - theta) / theta)
            if distribution == "auto":
                held.append((low <= theta) & (theta <= high))
    by_normal, by_tails = (np.sqrt(np.mean(np.square(each), axis=0)) for each in errors.values())
    assert np.mean(by_tails / by_normal) < 0.85
    assert np.mean(held) > (0.92 if known else 0.89)


@pytest.mark.long
def test_intervals_of_records_with_heavy_tails_shrink_and_hold_and_normal_ones_stay() -> None:
    """40 draws of five unknowns: the share that 95 % intervals hold has a standard deviation of about 2 points.

    The band takes the mean of several samples, and tails with it: standard deviations fall by some per cent only.
    """
    shrinks, held = [], []
    for seed in range(40):
        rng = np.random.default_rng([9, seed])
        model, theta = chain(2, 0.03, seed=1)
        test = record_of(model, theta, "random", decay_times=6, seed=seed)
        shape = test.record.values.shape
        heavy = seed < 32
        noise = rng.standard_t(3, shape) / np.sqrt(3) if heavy else rng.standard_normal(shape)
        noise[:, -1] = 0
        record = replace(test.record, values=test.record.values + 0.02 * test.size * noise)
        by_normal = dashpot.identify(model, record)
        by_tails = dashpot.identify(replace(model, distribution="auto"), record)
        if heavy:
            low, high = by_tails.interval()
            held.append((low <= theta) & (theta <= high))
            shrinks.append(by_tails.sd / by_normal.sd)
        else:
            np.testing.assert_array_equal(by_tails.values, by_normal.values)
    assert np.mean(shrinks) < 0.95
    assert np.mean(held) > 0.89
