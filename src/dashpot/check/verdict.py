"""The verdict on a fit: by χ², by the signs and modes of the rig, by how residuals run over frequency."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.check.limited_channels import LIMITED, limited_channels
from dashpot.check.record_residuals import hum_notices, mains_hum, standing_out
from dashpot.check.residuals import Residuals, calibrations_of, residuals
from dashpot.check.silent_channels import fundamental_lines, mostly_unheard
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.assessment import Assessment, Finding, Judgement, Misfit
from dashpot.estimate.inference.band_stability import DISAGREE
from dashpot.estimate.inference.diagnostics import dead_channels, of_one_sign
from dashpot.estimate.inference.free_motion import MODES_UNSEEN
from dashpot.estimate.inference.noise_in_time import UNEVEN
from dashpot.estimate.inference.time_course import CLOCK_STEP, GAIN_STEP, JUMP, SPIKES, TIME_CHANGES
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.notices import Notice

REJECTED = 0.01  # p-value of χ² below which a rig does not fit: one clean test in a hundred
MORE_THAN_NOISE = 2.0  # rms of a channel's residuals over the noise
PERHAPS_UNSTABLE = "perhaps_unstable"  # a code
FEWEST = 4  # degrees of freedom below which χ² has no power to speak of
BEYOND = 3.0  # standard deviations by which a sign or a damping ratio must be wrong
SMOOTH = 4.5  # standard deviations of the correlation of neighbouring residuals
WORST = 3  # amplitudes that are named
UNTESTED = ("no_noise", "noise_from_residuals", "few_degrees")  # codes of doubts that no χ² has settled
# What a change in the course of a record may be, and what to do about it, by its code.
IN_TIME = {
    GAIN_STEP: (
        "another range, a loose sensor, or a rig that changed?",
        "give the parts before and after as two records, the gain of one of them unknown",
    ),
    CLOCK_STEP: (
        "samples of that channel lost, its clock set anew, or one of its own?",
        "give the parts before and after as two records, the delay of one of them unknown",
    ),
    SPIKES: (
        "spikes of a loose contact?",
        "leave those samples out: the record is then used in pieces",
    ),
    JUMP: (
        "samples lost, a spike, or a blow that no channel shows?",
        "give the parts before and after it as two records",
    ),
}


def assess(model: Model, spectrum: Spectrum, estimate: Estimate) -> Assessment:
    """The verdict on one estimate (no batch axes) from the spectrum it was made of."""
    theta = estimate.values[: len(model.unknowns)]
    left = residuals(model, theta, spectrum, calibrations_of(model, estimate))
    tones = mains_hum(left, spectrum)
    quiet = replace(left, normalised=np.where(tones, np.nan, left.normalised))
    motions = np.array([not measures_input(model, channel) for channel in spectrum.channels])
    in_time = [notice for notice in estimate.warnings if notice.code in TIME_CHANGES]
    ended = limited_channels(left, spectrum, motions)
    against = [
        *unphysical(model, estimate),
        *unstable(estimate),
        *rejected(estimate),
        *_silent(model, spectrum),
        *(notice for notice in estimate.warnings if notice.code == DISAGREE),
        *in_time,
        *ended,
        *standing_out(left, spectrum, motions, tones),
        *_smooth(
            quiet,
            motions,
            least=1.0 if _sized_elsewhere(estimate, spectrum) else 0.5,
            uneven=any(notice.code == UNEVEN for notice in estimate.warnings),
        ),
    ]
    unheard = [] if spectrum.records else _unheard(left, motions, fundamental_lines(spectrum))
    untested = [] if against else doubts_about(estimate, of_residuals=RESIDUAL in spectrum.noise)
    chance = [notice for notice in estimate.warnings if notice.code == MODES_UNSEEN]
    doubts = [*untested, *chance, *hum_notices(left, motions, tones), *unheard]
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    relative = _relative(left, motions)
    noise = _noise_alone(left, tuple(relative)) if _sized_elsewhere(estimate, spectrum) else {}
    return Assessment(
        verdict, (*against, *doubts), relative, _worst(left) if estimate.fit.dof > 0 else (),
        findings=tuple(_finding_of(notice) for notice in (*ended, *in_time)), relative_noise=noise,
    )  # fmt: skip


def _finding_of(notice: Notice) -> Finding:
    """A change in the course of a record, or a channel that ends, as what may be wrong; its remedy is not tried."""
    if notice.code == LIMITED:
        change = f"drive less, widen the range, or leave {notice.of[0]} out if others show the motion"
        return Finding("channel", notice.of, f"{notice.text}: clipped, or saturated?", change, None)
    question, remedy = IN_TIME[notice.code]
    return Finding("time", notice.of, f"{notice.text}: {question}", remedy, None)


def with_change_in_time(assessment: Assessment, notice: Notice) -> Assessment:
    """The assessment with a change of one channel in the course of a record as its first reason and cause.

    What else seems to change in time is what the fit to that channel makes of the others.
    """
    reasons = [reason for reason in assessment.reasons if reason.code not in TIME_CHANGES]
    return replace(assessment, reasons=(notice, *reasons), findings=(_finding_of(notice),))


def _sized_elsewhere(estimate: Estimate, spectrum: Spectrum) -> bool:
    """Whether the noise is known from more than these residuals, so that their size says whether they are noise."""
    return estimate.fit.known_noise and RESIDUAL not in spectrum.noise


def rejected(estimate: Estimate) -> list[Notice]:
    """That χ² rejects the rig, if it does."""
    fit = estimate.fit
    if not bool(fit.p < REJECTED):
        return []
    return [Notice("chi2", f"the residuals are {float(fit.misfit):.2g} × the noise")]


def doubts_about(estimate: Estimate, *, of_residuals: bool = False) -> list[Notice]:
    """Why nobody should sign a fit that nothing speaks against: χ² has no power, or a mode comes out unstable."""
    return [*powerless(estimate, of_residuals=of_residuals), *unstable_by_chance(estimate)]


def powerless(estimate: Estimate, *, of_residuals: bool = False) -> list[Notice]:
    """Why χ² cannot tell whether the rig fits, if it cannot; `of_residuals`: it is they that say how large noise is."""
    fit = estimate.fit
    if not fit.known_noise:
        return [Notice("no_noise", "the noise is not known, so the size of the residuals cannot be judged")]
    if of_residuals:
        text = "the noise is estimated from the residuals themselves; a record at rest would make the fit testable"
        return [Notice("noise_from_residuals", text)]
    if fit.dof <= 0:
        text = "there are no more data than unknowns, so that nothing is left to test the fit by"
        return [Notice("few_degrees", text)]
    if fit.dof < FEWEST:
        return [Notice("few_degrees", f"{fit.dof} degrees of freedom are too few to test the fit")]
    return []


def _silent(model: Model, spectrum: Spectrum) -> list[Notice]:
    """Channels of moving points that do not move: they fit a rig that stands still."""
    return [
        Notice("silent_channel", f"{name} shows no motion at any line", (name,))
        for name in dead_channels(model, spectrum)
    ]


def unphysical(model: Model, estimate: Estimate) -> list[Notice]:
    """Parts of the rig that are negative beyond doubt by the sensors' noise; entries of free matrices may be."""
    rows = zip(model.unknown_names, of_one_sign(model), estimate.values, estimate.noise_sd, strict=False)
    names = tuple(name for name, held, value, sd in rows if held and value < -BEYOND * sd)
    if not names:
        return []
    return [Notice("negative", f"{joined(names)} {'is' if len(names) == 1 else 'are'} negative", names)]


def unstable(estimate: Estimate) -> list[Notice]:
    """The rig's modes that grow beyond doubt."""
    where, several = _growing(estimate, BEYOND)
    if not where:
        return []
    return [Notice("unstable", f"{where} grow{'' if several else 's'} instead of dying away")]


def unstable_by_chance(estimate: Estimate) -> list[Notice]:
    """Modes that grow as estimated, though by no more than noise may do: such a rig cannot be signed."""
    where, several = _growing(estimate, 0.0)
    if not where:
        return []
    text = f"{where} come{'' if several else 's'} out unstable, though noise alone may do so"
    return [Notice(PERHAPS_UNSTABLE, text)]


def _growing(estimate: Estimate, deviations: float) -> tuple[str, bool]:
    """Modes whose damping ratio is negative by more than so many standard deviations, in words; whether several."""
    modes = estimate.modes
    if modes is None:
        return "", False
    grows = modes.damping_ratio < np.minimum(-deviations * np.nan_to_num(modes.damping_sd), -1e-9)
    where = joined(f"{frequency:.3g}" for frequency in modes.frequency_hz[grows])
    several = bool(np.sum(grows) > 1)
    return (f"the mode{'s' if several else ''} at {where} Hz" if where else ""), several


def _unheard(left: Residuals, motions: Bools, lines: Bools) -> list[Notice]:
    """Channels that are little else than noise at the given lines: they fit anything."""
    unheard = motions & mostly_unheard(left.measured, left.sd, lines)
    quiet = [name for name, noise_only in zip(left.channels, unheard, strict=True) if noise_only]
    if not quiet:
        return []
    which = f"{joined(quiet)} {'is' if len(quiet) == 1 else 'are'}"
    text = f"{which} below three standard deviations of the noise at most lines"
    return [Notice("below_noise", text, tuple(quiet))]


def _smooth(left: Residuals, motions: Bools, least: float, uneven: bool) -> list[Notice]:
    """Channels whose residuals run smoothly over frequency, as they are or against the motion: noise does not.

    What a wrong rig leaves over is in proportion to the drive, whose phase may be another at each line.  Noise that is
    `uneven` in time runs smoothly, too, but no more so at the lines that move most than at the others.
    """
    order = np.argsort(left.frequency_hz, kind="stable")
    names = []
    for c in np.flatnonzero(motions):
        r, motion = left.normalised[order, c] / np.sqrt(2), left.predicted[order, c]
        finite = np.isfinite(r)
        r, phase = r[finite], np.exp(-1j * np.angle(motion[finite]))
        size = float(np.sum(np.abs(r) ** 2))
        if len(r) < 8 or size < least * len(r):
            continue
        loud = np.abs(motion[finite]) > np.median(np.abs(motion[finite])) if uneven else np.ones(len(r), bool)
        if max(_likeness(turned, loud) for turned in (r, r * phase)) > SMOOTH:
            names.append(left.channels[c])
    if not names:
        return []
    return [
        Notice(
            "smooth_residuals", f"the residuals of {joined(names)} run smoothly over frequency", tuple(names)
        )
    ]


def _likeness(r: Complex, loud: Bools) -> float:
    """Standard deviations of the correlation of neighbouring residuals (lines,) beyond that where they are not loud."""
    alike, power = (r[1:] * np.conj(r[:-1])).real, np.abs(r[1:]) ** 2
    correlation, variance = 0.0, 0.0
    for side, lines in ((1, loud[1:]), (-1, ~loud[1:])):
        if np.any(lines):
            correlation += side * float(np.sum(alike[lines]) / max(np.sum(power[lines]), 1e-300))
            variance += 1 / (2 * np.sum(lines))
    return float(correlation / np.sqrt(variance))


def _relative(left: Residuals, motions: Bools) -> Mapping[str, float]:
    """What the model leaves of the motion of each channel, (0 … 1).

    Measured inputs count where the fit meets the outputs by another input than was measured: it is more than noise
    away, and by a greater part than any output.
    """

    def rms(values: Complex) -> Real:
        power: Real = np.sqrt(np.nanmean(np.abs(values) ** 2, axis=0))
        return power

    shown = np.any(np.isfinite(left.measured), axis=0)
    away = np.where(np.isfinite(left.measured), left.measured - left.predicted, np.nan)
    sizes = rms(left.measured[:, shown])
    parts = rms(away[:, shown]) / np.where(sizes > 0, sizes, 1.0)
    names = [name for name, there in zip(left.channels, shown, strict=True) if there]
    moved = motions[shown]
    otherwise = (left.rms()[shown] > MORE_THAN_NOISE) & (parts > np.max(parts[moved], initial=0.0))
    said = moved | otherwise
    return {name: float(part) for name, part, motion in zip(names, parts, said, strict=True) if motion}


def _noise_alone(left: Residuals, names: Sequence[str]) -> dict[str, float]:
    """The rms that the noise alone would leave of each channel's motion, over the rms of that motion.

    It is that of the difference after the inputs were fitted to the same line; none where a channel is met exactly.
    """
    noise: dict[str, float] = {}
    for name in names:
        c = left.channels.index(name)
        seen = np.isfinite(left.measured[:, c])
        variance, motion = left.variance[seen, c], np.abs(left.measured[seen, c]) ** 2
        if np.any(motion > 0):
            noise[name] = float(np.sqrt(np.sum(variance) / np.sum(motion)))
    return noise


def worst_of(misfits: Iterable[Misfit]) -> tuple[Misfit, ...]:
    """The misfits that are named, the largest first."""
    return tuple(sorted(misfits, key=lambda misfit: -misfit.sd)[:WORST])


def _worst(left: Residuals) -> tuple[Misfit, ...]:
    size = np.nan_to_num(np.abs(left.normalised)) / np.sqrt(2)
    order = np.argsort(-size, axis=None)[:WORST]
    misfits = []
    for flat in order:
        line, channel = np.unravel_index(int(flat), size.shape)
        if size[line, channel] > 0:
            misfits.append(
                Misfit(
                    left.channels[int(channel)], float(left.frequency_hz[line]), float(size[line, channel])
                )
            )
    return tuple(misfits)
