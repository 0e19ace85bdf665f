"""Laws written as expressions in d (elongation) and v (its rate) with named constants: parsed, never evaluated as code.

    sum      = product { ("+" | "-") product }
    product  = power { ("*" | "/") power }
    power    = ("+" | "-") power | atom [ "**" power ]
    atom     = number | name | name "(" comparison { "," comparison } ")" | "(" sum ")"
    comparison = sum [ ("<" | ">" | "<=" | ">=") sum ]            only as the first argument of where

Values and first derivatives come together by forward differentiation; both are arrays of any one shape.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.errors import ModelError

_OF_ONE = ("abs", "sign", "tanh", "exp", "log", "sqrt", "sin", "cos")
FUNCTIONS: Mapping[str, int] = MappingProxyType(
    {**dict.fromkeys(_OF_ONE, 1), "min": 2, "max": 2, "where": 3}
)  # and how many arguments they take
LONGEST = 500  # characters of an expression
DEEPEST = 50  # brackets within brackets
LARGEST = 1e100  # number

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_]\w*)|(?P<sign>\*\*|<=|>=|[-+*/(),<>]))"
)


@dataclass(frozen=True)
class Node:
    """One operation of an expression: its symbol, what it works on, and the number or name that it stands for."""

    symbol: str
    operands: tuple[Node, ...] = ()
    number: float = 0.0
    name: str = ""


@dataclass(frozen=True)
class Dual:
    """A value and its partial derivatives by name; what is not named has none."""

    value: Real
    slopes: Mapping[str, Real]


@dataclass(frozen=True)
class Expression:
    """A parsed expression: its text, its tree and the names that occur in it, in order of first use."""

    text: str
    tree: Node
    names: tuple[str, ...]

    @property
    def functions(self) -> frozenset[str]:
        """Functions that it calls."""
        return frozenset(_functions(self.tree))

    @property
    def divisors(self) -> frozenset[str]:
        """Names that it divides by as they are."""
        return frozenset(node.name for node in _denominators(self.tree) if node.symbol == "name")

    def __call__(self, values: Mapping[str, Real]) -> Dual:
        """Value and derivatives with respect to every name that occurs; all `values` broadcast together."""
        with np.errstate(all="ignore"):
            return _evaluated(self.tree, values)

    def crosses_pole(self, values: Mapping[str, Real]) -> bool:
        """Whether something that it divides by is zero, or changes sign, within the rows (…, instants) of `values`."""
        for node in _denominators(self.tree):
            value = _evaluated(node, values).value
            if np.any(np.min(value, axis=-1) * np.max(value, axis=-1) <= 0) if np.ndim(value) else not value:
                return True
        return False


def _denominators(node: Node) -> list[Node]:
    inner = [denominator for operand in node.operands for denominator in _denominators(operand)]
    return [*inner, node.operands[1]] if node.symbol == "/" else inner


def _functions(node: Node) -> set[str]:
    inner = set().union(*(_functions(operand) for operand in node.operands))
    return inner | {node.symbol} if node.symbol in FUNCTIONS else inner


def parse(text: str) -> Expression:
    """The expression in `text`.  Raises ModelError that says what cannot be read, and where."""
    if len(text) > LONGEST:
        raise ModelError(f"the law has {len(text)} characters", cure=f"write it with {LONGEST} or fewer")
    tokens, at = [], 0
    while text[at:].strip():
        match = _TOKEN.match(text, at)
        if match is None:
            raise ModelError(
                f"{text[at:].strip()[0]!r} in the law {text!r} is not understood",
                cure=f"use + - * / ** ( ), numbers, names, and {', '.join(FUNCTIONS)}",
            )
        tokens.append((str(match.lastgroup), match[str(match.lastgroup)]))
        at = match.end()
    if not tokens:
        raise ModelError("the law is empty", cure='write one, such as "d**3"')
    parser = _Parser(text, tokens)
    tree = parser.sum(0)
    if parser.at < len(tokens):
        raise parser.wrong(f"{tokens[parser.at][1]!r} is not expected there")
    return Expression(text, tree, tuple(dict.fromkeys(parser.names)))


class _Parser:
    """Recursive descent over the tokens of one expression."""

    def __init__(self, text: str, tokens: list[tuple[str, str]]) -> None:
        self.text, self.tokens, self.at = text, tokens, 0
        self.names: list[str] = []

    def wrong(self, what: str) -> ModelError:
        return ModelError(f"the law {self.text!r}: {what}", cure='write it like "d**3" or "tanh(v/v0)"')

    def peek(self) -> str:
        return self.tokens[self.at][1] if self.at < len(self.tokens) else ""

    def take(self, *wanted: str) -> str:
        sign = self.peek()
        if sign not in wanted:
            raise self.wrong(f"{wanted[0]!r} is missing" + (f" before {sign!r}" if sign else " at the end"))
        self.at += 1
        return sign

    def sum(self, depth: int) -> Node:
        if depth > DEEPEST:
            raise self.wrong("brackets are nested too deep")
        left = self.product(depth)
        while self.peek() in ("+", "-"):
            left = Node(self.take("+", "-"), (left, self.product(depth)))
        return left

    def product(self, depth: int) -> Node:
        left = self.power(depth)
        while self.peek() in ("*", "/"):
            sign, right = self.take("*", "/"), self.power(depth)
            if sign == "/" and right.symbol == "number" and right.number == 0:
                raise self.wrong("it divides by zero")
            left = Node(sign, (left, right))
        return left

    def power(self, depth: int) -> Node:
        if depth > DEEPEST:
            raise self.wrong("signs are nested too deep")
        if self.peek() in ("+", "-"):
            sign, operand = self.take("+", "-"), self.power(depth + 1)
            return Node("negative", (operand,)) if sign == "-" else operand
        base = self.atom(depth)
        if self.peek() == "**":
            self.take("**")
            return Node("**", (base, self.power(depth + 1)))
        return base

    def atom(self, depth: int) -> Node:
        if self.at >= len(self.tokens):
            raise self.wrong("it ends too early")
        kind, word = self.tokens[self.at]
        if kind == "number":
            if not float(word) <= LARGEST:
                raise self.wrong(f"the number {word[:20]} is too large")
            if 0 < float(word) < 1 / LARGEST:
                raise self.wrong(f"the number {word[:20]} is too small")
            self.at += 1
            return Node("number", number=float(word))
        if kind == "name":
            self.at += 1
            if self.peek() == "(":
                return self.call(word, depth)
            self.names.append(word)
            return Node("name", name=word)
        self.take("(")
        inner = self.sum(depth + 1)
        self.take(")")
        return inner

    def call(self, word: str, depth: int) -> Node:
        if word not in FUNCTIONS:
            raise self.wrong(f"there is no function {word}; choose from {', '.join(FUNCTIONS)}")
        self.take("(")
        operands = [self.comparison(depth + 1) if word == "where" else self.sum(depth + 1)]
        while self.peek() == ",":
            self.take(",")
            operands.append(self.sum(depth + 1))
        self.take(")")
        if len(operands) != FUNCTIONS[word]:
            raise self.wrong(f"{word} takes {FUNCTIONS[word]} arguments, not {len(operands)}")
        return Node(word, tuple(operands))

    def comparison(self, depth: int) -> Node:
        left = self.sum(depth)
        sign = self.take("<", ">", "<=", ">=")
        right = self.sum(depth)
        return Node("-", (left, right)) if sign.startswith(">") else Node("-", (right, left))


def _evaluated(node: Node, values: Mapping[str, Real]) -> Dual:
    if node.symbol == "number":
        return Dual(np.asarray(node.number), {})
    if node.symbol == "name":
        value = values[node.name]
        return Dual(value, {node.name: np.ones_like(value)})
    return _RULES[node.symbol](*(_evaluated(operand, values) for operand in node.operands))


def _chain(value: Real, *terms: tuple[Dual, Real]) -> Dual:
    """A value with the derivatives Σ slope · ∂operand."""
    slopes: dict[str, Real] = {}
    for operand, slope in terms:
        for name, partial in operand.slopes.items():
            part = slope * partial
            slopes[name] = slopes[name] + part if name in slopes else part
    return Dual(value, slopes)


def _power(a: Dual, b: Dual) -> Dual:
    value = a.value**b.value
    along = b.value * a.value ** (b.value - 1)
    # At 0 the slope of a constant exponent of 0, and that along the exponent, is 0, not 0 times infinity.
    # So does that of a root, where it is infinite: a state such as Bouc and Wen's passes through 0 all the time.
    if np.any(b.value < 1):
        flat = (b.value == 0) | ((a.value == 0) & (b.value > 0))
        along = np.where(np.broadcast_to(flat & (b.value < 1), np.shape(along)), 0.0, along)
    if not b.slopes:
        return _chain(value, (a, along))
    inside = np.where(a.value > 0, a.value, 1.0)
    return _chain(value, (a, along), (b, np.where(a.value > 0, value * np.log(inside), 0.0)))


def _chosen(first: Bools, a: Dual, b: Dual) -> Dual:
    """Value and slopes of a where it is chosen, else of b; what is not chosen may be no number."""
    names = {**a.slopes, **b.slopes}
    slopes = {name: np.where(first, a.slopes.get(name, 0.0), b.slopes.get(name, 0.0)) for name in names}
    return Dual(np.where(first, a.value, b.value), slopes)


def _unary(function: Callable[[Real], Real], slope: Callable[[Real, Real], Real]) -> Callable[[Dual], Dual]:
    return lambda a: _chain(value := function(a.value), (a, slope(a.value, value)))


_RULES: Mapping[str, Callable[..., Dual]] = {
    "+": lambda a, b: _chain(a.value + b.value, (a, np.asarray(1.0)), (b, np.asarray(1.0))),
    "-": lambda a, b: _chain(a.value - b.value, (a, np.asarray(1.0)), (b, np.asarray(-1.0))),
    "*": lambda a, b: _chain(a.value * b.value, (a, b.value), (b, a.value)),
    "/": lambda a, b: _chain(a.value / b.value, (a, 1 / b.value), (b, -a.value / b.value**2)),
    "**": _power,
    "negative": lambda a: _chain(-a.value, (a, np.asarray(-1.0))),
    "abs": _unary(np.abs, lambda x, _: np.sign(x)),
    "sign": _unary(np.sign, lambda x, _: np.zeros_like(x)),
    "tanh": _unary(np.tanh, lambda _, y: 1 - y**2),
    "exp": _unary(np.exp, lambda _, y: y),
    "log": _unary(np.log, lambda x, _: 1 / x),
    "sqrt": _unary(np.sqrt, lambda _, y: 0.5 / y),
    "sin": _unary(np.sin, lambda x, _: np.cos(x)),
    "cos": _unary(np.cos, lambda x, _: -np.sin(x)),
    "min": lambda a, b: _chosen(a.value < b.value, a, b),
    "max": lambda a, b: _chosen(a.value > b.value, a, b),
    "where": lambda test, a, b: _chosen(test.value > 0, a, b),
}


Exponents = tuple[float, float]  # of metre and second
Powers = tuple[dict[int, float], Exponents]  # shares of unknown exponents, and what is known of the power
PURE: Powers = ({}, (0.0, 0.0))


def dimensions(
    expression: Expression, known: Mapping[str, Exponents]
) -> tuple[Exponents, Mapping[str, Exponents]]:
    """Powers of metre and second of an expression's value, and of the names that are not `known`.

    Terms that are added or compared are alike, arguments of tanh, exp, log, sin and cos and exponents are pure
    numbers; what is left open by that is a pure number.  A number written in the expression may carry any unit.
    Raises ModelError if no units make sense of the expression.
    """
    solver = _Dimensions(known)
    result = solver.visit(expression.tree)
    return solver.solved(expression, result)


class _Dimensions:
    """Linear equations for the powers of the units of names and numbers."""

    def __init__(self, known: Mapping[str, Exponents]) -> None:
        self.known = known
        self.names: dict[str, int] = {}
        self.count = 0
        self.rows: list[Powers] = []

    def free(self) -> Powers:
        self.count += 1
        return {self.count - 1: 1.0}, (0.0, 0.0)

    @staticmethod
    def plus(a: Powers, b: Powers, factor: float) -> Powers:
        parts = dict(a[0])
        for column, share in b[0].items():
            parts[column] = parts.get(column, 0.0) + factor * share
        return parts, (a[1][0] + factor * b[1][0], a[1][1] + factor * b[1][1])

    def alike(self, a: Powers, b: Powers) -> None:
        self.rows.append(self.plus(a, b, -1.0))

    def visit(self, node: Node) -> Powers:
        if node.symbol == "number":
            return self.free()
        if node.symbol == "name":
            return self.visit_name(node.name)
        if node.symbol == "**":
            return self.visit_power(*node.operands)
        parts = [self.visit(operand) for operand in node.operands]
        if node.symbol == "*":
            return self.plus(parts[0], parts[1], 1.0)
        if node.symbol == "/":
            return self.plus(parts[0], parts[1], -1.0)
        if node.symbol in ("+", "-", "min", "max"):
            self.alike(parts[0], parts[1])
        if node.symbol == "where":
            self.alike(parts[1], parts[2])
            return parts[1]
        if node.symbol in ("tanh", "exp", "log", "sin", "cos"):
            self.alike(parts[0], PURE)
            return PURE
        if node.symbol == "sign":
            return PURE
        return self.plus(PURE, parts[0], 0.5) if node.symbol == "sqrt" else parts[0]

    def visit_name(self, name: str) -> Powers:
        if name in self.known:
            return {}, self.known[name]
        if name not in self.names:
            self.names[name] = self.count
            self.count += 1
        return {self.names[name]: 1.0}, (0.0, 0.0)

    def visit_power(self, base: Node, exponent: Node) -> Powers:
        unit = self.visit(base)
        if exponent.symbol == "number":
            return self.plus(PURE, unit, exponent.number)
        self.alike(self.visit(exponent), PURE)
        # Whether an exponent is a named constant, so that its base keeps the unit it has at an exponent of 1
        return unit if exponent.symbol == "name" else PURE

    def solved(self, expression: Expression, result: Powers) -> tuple[Exponents, Mapping[str, Exponents]]:
        A = np.zeros((len(self.rows), self.count))
        b = np.zeros((len(self.rows), 2))
        for row, (parts, constant) in enumerate(self.rows):
            for column, share in parts.items():
                A[row, column] = share
            b[row] = [-constant[0], -constant[1]]
        powers = self._least(A, b) if A.size else np.zeros((self.count, 2))
        if len(b) and np.max(np.abs(A @ powers - b)) > 1e-9:
            raise ModelError(
                f"no consistent units exist for the law {expression.text!r}",
                cure="add and compare only what has one unit; tanh, exp, log, sin and cos take pure numbers",
            )
        total = np.array(result[1]) + sum((share * powers[c] for c, share in result[0].items()), np.zeros(2))
        clean = np.round(np.vstack([total, powers]), 9) + 0.0
        names = {name: (float(clean[c + 1, 0]), float(clean[c + 1, 1])) for name, c in self.names.items()}
        return (float(clean[0, 0]), float(clean[0, 1])), names

    def _least(self, A: Real, b: Real) -> Real:
        """Least powers: first those of the numbers, which are pure where the names can be made to fit them."""
        of_names = sorted(self.names.values())
        of_numbers = [column for column in range(self.count) if column not in self.names.values()]
        powers = np.zeros((self.count, 2))
        beyond_names = np.eye(len(A)) - A[:, of_names] @ np.linalg.pinv(A[:, of_names])
        powers[of_numbers] = np.linalg.lstsq(beyond_names @ A[:, of_numbers], beyond_names @ b, rcond=1e-9)[0]
        rest = b - A[:, of_numbers] @ powers[of_numbers]
        powers[of_names] = np.linalg.lstsq(A[:, of_names], rest, rcond=None)[0]
        return powers
