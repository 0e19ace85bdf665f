"""Nonlinear elements where all motion was measured, by the equation of motion: nothing is balanced or searched.

A candidate's force in the measured motion is one more column of a regression, weighed by what noise of the motion
leaves in the equation.  A rig that is far off, dwells beside a fold and lost branches do not matter here, as they do
where a candidate is scored beside the fit of a rig without it (THEORY §9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.check.diagnosis.candidate_elements import ScoredElement, at_each_scale
from dashpot.errors import DashpotError
from dashpot.estimate.linear.auxiliary_model import equation_covariance
from dashpot.estimate.linear.gram import known_side
from dashpot.estimate.linear.least_squares import equation
from dashpot.estimate.nonlinear.regression import MeasuredMotion, measured_motion, regressors_of
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.numerics.projection import orthonormal, real_rows

SOFT = 0.01  # of each amplitude: what harmonics that were not measured leave out of a force
ROUNDS = 3  # of weights, which depend on the values
APART = 1e-4  # part of a column that the rig's own unknowns must leave
NEAR = 1e-4  # relative step of differences along constants inside the rig's own laws
FAR = 2.0  # times such a constant, or one over it: as far as one round moves it


def scored_by_equation(data: Prepared, psi: Real, elements: Sequence[Element]) -> list[ScoredElement]:
    """The best candidate of each place and law, with all values of the rig beside it, the best first.

    data: of one repeat, settled dwells of a rig without unknown calibrations; psi (M,) its best fit, from which the
    constants inside its own laws are moved.  [] where some motion is not seen.
    """
    model, states = data.model, data.states
    if states is None or len(psi) > len(model.unknowns) or not elements:
        return []
    every = [replace(e, name=f"{e.name} {k}") for k, e in enumerate(at_each_scale(elements))]
    extended = replace(model, elements=(*model.elements, *every))
    try:
        motion = measured_motion(data.of_rig(extended))
        own = measured_motion(data) if len(model.nonlinear) else None
    except DashpotError:
        return []
    count = len(model.elements)
    added = motion.unit_forces(extended.constants_map[1])[..., count:]
    columns = added[0, :, None, :] * extended.B[count:].T
    scored = _Regression(data, _softened(states), own, columns).scored(psi, every)
    best: dict[str, ScoredElement] = {}
    for candidate in sorted(scored, key=lambda each: -each.fall):
        name = candidate.element.name.rsplit(" ", 1)[0]
        best.setdefault(name, replace(candidate, element=replace(candidate.element, name=name)))
    return list(best.values())


def _softened(states: States) -> States:
    """The states with the noise that unmeasured harmonics amount to."""
    soft = (SOFT * np.abs(states.z)) ** 2
    return replace(states, covariance=states.covariance + soft[..., None] * np.eye(soft.shape[-1]))


@dataclass(frozen=True)
class _Regression:
    """The equation of motion at all lines; columns (lines, n, candidates): unit forces on the coordinates.

    own: the measured motion, where the rig has laws of its own.
    """

    data: Prepared
    states: States
    own: MeasuredMotion | None
    columns: Complex

    def scored(self, psi: Real, elements: Sequence[Element]) -> list[ScoredElement]:
        """All candidates, weighed with the values that the best one asks for."""
        scored: list[ScoredElement] = []
        for _ in range(ROUNDS):
            scored = self._weighed_at(psi, elements)
            if not scored:
                return []
            best = max(scored, key=lambda each: each.fall)
            assert best.psi is not None
            psi = best.psi
        return scored

    def _weighed_at(self, psi: Real, elements: Sequence[Element]) -> list[ScoredElement]:
        """With weights of the values ψ (M,)."""
        model = self.data.model
        Phi, h = self._of_the_rig(psi)
        Se = equation_covariance(model, model.parameters(psi[None]), self.states)
        every = np.concatenate([Phi[0], h[0, ..., None], self.columns], axis=-1)
        try:
            white = np.linalg.solve(np.linalg.cholesky(Se[0]), every)
        except np.linalg.LinAlgError:
            return []
        rows = real_rows(white[None])[0]
        m = Phi.shape[-1]
        own, side, columns = rows[:, :m], rows[:, m], rows[:, m + 1 :]
        Q, back, _ = (part[0] for part in orthonormal(own[None]))
        residual, left = side - Q @ (Q.T @ side), columns - Q @ (Q.T @ columns)
        squares = np.sum(left**2, axis=0)
        apart = squares > APART**2 * np.sum(columns**2, axis=0)
        value = np.where(apart, left.T @ residual / np.where(apart, squares, 1.0), 0.0)
        theta = _within_reach(model, psi, back @ (Q.T @ (side[:, None] - value * columns)))
        chi2, dof = 2 * float(residual @ residual), max(len(side) - m - 1, 1)
        return [
            ScoredElement(element, 2 * float(p**2 * size), chi2, dof, float(p), values)
            for element, p, size, values, usable in zip(elements, value, squares, theta.T, apart, strict=True)
            if usable
        ]

    def _of_the_rig(self, psi: Real) -> tuple[Complex, Complex]:
        """Φ and h of the rig as it is, e = Φ θ − h, linear in the constants inside its laws about ψ (M,)."""
        model = self.data.model
        if self.own is None:
            return equation(model, self.states)
        constants, p = model.inner_constants(psi), model.parameters(psi)
        a = self.own.unit_forces(constants)
        Phi, h = regressors_of(model, a), known_side(model, a, self.own.f)
        along = model.constants_map[0]
        for column in np.flatnonzero(np.any(along, axis=0)):
            step = NEAR * max(abs(psi[column]), np.finfo(float).tiny)
            moved = self.own.unit_forces(constants + step * along[:, column])
            slope = ((moved - a) / step * p) @ model.B
            Phi[..., column] += slope
            h = h + slope * psi[column]
        return Phi, h


def _within_reach(model: Model, psi: Real, theta: Real) -> Real:
    """θ (unknowns, candidates) with constants inside laws no further from ψ (unknowns,) than slopes can tell."""
    inner = np.any(model.constants_map[0], axis=0)
    near = np.abs(psi[:, None])
    held: Real = np.where(inner[:, None], np.clip(theta, near / FAR, near * FAR), theta)
    return held
