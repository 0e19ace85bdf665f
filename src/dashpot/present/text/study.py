"""Words for the factors of a Monte Carlo study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from dashpot.study.runner import SummaryRow
from dashpot.study.summary import Summary

NOTHING = "–"
COUNTED_FACTORS = {"noise": "noise level", "samples": "samples per frequency", "in_all": "samples in total"}
LEGEND = (
    "bias, spread and bound: rms over the parameters, % of their true values (bound: Cramér-Rao at the truth).",
    "ratio: spread / bound.",
    "coverage: smallest and largest share of 95 % intervals that contain the truth, %.",
)


def factor_text(value: object) -> str:
    """The value of a factor as it is shown."""
    return NOTHING if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def accuracy_in_words(rows: Iterable[SummaryRow]) -> list[str]:
    """How far each method is from the bound and how often its intervals hold the truth, the most accurate first."""
    by_method: dict[str, list[Summary]] = {}
    for row in rows:
        by_method.setdefault(row.method, []).append(row.summary)
    worst = {name: max(each.error_over_bound for each in parts) for name, parts in by_method.items()}
    texts = []
    for name in sorted(worst, key=lambda name: (math.isnan(worst[name]), worst[name])):
        errors = [each.error_over_bound for each in by_method[name]]
        shares = [float(share) for each in by_method[name] for share in each.coverage]
        texts.append(
            f"{name}: rms error {_span(errors, 2)} × the Cramér-Rao bound; 95 % intervals hold the truth in "
            f"{_span(shares, 0)} % of the draws."
        )
    return texts


def _span(values: Sequence[float], decimals: int) -> str:
    low, high = f"{min(values):.{decimals}f}", f"{max(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"


def varied_factors(rows: Iterable[SummaryRow]) -> list[str]:
    """Factors that are not the same in all scenarios."""
    all_rows = list(rows)
    names = dict.fromkeys(key for row in all_rows for key in row.scenario.factors)
    return [name for name in names if len({row.scenario.factors.get(name) for row in all_rows}) > 1]
