"""Information of dwells of nonlinear rigs against the bound of an identification, and the drive that shows a law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.design import test_setup as harmonic_information
from dashpot.design.advise import drives_that_show
from dashpot.design.test_setup import Schedule, ShakerLimits, dwell_information, nominal_setup
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.nonlinear.objective import evaluate
from tests.nonlinear_rigs import motions, settled, two_masses

FREQUENCIES = np.array([2, 3, 4, 5, 6, 7, 8, 9.5, 11, 12.5, 14])
ALL = motions("x1", "x2", "u")


def with_noise(*sd):
    return tuple(replace(channel, noise=s) for channel, s in zip(ALL, sd, strict=True))


@pytest.mark.parametrize("input_noise", [0.0, 1e-6])
def test_information_is_that_of_an_identification(input_noise):
    model, theta = two_masses("cubic")
    channels, samples = with_noise(2e-6, 3e-6, input_noise), 500
    each = dwell_information(
        model, theta[None], channels, 2 * np.pi * FREQUENCIES, np.full((len(FREQUENCIES), 1), 1e-3 + 0j)
    )
    expected = np.sqrt(np.diagonal(np.linalg.inv(samples * np.sum(each[0], axis=0))))
    exact = settled(model, theta, ALL, FREQUENCIES, orders=(1, 2, 3, 4, 5))
    V = 4 / samples * np.diag([channel.noise**2 for channel in channels]) + 0j
    data = replace(exact, covariance=np.broadcast_to(V, (exact.lines, 3, 3)))
    assert np.allclose(identify(model, data, "ml").bound_sd, expected, rtol=1e-3)


def test_a_dwell_on_a_fold_tells_nothing():
    """Slopes are infinite there, of the motion and of what the noise of the input does to it."""
    model, theta = two_masses("cubic")
    at = 2 * np.pi * FREQUENCIES[:2]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(harmonic_information, "evaluate", _on_a_fold)
        each = dwell_information(
            model, theta[None], with_noise(2e-6, 3e-6, 1e-6), at, np.full((2, 1), 1e-3 + 0j)
        )
    assert not np.any(each[0, 0])
    assert np.all(np.linalg.eigvalsh(each[0, 1])[-3:] > 0)


def _on_a_fold(*arguments):
    """What harmonic balance gives, with infinite slopes in the first dwell."""
    at = evaluate(*arguments)
    at.J[:, :5], at.G[:, :5] = np.nan, np.nan
    return at


def test_a_weak_drive_does_not_show_a_law():
    model, theta = two_masses("cubic")
    setup = nominal_setup(model, with_noise(2e-6, 2e-6, 0.0), theta, amplitude=1e-3)
    count = len(FREQUENCIES)
    schedule = Schedule(FREQUENCIES, np.zeros(count, dtype=np.int64), np.full(count, 100.0))
    assert "q shows" in drives_that_show(setup, schedule)[0]
    faint = replace(setup, amplitude=1e-6)
    assert "q does not show" in drives_that_show(faint, schedule)[0]


def test_limits_of_what_is_not_proportional_to_the_drive_are_refused():
    model, theta = two_masses("cubic")
    setup = nominal_setup(model, with_noise(2e-6, 2e-6, 0.0), theta, limits=ShakerLimits(force=10.0))
    with pytest.raises(UsageError, match="limit of force holds for what is not proportional"):
        setup.drive(FREQUENCIES, np.zeros(len(FREQUENCIES), dtype=np.int64))
    moved = replace(setup, limits=ShakerLimits(stroke=1e-3, acceleration=4.0))
    drive = np.abs(moved.drive(FREQUENCIES, np.zeros(len(FREQUENCIES), dtype=np.int64))[:, 0])
    assert np.allclose(drive, np.minimum(1e-3, 4.0 / (2 * np.pi * FREQUENCIES) ** 2))
