"""The noise of amplitudes from the residual of the fit: its size beside each harmonic, and whether it is white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import bdtrc, chdtrc, fdtr, fdtrc

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.conditioning.regression import duration
from dashpot.data.conditioning.settings import Noise
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.notices import Notice

LAGS = 20  # of the portmanteau test
HALF_BAND = 10  # lines on each side of a harmonic that show the noise there
FEWEST_LINES = 6  # below this the local spectrum is not an estimate
SIGNIFICANT = 0.01


class ResidualMonitor:
    """Collects, while the residual streams by, its autocovariances and its Fourier sums beside each harmonic."""

    def __init__(self, record: Record, f: float, orders: Sequence[int], terms: int) -> None:
        samples, channels = record.values.shape[-2:]
        batch = int(np.prod(record.values.shape[:-2]))
        self.orders = len(orders)
        self.lags = min(LAGS, samples // 5) if samples >= 40 else 0
        self.step = 1 / duration(record.time)
        self.first = terms - 2 * len(orders)
        self.offset, self.owner = _neighbours(f, orders, self.step, samples)
        self.products = np.zeros((batch, self.lags, channels))
        self.tail = np.zeros((batch, channels, self.lags))
        self.sums = np.zeros((batch, len(self.owner), channels), dtype=complex)
        self.overlap = np.zeros((terms, len(self.owner)), dtype=complex)
        self.waves = np.zeros((len(self.owner), 0), dtype=complex)

    def next_rows(self, t: Real, A: Real) -> None:
        """The samples that `see` shows next: their times and design rows."""
        cycles = self.step * t
        turn = np.exp(-2j * np.pi * (cycles - np.floor(cycles)))
        reach = int(np.max(np.abs(self.offset), initial=0))
        turns = np.empty((reach + 1, len(t)), dtype=complex)
        turns[0] = 1.0
        for m in range(reach):
            np.multiply(turns[m], turn, out=turns[m + 1])
        self.waves = np.empty((len(self.offset), len(t)), dtype=complex)
        for line, (order, m) in enumerate(zip(self.owner.tolist(), self.offset.tolist(), strict=True)):
            carrier = A[:, self.first + 2 * order] - 1j * A[:, self.first + 2 * order + 1]
            np.multiply(carrier, turns[m] if m >= 0 else np.conj(turns[-m]), out=self.waves[line])
        self.overlap += (self.waves @ A).T

    def see(self, part: slice, e: Real) -> None:
        """Residuals (batch, rows, channels) of the present rows."""
        self.sums[part] += self.waves.real @ e + 1j * (self.waves.imag @ e)
        if self.lags:
            rows = e.shape[1]
            both = np.concatenate([self.tail[part], np.swapaxes(e, 1, 2)], axis=2)
            later = both[:, :, self.lags :]
            for lag in range(1, self.lags + 1):
                earlier = both[:, :, self.lags - lag : self.lags - lag + rows]
                self.products[part, lag - 1] += np.einsum("bct,bct->bc", later, earlier)
            self.tail[part] = both[:, :, -self.lags :]


def _neighbours(f: float, orders: Sequence[int], step: float, samples: int) -> tuple[Ints, Ints]:
    """Lines a whole number of steps 1/duration beside each harmonic, no farther than half way to the next one.

    Returns how many steps, and beside which of the orders.
    """
    reach = min(HALF_BAND, int((f / step - 1) / 2 + 1e-9))
    offsets = np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)]) if reach > 0 else np.arange(0)
    nyquist = samples * step / 2
    offset, owner = [], []
    for i, order in enumerate(orders):
        lines = order * f + offsets * step
        inside = offsets[(lines > 0) & (lines < max(nyquist - step, order * f))]
        offset.append(inside)
        owner.append(np.full(len(inside), i))
    return np.concatenate(offset).astype(np.int64), np.concatenate(owner).astype(np.int64)


@dataclass(frozen=True)
class NoiseLevel:
    """The noise that the harmonics are seen through.

    level      (batch, orders, channels, channels)  covariance of one sample that counts at each harmonic
    dof        (orders,)  real degrees of freedom behind it
    whiteness  (batch,)  p-value of a white residual; NaN where not tested
    """

    kind: Literal["white", "blocks"]
    level: Complex
    dof: Real
    whiteness: Real
    notes: tuple[Notice, ...] = ()


@dataclass(frozen=True)
class LocalNoise:
    """The noise on lines beside each harmonic: `level` as of NoiseLevel, `counts` lines (orders,), `whiteness`."""

    level: Complex
    counts: Real
    whiteness: Real

    def chosen(self, white: NoiseLevel, noise: Noise, record: Record, f: float) -> NoiseLevel:
        """This noise, or the white one.  Raises DataError where it is asked for and the record is too short."""
        enough = bool(np.all(self.counts >= FEWEST_LINES))
        periods = f * duration(record.time)
        if noise == "blocks" and not enough:
            raise DataError(
                f"{periods:.3g} periods are too few to see the colour of the noise at {f:g} Hz",
                record.source,
                'record at least eight periods, or take the noise as "white"',
            )
        coloured = is_coloured(self.whiteness)
        if noise == "blocks" or (coloured and enough):
            return NoiseLevel("blocks", self.level, 2.0 * self.counts, self.whiteness)
        if not coloured:
            return replace(white, whiteness=self.whiteness)
        text = (
            f"{record.source}: the residual at {f:g} Hz is not white, but {periods:.3g} periods "
            "are too few to measure its colour; the intervals treat it as white"
        )
        note = Notice("colour_unresolved", text, (record.source,))
        return replace(white, whiteness=self.whiteness, notes=(note,))


def white_noise(sigma: Real, orders: int, free: int) -> NoiseLevel:
    """The residual covariance (batch, channels, channels) at every harmonic alike; `free` degrees of freedom."""
    batch, channels, _ = sigma.shape
    level = np.broadcast_to(sigma[:, None].astype(complex), (batch, orders, channels, channels))
    return NoiseLevel("white", level, np.full(orders, float(free)), np.full(batch, np.nan))


def noise_beside_harmonics(
    monitor: ResidualMonitor, L: Real, samples: int, free: int, sigma: Real, exact: Bools, written: Bools
) -> LocalNoise:
    """What the monitor saw beside each harmonic; L is the factor of the Gram of the fit.

    sigma (batch, channels, channels): covariance of the residual; exact (batch, channels): where it is nothing;
    written (batch, channels): where it is the digits of the numbers, which repeat with the drive and are no noise.
    """
    level, counts = _local_level(monitor, L, samples, sigma, exact)
    return LocalNoise(
        level, counts, _whiteness(monitor, sigma, exact | written, level, counts, samples, free)
    )


def _local_level(
    monitor: ResidualMonitor, L: Real, samples: int, sigma: Real, exact: Bools
) -> tuple[Complex, Real]:
    """Noise level at each harmonic, (batch, orders, channels, channels) per sample, and lines behind it, (orders,).

    S(kω) = mean of J Jᴴ / samples with J = Σ e(t) e^{−jω_m t} on neighbouring lines, corrected for the share of each
    line that the fit itself has taken.  Where the lines are too few for the correlations of so many channels, the
    variances come from the lines and the correlations from the residual of all samples.
    """
    batch, _, channels = monitor.sums.shape
    orders = monitor.orders
    seen = cho_solve((L, True), monitor.overlap, check_finite=False)
    share = np.sum((np.conj(monitor.overlap) * seen).real, axis=0) / samples
    usable = share < 0.5
    level = np.zeros((batch, orders, channels, channels), dtype=complex)
    counts = np.zeros(orders)
    active = int(np.max(np.sum(~exact, axis=-1), initial=0))
    for order in range(orders):
        mine = usable & (monitor.owner == order)
        counts[order] = np.sum(mine)
        if not counts[order]:
            continue
        J = monitor.sums[:, mine] / np.sqrt(samples * (1 - share[mine]))[None, :, None]
        S = np.swapaxes(J, 1, 2) @ np.conj(J) / counts[order]
        if counts[order] < 2 * active:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.sqrt(np.diagonal(S, axis1=1, axis2=2).real / np.diagonal(sigma, axis1=1, axis2=2))
            ratio = np.where(np.isfinite(ratio), ratio, 0.0)
            S = ratio[:, :, None] * sigma * ratio[:, None, :]
        level[:, order] = (S + np.conj(np.swapaxes(S, 1, 2))) / 2
    level[np.broadcast_to((exact[:, :, None] | exact[:, None, :])[:, None], level.shape)] = 0.0
    return level, counts


def _whiteness(
    monitor: ResidualMonitor, sigma: Real, exact: Bools, local: Complex, counts: Real, samples: int, free: int
) -> Real:
    """(batch,): p-value of white noise by Ljung and Box's portmanteau and by the noise level at each harmonic."""
    variance = np.diagonal(sigma, axis1=1, axis2=2)
    safe = np.where(exact, 1.0, variance)
    ps: list[Real] = []
    if monitor.lags:
        lag = np.arange(1, monitor.lags + 1)[None, :, None]
        r = monitor.products / (safe * free)[:, None, :]
        ps.append(chdtrc(monitor.lags, samples * (samples + 2.0) * np.sum(r**2 / (samples - lag), axis=1)))
    for order, count in enumerate(counts):
        if count >= FEWEST_LINES:
            ratio = np.diagonal(local[:, order], axis1=1, axis2=2).real / safe
            ps.append(
                np.minimum(1.0, 2 * np.minimum(fdtrc(2 * count, free, ratio), fdtr(2 * count, free, ratio)))
            )
    if not ps:
        return np.full(len(sigma), np.nan)
    smallest = np.min(np.where(exact, np.nan_to_num(1.0), np.stack(ps)), axis=(0, 2))
    tests = len(ps) * np.sum(~exact, axis=-1)
    return np.where(tests > 0, np.minimum(1.0, smallest * tests), np.nan)


def is_coloured(whiteness: Real) -> bool:
    """One decision for all repeats: more of them fail at 1 % than chance allows, and more than a few per cent.

    whiteness (batch,): p-values.
    """
    tested = whiteness[np.isfinite(whiteness)]
    failed = int(np.sum(tested < SIGNIFICANT))
    if not failed:
        return False
    chance = float(bdtrc(failed - 1, len(tested), SIGNIFICANT))
    return failed >= 0.03 * len(tested) and chance <= SIGNIFICANT * (1 + 1e-9)
