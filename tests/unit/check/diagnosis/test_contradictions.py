"""Channels that contradict all others are told by what they show: a filter, a limit, two ranges, another point."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.check.diagnosis.diagnose import diagnose
from dashpot.data.spectrum import Spectrum
from dashpot.model.network import Model
from tests import rigs
from tests.mistakes import times


def clean() -> tuple[Model, Spectrum]:
    """Three coordinates, all seen as acceleration, 1 % noise; the second channel is the one that will be wrong."""
    rng = np.random.default_rng(5)
    rig = rigs.plain_rig(np.random.default_rng(11), 3)
    channels = rigs.channels(rig, (Quantity.ACCELERATION,))
    return rig.model, rigs.noisy(rig, channels, rigs.covariance(rig, channels, 0.01, inputs=0.01), rng)


def filtered(f: Real, y: Complex) -> Complex:
    corner = 0.7 * np.max(f)
    s = 1j * f / corner
    return 1 / (1 + np.sqrt(2) * s + s**2)


def coupled(f: Real, y: Complex) -> Complex:
    return 1 / (1 + 0.5 * np.min(f) / (1j * f))


def limited(f: Real, y: Complex) -> Complex:
    part = np.minimum(0.4 * np.max(np.abs(y)) / np.abs(y), 1.0)
    return (2 / np.pi * (np.arcsin(part) + part * np.sqrt(1 - part**2))).astype(complex)


def in_two(f: Real, y: Complex) -> Complex:
    return np.where(np.arange(len(f)) < 12, 1.0, 1.25).astype(complex)


@pytest.mark.parametrize(
    ("change", "words", "truth"),
    [
        (filtered, "it reads as through a low-pass filter of about", lambda f, y: 0.7 * np.max(f)),
        (coupled, "it reads as through a high-pass filter of about", lambda f, y: 0.5 * np.min(f)),
        (limited, "as if it ended at", lambda f, y: 0.4 * np.max(np.abs(y))),
        (in_two, "it reads", lambda f, y: 1.25),
    ],
)
def test_what_a_channel_goes_through_is_told(
    change: Callable[[Real, Complex], Complex], words: str, truth: Callable[[Real, Complex], float]
) -> None:
    model, spectrum = clean()
    f, y = spectrum.frequency_hz, spectrum.amplitudes[:, 1]
    first = diagnose(model, times(spectrum, 1, change(f, y)))[0]
    assert (first.kind, first.of) == ("channel", ("a_x2",))
    if change is in_two:
        assert f"from {f[12]:g} Hz on as before" in first.text
    number = float(first.text.split(words)[1].split()[0])
    assert number == pytest.approx(truth(f, y), rel=0.1)


def test_a_sensor_at_another_point_than_stated_is_moved_there() -> None:
    """Stated at a point that another sensor has, it leaves its own unseen."""
    model, spectrum = clean()
    channels = tuple(replace(c, of={"x3": 1.0}) if c.name == "a_x2" else c for c in spectrum.channels)
    first = diagnose(model, replace(spectrum, channels=channels))[0]
    assert (first.kind, first.of) == ("channel", ("a_x2",))
    assert first.text.endswith("it shows what the rig does at x2: is it mounted there?")
    assert first.channels[0].of == {"x2": 1.0}
    assert first.change.startswith('[channels] a_x2 = { of = "x2"')


def test_a_channel_of_nothing_but_noise_is_given_no_reason() -> None:
    model, spectrum = clean()
    rng = np.random.default_rng(1)
    Y = spectrum.amplitudes.copy()
    Y[:, 1] = np.std(Y[:, 1]) * (rng.standard_normal(len(Y)) + 1j * rng.standard_normal(len(Y)))
    first = diagnose(model, replace(spectrum, amplitudes=Y))[0]
    assert (first.kind, first.of) == ("channel", ("a_x2",))
    assert first.text.endswith("for no simple reason")


def test_two_channels_that_are_wrong_at_once_are_named_together_with_both_lines() -> None:
    model, spectrum = clean()
    first = diagnose(model, times(times(spectrum, 0, -1.0), 2, 1 / 9.80665))[0]
    assert (first.kind, first.of) == ("two", ("a_x1", "a_x3"))
    assert [(channel.name, channel.sign, channel.unit) for channel in first.channels] == [
        ("a_x1", -1.0, ""),
        ("a_x3", 1.0, "g"),
    ]


@pytest.mark.parametrize(("unit", "scale"), [("lb", 0.45359237), ("g", 1e-3)])
def test_a_stated_value_in_another_unit_is_named_with_it_before_others_that_explain_alike(
    unit: str, scale: float
) -> None:
    """With one mass and one spring known either may be off: all others scale with it."""
    rig = rigs.paper_rig()
    m2 = float(rig.p[[e.name for e in rig.model.elements].index("m2")])
    known = rig.knowing({"m2": {"value": round(m2 / scale, 6)}, "k2": {"value": None}})
    channels = rigs.channels(rig)
    spectrum = rigs.noisy(
        rig, channels, rigs.covariance(rig, channels, 0.01, inputs=0.01), np.random.default_rng(2)
    )
    first = diagnose(known.model, spectrum)[0]
    assert (first.kind, first.of) == ("value", ("m2",))
    assert first.text.endswith(f": {m2 / scale:g} {unit}?")
    assert first.elements[0].value == pytest.approx(m2, rel=1e-6)
