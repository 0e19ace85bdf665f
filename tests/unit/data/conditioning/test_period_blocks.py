"""Blocks of whole periods: amplitudes of each, found once for a record."""

import numpy as np
import pytest

from dashpot.data.conditioning.transients import period_blocks
from dashpot.data.record import Record
from tests.unit.data.conditioning.signals import X1, X2, wave


def test_blocks_count_from_the_end_and_hold_the_sine() -> None:
    t = np.arange(1030) / 100
    record = Record((X1, X2), t, wave(t, 2.0, [1.0, 2j]), 2.0)
    blocks = period_blocks(record, 2.0)
    assert len(blocks.starts) == 20
    assert blocks.ends[-1] == 1030
    assert np.all(blocks.ends - blocks.starts == 50)
    assert np.all(blocks.starts[1:] == blocks.ends[:-1])
    assert blocks.amplitudes == pytest.approx(np.tile([1.0, 2j], (20, 1)), abs=1e-12)
    assert np.max(blocks.rms) < 1e-12
    assert period_blocks(record, 2.0) is blocks


def test_too_few_periods() -> None:
    t = np.arange(350) / 100
    record = Record((X1,), t, wave(t, 2.0, [1.0]), 2.0)
    assert period_blocks(record, 2.0) is None
    assert period_blocks(record, 4.0) is not None
