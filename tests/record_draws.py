"""Monte Carlo of whole records: eight rigs and excitations, light and heavy damping, short and long, any noise.

Each case is one noise-free record, integrated eight times finer than it is sampled, and many draws of sensor noise on
its outputs.  The bound is that of all samples in time with the starting state unknown, from the slopes of the motion.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from dashpot.arrays import Real
from dashpot.data.conditioning.lines import spectrum
from dashpot.estimate.identify import identify
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.observation import observation_model
from tests.whole_rigs import WholeTest, chain, record_of

MEMORY = 0.8  # of coloured noise, first order
STEP = 1e-5  # of an unknown, for the slopes of the motion


@dataclass(frozen=True)
class Case:
    """A rig, what drives it, and its noise; decay_times of the slowest mode that the record lasts."""

    coordinates: int
    zeta: float
    driven: str  # "base", "force" or "nothing"
    excitation: str
    decay_times: float
    noise: float = 0.03  # of each output's size
    coloured: bool = False

    @property
    def name(self) -> str:
        """In words."""
        driven = "free decay" if self.driven == "nothing" else f"{self.excitation} {self.driven}"
        colour = ", coloured noise" if self.coloured else ""
        return (
            f"n = {self.coordinates}, ζ {self.zeta:.1%}, {driven}, {self.decay_times:g} decay times{colour}"
        )

    def test(self) -> WholeTest:
        """The noise-free record."""
        model, theta = chain(
            self.coordinates,
            self.zeta,
            force=self.driven == "force",
            base=self.driven == "base",
            seed=self.coordinates,
        )
        return record_of(model, theta, self.excitation, decay_times=self.decay_times, seed=1)


CASES = (
    Case(1, 0.001, "base", "random", 3),
    Case(2, 0.01, "force", "sweep", 10),
    Case(3, 0.02, "force", "hammer", 10),
    Case(2, 0.03, "nothing", "none", 5),
    Case(3, 0.03, "base", "earthquake", 20),
    Case(2, 0.05, "base", "stepped", 40),
    Case(1, 0.2, "base", "random", 300, coloured=True),
    Case(2, 0.1, "force", "random", 100, coloured=True),
)


@dataclass(frozen=True)
class Draws:
    """(draws, unknowns) errors and stated sd, whether intervals hold the truth, and the bound (unknowns,)."""

    error: Real
    stated: Real
    held: Real
    bound: Real

    @property
    def rms_over_bound(self) -> float:
        """Root mean square over unknowns and draws of error / bound."""
        return float(np.sqrt(np.mean((self.error / self.bound) ** 2)))

    @property
    def rms_over_stated(self) -> float:
        """As for the bound."""
        return float(np.sqrt(np.mean((self.error / self.stated) ** 2)))

    @property
    def stated_over_bound(self) -> float:
        """As for the bound, of the stated sd."""
        return float(np.sqrt(np.mean((self.stated / self.bound) ** 2)))


def draws(case: Case, count: int, seed: int) -> Draws:
    """Identifications of `count` noisy copies of the case's record, to which nothing is told but the rig."""
    return draws_of(case.test(), case.noise, count, seed, coloured=case.coloured)


def draws_of(
    test: WholeTest, noise: float, count: int, seed: int, *, coloured: bool = False, from_rest: bool = False
) -> Draws:
    """Identifications of `count` noisy copies of a record; `noise` of each output's size.

    `from_rest`: the bound knows that the rig starts at rest, which the identifications do not.
    """
    outputs = np.array([set(channel.of) <= set(test.model.coordinates) for channel in test.record.channels])
    sd = noise * test.size * outputs
    error, stated, held = [], [], []
    for k in range(count):
        rng = np.random.default_rng((seed, k))
        e = rng.normal(size=test.record.values.shape)
        if coloured:
            e = lfilter([1.0], [1.0, -MEMORY], e, axis=0) * (1 - MEMORY**2) ** 0.5
        record = replace(test.record, values=test.record.values + e * sd)
        found = identify(test.model, spectrum([record]))
        low, high = found.interval()
        error.append(found.values - test.theta)
        stated.append(found.sd)
        held.append((low <= test.theta) & (test.theta <= high))
    return Draws(np.array(error), np.array(stated), np.array(held), bound(test, sd, from_rest))


def bound(test: WholeTest, sd: Real, from_rest: bool = False) -> Real:
    """Smallest sd of each unknown, from all samples with white noise and inputs known; the starting state unknown, or
    known to be rest; sd (channels,) or (samples, channels)."""
    model, count = test.model, len(test.model.inputs)
    step = float(test.record.time[1] - test.record.time[0])
    outputs = test.record.channels[: len(test.record.channels) - count]
    view = observation_model(model, outputs, np.ones(1))
    inputs = test.record.values[:, len(outputs) :]
    weight = 1 / sd[..., : len(outputs)]

    def responses(theta: Real) -> tuple[Real, Real]:
        """Motion from rest, (samples · outputs,), and the free motion of each state, (…, 2 n), in units of noise."""
        p = model.parameters(theta)
        steps = integrator(model, p, step)
        free = [
            channel_samples(view, p, steps.motion(np.zeros_like(inputs), each))
            for each in np.eye(2 * model.n)
        ]
        return (channel_samples(view, p, steps.motion(inputs)) * weight).ravel(), np.stack(
            [(each * weight).ravel() for each in free], axis=1
        )

    driven, free = responses(test.theta)
    size = np.linalg.norm(free, axis=0)
    seen = (test.record.values[:, : len(outputs)] * weight).ravel()
    state = np.linalg.lstsq(free / size, seen - driven, rcond=None)[0] / size * (not from_rest)
    slopes = []
    for j, value in enumerate(test.theta):
        ends = []
        for way in (-1, 1):
            theta = np.array(test.theta)
            theta[j] += way * STEP * value
            moved, loose = responses(theta)
            ends.append(moved + loose @ state)
        slopes.append((ends[1] - ends[0]) / (2 * STEP * value))
    J = np.stack(slopes, axis=1)
    if not from_rest:
        J = J - (free / size) @ np.linalg.lstsq(free / size, J, rcond=None)[0]
    scale = np.linalg.norm(J, axis=0)
    variance = np.diagonal(np.linalg.inv((J / scale).T @ (J / scale)))
    return np.sqrt(variance) / scale
