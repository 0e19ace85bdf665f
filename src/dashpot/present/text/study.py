"""Words for the factors of a Monte Carlo study."""

from __future__ import annotations

from collections.abc import Iterable

from dashpot.study.runner import SummaryRow

NOTHING = "–"
COUNTED_FACTORS = {"noise": "noise level", "samples": "samples per frequency", "in_all": "samples in total"}
LEGEND = (
    "bias, spread and bound: rms over the parameters, % of their true values (bound: Cramér-Rao at the truth).",
    "ratio: spread / bound.",
    "coverage: smallest and largest share of 95 % intervals that contain the truth, %.",
)


def factor_text(value: object) -> str:
    """The value of a factor as it is shown."""
    """The value of a factor as it is shown."""
    """The value of a factor as it is shown."""
    return NOTHING if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def varied_factors(rows: Iterable[SummaryRow]) -> list[str]:
    """Factors that are not the same in all scenarios."""
    all_rows = list(rows)
    names = dict.fromkeys(key for row in all_rows for key in row.scenario.factors)
    return [name for name in names if len({row.scenario.factors.get(name) for row in all_rows}) > 1]
