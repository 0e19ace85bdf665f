"""A linear system by its modes, driven by band-limited noise that is integrated exactly between close samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record

RIG = """
name = "One mass"
coordinates = ["x1"]
[inputs]
f = { kind = "force", at = "x1" }
[masses]
m1 = { at = "x1", guess = "2 kg" }
[springs]
k1 = { between = ["x1", "ground"], guess = "8 kN/m" }
[dampers]
c1 = { between = ["x1", "ground"], guess = 8 }
[channels]
f = { of = "f", noise = "0.02 N" }
a1 = { of = "x1", quantity = "acceleration", unit = "m/s²", noise = 2e-5 }
"""
RATE = 100.0  # Hz
FINER = 10  # steps of the integration in one sample: linear between them, off by 3e-5 at 10 Hz


@dataclass(frozen=True)
class Bench:
    """Modes of natural frequencies (Hz) and damping ratios; shapes drawn once, at points 0, 1, … alike for forces."""

    frequency_hz: tuple[float, ...]
    damping: tuple[float, ...]
    points: int = 2

    @property
    def shapes(self) -> Real:
        """(points, modes), of unit modal mass."""
        rng = np.random.default_rng(7)
        size = (max(self.points, 4), len(self.damping))
        return np.asarray(rng.uniform(0.4, 1, size) * rng.choice([-1, 1], size))

    @property
    def omega(self) -> Real:
        """2π f."""
        return 2 * np.pi * np.array(self.frequency_hz)

    def accelerance(self, hz: Real, inputs: int) -> Complex:
        """(lines, points, inputs)."""
        s = 2j * np.pi * np.asarray(hz)[:, None]
        q = s**2 / (s**2 + 2 * np.array(self.damping) * self.omega * s + self.omega**2)
        phi = self.shapes
        return np.einsum("on,fn,in->foi", phi[: self.points], q, phi[:inputs]).astype(np.complex128)

    def noise(self, rng: np.random.Generator, seconds: float, inputs: int) -> Real:
        """Random forces up to 35 Hz, (steps, inputs)."""
        steps = round(seconds * RATE * FINER)
        u = rng.standard_normal((steps + 801, inputs))
        return np.asarray(signal.lfilter(signal.firwin(801, 35, fs=RATE * FINER), 1, u, axis=0)[801:])

    def record(
        self,
        forces: Real,
        rng: np.random.Generator,
        noise: float,
        start: Real | None = None,
        *,
        shift: bool = False,
    ) -> Record:
        """Forces and accelerations, or displacements (`shift`), with noise of that share of each output's rms."""
        inputs, time = forces.shape[1], np.arange(len(forces)) / (RATE * FINER)
        motion = []
        for k, (w, zeta) in enumerate(zip(self.omega, self.damping, strict=True)):
            A, B = np.array([[0, 1], [-w * w, -2 * zeta * w]]), np.array([[0.0], [1.0]])
            C, D = (np.eye(1, 2), [[0]]) if shift else (A[1:], [[1]])
            exact = signal.cont2discrete((A, B, C, D), 1 / (RATE * FINER), method="foh")[:4]
            (b,), a = signal.ss2tf(*exact)
            q = signal.lfilter(b, a, forces @ self.shapes[:inputs, k])
            if start is not None:
                rate = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
                place, speed = start[k], start[len(self.damping) + k]
                free = (place + 1j * (rate.real * place - speed) / rate.imag) * np.exp(rate * time)
                q = q + (free * rate ** (0 if shift else 2)).real
            motion.append(q)
        y = np.column_stack(motion) @ self.shapes[: self.points].T
        y = y[::FINER]
        y = y + noise * np.std(y, axis=0) * rng.standard_normal(y.shape)
        kind, letter = (Quantity.DISPLACEMENT, "x") if shift else (Quantity.ACCELERATION, "a")
        channels = [Channel(f"u{i}", {f"u{i}": 1.0}, Quantity.FORCE) for i in range(inputs)]
        channels += [Channel(f"{letter}{i}", {f"{letter}{i}": 1.0}, kind) for i in range(self.points)]
        return Record(tuple(channels), np.arange(len(y)) / RATE, np.column_stack([forces[::FINER], y]))
