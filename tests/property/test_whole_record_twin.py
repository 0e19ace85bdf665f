"""Whole records against the truth without noise, and against a slow likelihood of all samples in time with it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import MISSING, Record
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from tests.whole_rigs import WholeTest, chain, record_of, twin


def sizes(test: WholeTest, share: float) -> Real:
    """Noise of the outputs in parts of their size, none on the inputs."""
    sd = share * test.size
    sd[len(sd) - len(test.model.inputs) :] = 0
    return sd


def estimated(test: WholeTest, record: Record, sd: Real, *, all_lines: bool = False) -> Estimate:
    """By the whole record, the noise being known; its band is found, or `all_lines` are used."""
    highest = 0.98 / (2 * (record.time[1] - record.time[0]))
    lines = whole_record(record, band_hz=(0.0, highest) if all_lines else None)
    V = np.broadcast_to(np.diag(4 * sd**2 / len(record.time)).astype(complex), lines.covariance.shape)
    known = replace(lines, covariance=V, noise=("given",) * lines.lines, dof=np.full(lines.lines, np.inf))
    return identify(test.model, known, "ml")


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize(
    ("kind", "force", "moving"),
    [
        ("none", False, True),  # a free decay starts from motion, and nothing drives it
        *product(("random", "sweep", "hammer", "earthquake"), (False, True), (False, True)),
    ],
)
def test_noise_free_records_give_the_truth(n: int, kind: str, force: bool, moving: bool) -> None:
    model, theta = chain(n, 0.02, force=force, base=not force and kind != "none", seed=n)
    quantity = Quantity.ACCELERATION if n % 2 else Quantity.DISPLACEMENT
    test = record_of(model, theta, kind, moving=moving, quantities=(quantity,), seed=n)
    estimate = estimated(test, test.record, sizes(test, 0.05))
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < 5e-4


@pytest.mark.long
@pytest.mark.parametrize("kind", ["random", "sweep", "hammer", "none", "earthquake"])
def test_noise_free_records_of_larger_rigs(kind: str) -> None:
    test_noise_free_records_give_the_truth(6, kind, kind in ("sweep", "hammer"), True)


@pytest.mark.long
def test_a_coordinate_that_is_not_seen() -> None:
    model, theta = chain(4, 0.03, seed=4)
    guessed = replace(
        model,
        elements=tuple(
            element if element.value is not None else replace(element, guess=1.1 * true)
            for element, true in zip(model.elements, model.parameters(theta), strict=True)
        ),
    )
    test = record_of(
        guessed,
        theta,
        "random",
        quantities=(Quantity.VELOCITY, Quantity.DISPLACEMENT),
        seen=("x1", "x2", "x4"),
        seed=4,
    )
    estimate = estimated(test, test.record, sizes(test, 0.02))
    assert np.max(np.abs(estimate.values / theta - 1)) < 5e-4


@pytest.mark.long
@pytest.mark.parametrize("kind", ["random", "none", "hammer", "sweep", "earthquake"])
def test_the_twin_in_time_agrees(kind: str) -> None:
    # Sampled 20 times faster than the highest mode, inputs exact, the starting state unknown to both.
    model, theta = chain(
        2, 0.03, force=kind in ("hammer", "sweep"), base=kind in ("random", "earthquake"), seed=2
    )
    test = record_of(model, theta, kind, decay_times=6, seed=2)
    sd = sizes(test, 0.05)
    clean, best = estimated(test, test.record, sd, all_lines=True), twin(test, test.record, sd, theta)
    assert np.max(np.abs(clean.values - best.theta) / clean.sd) < 0.01
    rng = np.random.default_rng(6)
    away = []
    for _ in range(6):
        record = test.noisy(rng, sd)
        found = estimated(test, record, sd, all_lines=True)
        slow = twin(test, record, sd, theta)
        spread = np.sqrt(np.diagonal(slow.covariance))
        away.append((found.values - slow.theta) / spread)
        np.testing.assert_allclose(found.sd, spread, rtol=0.002)
    assert np.sqrt(np.mean(np.square(away))) < 0.1


@pytest.mark.long
def test_the_twin_in_time_agrees_where_samples_are_missing() -> None:
    """A twentieth of each channel in ten gaps: the same answers and intervals as of the samples that are there."""
    model, theta = chain(2, 0.03, seed=2)
    test = record_of(model, theta, "random", decay_times=6, seed=2)
    sd, rng = sizes(test, 0.05), np.random.default_rng(3)
    samples = len(test.record.time)
    gap, away, off = samples // 200, [], []
    for _ in range(8):
        record = test.noisy(rng, sd)
        status = np.zeros(record.values.shape, dtype=np.int64)
        for c in range(2):
            for begin in 2 * gap * (1 + rng.choice(samples // (2 * gap) - 2, 10, replace=False)):
                status[begin : begin + gap, c] = MISSING
        found = estimated(
            test, replace(record, values=np.where(status, 0.0, record.values), status=status), sd
        )
        slow = twin(test, record, sd, theta, status == 0)
        spread = np.sqrt(np.diagonal(slow.covariance))
        away.append((found.values - slow.theta) / spread)
        off.append((slow.theta - theta) / spread)
        np.testing.assert_allclose(found.sd, spread, rtol=0.01)
    assert np.sqrt(np.mean(np.square(away))) < 0.15 * np.sqrt(np.mean(np.square(off)))
