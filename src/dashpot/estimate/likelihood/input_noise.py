"""The noise of channels that measure inputs of whole records, where their own spectra do not show it.

An error Δ of a measured input moves all outputs as the rig would move them, t Δ; no other error does.  Where Σ is the
covariance of a line's equations and e what the fit leaves over, the likelihood of a variance s of Δ has the slope
|tᴴ Σ⁻¹ e|² − tᴴ Σ⁻¹ t and the information (tᴴ Σ⁻¹ t)²: a step of Fisher's scoring finds s.  It is taken as white, of
one size per sample in all records, and is never more than the quietest part of the channel's own spectrum.  What such
errors put into the outputs is no noise of theirs: it is taken out of their residuals when it is found, or these would
be counted as noisy where the rig moves most, and explain what the inputs' noise does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Real, hermitian
from dashpot.data.conditioning.still import HALF_WINDOW, smoothed
from dashpot.data.conditioning.whole_record import FLOOR
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.objective import estimated_inputs, inputs_by_channel
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, measures_input
from dashpot.notices import Notice

INPUT_NOISE = "input_noise"  # code of a notice
SHOWS = 4.0  # standard deviations of a variance, from which on it is one; few lines may tell it
STAYS = 3.0  # and up to which it is given up again
PIECE = 10_000  # lines at a time
ROOM = 1 + STAYS / (2 * HALF_WINDOW + 1) ** 0.5  # the least of many means, over the mean


@dataclass(frozen=True, eq=False)
class InputNoise:
    """The noise of channels that measure inputs alone, as far as it is known; all (channels,).

    sought: whether it is looked for; level: variance times samples; least, most: what it can be by the record itself
    """

    sought: Bools
    level: Real
    least: Real
    most: Real

    @staticmethod
    def of(view: ObservationModel, spectrum: Spectrum, lines: Bools, V: Complex) -> InputNoise:
        """Before the first fit: sought where the spectrum, or a time of rest, does not leave little to find.

        lines (lines,): of the records whose noise is to be found; V (1, lines, channels, channels) as they show it.
        """
        variance = np.diagonal(V[0, lines], axis1=-2, axis2=-1).real * spectrum.samples[lines, None]
        least, most = np.min(variance, axis=0), most_noise(spectrum, lines)
        sought = view.inputs_alone & (most > ROOM**2 * least)
        return InputNoise(sought, least, least, most)

    def refined(
        self,
        view: ObservationModel,
        spectrum: Spectrum,
        lines: Bools,
        data: Measured,
        residual: Complex,
        G: Complex,
    ) -> InputNoise:
        """After another fit.  What a next step does not bear out is given up for good."""
        ends = self.least, self.most
        shown = input_noise(view, spectrum, lines, data, residual, G, self.level, ends)
        level = np.where(self.sought, shown, self.least)
        return replace(
            self, sought=self.sought & ((self.level <= self.least) | (level > self.least)), level=level
        )

    def moves(self, view: ObservationModel, spectrum: Spectrum, G: Complex) -> Real:
        """Mean power that such errors put into all channels where they count as the inputs, (lines, channels)."""
        alone = view.inputs_alone & view.is_direct
        by_channel = inputs_by_channel(view, alone)
        if by_channel is None:
            return np.zeros(G.shape[:2])
        return np.abs(G @ by_channel) ** 2 @ (self.level * alone) / spectrum.samples[:, None]


def noise_counted(model: Model, spectrum: Spectrum, covariance: Complex) -> tuple[Notice, ...]:
    """How much noise is counted for the measured inputs of records whose noise was not known, and which have none.

    spectrum: before that noise was found, without batch axes; covariance (lines, channels, channels): with it.
    """
    lines = np.array([kind == FLOOR for kind in spectrum.noise])
    variance = np.diagonal(covariance[lines], axis1=-2, axis2=-1).real
    power = np.nan_to_num(np.abs(spectrum.amplitudes[lines])) ** 2
    counted, exact = [], []
    for c, channel in enumerate(spectrum.channels):
        size = float(np.sum(power[:, c]))
        if not measures_input(model, channel) or size == 0:
            continue
        share = float(np.sum(variance[:, c]) / size) ** 0.5
        if share < 1e-3:  # noise that is no more counts for nothing beside that of outputs
            exact.append(channel.name)
        else:
            counted.append((channel.name, f"{channel.name} {100 * share:.2g} %"))
    notices = []
    if counted:
        sizes = joined(text for _, text in counted)
        text = (
            f"noise counted for the inputs, of the rms of each: {sizes}, as far as records in motion tell it from that "
            "of the outputs; one at rest would settle it"
        )
        notices.append(Notice(INPUT_NOISE, text, tuple(name for name, _ in counted)))
    return (*notices, *counted_as_exact(exact))


def counted_as_exact(names: Sequence[str]) -> tuple[Notice, ...]:
    """That inputs, if any, show no noise that matters."""
    if not names:
        return ()
    count = "which counts" if len(names) == 1 else "which count"
    text = f"no noise shows in {joined(names)}, {count} as exact; a record at rest would tell"
    return (Notice(INPUT_NOISE, text, tuple(names)),)


def without_moved(power: Real, moved: Real, smooth: Callable[[Real], Real]) -> Real:
    """Power of the outputs' own noise in residuals that hold what errors of the inputs move as well.

    power, moved (lines, channels); smooth: variances from powers.  Steps of expectation and maximisation.
    """
    noise = smooth(power)
    for _ in range(40):  # turns in which the outputs' noise is told from what errors of the inputs move
        share = noise / np.maximum(noise + moved, np.finfo(float).tiny)
        alone = share**2 * power + share * moved
        before, noise = noise, smooth(alone)
        if np.all(np.abs(noise - before) <= 0.01 * before):
            break
    return alone


def input_noise(
    view: ObservationModel,
    spectrum: Spectrum,
    sought: Bools,
    data: Measured,
    residual: Complex,
    G: Complex,
    before: Real,
    ends: tuple[Real, Real],
) -> Real:
    """Variance times samples of channels that measure inputs alone, (channels,): the next after `before`.

    The least where no more is shown.

    sought (lines,): of the records whose noise is to be found; residual (lines, channels); G (lines, channels, inputs)
    calibrated; ends: the least and most that it can be, (channels,) each.
    """
    score, scale = _slopes(view, data, residual, G)
    each = (sought / spectrum.samples)[:, None]
    information = np.sum((each * scale) ** 2, axis=0)
    usable = view.inputs_alone & view.is_direct & (information > 0)
    information = np.where(usable, information, 1.0)
    # The few lines that tell are those at resonances, from which the fit has its unknowns and boundary loads as well.
    telling = information / np.maximum(np.max((each * scale) ** 2, axis=0), 1e-300)
    fitted = len(view.names) + 2 * view.model.n * len(spectrum.records)
    least, most = ends
    left = np.where(before > least, np.maximum(1 - fitted / (2 * telling), 0.5), 1.0)
    step = np.sum(each * (score / left - scale), axis=0) / information
    level = np.clip(before + step, least, most)
    more = np.where(before > least, STAYS, SHOWS) / np.sqrt(information)
    return np.where(usable & (level > least + more), level, least)


def _slopes(view: ObservationModel, data: Measured, residual: Complex, G: Complex) -> tuple[Real, Real]:
    """|tᴴ Σ⁻¹ e|² and tᴴ Σ⁻¹ t of an error in each channel, both (lines, channels); some lines at a time."""
    score, scale = np.zeros(residual.shape), np.zeros(residual.shape)
    alone = view.inputs_alone & view.is_direct
    for first in range(0, len(residual), PIECE):
        some = slice(first, first + PIECE)
        W, G_some = data.W[0, some], G[some]
        weighted = (W @ residual[some, :, None])[..., 0]
        if data.q is None:
            _, half = estimated_inputs(G_some, W, residual[some])
            taken = np.einsum("lcq,lqc->lc", half, hermitian(G_some) @ W)
            score[some] = np.abs(weighted) ** 2
            scale[some] = (np.diagonal(W, axis1=-2, axis2=-1) - taken).real
            continue
        by_channel = inputs_by_channel(replace(view, omega=view.omega[some]), alone)
        if by_channel is not None:
            t = G_some @ by_channel[..., alone]
            score[some, alone] = np.abs((hermitian(t) @ weighted[..., None])[..., 0]) ** 2
            scale[some, alone] = np.sum(np.conj(t) * (W @ t), axis=-2).real
    return score, scale


def most_noise(spectrum: Spectrum, sought: Bools) -> Real:
    """The variance times samples that white noise of a channel can have, (channels,): the quietest lines show it."""
    least = np.full(len(spectrum.channels), np.inf)
    for number in spectrum.records:
        lines = np.flatnonzero((spectrum.stretch == number) & sought)
        if len(lines):
            power = np.nan_to_num(np.abs(spectrum.amplitudes[0, lines])) ** 2
            around = smoothed(power.astype(np.complex128), HALF_WINDOW).real
            least = np.minimum(least, np.min(around, axis=0) * spectrum.samples[lines[0]])
    return ROOM * least
