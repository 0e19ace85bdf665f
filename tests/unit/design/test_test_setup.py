"""Settling times, and drives at the limits of a shaker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.design import test_setup
from dashpot.design.test_setup import ShakerLimits, nominal_setup
from dashpot.errors import UsageError
from tests.designs import light_setup, paper_setup
from tests.rigs import paper_rig


def test_settling_is_that_of_the_slowest_mode() -> None:
    """Real parts of the paper's eigenvalues: −16.05 and −26.2 1/s."""
    assert paper_setup().settling() == pytest.approx(np.log(1000) / 16.0467, rel=1e-3)


def test_limits_of_the_shaker_set_the_amplitudes() -> None:
    limits = ShakerLimits(stroke=0.01, velocity=0.2, acceleration=5.0, force=40.0)
    own = paper_setup(limits)
    f = np.geomspace(0.3, 25, 60)
    k = np.zeros(60, dtype=int)
    seen = own.seen(f, k)
    use = limits.use(2 * np.pi * f, seen.motion, seen.force)
    assert np.all(use <= 1)
    assert np.all(use > 1 - 1e-9)
    # A force limit alone holds nothing back where the rig does not push: here, nothing joins it to the base.
    rig = paper_rig()
    elements = tuple(replace(e, value=0.0) if e.name in ("k2", "c2") else e for e in rig.model.elements)
    loose = replace(rig.model, elements=elements)
    free = nominal_setup(loose, own.channels, rig.theta[[0, 1, 2, 4, 5]], limits=ShakerLimits(force=1))
    with pytest.raises(UsageError, match="none of its limits"):
        free.drive(f, k)


@pytest.mark.parametrize(("relative", "floor"), [(0.0, 1e-5), (0.1, 1e-6), (0.1, 0.0)])
def test_lines_some_at_a_time_are_lines_all_together(
    relative: float, floor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = light_setup(floor, relative)
    f = np.linspace(0.5, 25.0, 37)
    pattern = np.zeros(37, dtype=np.int64)
    together = setup.information(f, pattern)
    monkeypatch.setattr(test_setup, "CHUNK", 60)
    np.testing.assert_allclose(setup.information(f, pattern), together, rtol=1e-12)
