"""Which groups of a study's scenarios are drawn."""

from typing import Any

import pytest

from dashpot.present.figures import study as study_results
from dashpot.present.figures.study import MOST_ALIKE, FactorGroup, study_pictures


@pytest.mark.parametrize("levels", [1, MOST_ALIKE, MOST_ALIKE + 1, 200])
def test_of_many_groups_alike_some_are_drawn_the_first_and_the_last_among_them(
    levels: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    bars = [FactorGroup("frequencies", (("noise", k),), ("A", "B"), (), {}) for k in range(levels)]
    curves = [FactorGroup("noise", (("frequencies", "A"),), (1.0, 2.0, 3.0), (), {})]
    drawn: list[FactorGroup] = []

    def figure(group: FactorGroup, *_: Any) -> list[tuple[str, None]]:
        drawn.append(group)
        return [("", None)]

    monkeypatch.setattr(study_results, "groups", lambda _: [*bars, *curves])
    monkeypatch.setattr(study_results, "_bars", figure)
    monkeypatch.setattr(study_results, "_curves", figure)
    monkeypatch.setattr(study_results, "_title", lambda *_: "")
    monkeypatch.setattr(study_results, "_slug", lambda *_: "")
    monkeypatch.setattr(study_results, "png", lambda _: b"")
    made = study_pictures(None)  # type: ignore[arg-type]
    of_bars = [group for group in drawn if group.factor == "frequencies"]
    assert len(made) == len(drawn) == len(of_bars) + 1
    assert len(of_bars) == min(levels, MOST_ALIKE) == len({group.rest for group in of_bars})
    assert (of_bars[0], of_bars[-1]) == (bars[0], bars[-1])
