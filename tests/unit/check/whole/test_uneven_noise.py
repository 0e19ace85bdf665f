"""Decays whose noise grows with the motion: neighbouring residuals are alike, and yet the rig is right."""

import numpy as np
import pytest

from dashpot.api import identify
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import matrices
from dashpot.model.network import Model
from tests.networks import network

STEP, SAMPLES = 1 / 200, 1000


def rig(stated_k1: float | None = None) -> Model:
    """Two masses, one weighed, on two springs with dampers beside them."""
    stated = f"={stated_k1}" if stated_k1 else ""
    return network("x1 x2", "", f"m1@x1=2 m2@x2 k1:x1-ground{stated} k2:x1-x2 c1:x1-ground c2:x1-x2")


def decay(seed: int) -> Record:
    """Accelerations with 2 % noise of themselves and 0.2 % of their largest, by the eigenvalues of the state."""
    rng = np.random.default_rng(seed)
    model = rig()
    of = matrices(model, model.parameters(np.array([1.0, 8000.0, 3000.0, 4.0, 2.0])))
    A = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(of.M, of.K), -np.linalg.solve(of.M, of.C)]]
    )
    values, vectors = np.linalg.eig(A)
    start = np.linalg.solve(vectors, np.array([0.003, 0.004, 0.05 * (seed % 6), 0.0]))
    time = STEP * np.arange(SAMPLES)
    motion = ((vectors * start) @ np.exp(values[:, None] * time)).T @ A.T
    clean = motion[:, 2:].real
    noise = 0.02 * np.abs(clean) + 0.002 * np.max(np.abs(clean))
    channels = tuple(Channel(f"a{i}", {f"x{i}": 1.0}, Quantity.ACCELERATION) for i in (1, 2))
    return Record(channels, time, clean + noise * rng.normal(size=clean.shape))


def reasons(estimate: Estimate) -> set[str]:
    return {reason.code for reason in estimate.assessment.reasons}


@pytest.mark.parametrize("seed", range(6))
def test_noise_that_grows_with_the_motion_is_no_misfit(seed: int) -> None:
    """Seeds 0 to 5; all six were "does not fit" while the likeness of neighbours counted by itself."""
    assert reasons(identify(rig(), decay(seed), diagnose=True)) <= {"noise_from_residuals"}


@pytest.mark.slow
def test_a_rig_that_is_another_one_does_not_fit_for_all_that() -> None:
    estimate = identify(rig(stated_k1=8400.0), decay(1), diagnose=True)
    assert estimate.assessment.verdict == "does not fit"
