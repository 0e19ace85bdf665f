"""The estimators by the names that files and the command line use; each is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from dashpot.errors import UsageError
from dashpot.estimate.method import Method

METHODS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "ls": ("linear.least_squares", "LeastSquares"),
        "hls": ("linear.least_squares", "HarmonicLeastSquares"),
        "wls": ("linear.least_squares", "WeightedLeastSquares"),
        "tls": ("linear.total_least_squares", "TotalLeastSquares"),
        "cls": ("linear.total_least_squares", "CompensatedLeastSquares"),
        "iv": ("linear.instrumental_variables", "InstrumentalVariables"),
        "oiv": ("linear.instrumental_variables", "OptimalIV"),
        "oiv+": ("linear.definite", "DefiniteOptimalIV"),
        "ml": ("likelihood.maximum_likelihood", "MaximumLikelihood"),
    }
)


def method_class(name: str) -> type[Method]:
    """The class of that name.  Raises UsageError where there is none."""
    if name not in METHODS:
        raise UsageError(f"there is no method {name}", cure=f"there are {', '.join(METHODS)}")
    module, attribute = METHODS[name]
    try:
        found = getattr(import_module(f"dashpot.estimate.{module}"), attribute)
    except ModuleNotFoundError as error:
        if error.name != f"dashpot.estimate.{module}":
            raise
        raise UsageError(f"the method {name} is not part of this installation") from None
    assert isinstance(found, type)
    assert issubclass(found, Method)
    return found


def method(name: str, **settings: object) -> Method:
    """A method by name; of `settings` it takes what it has a field for (a seed matters to few)."""
    kind = method_class(name)
    fields = getattr(kind, "__dataclass_fields__", {})
    return kind(**{key: value for key, value in settings.items() if key in fields})
