"""What channels show of dwells: the compiled kernel against its twin in NumPy, and identifications by both."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.estimate.identify import identify
from dashpot.estimate.nonlinear.objective import ShownLines, dwells_of, shown_lines
from dashpot.model.observation import observation_model
from dashpot.numerics.kernel import using
from tests.kernels import apart, compiled, instruction_sets, instructions
from tests.nonlinear_rigs import motions, settled, two_masses

FREQUENCIES = [4.0, 5.5, 7.0, 8.5, 10.0]
CHANNELS = (
    Channel("x2", {"x2": 1.0}, quantity=Quantity.ACCELERATION),
    Channel("x1", {"x1": 1.0, "u": -1.0}),
    Channel("u", {"u": 1.0}),
    Channel("force", {"q": 1.0, "c2": 1.0}, quantity=Quantity.FORCE),
)


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("law", ["cubic", "coulomb"])
def test_channels_and_slopes_are_those_of_numpy(law: str, noisy: bool, name: str) -> None:
    compiled()
    model, theta = two_masses(law)
    spectrum = settled(model, theta, CHANNELS, FREQUENCIES, amplitude=5e-4)
    shuffled = spectrum.select(np.random.default_rng(4).permutation(spectrum.lines))
    dwells, view = dwells_of(model, shuffled), observation_model(model, CHANNELS, shuffled.omega)
    several = theta * np.random.default_rng(5).uniform(0.9, 1.1, (3, len(theta)))
    p, constants = model.parameters(several), model.inner_constants(several)
    q = np.tile(shuffled.amplitudes[None, :, 2:3], (3, 1, 1)) * np.array([1.0, 0.8, 1.1])[:, None, None]

    def shown(start: np.ndarray | None, grow: bool = False) -> ShownLines:
        return shown_lines(view, dwells, p, constants, q, start, noisy=noisy, grow=grow)

    with using("numpy"):
        twin = shown(None, grow=True)
    assert np.all(twin.converged)
    with instructions(name), using("compiled"):
        for start in (None, 1.01 * twin.delta):
            by_kernel = shown(start)
            assert np.array_equal(by_kernel.converged, twin.converged)
            for field in ("predicted", "J", "delta", "d_delta", *(["G"] if noisy else [])):
                value, expected = getattr(by_kernel, field), getattr(twin, field)
                assert value.shape == expected.shape
                assert apart(value, expected) < 1e-9, field


def test_dwells_that_the_kernel_loses_are_followed_from_small_drives_as_in_numpy() -> None:
    compiled()
    model, theta = two_masses("cubic")
    channels = motions("x2", "u")
    spectrum = settled(model, theta, channels, FREQUENCIES)
    dwells, view = dwells_of(model, spectrum), observation_model(model, channels, spectrum.omega)
    p, constants = model.parameters(theta[None]), model.inner_constants(theta[None])
    far = np.full((len(FREQUENCIES), 1, 2 * dwells.orders + 1), 1.0)
    with using("compiled"):
        lost, found = (
            shown_lines(
                view, dwells, p, constants, spectrum.amplitudes[None, :, 1:], far, noisy=False, grow=grow
            )
            for grow in (False, True)
        )
    assert not np.all(lost.converged)
    assert np.all(found.converged)
    assert apart(found.predicted, spectrum.amplitudes[None]) < 1e-4


@pytest.mark.parametrize("law", ["cubic", "gap"])
def test_identifications_by_kernel_and_numpy_end_alike(law: str) -> None:
    compiled()
    model, theta = two_masses(law)
    spectrum = settled(
        model, theta, motions("x1", "x2", "u"), FREQUENCIES, noise=0.003, rng=np.random.default_rng(8)
    )
    with using("numpy"):
        twin = identify(model, replace(spectrum), "ml")
    with using("compiled"):
        found = identify(model, replace(spectrum), "ml")
    assert np.max(np.abs(found.values - twin.values) / twin.sd) < 1e-4
    assert apart(found.sd[None], twin.sd[None]) < 1e-4
    assert found.fit.p == pytest.approx(twin.fit.p, rel=1e-6)
