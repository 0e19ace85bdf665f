"""Parameters of random rigs from measured modes, without guesses and with points that are not seen."""

import numpy as np
import pytest

from dashpot.data.modal_data import ModalData
from dashpot.estimate.modal import identify_modal
from dashpot.model.modes import eigenmodes, mode_sensitivities
from tests.rigs import PAPER_KINDS, Rig, random_rig

LEVEL = 3e-4  # of frequencies; damping ratios and shapes ten times that


def modal_test(rig: Rig, points: int, rng: np.random.Generator) -> ModalData | None:
    """A noisy modal test at the first `points` coordinates; None where it does not hold the unknowns."""
    found = eigenmodes(rig.model, rig.p)
    if len(found.eigenvalues) > rig.model.n or np.any(
        found.eigenvalues.imag <= 1e-6 * np.abs(found.eigenvalues)
    ):
        return None
    values, shapes = found.eigenvalues, found.shapes
    dlam, dphi = mode_sensitivities(rig.model, rig.p, values, shapes)
    seen, dseen = shapes[:, :points], dphi[:, :points]
    power = np.sum(np.abs(seen) ** 2, axis=-1)
    if np.any(power < 1e-6):
        return None
    along = np.einsum("kp,kpe->ke", np.conj(seen), dseen) / power[:, None]
    rows = [
        dlam / np.abs(values)[:, None],
        (dseen - seen[..., None] * along[:, None]).reshape(-1, len(rig.p)),
    ]
    J = np.concatenate(rows) @ rig.model.T * rig.theta
    s = np.linalg.svd(np.concatenate([J.real, J.imag]), compute_uv=False)
    if len(s) < len(rig.theta) or s[-1] < 1e-3 * s[0]:
        return None
    f, zeta = np.abs(values) / 2 / np.pi, -values.real / np.abs(values)
    sd = np.stack([LEVEL * f, 10 * LEVEL * zeta], axis=-1)
    size = 10 * LEVEL * np.max(np.abs(seen), axis=-1)[:, None]
    f, zeta = np.stack([f, zeta]) + rng.standard_normal((2, len(f))) * sd.T
    noisy = seen + size * (rng.standard_normal(seen.shape) + 1j * rng.standard_normal(seen.shape))
    V = 2 * size[..., None] ** 2 * np.eye(points)
    names = rig.model.coordinates[:points]
    return ModalData(names, f, zeta, sd[:, :, None] ** 2 * np.eye(2), noisy, V.astype(complex))


@pytest.mark.parametrize(
    ("n", "points"),
    [(3, 3), *(pytest.param(*each, marks=pytest.mark.long) for each in ((3, 2), (4, 3)))],
    ids=["all-of-3", "2-of-3", "3-of-4"],
)
def test_parameters_and_intervals_without_guesses(n: int, points: int) -> None:
    """Six random rigs, seed 20: each fits, and the intervals hold the truth but for four binomial errors below 95 %."""
    rng = np.random.default_rng(20)
    held = count = done = 0
    while done < 6:
        rig = random_rig(rng, n, displacements=1, kinds=PAPER_KINDS, known=0.3)
        data = modal_test(rig, points, rng)
        if data is None:
            continue
        done += 1
        found = identify_modal(rig.model, data)
        assert bool(found.converged)
        assert not np.any(found.fit.rejected)
        low, high = found.interval()
        held += int(np.sum((low <= rig.theta) & (rig.theta <= high)))
        count += len(rig.theta)
    assert held / count > 0.95 - 4 * np.sqrt(0.95 * 0.05 / count), (held, count)
