"""Maximum likelihood against slow twins: χ² written out and minimised by scipy, inputs as unknowns, priors as GLS."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import concatenate
from dashpot.errors import ConvergenceError, IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.global_search import not_unique
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.unknowns import Unknown
from tests.networks import changed
from tests.partly_seen import Bench, calibrations, noisy_base, pitch_and_bounce, reaction, two

ML = MaximumLikelihood()


def whitened(bench, spectrum):
    """Residuals of the textbook, (ȳ − y) in standard deviations: exact channels left out, inputs given as they are."""
    noisy = [c for c, channel in enumerate(bench.channels) if bench.noise.get(channel.name, bench.noise[""])]
    roots = (
        np.linalg.cholesky(np.linalg.inv(spectrum.covariance[:, noisy][:, :, noisy])).conj().swapaxes(-1, -2)
    )

    def residuals(psi, q=None):
        away = (spectrum.amplitudes - bench.shown(psi, q))[:, noisy]
        white = np.sqrt(2) * (roots @ away[..., None])[..., 0]
        return np.concatenate([white.real.ravel(), white.imag.ravel()])

    return residuals


@pytest.mark.parametrize(
    "make", [two, reaction, calibrations, pitch_and_bounce], ids=lambda make: make.__name__
)
def test_output_error_is_what_scipy_minimises(make):
    bench = make()
    spectrum = bench.spectrum(np.random.default_rng(4), correlation=0.5)
    estimate = identify(bench.model, spectrum, ML)
    residuals = whitened(bench, spectrum)
    size = np.abs(bench.psi)
    slow = least_squares(lambda z: residuals(z * size), bench.psi / size, xtol=1e-13, ftol=1e-13, gtol=1e-13)
    assert np.all(np.abs(estimate.values - slow.x * size) < 1e-4 * estimate.sd)
    assert estimate.fit.chi2 == pytest.approx(2 * slow.cost, rel=1e-9)
    covariance = np.linalg.inv(slow.jac.T @ slow.jac) * np.outer(size, size)
    assert np.allclose(estimate.covariance, covariance, rtol=1e-3, atol=1e-4 * np.abs(covariance).max())
    assert estimate.fit.dof == len(slow.fun) - len(bench.psi)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_profiled_inputs_are_those_of_the_joint_search(correlation):
    """The base's real and imaginary amplitude at each line as explicit unknowns beside the rig's: 11 + 44 unknowns."""
    bench = noisy_base()
    spectrum = bench.spectrum(np.random.default_rng(6), correlation=correlation)
    estimate = identify(bench.model, spectrum, ML)
    residuals = whitened(bench, spectrum)
    m, lines, scale = len(bench.psi), bench.lines, 0.01

    def joint(z):
        q = scale * (z[m : m + lines] + 1j * z[m + lines :])
        return residuals(z[:m] * bench.psi, q[:, None])

    start = np.concatenate([np.ones(m), bench.q[:, 0].real / scale, bench.q[:, 0].imag / scale])
    slow = least_squares(joint, start, xtol=1e-13, ftol=1e-13, gtol=1e-13)
    assert np.all(np.abs(estimate.values - slow.x[:m] * bench.psi) < 1e-4 * estimate.sd)
    assert estimate.fit.chi2 == pytest.approx(2 * slow.cost, rel=1e-9)
    covariance = np.linalg.inv(slow.jac.T @ slow.jac)[:m, :m] * np.outer(bench.psi, bench.psi)
    assert np.allclose(estimate.sd, np.sqrt(np.diag(covariance)), rtol=1e-3)
    assert estimate.fit.dof == len(slow.fun) - len(slow.x)


# Priors


def test_a_prior_is_one_more_row_and_comes_out_updated():
    """Against generalised least squares of the free estimate and the prior, exact where the noise is small."""
    free = two(noise=1e-4, known="m2", full=True)
    spectrum = free.spectrum(np.random.default_rng(8))
    alone = identify(free.model, spectrum, ML)
    sd = {"k1": 0.7 * alone["k1"].sd, "c4": 2 * alone["c4"].sd, "c1": alone["c1"].sd}
    stated = {
        name: free.truth[name] + off * width
        for (name, width), off in zip(sd.items(), (1.5, -1, 0.5), strict=True)
    }
    elements = tuple(
        replace(e, value=stated[e.name], sd=sd[e.name]) if e.name in sd else e for e in free.model.elements
    )
    both = identify(replace(free.model, elements=elements), spectrum, ML)
    assert both.names == alone.names
    precision = np.diag([1 / sd[name] ** 2 if name in sd else 0.0 for name in alone.names])
    mean = np.array([stated.get(name, 0.0) for name in alone.names])
    information = np.linalg.inv(alone.covariance)
    covariance = np.linalg.inv(information + precision)
    expected = covariance @ (information @ alone.values + precision @ mean)
    assert np.all(np.abs(both.values - expected) < 2e-3 * both.sd)
    assert np.all(np.abs(both.covariance - covariance) < 1e-3 * np.outer(both.sd, both.sd))
    for name in sd:
        assert both[name].sd < min(sd[name], alone[name].sd)
        assert abs(both[name].value - stated[name]) > 0.05 * sd[name]
    penalty = np.sum(((both.values - mean) * np.sqrt(np.diag(precision))) ** 2)
    moved = both.values - alone.values
    assert both.fit.chi2 == pytest.approx(alone.fit.chi2 + penalty + moved @ information @ moved, rel=1e-3)
    assert both.fit.dof == alone.fit.dof + 3


def test_a_prior_makes_up_for_the_scale_that_nothing_else_gives():
    """Without forces a base gives ratios alone; a mass known to 5 % gives all, each 5 % wide and more."""
    bench = two(known="")
    found = identify(
        changed(bench.model, "m2", value=1.02, sd=0.05), bench.spectrum(np.random.default_rng(9)), ML
    )
    assert found["m2"].value == pytest.approx(1.02, rel=1e-5)
    assert found["m2"].sd == pytest.approx(0.05, rel=1e-3)
    assert all(value.sd / value.value > 0.049 * 0.98 for value in found)


# Several experiments


def test_experiments_are_identified_together():
    """A shaken base and a push, other sensors and inputs at each line: one answer, with the information of both."""
    base, push = two(), two()
    model = Model(("x1", "x2"), (Input("u"), Input("p", "force", {"x2": 1.0})), base.model.elements)
    rng = np.random.default_rng(2)
    f = base.frequency_hz
    drive = np.exp(rng.uniform(-1, 1, (14, 1)) + 1j * rng.uniform(0, 6, (14, 1)))
    still = np.zeros((14, 1), dtype=complex)
    x2, u, p = base.channels[1], base.channels[2], Channel("p", {"p": 1}, Quantity.FORCE)
    quiet = {"": 0.02, "u": 0.0, "p": 0.0}
    shaken = replace(base, model=model, U=0.01 * drive, f=still, channels=(*base.channels, p), noise=quiet)
    pushed = replace(
        push, model=model, U=still, f=10 * drive[::-1], noise=quiet, frequency_hz=f * 1.07,
        channels=(Channel("v1", {"x1": 1}, Quantity.VELOCITY), x2, u, p),
    )  # fmt: skip
    one, other = shaken.spectrum(rng), pushed.spectrum(rng)
    other = replace(other, experiment=np.ones(14, dtype=int))
    both = identify(model, concatenate([one, other]), ML)
    assert np.all(np.abs(both.values - base.psi) < 4 * both.sd)
    assert both.fit.dof == 2 * 2 * 28 - len(base.psi)
    assert both.fit.p > 1e-3
    total = shaken.information() + pushed.information()
    assert np.allclose(both.sd, np.sqrt(np.diag(np.linalg.inv(total))), rtol=0.15)
    assert np.all(both.sd < identify(model, one, ML).sd * 1.05)
    # While the base stands still, c1 and c3 lie side by side: the push alone does not tell them apart.
    with pytest.raises(IdentifiabilityError, match="cannot separate c1 and c3"):
        identify(model, other, ML)


def test_inputs_that_are_not_measured_at_all():
    """Three sensors, an unmeasured base: what the sensors say to each other gives the rig where enough is known."""
    bench = noisy_base()
    given = [
        replace(e, value=bench.truth[e.name]) if e.name in ("k1", "c1") else e for e in bench.model.elements
    ]
    blind = replace(bench, model=replace(bench.model, elements=tuple(given)), channels=bench.channels[:3])
    found = identify(blind.model, blind.spectrum(np.random.default_rng(3)), ML)
    assert np.all(np.abs(found.values - blind.psi) < 4.5 * found.sd)
    assert found.fit.p > 1e-3


def test_an_input_left_empty_in_one_experiment_is_told():
    """A load cell that is not written while the base shakes: the force is unknown there, and intervals are wider."""
    bench = two()
    model = Model(("x1", "x2"), (Input("u"), Input("p", "force", {"x2": 1.0})), bench.model.elements)
    p = Channel("p", {"p": 1}, Quantity.FORCE)
    shaken = replace(
        bench, model=model, f=np.zeros((14, 1), dtype=complex), channels=(*bench.channels, p),
        noise={"": 0.02, "u": 0.0, "p": 0.0},
    )  # fmt: skip
    rested = shaken.spectrum(np.random.default_rng(4))
    amplitudes, covariance = rested.amplitudes.copy(), rested.covariance.copy()
    amplitudes[7:, 3], covariance[7:, 3, :], covariance[7:, :, 3] = np.nan, np.nan, np.nan
    blank = replace(rested, amplitudes=amplitudes, covariance=covariance)
    at_rest, unknown = identify(model, rested, ML), identify(model, blank, ML)
    assert not any(warning.code == "input_not_measured" for warning in at_rest.warnings)
    assert any("the input p is not measured at 7 of 14 lines" in warning.text for warning in unknown.warnings)
    assert np.all(unknown.sd > at_rest.sd)


# Rivals


def assert_other(found: Estimate, word: str) -> None:
    """The values told are not those of the estimate itself: one lies more than 3 sd from it."""
    told = [part.split(" = ") for part in word.partition(": ")[2].partition(";")[0].split(", ")]
    away = [abs(float(rest.split()[0]) - found[name].value) / found[name].sd for name, rest in told]
    assert max(away) > 3, word


def two_oscillators(values: dict[str, float], guess: float | None = None) -> Bench:
    """Two on one base, of which only the sum is seen: which is which cannot be known."""
    elements = (
        mass("ma", "a", value=1.0), mass("mb", "b", value=1.0),
        replace(between("ka", Kind.SPRING, "a", "u"), guess=guess), between("kb", Kind.SPRING, "b", "u"),
        between("ca", Kind.DAMPER, "a", "u"), between("cb", Kind.DAMPER, "b", "u"),
    )  # fmt: skip
    f = np.geomspace(2, 20, 15)
    channels = (Channel("sum", {"a": 1, "b": 1}), Channel("u", {"u": 1}))
    U, none = np.full((15, 1), 0.01 + 0j), np.zeros((15, 0), dtype=complex)
    model = Model(("a", "b"), (Input("u"),), elements)
    return Bench("sum", model, {"ma": 1.0, "mb": 1.0} | values, channels, f, U, none, {"": 0.01, "u": 0.0})


SUM = {"ka": 1500.0, "kb": 5000.0, "ca": 3.0, "cb": 9.0}


@pytest.mark.parametrize("guess", [1200.0, 4000.0])
def test_a_guess_decides_between_rigs_that_show_the_same(guess):
    bench = two_oscillators(SUM, guess)
    found = identify(bench.model, bench.spectrum(np.random.default_rng(1)), ML)
    assert found["ka"].value == pytest.approx(1500 if guess < 2500 else 5000, rel=0.05)


def test_guesses_weigh_what_fits_alike():
    """Two sets of values, χ² 2 apart: one at the guess, the other twice as large."""
    unknowns = (Unknown("k", "N/m", guess=1000.0), Unknown("c", "N·s/m"))
    at, other = np.array([1000.0, 2.0]), np.array([2000.0, 3.0])
    notice = not_unique(unknowns, at, [(other, 2.0)], 1.0)
    assert notice.odds[0] == pytest.approx(np.exp(-1 - (np.log10(2) / 0.3) ** 2 / 2))
    assert not_unique(unknowns, at, [(-other, 2.0)], 1.0).odds == (0.0,)  # no rig that can be built
    # The quantiles of the mixture by a million draws
    sd, rng = np.array([50.0, 0.1]), np.random.default_rng(2)
    pick = rng.random(1_000_000) < 1 / (1 + notice.odds[0])
    sizes = np.where(pick[:, None], at, other)
    draws = sizes * (1 + sd / at * rng.normal(size=sizes.shape))
    ends = np.array(notice.ends(at, sd, np.array(np.inf), 0.95))
    np.testing.assert_allclose(ends, np.quantile(draws, [0.025, 0.975], axis=0), rtol=0.01)
    for j, intervals in enumerate(notice.parts(at, sd, np.array(np.inf), 0.95)):
        assert len(intervals) == 2
        inside = sum(np.mean((low < draws[:, j]) & (draws[:, j] < high)) for low, high in intervals)
        assert inside == pytest.approx(0.95, abs=0.002)


@pytest.mark.long
def test_intervals_hold_where_several_rigs_show_the_same():
    """100 rigs drawn from the prior, seed 5: a standard error of 2 %, as the four intervals of a rig go together."""
    rng, held = np.random.default_rng(5), []
    for _ in range(100):
        ka, kb = np.exp(rng.uniform(np.log(800), np.log(8000), 2))
        values = {"ka": ka, "kb": kb, "ca": 0.1 * np.sqrt(ka), "cb": 0.1 * np.sqrt(kb)}
        bench = two_oscillators(values)
        found = identify(bench.model, bench.spectrum(rng), ML)
        held += [
            found[name].interval95[0] < value < found[name].interval95[1] for name, value in values.items()
        ]
    assert 0.90 < np.mean(held) < 0.995


def test_two_rigs_that_show_the_same_are_both_told():
    bench = two_oscillators(SUM)
    model, channels, spectrum = bench.model, bench.channels, bench.spectrum(np.random.default_rng(1))
    found = identify(model, spectrum, ML)
    assert sorted([found["ka"].value, found["kb"].value]) == pytest.approx([1500, 5000], rel=0.05)
    (word,) = (warning.text for warning in found.warnings if warning.code == "not_unique")
    assert_other(found, word)
    low, high = found["ka"].interval95
    assert low < 1600
    assert high > 4900
    again = Estimate.from_json(found.to_json())
    assert again.other_minima == found.other_minima
    assert again["ka"].interval95 == found["ka"].interval95
    repeats = identify(model, bench.spectrum(np.random.default_rng(1), 3), ML)
    (word,) = (warning.text for warning in repeats.warnings if warning.code == "not_unique")
    assert "in 3 of 3 repeats" in word
    both = replace(bench, channels=(*channels, Channel("a", {"a": 1})), noise={"": 0.01, "u": 0.0})
    decided = identify(model, both.spectrum(np.random.default_rng(1)), ML)
    assert decided["ka"].value == pytest.approx(1500, rel=0.05)
    assert not decided.warnings


def test_a_repeat_may_end_in_another_valley_than_the_first():
    """Repeats of one batch come from two rigs; each finds its own, as it does alone."""
    one, other = two(), replace(two(), truth={**two().truth, "m2": 0.3, "k2": 9000.0, "c4": 1.0})
    a, b = one.spectrum(np.random.default_rng(1), 2), other.spectrum(np.random.default_rng(2), 2)
    mixed = replace(a, amplitudes=np.concatenate([a.amplitudes, b.amplitudes]))
    found = identify(one.model, mixed, ML)
    for k in range(4):
        alone = identify(one.model, replace(a, amplitudes=mixed.amplitudes[k]), ML)
        assert np.allclose(found.values[k], alone.values, rtol=1e-6)


# Bounds


def held(**limits):
    bench = two(c3=0.0, **limits)
    spectrum = bench.spectrum(np.random.default_rng(3), 12)
    return bench, spectrum


def test_bounds_hold_and_without_need_change_nothing():
    bench, spectrum = held()
    free = identify(bench.model, spectrum, ML)
    bounded = identify(bench.model, spectrum, MaximumLikelihood(positive=True))
    j = free.names.index("c3")
    inside = free.values[:, j] > 0
    assert 0 < np.sum(inside) < 12
    assert np.all(bounded.values >= 0)
    assert np.all(bounded.values[~inside, j] == 0)
    assert np.all(np.abs(bounded.values[inside] - free.values[inside]) < 1e-5 * free.sd[inside])
    # Held, it is the estimate of the rig whose c3 is known to be 0.
    zero = identify(two(c3=0.0, known="k1 c3").model, spectrum, ML)
    others = [k for k in range(len(free.names)) if k != j]
    assert np.all(np.abs(bounded.values[~inside][:, others] - zero.values[~inside]) < 1e-4 * zero.sd[~inside])
    # The step without bounds leads back to the free estimate.
    assert np.all(np.abs(bounded.free_values - free.values) < 0.05 * free.sd)


@pytest.mark.parametrize("limits", [{"lower": 0.5}, {"upper": -0.5}, {"lower": -0.2, "upper": 0.2}])
def test_intervals_keep_to_the_bounds_and_hold_the_value(limits):
    bench, spectrum = held(**limits)
    found = identify(bench.model, spectrum, ML)
    j = found.names.index("c3")
    least, most = limits.get("lower", -np.inf), limits.get("upper", np.inf)
    assert found.lower[j] == least
    assert found.upper[j] == most
    for level in (0.5, 0.95, 0.999):
        low, high = found.interval(level)
        assert np.all((low[:, j] >= least) & (high[:, j] <= most))
        assert np.all((low <= found.values) & (found.values <= high))
        assert np.all(high > low)
    assert np.any((found.values[:, j] == least) | (found.values[:, j] == most))


def test_the_far_end_of_a_cut_interval_is_continuous():
    """Where the free estimate passes the bound: P(T > reach | T > 0) = 5 % is the two-sided 95 % of the whole."""
    from dashpot.estimate.result import truncated_reach

    dof = np.array([np.inf, 10.0, 3.0])
    from scipy.stats import t

    assert np.allclose(truncated_reach(np.zeros(3), dof, 0.95), t.isf(0.025, dof), rtol=1e-9)
    for beyond in (0.5, 2.0, 6.0):
        reach = truncated_reach(np.full(3, beyond), dof, 0.95)
        assert np.allclose(t.sf(reach, dof) / t.sf(beyond, dof), 0.05, rtol=1e-9)
    assert np.isfinite(truncated_reach(np.array([50.0]), np.array([np.inf]), 0.95)[0])


def test_data_without_a_finite_cost_anywhere_are_refused():
    """Amplitudes whose squares are no numbers: no start ends, and that is said."""
    bench = two()
    spectrum = bench.spectrum(np.random.default_rng(0))
    with np.errstate(all="ignore"), pytest.raises(ConvergenceError, match="no initial guess"):
        identify(
            bench.model, replace(spectrum, amplitudes=spectrum.amplitudes * 1e200),
            MaximumLikelihood(candidates=20, starts=4),
        )  # fmt: skip


def test_bounds_come_back_from_json():
    bench, spectrum = held(lower=0.0)
    j = bench.names.index("c3")
    for k in range(12):
        found = identify(bench.model, replace(spectrum, amplitudes=spectrum.amplitudes[k]), ML)
        back = Estimate.from_json(found.to_json())
        assert np.array_equal(back.lower, found.lower)
        assert np.array_equal(back.upper, found.upper)
        assert np.array_equal(back.free_values, found.free_values)
        assert back.interval()[0][j] == found.interval()[0][j]
        assert back["c3"].interval95 == found["c3"].interval95
        if found["c3"].value == 0:
            break
    else:
        pytest.fail("the bound was never met")


@pytest.mark.parametrize("draw", range(4))
def test_the_rival_told_is_another_rig_than_the_answer(draw):
    """A hidden mass between two springs of unknown size: two rigs show the same at x2, to rounding."""
    H = Kind.HYSTERETIC
    values = {"m1": 1.0, "m2": 2.0, "k1": 900.0, "k2": 1200.0, "h1": 30.0, "h2": 20.0}
    elements = (
        mass("m1", "x1", value=1.0), replace(mass("m2", "x2", value=2.0), sd=0.05),
        between("k1", Kind.SPRING, "x1", "u"), between("k2", Kind.SPRING, "x1", "x2"),
        between("h1", H, "x1", "u"), between("h2", H, "x1", "x2"),
    )  # fmt: skip
    f = np.array([2.0, 3.5])
    channels = (Channel("x2", {"x2": 1}), Channel("u", {"u": 1}))
    U, none = np.full((2, 1), 0.001 + 0j), np.zeros((2, 0), dtype=complex)
    model = Model(("x1", "x2"), (Input("u"),), elements)
    bench = Bench("hidden", model, values, channels, f, U, none, {"": 0.003, "u": 0.0})
    found = identify(model, bench.spectrum(np.random.default_rng(draw)), ML)
    for word in (warning.text for warning in found.warnings if warning.code == "not_unique"):
        assert_other(found, word)
    assert any(warning.code == "not_unique" for warning in found.warnings)


@pytest.mark.parametrize("share", [1e-4, 0.5])
def test_a_statement_has_no_doubt_about_its_own_size(share):
    """Intervals of noise measured with 8 degrees of freedom a line: what a prior tells counts as known exactly.

    A prior that tells all but 1e-4 has the normal distribution's quantile; one that tells half leaves more degrees of
    freedom than the data alone have.
    """
    bench = two(full=True, known="m1 m2 k1 k2 c1 c2 c4")
    sure = bench.spectrum(np.random.default_rng(1))
    doubtful = replace(sure, dof=np.full(sure.lines, 8.0))
    alone = identify(bench.model, sure)["c3"]
    s = alone.sd * np.sqrt(share / (1 - share))
    found = identify(changed(bench.model, "c3", value=alone.value, sd=s), doubtful)
    low, high = found.interval()
    if share < 0.01:
        assert high[0] - low[0] == pytest.approx(2 * 1.95996 * s, rel=1e-3)
    free = identify(bench.model, doubtful)
    assert found.dof[0] > 2 * free.dof[0]
    assert np.isfinite(found.dof[0])
