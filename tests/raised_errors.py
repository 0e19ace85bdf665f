"""Which errors of dashpot a function may raise, read from its code and from all that it calls by name."""

from __future__ import annotations

import ast
import builtins
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import import_module
from types import FunctionType
from typing import Any

from dashpot.errors import DashpotError

ROOTS = ("dashpot", "tests")  # whose functions are followed
# A wrong setting of the environment, and quantities that are dashpot's own words: no fault of what calls them.
NEVER = {"dashpot.numerics.kernel.kernel", "dashpot.units._quantity"}

Errors = tuple[type[BaseException], ...]


def raised(function: Callable[..., Any]) -> dict[str, str]:
    """Names of the errors, with the way to where each arises; errors that are caught on the way do not count."""
    way: dict[str, str] = {}
    seen = set[tuple[FunctionType, frozenset[type]]]()
    todo = [(_plain(function), frozenset[type](), function.__qualname__)]
    while todo:
        here, caught, path = todo.pop()
        if (here, caught) in seen:
            continue
        seen.add((here, caught))
        for what, around in _steps(here):
            kept = caught | frozenset(around)
            if isinstance(what, FunctionType):
                todo.append((what, kept, f"{path} > {what.__qualname__}"))
            elif issubclass(what, DashpotError) and not issubclass(what, tuple(kept)):
                way.setdefault(what.__name__, path)
    return way


def _plain(value: Any) -> Any:
    """The function behind a property, a method of a class or a cache."""
    for wrapper in ("fget", "func", "__func__", "__wrapped__"):
        value = getattr(value, wrapper, value)
    return value


@cache
def _node(function: FunctionType) -> ast.FunctionDef | None:
    """Its definition; None of one that stands inside another or was made by a decorator."""
    body = _module(function.__module__).body
    node: ast.stmt | None = None
    for name in function.__qualname__.split("."):
        named = (n for n in body if isinstance(n, ast.FunctionDef | ast.ClassDef) and n.name == name)
        node = next(named, None)
        body = [] if node is None else node.body  # type: ignore[attr-defined]
    return node if isinstance(node, ast.FunctionDef) else None


@cache
def _module(name: str) -> ast.Module:
    return ast.parse(inspect.getsource(sys.modules[name]))


@cache
def _local_imports(function: FunctionType) -> dict[str, Any]:
    """What the function imports when it runs."""
    names: dict[str, Any] = {}
    node = _node(function)
    for statement in ast.walk(node) if node is not None else ():
        if isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith("dashpot"):
            module = import_module(str(statement.module))
            names |= {alias.name: getattr(module, alias.name, None) for alias in statement.names}
    return names


def _value(expression: ast.expr, function: FunctionType) -> Any:
    """What a name, an attribute of self or of a module or class of dashpot stands for; None of anything else."""
    if isinstance(expression, ast.Name):
        outside = function.__globals__.get(expression.id, getattr(builtins, expression.id, None))
        return _local_imports(function).get(expression.id, outside)
    if not isinstance(expression, ast.Attribute):
        return None
    if isinstance(expression.value, ast.Name) and expression.value.id == "self":
        holder = function.__globals__.get(function.__qualname__.split(".")[0])
    else:
        holder = _value(expression.value, function)
    if inspect.ismodule(holder) or inspect.isclass(holder):
        return inspect.getattr_static(holder, expression.attr, None)
    return None


@cache
def _steps(function: FunctionType) -> tuple[tuple[Any, Errors], ...]:
    """Functions that it calls and errors that it raises, each with the errors that are caught around it."""
    steps: list[tuple[Any, Errors]] = []
    node = _node(function)
    todo = [] if node is None else list(_inside(node, (), function))
    while todo:
        part, caught = todo.pop()
        if isinstance(part, ast.Raise) and part.exc is not None:
            error = _value(part.exc.func if isinstance(part.exc, ast.Call) else part.exc, function)
            if isinstance(error, FunctionType):  # one that makes the error
                error = error.__globals__.get(str(error.__annotations__.get("return")))
            steps += [(error, caught)] if inspect.isclass(error) else []
        elif isinstance(part, ast.Call | ast.Attribute):
            value = _plain(_value(part.func if isinstance(part, ast.Call) else part, function))
            if isinstance(value, FunctionType) and f"{value.__module__}.{value.__qualname__}" not in NEVER:
                steps += [(value, caught)] if value.__module__.startswith(ROOTS) else []
        todo += _inside(part, caught, function)
    return tuple(steps)


def _inside(node: ast.AST, caught: Errors, function: FunctionType) -> Iterator[tuple[ast.AST, Errors]]:
    """The parts of a statement with what is caught around each; functions in it run where they are called."""
    if isinstance(node, ast.Try):
        kept = caught + tuple(error for handler in node.handlers for error in _caught(handler, function))
        yield from ((part, kept) for part in node.body)
        yield from ((part, caught) for part in (*node.handlers, *node.orelse, *node.finalbody))
        return
    if isinstance(node, ast.With):
        for call in (item.context_expr for item in node.items if isinstance(item.context_expr, ast.Call)):
            if isinstance(call.func, ast.Name) and call.func.id == "suppress":
                caught += _types(call.args, function)
    for part in ast.iter_child_nodes(node):
        if not isinstance(part, ast.FunctionDef | ast.Lambda):
            yield part, caught


def _caught(handler: ast.ExceptHandler, function: FunctionType) -> Errors:
    """The errors that a handler keeps; none where it raises them again."""
    again = any(isinstance(node, ast.Raise) and node.exc is None for node in ast.walk(handler))
    if handler.type is None or again:
        return ()
    return _types(handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type], function)


def _types(expressions: Iterable[ast.expr], function: FunctionType) -> Errors:
    return tuple(kind for kind in (_value(each, function) for each in expressions) if inspect.isclass(kind))
