"""How motions change with the samples of their inputs."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.estimate.nonlinear.records import RecordData, shown_outputs
from dashpot.model.nonlinear.integration import Integrator, Motion, forcing
from dashpot.model.nonlinear.shooting import (
    ChainSolver,
    Tangent,
    integrate,
    spline_coefficients,
    spline_transposed,
    tangent,
)
from dashpot.model.observation import observation_model
from tests.nonlinear_rigs import two_masses

STEP, SAMPLES, SUBSTEPS = 1 / 200, 60, 2
CHANNELS = (
    Channel("x1", {"x1": 1.0}),
    Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
    Channel("r", {"x1": 1.0, "u": -1.0}),
    Channel("v", {"x2": 1.0, "u": -1.0}, Quantity.VELOCITY),
    Channel("ar", {"x1": 1.0, "u": -1.0}, Quantity.ACCELERATION),
    Channel("F", {"u": 1.0}, Quantity.FORCE),  # the reaction of the base
)


def shown(law: str, u: np.ndarray) -> tuple[Integrator, Motion, np.ndarray]:
    model, theta = two_masses(law)
    view = observation_model(model, CHANNELS, np.ones(1))
    machine = Integrator(model, theta, forcing(STEP, u), SUBSTEPS)
    motion = integrate(machine, np.zeros(machine.states))
    assert motion.closed
    count = len(CHANNELS)
    data = RecordData(
        "", STEP, CHANNELS, u, np.zeros((len(u), count)), view.on_x, view.on_q,
        view.force, tuple(int(d) for d in view.derivative), (-1,) * count, (False,) * count,
    )  # fmt: skip
    return machine, motion, shown_outputs(machine, data, motion)[0]


def around(law: str, u: np.ndarray) -> Tangent:
    machine, motion, _ = shown(law, u)
    view = observation_model(machine.model, CHANNELS, np.ones(1))
    return tangent(machine, motion, view.on_x, view.on_q, tuple(int(d) for d in view.derivative), view.force)


def base() -> np.ndarray:
    return 3e-4 * np.cumsum(np.random.default_rng(0).standard_normal((SAMPLES, 1)), axis=0)


def test_cubics_are_those_of_the_spline_and_their_transpose_is_one() -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal((9, 2))
    c = spline_coefficients(values)
    np.testing.assert_allclose(c, forcing(1.0, values).coefficients, atol=1e-13)
    weight = rng.standard_normal(c.shape)
    assert np.sum(weight * c) == pytest.approx(np.sum(spline_transposed(weight) * values), rel=1e-12)


@pytest.mark.parametrize("law", ["cubic", "coulomb", "bouc-wen", "jenkins"])
def test_changes_along_the_inputs_are_those_of_differences(law: str) -> None:
    """Central differences of the whole motion, of displacements, rates and accelerations, also against the base."""
    u, change = base(), np.random.default_rng(2).standard_normal((SAMPLES, 1))
    ends = [shown(law, u + way * 1e-8 * change)[2] for way in (-1, 1)]
    slope = (ends[1] - ends[0]) / 2e-8
    mine = around(law, u).times(change[..., None])[..., 0]
    assert np.all(np.abs(mine - slope).max(axis=0) < 1e-7 * np.abs(slope).max(axis=0))


def test_the_transpose_is_one() -> None:
    rng = np.random.default_rng(3)
    along = around("cubic", base())
    change, outputs = rng.standard_normal((SAMPLES, 1, 2)), rng.standard_normal((SAMPLES, len(CHANNELS), 2))
    there = np.sum(along.times(change) * outputs, axis=(0, 1))
    back = np.sum(along.transposed(outputs) * change, axis=(0, 1))
    np.testing.assert_allclose(there, back, rtol=1e-11)


def test_the_chain_solver_is_the_inverse_of_the_covariance() -> None:
    along = around("cubic", base())
    weight, sd = np.array([1e5, 2e2, 1e5, 4e3, 2e2, 3.0]), np.array([2e-5])
    each = np.eye(SAMPLES)[:, None, :]
    reach = sd * weight[:, None] * along.times(each)
    flat = reach.reshape(SAMPLES * len(CHANNELS), SAMPLES)
    columns = np.random.default_rng(0).standard_normal((SAMPLES, len(CHANNELS), 3))
    dense = np.linalg.solve(np.eye(len(flat)) + flat @ flat.T, columns.reshape(len(flat), 3))
    solved = ChainSolver(along, weight, sd).solve(columns)
    np.testing.assert_allclose(solved.reshape(len(flat), 3), dense, atol=1e-8 * np.abs(dense).max())
