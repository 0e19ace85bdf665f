"""Mistakes in records whose transients have not died away: the same causes are named as in settled tests."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.check.explain.examine import diagnose, examined
from dashpot.check.explain.steady_lines import steady_lines
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.assessment import Assessment
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.record_noise import with_record_noise
from dashpot.model.dynamics import response
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from tests.whole_rigs import WholeTest, chain, record_of

NOISE = 0.002  # of each channel's size
STEP = 1 / 200  # s, of the integration; every other sample is recorded


@pytest.fixture(scope="module")
def test() -> WholeTest:
    """Two masses on a base that moves at random, from a moving start."""
    model, theta = chain(2, 0.05, seed=2)
    return record_of(model, theta, "random", decay_times=12.0, seed=1)


def dwells(model: Model, theta: Real, like: Record) -> list[Record]:
    """Dwells of four seconds from rest, each with a clock of its own: the transient fills a good part of them."""
    time = np.arange(800) * STEP
    records = []
    p = model.parameters(theta)
    for hz in (3.0, 4.5, 6.0, 7.5, 9.0, 10.5, 13.0, 16.0):
        u = 1e-3 * np.sin(2 * np.pi * hz * time)[:, None]
        motion = integrator(model, p, STEP).motion(u, np.zeros(2 * model.n))
        view = observation_model(model, like.channels, np.ones(1))
        records.append(Record(like.channels, time[::2], channel_samples(view, p, motion)[::2], hz))
    return records


def noisy(records: Sequence[Record], seed: int, mistake: Callable[[Record], Record]) -> list[Record]:
    rng = np.random.default_rng(seed)
    wrong = [mistake(record) for record in records]
    return [
        replace(r, values=r.values + rng.normal(size=r.values.shape) * NOISE * np.std(r.values, axis=0))
        for r in wrong
    ]


def assessed(model: Model, records: Sequence[Record]) -> Assessment:
    lines = spectrum(records)
    assert lines.carries_loads
    lines, method = with_record_noise(model, lines, MaximumLikelihood())
    assessment = examined(model, lines, identify(model, lines, method)).assessment
    assert assessment is not None
    return assessment


def scaled(channel: int, factor: float) -> Callable[[Record], Record]:
    def mistake(record: Record) -> Record:
        values = np.array(record.values)
        values[:, channel] *= factor
        return replace(record, values=values)

    return mistake


def late(record: Record) -> Record:
    """The second channel by one sample or 6 ms, whichever is more; it begins at rest."""
    values = np.array(record.values)
    samples = max(1, round(0.006 / float(record.time[1] - record.time[0])))
    values[:, 1] = np.concatenate([np.zeros(samples), values[:-samples, 1]])
    return replace(record, values=values)


def exchanged(record: Record) -> Record:
    return replace(record, values=record.values[:, [1, 0, 2]])


MISTAKES = {
    "sign": (("x2_dis",), scaled(1, -1.0)),
    "unit": (("x1_dis",), scaled(0, 1e-3)),
    "swap": (("x1_dis", "x2_dis"), exchanged),
    "delay": (("x2_dis",), late),
}
DRIVEN = ["at random", "in dwells"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("driven", "kind"),
    [
        ("in dwells", "delay"),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in (
                ("at random", "delay"),
                ("at random", "unit"),
                ("in dwells", "sign"),
                ("in dwells", "swap"),
            )
        ),
    ],
)
def test_a_mistake_is_named_first(test: WholeTest, driven: str, kind: str) -> None:
    of, mistake = MISTAKES[kind]
    records = [test.record] if driven == "at random" else dwells(test.model, test.theta, test.record)
    wrong = noisy(records, 3, mistake)
    try:
        assessment = assessed(test.model, wrong)
    except IdentifiabilityError:  # there is no answer at all, which the command explains in the same way
        findings = diagnose(test.model, spectrum(wrong))
    else:
        assert assessment.verdict == "does not fit"
        findings = assessment.findings
    assert (findings[0].kind, findings[0].of) == (kind, of)


@pytest.mark.slow
@pytest.mark.parametrize("driven", DRIVEN)
def test_a_right_rig_has_no_finding(test: WholeTest, driven: str) -> None:
    records = [test.record] if driven == "at random" else dwells(test.model, test.theta, test.record)
    assessment = assessed(test.model, noisy(records, 4, lambda record: record))
    assert assessment.verdict == "fits"
    assert assessment.findings == ()


@pytest.mark.parametrize("driven", DRIVEN)
def test_lines_follow_the_rig_to_a_few_per_cent(test: WholeTest, driven: str) -> None:
    records = [test.record] if driven == "at random" else dwells(test.model, test.theta, test.record)
    lines: Spectrum = steady_lines(test.model, spectrum(records))
    inputs = lines.amplitudes[:, 2:]
    shown = response(test.model, test.model.parameters(test.theta), lines.omega, inputs)
    away = np.abs(lines.amplitudes[:, :2] - shown) / np.abs(shown)
    assert len(away) == (8 if driven == "in dwells" else len(away))
    assert np.median(away) < (0.01 if driven == "in dwells" else 0.06)
    assert np.max(away) < (0.06 if driven == "in dwells" else 0.5)
