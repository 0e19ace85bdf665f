"""Estimates from data apart, merged: what all data at once give."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.fleet.record_parts import Merged, merge_estimates
from dashpot.model.network import Model
from dashpot.model.observation import with_relative_noise
from dashpot.model.rigfile import parse_rig
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.networks import changed
from tests.two_masses import RIG, VALUES

READ = parse_rig(RIG)
CHANNELS = with_relative_noise(READ.model, READ.channels, 0.03)
TRUTH = READ.model.theta(VALUES)
PARTS = 4


def spectra(rng: np.random.Generator, model: Model = READ.model, changed: float = 1.0) -> list[Spectrum]:
    """Tests of other lines each, the last of a rig whose first unknown is `changed` times as large."""
    made = []
    for k in range(PARTS):
        theta = TRUTH.copy()
        theta[0] *= changed if k == PARTS - 1 else 1.0
        test = dwells(model, np.linspace(1.5, 14, 10 + k), 40)
        made.append(simulate_spectrum(model, model.parameters(theta), CHANNELS, test, rng))
    return made


def of_parts(parts: list[Spectrum], model: Model = READ.model) -> Merged:
    return merge_estimates(model, [identify(model, part, "ml") for part in parts])


def with_prior(model: Model, sd: float) -> Model:
    """The first unknown is known beforehand, 2 % too large, with a standard deviation of `sd` of it."""
    name = model.unknown_names[0]
    return changed(model, name, guess=None, value=1.02 * TRUTH[0], sd=sd * TRUTH[0])


def test_parts_merged_are_all_data_at_once() -> None:
    parts = spectra(np.random.default_rng(1))
    together = identify(READ.model, concatenate(parts), "ml")
    apart = of_parts(parts).estimate
    assert np.all(np.abs(apart.values - together.values) < 0.1 * together.noise_sd)
    assert apart.noise_sd == pytest.approx(together.noise_sd, rel=0.02)
    assert apart.bound_sd == pytest.approx(together.bound_sd, rel=0.02)
    assert float(apart.fit.chi2) == pytest.approx(float(together.fit.chi2), rel=0.2)
    assert apart.fit.dof == together.fit.dof - (PARTS - 1) * len(TRUTH)


def test_the_sum_of_parabolas_written_out() -> None:
    estimates = [identify(READ.model, part, "ml") for part in spectra(np.random.default_rng(2))]
    total = sum(np.linalg.inv(each.noise_covariance) for each in estimates)
    weighted = sum(np.linalg.solve(each.noise_covariance, each.values) for each in estimates)
    result = merge_estimates(READ.model, estimates)
    expected: Real = np.linalg.solve(total, weighted)
    assert result.estimate.values == pytest.approx(expected, rel=1e-9)
    scatter = sum(
        float(d @ np.linalg.solve(each.covariance, d)) for each in estimates for d in [each.values - expected]
    )
    assert result.chi2 == pytest.approx(scatter, rel=1e-6)


def test_what_is_known_beforehand_counts_once() -> None:
    model = with_prior(READ.model, 0.01)
    parts = spectra(np.random.default_rng(3), model)
    together, apart = identify(model, concatenate(parts), "ml"), of_parts(parts, model).estimate
    assert abs(apart.values[0] - together.values[0]) < 0.1 * together.noise_sd[0]
    assert apart.noise_sd == pytest.approx(together.noise_sd, rel=0.02)


@pytest.mark.slow
def test_merged_intervals_cover_and_sound_parts_agree() -> None:
    """300 intervals of 100 draws: 95 ± 1.3 %; of 100 tests for agreement at 5 %, 5 ± 2.2 fail."""
    rng = np.random.default_rng(4)
    results = [of_parts(spectra(rng)) for _ in range(100)]
    inside = [np.abs(r.estimate.values - TRUTH) < 1.96 * r.estimate.sd for r in results]
    assert 0.92 < np.mean(inside) < 0.975
    assert np.mean([r.p < 0.05 for r in results]) < 0.13
    assert not any(r.disagree for r in results)


def test_parts_of_another_rig_disagree_and_widen_the_intervals() -> None:
    result = of_parts(spectra(np.random.default_rng(5), changed=1.1))
    assert result.disagree
    assert result.p < 1e-3
    assert result.estimate.basis == "model misfit"
    assert result.estimate.sd[0] > 2 * result.estimate.noise_sd[0]
    part, unknown = np.unravel_index(np.argmax(np.abs(result.away)), result.away.shape)
    assert (part, unknown) == (PARTS - 1, 0)


def test_one_part_is_itself() -> None:
    alone = identify(READ.model, spectra(np.random.default_rng(6))[0], "ml")
    result = merge_estimates(READ.model, [alone])
    assert result.estimate.values == pytest.approx(alone.values, rel=1e-12)
    assert result.estimate.sd == pytest.approx(alone.noise_sd, rel=1e-9)
    assert (result.chi2, result.dof, result.p) == (pytest.approx(0, abs=1e-12), 0, 1.0)


def changed_names(estimate: Estimate) -> Estimate:
    return replace(estimate, names=(*estimate.names[:-1], "other"))


def without_information(estimate: Estimate) -> Estimate:
    singular = estimate.noise_covariance.copy()
    singular[0] = singular[:, 0] = 0.0
    return replace(estimate, noise_covariance=singular)


@pytest.mark.parametrize(
    ("change", "said"), [(changed_names, "different unknowns"), (without_information, "does not determine")]
)
def test_what_cannot_be_merged_is_refused(change: object, said: str) -> None:
    first, second = (identify(READ.model, part, "ml") for part in spectra(np.random.default_rng(7))[:2])
    assert callable(change)
    with pytest.raises(DataError, match=said):
        merge_estimates(READ.model, [first, change(second)])


def test_a_sensor_turned_between_parts_is_told() -> None:
    first, second = (identify(READ.model, part, "ml") for part in spectra(np.random.default_rng(8))[:2])
    up, down = (replace(each, signs={"x1": np.array(s)}) for each, s in ((first, 1.0), (second, -1.0)))
    with pytest.raises(DataError, match="sign of x1"):
        merge_estimates(READ.model, [up, down])
