"""Samples lost under even time stamps are named with their moment, in records of any excitation; misfits are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from tests.unit.data.conditioning.test_transients import MODEL, stepped
from tests.whole_rigs import WholeTest, chain, record_of


def test_of(excitation: str) -> WholeTest:
    """A record of two masses, 20 decay times of the slower mode, on a base that moves or pushed by a force."""
    pushed = excitation in ("sweep", "hammer")
    model, theta = chain(2, 0.03, base=not pushed, force=pushed, seed=2)
    return record_of(model, theta, excitation, decay_times=20, seed=1)


test_of.__test__ = False  # type: ignore[attr-defined]


def without(record: Record, count: int) -> Record:
    """The record with samples missing beyond its middle, its stamps even all the same."""
    first = int(0.52 * len(record.time))
    values = np.delete(record.values, slice(first, first + count), axis=0)
    return replace(record, time=record.time[: len(values)], values=values)


def jumps(estimate: Estimate) -> list[str]:
    return [notice.text for notice in estimate.warnings if notice.code == "residual_jump"]


@pytest.mark.parametrize("excitation", ["random", "earthquake", "hammer"])
def test_lost_samples_are_named(excitation: str) -> None:
    """One of 5,000 samples, 3 % noise: each block of 48 errs once in 5e7."""
    test = test_of(excitation)
    noisy = test.noisy(np.random.default_rng(1), 0.03 * test.size * [1, 1, 0])
    assert jumps(identify(test.model, spectrum([noisy]))) == []
    (said,) = jumps(identify(test.model, spectrum([without(noisy, 1)])))
    at = float(said.split("near ")[1].split(" s ")[0])
    assert at == pytest.approx(0.52 * noisy.time[-1], abs=noisy.time[-1] / 40)


def test_a_rig_that_does_not_fit_does_not_jump() -> None:
    """The second sensor shows 10 % more than there is: the residual is loud where the motion is."""
    test = test_of("earthquake")
    noisy = test.noisy(np.random.default_rng(1), 0.01 * test.size * [1, 1, 0])
    wrong = replace(
        noisy, values=noisy.values * [1, 1.1, 1] + 0.3 * noisy.values**3 / np.max(noisy.values**2, axis=0)
    )
    estimate = identify(test.model, spectrum([wrong]))
    assert jumps(estimate) == []


def test_samples_lost_in_a_dwell_are_named() -> None:
    records = stepped(0.02, periods=30, settle=4.0)
    lost = [*records[:2], without(records[2], 4), *records[3:]]
    assert jumps(identify(MODEL, spectrum(records))) == []
    assert len(jumps(identify(MODEL, spectrum(lost)))) == 1
