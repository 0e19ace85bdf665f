"""Every function, method and class of the reference states shapes, units and the errors that it raises."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.errors import DataError, UsageError
from tests.public_surface import Entry, entries, entry

EVERY = list(entries())


def test_the_walk_meets_functions_methods_properties_and_classes() -> None:
    names = {each.name for each in EVERY}
    assert names >= {
        "dashpot.identify", "dashpot.Estimate.interval", "dashpot.Spectrum.omega", "dashpot.Record",
        "dashpot.design.test_setup.TestSetup.prior",
    }  # fmt: skip
    assert len(names) > 200


@pytest.mark.parametrize("what", ["without_shape", "without_unit", "unlisted_errors"])
def test_shapes_units_and_errors_are_stated(what: str) -> None:
    lacking = {each.name: getattr(each, what)() for each in EVERY}
    assert {name: left for name, left in lacking.items() if left} == {}


def _checked(values: Real) -> Real:
    if not np.all(np.isfinite(values)):
        raise DataError("a number is missing")
    return values


def silent(values: Real, scale: float) -> Real:
    """Scaled values (see below, with care)."""
    return _checked(values) * scale


def outspoken(values: Real, scale: float) -> Real:
    """Values (lines,), m, times `scale`.  Raises DataError where one is missing."""
    return _checked(values) * scale


def guarded(values: Real) -> Real:
    """Values (lines,), m; 0 where one is missing."""
    try:
        return _checked(values)
    except DataError:
        return np.zeros(0)


def refuses(text: str) -> None:
    """Raises as `outspoken`."""
    if text:
        raise UsageError("no text is wanted")
    outspoken(np.zeros(1), 1.0)


def of(function: object) -> Entry:
    return entry("function", function)


def test_what_is_left_unsaid_is_found() -> None:
    assert of(silent).without_shape() == ["values", "return"]
    assert of(silent).without_unit() == ["values", "scale", "return"]
    assert of(silent).unlisted_errors() == {"DataError": "silent > _checked"}
    assert of(refuses).unlisted_errors() == {"UsageError": "refuses"}


@pytest.mark.parametrize("function", [outspoken, guarded])
def test_what_is_stated_passes(function: object) -> None:
    assert not of(function).without_shape()
    assert not of(function).without_unit()
    assert not of(function).unlisted_errors()
