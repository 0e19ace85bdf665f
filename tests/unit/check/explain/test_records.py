"""Clocks and gains of single channels that step in the course of a record, to which a fit of all channels gives way."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, dlsim, lfilter

import dashpot
from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.check.explain.steady_lines import working_noise
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.assessment import Finding
from dashpot.model.elements import Kind, between, mass
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Input, Model
from dashpot.model.observation import observation_model, transfer
from tests.networks import network
from tests.whole_rigs import chain, excitation, record_of


@pytest.fixture(scope="module")
def test_of_three() -> tuple[Model, Record]:
    """Three masses on a shaken base with 1 % noise."""
    model, truth = chain(3, 0.03, base=True, seed=3)
    record = record_of(model, truth, "random", samples_per_cycle=10, decay_times=5, seed=2).record
    noise = np.random.default_rng(5).normal(size=record.values.shape) * [1, 1, 1, 0]
    return model, replace(record, values=record.values + 0.01 * record.values.std(axis=0) * noise)


def slipped(record: Record, samples: int) -> Record:
    """x2 late by so many samples from the middle on."""
    values = np.array(record.values)
    middle = len(values) // 2
    values[middle:, 1] = record.values[middle - samples : len(values) - samples, 1]
    return replace(record, values=values)


def first_cause(model: Model, record: Record) -> Finding:
    """What the diagnosis names first."""
    return dashpot.identify(model, record, diagnose=True).assessment.findings[0]


def main_hz(record: Record) -> float:
    """Where x2 moves most."""
    power = np.abs(np.fft.rfft(record.values[:, 1])) ** 2
    return float(np.argmax(power)) / (len(record.time) * float(record.time[1] - record.time[0]))


@pytest.mark.parametrize("cycles", [0.1, 0.35, 1.3])
@pytest.mark.long
def test_a_clock_that_slips_by_any_part_of_a_cycle_is_named_as_such(
    test_of_three: tuple[Model, Record], cycles: float
) -> None:
    """From a quarter of a cycle on it was a gain that changed, or a nonlinear element."""
    model, record = test_of_three
    step = float(record.time[1] - record.time[0])
    samples = max(1, round(cycles / main_hz(record) / step))
    estimate = dashpot.identify(model, slipped(record, samples), diagnose=True)
    assert estimate.assessment.verdict == "does not fit"
    first = estimate.assessment.findings[0]
    assert (first.kind, first.of) == ("time", ("x2_dis",))
    late_ms = float(first.text.split(" is ")[1].split()[0])
    assert late_ms == pytest.approx(1e3 * samples * step, rel=0.03, abs=0.2e3 * step)
    at_s = float(first.text.split(" after ")[1].split()[0])
    assert at_s == pytest.approx(record.time[len(record.time) // 2], abs=6 * step)
    assert [each.kind for each in estimate.assessment.findings].count("time") == 1


@pytest.mark.long
def test_a_gain_that_steps_is_no_slip(test_of_three: tuple[Model, Record]) -> None:
    model, record = test_of_three
    values = np.array(record.values)
    values[len(values) // 2 :, 1] *= 0.7
    first = first_cause(model, replace(record, values=values))
    assert (first.kind, first.of) == ("time", ("x2_dis",))
    assert first.text.startswith("the gain of x2_dis changes by a factor of 0.7")


@pytest.mark.long
def test_the_ends_of_acceleration_records_are_no_change_of_a_channel() -> None:
    """Left out of the fit, a channel has no terms of its own for the ends, beside which it jumped by 60 deviations."""
    model, truth = chain(3, 0.03, base=True, seed=3)
    test = record_of(model, truth, "random", decay_times=5, quantities=(Quantity.ACCELERATION,), seed=2)
    sd = 0.01 * test.size * np.array([1, 1, 1, 0])
    record = test.noisy(np.random.default_rng(5), sd)
    assert dashpot.identify(model, record, diagnose=True).assessment.findings == ()


def test_a_record_without_a_step_has_none(test_of_three: tuple[Model, Record]) -> None:
    model, record = test_of_three
    assert dashpot.identify(model, record, diagnose=True).assessment.findings == ()


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "kind", "word"),
    [
        ("saturated", ("saturation", "channel"), "saturated"),
        ("drift", ("channel",), "drifts"),
        ("spikes", ("time",), "abruptly"),
        ("filtered", ("filter",), "high-pass"),
        ("gain", ("gain",), "1.3"),
    ],
)
def test_a_sensor_that_ends_drifts_or_spikes_is_named_first(
    test_of_three: tuple[Model, Record], name: str, kind: tuple[str, ...], word: str
) -> None:
    """What one sensor alone does was "no simple reason", or blamed on another channel's clock."""
    model, record = test_of_three
    values = np.array(record.values)
    x, size = values[:, 1], float(values[:, 1].std())
    if name == "saturated":
        values[:, 1] = 1.5 * size * np.tanh(x / (1.5 * size))
    elif name == "drift":
        values[:, 1] += 2 * size * np.linspace(-1, 1, len(values)) ** 2
    elif name == "filtered":
        values[:, 1] = lfilter(
            *butter(1, 0.3 * main_hz(record) * 2 * (record.time[1] - record.time[0]), "high"), x
        )
    elif name == "gain":
        values[:, 1] *= 1.3
    else:
        # of two samples each: single ones are taken as not measured
        values[[150, 151, 388, 389, 750, 751], 1] += 6 * size
    estimate = dashpot.identify(model, replace(record, values=values), diagnose=True)
    assert estimate.assessment.verdict == "does not fit"
    first = estimate.assessment.findings[0]
    assert first.kind in kind
    assert first.of == ("x2_dis",)
    assert word in first.text


@pytest.mark.slow
def test_a_slip_of_few_samples_is_mended_and_not_left_out() -> None:
    """Its size comes from the channel itself, which a fit without the channel does not have."""
    model, truth = chain(2, 0.03, base=True, seed=3)
    test = record_of(model, truth, "random", samples_per_cycle=10, decay_times=5, seed=2)
    record = test.noisy(np.random.default_rng(5), 0.01 * test.size * np.array([1, 1, 0]))
    step = float(record.time[1] - record.time[0])
    first = first_cause(model, slipped(record, 4))
    assert (first.kind, first.of) == ("time", ("x2_dis",))
    assert first.number == pytest.approx(4 * step, abs=0.5 * step)  # s; slips are tried by half steps


@pytest.mark.slow
def test_a_body_that_the_rig_lacks_is_named_in_a_whole_record() -> None:
    model, truth = chain(2, 0.03, base=True, seed=3)
    parts = (
        mass("mb", "body", value=0.15),
        between("kb", Kind.SPRING, "body", "x2", value=0.15 * 60.0**2),  # rad/s, between the two modes
        between("cb", Kind.DAMPER, "body", "x2", value=0.5),
    )
    larger = replace(model, coordinates=(*model.coordinates, "body"), elements=(*model.elements, *parts))
    test = record_of(
        larger, truth, "random", samples_per_cycle=10, decay_times=6, seen=model.coordinates, seed=2
    )
    record = test.noisy(np.random.default_rng(5), 0.01 * test.size * [1, 1, 0])
    first = first_cause(model, record)
    assert (first.kind, first.of) == ("oscillator", ("x2",))
    assert first.number == pytest.approx(0.15 * 60.0**2, rel=0.1)


@pytest.mark.slow
def test_a_low_pass_filter_far_above_the_motion_is_no_delay_and_no_held_input() -> None:
    """Its corner is sought closely before forms of one channel's mistake are told apart."""
    model, truth = chain(1, 0.03, base=True, seed=3)
    test = record_of(model, truth, "random", decay_times=10, seed=2)
    step = float(test.record.time[1] - test.record.time[0])
    values, nyquist_hz = np.array(test.record.values), 0.5 / step
    lines_hz = np.fft.rfftfreq(2 * len(values), step)
    corner_hz = 0.6 * nyquist_hz
    passed = np.fft.rfft(values[:, 0], 2 * len(values)) / (1 + 1j * lines_hz / corner_hz)
    values[:, 0] = np.fft.irfft(passed, 2 * len(values))[: len(values)]
    noise = np.random.default_rng(5).normal(size=values.shape) * 0.003 * values.std(axis=0) * [1, 0]
    first = first_cause(model, replace(test.record, values=values + noise))
    assert (first.kind, first.of) == ("filter", ("x1_dis",))
    assert first.number == pytest.approx(corner_hz, rel=0.2)


def random_motion_of_three(seed: int) -> tuple[Model, Real, Record]:
    """Three masses on a shaken base, all springs and dampers unknown, their true values, and 0.5 % noise."""
    model, truth = chain(3, 0.03, base=True, seed=seed)
    record = record_of(model, truth, "random", decay_times=5, seed=2).record
    noise = np.random.default_rng(5).normal(size=record.values.shape) * [1, 1, 1, 0]
    return model, truth, replace(record, values=record.values + 0.005 * np.std(record.values, axis=0) * noise)


@pytest.mark.parametrize("seed", [3, 5])
@pytest.mark.long
def test_a_channel_that_passes_no_slow_motion_is_not_taken_for_a_late_one(seed: int) -> None:
    """The lines without the loads of the record's ends fit a delay as well."""
    model, _, record = random_motion_of_three(seed)
    values, step = np.array(record.values), float(record.time[1] - record.time[0])
    corner_hz = 0.5 / (record.time[-1] - record.time[0])
    values[:, 1] = lfilter(*butter(1, 2 * step * corner_hz, "high"), values[:, 1])
    first = first_cause(model, replace(record, values=values))
    assert (first.kind, first.of) == ("filter", ("x2_dis",))
    assert first.number == pytest.approx(corner_hz, rel=0.2)


@pytest.mark.parametrize(("seed", "rate"), [(3, 1.011), (3, 0.992), (5, 1.011)])
@pytest.mark.long
def test_a_time_base_that_is_off_by_one_per_cent_is_named_where_one_mass_is_seen(
    seed: int, rate: float
) -> None:
    """What two of the springs are is known."""
    model, truth, record = random_motion_of_three(seed)
    own = {unknown.name: float(value) for unknown, value in zip(model.unknowns, truth, strict=True)}
    known = [
        replace(each, value=own[each.name]) if each.name in ("k1", "k3") else each for each in model.elements
    ]
    seen = Record([record.channels[k] for k in (1, 3)], record.time * rate, record.values[:, [1, 3]])
    first = first_cause(replace(model, elements=tuple(known)), seen)
    assert (first.kind, first.of) == ("frequency", ())
    assert first.number == pytest.approx(rate, abs=0.002)


@pytest.mark.long
def test_a_small_gain_is_named_where_noise_is_most_of_what_is_left(
    test_of_three: tuple[Model, Record],
) -> None:
    model, record = test_of_three
    first = first_cause(model, replace(record, values=record.values * [1.0, 1.01, 1.0, 1.0]))
    assert (first.kind, first.of) == ("gain", ("x2_dis",))
    assert first.number == pytest.approx(1.01, abs=0.002)


@pytest.mark.slow
def test_what_describes_the_motion_closely_and_has_a_likely_cause_does_not_fit() -> None:
    """Two dampers alone are known, the force reads 0.4 % too much, and 0.3 % of the motion is left at the most."""
    model, truth = chain(2, 0.05, base=False, force=True, seed=3)
    own = {unknown.name: float(value) for unknown, value in zip(model.unknowns, truth, strict=True)}
    stated = {"m1": None, "c1": own["c1"], "c2": own["c2"]}
    elements = tuple(replace(each, value=stated.get(each.name, each.value)) for each in model.elements)
    record = record_of(model, truth, "random", decay_times=40, seed=2).record
    noise = np.random.default_rng(5).normal(size=record.values.shape) * [0.01, 0.01, 0.0]
    values = (record.values + record.values.std(axis=0) * noise) * [1.0, 1.0, 1.004]
    shown = replace(record, values=values)
    assessment = dashpot.identify(replace(model, elements=elements), shown, diagnose=True).assessment
    assert assessment.described
    assert assessment.verdict == "does not fit"
    assert [reason.code for reason in assessment.reasons] == ["one_cause"]
    assert ("gain", ("f",)) in {(each.kind, each.of) for each in assessment.findings}


@pytest.mark.parametrize("proportional", [False, True])
def test_the_noise_of_the_quietest_record_holds_for_all_as_it_stands_or_in_proportion(
    proportional: bool,
) -> None:
    """Of two sound records; a third whose residuals are a misfit counts no more noise than they have."""
    size = np.array([1.0, 10.0, 10.0])
    true = 0.01 * size**2 if proportional else np.full(3, 0.01)
    residual = true * [1, 1, 100]
    channels = (Channel("x", {"x": 1.0}),)
    record = WholeRecord(2.0, 200)
    found = Spectrum(
        channels, np.array([1.0, 1.0, 1.0]), size[:, None].astype(complex), residual[:, None, None].astype(complex),
        np.full(3, 200), np.full(3, np.inf), ("residual",) * 3, np.zeros(3, dtype=np.int64),
        stretch=np.arange(3), stretches=(record,) * 3,
    )  # fmt: skip
    assert working_noise(found)[:, 0] == pytest.approx(true, rel=0.01)  # beside what every line has


def with_a_tone(record: Record, per_channel: np.ndarray, frequency_hz: float) -> Record:
    """With a steady motion beside its own; per_channel (channels,): complex amplitudes."""
    turn = np.exp(2j * np.pi * frequency_hz * (record.time - record.time[0]))
    return replace(record, values=record.values + (turn[:, None] * per_channel).real)


@pytest.mark.long
def test_a_tone_in_one_channel_is_told_from_a_force_that_moves_all(
    test_of_three: tuple[Model, Record],
) -> None:
    """Either lies between two lines of the record, so that it leaks into all."""
    model, record = test_of_three
    truth = chain(3, 0.03, base=True, seed=3)[1]
    frequency_hz = 1.37 * main_hz(record)
    amplitudes = 0.1 * record.values[:, 1].std() * np.eye(4)[1] * np.exp(0.7j)
    first = first_cause(model, with_a_tone(record, amplitudes, frequency_hz))
    assert (first.kind, first.of) == ("tone", ("x2_dis",))
    assert f"{frequency_hz:.4g} Hz" in first.text

    pushed = replace(model, inputs=(*model.inputs, Input("p", "force", {"x1": 1.0})))
    view = observation_model(pushed, record.channels, np.array([2 * np.pi * frequency_hz]))
    (by_force,) = transfer(view, pushed.parameters(truth)).G[..., -1]
    by_force = 0.1 * record.values[:, 1].std() * by_force / np.abs(by_force[1])
    first = first_cause(model, with_a_tone(record, by_force, frequency_hz))
    assert (first.kind, first.of) == ("input", ("x1",))
    assert f"{frequency_hz:.4g} Hz" in first.text


def held_test(straight: bool) -> tuple[Model, Record]:
    """One mass under a force that is held from sample to sample, or straight in between, seen as an acceleration."""
    m, k, c, step, count = 2.0, 800.0, 4.0, 0.05, 1500
    force = np.random.default_rng(1).normal(size=count)
    moved, pushed = np.array([[0, 1], [-k / m, -c / m]]), np.array([[0], [1 / m]])
    system = cont2discrete((moved, pushed, moved[1:], pushed[1:]), step, "foh" if straight else "zoh")
    acceleration = dlsim(system, force)[1][:, 0]
    channels = (Channel("a", {"x": 1.0}, Quantity.ACCELERATION), Channel("f", {"f": 1.0}, Quantity.FORCE))
    noise = 0.01 * acceleration.std() * np.random.default_rng(2).normal(size=count)
    values = np.stack([acceleration + noise, force], axis=1)
    return network("x", "f@x", "m@x k:x-ground c:x-ground"), Record(channels, step * np.arange(count), values)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("straight", "word"),
    [
        pytest.param(False, "held", id="held"),
        pytest.param(True, "straight", id="straight", marks=pytest.mark.long),
    ],
)
def test_what_an_input_does_between_its_samples_is_told_by_its_images(straight: bool, word: str) -> None:
    """The sampling rate is 16 times the resonance; a delay of half a step explains less."""
    first = first_cause(*held_test(straight))
    assert (first.kind, first.of) == ("hold", ("f",))
    assert word in first.text
    assert first.remaining is None or first.remaining < 1.5


def recorded(
    model: Model, theta: Real, channels: Sequence[Channel], drive: Real, rate: float, noise: Sequence[float],
    rng: np.random.Generator,
) -> Record:  # fmt: skip
    """What channels show of a rig from rest, four times as finely driven (samples, 1), with a share of noise each."""
    p = model.parameters(theta)
    motion = integrator(model, p, 1 / rate).motion(drive, np.zeros(2 * model.n))
    values = channel_samples(observation_model(model, channels, np.ones(1)), p, motion)[::4]
    values = values + rng.normal(size=values.shape) * noise * values.std(axis=0)
    return Record(tuple(channels), 4 / rate * np.arange(len(values)), values)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.long), 3])
def test_a_channel_that_a_fit_takes_for_noise_is_looked_at(seed: int) -> None:
    """A velocity declared as a displacement, beside a force that tells the rig: all of it was noise of 100 %."""
    rng = np.random.default_rng(seed)
    model = network("x1 x2", "u", "m1@x1=62 m2@x2=171 k1:x1-u k2:x2-x1 c1:x1-u c2:x2-x1=1630")
    channels = (
        Channel("v1", {"x1": 1.0}, Quantity.VELOCITY),
        Channel("r", {"u": 1.0}, Quantity.FORCE),
        Channel("u", {"u": 1.0}, Quantity.DISPLACEMENT),
    )
    base = 1e-3 * excitation("random", np.arange(4001) / 4000, 8.0, 80.0, rng)[:, None]
    record = recorded(model, np.array([6.3e6, 2.27e6, 2040.0]), channels, base, 4000, (0.01, 0.008, 0.0), rng)
    stated = (replace(channels[0], quantity=Quantity.DISPLACEMENT), *channels[1:])
    assessment = dashpot.identify(model, replace(record, channels=stated), diagnose=True).assessment
    assert assessment.verdict == "does not fit"
    assert (assessment.findings[0].kind, assessment.findings[0].of) == ("quantity", ("v1",))


@pytest.mark.long
def test_a_wrong_unit_that_leaves_a_flat_valley_is_named() -> None:
    """Of the valley that the other channel alone leaves, rounding decides whether it is refused: named it is either
    way.
    """
    model, theta = chain(2, 0.03, base=True, seed=1)
    test = record_of(model, theta, "random", decay_times=4, seed=1)
    record = test.noisy(np.random.default_rng(1), 0.005 * test.size * [1, 1, 0])
    try:
        assessment = dashpot.identify(
            model, replace(record, values=record.values * [1000.0, 1, 1]), diagnose=True
        ).assessment
    except IdentifiabilityError as refused:
        causes = refused.causes
    else:
        assert assessment.verdict == "does not fit"
        causes = assessment.findings
    assert (causes[0].kind, causes[0].of) == ("unit", ("x1_dis",))


@pytest.mark.slow
def test_a_relative_acceleration_that_is_declared_a_displacement_is_named() -> None:
    """The ends of the base's own motion are in it, so that the lines of a record alone do not turn it into one."""
    model = network("x1 x2", "u", "m1@x1 m2@x2=171 k1:x1-u=6.3e6 k2:x2-x1 c1:x1-u c2:x2-x1=1630")
    drive = 1e-3 * excitation("random", np.arange(4001) / 4000, 8.0, 80.0, np.random.default_rng(3))[:, None]
    channels = (
        Channel("v2", {"x2": 1.0}, Quantity.VELOCITY),
        Channel("relative", {"x2": 1.0, "u": -1.0}, Quantity.ACCELERATION),
        Channel("u", {"u": 1.0}),
    )
    theta, rng = np.array([62.0, 2.27e6, 2040.0]), np.random.default_rng(1)
    record = recorded(model, theta, channels, drive, 4000, (0.01, 0.01, 0.0), rng).part(slice(200, 800))
    stated = (channels[0], replace(channels[1], quantity=Quantity.DISPLACEMENT), channels[2])
    first = first_cause(model, replace(record, channels=stated))
    assert (first.kind, first.of) == ("quantity", ("relative",))


@pytest.mark.slow
def test_a_cause_is_found_from_the_rig_of_the_file_where_the_wrong_one_has_run_away() -> None:
    """The only sensor sits on the other mass, so that a rigid spring k2 leaves least."""
    elements = (
        mass("m1", "x1"), mass("m2", "x2", value=21.75),
        between("k1", Kind.SPRING, "x1", "ground", guess=2.4e6), between("k2", Kind.SPRING, "x2", "x1", guess=3.7e6),
        between("c1", Kind.DAMPER, "x1", "ground"), between("c2", Kind.DAMPER, "x2", "x1", value=2312.0),
    )  # fmt: skip
    model = Model(("x1", "x2"), (Input("f", "force", {"x2": 1.0}),), elements)
    drive = excitation("random", np.arange(8001) / 4000, 15.0, 120.0, np.random.default_rng(3))[:, None]
    channels = Channel("d2", {"x1": 1.0}), Channel("f", {"f": 1.0}, Quantity.FORCE)
    theta, rng = np.array([24.0, 2.17e6, 3.66e6, 611.0]), np.random.default_rng(1)
    record = recorded(model, theta, channels, drive, 4000, (0.02, 0.0), rng)
    stated = replace(record, channels=(replace(channels[0], of={"x2": 1.0}), channels[1]))
    estimate = dashpot.identify(model, stated, diagnose=True)
    assert estimate["k2"].value > 1e7
    first = estimate.assessment.findings[0]
    assert (first.kind, first.of) == ("place", ("d2",))
