"""Which part of a dwell stands behind its lines."""

from dataclasses import replace

import numpy as np

from dashpot import Record, concatenate
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum, used_dwells
from dashpot.data.conditioning.settings import Conditioning

AS_TOLD = Conditioning(refine="none", transients="none", drift=0, noise="white", settle=1.0)


def dwell(f: float, orders: tuple[float, ...] = (1.0,)) -> Record:
    """Four seconds from 7 s on, with some noise."""
    time = 7.0 + np.arange(800) / 200
    rng = np.random.default_rng(int(10 * f))
    wave = sum(np.cos(2 * np.pi * k * f * time) / k for k in orders) + 1e-3 * rng.standard_normal(800)
    return Record((Channel("x", {"x": 1.0}),), time, wave[:, None], frequency_hz=f)


def test_each_dwell_has_its_lines_and_the_part_after_what_was_dropped() -> None:
    records = [dwell(2.0), dwell(3.0)]
    first, second = used_dwells(records, spectrum(records, AS_TOLD), AS_TOLD)
    assert (first.lines.tolist(), second.lines.tolist()) == ([0], [1])
    assert first.begin == 8.0
    assert first.end == records[0].time[-1]
    assert abs(second.discarded - 1 / 3.995) < 1e-9


def test_lines_of_one_fundamental_belong_to_one_dwell() -> None:
    settings = AS_TOLD.changed(orders=[1, 3])
    records = [dwell(2.0, (1.0, 3.0)), dwell(2.0, (1.0, 3.0))]
    found = used_dwells(records, spectrum(records, settings), settings)
    assert [one.lines.tolist() for one in found] == [[0, 1], [2, 3]]


def test_lines_that_are_not_one_dwell_each_have_no_part() -> None:
    records = [dwell(2.0), dwell(3.0)]
    lines = spectrum(records, AS_TOLD)
    assert used_dwells(records, concatenate([lines, lines]), AS_TOLD) == ()
    assert used_dwells([replace(records[0], frequency_hz=2.5), records[1]], lines, AS_TOLD) == ()
    assert used_dwells([replace(records[0], experiment=1), records[1]], lines, AS_TOLD) == ()
    whole = spectrum([replace(record, frequency_hz=None) for record in records])
    assert used_dwells(records, whole, AS_TOLD) == ()
