"""Words and pictures of Monte Carlo studies."""

from types import SimpleNamespace
from typing import Any

import pytest

from dashpot.present.study import FactorGroup, evenly_spread


def row(method: str, error: float, *coverage: float) -> Any:
    summary = SimpleNamespace(
        error_over_bound=error, rms_error=2 * error, coverage=coverage, draws=100, failed=0
    )
    return SimpleNamespace(method=method, summary=summary)


@pytest.mark.parametrize(("levels", "most"), [(1, 1), (12, 12), (13, 12), (200, 12)])
def test_of_many_groups_alike_some_are_drawn_the_first_and_the_last_among_them(
    levels: int, most: int
) -> None:
    bars = [FactorGroup("frequencies", (("noise", k),), ("A", "B"), (), {}) for k in range(levels)]
    curves = [FactorGroup("noise", (("frequencies", "A"),), (1.0, 2.0, 3.0), (), {})]
    drawn = list(evenly_spread([*bars, *curves]))
    of_bars = [group for group in drawn if group.factor == "frequencies"]
    assert len(drawn) == len(of_bars) + 1
    assert len(of_bars) == most == len({group.rest for group in of_bars})
    assert (of_bars[0], of_bars[-1]) == (bars[0], bars[-1])
