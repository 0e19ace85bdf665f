"""The sizes of the noise of outputs and inputs, from what the motion of whole records leaves over (THEORY §8, c).

Restricted likelihood: the residuals less what the unknowns can explain have a covariance in which each size has a part
of its own.  The sums of squares that measure a size are compared with those of noise that is drawn to the present sizes
and goes the same way, so nothing has to be known of the colours that the rig gives it; average information gives the
step.  Source: Gilmour, Thompson and Cullis (1995), Biometrics 51, 1440.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.estimate.nonlinear.uncertain_inputs import LinearisedRecord
from dashpot.numerics.small_systems import solve_scaled

DRAWS = 16  # of noise: sizes vary by 1/√DRAWS of their own standard deviation with the draws


@dataclass(frozen=True)
class DrawnNoise:
    """What P = V⁻¹ less the unknowns makes of the residuals and of draws of noise, for each record.

    data (samples, channels), draws (samples, channels, K); errors, drawn_errors the same carried back to the inputs.
    """

    data: tuple[Real, ...]
    draws: tuple[Real, ...]
    errors: tuple[Real, ...]
    drawn_errors: tuple[Real, ...]


@dataclass(frozen=True)
class Sizes:
    """Slopes of the restricted ln L along the logarithms of the variances of channels and inputs, and information."""

    slope: Real
    information: Real


def unknowns_matrix(linear: Sequence[LinearisedRecord], prior: Real) -> Real:
    """Information on all unknowns, (M, M), from the records and the prior's precision (M,)."""
    matrix: Real = np.diag(prior)
    for record in linear:
        part = record.normal_equations()
        matrix[np.ix_(part.chosen, part.chosen)] += part.matrix
    return matrix


def drawn_noise(linear: Sequence[LinearisedRecord], prior: Real, draws: int = DRAWS) -> DrawnNoise:
    """Of records at the end of a search; prior (M,) the unknowns' stated precision."""
    rng = np.random.default_rng(0)
    noises = []
    for record in linear:
        N, c = record.residual.shape
        white = rng.standard_normal((N, c, draws))
        moved = rng.standard_normal((N, record.covariance.known.spread.shape[1], draws))
        noises.append(white + record.covariance.reach(moved))
    draws_cleared = cleared(linear, prior, noises)
    data = tuple(record.score for record in linear)
    back = [record.covariance.back for record in linear]
    return DrawnNoise(
        data,
        tuple(draws_cleared),
        tuple(carry(z[..., None])[..., 0] for carry, z in zip(back, data, strict=True)),
        tuple(carry(z) for carry, z in zip(back, draws_cleared, strict=True)),
    )


def sizes_of_noise(linear: Sequence[LinearisedRecord], prior: Real, noise: DrawnNoise) -> Sizes:
    """Channels first, then inputs; all variances as they are now."""
    squares = np.concatenate([_squares(noise.data), _squares(noise.errors)])
    expected = np.concatenate([_squares(noise.draws), _squares(noise.drawn_errors)]).mean(axis=-1)
    working = [
        np.concatenate([_apart(z), record.covariance.reach(_apart(w))], axis=-1)
        for record, z, w in zip(linear, noise.data, noise.errors, strict=True)
    ]
    solved = cleared(linear, prior, working)
    parts = [np.tensordot(a, b, axes=([0, 1], [0, 1])) for a, b in zip(working, solved, strict=True)]
    information: Real = np.sum(parts, axis=0) / 2
    return Sizes((squares - expected) / 2, (information + information.T) / 2)


def information_on_inputs(linear: Sequence[LinearisedRecord], prior: Real, noise: DrawnNoise) -> Real:
    """Information on the logarithm of each input's variance alone, (q,), as noise of the present sizes has it."""
    total = []
    for j in range(noise.errors[0].shape[1]):
        only = np.arange(noise.errors[0].shape[1]) == j
        columns = [
            record.covariance.reach(w * only[:, None])
            for record, w in zip(linear, noise.drawn_errors, strict=True)
        ]
        solved = cleared(linear, prior, columns)
        squares = [np.sum(a * b) for a, b in zip(columns, solved, strict=True)]
        total.append(float(np.sum(squares)) / (2 * columns[0].shape[2]))
    return np.array(total)


def cleared(linear: Sequence[LinearisedRecord], prior: Real, columns: Sequence[Real]) -> list[Real]:
    """P of columns (samples, channels, K) that run through all records: V⁻¹ of them less what unknowns explain."""
    solved = [record.weighed(each) for record, each in zip(linear, columns, strict=True)]
    right = np.zeros((len(prior), columns[0].shape[2]))
    for record, each in zip(linear, solved, strict=True):
        right[record.chosen] += np.tensordot(record.slopes, each, axes=([0, 1], [0, 1]))
    matrix = unknowns_matrix(linear, prior)
    values = solve_scaled(matrix, right.T).T
    return [
        each - record.weighed_slopes @ values[record.chosen]
        for record, each in zip(linear, solved, strict=True)
    ]


def _squares(parts: Sequence[Real]) -> Real:
    """Of columns (samples, sizes, …) over all records: (sizes, …)."""
    total: Real = sum(np.sum(part**2, axis=0) for part in parts)
    return total


def _apart(columns: Real) -> Real:
    """(samples, k) as k columns of which each has one channel alone, (samples, k, k)."""
    return columns[:, :, None] * np.eye(columns.shape[1])
