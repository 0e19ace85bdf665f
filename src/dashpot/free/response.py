"""Frequency response functions with their covariance, of any data and without a rig.

Amplitudes of dwells and of periods are rows Y = H U + e at one frequency, both sides noisy; records of any excitation
have local models of H and of their transients in windows of neighbouring lines (Pintelon and Schoukens, System
Identification, 2nd ed. 2012, chapters 2, 4 and 7).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from scipy import fft
from scipy.special import betaincinv, chdtrc, fdtrc, gammaln

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real
from dashpot.channel import Channel
from dashpot.data.conditioning.clock import even_step
from dashpot.data.conditioning.lines import spectrum as amplitudes_of
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.conditioning.unmeasured import SHORTEST, marked_whole, with_likely
from dashpot.data.conditioning.whole_record import at_rest, refuse_rest, without_gaps
from dashpot.data.noise import moderated, smoothed, with_local_noise
from dashpot.data.periods import averaged_periods
from dashpot.data.readers import Reading
from dashpot.data.readers.text import write_rows
from dashpot.data.readers.uff import FRF, NodalFunction, NodePoint
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.data.record import Record, calibration
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError, UsageError
from dashpot.io.atomic import write_bytes
from dashpot.io.json_document import arrow_table, data_frame
from dashpot.io.words import choose_from, chosen_format, counted, joined
from dashpot.notices import Notice

Band = tuple[float, float]
Data = TypeVar("Data", Record, Spectrum)


@dataclass(frozen=True)
class MeasuredResponse(Frozen):
    """H of each pair of output and input, in units of the output over the input, calibrations taken out.

    inputs, outputs  channels
    frequency_hz  (lines,)
    values        (lines, outputs, inputs)
    covariance    (lines, pairs, pairs), E[Δ Δᴴ] of the pairs in the order of `values`, circular: the real and the
                  imaginary part have half of it each; NaN where the noise is unknown
    coherence     (lines, outputs): share of an output's power that the inputs explain
    apart         (lines,): number of lines after which an estimate shares no data with this one (1: independent)
    method        "dwells", "periods" or "local", depending on the data
    distortion    of periodic tests, share of each output's motion (rms) at even and at odd multiples that are not
                  driven, beyond noise and the inputs' own content there; 0 if not significant, NaN if every multiple
                  is driven
    notes         notices on the result
    records       lines of the records whose local models these are, in SI units: they tell more of sharp resonances
                  than the responses do, and `modes` takes them instead; files do not hold them
    """

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    frequency_hz: Real
    values: Complex
    covariance: Complex
    coherence: Real
    apart: Ints
    method: str
    distortion: dict[str, tuple[float, float]] = field(default_factory=dict)
    notes: tuple[Notice, ...] = ()
    records: tuple[RecordLines, ...] = ()

    def __repr__(self) -> str:
        f = self.frequency_hz
        pairs = ", ".join(self.pairs)
        return f"<MeasuredResponse {pairs}: {len(f)} lines from {f[0]:.4g} to {f[-1]:.4g} Hz>"

    @property
    def pairs(self) -> tuple[str, ...]:
        """OUT/IN of each pair, in the order of `covariance`."""
        return tuple(f"{out.name}/{into.name}" for out in self.outputs for into in self.inputs)

    @property
    def sd(self) -> Real:
        """Standard deviation of the real and of the imaginary part, each, of the shape of `values`."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2).real
        return np.sqrt(np.maximum(variance, 0) / 2).reshape(self.values.shape)

    def unit(self, out: Channel, into: Channel) -> str:
        """Unit of a pair, empty if the data do not state it."""
        if not (out.unit or into.unit):
            return ""
        below = into.unit or "1"
        return f"{out.unit or '1'}/{f'({below})' if set('/·*') & set(below) else below}"

    def chosen(self, lines: Ints | Bools) -> MeasuredResponse:
        """The response at some of the lines."""
        parts = {name: getattr(self, name)[lines] for name in ("frequency_hz", "values", "covariance")}
        return replace(self, **parts, coherence=self.coherence[lines], apart=self.apart[lines])

    def in_band(self, band_hz: Band | None) -> MeasuredResponse:
        """The response at the lines in a band, all without one.  Raises DataError if there is none."""
        return self.chosen(lines_in(self.frequency_hz, band_hz, "responses"))

    def independent(self) -> MeasuredResponse:
        """As many lines as possible that share no data, for fits that treat lines as independent."""
        kept, at = [], 0
        while at < len(self.apart):
            kept.append(at)
            at += int(self.apart[at])
        chosen = self.chosen(np.array(kept, dtype=np.int64))
        return replace(chosen, apart=np.ones(len(kept), dtype=np.int64))

    def to_dataframe(self) -> Any:
        """A pandas DataFrame over frequency: each response, complex, with its sd, and the coherence of each output.

        Raises UsageError without pandas (extra "analysis").
        """
        H, sd = self.values.reshape(len(self.values), -1), self.sd.reshape(len(self.values), -1)
        columns: dict[str, Any] = {"frequency_hz": self.frequency_hz}
        for k, pair in enumerate(self.pairs):
            columns |= {pair: H[:, k], f"{pair}_sd": sd[:, k]}
        columns |= {f"{out.name}_coherence": self.coherence[:, i] for i, out in enumerate(self.outputs)}
        return data_frame(columns, "frequency_hz")

    def to_dict(self) -> dict[str, object]:
        """Frequencies, real and imaginary part and standard deviation of each pair, and the coherence, for JSON."""
        H, sd = self.values.reshape(len(self.values), -1), self.sd.reshape(len(self.values), -1)
        units = [self.unit(out, into) for out in self.outputs for into in self.inputs]
        return {
            "frequency_hz": self.frequency_hz,
            "frf": {
                pair: {"re": H[:, k].real, "im": H[:, k].imag, "sd": sd[:, k], "unit": units[k]}
                for k, pair in enumerate(self.pairs)
            },
            "coherence": {out.name: self.coherence[:, i] for i, out in enumerate(self.outputs)},
            "lines_apart": self.apart,
            "method": self.method,
            "distortion": {name: {"even": even, "odd": odd} for name, (even, odd) in self.distortion.items()},
            "notes": [{"code": note.code, "text": note.text} for note in self.notes],
        }


def lines_in(frequency_hz: Real, band_hz: Band | None, of: str, usable: Bools | bool = True) -> Bools:
    """Which `usable` lines (lines,) of some data lie in a band, all without one.  Raises DataError if none does."""
    low, high = band_hz or (0.0, np.inf)
    there: Bools = usable & (frequency_hz >= low) & (frequency_hz <= high)
    if not np.any(there):
        raise DataError(
            f"no frequency of the {of} lies in the band",
            cure=f"they reach from {frequency_hz.min():.4g} to {frequency_hz.max():.4g} Hz",
        )
    return there


def frequency_response(
    reading: Reading, inputs: Sequence[str], outputs: Sequence[str], band_hz: Band | None = None
) -> MeasuredResponse:
    """The responses of `outputs` to `inputs` in data of any kind, in a band.

    Stepped sine and tables of amplitudes or responses: both sides noisy, as far as the noise is known.  Records that
    repeat: lines that the inputs drive, averaged over the periods.  Other records: local models, inputs exact.
    Raises UsageError for channels that are not there, DataError if the data do not separate the inputs, are too
    short, or hold no excitation in the band.
    """
    return response_of(parted(reading, inputs, outputs), band_hz)


@dataclass(frozen=True)
class Parted:
    """Data by what they are: amplitudes of steady motion, and records of any excitation without gaps; never both.

    inputs      how many of the channels are; they come first
    distortion  as of a MeasuredResponse; empty where no record repeats
    notes       what was said of the data
    """

    inputs: int
    spectra: tuple[Spectrum, ...]
    records: tuple[Record, ...]
    distortion: dict[str, tuple[float, float]]
    notes: tuple[Notice, ...]


def parted(reading: Reading, inputs: Sequence[str], outputs: Sequence[str]) -> Parted:
    """What data are of some inputs and outputs; records without inputs are free decays.  Raises as they are read."""
    if reading.joint:
        raise DataError("channels have their own clocks", cure="record them on one clock")
    told, spectra, whole = list(reading.notes), list[Spectrum](), list[Record]()
    distortion: dict[str, tuple[float, float]] = {}
    if reading.amplitudes is not None:
        spectra.append(with_local_noise(_of_channels(reading.amplitudes, inputs, outputs)))
    records = [_of_channels(record, inputs, outputs) for record in reading.records]
    dwells = [record for record in records if record.frequency_hz is not None]
    if dwells:
        spectra.append(amplitudes_of(dwells, Conditioning(transients="settle")))
    for record in (each for each in records if each.frequency_hz is None):
        repeated = averaged_periods(record, len(inputs)) if inputs else None
        if repeated is None:
            pieces, said = without_gaps(record, split=True)
            told += said
            for piece in pieces:
                parts, said = marked_whole(piece)
                whole, told = [*whole, *parts], [*told, *said]
            continue
        refuse_rest(record, len(inputs))
        spectra.append(repeated[0])
        shares = zip(outputs, repeated[1][len(inputs) :].tolist(), strict=True)
        distortion = distortion or {name: (even, odd) for name, (even, odd) in shares}
    if spectra and whole:
        raise DataError(
            "some data are steady (dwells, periods, tables), others are records of another excitation",
            cure="process them in two calls",
        )
    if not spectra and not whole:
        raise DataError(
            f"no gapless part of the data has {SHORTEST} samples", cure="record longer, or without gaps"
        )
    return Parted(len(inputs), tuple(spectra), _completed(whole, len(inputs)), distortion, tuple(told))


def response_of(data: Parted, band_hz: Band | None = None) -> MeasuredResponse:
    """The responses that parted data show in a band."""
    if data.records:
        found = local_response(data.records, data.inputs, band_hz)
    else:
        lines = concatenate(data.spectra) if len(data.spectra) > 1 else data.spectra[0]
        lines = replace(moderated(lines, kind="periods"), notes=lines.notes)
        found = _of_lines(lines, data.inputs, band_hz, "periods" if data.distortion else "dwells")
    notes = tuple(dict.fromkeys((*data.notes, *found.notes)))
    return replace(found, distortion=data.distortion, notes=notes)


TURNS = 6  # at the most, of samples and models made by each other
SETTLED = 0.05  # of what else local models leave of a channel (rms), by which no sample moves any more


def _completed(records: Sequence[Record], nu: int) -> tuple[Record, ...]:
    """The records with the likeliest values for samples that are not measured: what local models of all others expect,
    and of noise what goes on around them (expectation-maximisation, Dempster, Laird and Rubin 1977)."""
    if all(record.status is None for record in records):
        return tuple(records)
    found = [with_likely(record)[0] for record in records]
    for _ in range(TURNS):
        moved = 0.0
        for k, motion in enumerate(_expected(found, nu)):
            away = with_likely(replace(records[k], values=records[k].values - motion))[0].values
            missed, last = records[k].marks() != 0, found[k].values
            found[k] = replace(records[k], values=away + motion)
            rms = np.sqrt(np.mean(np.where(missed, 0.0, away) ** 2, axis=0))
            moves = np.max(np.abs(found[k].values - last) * missed, axis=0)
            moved = max(moved, float(np.max(moves / np.maximum(rms, np.finfo(float).tiny))))
        if moved < SETTLED:
            break
    return tuple(replace(record, status=None) for record in found)


def _expected(records: Sequence[Record], nu: int) -> list[Real]:
    """The outputs as local models show them, (samples, channels), 0 of the inputs."""
    lines = [record_lines(record, nu) for record in records]
    order = np.argsort([-part.duration_s for part in lines], kind="stable")
    parts = [lines[k] for k in order]
    first, half = parts[0], _smallest_half(parts)
    grid, chunk = np.arange(0, len(first.frequency_hz), half), _at_once(parts, half)
    shown = [np.zeros((part.samples // 2 + 1, len(records[0].channels)), np.complex128) for part in lines]
    for k in range(0, len(grid), chunk):
        r, U, Y, owner = _window_rows(parts, grid[k : k + chunk], half)
        motion = Y - _fitted(r, U, Y, owner, nu, Y.shape[2])[3]
        frequency = first.frequency_hz[grid[k : k + chunk], None] + r * half / first.duration_s
        inwards = np.argsort(-np.median(np.abs(r), axis=0), kind="stable")
        for row in inwards:  # what is nearest to the middle of a window stays
            number = order[owner[row]]
            at = np.rint(frequency[:, row] * lines[number].duration_s).astype(np.int64)
            shown[number][at, nu:] = motion[:, row]
    for record, part, one in zip(records, lines, shown, strict=True):
        one[1 : len(part.frequency_hz) + 1] /= (
            calibration(record.channels, part.frequency_hz) * 2 / part.samples**0.5
        )
    return [fft.irfft(one, part.samples, axis=0) for one, part in zip(shown, lines, strict=True)]


def _of_channels(data: Data, inputs: Sequence[str], outputs: Sequence[str]) -> Data:
    """The inputs, then the outputs.  Raises UsageError if one is not there, or is both."""
    names = [channel.name for channel in data.channels]
    for name in (*inputs, *outputs):
        if name not in names:
            raise UsageError(f"there is no channel {name}", cure=choose_from(names))
    if both := [name for name in outputs if name in inputs]:
        raise UsageError(f"{joined(both)} is input and output", cure="name it once")
    at = [names.index(name) for name in (*inputs, *outputs)]
    channels = tuple(data.channels[i] for i in at)
    if isinstance(data, Spectrum):
        V = data.covariance[..., at, :][..., at]
        return replace(
            data, channels=channels, amplitudes=data.amplitudes[..., at], covariance=V, moments=None
        )
    cell = None if data.cell is None else data.cell[at]
    status = None if data.status is None else data.status[:, at]
    return replace(data, channels=channels, values=data.values[..., at], sd=None, status=status, cell=cell)


# Steady amplitudes: rows at one frequency, both sides noisy.


def _of_lines(spectrum: Spectrum, nu: int, band_hz: Band | None, method: str) -> MeasuredResponse:
    """H at each frequency from the lines there, by the likelihood of noise on both sides."""
    if spectrum.batch:
        raise DataError("repeats of a spectrum have one response each", cure="give one at a time")
    inputs, outputs = spectrum.channels[:nu], spectrum.channels[nu:]
    complete = np.all(np.isfinite(spectrum.amplitudes), axis=1)
    there = lines_in(spectrum.frequency_hz, band_hz, "data", complete)
    frequency, group = np.unique(spectrum.frequency_hz[there], return_inverse=True)
    X, V = spectrum.amplitudes[there], spectrum.covariance[there]
    found, alone = [], 0
    chi2 = free = 0.0
    for k in range(len(frequency)):
        rows = np.flatnonzero(group == k)
        one = _rows(X[rows, :nu], X[rows, nu:], V[rows])
        if one is None:
            alone += 1
            continue
        found.append((k, one))
        chi2, free = chi2 + one.chi2, free + one.free
    if not found:
        names = joined(c.name for c in inputs)
        needed = "at rest" if nu == 1 else "never driven independently of one another"
        raise DataError(
            f"the inputs {names} are {needed} at every frequency"
            if nu > 1
            else f"the input {names} is {needed}",
            cure="make as many tests as there are inputs at each frequency"
            if nu > 1
            else "name what drives the rig",
        )
    notes = list(spectrum.notes)
    # Lines that contradict each other by more than their noise: what varies between them is in the intervals, too
    scale = 1.0
    if free and chdtrc(free, chi2) < 1e-3 and chi2 > 1.2 * free:
        scale = chi2 / free
        text = (
            f"repeats differ by {scale**0.5:.2g} × their noise: the rig is nonlinear, or changed; the standard "
            "deviations include it"
        )
        notes.append(Notice("responses_differ", text))
    if alone:
        text = f"the inputs cannot be separated at {alone} of {len(frequency)} frequencies: left out"
        notes.append(Notice("inputs_alike", text))
    H: Complex = np.stack([one.H for _, one in found])
    covariance: Complex = scale * np.stack([one.covariance for _, one in found])
    f = frequency[[k for k, _ in found]]
    coherence = np.array([one.coherence for _, one in found])
    units = in_units(inputs, outputs)
    return MeasuredResponse(
        inputs,
        outputs,
        f,
        H * units,
        covariance * np.outer(units.ravel(), units.ravel()),
        coherence,
        np.ones(len(f), dtype=np.int64),
        method,
        notes=tuple(notes),
    )


def in_units(inputs: Sequence[Channel], outputs: Sequence[Channel]) -> Real:
    """Factors from SI units to those of the channels, (outputs, inputs)."""
    return np.array([[into.scale / out.scale for into in inputs] for out in outputs])


@dataclass(frozen=True)
class _Rows:
    """What rows of one frequency give: H, its covariance, coherence (outputs,), χ² and its degrees of freedom."""

    H: Complex
    covariance: Complex
    coherence: Real
    chi2: float
    free: float


def _rows(U: Complex, Y: Complex, V: Complex) -> _Rows | None:
    """H of Y (rows, ny) = H U (rows, nu) with noise of covariance V (rows, nu + ny, …) on both sides.

    Of circular noise that is known, −log likelihood over the true inputs is Σ eᴴ C(H)⁻¹ e with e = Y − H U and
    C = [−H 1] V [−H 1]ᴴ (Gauss-Newton: the inputs less what e shows of their noise).  Without known noise the rows are
    weighed alike, and their scatter is the noise.  None where the inputs of the rows are not independent.
    """
    (count, nu), ny = U.shape, Y.shape[1]
    size = np.linalg.svd(U, compute_uv=False)
    if len(size) < nu or size[-1] <= 1e-9 * size[0] or size[0] == 0:
        return None
    H: Complex = np.linalg.lstsq(U, Y, rcond=None)[0].T.astype(np.complex128)
    known = bool(np.all(np.isfinite(V)))
    floor = 1e-26 * np.mean(np.abs(Y) ** 2) + 1e-300
    for _ in range(12 if known else 1):
        e = Y - U @ H.T
        J = np.concatenate(
            [np.broadcast_to(-H, (count, ny, nu)), np.broadcast_to(np.eye(ny), (count, ny, ny))], 2
        )
        C = J @ V @ np.conj(np.swapaxes(J, 1, 2)) if known else np.broadcast_to(np.eye(ny), (count, ny, ny))
        P = np.linalg.inv(C + floor * np.eye(ny))
        weighed = np.einsum("rij,rj->ri", P, e)
        # Of the inputs' noise, what the errors show: cov(ΔU, e) C⁻¹ e
        of_inputs = V[:, :nu] @ np.conj(np.swapaxes(J, 1, 2)) if known else np.zeros((count, nu, ny))
        likely = U - np.einsum("rcj,rj->rc", of_inputs, weighed)
        N = np.einsum("rc,rij,rd->icjd", np.conj(likely), P, likely).reshape(ny * nu, ny * nu)
        covariance: Complex = np.linalg.inv(N).astype(np.complex128)
        step = (covariance @ np.einsum("rc,ri->ic", np.conj(likely), weighed).ravel()).reshape(ny, nu)
        H = H + step
        if np.max(np.abs(step)) <= 1e-10 * np.max(np.abs(H)):
            break
    e = Y - U @ H.T
    chi2 = 2 * float(np.einsum("ri,rij,rj->", np.conj(e), P, e).real)
    free = 2.0 * (count - nu) * ny
    explained = np.sum(np.abs(U @ H.T) ** 2, axis=0)
    if known:
        noise = np.sum(np.diagonal(C, axis1=1, axis2=2).real, axis=0)
        return _Rows(H, covariance, explained / np.maximum(explained + noise, 1e-300), chi2, free)
    if count == nu:
        return _Rows(H, np.full_like(covariance, np.nan), np.full(ny, np.nan), 0.0, 0.0)
    scatter = np.einsum("ri,rj->ij", e, np.conj(e)) / (count - nu)
    pairs: Complex = np.kron(scatter, np.linalg.inv(np.conj(U.T) @ U)).astype(np.complex128)
    noise = count * np.diagonal(scatter).real
    return _Rows(H, pairs, explained / np.maximum(explained + noise, 1e-300), 0.0, 0.0)


# Records of any excitation: in windows of neighbouring lines H and the transient of each record are smooth.

SPARE = (
    8  # complex degrees of freedom that a window leaves for the noise: with its neighbours' some 30 real ones
)
MOST_LINES = 20_000  # of the result


@dataclass(frozen=True)
class RecordLines(Frozen):
    """Lines k/T, k ≥ 1, of one record: peak amplitudes times √N, so that white noise is alike in records of any length.

    inputs (lines, nu), outputs (lines, ny), SI units with calibrations taken out.
    """

    frequency_hz: Real
    inputs: Complex
    outputs: Complex
    duration_s: float
    samples: int


def record_lines(record: Record, nu: int) -> RecordLines:
    """The lines of a record.  Raises DataError for uneven stamps, and outputs that do not move."""
    if record.values.ndim != 2:
        raise DataError("repeats of a record cannot be combined", record.source, "give one at a time")
    refuse_rest(record, nu)
    step, samples = even_step(record), len(record.time)
    lines = (samples - 1) // 2
    frequency = np.arange(1, lines + 1) / (samples * step)
    X = fft.rfft(record.values - record.values.mean(axis=0), axis=0)[1 : lines + 1] * (2 / samples**0.5)
    X = X * calibration(record.channels, frequency) * ~at_rest(record.values)  # inputs at rest: exactly
    return RecordLines(frequency, X[:, :nu], X[:, nu:], samples * step, samples)


def local_response(
    records: Sequence[Record], nu: int, band_hz: Band | None = None, *, every_line: bool = True
) -> MeasuredResponse:
    """H by local models: about each line H and the transient of each record are quadratics, over one where that pays.

    Windows are as narrow as their degrees of freedom allow: those that are widened where the data seem to allow it have
    intervals that are too short at the resonances.  Estimates half a window apart share next to nothing.  Inputs count
    as exact: noise on them biases H towards 0 by its share of their power.  Of not `every_line`, only those of which
    no two share data.  Raises DataError.
    """
    channels = records[0].channels
    parts = sorted((record_lines(record, nu) for record in records), key=lambda part: -part.duration_s)
    first = parts[0]
    for c in range(nu):
        if not any(np.any(part.inputs[:, c]) for part in parts):
            raise DataError(f"the input {channels[c].name} is at rest", cure="name what drives the rig")
    half = _smallest_half(parts)
    grid = np.flatnonzero(lines_in(first.frequency_hz, band_hz, "records"))
    stride = -(-len(grid) // MOST_LINES) if every_line else half
    grid = grid[::stride]
    apart = -(-half // stride)
    H, covariance, between = _windows(parts, grid, half, apart)
    power = _mean_beside(np.abs(np.einsum("lic,lc->li", H, first.inputs[grid])) ** 2, apart)
    noise = np.diagonal(between, axis1=1, axis2=2).real
    units = in_units(channels[:nu], channels[nu:])
    found = MeasuredResponse(
        channels[:nu],
        channels[nu:],
        first.frequency_hz[grid],
        H * units,
        covariance * np.outer(units.ravel(), units.ravel()),
        power / np.maximum(power + noise, 1e-300),
        np.full(len(grid), apart),
        "local",
        records=tuple(parts),
    )
    # From the first to the last line at which an output moves with an input. Of noise alone |H|² is its variance in
    # the mean; four times that, in the mean of a few windows on either side, is no chance.
    variance = np.diagonal(found.covariance, axis1=1, axis2=2).real
    shows = np.abs(found.values.reshape(variance.shape)) ** 2 / np.maximum(variance, 1e-300)
    aside = 2 * int(np.median(found.apart))
    below, above = (_mean_beside(shows, aside, *sides) for sides in ((True, False), (False, True)))
    there = np.flatnonzero(np.max(np.minimum(below, above), axis=1) > 4)
    if not len(there):
        f = found.frequency_hz
        inputs, outputs = (joined(c.name for c in some) for some in (found.inputs, found.outputs))
        what = f"from {f[0]:.4g} to {f[-1]:.4g} Hz no response of {outputs} to {inputs}: no excitation there"
        raise DataError(
            what, cure="choose another band, drive the rig harder, or check which channels are inputs"
        )
    return found if band_hz is not None else found.chosen(np.arange(there[0], there[-1] + 1))


def line_noise(parts: Sequence[RecordLines], low: float, high: float) -> list[Complex]:
    """Noise of the outputs of each record at its lines from `low` to `high` Hz, (lines, ny, ny), as local models leave.

    Records with inputs share the response, free decays nothing.  Raises DataError if one is too short.
    """
    nu = parts[0].inputs.shape[1]
    groups = [list(parts)] if nu else [[part] for part in parts]
    found: dict[int, Complex] = {}
    for group in groups:
        ordered = sorted(group, key=lambda part: -part.duration_s)
        first = ordered[0]
        half = _smallest_half(ordered)
        grid = np.flatnonzero((first.frequency_hz >= low) & (first.frequency_hz <= high))
        if len(grid) < 2 * half + 1:
            raise DataError(
                f"{counted(len(grid), 'line')} of the record in the band",
                cure="record longer, or choose a wider band",
            )
        noise = _windows(ordered, grid[::half], half, 1)[2]
        for part in group:
            f = part.frequency_hz[(part.frequency_hz >= low) & (part.frequency_hz <= high)]
            found[id(part)] = noise[_nearest(first.frequency_hz[grid[::half]], f)]
    return [found[id(part)] for part in parts]


def shares_left(parts: Sequence[RecordLines], chance: float) -> list[Real]:
    """What share of the outputs of each record can be noise, (lines, ny): what local models leave, of one response.

    Of noise alone they leave about its power, and more than is counted here with a probability of 1 − chance.  Windows
    are compared with what they hold themselves, however narrow the band of the noise.  Raises DataError if a record is
    too short.
    """
    ordered = sorted(parts, key=lambda part: -part.duration_s)
    first, half = ordered[0], _smallest_half(ordered)
    nu, ny = first.inputs.shape[1], first.outputs.shape[1]
    lines = len(first.frequency_hz)
    grid = np.arange(0, lines, max(half, lines // 4_000))  # 4,000 windows are looked through
    shares, chunk = [], _at_once(ordered, half)
    for k in range(0, len(grid), chunk):
        r, U, Y, owner = _window_rows(ordered, grid[k : k + chunk], half)
        noise = _fitted(r, U, Y, owner, nu, ny)[2]
        power = np.maximum(np.mean(np.abs(Y) ** 2, axis=1), np.finfo(float).tiny)
        shares.append(np.diagonal(noise, axis1=1, axis2=2).real / power)
    rows = r.shape[1]
    free = rows - 3 * (nu + len(parts)) - 2
    share = np.concatenate(shares) * (free / rows) / betaincinv(free, rows - free, chance)
    nearest = (_nearest(first.frequency_hz[grid], part.frequency_hz) for part in parts)
    return [np.minimum(share[at], 1.0) for at in nearest]


def _at_once(parts: Sequence[RecordLines], half: int) -> int:
    """How many windows are regressed together: 64 MB of regressors."""
    rows = sum(_lines_of(part, parts[0], half) for part in parts)
    return max(1, 4_000_000 // (rows * (3 * (parts[0].inputs.shape[1] + len(parts)) + 2)))


def _smallest_half(parts: Sequence[RecordLines]) -> int:
    """Lines of the longest record, which comes first, on either side of windows that leave SPARE degrees of freedom.

    Raises DataError if a record has fewer lines than a window needs.
    """
    unknowns, half = 3 * (parts[0].inputs.shape[1] + len(parts)) + 2, 3
    while sum(_lines_of(part, parts[0], half) for part in parts) < unknowns + SPARE:
        half += 1
    if any(len(part.frequency_hz) < _lines_of(part, parts[0], half) for part in parts):
        shortest = min(part.samples for part in parts)
        raise DataError(
            f"a record of {counted(shortest, 'sample')} is too short",
            cure=f"each local model needs {2 * half + 1} lines of every record: record longer",
        )
    return half


def _lines_of(part: RecordLines, first: RecordLines, half: int) -> int:
    """How many lines of a record a window has that has 2·half + 1 of the longest."""
    return 2 * max(3, round(half * part.duration_s / first.duration_s)) + 1


def _mean_beside(values: Real, half: int, below: bool = True, above: bool = True) -> Real:
    """Mean over each line and `half` neighbours below and above it (axis 0), fewer at the ends."""
    lines = len(values)
    sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    first = np.maximum(np.arange(lines) - half * below, 0)
    last = np.minimum(np.arange(lines) + half * above + 1, lines)
    mean: Real = (sums[last] - sums[first]) / (last - first).reshape(-1, *[1] * (values.ndim - 1))
    return mean


def _windows(
    parts: Sequence[RecordLines], grid: Ints, half: int, beside: int
) -> tuple[Complex, Complex, Complex]:
    """H (lines, ny, nu), its covariance (lines, pairs, pairs) and the outputs' noise (lines, ny, ny), from windows of
    2·half + 1 lines; of those `beside` of the grid's lines apart each has its own half."""
    first = parts[0]
    nu, ny = first.inputs.shape[1], first.outputs.shape[1]
    chunk = _at_once(parts, half)
    found = [
        _fitted(*_window_rows(parts, grid[k : k + chunk], half), nu, ny) for k in range(0, len(grid), chunk)
    ]
    H, gain, noise = (np.concatenate([one[k] for one in found]) for k in range(3))
    noise = pooled_noise(noise, 2 * beside)
    covariance = (noise[:, :, None, :, None] * gain).reshape(len(grid), ny * nu, ny * nu)
    return H, covariance, noise


def pooled_noise(noise: Complex, apart: int) -> Complex:
    """Mean of noise (lines, q, q) over as many neighbouring lines as make each likeliest by the mean of the others.

    Lines that are `apart` share no data.  Noise goes on over frequency; what a local model misses does not.
    """
    q = noise.shape[1]
    alone = invertible(noise[::apart])
    enough = [half for half in doubled(1, len(alone) // 2) if 2 * half * SPARE > 2 * q]  # for an inverse
    levels = (
        (half, smoothed(alone, half)) for half in [*enough, len(alone)] if len(alone) > 2 * q / SPARE + 1
    )
    scores = [
        (likelihood_by_others(alone, level, min(2 * half + 1, len(alone)), SPARE), half)
        for half, level in levels
    ]
    return smoothed(noise, max(scores)[1] * apart if scores else len(noise))


LEAST_APART = 1e-9  # share of an output's noise power that no other has: a column given twice is one output


def invertible(noise: Complex) -> Complex:
    """Noise (…, q, q) with at least LEAST_APART of each output independent of the others."""
    one = np.eye(noise.shape[-1])
    return noise * (1 + LEAST_APART * one) + 1e-300 * one


def doubled(first: int, end: int) -> list[int]:
    """first, 2 first, 4 first, … below the end."""
    return [first << k for k in range(max(0, end.bit_length())) if first << k < end]


def likelihood_by_others(outer: Complex, level: Complex, count: int, freedom: int = 1) -> float:
    """Log-likelihood of noise (…, q, q) under the mean of the other lines that `level` is of, summed.

    Lines are complex Wishart with `freedom` degrees each, and so are the others' sums: a line's own is distributed as
    their ratio (matrix-variate F), which expects more scatter about a mean of few than about one that is known.
    """
    q = outer.shape[-1]
    others, told = freedom * (count * level - outer), freedom * (count - 1)
    total = (told + freedom) * np.linalg.slogdet(others + freedom * outer)[1]
    total = total - told * np.linalg.slogdet(others)[1]
    constant = np.sum(gammaln(told + freedom - np.arange(q)) - gammaln(told - np.arange(q)))
    return float(np.sum(constant - total))


def _window_rows(parts: Sequence[RecordLines], grid: Ints, width: int) -> tuple[Real, Complex, Complex, Ints]:
    """Place r in the window (lines, rows), inputs and outputs there (lines, rows, …), and each row's record (rows,)."""
    first = parts[0]
    f = first.frequency_hz[grid]
    places, inputs, outputs, owner = [], [], [], []
    for number, part in enumerate(parts):
        own = _lines_of(part, first, width)
        start = np.clip(_nearest(part.frequency_hz, f) - own // 2, 0, len(part.frequency_hz) - own)
        at = start[:, None] + np.arange(own)
        places.append((part.frequency_hz[at] - f[:, None]) * first.duration_s / width)
        inputs.append(part.inputs[at])
        outputs.append(part.outputs[at])
        owner += [number] * own
    join = np.concatenate
    return join(places, axis=1), join(inputs, axis=1), join(outputs, axis=1), np.array(owner)


def _fitted(
    r: Real, U: Complex, Y: Complex, owner: Ints, nu: int, ny: int
) -> tuple[Complex, Complex, Complex, Complex]:
    """H at r = 0 (lines, ny, nu), its covariance over that of the noise (lines, ny, nu, ny, nu), the noise (lines, ny,
    ny), and what is left of Y.

    Y = Σ_k r^k (G_k U + T_k) / (1 + d₁ r + d₂ r²), k = 0, 1, 2, with T of each record and d of each output: linear
    least squares (Levy), then Gauss-Newton as long as the errors fall.  Where chance could do what the denominator does
    (F-test, p > 0.001) it is 1.
    """
    lines, rows = r.shape
    powers = r[:, :, None] ** np.arange(3)
    of_inputs = (powers[..., :, None] * U[..., None, :]).reshape(lines, rows, -1)  # those of k = 0 come first
    records = owner[:, None] == np.unique(owner)
    of_ends = (powers[..., :, None] * records[:, None, :]).reshape(lines, rows, -1)
    linear = np.concatenate([of_inputs, of_ends], axis=2)
    tail = r[..., None] ** np.array([1, 2])
    H, residual = np.empty((lines, ny, nu), dtype=np.complex128), np.empty_like(Y)
    S = np.zeros((lines, ny, nu, rows), dtype=np.complex128)  # what an error of a line does to H
    free = np.full((lines, ny), rows - linear.shape[2] - 2)
    plain, smoother = _least_squares(linear, Y)
    plain_residual = Y - linear @ plain
    for i in range(ny):
        y = Y[..., i]
        now = _least_squares(np.concatenate([linear, -tail * y[..., None]], axis=2), y[..., None])[0][..., 0]
        best, kept = np.full(lines, np.inf), now
        for _ in range(4):  # the last ones move H by far less than its sd
            D = 1 + np.einsum("lrk,lk->lr", tail, now[:, -2:])
            shown = np.einsum("lrk,lk->lr", linear, now[:, :-2]) / D
            e = y - shown
            step, pseudo = _least_squares(
                np.concatenate([linear, -tail * shown[..., None]], axis=2) / D[..., None], e[..., None]
            )
            better = np.sum(np.abs(e) ** 2, axis=1) < best
            best = np.where(better, np.sum(np.abs(e) ** 2, axis=1), best)
            kept = np.where(better[:, None], now, kept)
            residual[..., i] = np.where(better[:, None], e, residual[..., i])
            S[:, i] = np.where(better[:, None, None], pseudo[:, :nu], S[:, i])
            now = kept + np.where(better[:, None], step[..., 0], 0)
        H[:, i] = kept[:, :nu]
        square = np.sum(np.abs(plain_residual[..., i]) ** 2, axis=1)
        more = (square / np.maximum(best, 1e-300) - 1) * free[:, i] / 2
        even = fdtrc(4, 2 * free[:, i], np.maximum(more, 0)) > 1e-3  # also where nothing better was found
        H[even, i] = plain[even, :nu, i]
        residual[even, :, i] = plain_residual[even, :, i]
        S[even, i] = smoother[even, :nu]
        free[even, i] += 2
    noise = np.einsum("lri,lrj->lij", residual, np.conj(residual)) / np.sqrt(
        free[:, :, None] * free[:, None, :]
    )
    return H, np.einsum("licr,ljdr->licjd", S, np.conj(S)), noise, residual


def _nearest(ordered: Real, values: Real) -> Ints:
    """Which of ordered values is nearest to each."""
    return np.searchsorted((ordered[1:] + ordered[:-1]) / 2, values).astype(np.int64)


def _least_squares(A: Complex, y: Complex) -> tuple[Complex, Complex]:
    """Solutions of A x = y, (lines, columns, …), and the pseudo-inverses of A (lines, rows, columns)."""
    size = np.linalg.norm(A, axis=1, keepdims=True)
    size = np.where(size > 0, size, 1.0)
    Q, R = np.linalg.qr(A / size)
    weak = np.abs(np.diagonal(R, axis1=1, axis2=2)) < 1e-10  # of a column's part that the others do not have
    R = R + (weak * 1e-10)[:, :, None] * np.eye(R.shape[1])
    inverse = np.linalg.solve(R, np.conj(np.swapaxes(Q, 1, 2))) / np.swapaxes(size, 1, 2)
    return inverse @ y, inverse.astype(np.complex128)


# Files of responses.

ENDINGS = ("csv", "gz", "parquet", "uff", "unv")


def write_response(found: MeasuredResponse, path: str | os.PathLike[str]) -> None:
    """Write lines of which no two share data, as numbers of the channels: a table or a universal file.

    Tables have OUT/IN_re, _im and _sd, which `identify` reads; Parquet has `A/IN&B/IN_cov_re` and `_im` as well, the
    covariance of outputs.  Universal files have the values alone.  Raises UsageError for another ending, DataError
    where the file cannot be written.
    """
    kind, found = chosen_format(path, ENDINGS), found.independent()
    nu = len(found.inputs)
    into, out = (calibration(some, found.frequency_hz) for some in (found.inputs, found.outputs))
    raw = (into[:, None, :] / out[:, :, None]).reshape(len(into), -1)  # calibrations are in, as in all tables
    H, V = (
        found.values.reshape(raw.shape) * raw,
        found.covariance * raw[:, :, None] * np.conj(raw)[:, None, :],
    )
    if kind in ("uff", "unv"):
        functions = []
        for k, pair in enumerate(found.pairs):
            units = found.outputs[k // nu].unit, found.inputs[k % nu].unit
            ends = NodePoint("", k // nu + 1), NodePoint("", len(found.outputs) + k % nu + 1)
            functions.append(
                NodalFunction(FRF, *ends, found.frequency_hz, H[:, k], *units, (pair, "measured"))
            )
        write_universal_file(path, functions)
        return
    columns: dict[str, Real] = {"frequency_hz": found.frequency_hz}
    for k, pair in enumerate(found.pairs):
        columns |= {f"{pair}_re": H[:, k].real, f"{pair}_im": H[:, k].imag}
        sd = np.sqrt(np.maximum(V[:, k, k].real, 0) / 2)
        if np.all(np.isfinite(sd)):
            columns[f"{pair}_sd"] = sd
    if kind != "parquet":
        write_rows(path, list(columns), list(columns.values()))
        return
    for k, pair in enumerate(found.pairs):
        for m in range(k + 1, len(found.pairs)):
            name = f"{pair}&{found.pairs[m]}_cov"
            columns |= {f"{name}_re": V[:, k, m].real, f"{name}_im": V[:, k, m].imag}
    import pyarrow as pa
    import pyarrow.parquet as pq

    out_stream = pa.BufferOutputStream()
    pq.write_table(arrow_table(columns), out_stream)
    write_bytes(path, out_stream.getvalue().to_pybytes())
