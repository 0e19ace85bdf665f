"""The best few sensors."""

from __future__ import annotations

import pytest

from dashpot.design.advise import choose
from dashpot.design.allocation import Criterion
from dashpot.design.test_setup import band_grid
from dashpot.errors import UsageError
from tests.designs import BAND, paper_setup


def test_sensors_by_all_sets_and_by_exchange(monkeypatch: pytest.MonkeyPatch) -> None:
    own = paper_setup()
    grid = band_grid(own, *BAND)
    found = choose(own, Criterion("A"), 1400, grid, 2)
    assert found.complete
    assert len(found.ranking) == 6
    # Both looks at the same mass tell nothing of the other one's share: the two worst sets.
    assert {frozenset(names) for names, _ in found.ranking[-2:]} == {
        frozenset({"x1", "dx1"}),
        frozenset({"x2", "dx2"}),
    }
    monkeypatch.setattr("dashpot.design.advise.EXACT", 0)
    quick = choose(own, Criterion("A"), 1400, grid, 2)
    assert not quick.complete
    assert quick.ranking[0][1] == pytest.approx(found.ranking[0][1], rel=1e-3)
    with pytest.raises(UsageError, match="no channel x9"):
        choose(own, Criterion("A"), 1400, grid, 1, ("x9",))
