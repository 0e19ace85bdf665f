"""Nonlinear laws: the unit force of an element as a function of its elongation d, its rate v and inner constants.

Three kinds (THEORY §9): functions of (d, v); laws with a state z whose rate is an expression, dz/dt = g(z, d, v)
(Bouc-Wen); and the two operators of dry friction and play, which depend on the order of the elongations only:

    stop   z follows d but stays within ±g       a spring in series with a slider: the Jenkins element
    play   z follows d but lags by up to g       backlash

or sums of such operators, z = Σ_j w_j z_j with widths s_j, both functions of the constants (Iwan's element).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.errors import ModelError
from dashpot.model.nonlinear.expression import Dual, Exponents, Expression, dimensions, parse

Operator = Literal["", "stop", "play"]


@dataclass(frozen=True)
class NamedLaw:
    """A usual law: its expression of d and v, or of its state z, and what its constants are."""

    text: str
    rate: str = ""
    operator: Operator = ""
    constants: tuple[str, ...] = ()
    pure: Mapping[str, tuple[float, ...]] = field(
        default_factory=dict
    )  # constants without a unit: values to begin with


_BRISTLE = "v - abs(v)*z/(slip*(1 + (ratio - 1)*exp(-(v/vs)**2)))"
_ANYWHERE: Mapping[str, NamedLaw] = {
    "coulomb": NamedLaw("tanh(v/v0)"),
    "stribeck": NamedLaw("tanh(v/v0)*(1 + (ratio - 1)*exp(-(v/vs)**2))"),
    "gap": NamedLaw("max(d - gap, 0) + min(d + gap, 0)"),
    "one-sided": NamedLaw("max(d - gap, 0)"),
    "bilinear": NamedLaw("max(d, 0) + ratio*min(d, 0)"),
    "jenkins": NamedLaw("z", operator="stop", constants=("slip",)),
    "iwan": NamedLaw(
        "z",
        operator="stop",
        constants=("slip", "chi", "beta"),
        pure=MappingProxyType({"chi": (-0.75, -0.5, -0.2), "beta": (0.1, 0.5, 2.0)}),
    ),
    "backlash": NamedLaw("z", operator="play", constants=("gap",)),
    "bouc-wen": NamedLaw("z", rate="v - (gamma*abs(v)*sign(z) + delta*v)*abs(z)**nu"),
    "maxwell": NamedLaw("z", rate="v - z/tau"),
    # Canudas de Wit et al. 1995, IEEE Transactions on Automatic Control 40, 419: σ₀ is the parameter, σ₁ is σ₀ tau, σ₂
    # a damper in parallel; g(v)/σ₀ goes from ratio · slip of bristles that begin to slide to slip.
    "lugre": NamedLaw(f"z + tau*({_BRISTLE})", rate=_BRISTLE),
}
SPRING_LAWS: Mapping[str, NamedLaw] = MappingProxyType(
    {
        "square": NamedLaw("d**2"),
        "quadratic": NamedLaw("d*abs(d)"),
        "cubic": NamedLaw("d**3"),
        "quintic": NamedLaw("d**5"),
        **_ANYWHERE,
    }
)
DAMPER_LAWS: Mapping[str, NamedLaw] = MappingProxyType(
    {"quadratic": NamedLaw("v*abs(v)"), "cubic": NamedLaw("v**3"), **_ANYWHERE}
)


@dataclass(frozen=True)
class Constant:
    """An inner constant of a law; without a value it is unknown, with a value and an sd it has a prior."""

    name: str
    value: float | None = None
    sd: float | None = None
    guess: float | None = None
    lower: float | None = None
    upper: float | None = None

    @property
    def unknown(self) -> bool:
        """Whether it is estimated."""
        return self.value is None or self.sd is not None


# Iwan's element after Segalman 2005, Journal of Applied Mechanics 72, 752: Jenkins elements in parallel whose slips φ
# have the density R φ^χ up to φ_max, and one more there. Of stiffness K_T = 1 before it slips and of the force
# F_S = K_T · slip when all of it does,
#
#     φ_max = slip (1 + β)/(β + (χ + 1)/(χ + 2))      the shares 1/(1 + β) of K_T of all, β/(1 + β) of the last.
#
# The density is cut at edges that shrink in proportion; each piece is one Jenkins element of its stiffness and force.

PIECES = 12  # into which the density is cut


def _iwan(slip: Complex, chi: Complex, beta: Complex) -> tuple[Complex, Complex]:
    """Weights and slips of the pieces (..., PIECES + 1), of constants (...,)."""
    # χ > −1 has a finite stiffness; edges that shrink to 0.65: elongations from 0.6 % of φ_max on make something slip
    chi = np.where(chi.real < -0.99, np.nan, chi)
    edges = np.concatenate([[0.0], 0.65 ** np.arange(PIECES - 1.0, -1, -1)])
    with np.errstate(all="ignore"):
        most = slip * (1 + beta) / (beta + (chi + 1) / (chi + 2))
        stiffness, force = (
            np.diff(np.where(edges > 0, edges ** (chi[..., None] + more), 0.0), axis=-1) for more in (1, 2)
        )
        slips = ((chi + 1) / (chi + 2))[..., None] * force / stiffness
        weights = np.concatenate([stiffness, beta[..., None]], axis=-1) / (1 + beta)[..., None]
        return weights, most[..., None] * np.concatenate([slips, np.ones_like(beta)[..., None]], axis=-1)


@dataclass(frozen=True)
class Sliders:
    """The operators of a law: weights and widths (..., J), and their slopes along the constants (..., J, G)."""

    weights: Real
    widths: Real
    by_weights: Real
    by_widths: Real


@dataclass(frozen=True)
class ForceLaw:
    """A nonlinear law.

    text        as the rig file writes it: an expression or a name
    expression  unit force of d, v and, where there is a state, z
    rate        dz/dt of z, d and v, where the state follows a differential equation
    operator    "stop" or "play", where the state follows from the order of the elongations
    constants   in the order of their first use
    """

    text: str
    expression: Expression
    constants: tuple[Constant, ...] = ()
    rate: Expression | None = None
    operator: Operator = ""

    @property
    def has_state(self) -> bool:
        """Whether the force depends on more than the present d and v."""
        return self.rate is not None or bool(self.operator)

    @property
    def _named(self) -> NamedLaw:
        return _ANYWHERE.get(self.text.strip().lower(), NamedLaw(""))

    @property
    def pure(self) -> Mapping[str, tuple[float, ...]]:
        """Values to begin with of constants without a unit, by name."""
        return self._named.pure

    @property
    def states(self) -> int:
        """Numbers that the force depends on in addition to the present d and v."""
        return (PIECES + 1 if self.pure else 1) if self.has_state else 0

    def sliders(self, g: Real) -> Sliders:
        """The operators of a law of stop or play, for constants g (..., G)."""
        count = g.shape[-1]
        if not self.pure:
            one = np.zeros((*g.shape[:-1], 1, count))
            one[..., 0] = 1.0
            return Sliders(np.ones((*g.shape[:-1], 1)), g[..., :1], 0 * one, one)
        # Exact slopes of analytic functions: Im f(g + ih)/h
        h = 1e-30
        weights, widths = _iwan(*np.moveaxis(g + 0j, -1, 0))
        along = [_iwan(*np.moveaxis(g + 1j * h * unit, -1, 0)) for unit in np.eye(count)]
        by_weights, by_widths = (np.stack([each[k].imag / h for each in along], axis=-1) for k in (0, 1))
        return Sliders(weights.real, widths.real, by_weights, by_widths)

    @cached_property
    def smooth(self) -> bool:
        """Whether the force is a polynomial of d and v, so that few harmonics tell it."""
        return not self.has_state and not self.expression.functions

    @cached_property
    def positive(self) -> frozenset[str]:
        """Constants that make sense above 0 only: gaps, slips and speeds of the usual laws, and what is divided by."""
        usual = self.text.strip().lower() in {**SPRING_LAWS, **DAMPER_LAWS}
        lengths = (
            {name for name, (metre, _) in self.exponents[1].items() if metre > 0} if usual else set[str]()
        )
        return frozenset(lengths | self.expression.divisors) & frozenset(self.constant_names)

    @cached_property
    def constant_names(self) -> tuple[str, ...]:
        """Names of the constants, in order."""
        return tuple(constant.name for constant in self.constants)

    @cached_property
    def exponents(self) -> tuple[Exponents, Mapping[str, Exponents]]:
        """Powers of metre and second of the unit force and of each constant."""
        known: dict[str, Exponents] = {"d": (1.0, 0.0), "v": (1.0, -1.0)}
        if self.operator:
            pure = self._named.pure
            return (1.0, 0.0), {
                name: (0.0, 0.0) if name in pure else (1.0, 0.0) for name in self.constant_names
            }
        if self.rate is None:
            return dimensions(self.expression, known)
        known["z"] = (1.0, 0.0)
        of_law = dimensions(self.expression, known)
        return of_law[0], {**dimensions(self.rate, known)[1], **of_law[1]}

    def __call__(self, d: Real, v: Real, z: Real, constants: Real) -> Dual:
        """Unit force and its derivatives by name; `constants` (..., G) broadcast against d, v, z ."""
        return self.expression(self.values(d, v, z, constants))

    def values(self, d: Real, v: Real, z: Real, constants: Real) -> dict[str, Real]:
        """All that expressions of this law may name; d, v, z of one shape (...,), constants (..., constants of it)."""
        named = {name: constants[..., j, None] for j, name in enumerate(self.constant_names)}
        return {"d": d, "v": v, "z": z, **named}

    def with_constants(self, constants: Sequence[Constant]) -> ForceLaw:
        """The same law with other knowledge of its constants, matched by name."""
        named = {constant.name: constant for constant in constants}
        return replace(self, constants=tuple(named.get(c.name, c) for c in self.constants))


def force_law(text: str, constants: Sequence[Constant] = (), *, damper: bool = False) -> ForceLaw:
    """The law that a rig file calls `text`: a usual name or an expression; unnamed constants are unknown.

    Raises ModelError if it cannot be read, names what is not given, or is not finite at rest.
    """
    usual = (DAMPER_LAWS if damper else SPRING_LAWS).get(text.strip().lower())
    expression = parse(text if usual is None else usual.text)
    rate = parse(usual.rate) if usual is not None and usual.rate else None
    state = usual is not None and (rate is not None or bool(usual.operator))
    names = [*expression.names, *(rate.names if rate else ()), *(usual.constants if usual else ())]
    # The names that are constants, in order, each once
    wanted = [name for name in dict.fromkeys(names) if name not in ({"d", "v", "z"} if state else {"d", "v"})]
    given = {constant.name: constant for constant in constants}
    complete = usual is None
    missing = [name for name in wanted if name not in given]
    meant = get_close_matches(text.strip().lower(), {**SPRING_LAWS, **DAMPER_LAWS}, 1)
    if complete and missing and meant:
        raise ModelError(f"{text!r} is not a law", cure=f'write law = "{meant[0]}"')
    if complete and missing:
        raise ModelError(
            f"the law {text!r} names {', '.join(missing)}",
            cure=f'give {missing[0]} next to the law, as a number or "unknown"; d is the elongation, v its rate',
        )
    excess = [name for name in given if name not in wanted]
    if excess:
        raise ModelError(
            f"the law {text!r} has no constant {', '.join(excess)}",
            cure=f"its constants are {', '.join(wanted)}" if wanted else "it has none: remove it",
        )
    if not state and not {"d", "v"} & set(expression.names):
        raise ModelError(
            f"the law {text!r} depends on neither d nor v", cure='write one that does, such as "d**3"'
        )
    constants = tuple(given.get(name, Constant(name)) for name in wanted)
    law = ForceLaw(text, expression, constants, rate, "" if usual is None else usual.operator)
    law.exponents  # noqa: B018  # raises where no units make sense
    # Force and slopes are finite at rest
    middle, zero = np.array([_typical(constant) for constant in law.constants]), np.zeros(1)
    at = law(zero, zero, zero, middle)
    numbers = [at.value, *(slope for name, slope in at.slopes.items() if name in ("d", "v"))]
    if not all(np.all(np.isfinite(number)) for number in numbers):
        raise ModelError(
            f"the law {law.text!r} divides by zero, overflows or has no finite slope at rest",
            cure="write it so that force and slope are finite at d = 0, v = 0",
        )
    if not state:
        _require_steady(law)
    return law


def _require_steady(law: ForceLaw) -> None:
    """Raises ModelError if a law is no number on one side of rest, or jumps where d or v changes its sign.

    No settled motion can be followed over a jump.
    """
    middle = np.array([_typical(constant) for constant in law.constants])

    def force(d: Real, v: Real) -> Real:
        with np.errstate(all="ignore"):
            value = law(d.ravel(), v.ravel(), d.ravel(), middle).value
        return np.broadcast_to(value, d.size).reshape(d.shape)

    # m, m/s: about rest, and nothing but a sign
    near, hardly = np.array([-1e-6, 0.0, 1e-6]), np.array([-1e-150, 1e-150])
    around = force(*np.meshgrid(near, near))
    if np.any(np.isnan(around)):
        raise ModelError(
            f"the law {law.text!r} is not defined where d or v is below zero",
            cure='write it with abs(d) and sign(d), such as "sign(d)*abs(d)**1.5"',
        )
    along_d = force(*np.meshgrid(hardly, near))
    along_v = force(*np.meshgrid(near, hardly, indexing="ij"))
    for name, both in (("d", along_d), ("v", along_v)):
        # Less than a millionth of the force is rounding.
        if np.any(np.abs(np.diff(both, axis=1)) > 1e-6 * np.max(np.abs(around))):
            raise ModelError(
                f"the law {law.text!r} jumps where {name} changes its sign",
                cure=f"smooth it: write tanh({name}/{name}0) for sign({name}), with a small {name}0",
            )


def _typical(constant: Constant) -> float:
    """A number to try a constant with."""
    for number in (constant.value, constant.guess):
        if number is not None:
            return number
    low = 0.0 if constant.lower is None else constant.lower
    return low + 1.0 if constant.upper is None else (low + constant.upper) / 2


def unit_of(exponents: Exponents, force: bool = False, angle: bool = False) -> str:
    """SI unit of m^a s^b, or with `force` of a parameter whose law has it: N (or N·m) divided by it."""
    length = "rad" if angle else "m"
    metre, second = exponents
    if not force:
        above = [_raised(length, metre)] * (metre > 0) + [_raised("s", second)] * (second > 0)
        below = [_raised(length, -metre)] * (metre < 0) + [_raised("s", -second)] * (second < 0)
    else:
        above = [
            "N·m" if angle else "N",
            *([_raised(length, -metre)] * (metre < 0)),
            *([_raised("s", -second)] * (second < 0)),
        ]
        below = [_raised(length, metre)] * (metre > 0) + [_raised("s", second)] * (second > 0)
    top = "·".join(above) if above else "1"
    return top if not below else f"{top}/{'/'.join(below)}"


_RAISED = str.maketrans("0123456789.-", "⁰¹²³⁴⁵⁶⁷⁸⁹·⁻")


def _raised(letter: str, power: float) -> str:
    return letter if power == 1 else letter + f"{power:g}".translate(_RAISED)
