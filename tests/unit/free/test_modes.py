"""Modes without a rig: unbiased, with intervals that cover, however the rig was driven; and back into `identify`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dashpot
from dashpot.arrays import Complex, Real
from dashpot.data.record import Record
from dashpot.errors import DataError, UsageError
from dashpot.free.modes import MeasuredModes
from dashpot.free.response import MeasuredResponse, record_lines
from dashpot.io.json_document import to_json
from tests import rigs
from tests.unit.free.bench import Bench

TWO = Bench((4.0, 9.0), (0.01, 0.02))
CLOSE = Bench((4.0, 4.08, 9.0), (0.005, 0.005, 0.02))
WIDE = Bench((3.0, 7.0, 12.0), (0.001, 0.1, 0.01), 3)


def errors(found: MeasuredModes, bench: Bench) -> tuple[Real, Real, Real]:
    """Errors of frequencies, damping ratios and parts of shapes in standard deviations; every mode is found."""
    assert found.frequency_hz == pytest.approx(np.array(bench.frequency_hz), rel=0.02)
    f = (found.frequency_hz - bench.frequency_hz) / found.frequency_sd
    zeta = (found.damping_ratio - bench.damping) / found.damping_sd
    shapes = []
    for k in range(len(f)):
        true = bench.shapes[: bench.points, k]
        largest = int(np.argmax(np.abs(found.shapes[k]) * (found.shape_sd[k] == 0)))
        others = np.arange(bench.points) != largest
        away = (found.shapes[k] - true / true[largest])[others] / found.shape_sd[k][others]
        shapes += [*away.real, *away.imag]
    return f, zeta, np.array(shapes)


def decays(bench: Bench, rng: np.random.Generator, count: int, seconds: float, noise: float) -> list[Record]:
    """Free decays, displacements, from states drawn at random."""
    found = []
    for _ in range(count):
        start = np.concatenate(
            [rng.normal(size=len(bench.damping)) / bench.omega, rng.normal(size=len(bench.damping))]
        )
        found.append(bench.record(np.zeros((round(seconds * 1000), 0)), rng, noise, start, shift=True))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bench", "seconds", "inputs", "records"),
    [pytest.param(TWO, 40.0, 1, 1, marks=pytest.mark.long), (CLOSE, 60.0, 1, 1), (TWO, 20.0, 2, 2)],
)
def test_random_records(bench: Bench, seconds: float, inputs: int, records: int) -> None:
    rng = np.random.default_rng(2)
    tests = [bench.record(bench.noise(rng, seconds, inputs), rng, 0.02) for _ in range(records)]
    found = dashpot.modes(tests, [f"u{i}" for i in range(inputs)], "a0,a1")
    z = np.concatenate(errors(found, bench))
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert 0.9 < found.chi2 / found.dof < 1.15
    # Residues of the accelerance are λ² φ_i φ_j / 2jIm λ, of unit modal masses
    lam = found.eigenvalues
    largest = np.argmax(np.abs(found.shapes), axis=1)
    at = np.arange(len(lam))
    true = bench.shapes[largest, at] * bench.shapes[0, at] / (2j * lam.imag)
    assert np.all(np.abs(found.participation[:, 0] - true) < 5 * found.participation_sd[:, 0] * 2**0.5)


def slow_chi2(f: Real, U: Complex, Y: Complex, noise: Complex, step: float, poles: Complex) -> float:
    """χ² of lines with noise (q, q) for given poles: residues, a constant and, of a record sampled each `step`, its
    ends, by stacked least squares."""
    s, both = 2j * np.pi * f[:, None], np.concatenate([poles, poles.conj()])
    columns = [U[:, None] * np.hstack([1 / (s - both), np.ones_like(s)])]
    if step:
        columns += [1 / (1 - np.exp((both - s) * step)), (s / np.abs(s[-1])) ** np.arange(3)]
    m, X = len(poles), np.hstack(columns)
    for first in (0, 2 * m + 1)[: 2 if step else 1]:
        upper, lower = X[:, first : first + m].copy(), X[:, first + m : first + 2 * m].copy()
        X[:, first : first + m], X[:, first + m : first + 2 * m] = upper + lower, 1j * (upper - lower)
    whiten = np.linalg.inv(np.linalg.cholesky(noise))
    A = np.einsum("ij,la->lija", whiten, X).reshape(Y.size, -1)
    A, y = np.vstack([A.real, A.imag]), (Y @ whiten.T).ravel()
    y = np.concatenate([y.real, y.imag])
    size = np.linalg.norm(A, axis=0)
    return float(2 * np.sum((y - A / size @ np.linalg.lstsq(A / size, y)[0]) ** 2))


def by_differences(found: MeasuredModes, *data: Any) -> tuple[Real, Real]:
    """Covariance of the poles by the curvature of the slow χ², and how far its minimum is, in standard deviations."""
    sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2)).ravel()

    def chi2(x: Real) -> float:
        moved = x * sd / 5
        return slow_chi2(*data, found.eigenvalues + moved[::2] + 1j * moved[1::2])

    unit = np.eye(len(sd))
    H = np.zeros(unit.shape)
    for i, a in enumerate(unit):
        for j, b in enumerate(unit[: i + 1]):
            H[i, j] = H[j, i] = (chi2(a + b) - chi2(a - b) - chi2(b - a) + chi2(-a - b)) / 4
    covariance = 2 * np.linalg.inv(H) / 25
    return covariance, covariance @ [5 * (chi2(a) - chi2(-a)) / 4 for a in unit]


@pytest.mark.slow
def test_deviations_are_those_of_the_bound_though_the_noise_is_that_of_residuals() -> None:
    """Of three outputs with white noise, against the likelihood with this noise given."""
    bench, rng, noise = Bench((4.0, 9.0), (0.01, 0.02), 3), np.random.default_rng(4), 0.02
    test = bench.record(bench.noise(rng, 40.0, 1), rng, noise)
    found = dashpot.modes(test, "u0", band=(0.5, 30.0))
    lines = record_lines(test, 1)
    inside = (lines.frequency_hz >= 0.5) & (lines.frequency_hz <= 30)
    level = np.diag((2 * noise * np.std(test.values[:, 1:], axis=0)) ** 2).astype(complex)
    data = lines.frequency_hz[inside], lines.inputs[inside, 0], lines.outputs[inside], level
    covariance, _ = by_differences(found, *data, lines.duration_s / lines.samples)
    assert np.sqrt(np.diagonal(covariance)) == pytest.approx(1, rel=0.05)


def test_poles_of_responses_are_likeliest_and_their_covariance_is_the_curvature() -> None:
    rng, f = np.random.default_rng(0), np.arange(1.0, 12.0, 0.1)
    noise = np.array([[2.0, 0.5 + 0.3j], [0.5 - 0.3j, 1.0]]) * 1e-6
    Y = TWO.accelerance(f, 1)[:, :, 0]
    Y = Y + (rng.normal(size=Y.shape) + 1j * rng.normal(size=Y.shape)) @ np.linalg.cholesky(noise).T / 2**0.5
    u0, *outputs = TWO.record(np.zeros((100, 1)), rng, 0.0).channels
    one = np.ones(len(f), dtype=np.int64)
    response = MeasuredResponse(
        (u0,),
        tuple(outputs),
        f,
        Y[..., None],
        np.broadcast_to(noise, (len(f), 2, 2)),
        np.ones(Y.shape),
        one,
        "dwells",
    )
    found = dashpot.modes(response)
    data = f, np.ones(len(f), complex), Y, noise, 0.0
    assert found.dof == 4 * len(f) - 4 - 2 * 5  # two poles; two residues and a constant of each output
    assert found.chi2 == pytest.approx(slow_chi2(*data, found.eigenvalues), rel=1e-6)
    covariance, away = by_differences(found, *data)
    covariance = covariance * max(
        1, found.chi2 / found.dof
    )  # as what a fit leaves beyond the noise widens intervals
    assert away == pytest.approx(0, abs=0.01)
    assert np.diagonal(covariance) == pytest.approx(1, rel=0.005)
    for k, V in enumerate(found.covariance):
        assert covariance[2 * k, 2 * k + 1] == pytest.approx(V[0, 1] / np.sqrt(V[0, 0] * V[1, 1]), abs=0.005)


@pytest.mark.slow
def test_responses_of_a_record_give_its_modes() -> None:
    """As by the record itself, though a resonance is narrower than the lines are apart."""
    bench = Bench((3.0, 7.0), (0.001, 0.02), 3)
    rng = np.random.default_rng(5)
    record = bench.record(bench.noise(rng, 100.0, 1), rng, 0.03)
    response = dashpot.frf(record, "u0", band=(1, 20))
    direct, first = dashpot.modes(record, "u0", band=(1, 20)), dashpot.modes(response)
    assert first.eigenvalues == pytest.approx(direct.eigenvalues, rel=1e-4)
    assert first.damping_sd == pytest.approx(direct.damping_sd, rel=0.02)
    alone = dashpot.modes(replace(response, records=()))
    assert np.all(alone.damping_sd > 1.1 * direct.damping_sd)
    assert np.all(np.abs(alone.damping_ratio - bench.damping) < 3.5 * alone.damping_sd)


def test_a_line_without_any_drive_hides_no_mode() -> None:
    bench = Bench((4.0, 9.0), (0.01, 0.02))
    rng = np.random.default_rng(2)
    response = dashpot.frf(
        bench.record(bench.noise(rng, 60.0, 1), rng, 0.02), "u0", band=(1, 20)
    ).independent()
    response = replace(response, records=())
    values, covariance = response.values.copy(), response.covariance.copy()
    values[-1], covariance[-1] = 1e14, 1e28 * np.eye(len(covariance[-1]))
    poor = dashpot.modes(replace(response, values=values, covariance=covariance))
    whole = dashpot.modes(response)
    assert np.all(np.abs(poor.eigenvalues - whole.eigenvalues) < np.sqrt(whole.covariance[:, 0, 0]))


def test_units_of_the_force_change_participations_alone() -> None:
    """Deviations of the shapes of a building had been rounding, since 1 N moves it by next to nothing."""
    rng = np.random.default_rng(4)
    test = TWO.record(TWO.noise(rng, 20.0, 1), rng, 0.02)
    large = replace(test, values=test.values * np.array([1e9, 1, 1]))
    one, other = (dashpot.modes(record, "u0", band=(0.5, 30.0)) for record in (test, large))
    assert other.shape_sd == pytest.approx(one.shape_sd, rel=1e-3)
    assert other.participation_sd * 1e9 == pytest.approx(one.participation_sd, rel=1e-3)


def test_free_decays() -> None:
    found = dashpot.modes(decays(TWO, np.random.default_rng(1), 2, 8.0, 0.02), [], "x0,x1")
    z = np.concatenate(errors(found, TWO))
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert found.participation.shape == (2, 0)


@pytest.mark.slow
def test_a_driven_motion_is_no_free_decay() -> None:
    """It had one mode, with an interval of less than a per cent, that is none of the rig's."""
    rng = np.random.default_rng(6)
    test = TWO.record(TWO.noise(rng, 20.0, 1), rng, 0.01)
    with pytest.raises(DataError, match=r"do not move as in a free decay: it explains \d % of the motion"):
        dashpot.modes(test, outputs=[channel.name for channel in test.channels])
    assert len(dashpot.modes(decays(TWO, rng, 2, 20.0, 1.0)).frequency_hz) == 2


@pytest.mark.long
@pytest.mark.parametrize("case", ["random", "close", "damping", "decays", "responses"])
def test_coverage(case: str) -> None:
    """40 draws: coverage of 93 to 97 %, bias a fifth of the sd, each to three standard errors."""
    f, zeta, shapes = [], [], []
    bench = {"close": CLOSE, "damping": WIDE}.get(case, TWO)
    for draw in range(40):
        rng = np.random.default_rng(draw)
        if case == "decays":
            found = dashpot.modes(decays(TWO, rng, 1, 8.0, 0.02), [], "x0,x1")
        else:
            test = bench.record(bench.noise(rng, 60.0 if case == "close" else 20.0, 1), rng, 0.03)
            outputs = [f"a{i}" for i in range(bench.points)]
            found = dashpot.modes(
                dashpot.frf(test, "u0", outputs) if case == "responses" else test, "u0", outputs
            )
        one, two, three = errors(found, bench)
        f += one.tolist()
        zeta += two.tolist()
        shapes += three.tolist()
    for z in (np.array(f), np.array(zeta), np.array(shapes)):
        inside = np.mean(np.abs(z) < 1.96)
        assert abs(inside - 0.95) < 0.02 + 3 * np.sqrt(0.05 * 0.95 / len(z)), (case, inside)
        assert abs(np.mean(z)) < 0.2 + 3 / np.sqrt(len(z)), case


TWO_MASSES = """
coordinates = ["x1", "x2"]
[inputs]
f = { kind = "force", at = "x1" }
[masses]
m1 = { at = "x1", value = 2 }
m2 = { at = "x2" }
[springs]
k1 = { between = ["x1", "ground"] }
k2 = { between = ["x1", "x2"] }
[dampers]
c1 = { between = ["x1", "ground"] }
c2 = { between = ["x1", "x2"] }
[channels]
f = { of = "f" }
a1 = { of = "x1", quantity = "acceleration", unit = "m/s²", noise = 0.01 }
a2 = { of = "x2", quantity = "acceleration", unit = "m/s²", noise = 0.01 }
"""
TRUTH = {"m2": 1.0, "k1": 8000.0, "k2": 3000.0, "c1": 8.0, "c2": 3.0}


def test_identify_and_compare_read_them(tmp_path: Path) -> None:
    rig = dashpot.parse_rig(TWO_MASSES)
    dwells = rig.simulate(TRUTH, np.arange(2, 20, 0.5), amplitudes={"f": 5.0}, seed=1)
    found = dashpot.modes(dwells, rig=rig)
    assert found.points == ("x1", "x2")
    path = tmp_path / "modes.json"
    path.write_text(to_json(found.to_dict()), encoding="utf-8")
    content = json.loads(path.read_text(encoding="utf-8"))
    first = content["modes"][0]
    assert set(first) >= {"frequency_hz", "damping_ratio", "shape"}
    assert set(first["frequency_hz"]) == {"value", "sd"}
    assert set(first["shape"]["x1"]) == {"re", "im", "sd"}
    from_json = rig.identify(str(path), judge=False)
    from_value = rig.identify(found.modal_data, judge=False)
    blind = dashpot.modes(dwells, "f", ["a1", "a2"])
    of_channels = rig.identify(blind.modal_data, judge=False)
    for name, value in TRUTH.items():
        for other in (from_value, of_channels):
            assert from_json[name].value == pytest.approx(other[name].value, abs=0.1 * from_json[name].sd)
        assert abs(from_json[name].value - value) < 5 * from_json[name].sd


def body_moves(drawing: Any, body: str) -> float:
    """px that a body is from its mean place in the first frame."""
    at = [part.shapes[0].points[0][0] for f in drawing.frames for part in f if part.title == f"body {body}"]
    return float(at[0] - np.mean(at))


@pytest.mark.slow
def test_shapes_are_drawn_on_a_rig_and_what_is_not_measured_rests() -> None:
    rig = dashpot.parse_rig(TWO_MASSES)
    dwells = rig.simulate(TRUTH, np.arange(2, 20, 0.5), amplitudes={"f": 5.0}, seed=1)
    found = dashpot.modes(dwells, "f", ["a1", "a2"])
    second = dashpot.draw(rig, found, mode=2)
    ratio = (found.shapes[1, 0] / found.shapes[1, 1]).real
    assert body_moves(second, "x1") / body_moves(second, "x2") == pytest.approx(ratio, rel=0.01)
    both = dashpot.draw(rig, found)
    assert both.height == pytest.approx(dashpot.draw(rig, found, mode=1).height + second.height)
    alone = dashpot.draw(rig, dashpot.modes(dwells, "f", "a2"), mode=1)
    assert body_moves(alone, "x1") == 0
    assert body_moves(alone, "x2") == pytest.approx(18)
    with pytest.raises(UsageError, match="no mode 3"):
        dashpot.draw(rig, found, mode=3)


@pytest.mark.slow
def test_a_drift_and_a_column_given_twice_leave_sound_deviations() -> None:
    rng = np.random.default_rng(3)
    test = TWO.record(TWO.noise(rng, 30.0, 1), rng, 0.02)
    drifting = test.values.copy()
    drifting[:, 1] += 5 + 6 * np.std(test.values[:, 1]) * np.linspace(0, 1, len(drifting))
    found = dashpot.modes(replace(test, values=drifting), "u0")
    assert np.max(np.abs(np.concatenate(errors(found, TWO)[:2]))) < 4
    assert np.all(found.shape_sd < 1)
    twice = replace(
        test,
        values=np.column_stack([test.values, test.values[:, -1]]),
        channels=(*test.channels, replace(test.channels[-1], name="again")),
    )
    found, once = dashpot.modes(twice, "u0"), dashpot.modes(test, "u0")
    assert found.shapes[:, 2] == pytest.approx(found.shapes[:, 1], abs=1e-4)
    assert found.frequency_sd == pytest.approx(once.frequency_sd, rel=0.1)
    assert np.all(np.abs(found.frequency_hz - once.frequency_hz) < once.frequency_sd)


def held(x: Real, rng: np.random.Generator) -> Real:
    at = np.arange(len(x))
    return np.where((at > len(x) // 2) & (at <= len(x) // 2 + 150), x[len(x) // 2], x)


def clipped(x: Real, rng: np.random.Generator) -> Real:
    return np.clip(x, *np.quantile(x, [0.04, 0.96]))


def spiky(x: Real, rng: np.random.Generator) -> Real:
    at = rng.integers(100, len(x) - 100, 5)
    return x + 30 * np.std(x) * np.isin(np.arange(len(x)), at)


@pytest.mark.slow
@pytest.mark.parametrize("spoiled", [held, clipped, spiky])
def test_samples_that_are_not_measured_bend_no_mode(spoiled: Callable[..., Real]) -> None:
    """As they were taken, shapes were up to 11 standard deviations away, and nothing was said."""
    rng = np.random.default_rng(4)
    test = TWO.record(TWO.noise(rng, 40.0, 1), rng, 0.01)
    values = test.values.copy()
    values[:, 2] = spoiled(values[:, 2], rng)
    found = dashpot.modes(replace(test, values=values), "u0")
    assert np.max(np.abs(np.concatenate(errors(found, TWO)))) < 4
    assert {note.code for note in found.notes} & {"held_samples", "dropouts", "unclipped"}


@pytest.mark.slow
def test_real_shapes_and_no_modes() -> None:
    rng = np.random.default_rng(5)
    test = TWO.record(TWO.noise(rng, 30.0, 1), rng, 0.02)
    found = dashpot.modes(test, "u0", real=True)
    assert np.all(found.shapes.imag == 0)
    assert np.sqrt(np.mean(np.concatenate(errors(found, TWO)[:2]) ** 2)) < 2
    noise = replace(test, values=rng.standard_normal(test.values.shape))
    with pytest.raises(DataError, match="no excitation"):
        dashpot.modes(noise, "u0")
    with pytest.raises(DataError, match="do not move as in a free decay"):
        dashpot.modes(noise, [], "a0,a1")


ONE = """
coordinates = ["x"]
[masses]
m = { at = "x" }
[springs]
k = { between = ["x", "ground"] }
"""


def test_a_models_modes_are_still_to_be_had() -> None:
    model, p = dashpot.parse_rig(ONE).model, np.array([1.0, 4 * np.pi**2])
    for found in (dashpot.modes(model, p), dashpot.modes(model, p=p), dashpot.modes(model=model, p=p)):
        assert found.frequency_hz == pytest.approx(1.0)
    with pytest.raises(UsageError, match="parameters"):
        dashpot.modes(model)
    with pytest.raises(UsageError, match="data"):
        dashpot.modes()


def test_modes_damped_to_two_thirds_of_critical_are_found_in_settled_sines() -> None:
    """Of the rig in Yamane (1989), whose modes have damping ratios of 0.65 and 0.40; no other pole counts as one."""
    rig = rigs.paper_rig(np.linspace(1.0, 12.0, 40))
    chosen = rigs.channels(rig)
    spectrum = rigs.noisy(rig, chosen, rigs.covariance(rig, chosen, 0.01), np.random.default_rng(3))
    found = dashpot.modes(spectrum, ["u"], [channel.name for channel in chosen if channel.name != "u"])
    true = dashpot.modes(rig.model, rig.model.parameters(rig.theta))
    for shown, sd, value in (
        (found.frequency_hz, found.frequency_sd, true.frequency_hz),
        (found.damping_ratio, found.damping_sd, true.damping_ratio),
    ):
        assert np.max(np.abs(shown - value) / sd) < 3.5
        assert np.all(sd < 0.03 * value)
