"""Words and pictures of Monte Carlo studies."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from dashpot.present.study import MOST_ALIKE, FactorGroup, accuracy_in_words, evenly_spread, next_study_steps


def row(method: str, error: float, *coverage: float) -> Any:
    summary = SimpleNamespace(
        error_over_bound=error, rms_error=2 * error, coverage=coverage, draws=100, failed=0
    )
    return SimpleNamespace(method=method, summary=summary)


def test_the_most_accurate_method_comes_first_with_the_range_over_all_scenarios() -> None:
    rows = [row("ls", 1.2, 5, 95), row("oiv", 0.98, 93, 96), row("ls", 3.5, 0, 80), row("oiv", 1.04, 94, 97)]
    assert accuracy_in_words(cast("Any", rows)) == [
        (
            "oiv: rms error 2.0 to 2.1 % of the true values, 0.98 to 1.04 × the Cramér-Rao bound; 95 % intervals hold "
            "the truth in 93 to 97 % of the draws."
        ),
        (
            "ls: rms error 2.4 to 7.0 % of the true values, 1.20 to 3.50 × the Cramér-Rao bound; 95 % intervals hold "
            "the truth in 0 to 95 % of the draws."
        ),
    ]
    first, more = next_study_steps(cast("Any", rows))
    assert "--method oiv" in first
    assert "100 draws tell a share of 95 % to ± 2.2 points" in more


@pytest.mark.parametrize("levels", [1, MOST_ALIKE, MOST_ALIKE + 1, 200])
def test_of_many_groups_alike_some_are_drawn_the_first_and_the_last_among_them(levels: int) -> None:
    bars = [FactorGroup("frequencies", (("noise", k),), ("A", "B"), (), {}) for k in range(levels)]
    curves = [FactorGroup("noise", (("frequencies", "A"),), (1.0, 2.0, 3.0), (), {})]
    drawn = list(evenly_spread([*bars, *curves]))
    of_bars = [group for group in drawn if group.factor == "frequencies"]
    assert len(drawn) == len(of_bars) + 1
    assert len(of_bars) == min(levels, MOST_ALIKE) == len({group.rest for group in of_bars})
    assert (of_bars[0], of_bars[-1]) == (bars[0], bars[-1])
