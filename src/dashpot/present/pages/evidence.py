"""The evidence of an identification: from model, data and estimate to arrays to figures with what they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from dashpot.check.collinearity import Collinearity, shares_by_band
from dashpot.check.dwell_history import dwell_histories
from dashpot.check.frequency_response import responses_of_channels
from dashpot.check.profile import Profile, profile
from dashpot.check.residuals import Residuals, calibrations_of, correlation, residuals
from dashpot.check.validation import RecordPrediction, validate
from dashpot.data.conditioning.used_dwells import UsedDwell
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, DataError, UsageError
from dashpot.estimate.registry import AUTOMATIC  # those that end in the minimum of χ²
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.present.figures import spectra as figures
from dashpot.present.figures.comparison import estimate_figure
from dashpot.present.figures.dwells import beginnings, whole_dwells
from dashpot.present.figures.findings import profile_figure, shares_figure
from dashpot.present.figures.response import MOST_PLANES, nyquist_figure, response_figure
from dashpot.present.figures.spectra import rows_of_pictures
from dashpot.present.figures.validation import drawn_of, prediction_figure
from dashpot.present.pages.page import Block, figure_picture
from dashpot.present.text.check import profile_in_words
from dashpot.present.text.numbers import short

MOST_PANELS = 16  # channels drawn with amplitude and phase
MOST_IN_FILE = 6  # channels of a figure that stands alone
MOST_NAMES = 40  # unknowns in one picture
MOST_PROFILES = 12  # unknowns whose profile is computed
MOST_AMPLITUDES = 3000  # with more, profiles take longer than the report is worth


def evidence_blocks(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    found: Residuals | None,
    weak: Collinearity | None,
    dwells: Sequence[UsedDwell] = (),
) -> list[Block]:
    """Measured and estimated responses, histories, residuals, intervals, correlations, what each line tells.

    No batch axes; `dwells` are those that the spectrum's lines come from.
    """
    blocks = []
    if spectrum is not None and found is not None:
        blocks += _responses(model, spectrum, estimate, found)
        blocks += _histories(model, spectrum, estimate)
        blocks += _dwells(dwells, found)
        blocks += _residuals(found)
    if len(estimate.names) <= MOST_NAMES:
        text = "Each unknown with its 95 % interval; shaded, the interval at the Cramér-Rao bound."
        if any(unknown.sd is not None for unknown in model.unknowns):
            text += " 'stated' is what the rig file says of it."
        picture = figure_picture(estimate_figure(estimate, model=model), "Parameters with their intervals")
        blocks.append(Block("Intervals", (text,), pictures=(picture,)))
        if len(estimate.names) > 1:
            blocks.append(_correlations(estimate))
    if weak is not None and spectrum is not None and len(weak.names) <= MOST_NAMES:
        blocks.append(shares_block(weak, spectrum))
    return blocks


def prediction_block(title: str, predictions: Sequence[RecordPrediction]) -> Block:
    """FIT of each record and channel, and histories of the first record."""
    texts = [text[:1].upper() + text[1:] for text in fits_in_words(predictions)]
    records = [part for part in predictions if part.samples]
    shown = "Histories and spectra" if records else "Amplitudes and phases"
    drawn = drawn_of(predictions)
    pictures = tuple(
        figure_picture(
            prediction_figure(drawn, rows),
            f"{shown} of {joined([drawn.channels[k] for k in rows])}, measured and predicted",
        )
        for rows in rows_of_pictures(len(drawn.channels))
    )
    if records:
        texts.append(_part_shown(records[0]))
    return Block(title, tuple(texts), pictures=pictures, whole=True)


def fits_in_words(predictions: Sequence[RecordPrediction]) -> list[str]:
    """FIT of every channel, a sentence for each record."""
    texts = []
    for k, part in enumerate(predictions):
        fits = [
            f"{name} {short(100 * float(fit), 3)} %"
            for name, fit in zip(part.channels, part.fit, strict=True)
        ]
        record = f"record {k + 1}: " if len(predictions) > 1 else ""
        texts.append(f"{record}FIT {joined(fits)}.")
    return texts


def _part_shown(record: RecordPrediction) -> str:
    """Which part of a record its histories hold."""
    low, high = (short(float(end), 4) for end in (np.min(record.frequency_hz), np.max(record.frequency_hz)))
    return (
        f"The histories last {short(record.duration_s, 4)} s and hold the {len(record.frequency_hz)} lines from {low} "
        f"to {high} Hz that were used; motion at other frequencies is left out of all curves."
    )


def fit_figure(model: Model, spectrum: Spectrum, estimate: Estimate) -> Figure:
    """Measured and fitted: the first responses, or the first channels where no response can be formed.

    No batch axes.  Raises UsageError where the data drive no output.
    """
    found = residuals(
        model, estimate.values[: len(model.unknowns)], spectrum, calibrations_of(model, estimate)
    )
    responses = responses_of_channels(model, estimate, spectrum, found)
    if responses:
        return response_figure(responses[:MOST_IN_FILE])
    driven = _driven(found)
    if not driven:
        raise UsageError("no channel of these data depends on the estimate", "a figure of the fit")
    return _channels_figure(found, driven[:MOST_IN_FILE])


def _driven(found: Residuals) -> list[int]:
    """Places of the channels that can be compared with a prediction."""
    return [i for i in range(len(found.channels)) if np.any(np.isfinite(found.normalised[:, i]))]


def _channels_figure(found: Residuals, places: Sequence[int]) -> Figure:
    """Channels as measured and as predicted."""
    # Of another experiment's channel there is nothing to compare a prediction with.
    predicted = np.where(np.isfinite(found.measured), found.predicted, np.nan)
    return figures.amplitude_and_phase(
        [found.channels[i] for i in places], [found.units[i] for i in places], found.frequency_hz,
        found.measured[:, places], found.sd[:, places], None, None, predicted[:, places],
    )  # fmt: skip


def _responses(model: Model, spectrum: Spectrum, estimate: Estimate, found: Residuals) -> list[Block]:
    every = responses_of_channels(model, estimate, spectrum, found)
    responses = every[:MOST_PANELS]
    if responses:
        text = "Output over input, measured and predicted by the estimated rig."
        if spectrum.carries_loads:
            text += " The transients at both ends of the record, as estimated, are taken out of the measured motion."
        text += _first(MOST_PANELS, len(every))
        panels = tuple(
            figure_picture(
                response_figure(part),
                f"Amplitude and phase of {joined([shown.channel for shown in part])}, measured and model",
            )
            for part in (responses[rows.start : rows.stop] for rows in rows_of_pictures(len(responses)))
        )
        plane = figure_picture(
            nyquist_figure(responses),
            f"{joined([r.channel for r in responses[:MOST_PLANES]])} in the complex plane",
            wide=len(responses) > 2,
        )
        return [
            Block("Measured and model", (text,), pictures=panels, whole=True),
            Block(
                "In the complex plane",
                (f"Each resonance is a circle.{_first(MOST_PLANES, len(every))}",),
                pictures=(plane,),
                whole=True,
            ),
        ]
    driven = _driven(found)
    chosen = driven[:MOST_PANELS]
    if not chosen:
        return []
    pictures = []
    for rows in rows_of_pictures(len(chosen)):
        places = [chosen[k] for k in rows]
        shown = joined([found.channels[i] for i in places])
        pictures.append(
            figure_picture(
                _channels_figure(found, places), f"Amplitude and phase of {shown}, measured and predicted"
            )
        )
    text = "Amplitude and phase of each channel, as measured and as predicted from the inputs."
    texts = (text + _first(MOST_PANELS, len(driven)),)
    return [Block("Measured and model", texts, pictures=tuple(pictures), whole=True)]


def _first(most: int, channels: int) -> str:
    """That not all channels are drawn."""
    return f" Drawn are the first {most} of {channels} channels." if channels > most else ""


def _histories(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[Block]:
    """The first whole record in time, where there is one."""
    if len(model.nonlinear) or not any(getattr(stretch, "samples", 0) for stretch in spectrum.stretches):
        return []
    try:
        predictions = validate(model, estimate, spectrum)
    except DataError:
        return []
    records = [part for part in predictions if part.samples]
    if not records:
        return []
    block = prediction_block("In time, as used", records[:1])
    text = "The inputs are taken as measured; the fit also estimates their noise and so leaves less."
    return [replace(block, paragraphs=(*block.paragraphs, text))]


def _dwells(dwells: Sequence[UsedDwell], found: Residuals) -> list[Block]:
    """Some dwells in time, the part used shaded."""
    histories = dwell_histories(dwells, found)
    if not histories:
        return []
    cut = [one for one in histories if one.begin > 0 or one.end < one.time[-1]]
    shaded = "Each of these dwells was used whole."
    if cut:
        places = [
            f"at {short(one.frequency_hz, 4)} Hz {short(one.begin, 3)} to {short(one.end, 3)} s of "
            f"{short(float(one.time[-1]), 3)} s"
            for one in cut
        ]
        shaded = f"Shaded is the part that was used: {joined(places)}."
    choice = (
        f"Shown are {len(histories)} of {len(dwells)} dwells, with them the one with the largest residual and the one "
        "of which least was used. Offsets are taken out; predicted is the steady motion."
    )
    channels = joined(histories[0].channels)
    pictures = (
        figure_picture(whole_dwells(histories), f"Dwells of {channels} in time. {shaded}"),
        figure_picture(
            beginnings(histories), f"{channels} where the part used begins, measured and predicted"
        ),
    )
    return [Block("Dwells in time", (shaded, choice), pictures=pictures, whole=True)]


def _residuals(found: Residuals) -> list[Block]:
    size = np.abs(found.normalised) / np.sqrt(2)
    if not np.any(np.isfinite(size)):
        return []
    unit = "their rms (the noise is unknown)" if found.scaled else "the standard deviation of the noise"
    texts = [
        f"Size of measured minus predicted amplitude over {unit}; where the model fits, 95 % lie in the band."
    ]
    rms = [
        f"{name} {short(value, 2)}"
        for name, value in zip(found.channels, found.rms().tolist(), strict=True)
        if np.isfinite(value)
    ]
    texts.append(f"Rms of each channel: {joined(rms)}.")
    worst = found.worst()
    if worst is not None:
        name, f, value = worst
        texts.append(f"The largest is {short(value, 2)}: {name} at {short(f, 4)} Hz.")
    figure = figures.residual_plot(found.channels, found.frequency_hz, size, worst)
    picture = figure_picture(figure, f"Residuals by frequency and channel. {texts[-1]}")
    return [Block("Residuals", tuple(texts), pictures=(picture,))]


def _correlations(estimate: Estimate) -> Block:
    figure = figures.correlation_plot(estimate.names, correlation(estimate.covariance))
    text = "Near ±1, two unknowns are hard to separate: their sum or difference is known better than either."
    return Block(
        "Correlation",
        (text,),
        pictures=(figure_picture(figure, "Correlation matrix of the estimates", wide=False),),
    )


def profiles_block(model: Model, spectrum: Spectrum, estimate: Estimate, level: float) -> Block | None:
    """Profiles of the unknowns whose normal interval misleads; None where there are none, or where they cost much."""
    records = any(getattr(stretch, "samples", 0) for stretch in spectrum.stretches)
    many = len(estimate.names) > MOST_PROFILES or spectrum.amplitudes.size > MOST_AMPLITUDES
    if records or many or len(model.nonlinear) or estimate.method not in AUTOMATIC:
        return None
    differing = []
    for name in estimate.names:
        try:
            profiled = profile(model, spectrum, name, level, estimate)
        except DashpotError:
            return None  # nothing is said of the surface of such a rig
        if bool(profiled.misleads):
            differing.append(profiled)
    return _drawn(differing) if differing else None


def _drawn(profiles: Sequence[Profile]) -> Block:
    names = joined([each.name for each in profiles])
    picture = figure_picture(
        profile_figure(profiles), f"Rise of χ² along {names}, beside the parabola of ± sd"
    )
    texts = ("Where the curve is not the parabola, use the interval from the profile.",)
    return Block(
        "Profiles that differ",
        texts,
        items=tuple(profile_in_words(each) for each in profiles),
        pictures=(picture,),
    )


def shares_block(weak: Collinearity, spectrum: Spectrum) -> Block:
    """What each line tells of each unknown."""
    middles, shares = shares_by_band(weak, spectrum.frequency_hz)
    figure = shares_figure(weak.names, middles, shares)
    text = "Which frequencies determine each unknown: per cent of the information on it."
    if weak.idle:
        text += f" {len(weak.idle)} of {spectrum.lines} lines contribute to no unknown."
    picture = figure_picture(figure, "Share of the information on each unknown by frequency")
    return Block("Information by frequency", (text,), pictures=(picture,))
