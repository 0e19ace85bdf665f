"""Parameters from measured modes: slopes by differences, exact data of random rigs, pairing, Monte Carlo, refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from dashpot.data.modal_data import ModalData, of_eigenvalues
from dashpot.errors import DataError, IdentifiabilityError, UsageError
from dashpot.estimate.method import OtherMinima
from dashpot.estimate.modal import identify_modal, like_parts
from dashpot.model.elements import Kind, between, mass
from dashpot.model.modes import eigenmodes, mode_sensitivities
from dashpot.model.network import Input, Model
from tests.rigs import PAPER_KINDS, Rig, random_rig

LEVEL = 1e-3  # of frequencies and shapes; damping ratios a hundredth of themselves


def swinging(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and shapes of the modes that swing, by frequency."""
    found = eigenmodes(rig.model, rig.p)
    there = found.eigenvalues.imag > 1e-6 * np.abs(found.eigenvalues)
    return found.eigenvalues[there], found.shapes[there]


def measured(
    rig: Rig,
    rng: np.random.Generator | None = None,
    draws: int | None = None,
    *,
    points: tuple[str, ...] | None = None,
    which: slice | list[int] = slice(None),
    level: float = LEVEL,
) -> ModalData:
    """Modes of a rig with their uncertainty, noisy where `rng` is given."""
    values, shapes = swinging(rig)
    values, shapes = values[which], shapes[which]
    names = rig.model.coordinates if points is None else points
    shapes = shapes[:, [rig.model.coordinates.index(name) for name in names]]
    size = np.max(np.abs(shapes), axis=-1, keepdims=True, initial=1e-9)
    f, zeta = np.abs(values) / 2 / np.pi, -values.real / np.abs(values)
    sd = np.stack([level * f, 10 * level * np.maximum(np.abs(zeta), 1e-3)], axis=-1)
    covariance = sd[:, :, None] * np.array([[1, 0.3], [0.3, 1]]) * sd[:, None, :]
    V = 2 * (10 * level * size[..., None]) ** 2 * np.eye(len(names))
    if rng is not None:
        shape = (() if draws is None else (draws,)) + f.shape
        noise = rng.standard_normal((*shape, 2)) @ np.linalg.cholesky(np.array([[1, 0.3], [0.3, 1]])).T * sd
        f, zeta = f + noise[..., 0], zeta + noise[..., 1]
        white = rng.standard_normal((2, *shape, len(names)))
        shapes = shapes + 10 * level * size * (white[0] + 1j * white[1])
    return ModalData(names, f, zeta, covariance, shapes, V.astype(complex))


def chain(values: dict[str, float] | None = None, **known: dict[str, float]) -> Rig:
    """Three unlike masses between unlike springs on a held base, lightly damped; m1 known."""
    true = {"m1": 2.0, "m2": 1.0, "m3": 3.0, "k1": 4000.0, "k2": 2500.0, "k3": 1200.0,
            "c1": 6.0, "c2": 3.0, "c3": 8.0} | (values or {})  # fmt: skip
    x = ["u", "x1", "x2", "x3"]
    given = {"m1": {"value": true["m1"]}} | known
    elements = [mass(f"m{i}", x[i], **given.get(f"m{i}", {})) for i in (1, 2, 3)]
    for letter, kind in (("k", Kind.SPRING), ("c", Kind.DAMPER)):
        for i in (1, 2, 3):
            name = f"{letter}{i}"
            elements.append(between(name, kind, x[i], x[i - 1], **given.get(name, {})))
    model = Model(("x1", "x2", "x3"), (Input("u"),), tuple(elements), "chain")
    theta = np.array([true[unknown.name] for unknown in model.unknowns])
    none = np.zeros((1, 0), dtype=complex)
    return Rig(model, theta, np.array([1.0]), np.ones((1, 1), dtype=complex), none)


# Exact data


def usable(rig: Rig) -> bool:
    """All modes swing, and they determine the unknowns within a factor of 1000."""
    values, shapes = swinging(rig)
    if len(values) < rig.model.n:
        return False
    dlam, dphi = mode_sensitivities(rig.model, rig.p, values, shapes)
    rows = [dlam / np.abs(values)[:, None], *np.moveaxis(dphi, 1, 0)]
    J = np.concatenate(rows) @ rig.model.T * rig.theta
    s = np.linalg.svd(np.concatenate([J.real, J.imag]), compute_uv=False)
    return bool(np.all(np.isfinite(s)) and s[-1] > 1e-3 * s[0])


@pytest.mark.parametrize("n", [2, 3, 4])
def test_exact_modes_of_random_rigs_give_the_parameters_back(n: int) -> None:
    """Shapes of any complex scale, points and modes in any order, rigs of grams or of tonnes."""
    rng = np.random.default_rng(70 + n)
    done = 0
    while done < 6:
        rig = random_rig(rng, n, displacements=1, kinds=PAPER_KINDS, known=0.3)
        if not usable(rig):
            continue
        done += 1
        factor = float(10.0 ** rng.uniform(-4, 4))
        rig = replace(
            rig,
            model=replace(
                rig.model,
                elements=tuple(
                    e if e.value is None else replace(e, value=factor * e.value) for e in rig.model.elements
                ),
            ),
            theta=factor * rig.theta,
        )
        data = measured(rig)
        order, points = rng.permutation(data.modes), rng.permutation(n)
        scale = np.exp(rng.uniform(-9, 9, data.modes) + 2j * np.pi * rng.random(data.modes))[order]
        data = ModalData(
            tuple(np.array(data.points)[points].tolist()),
            data.frequency_hz[order],
            data.damping_ratio[order],
            data.covariance[order],
            data.shapes[order][:, points] * scale[:, None],
            data.shape_covariance[order] * np.abs(scale[:, None, None]) ** 2,
        )
        found = identify_modal(rig.model, data)
        assert bool(found.converged)
        assert int(found.iterations) <= 3  # linear least squares has been there before
        assert np.allclose(found.values, rig.theta, rtol=1e-6)
        assert float(found.fit.chi2) < 1e-6


@pytest.mark.parametrize("points", [("x3",), ("x2", "x3"), ()])
def test_few_points_do_where_enough_is_known(points: tuple[str, ...]) -> None:
    """Masses known: three frequencies and three damping ratios hold three springs and three dampers.

    A chain has several sets of springs with the same frequencies: a guess within a fifth leads to the nearest.
    """
    true = chain()
    values = dict(zip(true.names, true.theta, strict=True))
    known = {"m2": {"value": 1.0}, "m3": {"value": 3.0}}
    guess = {
        name: {"guess": values[name] * (1.15 if name[1] == "2" else 0.9)}
        for name in values
        if name[0] in "kc"
    }
    rig = chain(None, **known, **guess)
    found = identify_modal(rig.model, measured(rig, points=points))
    assert np.allclose(found.values, rig.theta, rtol=1e-6)
    assert found.fit.dof == 2 * 3 * max(len(points) - 1, 0)


def test_no_damping_measured_leaves_masses_and_springs() -> None:
    """Frequencies and shapes alone, with dampers known; unknown ones are said not to be determined."""
    damping = {f"c{i}": {"value": v} for i, v in enumerate((6.0, 3.0, 8.0), 1)}
    rig = chain(None, **damping)
    data = measured(rig)
    blind = replace(data, damping_ratio=np.full(3, np.nan))
    found = identify_modal(rig.model, blind)
    assert np.allclose(found.values, rig.theta, rtol=1e-6)
    assert found.fit.dof == 3 + 3 * 4 - 5
    undamped = chain({"c1": 0.0, "c2": 0.0, "c3": 0.0}, **{name: {"value": 0.0} for name in damping})
    real = replace(measured(undamped), damping_ratio=np.full(3, np.nan))
    assert np.allclose(identify_modal(undamped.model, real).values, undamped.theta, rtol=1e-6)


@pytest.mark.slow
def test_without_damping_ratios_and_with_real_shapes_dampers_are_not_determined() -> None:
    rig = chain({"c1": 0.0, "c2": 0.0, "c3": 0.0})
    data = replace(measured(rig), damping_ratio=np.full(3, np.nan))
    shapes = data.shapes.real + 0j
    two = replace(
        data, points=("x3",), shapes=shapes[:, 2:], shape_covariance=data.shape_covariance[:, 2:, 2:]
    )
    with pytest.raises(IdentifiabilityError, match="do not determine"):
        identify_modal(rig.model, two)


def test_a_shape_scaled_at_a_point_is_exact_there() -> None:
    """What it is scaled by has sd 0: the same estimate as with the noise referred to it.

    To 0.005 sd: noise of 0.1 % squared, over that noise.
    """
    rig = chain()
    noisy = measured(rig, np.random.default_rng(4), level=1e-4)
    last = noisy.shapes[:, 2:]
    scaled = noisy.shapes / last
    V = noisy.shape_covariance / np.abs(last[..., None]) ** 2
    exact = V.copy()
    exact[:, 2, :] = exact[:, :, 2] = 0
    # Scaling by a noisy point spreads its noise over the others: cov of (Δ_i − φ_i Δ_3).
    for k in range(3):
        G = np.eye(3, dtype=complex)
        G[:, 2] -= scaled[k]
        exact[k] = G @ V[k] @ G.conj().T
        exact[k, 2, :] = exact[k, :, 2] = 0
    found = identify_modal(rig.model, replace(noisy, shapes=scaled, shape_covariance=exact))
    same = identify_modal(rig.model, noisy)
    assert np.max(np.abs(found.values - same.values) / same.sd) < 0.008
    assert np.allclose(found.sd, same.sd, rtol=0.02)  # V is referred to noisy amplitudes, some of them small


def test_the_answer_is_that_of_least_squares_written_out() -> None:
    """Frequencies, damping ratios and shapes with each mode's scale as two more unknowns, by SciPy with differences.

    Values to a thousandth of a standard deviation, sd to 0.1 %.
    """
    rig = chain()
    data = measured(rig, np.random.default_rng(6), level=1e-4)
    found = identify_modal(rig.model, data)
    sd = np.sqrt(np.diagonal(data.shape_covariance, axis1=1, axis2=2).real / 2)

    def residuals(psi: np.ndarray) -> np.ndarray:
        own = eigenmodes(rig.model, rig.model.parameters(psi[:8] * rig.theta))
        scale = psi[8:].reshape(2, 3)
        rows = []
        for k in range(3):
            lam = own.eigenvalues[k]
            off = np.array(
                [data.frequency_hz[k] - abs(lam) / 2 / np.pi, data.damping_ratio[k] + lam.real / abs(lam)]
            )
            rows.append(np.linalg.solve(np.linalg.cholesky(data.covariance[k]), off))
            shape = (data.shapes[k] - (scale[0, k] + 1j * scale[1, k]) * own.shapes[k]) / sd[k]
            rows += [shape.real, shape.imag]
        return np.concatenate(rows)

    start = np.concatenate([np.ones(8), np.ones(3), np.zeros(3)])
    best = least_squares(residuals, start, jac="3-point", xtol=1e-12, ftol=1e-14, gtol=1e-12)
    assert 2 * best.cost == pytest.approx(float(found.fit.chi2), rel=1e-6)
    assert np.max(np.abs(best.x[:8] * rig.theta - found.values) / found.sd) < 1e-3
    spread = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))[:8] * rig.theta
    assert np.allclose(spread, found.sd, rtol=1e-3)


# Which is which


def test_missing_and_swapped_modes_are_paired_by_shape() -> None:
    """The second mode is not measured, and the others come in the wrong order."""
    rig = chain()
    values = dict(zip(rig.names, rig.theta, strict=True))
    known = {name: {"value": values[name]} for name in ("m2", "m3", "k1")}
    own = chain(None, **known)
    data = measured(own, which=[2, 0])
    assert data.frequency_hz[0] > data.frequency_hz[1]
    found = identify_modal(own.model, data)
    assert np.allclose(found.values, own.theta, rtol=1e-6)


def test_modes_that_cross_are_told_by_their_shapes() -> None:
    """Two all but equal pendulums, told apart by a guess that has them the other way round, and one not measured.

    By frequency alone the modes would be paired wrongly, and the search would end in front of the crossing.
    """
    guess = {"k1": 1100.0, "k2": 1000.0}
    elements = [mass(f"m{i}", f"x{i}", value=1.0) for i in (1, 2, 3)]
    elements += [between(k, Kind.SPRING, f"x{k[1]}", "ground", guess=guess[k]) for k in guess]
    elements += [between(f"c{i}", Kind.DAMPER, f"x{i}", "ground", value=0.2) for i in (1, 2, 3)]
    elements.append(between("k12", Kind.SPRING, "x1", "x2", value=0.5))
    elements.append(between("k23", Kind.SPRING, "x2", "x3", value=0.5))
    elements.append(between("k3", Kind.SPRING, "x3", "ground", value=9000.0))
    model = Model(("x1", "x2", "x3"), (), tuple(elements))
    none = np.zeros((1, 0), dtype=complex)
    rig = Rig(model, np.array([1000.0, 1100.0]), np.array([1.0]), none, none)
    data = measured(rig, points=("x1", "x2"), which=[0, 1])
    found = identify_modal(model, data, starts=0)
    assert np.allclose(found.values, rig.theta, rtol=1e-6)


def test_a_batch_is_its_repeats() -> None:
    rig = chain()
    data = measured(rig, np.random.default_rng(8), 4)
    together = identify_modal(rig.model, data)
    for k in range(4):
        own = replace(
            data,
            frequency_hz=data.frequency_hz[k],
            damping_ratio=data.damping_ratio[k],
            shapes=data.shapes[k],
        )
        alone = identify_modal(rig.model, own)
        assert np.allclose(alone.values, together.values[k], rtol=1e-8)
        assert np.allclose(alone.covariance, together.covariance[k], rtol=1e-6)
        assert float(alone.fit.chi2) == pytest.approx(float(together.fit.chi2[k]), rel=1e-8)


def frequencies_alone(**springs: dict[str, float]) -> tuple[Rig, ModalData]:
    """Three known masses in a chain without dampers, and its three frequencies to 0.1 %."""
    none = {name: {"value": 0.0} for name in ("c1", "c2", "c3")}
    masses = {"m2": {"value": 1.0}, "m3": {"value": 3.0}}
    rig = chain(dict.fromkeys(none, 0.0), **none, **masses, **springs)
    return rig, replace(measured(rig, points=()), damping_ratio=np.full(3, np.nan))


@pytest.mark.slow
def test_other_rigs_with_the_same_frequencies_are_named() -> None:
    """A chain is not the only one with its frequencies: whatever the seed, one set is the answer, others are told."""
    rig, data = frequencies_alone()
    found = [identify_modal(rig.model, data, seed=seed) for seed in range(7)]
    for other in found:
        assert np.allclose(other.values, found[0].values, rtol=1e-6)
        assert float(other.fit.chi2) < 1e-6
    (warning,) = (notice.text for notice in found[0].warnings)
    assert "fits equally well" in warning
    named = dict(re.findall(r"(k\d) = ([\d.]+) N/m", warning))
    assert len(named) == 3
    theta = np.array([float(named[name]) for name in found[0].names])
    assert np.max(np.abs(theta / found[0].values - 1)) > 0.1
    f = eigenmodes(rig.model, rig.model.parameters(theta)).frequency_hz
    assert np.allclose(f, data.frequency_hz, rtol=1e-3)  # four digits are printed
    sets = [found[0].values, theta]
    truth_is_one = any(np.allclose(one, rig.theta, rtol=1e-3) for one in sets)
    assert truth_is_one or "further set" in warning


def test_nothing_is_named_where_shapes_decide_or_guesses_are_far_from_others() -> None:
    """Guesses, right within a factor of two, do not tell rigs apart that are nearer than that: these are named."""
    rig, data = frequencies_alone()
    undamped = replace(measured(rig), damping_ratio=np.full(3, np.nan))
    assert identify_modal(rig.model, undamped).warnings == ()
    guesses = {name: {"guess": 0.9 * value} for name, value in zip(rig.names, rig.theta, strict=True)}
    guessed, _ = frequencies_alone(**guesses)
    found = identify_modal(guessed.model, data)
    assert np.allclose(found.values, rig.theta, rtol=1e-6)
    (told,) = found.warnings
    assert isinstance(told, OtherMinima)
    away = np.log10(np.array(told.values) / (0.9 * rig.theta)) / 0.3
    assert np.all(np.sum(away**2, axis=1) < 10)
    free = identify_modal(rig.model, data).warnings[0]
    assert isinstance(free, OtherMinima)
    assert len(free.values) >= len(told.values)
    lower, upper = found.interval()
    assert all(np.all((lower < other) & (other < upper)) for other in told.values)


# What it is worth


DRAWS = 2000


@pytest.fixture(scope="module", params=["all points", "two points, two modes", "with a prior"])
def study(request):
    """2,000 noisy modal tests of the chain, seed 9; k1 drawn anew where it has a prior."""
    if request.param == "all points":
        rig = chain()
        return rig, identify_modal(rig.model, measured(rig, np.random.default_rng(9), DRAWS))
    if request.param == "with a prior":
        rig = chain(None, k1={"value": 4000.0, "sd": 8.0}, m1={})
        return rig, identify_modal(rig.model, measured(rig, np.random.default_rng(9), DRAWS))
    values = dict(zip(chain().names, chain().theta, strict=True))
    known = {name: {"value": values[name]} for name in ("m2", "m3", "c3")}
    guess = {name: {"guess": 1.1 * values[name]} for name in ("k1", "k2", "k3", "c1", "c2")}
    rig = chain(None, **known, **guess)
    data = measured(rig, np.random.default_rng(9), DRAWS, points=("x3", "x1"), which=[0, 2], level=LEVEL / 4)
    return rig, identify_modal(rig.model, data)


def test_spread_is_that_of_the_bound(study) -> None:
    """rms over the unknowns within 5 % of it, each one within 7 % (standard error 1.6 %); no bias above 0.1 sd."""
    rig, found = study
    free = np.array([unknown.sd is None for unknown in rig.model.unknowns])
    error = found.values - rig.theta
    ratio = (error.std(0) / np.median(found.bound_sd, axis=0))[free]
    if np.all(free):
        assert abs(np.sqrt(np.mean(ratio**2)) - 1) < 0.05
        assert np.all(np.abs(ratio - 1) < 0.07)
    else:  # the prior's mean stays where it is, so its part of the spread is not seen
        assert np.all(ratio < 1.05)
    assert np.max(np.abs(error[:, free].mean(0) / error[:, free].std(0))) < 0.1


def test_intervals_hold_the_truth_19_times_in_20(study) -> None:
    """Within 2.5 times the binomial error of 0.49 points; more often where a prior is true."""
    rig, found = study
    low, high = found.interval()
    covered = 100 * np.mean((low <= rig.theta) & (rig.theta <= high), axis=0)
    assert np.all(covered > 95 - 1.23), covered
    if all(unknown.sd is None for unknown in rig.model.unknowns):
        assert np.all(covered < 95 + 1.23), covered


def test_chi2_is_distributed_as_it_says(study) -> None:
    """Its mean is its degrees of freedom to 3 standard errors (and 2 % for curvature)."""
    rig, found = study
    if any(unknown.sd is not None for unknown in rig.model.unknowns):
        return
    error = 3 * np.sqrt(2 * found.fit.dof / DRAWS) + 0.02 * found.fit.dof
    assert abs(float(np.mean(found.fit.chi2)) - found.fit.dof) < error


def test_a_prior_on_the_scale_fixes_it() -> None:
    """Modes alone hold ratios: m1's prior of 2 ± 0.02 kg goes into every parameter in full, 1 %."""
    rig = chain(None, m1={"value": 2.0, "sd": 0.02})
    found = identify_modal(rig.model, measured(rig, level=1e-6))
    assert np.allclose(found.sd / found.values, 0.01, rtol=0.02)


def test_a_model_that_lacks_something_is_rejected_and_its_intervals_widened() -> None:
    rig = chain()
    data = measured(rig, np.random.default_rng(2))
    stiff = chain(None, k3={"value": 900.0}, m1={"value": 2.0})
    found = identify_modal(stiff.model, data)
    assert found.basis == "model misfit"
    assert np.all(found.sd > found.noise_sd)
    assert bool(found.fit.rejected)


def test_a_bound_is_held_and_said_with_where_the_answer_would_lie_without() -> None:
    """The bound lies half a standard deviation above what fits best."""
    data = measured(chain(), np.random.default_rng(2))
    free = identify_modal(chain().model, data)
    bound = free["c1"].value + 0.5 * free["c1"].sd
    found = identify_modal(chain(None, c1={"lower": bound}).model, data)
    j = found.names.index("c1")
    assert found.values[j] == bound
    assert found.free_values[j] == pytest.approx(free.values[j], abs=0.02 * free.sd[j])
    assert found.interval()[0][j] == bound
    assert [word for word in found.warnings if word.code == "at_bound" and word.of == ("c1",)]
    assert np.all(np.abs(found.values - free.values) <= 0.52 * free.sd)
    assert not [word for word in free.warnings if "bound" in word.code]


def test_eigenvalues_and_frequencies_say_the_same() -> None:
    """λ with the covariance of its parts becomes f and ζ by the slopes: against differences."""
    lam = np.array([-2.0 + 30j, -0.5 + 80j])
    S = np.array([[[0.04, 0.01], [0.01, 0.09]]] * 2)
    data = of_eigenvalues((), lam, S, np.zeros((2, 0), dtype=complex), np.zeros((2, 0, 0), dtype=complex))
    assert np.allclose(data.eigenvalues, lam)
    for k in range(2):

        def both(x: float, y: float) -> np.ndarray:
            return np.array([np.hypot(x, y) / 2 / np.pi, -x / np.hypot(x, y)])

        x, y, h = lam[k].real, lam[k].imag, 1e-6
        J = np.stack([(both(x + h, y) - both(x - h, y)), (both(x, y + h) - both(x, y - h))], axis=-1) / 2 / h
        assert np.allclose(data.covariance[k], J @ S[k] @ J.T, rtol=1e-6)


# Refusals


def test_what_does_not_suit_is_said() -> None:
    rig = chain()
    data = measured(rig)
    with pytest.raises(IdentifiabilityError, match="scale"):
        identify_modal(chain(None, m1={}).model, data)
    with pytest.raises(DataError, match="not a coordinate"):
        identify_modal(rig.model, replace(data, points=("x1", "x2", "x9")))
    four = [
        np.concatenate([a, a[:1]])
        for a in (data.frequency_hz, data.damping_ratio, data.covariance, data.shapes)
    ]
    more = ModalData(data.points, *four, np.concatenate([data.shape_covariance, data.shape_covariance[:1]]))
    with pytest.raises(DataError, match="only 3"):
        identify_modal(rig.model, more)
    with pytest.raises(DataError, match="not positive definite"):
        identify_modal(rig.model, replace(data, covariance=np.zeros((3, 2, 2))))
    known = {name: {"value": 1.0} for name in ("m1", "m2", "m3", "k1", "k2", "k3", "c1", "c2", "c3")}
    with pytest.raises(UsageError, match="is known"):
        identify_modal(chain(None, **known).model, data)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"frequency_hz": np.array([1.0, -2.0, 3.0])}, "not positive"),
        ({"damping_ratio": np.array([0.1, 1.0, 0.1])}, "does not oscillate"),
        ({"shapes": np.zeros((3, 2), dtype=complex)}, "must be"),
        ({"covariance": np.zeros((2, 2, 2))}, "must be"),
    ],
    ids=["frequency", "damping", "shapes", "covariance"],
)
def test_modal_data_that_cannot_be_are_refused(change: dict[str, np.ndarray], said: str) -> None:
    with pytest.raises(DataError, match=said):
        replace(measured(chain()), **change)


def test_like_parts_have_the_first_frequency_of_the_data() -> None:
    """A chain of nine with two known springs: the others alike, and the first mode where it was measured."""
    points = ("ground", *(f"x{i}" for i in range(1, 10)))
    springs = tuple(
        between(f"k{i}", Kind.SPRING, points[i + 1], points[i], value=3000.0 if i < 2 else None)
        for i in range(9)
    )
    masses = tuple(mass(f"m_{x}", x, value=2.0) for x in points[1:])
    model = Model(points[1:], (), (*masses, *springs))
    flat = np.tile(np.eye(2), (1, 1, 1))
    data = ModalData(("x9",), np.array([1.3]), np.array([0.01]), flat, np.ones((1, 1)), np.ones((1, 1, 1)))
    theta = like_parts(model, data)
    assert np.ptp(theta) < 1e-9 * theta[0]
    assert np.min(np.abs(eigenmodes(model, model.parameters(theta)).eigenvalues)) == pytest.approx(
        2 * np.pi * 1.3, rel=1e-6
    )


def tower(seed: int, spread: float = 0.2, level: float = 1e-6) -> tuple[Model, ModalData, np.ndarray]:
    """18 storeys of 1 kg whose stiffnesses scatter around 2,000 N/m: the four lowest modes at seven of them.

    Eigenvalues and shapes are those of the symmetric problem, by another way than the model's.
    """
    rng = np.random.default_rng(seed)
    points = ("ground", *(f"x{i}" for i in range(1, 19)))
    storeys = tuple(between(f"k{i}", Kind.SPRING, points[i], points[i - 1]) for i in range(1, 19))
    masses = tuple(mass(f"m{i}", points[i], value=1.0) for i in range(1, 19))
    model = Model(points[1:], (), (*masses, *storeys))
    k = 2000 * np.exp(spread * rng.standard_normal(18))
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    squares, vectors = np.linalg.eigh(K)
    at = [0, 2, 5, 8, 11, 14, 17]
    f, shapes = np.sqrt(squares[:4]) / (2 * np.pi), vectors[at, :4].T
    size = np.max(np.abs(shapes), axis=1, keepdims=True)
    f = f * (1 + level * rng.standard_normal(4))
    shapes = shapes + 10 * level * size * rng.standard_normal(shapes.shape)
    covariance = np.zeros((4, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = (level * f) ** 2, 1.0
    V = 2 * (10 * level * size[..., None]) ** 2 * np.eye(len(at))
    seen = tuple(points[1 + i] for i in at)
    nothing = np.full(4, np.nan)
    return model, ModalData(seen, f, nothing, covariance, shapes.astype(complex), V.astype(complex)), k


@pytest.mark.parametrize(
    "seeds", [range(5), pytest.param(range(5, 100), marks=pytest.mark.long)], ids=["five", "all"]
)
def test_a_tower_is_found_without_guesses(seeds: range) -> None:
    """18 unknown stiffnesses from modes at seven storeys; each within 1 %, and within what is stated."""
    for seed in seeds:
        model, data, k = tower(seed)
        estimate = identify_modal(model, data, seed=seed)
        assert bool(estimate.converged)
        assert np.all(np.abs(estimate.values / k - 1) < 0.01), seed
        assert np.all(np.abs(estimate.values - k) < 5 * estimate.sd), seed
