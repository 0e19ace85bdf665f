"""Which dwells are records with transients, and which blocks belong to one record."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.conditioning.steadiness import BENT, UNSETTLED, transients_show
from dashpot.data.conditioning.whole_record import continuous
from dashpot.data.readers import Reading
from dashpot.data.record import Record
from dashpot.data.spectrum import SettledDwell, WholeRecord
from dashpot.estimate.identify import conditioning_for, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.instrumental_variables import OptimalIV
from tests.whole_rigs import chain, record_of, stepped_sine

MODEL, THETA = chain(2, 0.08, seed=1)
CHANNELS = record_of(MODEL, THETA, "random", decay_times=0.1).record.channels
FREQUENCIES = (4.0, 6.0, 9.0, 13.0, 18.0)


def stepped(noise: float, *, periods: float = 5, settle: float = 0.0, seed: int = 0) -> list[Record]:
    """Dwells of 20 samples a period, each from the state that the last one left, clocks restarted."""
    return stepped_sine(MODEL, THETA, CHANNELS, FREQUENCIES, noise, periods=periods, settle=settle, seed=seed)


@pytest.mark.slow
def test_transients_are_found_and_nothing_where_none_are() -> None:
    assert transients_show(stepped(0.01)) < 1e-6
    assert transients_show(stepped(0.05)) < 1e-3
    p = [transients_show(stepped(0.05, settle=4.0, seed=k)) for k in range(40)]
    assert min(p) > 1e-3
    assert np.mean(p) == pytest.approx(0.5, abs=0.19)  # 4 sd of 40 uniform numbers


@pytest.mark.parametrize("periods", [2.2, 3.6, 6.2])
def test_a_transient_within_the_first_period_of_one_dwell_is_no_noise_of_it(periods: float) -> None:
    """One mass at rest, damped by 16 %: what a sine leaves of the first period had counted as noise on both sides.

    Of 40 settled dwells each none is a record, p = 0.001 each.
    """
    model, theta = chain(1, 0.08, seed=1)
    channels = record_of(model, theta, "random", decay_times=0.1).record.channels

    def one(noise: float, settle: float, seed: int) -> list[Record]:
        return stepped_sine(model, theta, channels, (6.5,), noise, periods=periods, settle=settle, seed=seed)

    assert all(UNSETTLED.shows(one(0.01, 0.0, seed)) for seed in range(5))
    assert not any(UNSETTLED.shows(one(0.05, 4.0, seed)) for seed in range(40))
    estimate = identify(model, spectrum(one(0.005, 0.0, 0)))
    assert np.all(np.abs(estimate.values / theta - 1) < 0.05)


def test_unsettled_dwells_become_records() -> None:
    lines = spectrum(stepped(0.01))
    assert len(lines.records) == len(FREQUENCIES)
    assert all(isinstance(value, WholeRecord) and value.polynomial == 2 for value in lines.stretches)
    assert "5 dwells are not settled" in lines.notes[-1].text
    settled = spectrum(stepped(0.05, settle=4.0))
    assert settled.stretches == (SettledDwell(),)
    assert settled.lines == len(FREQUENCIES)
    assert spectrum(stepped(0.01), transients="none").lines == len(FREQUENCIES)
    assert len(spectrum(stepped(0.05, settle=4.0), transients="estimate").records) == len(FREQUENCIES)


def test_dwells_too_short_to_compare_their_periods_show_transients_too() -> None:
    periods = 1.4
    assert BENT.shows(stepped(0.01, periods=periods))
    assert not any(BENT.shows(stepped(0.05, periods=periods, settle=4.0, seed=k)) for k in range(8))
    estimate = identify(MODEL, spectrum(stepped(0.01, periods=periods)))
    assert np.all(np.abs(estimate.values - THETA) < 4 * estimate.sd)
    # One dwell of many that is odd does not turn all others into records.
    some = [*stepped(0.01, periods=5, settle=4.0), *stepped(0.01, periods=5, settle=4.0, seed=9)]
    odd = stepped(0.01, periods=periods)[0]
    assert not BENT.shows([odd, *some])


def test_slopes_of_unsettled_dwells_spoil_nothing() -> None:
    drifting = []
    for k, record in enumerate(stepped(0.01, periods=1.5)):
        slopes = 0.2 * np.std(record.values, axis=0) * np.random.default_rng(k).normal(size=3)
        line = np.linspace(-1, 1, len(record.time))[:, None]
        drifting.append(replace(record, values=record.values + slopes * line))
    spoilt, mended = (identify(MODEL, spectrum(drifting, drift=degree)) for degree in (0, "auto"))
    assert np.max(np.abs(spoilt.values - THETA) / spoilt.sd) > 5
    assert np.all(np.abs(mended.values - THETA) < 4 * mended.sd)


def test_what_is_asked_of_a_steady_state_keeps_dwells() -> None:
    records = stepped(0.01)
    for how in ({"settle": "auto"}, {"refine": "always"}, {"moments": True}, {"orders": (1, 3)}):
        assert not spectrum(records, **how).records  # type: ignore[arg-type]


def test_blocks_that_follow_in_time_are_one_record() -> None:
    step = 0.01
    blocks = [
        Record(
            CHANNELS,
            step * np.arange(k * 100, (k + 1) * 100),
            np.random.default_rng(k).normal(size=(100, 3)),
            f,
        )
        for k, f in enumerate((4.0, 5.0, 6.0))
    ]
    (one,) = continuous(blocks)
    assert one.frequency_hz is None
    assert len(one.time) == 300
    late = replace(blocks[2], time=blocks[2].time + 0.006)
    assert [len(record.time) for record in continuous([*blocks[:2], late])] == [200, 100]
    other = replace(blocks[1], experiment=1)
    assert len(continuous([blocks[0], other])) == 2


def test_what_hardly_reaches_a_long_dwell_leaves_it_settled() -> None:
    records = []
    for record in stepped(0.0, periods=30, settle=20.0):
        rng = np.random.default_rng(1)
        slight = (
            0.02 * np.exp(-record.time * (record.frequency_hz or 1.0))[:, None]
        )  # gone after a period or two
        size = np.std(record.values, axis=0)
        values = record.values * (1 + slight) + 1e-3 * size * rng.normal(size=record.values.shape)
        records.append(replace(record, values=values))
    assert transients_show(records) < 1e-3
    assert not UNSETTLED.shows(records)
    assert not spectrum(records).records
    assert UNSETTLED.shows(stepped(0.01, periods=30))


def test_what_builds_up_slowly_is_used_from_its_start() -> None:
    """Where a resonance builds up for half of the dwell, that half looked as if it were not driven, and was cut off."""
    rng = np.random.default_rng(5)
    records = []
    for record in stepped(0.0, periods=20):
        time = record.time - record.time[0]
        values = np.array(record.values)
        values[:, 0] *= 1 - np.exp(-4 * time / time[-1])
        values += 1e-3 * np.max(np.abs(values), axis=0) * rng.normal(size=values.shape)
        records.append(replace(record, values=values))
    lines = spectrum(records)
    assert [notice.code for notice in lines.notes] == ["dwells_with_transients"]
    samples = [shared.samples for shared in lines.stretches if isinstance(shared, WholeRecord)]
    assert samples == [len(record.time) for record in records]


def test_methods_that_know_no_transients_get_what_has_settled() -> None:
    """Taken as settled, a whole dwell gave dampers that were wrong by several deviations, with a fit."""
    records = stepped(0.002, periods=30)
    reading = Reading(tuple(records), None, ())
    settings = conditioning_for(MODEL, reading, Conditioning(), [OptimalIV.traits])
    lines = spectrum(records, settings)
    assert {"transient_discarded"} <= {notice.code for notice in lines.notes}
    estimate = identify(MODEL, lines, OptimalIV())
    assert np.all(np.abs(estimate.values - THETA) < 4 * estimate.sd)
    settled = spectrum(stepped(0.05, settle=4.0), settings)
    assert "transient_discarded" not in {notice.code for notice in settled.notes}
    whole = conditioning_for(MODEL, reading, Conditioning(), [MaximumLikelihood.traits])
    assert whole.transients == "auto"
    stated = conditioning_for(MODEL, reading, Conditioning(transients="none"), [OptimalIV.traits])
    assert stated.transients == "none"
