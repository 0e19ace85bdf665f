"""The noise of amplitudes without standard deviations, from how they scatter over frequency."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.noise import with_local_noise
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.model.dynamics import response
from tests import rigs
from tests.two_masses import PUSHED, pushed_pair

RIG = pushed_pair("ground")
CHANNELS = (Channel("x1", {"x1": 1.0}), Channel("x2", {"x2": 1.0}), Channel("f", {"f": 1.0}, Quantity.FORCE))


def functions(lines: int, relative: float, seed: int = 0, truth: dict[str, float] = PUSHED) -> Spectrum:
    """Responses to a unit force from 2 to 14 Hz, with a share of noise and a constant one."""
    rng = np.random.default_rng(seed)
    hz = np.linspace(2, 14, lines)
    X = response(
        RIG, RIG.parameters(RIG.theta(truth)), 2 * np.pi * hz, np.zeros((lines, 0)), np.ones((lines, 1))
    )
    sd = relative * np.sqrt(np.abs(X) ** 2 + 0.01 * np.mean(np.abs(X) ** 2, axis=0))
    X = X + sd / np.sqrt(2) * (rng.normal(size=X.shape) + 1j * rng.normal(size=X.shape))
    y = np.concatenate([X, np.ones((lines, 1))], axis=1)
    return rigs.of_unknown_noise(rigs.stated(CHANNELS, hz, y, np.zeros((lines, 3, 3), dtype=complex)))


def test_the_noise_is_what_it_is() -> None:
    exact = functions(300, 0.0)
    size = np.abs(exact.amplitudes[:, :2])
    ratios = []
    for seed in range(20):
        lines = with_local_noise(functions(300, 0.02, seed))
        assert set(lines.noise) == {"smooth"}
        assert np.all(lines.covariance[:, 2, 2] == 0)  # the force is 1 at all lines
        variance = np.stack([lines.covariance[:, c, c].real for c in range(2)], axis=1)
        ratios.append(variance / (0.02**2 * (size**2 + 0.01 * np.mean(size**2, axis=0))))
    # 20 x 300 lines, of which 5/9 of 12 degrees of freedom a window of nine are behind each channel: 2 % at 3 sd
    assert np.mean(np.median(ratios, axis=1)) == pytest.approx(1, abs=0.06)


def test_the_fit_is_tested_and_a_wrong_rig_refused() -> None:
    p = np.array([identify(RIG, with_local_noise(functions(300, 0.02, s))).fit.p for s in range(40)])
    assert np.mean(p < 0.01) <= 0.1
    assert 0.25 < np.mean(p) < 0.75
    wrong = replace(RIG, elements=tuple(e for e in RIG.elements if e.name != "c2"))
    assert identify(wrong, with_local_noise(functions(300, 0.02))).fit.p < 1e-6


@pytest.mark.parametrize(("lines", "relative"), [(12, 0.02), (40, 0.002), (300, 0.0), (300, 1.0)])
def test_lines_too_far_apart_without_noise_or_all_noise_say_nothing(lines: int, relative: float) -> None:
    spectrum = functions(lines, relative)
    assert with_local_noise(spectrum) is spectrum


def test_given_noise_is_left_alone() -> None:
    known = with_local_noise(functions(300, 0.02))
    assert with_local_noise(known) is known
