"""An Estimate in the terms of other libraries: a table, numbers that carry their uncertainty, labelled arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dashpot.errors import UsageError
from dashpot.io.optional import optional_library

if TYPE_CHECKING:
    from dashpot.estimate.result import Estimate

EXTRA = "analysis"


def dataframe(estimate: Estimate, level: float = 0.95) -> Any:
    """A pandas DataFrame: a row for each parameter of the rig; value, sd, low, high, bound_sd, unit, known.

    `low` and `high` are the ends of the intervals at `level`.  Raises UsageError without pandas, and for a batch.
    """
    _require_single(estimate)
    pandas = optional_library("pandas", EXTRA, "to_dataframe")
    ends = dict(zip(estimate.names, zip(*estimate.interval(level), strict=True), strict=True))
    for name, root, times, _ in estimate.tied:
        ends[name] = tuple(sorted(times * end for end in ends[root]))
    rows = [
        (value.name, value.value, value.sd, *ends.get(value.name, value.interval95), value.bound_sd, value.unit,
         value.known)
        for value in estimate.parameters().values()
    ]  # fmt: skip
    columns = ["parameter", "value", "sd", "low", "high", "bound_sd", "unit", "known"]
    return pandas.DataFrame(rows, columns=columns).set_index("parameter")


def correlated_numbers(estimate: Estimate) -> dict[str, Any]:
    """Numbers of the package `uncertainties` by name, their correlations kept: unknown and tied parameters.

    Those that are exactly known are plain numbers.  Raises UsageError without uncertainties, and for a batch.
    """
    _require_single(estimate)
    library = optional_library("uncertainties", EXTRA, "to_uncertainties")
    correlated = library.correlated_values(
        estimate.values.tolist(), estimate.covariance.tolist(), estimate.names
    )
    numbers = dict(zip(estimate.names, correlated, strict=True))
    numbers |= {name: times * numbers[root] for name, root, times, _ in estimate.tied}
    return numbers | {name: value for name, value, _ in estimate.known}


def dataset(estimate: Estimate) -> Any:
    """An xarray Dataset: value, sd, bound_sd (…, parameter) and covariance (…, parameter, other); … repeats.

    Raises UsageError without xarray.
    """
    xarray = optional_library("xarray", EXTRA, "to_xarray")
    repeats = [f"repeat_{axis}" for axis in range(estimate.values.ndim - 1)]
    names = list(estimate.names)
    along = [*repeats, "parameter"]
    return xarray.Dataset(
        {
            "value": (along, estimate.values),
            "sd": (along, estimate.sd),
            "bound_sd": (along, estimate.bound_sd),
            "covariance": ([*along, "other"], estimate.covariance),
            "converged": (repeats, estimate.converged),
        },
        coords={"parameter": names, "other": names, "unit": ("parameter", list(estimate.units))},
        attrs={"model": estimate.model, "method": estimate.method, "intervals_count": estimate.basis},
    )


def _require_single(estimate: Estimate) -> None:
    if estimate.values.ndim != 1:
        raise UsageError("this is a batch of estimates", cure="use to_xarray, or take one of them")
