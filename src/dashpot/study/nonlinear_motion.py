"""Simulated tests of rigs with nonlinear elements: settled dwells by harmonic balance, records by integration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import SettledDwell
from dashpot.errors import ConvergenceError
from dashpot.model.channel_noise import noise_sd
from dashpot.model.network import Model
from dashpot.model.nonlinear.channel_motion import channel_harmonics
from dashpot.model.nonlinear.continuation import grown_from_rest
from dashpot.model.nonlinear.harmonic_balance import Periodic, periodic_response, settled_orders
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.study.simulate import Dwells

ORDERS = 7  # harmonics to begin with
FINEST = 1e-6  # truncation error of the elongations
SEEN = 5  # harmonics in tables of amplitudes


@dataclass(frozen=True)
class SettledMotion:
    """Harmonics of the channels in every dwell, (dwells, H + 1, channels), SI units, of unknown calibrations 1."""

    channels: tuple[Channel, ...]
    harmonics: Complex


def settled_motion(model: Model, theta: Real, channels: Sequence[Channel], test: Dwells) -> SettledMotion:
    """The motion that each dwell of a test settles to, with as many harmonics as it needs; theta (unknowns,).

    Where several motions are possible it is that which a drive raised slowly from rest leads to.
    Raises ConvergenceError, which names the frequency, where none is found.
    """
    rows = len(test.frequency_hz)
    U, f = (np.zeros((rows, ORDERS + 1, part.shape[1]), dtype=np.complex128) for part in (test.U, test.f))
    U[:, 1], f[:, 1] = test.U, test.f
    p, constants = (
        np.tile(model.parameters(theta), (rows, 1)),
        np.tile(model.inner_constants(theta), (rows, 1)),
    )
    drive = Drive(test.omega, U, f)
    at = periodic_response(model, p, constants, drive)
    if not np.all(at.converged):  # with few harmonics, which costs little
        at = _followed(model, theta, drive, at)
    at, drive = settled_orders(model, p, constants, drive, at.delta, tolerance=FINEST)
    if not np.all(at.converged):
        at = _followed(model, theta, drive, at)
    return SettledMotion(tuple(channels), channel_harmonics(model, p, channels, drive, at))


def _followed(model: Model, theta: Real, drive: Drive, at: Periodic) -> Periodic:
    """The motions with those that Newton's method missed found by following the drive's growth, through folds.

    Raises ConvergenceError, which names the frequency, where that fails as well.
    """
    delta = at.delta.copy()
    for row in np.flatnonzero(~at.converged):
        one = np.arange(len(drive.omega)) == row
        try:
            delta[row] = grown_from_rest(model, theta, drive.rows(one))
        except ConvergenceError as error:
            raise ConvergenceError(
                f"harmonic balance finds no response at {drive.omega[row] / (2 * np.pi):g} Hz",
                cure="drive less there, or leave it out",
            ) from error
    rows = len(delta)
    p, constants = (
        np.tile(model.parameters(theta), (rows, 1)),
        np.tile(model.inner_constants(theta), (rows, 1)),
    )
    return periodic_response(model, p, constants, drive, delta)


def settled_records(motion: SettledMotion, test: Dwells, rng: np.random.Generator) -> list[Record]:
    """One steady record for each dwell, noise and known calibrations of the channels included."""
    channels = motion.channels
    sd = noise_sd(channels, motion.harmonics[:, 1])
    factor = np.array([channel.factor for channel in channels])
    delay = np.array([0.0 if channel.delay is None else channel.delay for channel in channels])
    orders = np.arange(motion.harmonics.shape[1])
    records = []
    for line, omega in enumerate(test.omega):
        time = test.time(line)
        turns = np.exp(
            1j * omega * orders[:, None] * (time[:, None, None] - delay)
        )  # (samples, H + 1, channels)
        values = np.sum((turns * motion.harmonics[line]).real, axis=1)
        values = values + sd[line] * rng.standard_normal(values.shape)
        frequency = float(test.frequency_hz[line])
        source = f"simulation at {frequency:g} Hz"
        records.append(Record(channels, time, factor * values, frequency, source=source))
    return records


def settled_spectrum(
    motion: SettledMotion, test: Dwells, rng: np.random.Generator | None, *, draws: int | None = None
) -> Spectrum:
    """Amplitudes of the first harmonics of each dwell, as white noise on the samples of whole periods leaves them.

    `draws` repeats make a leading axis; without `rng` the amplitudes are exact and the covariance is that of noise.
    """
    channels, dwells = motion.channels, len(test.frequency_hz)
    count = min(SEEN, motion.harmonics.shape[1] - 1)
    sd = noise_sd(channels, motion.harmonics[:, 1]) * np.sqrt(2 / test.samples)[:, None]  # of Re and Im, each
    Y = motion.harmonics[:, 1 : count + 1].reshape(dwells * count, -1)
    spread = np.repeat(sd, count, axis=0)
    shape = (2, *(() if draws is None else (draws,)), *Y.shape)
    error = np.zeros(shape) if rng is None else rng.standard_normal(shape)
    return Spectrum(
        channels,
        np.outer(test.frequency_hz, np.arange(1, count + 1)).ravel(),
        Y + spread * (error[0] + 1j * error[1]),
        ((2 * spread[..., None] ** 2) * np.eye(len(channels))).astype(np.complex128),
        np.repeat(test.samples, count),
        np.full(len(Y), np.inf),
        ("given",) * len(Y),
        np.zeros(len(Y), dtype=np.int64),
        stretch=np.repeat(np.arange(dwells), count),
        stretches=tuple(SettledDwell(float(f)) for f in test.frequency_hz),
    )
