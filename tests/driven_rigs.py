"""Nonlinear rigs of one mass in time, by a Runge-Kutta method of their own, and noise on all that is measured."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.model.elements import Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import Constant, force_law
from tests.networks import network

RATE, FINER = 150.0, 8  # samples a second, and steps of the integration between two of them


@dataclass(frozen=True)
class DrivenTest:
    """A rig, its true unknowns, and a record without noise whose last channel shows the input."""

    model: Model
    theta: Real
    record: Record

    def noisy(self, output: float, drive: float, *seed: int) -> Record:
        """The record with white noise, of these parts of the channels' sizes."""
        values = self.record.values
        sd = np.array([output] * (values.shape[1] - 1) + [drive]) * np.std(values, axis=0)
        return replace(
            self.record, values=values + sd * np.random.default_rng(seed).standard_normal(values.shape)
        )


def tones(samples: int, size: float, seed: int) -> tuple[Real, Real]:
    """Forty tones of 1 to 15 Hz of this rms at all half steps of the integration, and their rate."""
    rng = np.random.default_rng(seed)
    omega, phase = 2 * np.pi * rng.uniform(1, 15, 40), rng.uniform(0, 2 * np.pi, 40)
    time = np.arange(2 * FINER * (samples - 1) + 1)[:, None] / (2 * FINER * RATE)
    amplitude = size * (2 / 40) ** 0.5
    at = omega * time + phase
    return amplitude * np.sum(np.cos(at), axis=1), -amplitude * np.sum(omega * np.sin(at), axis=1)


def moved(acceleration: Callable[[float, float, int], float], samples: int) -> Real:
    """Displacement at the samples from rest, (samples,); acceleration(x, v, half step)."""
    h = 1 / (RATE * FINER)
    x = v = 0.0
    out = [x]
    for i in range(0, 2 * FINER * (samples - 1), 2):
        a1 = acceleration(x, v, i)
        v2 = v + h / 2 * a1
        a2 = acceleration(x + h / 2 * v, v2, i + 1)
        v3 = v + h / 2 * a2
        a3 = acceleration(x + h / 2 * v2, v3, i + 1)
        v4 = v + h * a3
        a4 = acceleration(x + h * v3, v4, i + 2)
        x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        if (i + 2) % (2 * FINER) == 0:
            out.append(x)
    return np.array(out)


def on_base(law: str, value: float, samples: int = 800, *constants: Constant) -> DrivenTest:
    """A known mass on a spring, a damper and a nonlinear element, all to a base that moves by 1 mm rms.

    law: "cubic" or "coulomb".
    """
    m, k, c = 2.0, 4000.0, 12.0 if law == "cubic" else 6.0
    u, rate = tones(samples, 1e-3, 0)

    def acceleration(x: float, v: float, i: int) -> float:
        d, w = x - u[i], v - rate[i]
        force = value * (d**3 if law == "cubic" else np.tanh(w / 0.02))
        return -(k * d + c * w + force) / m

    x = moved(acceleration, samples)
    kind = Kind.SPRING if law == "cubic" else Kind.DAMPER
    element = replace(between("q", kind, "x", "u"), force_law=force_law(law, constants))
    model = network("x", "u", f"m@x={m} k:x-u c:x-u", element)
    channels = (Channel("x", {"x": 1.0}), Channel("u", {"u": 1.0}))
    values = np.column_stack([x, u[:: 2 * FINER]])
    record = Record(channels, np.arange(samples) / RATE, values)
    return DrivenTest(model, model.theta({"k": k, "c": c, "q": value}), record)


def cubic(samples: int = 800) -> DrivenTest:
    """A spring that stiffens by 60 % on a base that moves."""
    return on_base("cubic", 1e8, samples)


def coulomb(samples: int = 800) -> DrivenTest:
    """Friction against a base that moves; its speed constant is known."""
    return on_base("coulomb", 1.5, samples, Constant("v0", 0.02))


def gap(samples: int = 800) -> DrivenTest:
    """A mass under a force between stops that it reaches."""
    m, k, c, q, clearance = 2.0, 3000.0, 12.0, 2500.0, 1e-3
    force, _ = tones(samples, 3.0, 0)

    def acceleration(x: float, v: float, i: int) -> float:
        stops = q * (max(x - clearance, 0.0) + min(x + clearance, 0.0))
        return (force[i] - k * x - c * v - stops) / m

    x = moved(acceleration, samples)
    element = replace(between("q", Kind.SPRING, "x", "ground"), force_law=force_law("gap"))
    model = network("x", "f@x", "m@x k:x-ground c:x-ground", element)
    channels = (Channel("x", {"x": 1.0}), Channel("f", {"f": 1.0}, Quantity.FORCE))
    values = np.column_stack([x, force[:: 2 * FINER]])
    record = Record(channels, np.arange(samples) / RATE, values)
    return DrivenTest(model, model.theta({"m": m, "k": k, "c": c, "q": q, "q.gap": clearance}), record)
