"""What whole records lack: length, lines, or inputs that have anything to do with the motion.

A dead sensor, another clock, a band in which nothing was driven, or the free decay of a rig whose input rests: the
noise of such an input explains nothing, and a fit that takes it for the drive ends anywhere.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord
from dashpot.io.words import joined
from dashpot.model.modes import modes
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.notices import Notice
from dashpot.numerics.combined_tests import fishers_product

BIN = 12  # lines in which a response is nearly constant and a transient straight
BINS = 400  # looked at, at most
SPARE = 4  # lines that a bin must have beyond its columns
CHANCE = 0.01  # p-value above which no relation shows
OPEN = 0.1  # of a value: a standard deviation, by the noise alone, from which on it is open
FEW = 4  # equations for each term of the ends and each unknown, below which little is left for the rig


def of_records(model: Model, theta: Real, covariance: Real, spectrum: Spectrum) -> list[Notice]:
    """What is to be said of an estimate that whole records have given (no batch axes).

    theta (m,) or longer with its covariance by the noise alone.
    """
    if not spectrum.records:
        return []
    frequency = modes(model, model.parameters(theta[: len(model.unknowns)])).frequency_hz
    notices = short_records(frequency, spectrum) + modes_outside(
        model, theta, covariance, frequency, spectrum
    )
    few = few_lines(model, spectrum)
    if few is not None:
        notices.append(Notice("few_lines", f"{few}, hardly more; widen the band or record for longer"))
    return notices + unrelated_inputs(model, spectrum)


def short_records(frequency: Real, spectrum: Spectrum) -> list[Notice]:
    """A warning where no whole record lasts for one period of the slowest mode found, of those at `frequency`, Hz."""
    durations = [value.duration_s for value in spectrum.stretches if isinstance(value, WholeRecord)]
    if not durations or len(durations) < len(spectrum.stretches):
        return []
    slowest = float(np.min(frequency[frequency > 0], initial=np.inf))
    if max(durations) * slowest >= 1:
        return []
    text = (
        f"the longest record, {max(durations):.4g} s, is shorter than one period of the slowest mode, "
        f"{1 / slowest:.4g} s: its transient can hardly be separated from its motion"
    )
    return [Notice("short_record", text)]


def modes_outside(
    model: Model, theta: Real, covariance: Real, frequency: Real, spectrum: Spectrum
) -> list[Notice]:
    """A warning where the band holds some modes of the rig only, and leaves unknowns open for that."""
    low, high = float(np.min(spectrum.frequency_hz)), float(np.max(spectrum.frequency_hz))
    moving = frequency[frequency > 0]
    inside = int(np.sum((moving >= low) & (moving <= high)))
    count = len(model.unknowns)
    sd = np.sqrt(np.diagonal(covariance)[:count])
    open_ones = [u.name for u, s, v in zip(model.unknowns, sd, theta, strict=False) if not s < OPEN * abs(v)]
    if inside == len(moving) or not open_ones:
        return []
    text = (
        f"the band from {low:.3g} to {high:.3g} Hz holds {inside} of the rig's {len(moving)} modes, which leaves "
        f"{joined(open_ones)} open: widen the band to the others, or give values"
    )
    return [Notice("modes_outside", text, tuple(open_ones))]


def few_lines(model: Model, spectrum: Spectrum) -> str | None:
    """What to say where the lines of whole records carry hardly more than the terms of their ends; else None."""
    records = [value for value in spectrum.stretches if isinstance(value, WholeRecord)]
    if not records or len(records) < len(spectrum.stretches):
        return None
    outputs = int(np.sum([not measures_input(model, channel) for channel in spectrum.channels]))
    lines = spectrum.lines
    fitted = outputs if model.inputs else 0  # free motion alone is known between the samples as well
    terms = sum(2 * model.n * value.loads + value.polynomial * fitted for value in records)
    if 2 * lines * outputs >= FEW * (terms + len(model.unknowns)):
        return None
    whose = "records'" if len(records) > 1 else "record's"
    return (
        f"the {lines} lines in the band carry {terms} terms of the {whose} ends beside the "
        f"{len(model.unknowns)} unknowns"
    )


def unrelated_inputs(model: Model, spectrum: Spectrum) -> list[Notice]:
    """A warning where no output of any whole record goes with the inputs: F tests in bins of lines, Fisher's product.

    In each bin of lines the outputs are fitted by a straight transient alone, and by the inputs times a constant
    response as well: inputs of white noise then pass as often as stated, whatever the outputs are.
    """
    inputs = np.array([measures_input(model, channel) for channel in spectrum.channels], dtype=bool)
    if not np.any(inputs) or np.all(inputs):
        return []
    amplitudes = spectrum.amplitudes[(0,) * len(spectrum.batch)]
    bins = [
        p
        for number, value in enumerate(spectrum.stretches)
        if isinstance(value, WholeRecord)
        for p in _p_values(amplitudes[spectrum.stretch == number], inputs)
    ]
    if not bins or np.min(fishers_product(bins)) * np.sum(~inputs) <= CHANCE:
        return []
    names = [channel.name for channel, given in zip(spectrum.channels, inputs, strict=True) if given]
    low, high = float(np.min(spectrum.frequency_hz)), float(np.max(spectrum.frequency_hz))
    text = (
        f"from {low:.3g} to {high:.3g} Hz no channel moves with {joined(names)}: a dead sensor, another clock, no "
        "drive in this band, or a free decay, where a resting input is ground"
    )
    return [Notice("unrelated_inputs", text, tuple(names))]


def _p_values(X: Complex, inputs: Bools) -> list[Real]:
    """p-values of the F tests in each bin of one record, (outputs,) each; X (lines, channels)."""
    columns = 2 + int(np.sum(inputs))
    each = max(BIN, columns + SPARE)
    if not np.all(np.isfinite(X)):
        return []
    starts = np.arange(0, len(X) - each + 1, each)
    if not len(starts):
        return []
    part = X[_most_driven(X[:, inputs], starts)[:, None] + np.arange(each)]
    run = np.linspace(-1, 1, each)[:, None]
    transient = np.broadcast_to(np.concatenate([np.ones((each, 1)), run], axis=1), (len(part), each, 2))
    driven = np.concatenate([transient, part[..., inputs]], axis=-1)
    without, left = _left(transient, part[..., ~inputs]), _left(driven, part[..., ~inputs])
    more, free = columns - 2, each - columns
    with np.errstate(divide="ignore", invalid="ignore"):
        F = np.where(left > 0, (without - left) / more / (left / free), np.inf)
    return list(fdtrc(2 * more, 2 * free, F))


def _most_driven(inputs: Complex, starts: Ints) -> Ints:
    """The starts of those BINS bins in which the inputs are strongest; inputs (lines, inputs).

    A few tones in a long record are in few of its bins, and the others tell nothing of them.
    """
    if len(starts) <= BINS:
        return starts
    power = np.abs(inputs) ** 2
    total = np.sum(power / np.maximum(np.mean(power, axis=0), np.finfo(float).tiny), axis=1)
    return starts[np.sort(np.argsort(np.add.reduceat(total, starts))[-BINS:])]


def _left(columns: Complex, Y: Complex) -> Real:
    """Sums of squares of what columns (bins, lines, columns) leave of Y (bins, lines, outputs), (bins, outputs)."""
    size = np.linalg.norm(columns, axis=-2, keepdims=True)
    scaled = columns / np.maximum(size, np.finfo(float).tiny)
    rounding = scaled.shape[-2] * np.finfo(float).eps
    shown = scaled @ (np.linalg.pinv(scaled, rcond=rounding) @ Y)
    left: Real = np.sum(np.abs(Y - shown) ** 2, axis=-2)
    return left
