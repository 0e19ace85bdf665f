"""Spectrum: complex amplitudes of all channels at each line, with the covariance of their noise.

Wherever amplitudes come from (records, tables, FRF files, simulation), estimation starts here and never asks again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from scipy.fft import next_fast_len

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real, freeze
from dashpot.channel import Channel
from dashpot.data.record import calibration
from dashpot.errors import DataError
from dashpot.io.json_document import optional_library
from dashpot.io.words import choose_from
from dashpot.notices import Notice
from dashpot.shorthand import InNotebooks

# What lines of a Spectrum have in common: a settled dwell, or a whole record with its transient (THEORY
# §8).


@dataclass(frozen=True)
class SettledDwell:
    """Lines of a steady state: no transient is in them.

    fundamental_hz: drive frequency whose multiples the lines are; None if each line stands for itself.
    per_unit: whether the lines are responses per unit of an input: how large the motion was they do not say.
    """

    fundamental_hz: float | None = None
    per_unit: bool = False

    def orders(self, frequency_hz: Real) -> Ints:
        """Multiples of the fundamental that lines at `frequency_hz` are, 1 without one; shape of `frequency_hz`."""
        if self.fundamental_hz is None:
            return np.ones(np.shape(frequency_hz), dtype=np.int64)
        return np.rint(np.asarray(frequency_hz) / self.fundamental_hz).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Unmeasured(Frozen):
    """Samples of a whole record that one channel has not measured: what is put in for them is off by unknowns.

    channel      with what is left of its known gain, sign and delay
    samples      (k,) their numbers
    mean, precision  (k,), (k, k) of the unknowns, as far as known without the record's lines: in the channel's unit,
                 inverse covariance
    """

    channel: Channel
    samples: Ints
    mean: Real
    precision: Real

    def columns(self, omega: Real, record: WholeRecord) -> Complex:
        """Amplitudes at ω (lines,), rad/s, per unit of each unknown: (lines, k)."""
        turn = np.exp(-1j * omega[:, None] * record.step_s * self.samples) * (2 / record.samples)
        return calibration((self.channel,), omega / (2 * np.pi)) * turn


@dataclass(frozen=True)
class WholeRecord:
    """Lines k / T of one stretch of samples, whose motion need not return to where it began.

    duration_s   T = N times the sampling step, s
    samples      N
    loads        whether the lines carry boundary loads, an impulse and a doublet at every coordinate (THEORY (W));
                 False where the motion is periodic in T, or starts and ends at rest
    polynomial   how many of the columns 1, jω, (jω)², … each output channel has for what the ends of the record alias
    ramp         whether each output channel has the column 1/jω of a linear drift as well
    drive_hz     drive frequency of a dwell that may have settled, which is then steady motion at that frequency
    unmeasured   of each channel that has not measured all samples which, unknowns in its lines
    """

    duration_s: float
    samples: int
    loads: bool = True
    polynomial: int = 4
    ramp: bool = False
    drive_hz: float | None = None
    unmeasured: tuple[Unmeasured, ...] = ()

    def __post_init__(self) -> None:
        if not (0 < self.duration_s < np.inf and self.samples > 0 and 0 <= self.polynomial <= 6):
            raise DataError(
                f"a record of {self.samples} samples in {self.duration_s:g} s with {self.polynomial} polynomials",
                cure="its duration and samples must be positive, its columns 0 to 6",
            )

    @property
    def step_s(self) -> float:
        """Sampling step, s."""
        return self.duration_s / self.samples

    def orders(self, frequency_hz: Real) -> Ints:
        """Multiples of 1/T that lines at `frequency_hz` are, of its shape."""
        return np.rint(np.asarray(frequency_hz) * self.duration_s).astype(np.int64)


Stretch = SettledDwell | WholeRecord


def history_of_lines(amplitudes: Complex, order: Ints, samples: int) -> Real:
    """The motion of a record whose lines k/T are those of `order` (lines,), without all others, (samples, ...).

    amplitudes (lines, ...), peak, in any unit: the history has the same.  Other than the record's own number of samples
    show the same motion more or less finely.
    """
    lines = np.zeros((samples // 2 + 1, *amplitudes.shape[1:]), dtype=np.complex128)
    lines[order] = amplitudes * samples / 2
    return np.fft.irfft(lines, samples, axis=0)


@dataclass(frozen=True)
class LinesInTime:
    """The lines of one whole record, their multiples of 1/T (lines,), and how many samples show them in time."""

    lines: Ints
    order: Ints
    duration_s: float
    samples: int

    @property
    def step_s(self) -> float:
        """Step of the samples, s."""
        return self.duration_s / self.samples

    @property
    def for_squares(self) -> LinesInTime:
        """By twice as many samples as the lines ask for, so that squares alias nothing and no peak is missed."""
        return replace(self, samples=int(next_fast_len(4 * (int(np.max(self.order)) + 1), real=True)))

    def history(self, amplitudes: Complex) -> Real:
        """The samples of amplitudes (lines of the whole spectrum, ...), (samples, ...)."""
        return self.history_of(amplitudes[self.lines])

    def history_of(self, amplitudes: Complex) -> Real:
        """The samples of amplitudes of these lines alone (lines, ...), (samples, ...)."""
        return history_of_lines(amplitudes, self.order, self.samples)

    def amplitudes(self, history: Real) -> Complex:
        """What a history (samples, ...) has at these lines, (lines, ...)."""
        return np.fft.rfft(history, axis=0)[self.order] * (2 / self.samples)


def joined_stretches(parts: Sequence[tuple[Ints, tuple[Stretch, ...]]]) -> tuple[Ints, tuple[Stretch, ...]]:
    """Stretches of several spectra put one after another, (lines of all,).

    Records and dwells stay apart, even where they are alike; lines that stand for themselves share one stretch.
    """
    stretches: list[Stretch] = []
    lines = []
    for stretch, values in parts:
        number = np.zeros(len(values), dtype=np.int64)
        for i, value in enumerate(values):
            if isinstance(value, SettledDwell) and value.fundamental_hz is None and value in stretches:
                number[i] = stretches.index(value)
                continue
            number[i] = len(stretches)
            stretches.append(value)
        lines.append(number[stretch])
    return np.concatenate(lines) if lines else np.zeros(0, dtype=np.int64), tuple(stretches)


def taken_as_measured(spectrum: Spectrum) -> Spectrum:
    """The same, with what is put in for samples that are not measured counting as measured: for first fits."""
    if not any(value.unmeasured for value in spectrum.stretches if isinstance(value, WholeRecord)):
        return spectrum
    plain = (replace(v, unmeasured=()) if isinstance(v, WholeRecord) else v for v in spectrum.stretches)
    return replace(spectrum, stretches=tuple(plain))


def selected(stretch: Ints, stretches: tuple[Stretch, ...]) -> tuple[Ints, tuple[Stretch, ...]]:
    """The stretches that are still used by lines with the numbers `stretch`, renumbered.  stretch (lines,)."""
    if not len(stretch):
        return stretch, stretches[:1]
    used, number = np.unique(stretch, return_inverse=True)
    return number.astype(np.int64), tuple(stretches[int(i)] for i in used)


FITTED = "fitted"  # kind of noise


@dataclass(frozen=True)
class Moments(Frozen):
    """Second moments Σ_t q qᵀ of the samples, for the methods of the paper that work on samples.

    q(t) = (channels in SI units, cos ωt, sin ωt) with offset and drift removed from every entry;
    `products` has shape (..., lines, channels + 2, channels + 2).
    """

    products: Real


@dataclass(frozen=True)
class Spectrum(InNotebooks):
    """Complex amplitudes, x(t) = Re(X e^{jωt}), in SI units with known gains, signs and delays taken out.

    frequency_hz  (lines,)                      the same frequency may occur more than once
    amplitudes    (..., lines, channels)        NaN where a channel was not measured
    covariance    (..., lines, channels, channels)  V = E[Δ Δᴴ] of the amplitudes' noise Δ, taken as circular: the real
                  and the imaginary part have the covariance Re V / 2 each.  0 is exact; NaN is unknown.  Leading axes
                  may be missing where all repeats share it.
    samples       (lines,)                      samples behind each line (1 if only amplitudes are available)
    dof           (lines,)                      residual degrees of freedom (real) behind V; inf where V is given
    noise         (lines,)                      how V was found: "given", "white", "blocks" (lines next to each
                  harmonic), "periods" (scatter of averages of periods), of whole records "rest" (an at-rest record),
                  "floor" (where nothing moves; replaced by) "residual" (from residuals of a fit), of tables that
                  give none "fitted" (as a function of frequency, from residuals of a fit), or "unknown"
    experiment    (lines,)                      which experiment a line belongs to
    moments       second moments of the samples, where they were asked for
    notes         what a reader of results should know: samples discarded, noise that could not be judged
    stretch       (lines,)                      index into `stretches`; all settled where it is not given
    stretches     what they share: settled dwells, or records with their boundary loads
    unsettled     the same data with the dwells that are too short to show whether they have settled as whole records;
                  which of the two it is only a fit can tell
    """

    channels: tuple[Channel, ...]
    frequency_hz: Real
    amplitudes: Complex
    covariance: Complex
    samples: Ints
    dof: Real
    noise: tuple[str, ...]
    experiment: Ints
    moments: Moments | None = None
    notes: tuple[Notice, ...] = ()
    stretch: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    stretches: tuple[Stretch, ...] = (SettledDwell(),)
    unsettled: Spectrum | None = None

    def __repr__(self) -> str:
        f = self.frequency_hz
        span = f" from {np.min(f):.4g} to {np.max(f):.4g} Hz" if len(f) else ""
        repeats = f", {' × '.join(map(str, self.batch))} repeats" if self.batch else ""
        names = ", ".join(channel.name for channel in self.channels)
        return f"<Spectrum of {names}: {len(f)} lines{span}{repeats}>"

    def __post_init__(self) -> None:
        for name in ("channels", "noise", "notes", "stretches"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not np.size(self.stretch):
            object.__setattr__(self, "stretch", np.zeros(len(self.frequency_hz), dtype=np.int64))
        freeze(self)
        self._require_shapes()
        self._require_numbers()

    def _require_shapes(self) -> None:
        lines, channels = len(self.frequency_hz), len(self.channels)
        expected = {
            "amplitudes": (self.amplitudes.shape[-2:], (lines, channels)),
            "covariance": (self.covariance.shape[-3:], (lines, channels, channels)),
            "samples": (self.samples.shape, (lines,)),
            "dof": (self.dof.shape, (lines,)),
            "noise": ((len(self.noise),), (lines,)),
            "experiment": (self.experiment.shape, (lines,)),
            "stretch": (self.stretch.shape, (lines,)),
        }
        for name, (shape, wanted) in expected.items():
            if shape != wanted:
                raise DataError(f"{name} has shape {shape}, its last axes must be {wanted}")
        if lines and not (self.stretch.min() >= 0 and self.stretch.max() < len(self.stretches)):
            raise DataError(
                f"a line belongs to stretch {self.stretch.max()} of {len(self.stretches)}",
                cure="stretch counts from 0 through stretches",
            )

    def _require_numbers(self) -> None:
        names = [channel.name for channel in self.channels]
        if len(set(names)) != len(names):
            raise DataError("a channel is named twice", cure="every channel needs its own name")
        wrong = ~(np.isfinite(self.frequency_hz) & (self.frequency_hz > 0))
        if np.any(wrong):
            line = int(np.argmax(wrong))
            raise DataError(
                f"frequency {self.frequency_hz[line]} Hz at line {line + 1}",
                cure="frequencies must be positive and finite",
            )
        negative = np.diagonal(self.covariance, axis1=-2, axis2=-1).real < 0
        for wrong, what, cure in (
            (np.isinf(self.amplitudes), "an infinite amplitude", "what is not measured is NaN"),
            (negative, "a negative variance", "covariances are E[Δ Δᴴ]; 0 is exact, NaN unknown"),
        ):
            if np.any(wrong):
                line, channel = np.argwhere(wrong)[0][-2:]
                raise DataError(f"{what} of {names[channel]} at line {line + 1}", cure=cure)

    @property
    def omega(self) -> Real:
        """2π f, (lines,), rad/s."""
        return 2 * np.pi * self.frequency_hz

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.frequency_hz)

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes: repeats of the same test."""
        return self.amplitudes.shape[:-2]

    @cached_property
    def present(self) -> Bools:
        """Which channels were measured at which line in all repeats, (lines, channels)."""
        finite = np.isfinite(self.amplitudes)
        return np.asarray(finite.reshape(-1, *finite.shape[-2:]).all(axis=0))

    @cached_property
    def complete(self) -> bool:
        """Whether every channel was measured at every line in all repeats."""
        return bool(np.isfinite(self.amplitudes).all())

    def index(self, name: str) -> int:
        """Position of a channel by name.  Raises DataError if there is none."""
        for i, channel in enumerate(self.channels):
            if channel.name == name:
                return i
        raise DataError(f"there is no channel {name}", cure=choose_from(c.name for c in self.channels))

    def sd(self) -> Real:
        """Standard deviation of the real (and of the imaginary) part of each amplitude, (..., lines, channels), SI."""
        diagonal = np.diagonal(self.covariance, axis1=-2, axis2=-1).real
        return np.sqrt(np.maximum(diagonal, 0.0) / 2)

    @property
    def records(self) -> tuple[int, ...]:
        """Indices of the stretches that are whole records."""
        return tuple(i for i, value in enumerate(self.stretches) if isinstance(value, WholeRecord))

    def in_time(self, number: int) -> LinesInTime:
        """The lines of the record that is stretch `number`, by as few samples as they ask for."""
        lines, record = np.flatnonzero(self.stretch == number), self.stretches[number]
        assert isinstance(record, WholeRecord)
        order = record.orders(self.frequency_hz[lines])
        return LinesInTime(lines, order, record.duration_s, 2 * (int(np.max(order)) + 1))

    @property
    def carries_loads(self) -> bool:
        """Whether some lines carry the transients of whole records."""
        return any(isinstance(value, WholeRecord) and value.loads for value in self.stretches)

    @cached_property
    def noise_given(self) -> bool:
        """Whether the noise of every line was given rather than estimated from samples."""
        return bool(np.isinf(self.dof).all())

    @cached_property
    def noise_known(self) -> bool:
        """Whether the covariance of the amplitudes is given or was estimated from samples, at every line.

        A covariance of 0 throughout counts as unknown, since it gives residuals no scale.  So does one that was
        fitted to these amplitudes.
        """
        return (
            FITTED not in self.noise and not np.isnan(self.covariance).any() and bool(self.covariance.any())
        )

    def derived(self, **changes: Any) -> Spectrum:
        """The same spectrum with other arrays, read-only and of the right shapes; nothing is checked again."""
        other = object.__new__(Spectrum)
        other.__dict__.update(self.__dict__, **changes)
        for fact in ("present", "complete", "noise_known", "noise_given"):  # of the old arrays
            other.__dict__.pop(fact, None)
        return other

    def select(self, lines: Sequence[int] | Ints) -> Spectrum:
        """The same spectrum with only some lines (count,), in the order given."""
        i = np.asarray(lines, dtype=np.int64)
        return Spectrum(
            self.channels,
            self.frequency_hz[i],
            self.amplitudes[..., i, :],
            self.covariance[..., i, :, :],
            self.samples[i],
            self.dof[i],
            tuple(self.noise[int(k)] for k in i),
            self.experiment[i],
            None if self.moments is None else Moments(self.moments.products[..., i, :, :]),
            self.notes,
            *selected(self.stretch[i], self.stretches),
        )

    def signs(self, given: Mapping[str, Any], repeats: int = 1) -> Real:
        """Signs of all channels, (repeats, channels): as `given` by name, one value or one per repeat; else 1.

        Raises DataError if there is no channel of such a name.
        """
        signs = np.ones((repeats, len(self.channels)))
        for name, sign in given.items():
            signs[:, self.index(name)] = np.ravel(sign)
        return signs

    def with_channels(self, channels: tuple[Channel, ...]) -> Spectrum:
        """The same numbers under other channel descriptions, one for one."""
        unsettled = None if self.unsettled is None else self.unsettled.with_channels(channels)
        return replace(self, channels=channels, unsettled=unsettled)

    def to_xarray(self) -> Any:
        """An xarray Dataset: amplitude (…, line, channel), covariance (…, line, channel, other); … repeats.

        SI units.  Coordinates: frequency_hz, experiment, samples, dof and noise of each line, quantity of each channel.
        Repeats that have one covariance share it.  Raises UsageError without xarray (extra "analysis").
        """
        xarray = optional_library("xarray", "analysis", "to_xarray")
        repeats = [f"repeat_{axis}" for axis in range(len(self.batch))]
        shared = self.covariance.shape[:-3] != self.batch
        V = self.covariance.reshape(self.covariance.shape[-3:]) if shared else self.covariance
        names = [channel.name for channel in self.channels]
        return xarray.Dataset(
            {
                "amplitude": ([*repeats, "line", "channel"], self.amplitudes),
                "covariance": ([*([] if shared else repeats), "line", "channel", "other"], V),
            },
            coords={
                "channel": names,
                "other": names,
                "quantity": ("channel", [channel.quantity.value for channel in self.channels]),
                "frequency_hz": ("line", self.frequency_hz),
                "experiment": ("line", self.experiment),
                "samples": ("line", self.samples),
                "dof": ("line", self.dof),
                "noise": ("line", list(self.noise)),
            },
        )

    def __add__(self, other: Spectrum) -> Spectrum:
        """Lines of both; channels are matched by name, and one that is missing on a side is NaN there."""
        return concatenate([self, other])


def concatenate(spectra: Sequence[Spectrum]) -> Spectrum:
    """Lines of all the spectra, one after another.  Channels are matched by name.

    Raises DataError if there are none, channels of one name are described differently, or batches do not match.
    """
    if not len(spectra):
        raise DataError("there are no data", cure="give at least one record or spectrum")
    if len(spectra) == 1:
        return spectra[0]
    # Every channel once, in the order of first mention
    described: dict[str, Channel] = {}
    for spectrum in spectra:
        for channel in spectrum.channels:
            if described.setdefault(channel.name, channel) != channel:
                raise DataError(
                    f"channel {channel.name} is described differently in the spectra that are put together",
                    cure="describe it once, or name one of them differently",
                )
    channels = tuple(described.values())
    batch = np.broadcast_shapes(*(spectrum.batch for spectrum in spectra))
    shared = all(spectrum.covariance.ndim == 3 for spectrum in spectra)
    widened = []
    for spectrum in spectra:
        place = {channel.name: i for i, channel in enumerate(spectrum.channels)}
        where = [i for i, channel in enumerate(channels) if channel.name in place]
        source = [place[channel.name] for channel in channels if channel.name in place]
        lines, count = spectrum.lines, len(channels)
        amplitudes = np.full((*batch, lines, count), np.nan + 0j)
        amplitudes[..., where] = np.broadcast_to(
            spectrum.amplitudes[..., source], (*batch, lines, len(where))
        )
        covariance = np.zeros((*(() if shared else batch), lines, count, count), dtype=complex)
        rows, columns = np.ix_(where, where)
        covariance[..., rows, columns] = spectrum.covariance[..., source, :][..., source]
        widened.append((amplitudes, covariance))

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(spectrum, name) for spectrum in spectra])

    # The same lines with undecided dwells as whole records; None if there are none
    if all(spectrum.unsettled is None for spectrum in spectra):
        unsettled = None
    else:
        unsettled = concatenate([spectrum.unsettled or spectrum for spectrum in spectra])
    return Spectrum(
        channels,
        joined("frequency_hz"),
        np.concatenate([amplitudes for amplitudes, _ in widened], axis=-2),
        np.concatenate([covariance for _, covariance in widened], axis=-3),
        joined("samples"),
        joined("dof"),
        tuple(kind for spectrum in spectra for kind in spectrum.noise),
        joined("experiment"),
        _moments(spectra, [channel.name for channel in channels], batch),
        tuple(dict.fromkeys(note for spectrum in spectra for note in spectrum.notes)),
        *joined_stretches([(spectrum.stretch, spectrum.stretches) for spectrum in spectra]),
        unsettled,
    )


def _moments(spectra: Sequence[Spectrum], names: list[str], batch: tuple[int, ...]) -> Moments | None:
    """Moments of all lines, kept only where every spectrum has all the channels and the moments."""
    parts = []
    for spectrum in spectra:
        place = {channel.name: i for i, channel in enumerate(spectrum.channels)}
        if spectrum.moments is None or set(place) != set(names):
            return None
        order = [*(place[name] for name in names), len(names), len(names) + 1]
        products = spectrum.moments.products[..., order, :][..., order]
        parts.append(np.broadcast_to(products, (*batch, *products.shape[-3:])))
    return Moments(np.concatenate(parts, axis=-3))


def merge_repeats(spectrum: Spectrum) -> Spectrum:
    """Merge the lines of one frequency and experiment into one, averaging amplitudes by their covariances.

    The repeats must have been driven alike.  Lines whose noise is unknown or singular are averaged evenly.  Lines of
    whole records are kept, since each record has its own transient; so are equal lines of different fundamentals.
    Raises DataError as `concatenate` where lines do not go together.
    """
    groups: dict[tuple[float, int, int | float | None], list[int]] = {}
    for line, (f, experiment, number) in enumerate(
        zip(
            spectrum.frequency_hz.tolist(),
            spectrum.experiment.tolist(),
            spectrum.stretch.tolist(),
            strict=True,
        )
    ):
        shared = spectrum.stretches[number]
        apart = shared.fundamental_hz if isinstance(shared, SettledDwell) else -1 - number
        groups.setdefault((f, experiment, apart), []).append(line)
    if len(groups) == spectrum.lines:
        return spectrum
    averaged = []
    for group in groups.values():
        lines = spectrum.select(group)
        if lines.lines == 1:
            averaged.append(lines)
        else:
            V = lines.covariance
            identity = np.eye(len(lines.channels))
            weights = np.broadcast_to(identity / lines.lines, V.shape)
            covariance = np.sum(V, axis=-3, keepdims=True) / lines.lines**2
            if np.all(np.isfinite(V)) and np.all(np.isfinite(lines.amplitudes)):
                exact = np.all(np.diagonal(V, axis1=-2, axis2=-1) == 0, axis=-2, keepdims=True)
                filled = V + exact[..., None] * identity
                if np.all(np.linalg.matrix_rank(filled, hermitian=True) == len(lines.channels)):
                    precision = np.linalg.inv(filled)
                    total = np.sum(precision, axis=-3, keepdims=True)
                    weights = np.linalg.solve(total, precision)
                    covariance = np.where(exact[..., None] | exact[..., None, :], 0.0, np.linalg.inv(total))
            amplitudes = np.sum(
                np.einsum("...lij,...lj->...li", weights, lines.amplitudes), axis=-2, keepdims=True
            )
            moments = lines.moments
            if moments is not None:
                moments = Moments(np.sum(moments.products, axis=-3, keepdims=True))
            averaged.append(
                replace(
                    lines.select([0]),
                    amplitudes=amplitudes,
                    covariance=covariance,
                    samples=np.sum(lines.samples, keepdims=True),
                    dof=np.sum(lines.dof, keepdims=True),
                    moments=moments,
                )
            )
    merged = concatenate(averaged)
    first = np.array([group[0] for group in groups.values()])
    stretch, stretches = selected(spectrum.stretch[first], spectrum.stretches)
    return replace(merged, stretch=stretch, stretches=stretches)


# The repeats of a test, the leading axes of a Spectrum, as one axis and in chunks.


def flattened(spectrum: Spectrum) -> Spectrum:
    """The same spectrum with exactly one leading axis of repeats on amplitudes, covariance (or 1) and moments."""
    if len(spectrum.batch) == 1 and spectrum.covariance.ndim == 4 and spectrum.moments is None:
        return spectrum
    repeats = prod(spectrum.batch)
    V = spectrum.covariance
    if V.ndim == 3:
        V = V[None]
    elif V.shape[:-3] != (1,):
        V = np.broadcast_to(V, (*spectrum.batch, *V.shape[-3:])).reshape(repeats, *V.shape[-3:])
    moments = None
    if spectrum.moments is not None:
        M = spectrum.moments.products
        moments = Moments(
            np.broadcast_to(M, (*spectrum.batch, *M.shape[-3:])).reshape(repeats, *M.shape[-3:])
        )
    amplitudes = spectrum.amplitudes.reshape(repeats, *spectrum.amplitudes.shape[-2:])
    return spectrum.derived(amplitudes=amplitudes, covariance=V, moments=moments)


def in_chunks(flat: Spectrum, size: int) -> Iterator[Spectrum]:
    """The repeats of a flat spectrum, `size` at a time."""
    if len(flat.amplitudes) <= size:
        yield flat
        return
    for first in range(0, len(flat.amplitudes), size):
        rows = slice(first, first + size)
        V = flat.covariance if len(flat.covariance) == 1 else flat.covariance[rows]
        moments = None if flat.moments is None else Moments(flat.moments.products[rows])
        yield flat.derived(amplitudes=flat.amplitudes[rows], covariance=V, moments=moments)
