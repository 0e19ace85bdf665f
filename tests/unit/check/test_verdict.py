"""Data that once passed for a fit, or were blamed on the wrong thing: the verdict says what they are."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Complex
from dashpot.channel import Channel, Quantity
from dashpot.check.deficiencies import require_identifiable
from dashpot.check.explain.examine import examined
from dashpot.check.verdict import assess, silent_channels
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.periods import driven_lines
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.diagnostics import wrong_signs
from dashpot.model.dynamics import response
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.notices import Notice
from tests import rigs
from tests.networks import network
from tests.nonlinear_rigs import motions, settled, two_masses
from tests.two_masses import PUSHED, two_mass_rig
from tests.unit.data.test_local_noise import RIG, functions
from tests.whole_rigs import chain

PAPER = rigs.paper_rig()
CHANNELS = rigs.channels(PAPER, (Quantity.DISPLACEMENT,))


@pytest.mark.parametrize("share", [0.03, 1.0])
def test_friction_on_a_linear_rig_does_not_fit(share: float) -> None:
    """Slight friction too, which raises the residuals to some times the noise."""
    model, theta = two_masses("coulomb")
    theta = np.array(theta)
    theta[5] *= share
    rng = np.random.default_rng(2)
    lines = [3, 4, 5, 6, 7, 8, 9.5, 11]
    data = settled(model, theta, motions("x1", "x2", "u"), lines, orders=(1,), noise=0.002, rng=rng, most=15)
    linear = replace(model, elements=model.elements[:-1])
    assert assess(linear, data, identify(linear, data)).verdict == "does not fit"


def bump(lines: int, sd: float | None) -> tuple[Model, Spectrum]:
    """One heavily damped mass, and the receptance of two at the first one's place; noise a share `sd` or not given."""
    both = functions(lines, 0.05, truth=PUSHED | {"c1": 60.0, "c2": 40.0})
    shown = [0, 2]
    covariance = np.full((lines, 2, 2), np.nan, dtype=complex)
    if sd is not None:
        covariance = np.zeros((lines, 2, 2), dtype=complex)
        covariance[:, 0, 0] = (sd * np.abs(both.amplitudes[:, 0])) ** 2
    one = network("x1", "f@x1", "m@x1 k:x1-ground c:x1-ground")
    data = replace(
        both,
        channels=tuple(both.channels[c] for c in shown),
        amplitudes=both.amplitudes[:, shown],
        covariance=covariance,
        noise=("unknown" if sd is None else "given",) * lines,
    )
    return one, data


@pytest.mark.parametrize("sd", [None, 0.23])
def test_a_damped_bump_is_not_one_mode(sd: float | None) -> None:
    """Noise that is unknown or stated so large that χ² passes: the residuals run smoothly over frequency."""
    model, data = bump(40, sd)
    estimate = identify(model, data)
    assert sd is None or float(estimate.fit.p) > 0.01
    assessment = assess(model, data, estimate)
    assert assessment.verdict == "does not fit"
    assert "smooth_residuals" in {reason.code for reason in assessment.reasons}


def test_a_change_in_the_course_of_a_record_is_reason_and_cause() -> None:
    model, data = bump(40, 0.02)
    warned = replace(identify(model, data), warnings=(Notice("spikes", "x1 jumps at 3 s", ("x1",)),))
    judged = assess(model, data, warned)
    assert judged.verdict == "does not fit"
    assert "spikes" in [reason.code for reason in judged.reasons]
    (cause,) = judged.findings
    assert (cause.kind, cause.of, cause.remaining) == ("time", ("x1",), None)
    assert cause.text.startswith("x1 jumps at 3 s.")


def test_an_unstable_rig_does_not_fit_where_no_noise_is_given() -> None:
    """Lines too far apart to show their noise."""
    few = functions(12, 0.01, truth=PUSHED | {"c1": -1.0, "c2": -0.5})
    estimate = identify_with_noise(RIG, few)[0]
    assert not estimate.fit.known_noise
    assessment = assess(RIG, few, estimate)
    assert assessment.verdict == "does not fit"
    assert "unstable" in {reason.code for reason in assessment.reasons}


def test_nobody_signs_a_rig_that_noise_alone_makes_unstable() -> None:
    """Hardly damped masses at twelve lines: modes come out stable or not, by chance (20 draws, seeds 0 to 19)."""
    seen = set()
    for seed in range(20):
        few = functions(12, 0.05, seed, truth=PUSHED | {"c1": 0.02, "c2": 0.01})
        size = 0.05**2 * np.abs(few.amplitudes[:, :2]) ** 2
        covariance = np.zeros((12, 3, 3), dtype=complex)
        covariance[:, [0, 1], [0, 1]] = size + 0.01 * np.mean(size, axis=0)
        data = replace(few, covariance=covariance, noise=("given",) * 12)
        estimate = identify(RIG, data)
        judged = assess(RIG, data, estimate)
        seen.add((bool(np.any(estimate.modes.damping_ratio < 0)), judged.verdict))
        assert ("perhaps_unstable" in {reason.code for reason in judged.reasons}) == (
            judged.verdict == "cannot tell"
        )
    assert {(True, "cannot tell"), (False, "fits")} <= seen <= {(True, "cannot tell"), (False, "fits")}


def test_a_misfit_excuses_no_negative_mass() -> None:
    """However wide the misfit makes the interval, 0 is not in that of the noise; nor is a wild value nearly 0."""
    theta = np.array([-32.8, 2.7, 20.0, 30.0, 1.0, 1.0])
    noise = np.diag(np.full(6, 0.01))
    (beyond,) = wrong_signs(PAPER.model, theta, noise)
    assert (beyond.code, beyond.of) == ("negative", ("m1",))
    (loose,) = wrong_signs(PAPER.model, theta, np.diag(np.full(6, 30.0**2)))
    assert (loose.code, loose.of) == ("negative_but_zero", ("m1",))
    assert "± 30 kg" in loose.text
    theta[0] = -0.5
    (near,) = wrong_signs(PAPER.model, theta, np.diag(np.full(6, 30.0**2)))
    assert near.code == "negative_but_zero"
    assert "consistent with zero" in near.text


def test_a_forgotten_mass_is_named() -> None:
    rig = two_mass_rig(dampers='c1 = { between = ["x1", "x2"] }\n')
    model = replace(rig.model, elements=tuple(e for e in rig.model.elements if e.name != "m1"))
    with pytest.raises(IdentifiabilityError, match="c1: x1 has no mass") as refused:
        require_identifiable(model, rig.channels)
    assert 'm_x1 = { at = "x1" }' in str(refused.value)


def bench(seed: int = 0) -> tuple[Model, Spectrum]:
    """Motor and load with a force that is late and a load that counts the other way, neither of them declared."""
    parts = "J1@motor J2@load k:motor-load c:motor-load c1:motor-ground c2:load-ground"
    model = network("motor load", "torque@motor", parts)
    truth = {"J1": 0.0048, "J2": 0.0048, "k": 550.0, "c": 0.012, "c1": 0.043, "c2": 0.092}
    hz = np.linspace(11, 250, 30)
    omega = 2 * np.pi * hz
    X = response(model, model.parameters(model.theta(truth)), omega, np.zeros((30, 0)), np.ones((30, 1)))
    rng = np.random.default_rng(seed)
    sd = 0.01 * np.abs(X)
    X = X + sd / np.sqrt(2) * (rng.normal(size=X.shape) + 1j * rng.normal(size=X.shape))
    Y: Complex = np.concatenate([X * [1, -1], np.exp(1j * omega * 1e-4)[:, None]], axis=1)
    channels = (
        Channel("theta_m", {"motor": 1.0}), Channel("theta_l", {"load": 1.0}),
        Channel("torque", {"torque": 1.0}, Quantity.FORCE),
    )  # fmt: skip
    V = np.zeros((30, 3, 3), dtype=complex)
    V[:, [0, 1], [0, 1]] = sd**2
    return model, rigs.stated(channels, hz, Y, V)


@pytest.mark.slow
def test_a_motor_bench_without_its_sign_and_delay_does_not_fit() -> None:
    """Either angle may be the one that is turned: two causes at once are two steps."""
    model, data = bench()
    estimate = examined(model, data, identify_with_noise(model, data)[0])
    assert estimate.assessment.verdict == "does not fit"
    first, second = estimate.assessment.findings[:2]
    assert first.kind == "sign"
    assert first.of[0] in ("theta_m", "theta_l")
    assert second.kind == "delay"


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["dead", "flipped"])
def test_one_bad_dwell_of_many_is_named(fault: str) -> None:
    records = rigs.records(PAPER, CHANNELS, np.random.default_rng(3), samples=80, periods=8.0, relative=0.02)
    bad = 10
    values = np.array(records[bad].values)
    values[:, :2] *= 1e-3 if fault == "dead" else -1.0
    records[bad] = Record(CHANNELS, records[bad].time, values, records[bad].frequency_hz)
    data = spectrum(records)
    estimate = examined(PAPER.model, data, identify_with_noise(PAPER.model, data)[0])
    assert estimate.assessment.verdict == "does not fit"
    first = estimate.assessment.findings[0]
    assert (first.kind, first.of) == ("dwell", (f"{records[bad].frequency_hz:g} Hz",))


@pytest.mark.parametrize("distortion", [0.0, 0.01])
def test_lines_that_a_multisine_does_not_drive_are_no_silent_sensor(distortion: float) -> None:
    """Three periods from rest, driven at every fourth of 240 lines: the others tell the noise, and distortion."""
    model, theta = chain(1, 0.04)
    channels = (Channel("x1", {"x1": 1.0}), Channel("u", {"u": 1.0}))
    rng, driven, rate, fine = np.random.default_rng(1), np.arange(11, 251, 4), 64, 4
    time = np.arange(48 * rate * fine + 1) / (rate * fine)
    u = 1e-3 * np.cos(2 * np.pi * np.outer(time, driven) / 16 + rng.uniform(0, 6.3, len(driven))).sum(axis=1)
    motion = integrator(model, p := model.parameters(theta), time[1]).motion(u[:, None])
    values = channel_samples(observation_model(model, channels, np.ones(1)), p, motion)[:-1:fine]
    size = np.std(values, axis=0)
    values = values + distortion * size * [1, 0] * ((values / size) ** 2 + (values / size) ** 3)
    values += 0.01 * size * rng.normal(size=values.shape)
    lines = spectrum([Record(channels, np.arange(len(values)) / rate, values)])
    (note,) = [note for note in lines.notes if note.code == "lines_driven"]
    assert "one in 12 from 33 to 741" in note.text
    assert silent_channels(model, lines) == {}
    assert not np.all(driven_lines(lines.amplitudes[:, :1]))  # the answer alone shows the pattern, too
    estimate = identify_with_noise(model, lines)[0]
    if not distortion:
        assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)
    assert (estimate.sd[0] > 2e-4 * theta[0]) == (distortion > 0)
