"""What one channel shows in a whole record in the place of what the others say of it, by form."""

from collections.abc import Callable

import numpy as np
import pytest

from dashpot.arrays import Complex, Real
from dashpot.check.diagnosis.channel_changes import ComparedLines, contradiction_in_record
from dashpot.check.diagnosis.contradictions import Contradiction
from dashpot.check.diagnosis.trials import Likeness
from dashpot.data.spectrum import history_of_lines

LINES, DURATION = 400, 20.0
ORDER = np.arange(1, LINES + 1)
F = ORDER / DURATION
TIME = np.linspace(0, 1, 2 * (LINES + 1), endpoint=False)


def expected(seed: int) -> Complex:
    """A motion with two resonances, 1 m at its largest."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(LINES) + 1j * rng.standard_normal(LINES)
    response = sum(1 / (1 - (F / f) ** 2 + 0.04j * F / f) for f in (3.0, 8.0))
    lines = response * noise
    return np.asarray(lines / np.max(np.abs(history_of_lines(lines, ORDER, len(TIME)))))


def of_history(history: Real) -> Complex:
    """The lines of a history."""
    return 2 / len(history) * np.fft.rfft(history)[ORDER]


def form(y: Complex, e: Complex, seed: int) -> Likeness | Contradiction | None:
    """What is said of lines with 1 % noise."""
    rng = np.random.default_rng([seed, 1])
    size = 0.01 * np.sqrt(np.mean(np.abs(e) ** 2) / 2)
    noise = size * (rng.standard_normal(LINES) + 1j * rng.standard_normal(LINES))
    return contradiction_in_record(ComparedLines(y + noise, e, F, ORDER, DURATION), "m")


SHAPES: dict[str, tuple[Callable[[Real], Real], str]] = {
    "clipped": (lambda x: np.clip(x, -0.5, 0.5), "clipped, or saturated"),
    "clipped on one side": (lambda x: np.minimum(x, 0.4), "clipped, or saturated"),
    "saturated": (lambda x: 0.8 * np.tanh(x / 0.8), "clipped, or saturated"),
    "drift": (lambda x: x + 0.7 * (3 * TIME**2 - 1.2 * TIME), "a zero that drifts"),
    "another zero": (lambda x: x + 0.2 * (TIME > 0.3), "a zero that steps by"),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", SHAPES)
def test_the_shape_of_a_channel_in_time_is_named(name: str, seed: int) -> None:
    """Only "for no simple reason" was said."""
    shape, words = SHAPES[name]
    e = expected(seed)
    shown = form(of_history(shape(history_of_lines(e, ORDER, len(TIME)))), e, seed)
    assert isinstance(shown, Contradiction)
    assert words in shown.text


@pytest.mark.parametrize(
    ("factor", "kind"),
    [
        (-1.0, "sign"), (1000.0, "unit"), (1 / 9.80665, "unit"), (1.3, "gain"),
        (np.exp(-2j * np.pi * F * 0.02), "delay"), (2j * np.pi * F, "quantity"),
    ],
)  # fmt: skip
def test_what_a_channel_is_times_the_motion_is_named(factor: complex | Complex, kind: str) -> None:
    e = expected(0)
    shown = form(factor * e, e, 0)
    assert isinstance(shown, Likeness)
    assert shown.kind == kind
    if kind == "unit":
        assert shown.number == pytest.approx(float(np.real(factor)), rel=1e-9)


def test_a_filter_is_named_and_noise_is_not() -> None:
    e = expected(1)
    s = 2j * np.pi * F
    through = form(s / (s + 2 * np.pi * 1.5) * e, e, 1)
    assert isinstance(through, Contradiction)
    assert "a high-pass filter of about 1.5 Hz" in through.text
    rng = np.random.default_rng(7)
    for seed in range(40):
        e = expected(seed)
        power = np.mean(np.abs(e) ** 2) / 2
        noise = 0.2 * np.sqrt(power) * (rng.standard_normal(LINES) + 1j * rng.standard_normal(LINES))
        assert form(e + noise, e, seed) is None
