"""Plain mistakes of a record that an estimate from another one predicts badly are named, with what to do about them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.check.explain.prediction import mistakes_in_lines
from dashpot.check.validation import missed, validate
from dashpot.data.conditioning.whole_record import whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import SettledDwell, concatenate
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.observation import observation_model
from tests.two_masses import SHAKEN, SHAKEN_TRUTH

CHANNELS = (
    Channel("x1", {"x1": 1.0}),
    Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
    Channel("u", {"u": 1.0}),
)
LATE = 2  # samples


def record(seed: int) -> Record:
    """Twenty seconds of a base in aperiodic motion at 100 Hz, 1 % noise on what moves."""
    rng = np.random.default_rng(seed)
    p = SHAKEN.parameters(SHAKEN.theta(SHAKEN_TRUTH))
    fine = np.arange(2000 * 8) / 800
    f = rng.uniform(0.3, 15, 80)
    base = 2e-4 * np.sum(np.cos(2 * np.pi * f[:, None] * fine + rng.uniform(0, 6, 80)[:, None]), axis=0)
    motion = integrator(SHAKEN, p, 1 / 800).motion(base[:, None], np.zeros(4))
    values = channel_samples(observation_model(SHAKEN, CHANNELS, np.ones(1)), p, motion)[::8]
    noise = 0.01 * np.std(values, axis=0) * [1, 1, 0.1] * rng.standard_normal(values.shape)
    return Record(CHANNELS, fine[::8], values + noise)


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return identify(SHAKEN, whole_records([record(1)]))


def times(factors: list[float]) -> Callable[[Record], Record]:
    return lambda data: replace(data, values=data.values * np.array(factors))


def late(data: Record) -> Record:
    """The first channel as it was two samples ago."""
    x1: Real = np.concatenate([np.full(LATE, data.values[0, 0]), data.values[:-LATE, 0]])
    return replace(data, values=np.column_stack([x1, data.values[:, 1:]]))


MISTAKES = {
    "a sign": (times([-1, 1, 1]), "sign", ("x1",), "multiply x1 by −1 in the data"),
    "of the input": (times([1, 1, -1]), "sign", ("u",), "multiply u by −1 in the data"),
    "mm": (times([1e3, 1, 1]), "unit", ("x1",), "multiply x1 by 0.001 in the data"),
    "g": (times([1, 1 / 9.80665, 1]), "unit", ("a2",), "multiply a2 by 9.80665 in the data"),
    "late": (late, "delay", ("x1",), "ms in the data"),
    "clock": (
        lambda data: replace(data, time=1.024 * data.time),
        "frequency",
        (),
        "sampling rate of the data by 1.02",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_a_fresh_record_is_named_first(name: str, estimate: Estimate) -> None:
    """Of whole records nothing but "poorly predicted" was said."""
    mistaken, kind, of, change = MISTAKES[name]
    spectrum = whole_records([mistaken(record(2))])
    assert missed(validate(SHAKEN, estimate, spectrum))
    first = mistakes_in_lines(SHAKEN, estimate, spectrum)[0]
    assert (first.kind, first.of) == (kind, of)
    assert change in first.change
    if kind == "delay":
        assert first.number == pytest.approx(LATE / 100, rel=0.05)


def test_of_several_records_the_one_that_is_wrong_is_named(estimate: Estimate) -> None:
    spectrum = whole_records([record(2), times([-1, 1, 1])(record(3))])
    (finding,) = mistakes_in_lines(SHAKEN, estimate, spectrum)
    assert (finding.kind, finding.of) == ("sign", ("x1",))
    assert finding.text.startswith("in record 2, x1 ")
    assert finding.change == "multiply x1 by −1 in record 2"


@pytest.mark.slow
def test_records_are_counted_beside_settled_lines_as_well(estimate: Estimate) -> None:
    """The first record had been called the second one, and settled lines the first."""
    wrong = whole_records([times([-1, 1, 1])(record(3))])
    settled = replace(wrong, stretches=(SettledDwell(),))
    findings = mistakes_in_lines(SHAKEN, estimate, concatenate([settled, wrong]))
    assert [finding.text.split(",")[0] for finding in findings] == ["in the settled lines", "in record 1"]
    assert findings[-1].change == "multiply x1 by −1 in record 1"


def test_a_sound_record_and_another_rig_have_no_mistake(estimate: Estimate) -> None:
    """A spring of half the stiffness makes another motion, of which no channel is to blame."""
    assert mistakes_in_lines(SHAKEN, estimate, whole_records([record(2)])) == ()
    halves = np.where(np.array(estimate.names) == "k1", 0.5, 1.0)
    other = replace(estimate, values=estimate.values * halves)
    spectrum = whole_records([record(2)])
    assert missed(validate(SHAKEN, other, spectrum))
    assert mistakes_in_lines(SHAKEN, other, spectrum) == ()
