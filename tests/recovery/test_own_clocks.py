"""Sensors with clocks of their own: the 95 % intervals of a rig's parameters hold the truth, over offsets and rates.

Two rigs on a shaken base, accelerometers at the base and at each mass, a file for each sensor and dwell.  In each dwell
the sensors are shaken together for ten seconds, at random, and then stand on the rig while it is driven.  Each clock of
each dwell is off by up to 5 s and 50 ppm, and each sensor has a rate of its own.

20 draws of 6 dwells: the pooled coverage of some 110 intervals, which are correlated in a draw, has a standard error of
3 points where the noise of the amplitudes is all that counts, and is higher where the clocks are: their error turns
phases only, and dashpot counts it as noise along the amplitude as well.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from dashpot.api import identify
from dashpot.arrays import Complex, Real
from dashpot.model.rigfile import parse_rig
from tests.whole_rigs import tones

pytestmark = pytest.mark.long

RATES = 200.0, 199.3, 198.1, 201.7
TOGETHER, DRIVEN = 10.0, 24.0  # s
DRAWS = 20


@dataclass(frozen=True)
class Chain:
    """Masses one above the other on a base u: known ones, springs and dampers from the base upwards, drive in Hz."""

    masses: tuple[float, ...]
    springs: tuple[float, ...]
    dampers: tuple[float, ...]
    hz: tuple[float, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The channels, the base first."""
        return ("u", *(f"x{k + 1}" for k in range(len(self.masses))))

    @property
    def truth(self) -> dict[str, float]:
        """The unknowns."""
        pairs = (("k", self.springs), ("c", self.dampers))
        return {f"{letter}{i + 1}": value for letter, values in pairs for i, value in enumerate(values)}

    def rig(self) -> str:
        """The rig file."""
        lines = [
            f"coordinates = {list(self.names[1:])}",
            "[inputs]",
            'u = { kind = "displacement" }',
            "[masses]",
        ]
        lines += [f'm{k + 1} = {{ at = "x{k + 1}", value = {m} }}' for k, m in enumerate(self.masses)]
        for table, letter in (("springs", "k"), ("dampers", "c")):
            lines.append(f"[{table}]")
            lines += [
                f"{letter}{k} = {{ between = {list(self.names[k - 1 : k + 1])} }}"
                for k in range(1, len(self.names))
            ]
        lines.append("[channels]")
        return "\n".join(
            [*lines, *(f'{n} = {{ of = "{n}", quantity = "acceleration" }}' for n in self.names)]
        )

    def transmitted(self, f: float) -> Complex:
        """Motion of each point over the base's, written out apart from dashpot."""
        s, n = 2j * np.pi * f, len(self.masses)
        Z = np.diag(np.array(self.masses) * s**2).astype(complex)
        z = np.array(self.springs) + np.array(self.dampers) * s
        for k in range(n):
            Z[k, k] += z[k]
            if k:
                Z[k - 1, k - 1] += z[k]
                Z[k - 1, k] -= z[k]
                Z[k, k - 1] -= z[k]
        return np.array([1.0, *np.linalg.solve(Z, np.array([z[0], *[0.0] * (n - 1)]))])


TWO = Chain((2.0, 1.0), (2000.0, 1000.0), (6.0, 4.0), (2.0, 3.5, 5.0, 6.5, 8.0, 10.0))
THREE = Chain((0.16, 0.16, 0.142), (500.0, 540.0, 520.0), (0.9, 0.7, 0.8), (1.5, 3.0, 5.0, 8.0, 12.0, 15.0))


def shaking(rng: np.random.Generator, t: Real) -> Real:
    """Random motion up to 20 Hz of unit power while the sensors are together."""
    count = 300
    f, X = rng.uniform(0.3, 20.0, count), rng.normal(size=count) + 1j * rng.normal(size=count)
    shaken, moved = t < TOGETHER, np.zeros(len(t))
    moved[shaken] = tones(t[shaken], f, X) / np.sqrt(count)
    return moved


def draw(folder: Path, chain: Chain, rng: np.random.Generator, loud: float, noise: float) -> Path:
    """Files of one test and the manifest that names them."""
    for f in chain.hz:
        seed = int(rng.integers(2**32))
        for k, (name, X) in enumerate(zip(chain.names, chain.transmitted(f), strict=True)):
            offset, drift = (0.0, 0.0) if k == 0 else (rng.uniform(-5, 5), rng.uniform(-5e-5, 5e-5))
            t = np.arange(0.0 if k == 0 else rng.uniform(-0.5, 0.5), TOGETHER + DRIVEN + 1, 1 / RATES[k])
            driven = np.where(t > TOGETHER + 1, np.real(X * np.exp(2j * np.pi * f * t)), 0.0)
            y = loud * shaking(np.random.default_rng(seed), t) + driven + noise * rng.normal(size=len(t))
            np.savez(folder / f"{f:g}Hz_{name}.npz", time_s=t - offset - drift * (t - np.mean(t)), a=y)
    sensors = "".join(f'{name} = {{ {name} = "a" }}\n' for name in chain.names)
    parts = f"align_s = [0.2, {TOGETHER - 0.2}]\nwindow_s = [{TOGETHER + 2}, {TOGETHER + DRIVEN}]"
    text = f'[[files]]\nname = "{{frequency}}Hz_{{sensor}}.npz"\nclock = "own"\n{parts}\n[files.sensors]\n{sensors}'
    (folder / "test.toml").write_text(text)
    return folder / "test.toml"


@pytest.mark.parametrize(
    ("chain", "loud", "noise"), [(TWO, 30.0, 1.0), (THREE, 1.0, 0.02)], ids=["noise counts", "clocks count"]
)
def test_intervals_hold_the_truth(tmp_path: Path, chain: Chain, loud: float, noise: float) -> None:
    rig = parse_rig(chain.rig(), "rig.toml")
    held, squares = [], []
    for seed in range(DRAWS):
        estimate = identify(rig, draw(tmp_path, chain, np.random.default_rng([11, seed]), loud, noise))
        for name, true in chain.truth.items():
            value = estimate[name]
            low, high = value.interval95
            held.append(low <= true <= high)
            squares.append(((value.value - true) / value.sd) ** 2)
    print(f"coverage {np.mean(held):.3f}, mean square of error over sd {np.mean(squares):.2f}")
    assert np.mean(held) > 0.95 - 3 * 0.03
    clocks_count = loud == 1.0
    # Half of what a clock counts for does not happen.
    assert 0.2 < np.mean(squares) < 1.0 if clocks_count else 0.6 < np.mean(squares) < 1.5
