"""Methods of values that are short for functions of the package: `rig.identify(data)` is `dashpot.identify(rig, data)`.

A value knows none of the layers above its own.  The function is looked up in `dashpot.api` by its name when the method
is called, as `dashpot.identify` is when it is used; nothing is imported before.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from inspect import signature, unwrap
from numbers import Integral, Real
from types import UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, cast, get_args, get_origin

import numpy as np

from dashpot.errors import UsageError

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
_SHOWN = (type(None), str, bytes, int, float, complex, tuple, list, dict)  # others are named by their type


def call(function: str, *arguments: Any, **options: Any) -> Any:
    """Call a function of `dashpot.api` by its name."""
    return refusing(getattr(import_module("dashpot.api"), function))(*arguments, **options)


def refusing(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """The function; where it fails on an argument that is not of its annotated type, a UsageError names that one."""

    @wraps(function)
    def called(*arguments: Arguments.args, **options: Arguments.kwargs) -> Result:
        try:
            return function(*arguments, **options)
        except (ArithmeticError, AttributeError, LookupError, RuntimeWarning, TypeError, ValueError) as error:
            try:
                given = signature(function).bind(*arguments, **options).arguments
            except TypeError:  # too many arguments, or too few, which Python says well
                raise error from None
            for name, value in given.items():
                hint = function.__annotations__.get(name, "Any")
                try:
                    kind = eval(hint, unwrap(function).__globals__)
                except NameError:
                    kind = Any
                if not _fits(value, kind):
                    shown = reprlib.repr(value) if isinstance(value, _SHOWN) else f"a {type(value).__name__}"
                    paths = hint in ("AnyPath", "str | os.PathLike[str]")
                    cure = "give the name of a file" if paths else f"it must be {hint}"
                    raise UsageError(f"{function.__name__}: {name} is {shown}", cure=cure) from error
            raise

    return called


def _fits(value: object, hint: Any) -> bool:
    """Whether a value is of a type, as far as an isinstance tells; no bytes, and no numbers that are not finite."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        return any(_fits(value, each) for each in inner)
    if kind is Literal:
        return any(type(value) is type(each) and value == each for each in inner)
    if kind is np.ndarray:
        return isinstance(value, np.ndarray) and value.size > 0 and bool(np.all(np.isfinite(value)))
    if kind in (float, int):
        return isinstance(value, Real if kind is float else Integral) and bool(np.isfinite(float(value)))
    if kind is Any or not isinstance(kind, type):
        return True
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    if not isinstance(value, kind) or isinstance(value, bytes):
        return issubclass(kind, Sequence) and isinstance(value, np.ndarray) and _fits(value.tolist(), hint)
    if isinstance(value, Mapping):
        return all(_fits(each, inner[1]) for each in value.values()) if len(inner) == 2 else True
    if isinstance(value, list | tuple) and inner:
        return all(_fits(each, inner[0]) for each in value[:100])
    return not (isinstance(value, str) and inner)  # a text is a sequence of texts, but not meant as one


class InNotebooks:
    """A value that a notebook shows as a table."""

    def _repr_html_(self) -> str:
        return cast(str, call("html", self))


class Printable(InNotebooks):
    """A result that prints as its command does, and can be drawn."""

    def __str__(self) -> str:
        """What the command prints."""
        return cast(str, call("text", self))

    def plot(self, level: float = 0.95) -> Any:
        """A matplotlib Figure of the values with their intervals."""
        return call("plot", self, level)
