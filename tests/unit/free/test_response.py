"""Frequency responses without a rig: against the truth, with intervals that cover it, and back into `identify`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal, special, stats

import dashpot
from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.noise import smoothed
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.free.response import (
    MeasuredResponse,
    frequency_response,
    likelihood_by_others,
    pooled_noise,
    write_response,
)
from tests import rigs
from tests.unit.free.bench import RIG, Bench

TWO = Bench((4.0, 9.0), (0.01, 0.02))


def z_scores(found: MeasuredResponse, truth: Complex) -> Real:
    """Errors of real and imaginary parts in standard deviations."""
    error = (found.values - truth) / found.sd
    return np.concatenate([error.real.ravel(), error.imag.ravel()])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inputs", "seconds"),
    [
        (1, (60.0,)),
        pytest.param(2, (60.0,), marks=pytest.mark.long),
        pytest.param(1, (20.0,) * 4, marks=pytest.mark.long),
        (2, (20.0, 33.0)),
        (6, (6.0, 33.0)),
    ],
)
def test_records_of_random_excitation(inputs: int, seconds: tuple[float, ...]) -> None:
    rng, bench = np.random.default_rng(3), replace(TWO, points=6) if inputs > 2 else TWO
    tests = [bench.record(bench.noise(rng, each, inputs), rng, 0.02) for each in seconds]
    names = [f"u{i}" for i in range(inputs)]
    found = dashpot.frf(tests, names, "a0,a1", band=(1, 30))
    z = z_scores(found.independent(), bench.accelerance(found.independent().frequency_hz, inputs)[:, :2])
    assert abs(np.mean(np.abs(z) < 1.96) - 0.95) < 0.035  # 3 standard errors of some 400 independent numbers
    assert found.pairs[0] == "a0/u0"
    assert np.all(found.coherence <= 1)


def test_responses_end_where_the_drive_does() -> None:
    rng, bench = np.random.default_rng(1), Bench((4.0, 9.0), (0.01, 0.02))
    force = np.fft.rfft(rng.standard_normal((60_000, 1)), axis=0)
    hz = np.fft.rfftfreq(60_000, 1e-3)
    force[(hz < 1) | (hz > 20)] = 0
    test = bench.record(np.fft.irfft(force, axis=0), rng, 0.02)
    found = dashpot.frf(test, "u0", "a0,a1")
    assert found.frequency_hz[0] == pytest.approx(1, abs=0.5)
    assert found.frequency_hz[-1] == pytest.approx(20, abs=0.2)
    true = bench.accelerance(found.frequency_hz, 1)
    assert np.max(np.abs(found.values)) < 1.2 * np.max(np.abs(true))


def test_local_models_are_the_textbooks_least_squares() -> None:
    """Windows solved slowly: where no denominator is worth having, H is that of the local polynomial method."""
    rng = np.random.default_rng(0)
    flat = Bench((40.0,), (0.5,))
    record = flat.record(flat.noise(rng, 30.0, 1), rng, 0.1)
    found = dashpot.frf(record, "u0", "a0", band=(8, 12))
    X = np.fft.rfft(record.values - record.values.mean(axis=0), axis=0)
    r, alike = np.arange(-8, 9), []
    for k, H in zip(np.rint(found.frequency_hz * 30.0).astype(int), found.values[:, 0, 0], strict=True):
        U, Y = X[k + r, 0], X[k + r, 1]
        A = np.stack([U, r * U, r**2 * U, r**0, r, r**2], axis=1)
        alike.append(abs(H / np.linalg.lstsq(A, Y, rcond=None)[0][0] - 1) < 1e-8)
    assert np.mean(alike) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(
    "damping", [0.01, *(pytest.param(each, marks=pytest.mark.long) for each in (0.001, 0.1))]
)
def test_errors_are_as_large_as_the_covariance_says(damping: float) -> None:
    """Mean χ² a degree of freedom, of three outputs together, at resonances narrower and broader than the lines."""
    bench = Bench((4.0, 7.0, 9.0), (damping,) * 3, 3)
    rng, each = np.random.default_rng(round(1e4 * damping)), []
    for _ in range(3):
        record = bench.record(bench.noise(rng, 100.0, 1), rng, 0.03)
        found = dashpot.frf(record, "u0", band=(2, 11)).independent()
        e = (found.values - bench.accelerance(found.frequency_hz, 1))[..., 0]
        each.append(
            np.einsum("li,li->l", np.conj(e), np.linalg.solve(found.covariance, e[..., None])[..., 0]).real
            / 3
        )
    # 950 degrees of freedom: 3 standard errors
    assert np.mean(each) == pytest.approx(1, abs=0.1)


def test_noise_is_pooled_where_the_others_make_it_likeliest() -> None:
    """Slowly, line by line, against each width; noise that goes on is pooled over all, a step is not."""
    rng = np.random.default_rng(1)

    def scatter(levels: Real) -> Complex:
        e = (rng.standard_normal((len(levels), 8, 2, 2)) @ [1, 1j]) * levels[:, None, None] ** 0.5
        return np.asarray(np.einsum("lki,lkj->lij", e, np.conj(e)) / 8)

    def slowly(noise: Complex, half: int) -> float:
        total, n = 0.0, len(noise)
        for k in range(n):
            first = int(np.clip(k - half, 0, max(0, n - 2 * half - 1)))
            others = [noise[i] for i in range(first, min(first + 2 * half + 1, n)) if i != k]
            told, beside = 8 * len(others), 8 * sum(others)
            total += told * np.log(np.linalg.det(beside).real)
            total -= (told + 8) * np.log(np.linalg.det(beside + 8 * noise[k]).real)
            total += sum(special.gammaln(told + 8 - i) - special.gammaln(told - i) for i in range(2))
        return total

    even, step = scatter(np.ones(64)), scatter(np.repeat([1.0, 30.0], 32))
    for noise in (even, step):
        best = max([1, 2, 4, 8, 16, 64], key=lambda half: slowly(noise, half))
        assert pooled_noise(noise, 1) == pytest.approx(smoothed(noise, best))
    assert pooled_noise(even, 1) == pytest.approx(np.broadcast_to(np.mean(even, axis=0), even.shape))
    found = pooled_noise(step, 1)[:, 0, 0].real
    assert found[60] / found[3] == pytest.approx(30, rel=0.5)


def test_noise_of_one_output_beside_others_has_an_f_distribution() -> None:
    rng = np.random.default_rng(4)
    freedom, lines = 8, 11
    outer = rng.gamma(freedom, size=lines) / freedom
    level = np.full(lines, np.mean(outer))
    others = (np.sum(outer) - outer) / (lines - 1)
    slow = stats.f.logpdf(outer / others, 2 * freedom, 2 * freedom * (lines - 1)) - np.log(others)
    of_outer = (freedom - 1) * np.log(outer) + freedom * np.log(freedom) - special.gammaln(freedom)
    found = likelihood_by_others(outer[:, None, None] + 0j, level[:, None, None] + 0j, lines, freedom)
    # what is the same for any level is left out: (freedom − 1) log |outer| and constants
    assert found == pytest.approx(float(np.sum(slow - of_outer)), rel=1e-10)


def test_noise_that_a_few_lines_make_is_not_spread_over_all() -> None:
    """Windows that miss sharp resonances, one of each: a mean known but for scatter would take all for even."""
    rng = np.random.default_rng(5)
    lines, freedom = 120, 8
    size = np.where(np.arange(lines) % 40 == 0, 1e4, 1.0)
    e = rng.standard_normal((lines, freedom, 2, 2)) @ [1, 1j] * np.sqrt(size / 2)[:, None, None]
    noise = np.einsum("lni,lnj->lij", e, np.conj(e)) / freedom
    found = pooled_noise(noise, 1)[:, 0, 0].real
    away = np.arange(lines) % 40 == 20
    assert np.max(found[away]) < 5


def test_lines_that_are_told_apart_share_no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every sixth line, with windows of 8 lines on either side, every second one."""
    monkeypatch.setattr("dashpot.free.response.MOST_LINES", 300)
    rng = np.random.default_rng(3)
    found = dashpot.frf(TWO.record(TWO.noise(rng, 60.0, 1), rng, 0.02), "u0", band=(1, 30))
    assert np.diff(found.frequency_hz) == pytest.approx(0.1)
    assert np.all(found.apart == 2)


def test_periods_have_noise_and_distortion_apart() -> None:
    rng = np.random.default_rng(5)
    order = np.arange(3, 60, 2)
    t = np.arange(0, 2.0, 0.01)
    phases = rng.uniform(0, 2 * np.pi, len(order))
    u = np.cos(2 * np.pi * 0.5 * order * t[:, None] + phases).sum(axis=1)
    y = signal.lfilter([1.0], [1.0], np.tile(u, 12)) + 0.02 * np.tile(u, 12) ** 2  # even distortion alone
    noise = 0.01 * rng.standard_normal((len(y), 2))
    channels = (Channel("u", {"u": 1.0}), Channel("y", {"y": 1.0}))
    record = Record(channels, np.arange(len(y)) * 0.01, np.column_stack([np.tile(u, 12), y]) + noise)
    found = dashpot.frf(record, "u", "y")
    assert found.method == "periods"
    assert found.frequency_hz == pytest.approx(0.5 * order)
    z = z_scores(found, np.ones((len(order), 1, 1)))
    assert np.mean(np.abs(z) < 2.26) > 0.85  # twelve periods: t of 11; the noise of the input counts
    even, odd = found.distortion["y"]
    assert even > 0.02
    assert np.isnan(odd)  # all odd multiples are driven


def test_rows_are_the_maximum_of_the_likelihood_of_noise_on_both_sides() -> None:
    """Against a slow search for the true inputs and H together, Σ (z − ẑ)ᴴ V⁻¹ (z − ẑ)."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    rows = 4
    L = rng.normal(size=(rows, 3, 3)) + 1j * rng.normal(size=(rows, 3, 3))
    V = 0.01 * L @ np.conj(np.swapaxes(L, 1, 2))
    u = rng.normal(size=rows) + 1j * rng.normal(size=rows)
    H = np.array([2 - 1j, 0.5j])
    z = np.stack([u, H[0] * u, H[1] * u], axis=1)
    half = np.linalg.cholesky(V)
    z = (
        z
        + np.einsum("rij,rj->ri", half, rng.normal(size=(rows, 3)) + 1j * rng.normal(size=(rows, 3))) / 2**0.5
    )
    channels = tuple(Channel(name, {name: 1.0}) for name in ("u", "a", "b"))
    spectrum = rigs.stated(channels, np.full(rows, 5.0), z, V, np.arange(rows))
    found = dashpot.frf(spectrum, "u", "a,b")

    def away(x: Real) -> Real:
        c = x[: len(x) // 2] + 1j * x[len(x) // 2 :]
        model = np.stack([c[2:], c[0] * c[2:], c[1] * c[2:]], axis=1)
        e = np.linalg.solve(half, (z - model)[..., None]).ravel()
        return np.concatenate([e.real, e.imag])

    start = np.concatenate([H, z[:, 0]])
    best = least_squares(away, np.concatenate([start.real, start.imag]), xtol=1e-14, ftol=1e-14, gtol=1e-12)
    half_way = len(best.x) // 2
    assert found.values[0, :, 0] == pytest.approx(best.x[:2] + 1j * best.x[half_way : half_way + 2], rel=1e-5)
    information = best.jac.T @ best.jac  # of half a χ²: complex noise has half the variance in each part
    sd = np.sqrt(np.diag(np.linalg.inv(2 * information)))[:2]
    assert found.sd[0, :, 0] == pytest.approx(sd, rel=0.15)


@pytest.mark.parametrize("ending", ["csv", "parquet", "uff"])
def test_identify_reads_what_is_written(tmp_path: Path, ending: str) -> None:
    rig = dashpot.parse_rig(RIG)
    dwells = rig.simulate({"m1": 2, "k1": 8000, "c1": 8}, [3, 6, 9, 10, 12, 15], seed=2)
    found = dashpot.frf(dwells, rig=rig)
    write_response(found, tmp_path / f"frf.{ending}")
    estimate = rig.identify(str(tmp_path / f"frf.{ending}"), judge=False)
    direct = rig.identify(dwells, judge=False)
    bare = ending == "uff"  # which has no standard deviations
    reach = (0.6 if bare else 0.05) * direct["m1"].sd
    assert estimate["m1"].value == pytest.approx(direct["m1"].value, abs=reach)
    assert bare or estimate["m1"].sd == pytest.approx(direct["m1"].sd, rel=0.05)


def test_two_inputs_from_two_tests() -> None:
    f = np.array([2.0, 5.0, 8.0])
    truth = TWO.accelerance(f, 2)
    rng = np.random.default_rng(4)
    U = rng.normal(size=(2, 3, 2)) + 1j * rng.normal(size=(2, 3, 2))
    Y = np.einsum("foi,tfi->tfo", truth, U)
    channels = tuple(Channel(n, {n: 1.0}) for n in ("u0", "u1", "a0", "a1"))
    amplitudes = np.concatenate([U, Y], axis=2).reshape(6, 4)
    spectrum = rigs.of_unknown_noise(
        rigs.stated(channels, np.tile(f, 2), amplitudes, np.zeros((6, 4, 4), complex), np.repeat([0, 1], 3))
    )
    found = dashpot.frf(spectrum, ["u0", "u1"], ["a0", "a1"])
    assert found.values == pytest.approx(truth)
    with pytest.raises(DataError, match="driven independently"):
        dashpot.frf(spectrum.select([0, 1, 2]), ["u0", "u1"])


def test_refusals_are_one_line() -> None:
    rng = np.random.default_rng(0)
    record = TWO.record(TWO.noise(rng, 20.0, 1), rng, 0.01)
    with pytest.raises(UsageError, match="no input is named"):
        dashpot.frf(record)
    with pytest.raises(UsageError, match="no channel q"):
        dashpot.frf(record, "q")
    with pytest.raises(DataError, match="too short"):
        dashpot.frf(record.part(slice(0, 20)), "u0")
    with pytest.raises(DataError, match="band"):
        dashpot.frf(record, "u0", band=(80, 90))
    with pytest.raises(DataError, match="no excitation"):
        dashpot.frf(record, "u0", band=(46, 49))
    still = Record(record.channels, record.time, record.values * np.array([0.0, 1.0, 1.0]))
    with pytest.raises(DataError, match="at rest"):
        dashpot.frf(still, "u0")
    kept = np.arange(100) != 50
    gap = Record(record.channels, record.time[:100][kept], record.values[:100][kept])
    for ask in (dashpot.frf, dashpot.modes):
        with pytest.raises(DataError, match="no segment between"):
            ask(gap, "u0")
    reading = dashpot.Reading((record,), None, ())
    assert frequency_response(reading, ["u0"], ["a1"]).outputs[0].quantity is Quantity.ACCELERATION


@pytest.mark.parametrize("periodic", [False, True])
def test_an_output_that_does_not_move_is_named(periodic: bool) -> None:
    rng = np.random.default_rng(0)
    record = TWO.record(TWO.noise(rng, 20.0, 1), rng, 0.01)
    values = np.tile(record.values[:200], (10, 1)) if periodic else record.values.copy()
    values[:, 2] = 5.3
    stuck = Record(record.channels, record.time[: len(values)], values)
    with pytest.raises(DataError, match=r"a1 stays at .* throughout.*leave"):
        dashpot.frf(stuck, "u0")
    with pytest.raises(DataError, match="a1 stays at"):
        dashpot.modes(stuck, "u0" if periodic else None, "a0,a1")
    values[:, 0] = 5.3
    with pytest.raises(DataError, match="u0 is at rest"):
        dashpot.frf(replace(stuck, values=values), "u0", "a0")


@pytest.mark.parametrize("periods", [6, 12])
def test_a_line_at_which_the_force_drops_is_driven(periods: int) -> None:
    """As a shaker's does at a resonance: 34 dB below the lines beside, 17 dB above the noise of the mean."""
    rng, time, lines = np.random.default_rng(1), np.arange(1000 * periods) / 1000, np.arange(5, 90)
    size = np.where(lines == 40, 0.02, 1.0)
    waves = np.sin(2 * np.pi * lines * time[:, None] + rng.uniform(0, 6.28, lines.size)) * size
    noise = 0.002 * (500 * periods) ** 0.5 * rng.standard_normal((len(time), 2))
    drive, answer = waves.sum(axis=1), (waves / size**0.5).sum(axis=1)
    found = dashpot.frf({"time_s": time, "f": drive + noise[:, 0], "y": answer + noise[:, 1]}, "f", "y")
    assert found.frequency_hz == pytest.approx(lines)
    assert abs(found.values[35, 0, 0] - 50**0.5) < 4 * found.sd[35, 0, 0]


def test_three_taps_of_a_hammer_tell_their_noise_together() -> None:
    """Of each line alone the scatter of three is known to a factor of two: intervals held the truth in 85 %, and modes
    were found that are none."""
    rng, f = np.random.default_rng(1), np.arange(2.0, 12.0, 0.05)
    H = TWO.accelerance(f, 1)[:, :, 0]
    taps = H + 0.02 * (rng.standard_normal((3, *H.shape)) + 1j * rng.standard_normal((3, *H.shape)))
    mean, V = np.mean(taps, axis=0), np.zeros((len(f), 3, 3), dtype=np.complex128)
    V[:, [1, 2], [1, 2]] = np.var(taps, axis=0, ddof=1) / 3
    channels = tuple(Channel(name, {name: 1.0}) for name in ("f", "a", "b"))
    lines = Spectrum(
        channels,
        f,
        np.column_stack([np.ones(len(f)), mean]),
        V,
        np.ones(len(f), dtype=np.int64),
        np.full(len(f), 4.0),
        ("periods",) * len(f),
        np.zeros(len(f), dtype=np.int64),
    )
    z = z_scores(dashpot.frf(lines, "f"), H[:, :, None])
    assert abs(np.mean(np.abs(z) < 1.96) - 0.95) < 0.03  # 4 standard errors of 800 numbers
    assert dashpot.modes(lines, "f").frequency_hz == pytest.approx(TWO.frequency_hz, rel=0.01)


def test_no_period_is_left_out_for_rounding() -> None:
    """A drive without noise differs between periods by the rounding of its time."""
    rng, time, odd = np.random.default_rng(0), np.arange(8000) / 1000, np.arange(3, 200, 4)
    drive = np.sin(2 * np.pi * odd * time[:, None] + rng.uniform(0, 6.28, odd.size)).sum(axis=1)
    answer = drive + 1e-3 * rng.standard_normal(8000)
    (note,) = dashpot.frf({"time_s": time, "f": drive, "y": answer}, "f", "y").notes
    assert "means of 8 periods" in note.text
