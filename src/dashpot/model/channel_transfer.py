"""What the likelihood asks of a rig: its channels as functions of the inputs, of the whole rig or a reduced one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from dashpot.arrays import Complex, Real

if TYPE_CHECKING:
    from dashpot.model.observation import ObservationModel


class ChannelTransfer(Protocol):
    """The channels as functions of the inputs, whoever computed them."""

    @property
    def G(self) -> Complex:
        """y = G q, (..., lines, channels, r + s)."""

    def amplitudes(self, q: Complex) -> Complex:
        """y under inputs q (..., lines, r + s); (..., lines, channels)."""

    def slopes(self, q: Complex) -> Complex:
        """∂y/∂ψ at fixed inputs; (..., lines, channels, M)."""

    def calibrated(self, kappa: Complex, psi: Real) -> ChannelTransfer:
        """The same with calibrations κ (..., lines, channels, 1) at ψ."""


class Reduced(Protocol):
    """A rig on the span of few motions."""

    @property
    def size(self) -> int:
        """How many."""

    def transfer(self, view: ObservationModel, theta: Real) -> ChannelTransfer:
        """The channels at θ (..., unknowns)."""
