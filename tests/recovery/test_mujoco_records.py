"""Records that MuJoCo has computed, from rigs that MuJoCo holds as nested bodies on springs, identified whole."""

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Model
from tests.whole_rigs import chain

mujoco = pytest.importorskip("mujoco")

FINER = 10  # steps of MuJoCo's integrator in a sample
PER_CYCLE = 16  # samples of the highest mode


def simulated(model: Model, theta: Real, rng: np.random.Generator, *, periods: float) -> Record:
    """x of every mass and the force on the last one, from rest, (periods of the lowest mode) long, without noise.

    Joint i is the elongation of spring i, for each body hangs on the one before.
    """
    p = dict(
        zip([element.name for element in model.elements], map(float, model.parameters(theta)), strict=True)
    )
    hz = eigenmodes(model, model.parameters(theta)).frequency_hz
    step = 1 / (PER_CYCLE * FINER * float(np.max(hz)))
    count = int(periods / float(np.min(hz)) / step) // FINER
    opened, closed = "", ""
    for i in range(1, model.n + 1):
        opened += (
            f'<body><inertial pos="0 0 0" mass="{p[f"m{i}"]!r}" diaginertia="1 1 1"/>'
            f'<joint type="slide" axis="1 0 0" stiffness="{p[f"k{i}"]!r}" damping="{p[f"c{i}"]!r}"/>'
        )
        closed += "</body>"
    rig = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step!r}" integrator="RK4" gravity="0 0 0"/>'
        f"<worldbody>{opened}{closed}</worldbody></mujoco>"
    )
    data = mujoco.MjData(rig)
    middle = (np.arange(count * FINER) + 0.5) * step
    tones = rng.uniform(0.4 * np.min(hz), 1.2 * np.max(hz), 40)
    phases = rng.uniform(0, 2 * np.pi, 40)

    def force(time: Real) -> Real:
        return np.sin(2 * np.pi * tones * time[:, None] + phases).sum(axis=1)

    x = np.zeros((count, model.n))
    for k, f in enumerate(force(middle)):
        if k % FINER == 0:
            x[k // FINER] = np.cumsum(data.qpos)
        data.xfrc_applied[model.n, 0] = f
        mujoco.mj_step(rig, data)
    time = np.arange(count) * FINER * step
    channels = [Channel(name, {name: 1.0}) for name in model.coordinates]
    channels.append(Channel("f", {"f": 1.0}, Quantity.FORCE))
    return Record(tuple(channels), time, np.concatenate([x, force(time)[:, None]], axis=1))


@pytest.mark.parametrize("n", [1, 2, 4])
def test_rigs_of_mujoco_are_found_again(n: int) -> None:
    """Without noise within 0.1 %; with 2 % of each output within 4 stated sd and 3 % (seeds 10 + n)."""
    rng = np.random.default_rng(10 + n)
    model, theta = chain(n, rng.uniform(0.01, 0.06), force=True, base=False, seed=20 + n)
    clean = simulated(model, theta, rng, periods=20)
    assert identify(model, spectrum([clean])).values == pytest.approx(theta, rel=1e-3)
    sd = 0.02 * np.std(clean.values, axis=0) * np.r_[np.ones(n), 0.0]
    noisy = clean.values + sd * rng.normal(size=clean.values.shape)
    found = identify(model, spectrum([Record(clean.channels, clean.time, noisy)]))
    assert np.all(np.abs(found.values - theta) < 4 * found.sd)
    assert np.all(found.sd < 0.03 * theta)
