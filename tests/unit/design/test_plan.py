"""Plans: budgets, whole periods, shortest tests, comparisons, files; robust tests, sensors, the stopping rule."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.design.advise import Question, answer
from dashpot.design.allocation import Allocation
from dashpot.design.alternative import compare_tests
from dashpot.design.budget import Budget
from dashpot.design.criteria import AOptimal, Minimax, MinimaxTargets
from dashpot.design.frequency_grid import band_grid
from dashpot.design.plan import plan
from dashpot.design.plan_files import plan_to_csv, plan_to_json
from dashpot.design.precision import expected_precision
from dashpot.design.robust import (
    GaussianPrior,
    UniformBox,
    gaussian_prior_of,
    in_the_worst_case,
    on_average,
    shortest_in_the_worst_case,
    slowest_settling,
    uniform_box_of,
    worst_scenario,
)
from dashpot.design.rounding import DesignProblem, DwellShares
from dashpot.design.schedule import Schedule, even_schedule
from dashpot.design.sensors import choose
from dashpot.design.shortest import shortest
from dashpot.design.stopping import enough, known_after, noise_from, sequential_estimates, values_after
from dashpot.design.test_setup import ShakerLimits, TestSetup, nominal_setup
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.quantities import frequencies
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.rigs import paper_rig

CASE3 = "1,1.5,2:4:0.25,5,6,7,8:12:0.5,13,14"
BAND = (0.25, 25.0)


def paper_bench(limits: ShakerLimits | None = None) -> TestSetup:
    rig = paper_rig()
    sensors = [
        Channel(f"{'' if q is Quantity.DISPLACEMENT else 'd'}{x}", {x: 1.0}, q, relative_noise=0.1)
        for q in (Quantity.DISPLACEMENT, Quantity.VELOCITY)
        for x in ("x1", "x2")
    ]
    return nominal_setup(rig.model, [*sensors, Channel("u", {"u": 1.0})], rig.theta, limits=limits)


def measured(own: TestSetup, samples: int = 56, seed: int = 0, f: str = CASE3) -> Spectrum:
    rng = np.random.default_rng(seed)
    test = dwells(own.model, frequencies(f), samples)
    return simulate_spectrum(own.model, own.p[0], own.channels, test, rng)


def test_samples_are_spent_to_the_last() -> None:
    found = plan(paper_bench(), AOptimal(), Budget(samples=1400), band_grid(paper_bench(), *BAND))
    assert found.samples == 1400
    assert found.predicted.figure <= 0.0090
    assert 0 <= found.loss < 1e-4
    assert found.time_s is None


def test_time_counts_settling_and_whole_periods() -> None:
    own = paper_bench()
    budget = Budget(time=30, rate=100, settle=own.settling(), min_dwell=2.0)
    found = plan(own, AOptimal(), budget, band_grid(own, *BAND))
    assert found.time_s is not None
    assert 29 < found.time_s <= 30
    for dwell in found.dwells:
        assert dwell.time_s is not None
        assert dwell.time_s >= 2.0
        assert dwell.time_s * dwell.frequency_hz == pytest.approx(dwell.periods, abs=1e-9)
        assert dwell.samples == int(dwell.time_s * 100 + 1e-9)


def test_settling_is_that_of_the_slowest_mode() -> None:
    """Real parts of the paper's eigenvalues: −16.05 and −26.2 1/s."""
    assert paper_bench().settling() == pytest.approx(np.log(1000) / 16.0467, rel=1e-3)


def test_long_settling_and_few_dwells() -> None:
    """With settling of a third of the time fewer dwells are better; never more than are allowed."""
    own, grid = paper_bench(), band_grid(paper_bench(), *BAND)
    free = plan(own, AOptimal(), Budget(time=60, rate=100, settle=0.1), grid)
    slow = plan(own, AOptimal(), Budget(time=60, rate=100, settle=20.0), grid)
    assert len(slow.dwells) < len(free.dwells)
    two = plan(own, AOptimal(), Budget(samples=1400, most=2), grid)
    assert len(two.dwells) == 2
    # No pair of frequencies of a grid with any split does better.
    f = np.geomspace(*BAND, 25)
    M = own.information(f, np.zeros(25, dtype=int))[0]
    best = np.inf
    for i in range(25):
        for j in range(i):
            for part in np.linspace(0.2, 0.8, 13):
                C = np.linalg.inv(1400 * (part * M[i] + (1 - part) * M[j]))
                best = min(best, float(np.trace(C)) / 6)
    assert two.predicted.figure <= np.sqrt(best) * 1.001


def test_too_small_a_budget() -> None:
    own = paper_bench()
    grid = band_grid(own, *BAND)
    with pytest.raises(UsageError, match="settling alone"):
        plan(own, AOptimal(), Budget(time=1, rate=100, settle=2), grid)
    with pytest.raises(UsageError, match="holds no test"):
        plan(own, AOptimal(), Budget(samples=3), grid)
    with pytest.raises(UsageError, match="sampling rate"):
        plan(own, AOptimal(), Budget(samples=300, rate=30), grid)
    with pytest.raises(UsageError, match="needs the sampling rate"):
        Budget(time=10)
    with pytest.raises(UsageError, match="a number of samples or a time"):
        Budget()


@pytest.mark.parametrize("target", [0.02, 0.005])
def test_the_shortest_test_just_reaches_its_target(target: float) -> None:
    own = paper_bench()
    grid = band_grid(own, *BAND)
    found = shortest(own, Minimax(), target, Budget(samples=100), grid)
    assert found is not None
    assert 0.99 * target < np.max(found.predicted.relative) <= target
    fewer = plan(own, Minimax(), Budget(samples=round(0.98 * found.samples)), grid)
    assert np.max(fewer.predicted.relative) > target


def test_targets_by_name() -> None:
    own = paper_bench()
    found = shortest(
        own, MinimaxTargets({"c2": 0.02, "m1": 0.005}), 1.0, Budget(samples=100), band_grid(own, *BAND)
    )
    assert found is not None
    by_name = dict(zip(found.predicted.names, found.predicted.relative, strict=True))
    assert by_name["c2"] <= 0.02
    assert by_name["m1"] <= 0.005


def test_case_3_takes_many_times_the_samples() -> None:
    """The paper's CASE 3: 1.42 % at the bound, 2.76 % by its instrumental variables (their Monte Carlo: 2.7 %)."""
    own = paper_bench()
    found = plan(own, AOptimal(), Budget(samples=1400), band_grid(own, *BAND))
    beside = compare_tests(own, AOptimal(), found, even_schedule(frequencies(CASE3), 1400))
    assert beside.predicted.figure == pytest.approx(0.0142, abs=1e-4)
    assert beside.iv is not None
    assert beside.iv.rms() == pytest.approx(0.0276, abs=3e-4)
    assert beside.factor == pytest.approx((beside.predicted.figure / found.predicted.figure) ** 2, rel=1e-6)
    assert beside.factor_iv == pytest.approx(9.6, abs=0.3)


def test_case_3_under_constant_noise() -> None:
    """Floors of 0.05 and 1.5 at unit amplitude: 0.91 %; CASE 3 takes 1.75 times the samples, with iv 8.7 times."""
    rig = paper_rig()
    sensors = [
        Channel(f"{q.value[0]}{x}", {x: 1.0}, q, noise=noise)
        for q, noise in ((Quantity.DISPLACEMENT, 0.05), (Quantity.VELOCITY, 1.5))
        for x in ("x1", "x2")
    ]
    own = nominal_setup(rig.model, [*sensors, Channel("u", {"u": 1.0})], rig.theta)
    found = plan(own, AOptimal(), Budget(samples=1400), band_grid(own, *BAND))
    assert found.predicted.figure <= 0.0092
    beside = compare_tests(own, AOptimal(), found, even_schedule(frequencies(CASE3), 1400))
    assert beside.predicted.figure == pytest.approx(0.0120, abs=1e-4)
    assert beside.iv is not None
    assert beside.iv.rms() == pytest.approx(0.0268, abs=1e-4)
    assert beside.factor == pytest.approx(1.75, abs=0.02)
    assert beside.factor_iv == pytest.approx(8.7, abs=0.1)


@pytest.mark.parametrize(
    ("name", "percent"),
    [("m1", 0.534), ("m2", 0.579), ("c1", 0.950), ("c2", 0.902), ("c3", 0.421), ("c4", 1.161)],
)
def test_the_best_test_for_each_parameter(name: str, percent: float) -> None:
    """What examples/design says; no test of three dwells drawn at random does better."""
    own = paper_bench()
    found = plan(own, AOptimal((name,)), Budget(samples=1400), band_grid(own, *BAND))
    assert found.gap < 1e-6
    assert 100 * found.predicted.figure == pytest.approx(percent, abs=1e-3)
    rng = np.random.default_rng(0)
    f = np.exp(rng.uniform(*np.log(BAND), (300, 3)))
    w = rng.dirichlet(np.ones(3), 300)
    M = own.information(f.ravel(), np.zeros(900, dtype=int))[0].reshape(300, 3, 6, 6)
    C = np.linalg.inv(1400 * np.einsum("ti,tiab->tab", w, M))
    j = own.names.index(name)
    assert np.min(C[:, j, j]) >= found.predicted.figure**2


def test_limits_of_the_shaker_set_the_amplitudes() -> None:
    limits = ShakerLimits(stroke=0.01, velocity=0.2, acceleration=5.0, force=40.0)
    own = paper_bench(limits)
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


def test_files() -> None:
    own = paper_bench()
    found = plan(own, AOptimal(), Budget(time=30, rate=100, settle=0.5), band_grid(own, *BAND))
    content = json.loads(plan_to_json(found))
    assert [d["samples"] for d in content["dwells"]] == [d.samples for d in found.dwells]
    assert content["dwells"][0]["amplitudes"] == {"u": 1.0}
    assert content["predicted"]["m1"]["sd"] == pytest.approx(found.predicted.sd[0])
    assert content["gap"] < 1e-6
    rows = plan_to_csv(found).splitlines()
    assert rows[0] == "dwell,frequency_hz,u_amplitude,settle_s,periods,time_s,samples"
    assert len(rows) == 1 + len(found.dwells)


def test_existing_data_count() -> None:
    """Information of earlier data is added: the rest of a test knows what its beginning has told."""
    own = paper_bench()
    estimate = identify(own.model, measured(own))
    here = nominal_setup(own.model, own.channels, values_after(own.model, estimate))
    known = here.known(known_after(here, estimate))
    before = expected_precision(here, AOptimal(), known)
    assert np.allclose(before.sd, estimate.sd, rtol=1e-6)
    found = plan(here, AOptimal(), Budget(samples=700), band_grid(here, *BAND), known=known)
    alone = plan(here, AOptimal(), Budget(samples=700), band_grid(here, *BAND))
    assert found.predicted.figure < min(before.figure, alone.predicted.figure)
    assert found.gap < 1e-6


def test_known_with_an_sd_is_known() -> None:
    """A prior so tight that nothing is left to find costs no samples."""
    rig = paper_rig()
    tight = rig.knowing({"m2": {"value": 2.7, "sd": 1e-6}})
    own = nominal_setup(tight.model, paper_bench().channels, tight.theta)
    found = plan(own, AOptimal(), Budget(samples=1400), band_grid(own, *BAND))
    assert found.predicted.sd[found.predicted.names.index("m2")] == pytest.approx(1e-6, rel=1e-3)
    free = plan(
        paper_bench(), AOptimal(("m1", "c1", "c2", "c3", "c4")), Budget(samples=1400), band_grid(own, *BAND)
    )
    assert found.predicted.figure < free.predicted.figure


def test_robust_tests() -> None:
    own = paper_bench()

    def grid_of(wide: TestSetup):  # type: ignore[no-untyped-def]
        return band_grid(wide, *BAND)

    nominal = plan(own, AOptimal(), Budget(samples=1400), grid_of(own))
    box = UniformBox(0.3)
    before, at = worst_scenario(own, AOptimal(), nominal.schedule, box)
    assert np.all(np.abs(at / own.theta[0] - 1) <= 0.3 + 1e-12)
    safe = in_the_worst_case(own, AOptimal(), Budget(samples=1400), box, grid_of)
    assert safe.worst < before
    assert safe.plan.gap < 1e-6
    after, _ = worst_scenario(own, AOptimal(), safe.plan.schedule, box, count=2000, seed=9)
    assert after <= safe.worst * 1.005
    calm = on_average(
        own, AOptimal(), Budget(samples=1400), GaussianPrior(np.diag((0.1 * own.theta[0]) ** 2)), grid_of
    )
    assert calm.plan.gap < 1e-6
    with pytest.raises(UsageError, match="between 0 and 100"):
        in_the_worst_case(own, AOptimal(), Budget(samples=1400), UniformBox(1.5), grid_of)


def test_the_shortest_robust_test() -> None:
    """Its worst case just reaches the target; the nominal test's does not; nothing to do where enough is known."""
    own = paper_bench()

    def grid_of(wide: TestSetup):  # type: ignore[no-untyped-def]
        return band_grid(wide, *BAND)

    box, budget = UniformBox(0.2), Budget(samples=1000)
    nominal = shortest(own, AOptimal(), 0.02, budget, grid_of(own))
    safe = shortest_in_the_worst_case(own, AOptimal(), 0.02, budget, box, grid_of)
    calm = on_average(own, AOptimal(), budget, box, grid_of, target=0.02)
    assert nominal is not None
    assert safe.plan is not None
    assert calm.plan is not None
    assert nominal.samples < calm.plan.samples < safe.plan.samples
    assert safe.worst <= 0.02
    after, _ = worst_scenario(own, AOptimal(), safe.plan.schedule, box, count=1000, seed=9)
    assert 0.0195 < after < 0.02 * 1.003
    assert worst_scenario(own, AOptimal(), nominal.schedule, box)[0] > 0.021
    known = np.diag((1e-3 * own.theta[0]) ** -2.0)
    assert shortest_in_the_worst_case(own, AOptimal(), 0.02, budget, box, grid_of, known=known).plan is None


def test_doubts_of_the_rig_file_and_of_an_estimate() -> None:
    """A part of every value, less where an sd is stated; an estimate's covariance without its calibrations."""
    rig = paper_rig()
    known = rig.knowing({"m2": {"value": 2.7, "sd": 0.027}})
    box = uniform_box_of(known.model, known.theta, 0.3)
    names = [u.name for u in known.model.unknowns]
    wide = dict(zip(names, np.broadcast_to(box.relative, len(names)), strict=True))
    assert wide.pop("m2") == pytest.approx(0.0196)
    assert set(wide.values()) == {0.3}
    own = paper_bench()
    loose = tuple(replace(c, gain=None) if c.name == "dx1" else c for c in own.channels)
    data = replace(measured(own), channels=loose)
    estimate = identify(own.model, data)
    assert estimate.covariance.shape == (7, 7)
    cloud = gaussian_prior_of(own.model, estimate)
    assert np.allclose(cloud.covariance, estimate.covariance[:6, :6])
    drawn = cloud.draw(own.theta[0], 4000, np.random.default_rng(0))
    # Cut at 2.5 sd, a normal keeps 0.97 of its spread; 4,000 draws know it to 1.1 % (1 sd).
    assert np.std(drawn, axis=0) == pytest.approx(0.98 * estimate.sd[:6], rel=0.05)
    with pytest.raises(UsageError, match="says nothing of"):
        gaussian_prior_of(rig.model, replace_names(estimate))


def replace_names(estimate: Estimate) -> Estimate:
    """An estimate of somebody else's unknowns."""
    return replace(estimate, names=tuple(f"other {name}" for name in estimate.names))


def test_a_doubt_of_nothing_asks_for_the_test_of_the_values() -> None:
    own = paper_bench()
    values = dict(zip((u.name for u in own.model.unknowns), own.theta[0], strict=True))
    asked = Question(
        model=own.model,
        channels=own.channels,
        criterion=AOptimal(),
        values=values,
        samples=1000,
        band=(0.5, 25),
    )
    plain, doubted = answer(asked).plan, answer(replace(asked, uncertainty=0)).plan
    assert plain is not None
    assert doubted is not None
    assert doubted.predicted.figure == pytest.approx(plain.predicted.figure, rel=1e-4)


def test_settling_of_the_slowest_rig_of_a_doubt() -> None:
    """Masses 30 % heavier behind dampers 30 % weaker settle 1.86 times as slowly; 64 draws come near."""
    own = paper_bench()
    assert 1.3 * own.settling() < slowest_settling(own, UniformBox(0.3)) <= 1.9 * own.settling()
    assert slowest_settling(own, UniformBox(0.0)) == pytest.approx(own.settling())


def test_dwells_that_crowd_are_one() -> None:
    """The optimum is flat: neighbours are joined where that costs less than 1e-4 of the variance, and only there."""
    own, budget = paper_bench(), Budget(samples=1400)
    grid = band_grid(own, *BAND)
    f = np.array([3.79, 3.795, 3.8, 3.81, 9.4, 9.6, 25.0])
    share = np.array([0.05, 0.05, 0.05, 0.03, 0.2, 0.22, 0.4])
    crowd = Allocation(f, np.zeros(7, dtype=int), share, 0.0, 0.0, (f, np.zeros(7, dtype=int), f))
    terms = AOptimal().terms(own, "worst")
    shares = DwellShares(DesignProblem(own, terms, own.prior, budget, grid), crowd)
    shares.join()
    assert shares.count == 3
    assert np.sum(shares.w) == pytest.approx(1.0)
    before = expected_precision(
        own, AOptimal(), Schedule(f, np.zeros(7, dtype=int), 1400 * share).information(own)
    ).figure
    after = expected_precision(
        own, AOptimal(), Schedule(shares.f, shares.k, 1400 * shares.w).information(own)
    ).figure
    assert after <= before * (1 + 5e-5)
    # Two frequencies apart that are both needed stay two, also on a grid of fixed frequencies.
    fixed = band_grid(own, *BAND, 0.25)
    apart = Allocation(
        np.array([3.75, 9.5, 25.0]), np.zeros(3, dtype=int), np.array([0.2, 0.4, 0.4]), 0.0, 0.0,
        (f, np.zeros(7, dtype=int), f),
    )  # fmt: skip
    shares = DwellShares(DesignProblem(own, terms, own.prior, budget, fixed), apart)
    shares.join()
    assert shares.f.tolist() == [3.75, 9.5, 25.0]


def test_sensors_by_all_sets_and_by_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    own = paper_bench()
    grid = band_grid(own, *BAND)
    found = choose(own, AOptimal(), 1400, grid, 2)
    assert found.complete
    assert len(found.ranking) == 6
    # Both looks at the same mass tell nothing of the other one's share: the two worst sets.
    assert {frozenset(names) for names, _ in found.ranking[-2:]} == {
        frozenset({"x1", "dx1"}),
        frozenset({"x2", "dx2"}),
    }
    monkeypatch.setattr("dashpot.design.sensors.EXACT", 0)
    quick = choose(own, AOptimal(), 1400, grid, 2)
    assert not quick.complete
    assert quick.ranking[0][1] == pytest.approx(found.ranking[0][1], rel=1e-3)
    with pytest.raises(UsageError, match="no channel x9"):
        choose(own, AOptimal(), 1400, grid, 1, ("x9",))


def test_noise_that_data_show() -> None:
    rig = paper_rig()
    true = [
        Channel("x1", {"x1": 1.0}, noise=0.05, relative_noise=0.03),
        Channel("x2", {"x2": 1.0}, unit="mm", scale=1e-3, noise=40.0),
        Channel("u", {"u": 1.0}),
    ]
    test = dwells(rig.model, np.geomspace(0.5, 25, 40), 4000)
    spectrum = simulate_spectrum(rig.model, rig.p, true, test, np.random.default_rng(0), noise="estimated")
    silent = tuple(replace(c, noise=0.0, relative_noise=0.0) for c in true)
    found = noise_from(silent, spectrum)
    assert found[0].noise == pytest.approx(0.05, rel=0.05)
    assert found[0].relative_noise == pytest.approx(0.03, rel=0.1)
    assert found[1].noise == pytest.approx(40.0, rel=0.05)
    assert found[2].noise == 0


def test_stopping_rule() -> None:
    """More of the same: the predicted number of samples makes the worst interval as narrow as was asked."""
    own = paper_bench()
    data = measured(own)
    estimate = identify(own.model, data)
    targets = dict.fromkeys(own.names, 0.01)
    verdict = enough(estimate, targets, 1400)
    assert not verdict.reached
    relative = dict(zip(estimate.names, estimate.sd / estimate.values, strict=True))
    assert verdict.worst == max(relative, key=lambda name: relative[name])
    assert verdict.more == pytest.approx(1400 * ((relative[verdict.worst] / 0.01) ** 2 - 1), abs=2)
    later = identify(own.model, measured(own, round(56 * (1 + verdict.more / 1400) * 1.1), 1))
    assert enough(later, targets, 1).reached
    tale = sequential_estimates(own.model, data, steps=6)
    assert tale.samples[-1] == 1400
    assert np.allclose(tale.sd[-1], estimate.sd)


def test_the_stopping_rule_reads_what_the_goal_reads() -> None:
    """Rms and mean radius against the matrices; priors do not grow with the samples; calibrations may be there."""
    own = paper_bench()
    loose = tuple(replace(c, gain=None) if c.name == "dx1" else c for c in own.channels)
    estimate = identify(own.model, replace(measured(own), channels=loose))
    names = estimate.names[:6]
    C = estimate.covariance[:6, :6] / np.outer(estimate.values[:6], estimate.values[:6])
    targets = dict.fromkeys(names, 0.01)
    rms = enough(estimate, targets, 1400, reading="rms")
    assert rms.excess == pytest.approx(np.sqrt(np.trace(C) / 6) / 0.01)
    assert rms.more == pytest.approx(1400 * (rms.excess**2 - 1), abs=2)
    volume = enough(estimate, targets, 1400, reading="volume")
    assert volume.excess == pytest.approx(np.exp(np.log(np.linalg.det(C)) / 12) / 0.01)
    each = enough(estimate, targets, 1400)
    assert volume.excess < rms.excess < each.excess
    prior = np.zeros((6, 6))
    prior[0, 0] = 0.5 / estimate.covariance[0, 0]
    assert enough(estimate, {"m1": 0.003}, 1400, prior).more > enough(estimate, {"m1": 0.003}, 1400).more
    assert enough(estimate, dict.fromkeys(names, 0.5), 1400, reading="rms").reached


def test_another_test_after_data_counts_them_too() -> None:
    """Optimal or by the paper's bootstrap: what is known already is weighed with it."""
    own = paper_bench()
    found = plan(own, AOptimal(), Budget(samples=1400), band_grid(own, *BAND))
    other = even_schedule(frequencies(CASE3), 1400)
    alone = compare_tests(own, AOptimal(), found, other)
    known = own.known(np.diag((0.01 * own.theta[0]) ** -2.0))
    both = compare_tests(own, AOptimal(), found, other, known=known)
    assert alone.iv is not None
    assert both.iv is not None
    C = np.linalg.inv(np.linalg.inv(alone.iv.covariance) + np.diag((0.01 * own.theta[0]) ** -2.0))
    assert both.iv.sd == pytest.approx(np.sqrt(np.diagonal(C)), rel=1e-9)
    assert both.factor_iv is None


def test_vague_estimates_give_way_to_guesses() -> None:
    own = paper_bench()
    estimate = identify(own.model, measured(own, 4, 0, "1,1.2,1.4,1.6"))
    values = values_after(own.model, estimate, {"c2": 41.0})
    assert estimate.sd[3] > 0.5 * abs(estimate.values[3])
    assert values["c2"] == 41.0
