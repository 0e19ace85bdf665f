"""Dwells that end before their first period: left out where others hold, refused where most are like them."""

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, U, wave

RATE = 100.0


def dwell(f: float, samples: int) -> Record:
    t = np.arange(samples) / RATE
    noise = 1e-3 * np.random.default_rng(samples).normal(size=(samples, 2))
    return Record((X1, U), t, wave(t, f, [1.0, 0.5j]) + noise, f, source=f"test.csv:{f:g}")


@pytest.mark.parametrize(("samples", "holds"), [(8, "0.36 of a period"), (3, "3 samples"), (1, "1 sample")])
def test_a_dwell_that_was_stopped_is_left_out_and_told(samples, holds):
    lines = spectrum([dwell(3.0, 200), dwell(5.0, 200), dwell(4.5, samples)])
    assert lines.frequency_hz.tolist() == [3.0, 5.0]
    (note,) = [note for note in lines.notes if note.code == "dwell_left_out"]
    assert holds in note.text
    assert "test.csv:4.5" in note.text


def test_where_most_are_too_brief_the_frequencies_are_in_doubt():
    with pytest.raises(DataError, match="of a period at"):
        spectrum([dwell(3.0, 200), dwell(4.5, 8)])
