"""Laws of elements: how the unit force follows from the elongation (THEORY §1).

A law is a frozen value and the only place that knows its physics: the unit force, the unit of the parameter, the
matrix that it enters, its usual size and sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.units import si_unit

Scalar = TypeVar("Scalar", float, Real)

_POWERS_OF_J = (1.0, 1j, -1.0, -1j)


@dataclass(frozen=True)
class Law:
    """A linear law: the unit force is a = φ(ω) δ with φ(ω) = (jω)^power, turned by j sign(ω) if `hysteretic`.

    `power` is the derivative of the elongation δ that the unit force follows; `matrix` the letter of the matrix that
    the element enters; `quantity` what `dashpot.units` calls its parameter.  `dissipative` laws take energy out of the
    motion, and their parameters go with the damping ratio.  Below zero the parameter of no linear law has a meaning.
    """

    power: int
    matrix: Literal["M", "C", "K", "H"]
    quantity: str
    dissipative: bool = False
    hysteretic: bool = False

    def factor(self, omega: Real) -> Complex:
        """φ(ω), of the shape of `omega`, rad/s."""
        phi: Complex = _POWERS_OF_J[self.power % 4] * omega.astype(np.complex128) ** self.power
        return phi * (1j * np.sign(omega)) if self.hysteretic else phi

    def pole_factor(self, poles: Complex) -> Complex:
        """φ at complex rates λ, 1/s, of their shape: λ^power.  A hysteretic law has a meaning at Im λ > 0 alone."""
        phi: Complex = poles**self.power
        return 1j * phi if self.hysteretic else phi

    def unit(self, angular: bool = False) -> str:
        """SI unit of the parameter; `angular` where all points that the element joins are angles."""
        return si_unit(self.quantity, angular)

    def typical_size(self, mass: Scalar, rate: Scalar, damping_ratio: Scalar) -> Scalar:
        """Size of a parameter that goes with a mass (kg), a natural frequency (rad/s) and a damping ratio.

        m ω^(2 − power), times 2ζ for what dissipates: the terms of m ẍ + 2ζ m ω ẋ + m ω² x.
        """
        size = mass * rate ** (2 - self.power)
        return 2 * damping_ratio * size if self.dissipative else size
