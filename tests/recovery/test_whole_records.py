"""Whole records of any excitation against the bound of all samples: error, stated error and coverage."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.identify import identify
from tests.record_draws import CASES, Case, draws, draws_of
from tests.whole_rigs import chain, record_of

EACH = 20


@pytest.mark.long
def test_whole_records_reach_the_bound_and_say_so() -> None:
    """8 cases of 20 draws, seeds (case, draw); errors of unknowns of one draw count as two independent ones.

    White cases: rms error over the bound 1 ± 3 / √(2 · 240) = ± 0.14.  Coverage of 320: 95 % ± 3 · 1.2 %.
    What is off by 5 % needs the 2,000 draws of `dev.py bench records`.
    """
    results = [(case, draws(case, EACH, seed)) for seed, case in enumerate(CASES)]
    white = np.array([done.rms_over_bound for case, done in results if not case.coloured])
    assert np.sqrt(np.mean(white**2)) == pytest.approx(1.0, abs=0.14)
    stated = np.array([done.rms_over_stated for _, done in results])
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(1.0, abs=0.12)
    held = np.concatenate([np.mean(done.held, axis=1) for _, done in results])
    assert np.mean(held) == pytest.approx(0.95, abs=0.036)


def test_the_stated_error_is_the_bound_of_all_samples() -> None:
    """One draw of a stepped sine: a stated sd is as sure as the size of the noise, one per cent."""
    done = draws(CASES[5], 1, 5)
    assert done.stated[0] == pytest.approx(done.bound, rel=0.04)


def test_a_base_that_ends_elsewhere_than_it_began_is_not_taken_for_noisy() -> None:
    """A part of a record in random motion, 0.3 % noise on the outputs, none on the base: two draws, seeds (3, draw).

    What its ends leak into all lines had counted as noise of the base: stated deviations were eleven times the bound.
    """
    test = Case(2, 0.05, "base", "random", 20).test()
    samples = len(test.record.time)
    part = slice(int(0.3 * samples), int(0.6 * samples))
    record = replace(test.record, time=test.record.time[part], values=test.record.values[part])
    done = draws_of(replace(test, record=record), 0.003, 2, 3)
    assert done.stated_over_bound == pytest.approx(1.0, abs=0.06)
    assert done.rms_over_bound < 1.8


@pytest.mark.long
def test_a_noisy_base_that_moves_at_all_frequencies() -> None:
    """Three storeys by accelerometers, 3 % noise on the base as well, whose spectrum shows none of it.

    Seeds (4, draw), 40 draws of seven unknowns, which count as two independent ones: rms error over the bound with the
    noise stated 1 ± 3 / √160, coverage 95 % ± 3 · 2.4 %.
    """
    model, theta = chain(3, 0.03, seed=4)
    sensor = Quantity.ACCELERATION
    test = record_of(
        model, theta, "random", decay_times=25, quantities=(sensor,), input_quantity=sensor, seed=4
    )
    sd = 0.03 * test.size
    clean = whole_record(test.record)
    known = np.broadcast_to(np.diag(4 * sd**2 / clean.samples[0]).astype(complex), clean.covariance.shape)
    bound = identify(model, replace(clean, covariance=known, noise=("given",) * clean.lines)).sd
    errors, stated, held = [], [], []
    for draw in range(40):
        lines = whole_record(test.noisy(np.random.default_rng([4, draw]), sd))
        found = identify(model, replace(lines, covariance=lines.covariance * np.array([1, 1, 1, 0])))
        errors.append((found.values - theta) / bound)
        stated.append(found.sd / bound)
        low, high = np.transpose([found[name].interval95 for name in found.names])
        held.append((low < theta) & (theta < high))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.24)
    assert np.mean(stated) == pytest.approx(1.0, abs=0.08)
    assert np.mean(held) == pytest.approx(0.95, abs=0.07)


@pytest.mark.long
def test_a_twentieth_of_the_samples_missing_in_ten_gaps() -> None:
    """Rows lost, noise on all channels unknown, 16 draws of five values: the record stays whole, intervals hold.

    Of 80 numbers 70 to 80 are held at a coverage of 95 %, but for one case in 500; the seed is fixed.
    """
    model, theta = chain(2, 0.03, seed=2)
    test = record_of(model, theta, "random", decay_times=6, seed=2)
    samples, held, wider = len(test.record.time), 0, []
    gap = samples // 200
    for draw in range(16):
        rng = np.random.default_rng([77, draw])
        record = test.noisy(rng, 0.03 * test.size)
        gone = 2 * gap * (1 + rng.choice(samples // (2 * gap) - 2, 10, replace=False))[:, None] + np.arange(
            gap
        )
        keep = np.setdiff1d(np.arange(samples), gone)
        lines = spectrum([replace(record, time=record.time[keep], values=record.values[keep])])
        assert len(lines.records) == 1
        estimate, whole = (
            identify_with_noise(model, lines)[0],
            identify_with_noise(model, spectrum([record]))[0],
        )
        low, high = np.array([estimate[name].interval95 for name in estimate.names]).T
        held += int(np.sum((low <= theta) & (theta <= high)))
        wider.append(estimate.sd / whole.sd)
    assert held >= 70
    assert 1.0 < np.mean(wider) < 1.12  # the inputs, too, are unknown in the gaps: else 1.026
