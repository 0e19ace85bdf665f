"""The estimators by the names that files and the command line use; each is imported when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from dashpot.errors import UsageError

if TYPE_CHECKING:
    from dashpot.estimate.method import Method
    from dashpot.model.network import Model

METHODS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "ls": ("linear.least_squares", "LeastSquares"),
        "hls": ("linear.least_squares", "HarmonicLeastSquares"),
        "wls": ("linear.least_squares", "WeightedLeastSquares"),
        "tls": ("linear.total_least_squares", "TotalLeastSquares"),
        "cls": ("linear.total_least_squares", "CompensatedLeastSquares"),
        "iv": ("linear.instrumental_variables", "InstrumentalVariables"),
        "oiv": ("linear.instrumental_variables", "OptimalIV"),
        "oiv+": ("linear.instrumental_variables", "DefiniteOptimalIV"),
        "ml": ("likelihood.maximum_likelihood", "MaximumLikelihood"),
    }
)


AUTOMATIC = ("oiv", "ml")  # the first that suits the data is taken where none is named


def method_class(name: str) -> type[Method]:
    """The class of that name.  Raises UsageError if there is none."""
    from dashpot.estimate.method import Method  # the names alone load neither NumPy nor an estimator

    if name not in METHODS:
        raise UsageError(f"there is no method {name}", cure=f"the methods are {', '.join(METHODS)}")
    module, attribute = METHODS[name]
    try:
        kind = getattr(import_module(f"dashpot.estimate.{module}"), attribute)
    except ModuleNotFoundError as error:
        if error.name != f"dashpot.estimate.{module}":
            raise
        raise UsageError(f"the method {name} is not part of this installation") from None
    assert isinstance(kind, type)
    assert issubclass(kind, Method)
    return kind


def methods_for(model: Model) -> list[str]:
    """All methods that may differ for the rig: definite matrices count only where entries of matrices are free."""
    from dashpot.model.matrix_elements import free_entries

    free = bool(free_entries(model))
    return [name for name in METHODS if free or not method_class(name).traits.definite]


def method(name: str, *, seed: int | None = None, **settings: object) -> Method:
    """A method by name with its `settings`, the fields of its class.

    `seed` is accepted for every method; those without random starts ignore it.
    Raises UsageError if there is no such method or it has no such setting.
    """
    kind = method_class(name)
    fields = tuple(getattr(kind, "__dataclass_fields__", {}))
    for key in settings:
        if key not in fields:
            its = f"its settings are {', '.join(fields)}" if fields else "it has none"
            raise UsageError(f"the method {name} has no setting {key}", cure=its)
    if seed is not None and "seed" in fields:
        settings["seed"] = seed
    return kind(**settings)
