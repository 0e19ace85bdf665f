"""Words for the factors of a Monte Carlo study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from dashpot.study.montecarlo import Summary, SummaryRow

NOTHING = "–"
ENOUGH_DRAWS = 400  # by which a share of 95 % is known to a point
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
    texts = []
    for name, summaries in _most_accurate_first(rows).items():
        errors = [each.error_over_bound for each in summaries]
        sizes = [each.rms_error for each in summaries]
        shares = [float(share) for each in summaries for share in each.coverage]
        texts.append(
            f"{name}: rms error {_span(sizes, 1)} % of the true values, {_span(errors, 2)} × the Cramér-Rao bound; "
            f"95 % intervals hold the truth in {_span(shares, 0)} % of the draws."
        )
    return texts


def next_study_steps(rows: Sequence[SummaryRow]) -> tuple[str, ...]:
    """What to do after a study: whose values to take, and how far its shares are known."""
    method = next(iter(_most_accurate_first(rows)))
    draws = min(row.summary.draws - row.summary.failed for row in rows)
    steps = [f"Take its values in tests like these: dashpot identify RIG DATA --method {method}."]
    if draws < ENOUGH_DRAWS:
        spread = 100 * math.sqrt(0.95 * 0.05 / max(draws, 1))
        steps.append(
            f"{draws} draws tell a share of 95 % to ± {spread:.1f} points: run the study with --draws 1000 before "
            "judging intervals."
        )
    return tuple(steps)


def _most_accurate_first(rows: Iterable[SummaryRow]) -> dict[str, list[Summary]]:
    """Summaries of each method, by its largest error over the bound."""
    by_method: dict[str, list[Summary]] = {}
    for row in rows:
        by_method.setdefault(row.method, []).append(row.summary)
    worst = {name: max(each.error_over_bound for each in parts) for name, parts in by_method.items()}
    return {
        name: by_method[name]
        for name in sorted(worst, key=lambda name: (math.isnan(worst[name]), worst[name]))
    }


def _span(values: Sequence[float], decimals: int) -> str:
    low, high = f"{min(values):.{decimals}f}", f"{max(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"


def varied_factors(rows: Iterable[SummaryRow]) -> list[str]:
    """Factors that are not the same in all scenarios."""
    all_rows = list(rows)
    names = dict.fromkeys(key for row in all_rows for key in row.scenario.factors)
    return [name for name in names if len({row.scenario.factors.get(name) for row in all_rows}) > 1]
