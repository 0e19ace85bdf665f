"""Coloured noise and a missing small element, from samples to intervals.

Where the model lacks an element no method finds the truth; the intervals of sensor noise must hold the values that
fit best (those that noise-free data of the full rig give), and what says that the model fails is χ².
Coverages of 1,000 repeats have a standard error of 0.7 points, the mean over the six parameters one of 0.3 to 0.7.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import stdtrit

from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import response
from dashpot.model.elements import Kind, between
from dashpot.model.network import Model
from tests import rigs

SEED, REPEATS = 11, 1000
HZ = np.array([1, 2, 3, 3.8, 5, 7, 9.5, 11, 13, 16, 20, 25.0])
SAMPLES, PERIODS = 600, 30
CORNER = 0.8  # first-order filter: half power at 0.7 of the drive at 20 samples a period, inside the band of a dwell
NOISE = 0.1
TRUTH = {"m1": 3.0, "m2": 2.7, "c1": 30.0, "c2": 40.0, "c3": 90.0, "c4": 50.0}
CHANNELS = (
    Channel("x1", {"x1": 1.0}),
    Channel("x2", {"x2": 1.0}),
    Channel("v1", {"x1": 1.0}, Quantity.VELOCITY),
    Channel("v2", {"x2": 1.0}, Quantity.VELOCITY),
    Channel("u", {"u": 1.0}),
)


def _rig(extra: float = 0.0) -> Model:
    more = (between("k3", Kind.SPRING, "x1", "ground", value=extra),) if extra else ()
    plain = rigs.paper_rig().model
    return replace(plain, elements=(*plain.elements, *more))


def _clean(model: Model) -> np.ndarray:
    omega = 2 * np.pi * HZ
    X = response(model, model.parameters(model.theta(TRUTH)), omega, np.ones((len(HZ), 1), dtype=complex))
    return np.concatenate([X, 1j * omega[:, None] * X, np.ones((len(HZ), 1))], axis=-1)


def _records(Y: np.ndarray, memory: float, repeats: int) -> list[Record]:
    rng = np.random.default_rng(SEED)
    records = []
    for hz, row in zip(HZ, Y, strict=True):
        t = np.arange(SAMPLES) * PERIODS / hz / SAMPLES
        values = np.broadcast_to(
            (row * np.exp(2j * np.pi * hz * t)[:, None]).real, (repeats, SAMPLES, 5)
        ).copy()
        white = rng.standard_normal((repeats, SAMPLES + 200, 4))
        noise = lfilter([np.sqrt(1 - memory**2)], [1, -memory], white, axis=1)[:, 200:]
        values[..., :4] += NOISE * np.abs(row[:4]) * noise
        records.append(Record(CHANNELS, t, values, float(hz)))
    return records


def _best_fit(Y: np.ndarray, weights: Spectrum) -> np.ndarray:
    """What noise-free data of the full rig give, weighted alike."""
    lines = len(HZ)
    exact = Spectrum(
        CHANNELS, HZ, Y, np.mean(weights.covariance, axis=0), weights.samples, np.full(lines, np.inf),
        ("given",) * lines, weights.experiment,
    )  # fmt: skip
    return np.asarray(identify(_rig(), exact).values)


def _coverage(estimate: Estimate, target: np.ndarray) -> np.ndarray:
    half = stdtrit(estimate.dof, 0.975) * estimate.noise_sd
    return np.asarray(100 * np.mean(np.abs(estimate.values - target) <= half, axis=0))


@pytest.mark.long
@pytest.mark.parametrize("extra", [0.0, 40.0])
def test_block_intervals_cover_where_plain_ones_do_not(extra: float) -> None:
    Y = _clean(_rig(extra))
    records = _records(Y, CORNER, REPEATS)
    seen = spectrum(records, harmonics=(), drift=0)
    assert set(seen.noise) == {"blocks"}
    robust = _coverage(identify(_rig(), seen), _best_fit(Y, seen))
    assert np.all((robust >= 93) & (robust <= 97.5)), robust
    assert 93.5 <= np.mean(robust) <= 96.5, robust
    plain = spectrum(records, harmonics=(), drift=0, noise="white")
    estimate = identify(_rig(), plain)
    assert np.all(_coverage(estimate, _best_fit(Y, plain)) < 80)
    assert np.mean(estimate.fit.rejected) > 0.95  # and χ² says that those are not to be believed


@pytest.mark.slow
def test_one_record_says_which_interval_to_believe() -> None:
    Y = _clean(_rig())
    coloured = identify(_rig(), spectrum(_one(_records(Y, CORNER, 1)), harmonics=(), drift=0))
    assert coloured.basis == "sensor noise"
    assert any(warning.code == "coloured_noise" for warning in coloured.warnings)
    white = identify(_rig(), spectrum(_one(_records(Y, 0.0, 1)), harmonics=(), drift=0))
    assert not any(warning.code == "coloured_noise" for warning in white.warnings)
    lacking = identify(
        _rig(), spectrum(_one(_records(_clean(_rig(400.0)), CORNER, 1)), harmonics=(), drift=0)
    )
    assert lacking.basis == "model misfit"
    assert any(warning.code == "model_misfit" for warning in lacking.warnings)
    assert np.all(lacking.sd > 1.5 * lacking.noise_sd)


def _one(records: list[Record]) -> list[Record]:
    return [Record(r.channels, r.time, r.values[0], r.frequency_hz) for r in records]
