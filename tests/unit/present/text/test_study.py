"""Words of Monte Carlo studies."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from dashpot.present.text.study import accuracy_in_words


def row(method: str, error: float, *coverage: float) -> Any:
    return SimpleNamespace(method=method, summary=SimpleNamespace(error_over_bound=error, coverage=coverage))


def test_the_most_accurate_method_comes_first_with_the_range_over_all_scenarios() -> None:
    rows = [row("ls", 1.2, 5, 95), row("oiv", 0.98, 93, 96), row("ls", 3.5, 0, 80), row("oiv", 1.04, 94, 97)]
    assert accuracy_in_words(cast("Any", rows)) == [
        "oiv: rms error 0.98 to 1.04 × the Cramér-Rao bound; 95 % intervals hold the truth in 93 to 97 % of the draws.",
        "ls: rms error 1.20 to 3.50 × the Cramér-Rao bound; 95 % intervals hold the truth in 0 to 95 % of the draws.",
    ]
