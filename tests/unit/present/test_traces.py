"""Small pictures of channels: thinned by extremes, so that nothing that stands out is lost."""

import numpy as np
import pytest

from dashpot.present.figures.traces import bars_svg, extremes_of, lines_svg, trace_svg

NAME = "<b>&x"


def test_a_single_peak_of_a_million_samples_is_kept() -> None:
    values = np.zeros(1_000_000)
    values[123_456], values[777_777] = 5.0, -3.0
    low, high = extremes_of(values, 576)
    assert (low.min(), high.max()) == (-3.0, 5.0)


def test_samples_that_are_no_numbers_leave_a_gap() -> None:
    low, _ = extremes_of(np.r_[np.ones(10), np.full(10, np.nan)], 2)
    assert np.array_equal(np.isfinite(low), [True, False])


@pytest.mark.parametrize("samples", [1, 2, 5, 1000])
def test_pictures_escape_names_and_mark_what_is_masked(samples: int) -> None:
    time = np.arange(samples) / 10
    marks = time == time[-1]
    svg = trace_svg(NAME, NAME, [(time, np.sin(time), marks), (time, np.cos(time), None)])
    assert NAME not in svg
    assert svg.count("<rect") == 1
    assert NAME not in lines_svg(NAME, NAME, time, np.exp(1j * time))
    assert NAME not in bars_svg(NAME, [1, 2], [0, 1], [2, np.nan])
