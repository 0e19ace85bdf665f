"""Tests that wait for nothing: their motion, their information, and what the planner says of waiting."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.design.advise import Answer, Question, answer
from dashpot.design.allocation import Criterion
from dashpot.design.plan import lines_of_dwells, unsettled_dwells
from dashpot.design.test_setup import Schedule
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.present.design import plan_in_words
from tests.designs import AMPLITUDE, RATE, advised, light_setup


def last_words(said: Answer) -> str:
    assert said.plan is not None
    return plan_in_words(said, said.plan)[-1]


@pytest.mark.slow
def test_the_motion_goes_on_from_dwell_to_dwell_and_settles() -> None:
    own = light_setup(2e-3, 0.0, zeta=0.1)
    drive = np.full((2, 1), AMPLITUDE, dtype=complex)
    f = np.array([5.0, 9.0])
    first, second = unsettled_dwells(own.model, own.p[0], own.channels, f, drive, [600, 600], [1 / RATE] * 2)
    assert np.all(np.abs(first.values[0]) < 1e-12)  # from rest
    steps = np.abs(np.diff(np.vstack([first.values[-20:], second.values[:20]]), axis=0))
    assert np.max(steps[19]) < 2 * np.max(steps)  # no jump between them
    lines = spectrum([first, second], settle="auto", transients="settle")
    steady = own.seen(f, np.zeros(2, dtype=np.int64)).Y
    relative = lines.amplitudes[:, :2] / lines.amplitudes[:, 2:]
    assert relative == pytest.approx(steady[:, :2] / steady[:, 2:], rel=2e-3)


def test_long_dwells_tell_what_settled_ones_tell() -> None:
    """150 decay times each: the transient of one, and the loads, are some per cent of them."""
    own = light_setup(2e-3, 0.0, zeta=0.1)
    f, drive = np.array([6.0, 15.0]), np.full((2, 1), AMPLITUDE, dtype=complex)
    samples = 6000
    records = unsettled_dwells(own.model, own.p[0], own.channels, f, drive, [samples] * 2, [1 / RATE] * 2)
    lines = lines_of_dwells(records, own.channels, joined=False)
    whole = identify(own.model, lines, MaximumLikelihood(start=tuple(own.theta[0].tolist())))
    settled = Schedule(f, np.zeros(2, dtype=np.int64), np.full(2, float(samples))).information(own)[0]
    sd = np.sqrt(np.diagonal(np.linalg.inv(settled))) * own.sizes[0]
    assert whole.bound_sd == pytest.approx(sd, rel=0.03)


@pytest.mark.slow
def test_waiting_is_called_a_waste_where_it_is() -> None:
    own = light_setup(2e-3, 0.0)
    waits = advised(own, settle=own.settling() / 2)
    assert waits.unsettled.joined
    assert waits.unsettled.predicted.figure < 0.9 * waits.plan.predicted.figure
    kept = (waits.unsettled.predicted.figure / waits.plan.predicted.figure) ** 2
    assert waits.unsettled.thrown_away == pytest.approx(1 - kept)
    assert "Do not wait for steady state" in last_words(waits)
    assert "No dwell waits" in last_words(advised(own, settle=0.0))
    heavy = light_setup(2e-3, 0.0, zeta=0.2)
    assert "Waiting for steady state costs little" in last_words(advised(heavy, settle=0.1))


def test_nothing_is_said_of_rigs_without_a_motion_in_time() -> None:
    own = light_setup(2e-3, 0.0)
    question = Question(
        model=own.model,
        channels=own.channels,
        criterion=Criterion("A"),
        band=(3.0, 20.0),
        samples=2000,
        values=dict(zip(own.model.unknown_names, own.theta[0].tolist(), strict=True)),
        amplitude=AMPLITUDE,
    )
    assert answer(question).unsettled is None  # no sampling rate
