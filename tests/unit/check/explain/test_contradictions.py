"""Channels that contradict all others are told by what they show: a filter, a limit, two ranges, another point."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.check.explain.examine import diagnose
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "kind", "truth"),
    [
        (filtered, "filter", lambda f, y: 0.7 * np.max(f)),
        pytest.param(coupled, "filter", lambda f, y: 0.5 * np.min(f), marks=pytest.mark.long),
        pytest.param(limited, "saturation", lambda f, y: 0.4 * np.max(np.abs(y)), marks=pytest.mark.long),
        (in_two, "gain", lambda f, y: 1.25),
    ],
)
def test_what_a_channel_goes_through_is_told(
    change: Callable[[Real, Complex], Complex], kind: str, truth: Callable[[Real, Complex], float]
) -> None:
    model, spectrum = clean()
    f, y = spectrum.frequency_hz, spectrum.amplitudes[:, 1]
    first = diagnose(model, times(spectrum, 1, change(f, y)))[0]
    assert (first.kind, first.of) == (kind, ("a_x2",))
    if change is in_two:
        assert f"from {f[12]:g} Hz" in first.text
    assert first.number == pytest.approx(truth(f, y), rel=0.1)


@pytest.mark.slow
def test_a_sensor_at_another_point_than_stated_is_moved_there() -> None:
    """Stated at a point that another sensor has, it leaves its own unseen."""
    model, spectrum = clean()
    channels = tuple(replace(c, of={"x3": 1.0}) if c.name == "a_x2" else c for c in spectrum.channels)
    first = diagnose(model, replace(spectrum, channels=channels))[0]
    assert (first.kind, first.of) == ("place", ("a_x2",))
    assert [dict(channel.of) for channel in first.channels] == [{"x2": 1.0}]


@pytest.mark.long
def test_a_sensor_between_two_points_shows_a_part_of_either() -> None:
    model, spectrum = clean()
    channels = tuple(
        replace(c, of={"x2": 0.7, "x3": 0.3}) if c.name == "a_x2" else c for c in spectrum.channels
    )
    rig = replace(rigs.plain_rig(np.random.default_rng(11), 3))
    seen = rigs.noisy(
        rig, channels, rigs.covariance(rig, channels, 0.01, inputs=0.01), np.random.default_rng(5)
    )
    first = diagnose(model, replace(seen, channels=spectrum.channels))[0]
    assert (first.kind, first.of) == ("place", ("a_x2",))
    assert dict(first.channels[0].of)["x3"] == pytest.approx(0.3, abs=0.03)
