"""Measured modes: natural frequencies, damping ratios and mode shapes with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.errors import DataError
from dashpot.io.words import listed, shown


@dataclass(frozen=True)
class ModalData:
    """Oscillating modes from a modal test; arrays may have leading batch axes (repeats).

    points            names of the points of the shapes, any of the rig's coordinates; may be none
    frequency_hz      (..., modes)            |λ| / 2π
    damping_ratio     (..., modes)            −Re λ / |λ|; NaN where not measured
    covariance        (modes, 2, 2)           of (frequency, damping ratio)
    shapes            (..., modes, points)    each with an arbitrary complex scale; NaN where not measured
    shape_covariance  (modes, points, points) E[Δ Δᴴ] of circular noise: half each for real and imaginary part
    """

    points: tuple[str, ...]
    frequency_hz: Real
    damping_ratio: Real
    covariance: Real
    shapes: Complex
    shape_covariance: Complex

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(self.points))
        freeze(self)
        count, points = self.modes, len(self.points)
        expected = {
            "damping_ratio": (self.damping_ratio.shape, self.frequency_hz.shape),
            "covariance": (self.covariance.shape, (count, 2, 2)),
            "shapes": (self.shapes.shape, (*self.frequency_hz.shape, points)),
            "shape_covariance": (self.shape_covariance.shape, (count, points, points)),
        }
        for name, (shape, wanted) in expected.items():
            if shape != wanted:
                raise DataError(f"{name} has shape {shape}, it must be {wanted}")
        if count == 0:
            raise DataError("there are no modes", cure="give at least one")
        if not np.all((self.frequency_hz > 0) & np.isfinite(self.frequency_hz)):
            raise DataError("a natural frequency is not positive and finite", cure="correct it")
        damping = self.damping_ratio[~np.isnan(self.damping_ratio)]
        if not np.all((damping > -1) & (damping < 1)):
            raise DataError(
                "a damping ratio is not between −1 and 1: such a mode does not oscillate", cure="leave it out"
            )

    @property
    def modes(self) -> int:
        """Number of modes."""
        return int(self.frequency_hz.shape[-1])

    @property
    def eigenvalues(self) -> Complex:
        """λ = 2πf (−ζ + j √(1 − ζ²)), (..., modes), 1/s; ζ = 0 where not measured."""
        zeta = np.nan_to_num(self.damping_ratio)
        return 2 * np.pi * self.frequency_hz * (-zeta + 1j * np.sqrt(1 - zeta**2))


def named_points(coordinates: Sequence[str], channels: Iterable[Channel]) -> dict[str, tuple[str, float]]:
    """What points of shapes may be called: coordinates, and motions that show one of them alone, with their factors."""
    names = {name: (name, 1.0) for name in coordinates}
    for channel in channels:
        if channel.quantity is not Quantity.FORCE and len(channel.of) == 1:
            ((point, factor),) = channel.of.items()
            if point in coordinates:
                names.setdefault(channel.name, (point, factor))
    return names


def at_coordinates(
    modes: ModalData, coordinates: Sequence[str], channels: Iterable[Channel] = (), source: str = ""
) -> ModalData:
    """The same modes with the coordinates for their points, in the order of these; names as for `named_points`.

    Raises DataError for a point that is none, and for two of one coordinate.
    """
    if not set(modes.points) - set(coordinates):
        return modes
    names, found = named_points(coordinates, channels), dict[str, tuple[int, float]]()
    for i, name in enumerate(modes.points):
        if name not in names:
            what = f"{shown(name)} is not a coordinate of the rig, nor a channel that shows one alone"
            raise DataError(what, source, f"the coordinates are {listed(coordinates)}")
        point, factor = names[name]
        if point in found:
            both = f"{shown(modes.points[found[point][0]])} and {shown(name)}"
            raise DataError(f"{both} show {shown(point)}: the same point twice", source, "leave one out")
        found[point] = (i, factor)
    points = tuple(point for point in coordinates if point in found)
    at, by = (np.array([found[point][k] for point in points]) for k in (0, 1))
    V = modes.shape_covariance[:, at[:, None], at] / np.outer(by, by)
    return replace(modes, points=points, shapes=modes.shapes[..., at] / by, shape_covariance=V)


def independent_modes(
    points: tuple[str, ...],
    frequency: tuple[Real, Real],
    damping: tuple[Real, Real],
    shapes: tuple[Complex, Real],
) -> ModalData:
    """Modal data whose errors are independent: numbers and their standard deviations, NaN for 0.

    That of a shape, (modes, points), is of the real and of the imaginary part, each.
    """
    covariance = np.zeros((len(frequency[0]), 2, 2))
    for i, (_, sd) in enumerate((frequency, damping)):
        covariance[:, i, i] = np.nan_to_num(sd) ** 2
    V = 2 * np.nan_to_num(shapes[1])[:, :, None] ** 2 * np.eye(len(points))
    return ModalData(points, frequency[0], damping[0], covariance, shapes[0], V.astype(complex))


def of_eigenvalues(
    points: tuple[str, ...],
    eigenvalues: Complex,
    covariance: Real,
    shapes: Complex,
    shape_covariance: Complex,
) -> ModalData:
    """Modal data from eigenvalues (..., modes), 1/s, and the covariance (modes, 2, 2) of (Re λ, Im λ).

    With repeats, the covariance of frequency and damping is taken at the mean eigenvalue.
    """
    size = np.abs(eigenvalues)
    mean = np.mean(eigenvalues.reshape(-1, eigenvalues.shape[-1]), axis=0)
    x, y, r = mean.real, mean.imag, np.abs(mean)
    slope = np.array([[x / r / (2 * np.pi), y / r / (2 * np.pi)], [-(y**2) / r**3, x * y / r**3]])
    slope = np.moveaxis(slope, -1, 0)
    return ModalData(
        points,
        size / (2 * np.pi),
        -eigenvalues.real / size,
        slope @ covariance @ np.swapaxes(slope, -1, -2),
        shapes,
        shape_covariance,
    )
