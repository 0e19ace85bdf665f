"""Plain mistakes of channels in whole records of nonlinear rigs are named at once, sound channels left alone."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.decays_and_stands import decay
from dashpot.api import identify
from dashpot.channel import Channel, Quantity
from dashpot.check.explain.record_channels import channel_mistakes, require_sound_channels
from dashpot.data.record import MISSING, Record
from dashpot.errors import DataError
from dashpot.estimate.assessment import Finding
from dashpot.model.network import Model
from tests.nonlinear_rigs import guessed, motions
from tests.unit.estimate.nonlinear.test_whole_record import chaotic, record

SEEN = (*motions("x1", "x2"), Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION), *motions("u"))
IN_PART = (*motions("x2"), Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION), *motions("u"))


def times(data: Record, name: str, factor: float) -> Record:
    """The record with one channel times a factor."""
    factors = [factor if channel.name == name else 1.0 for channel in data.channels]
    return replace(data, values=data.values * np.array(factors))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "name", "factor", "kind", "line"),
    [
        ("cubic", "a1", -1.0, "sign", "sign = -1"),
        ("coulomb", "x1", -1.0, "sign", "sign = -1"),
        ("cubic", "x2", 1e3, "unit", '"mm"'),
        ("coulomb", "a1", 1 / 9.80665, "unit", '"g"'),
        ("cubic", "u", -1.0, "sign", "sign = -1"),
    ],
)
def test_a_wrong_sign_or_unit_is_named_first(
    law: str, name: str, factor: float, kind: str, line: str
) -> None:
    model, _, data = record(law, SEEN, noise=0.01)
    first = channel_mistakes(model, times(data, name, factor))[0]
    assert (first.kind, first.of) == (kind, (name,))
    assert line in first.change
    assert first.channels[0].name == name


def test_exchanged_channels_are_named_first() -> None:
    model, _, data = record("cubic", SEEN, noise=0.01)
    first = channel_mistakes(model, replace(data, values=data.values[:, [1, 0, 2, 3]]))[0]
    assert (first.kind, first.of) == ("swap", ("x1", "x2"))


@pytest.mark.parametrize(("name", "factor"), [("a1", -1.0), ("x2", 1e3), ("u", -1.0)])
def test_where_a_coordinate_is_not_seen_the_motion_of_the_guesses_tells(name: str, factor: float) -> None:
    model, theta, data = record("cubic", IN_PART, noise=0.01)
    near = guessed(model, theta, 1.05)
    assert channel_mistakes(near, data) == ()
    assert channel_mistakes(near, times(data, name, factor))[0].of == (name,)


def test_of_two_motions_either_may_be_turned_and_the_output_is_named_first() -> None:
    model, _, data = chaotic(250)
    assert channel_mistakes(model, data) == ()
    named = channel_mistakes(model, times(data, "f", -1.0))
    assert [(each.kind, each.of) for each in named] == [("sign", ("x",)), ("sign", ("f",))]


def test_an_identification_ends_at_once_with_the_line_to_write() -> None:
    """It had gone on for minutes, to an end that said nothing."""
    model, _, data = record("cubic", SEEN, noise=0.01)
    with pytest.raises(DataError) as caught:
        identify(model, [times(data, "a1", -1.0)])
    contradiction, cause = caught.value.problems
    assert "inconsistent" in contradiction.what
    assert cause.what.startswith("a likely cause: a1 ")
    assert cause.cure is not None
    assert "sign = -1.0" in cause.cure


@pytest.mark.long
def test_a_channel_that_is_wrong_in_one_of_several_records_is_named_with_that_record() -> None:
    """Turned when the sensor was mounted again: only the first record was looked at."""
    model, _, data = record("cubic", SEEN, noise=0.01)
    second = replace(record("cubic", SEEN, noise=0.01, seed=5)[2], source="run2.csv")
    with pytest.raises(DataError) as caught:
        identify(model, [data, times(second, "a1", -1.0)])
    contradiction, cause = caught.value.problems[:2]
    assert contradiction.where == "run2.csv"
    assert cause.what.startswith("a likely cause: in this record, a1 ")
    assert cause.cure == "multiply a1 by −1 in run2.csv, or leave it out"
    assert caught.value.causes == ()  # no line of the rig file is right for both
    swapped = replace(second, values=second.values[:, [1, 0, 2, 3]])
    with pytest.raises(DataError, match=r"exchange x1 and x2 in run2\.csv"):
        require_sound_channels(model, [data, swapped])


@pytest.mark.slow
def test_a_channel_that_is_wrong_in_all_records_is_mended_in_the_rig_file() -> None:
    model, _, data = record("cubic", SEEN, noise=0.01)
    second = record("cubic", SEEN, noise=0.01, seed=5)[2]
    with pytest.raises(DataError) as caught:
        require_sound_channels(model, [times(each, "a1", -1.0) for each in (data, second)])
    assert "sign = -1.0" in str(caught.value)
    assert isinstance(caught.value.causes[0], Finding)
    assert caught.value.causes[0].channels[0].sign == -1.0


@pytest.mark.parametrize("law", ["cubic", "coulomb", "backlash"])
def test_sound_channels_are_left_alone_under_noise_whatever_the_law(law: str) -> None:
    """A tenth of each channel is noise; an accelerometer that hangs shows its weight."""
    model, _, data = record(law, SEEN, noise=0.1)
    weighed = replace(data, values=data.values + np.array([0.0, 0.0, 9.81, 0.0]))
    assert channel_mistakes(model, weighed) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "count"), [(903, 4), (6006, 6)])
def test_hysteresis_that_smooth_laws_do_not_describe_is_no_mistake_of_a_channel(
    seed: int, count: int
) -> None:
    """Free decays: smooth laws in its place fitted best beside a mass below zero, and any unit mended that."""
    drawn = decay("bouc-wen", count, np.random.default_rng((seed, count)))
    assert isinstance(drawn.data, dict)
    time, *seen = drawn.data.values()
    data = Record(drawn.rig.channels, time, np.column_stack(seen))
    assert channel_mistakes(drawn.rig.model, data) == ()


@pytest.mark.slow
def test_another_rig_than_the_stated_one_is_no_mistake_of_a_channel() -> None:
    """A spring that is missing, and a mass that is stated at half its value, are for the fit to tell."""
    model, theta, data = record("cubic", SEEN, noise=0.01)
    for elements in (
        tuple(e for e in model.elements if e.name != "k1"),
        tuple(replace(e, value=1.35) if e.name == "m2" else e for e in model.elements),
    ):
        other: Model = replace(model, elements=elements)
        assert channel_mistakes(other, data) == ()
    assert channel_mistakes(guessed(model, theta, 2.0), data) == ()


def test_a_sample_that_is_missed_late_in_a_long_record_is_no_mistake_of_a_channel() -> None:
    """Seen by an acceleration alone, which is laid beside the motion of the guesses: 1,000 samples of it."""
    channels = (Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION), Channel("u", {"u": 1.0}))
    model, theta, data = record("cubic", channels, noise=0.01, samples=1200)
    status = np.zeros(data.values.shape, dtype=np.int64)
    status[[300, 1100], 0] = MISSING
    assert channel_mistakes(guessed(model, theta, 1.0), replace(data, status=status)) == ()
