"""The verdict on a fit: by χ², by the signs and modes of the rig, by how residuals run over frequency."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import fdtrc

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.check.explain.effect import Phrase
from dashpot.check.residuals import discrepancies, residuals_of
from dashpot.data.periods import driven_lines
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Assessment, Discrepancy, Finding, Judgement, Misfit, Residuals
from dashpot.estimate.inference.diagnostics import MODES_UNSEEN, dead_channels, of_one_sign
from dashpot.estimate.inference.time_course import (
    CLOCK_STEP,
    DISAGREE,
    GAIN_STEP,
    JUMP,
    SPIKES,
    TIME_CHANGES,
    UNEVEN,
)
from dashpot.estimate.likelihood.record_noise import RESIDUAL, share_without_misfit
from dashpot.estimate.nonlinear.objective import nonlinear_part
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.model.observation import measures_input
from dashpot.notices import Notice

# Channels of whole records that bend away from what they should show where it is large: clipped, or
# saturated.


LIMITED = "limited_channel"
LEVELS = np.linspace(0.3, 0.96, 16)  # of the largest motion, beyond which a channel may read less
IMPROBABLE = 1e-6  # p-value of a form by chance


def limited_channels(left: Residuals, spectrum: Spectrum, motions: Bools) -> list[Notice]:
    """Motions (channels,) that end in some whole record, by the fit to all channels, with where they do."""
    notices: dict[str, Notice] = {}
    for number in spectrum.records:
        its = spectrum.stretch == number
        for c in np.flatnonzero(motions):
            y, p = left.measured[:, c], left.predicted[:, c]
            if not np.all(np.isfinite(y[its]) & np.isfinite(p[its])):
                continue
            clipped = clipped_beyond(spectrum, number, y, p)
            if clipped is not None:
                name = left.channels[c]
                text = f"{name} saturates at about {clipped[0]:.3g} {left.units[c]}"
                notices.setdefault(name, Notice(LIMITED, text, (name,)))
    return list(notices.values())


def clipped_beyond(
    spectrum: Spectrum, number: int, measured: Complex, predicted: Complex
) -> tuple[float, Complex] | None:
    """Where a channel ends in one of the records, if what it shows bends away from what it should, and what it loses.

    All amplitudes are (lines,), and what it loses is 0 at those of other records.  What its samples lose beyond a
    level, on either side, is sharper than its lines show.  None where that explains too little.
    """
    at, record = spectrum.in_time(number), spectrum.stretches[number]
    assert isinstance(record, WholeRecord)
    recorded = replace(at, samples=max(record.samples, at.samples))
    expected = recorded.history(predicted)
    # 0.02 of a record at either end, where what its ends leave in its lines is least well known
    ends = int(0.02 * at.samples)
    inner = slice(ends, at.samples - ends)
    shown, should = at.history(measured)[inner], at.history(predicted)[inner]
    largest = float(np.quantile(np.abs(should), 0.999))  # quantile of the motion that counts as the largest
    if largest == 0:
        return None
    straight = np.stack([np.ones(len(should)), should / largest], axis=1)
    rest = _left(straight, shown)[1]
    freedom = 2 * len(at.lines) - straight.shape[1] - 3
    found = []
    for level in LEVELS:
        over = np.stack(
            [np.minimum(level * largest - expected, 0.0), np.maximum(-level * largest - expected, 0.0)]
        )
        lost = recorded.amplitudes(over.T)
        values, bent = _left(np.concatenate([straight, at.history_of(lost)[inner]], axis=1), shown)
        found.append((bent, level, values, lost))
    bent, level, values, lost = min(found, key=lambda each: each[0])
    # 0.4: share of what a straight line leaves that bending must explain
    if not 0 < bent < (1 - 0.4) * rest or freedom < 1:
        return None
    if not fdtrc(3, freedom, (rest - bent) / 3 / (bent / freedom)) < IMPROBABLE:
        return None
    # 0.4 of the slope in the middle that is lost beyond: what a channel near its limit shows at most
    (offset, slope), sides = values[:2], values[2:]
    side = int(np.argmax(sides * np.sign(slope)))
    if not sides[side] * largest * np.sign(slope) > 0.4 * abs(slope):
        return None
    put_back = np.zeros(spectrum.lines, dtype=np.complex128)
    put_back[at.lines] = lost @ sides
    return float(abs(offset + (1, -1)[side] * slope * level)), put_back


def _left(columns: Real, y: Real) -> tuple[Real, float]:
    """Values of a least-squares fit and the sum of squares that it leaves."""
    values: Real = np.linalg.lstsq(columns, y, rcond=1e-10)[0].astype(np.float64)
    return values, float(np.sum((y - columns @ values) ** 2))


# Single lines of whole records that stand out of a noise which is itself read from the residuals.


IMPROBABLE_RECORD_RESIDUALS = 1e-4  # chance of the largest residual of a right rig
MAINS_HZ = (50.0, 60.0)


def standing_out(left: Residuals, spectrum: Spectrum, outputs: Bools, hum: Bools) -> list[Notice]:
    """Outputs with a line that noise of the size of all the others would not show; `hum` (lines, channels) apart.

    Where the mean of n squares scales them, the largest of N exceeds s² with a chance of about N (1 − s²/n)ⁿ⁻¹
    (Fisher 1929).
    """
    of_residuals = np.array([kind == RESIDUAL for kind in spectrum.noise])
    if not np.any(of_residuals):
        return []
    square = np.where(of_residuals[:, None] & outputs, np.nan_to_num(np.abs(left.normalised)) ** 2 / 2, 0.0)
    square[hum] = 0.0
    away = np.abs(np.nan_to_num(left.measured - left.predicted))
    # 0.005 of a channel's largest amplitude: what stands out less is of no account
    square[(away < 0.005 * np.nanmax(np.abs(np.nan_to_num(left.measured)), axis=0))] = 0.0
    n = np.maximum(spectrum.dof / 2, 2.0)[:, None]
    with np.errstate(divide="ignore"):
        chance = np.sum(of_residuals) * np.exp((n - 1) * np.log1p(-np.minimum(square / n, 1.0)))
    worst: Ints = np.argmin(chance, axis=0)
    notices = []
    for c in np.flatnonzero(np.min(chance, axis=0) < IMPROBABLE_RECORD_RESIDUALS):
        name, line = left.channels[c], worst[c]
        off = f"{np.sqrt(square[line, c]):.2g} standard deviations off"
        text = f"{name} at {left.frequency_hz[line]:.4g} Hz is {off}, more than noise explains"
        notices.append(Notice("standing_out", text, (name,)))
    return notices


def hum_notices(left: Residuals, outputs: Bools, hum: Bools) -> list[Notice]:
    """Outputs (channels,) that carry the tone of the mains, `hum` (lines, channels)."""
    hums = hum & outputs & (np.abs(np.nan_to_num(left.normalised)) ** 2 / 2 > 16)
    names = tuple(name for name, there in zip(left.channels, np.any(hums, axis=0), strict=True) if there)
    if not names:
        return []
    at = np.unique(_multiple(left.frequency_hz[np.any(hums, axis=1)]))
    where = joined(f"{f:g}" for f in at)
    carry = "carries" if len(names) == 1 else "carry"
    text = f"{joined(names)} {carry} a tone at {where} Hz that no input drives: mains hum?"
    return [Notice("mains_hum", text, names)]


def mains_hum(left: Residuals, spectrum: Spectrum) -> Bools:
    """Amplitudes of whole records next to a multiple of the mains' frequency that the rig does not explain.

    (lines, channels).
    """
    duration_s = np.array([getattr(stretch, "duration_s", 0.0) for stretch in spectrum.stretches])
    multiple = _multiple(left.frequency_hz)
    near = np.abs(left.frequency_hz - multiple) * duration_s[spectrum.stretch] <= 2.0
    near &= np.isin(spectrum.stretch, spectrum.records)
    with np.errstate(invalid="ignore"):
        # 0.3 of an amplitude: what the rig can explain of a tone that nothing drives
        undriven = np.abs(left.predicted) < 0.3 * np.abs(left.measured)
    # A tone stands out of the lines about it (once in 50,000 does noise as far); what a wrong rig leaves does not.
    power = np.nan_to_num(np.abs(left.measured - left.predicted)) ** 2
    alone = power > 16 * median_filter(power, (25, 1))
    each = np.unique(np.stack([spectrum.stretch, multiple]), axis=1, return_inverse=True)[1].ravel()
    tone = np.zeros((np.max(each) + 1, power.shape[1]), dtype=bool)
    np.logical_or.at(tone, each[near], alone[near])
    return near[:, None] & undriven & tone[each]


def _multiple(frequency_hz: Real) -> Real:
    """The multiples of a mains frequency that are nearest, (lines,)."""
    mains = np.array(MAINS_HZ)
    around = mains * np.maximum(np.round(frequency_hz[:, None] / mains), 1)
    nearest = np.argmin(np.abs(around - frequency_hz[:, None]), axis=1)
    return around[np.arange(len(around)), nearest]


# Channels whose own numbers say that they measured nothing: still, stuck at one value, or below their
# noise.


MOSTLY = 0.5  # share of a channel's lines
FEWEST = 4  # lines at which a channel that moves does not read alike


def mostly_unheard(measured: Complex, sd: Real, lines: Bools) -> Bools:
    """Channels that are little else than noise at the given `lines` (lines,), (channels,).

    measured (lines, channels), NaN where nothing was; sd (lines, channels) of the real and of the imaginary part.
    """
    present = np.isfinite(measured) & lines[:, None]
    with np.errstate(invalid="ignore"):
        # 3.0: standard deviations that an amplitude must have to be more than noise
        heard = present & (np.abs(measured) > 3.0 * np.sqrt(2) * sd)
    share = np.sum(heard, axis=0) / np.maximum(np.sum(present, axis=0), 1)
    return (share < MOSTLY) & np.any(sd > 0, axis=0)


def fundamental_lines(spectrum: Spectrum) -> Bools:
    """Lines that are driven, (lines,): harmonics of a drive, and lines between those of a multisine, may be noise."""
    driven = np.ones(spectrum.lines, dtype=bool)
    Y = spectrum.amplitudes[(0,) * len(spectrum.batch)]
    for k, shared in enumerate(spectrum.stretches):
        of = spectrum.stretch == k
        if isinstance(shared, WholeRecord):
            driven[of] = driven_lines(Y[of])
        else:
            driven[of] = shared.orders(spectrum.frequency_hz[of]) == 1
    return driven


def silent_channels(model: Model, spectrum: Spectrum) -> dict[str, str]:
    """What channels of moving points show that measured nothing; of one repeat, and of lines that are runs.

    The first repeat counts; below the noise is a channel only whose noise is known.
    """
    shows = dict.fromkeys(dead_channels(model, spectrum), "shows no motion at any line")
    first = (0,) * len(spectrum.batch)
    Y = spectrum.amplitudes[first]
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real[first]
    noisy = mostly_unheard(Y, np.sqrt(variance / 2), fundamental_lines(spectrum))
    for c, channel in enumerate(spectrum.channels):
        if measures_input(model, channel) or channel.name in shows:
            continue
        y = Y[np.isfinite(Y[:, c]), c]
        if len(y) >= FEWEST and np.all(np.abs(y - y[0]) <= 1e-9 * np.abs(y[0])):  # of its size
            shows[channel.name] = "has the same value at every line"
        elif noisy[c]:
            shows[channel.name] = "is mostly noise at most lines"
    return shows


# Dwells at which a nonlinear rig has more than one settled motion: the measured one has been taken.


APART = 0.05  # relative difference of two motions
MOST = 6  # frequencies named in a message


def several_motions(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[Notice]:
    """A notice where the motion from the measured one differs from that which the linear response leads to.

    Folds lie around such dwells: a drive that is raised or swept otherwise would settle elsewhere.
    """
    try:
        part = nonlinear_part(prepare(model, spectrum), np.nan_to_num(spectrum.amplitudes)[None], None)
    except DashpotError:
        return []
    if part.start is None:
        return []
    theta, rows = estimate.values[: len(model.unknowns)], (len(part.dwells.omega), 1)
    p, constants = np.tile(model.parameters(theta), rows), np.tile(model.inner_constants(theta), rows)
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    measured = periodic_response(model, p, constants, drive, part.start[0])
    other = periodic_response(model, p, constants, drive)
    size = np.max(np.abs(measured.delta), axis=(1, 2))
    away = np.max(np.abs(measured.delta - other.delta), axis=(1, 2))
    several = measured.converged & other.converged & (away > APART * size)
    if not np.any(several):
        return []
    frequencies = np.unique(np.round(part.dwells.omega[several] / (2 * np.pi), 9))
    named = [f"{f:.4g}" for f in frequencies[:MOST]]
    more = f" and {len(frequencies) - MOST} more" if len(frequencies) > MOST else ""
    where = f"{joined(named)} Hz{more}"
    text = f"several steady states are possible near {where}; the measured one was used"
    return [Notice("several_motions", text)]


REJECTED = 0.01  # p-value of χ² below which a rig does not fit: one clean test in a hundred
PERHAPS_UNSTABLE = "perhaps_unstable"  # a code
BEYOND = 3.0  # standard deviations by which a sign or a damping ratio must be wrong
WORST = 3  # amplitudes that are named
CONVINCING = 0.8  # odds of causes above which a rig does not fit, if the likeliest would move an unknown
UNTESTED = ("no_noise", "noise_from_residuals", "few_degrees")  # codes of doubts that no χ² has settled
# Codes of reasons that say nothing against a rig that describes the motion as closely as it should.
BY_SIZE = {"chi2", "smooth_residuals", "standing_out", "no_noise", "noise_from_residuals"}
# What a change in the course of a record may be, and what to do about it, by its code.
IN_TIME = {
    GAIN_STEP: (
        "Did the range change, a sensor come loose, or the rig change?",
        'split the record there into two, and give one part gain = "unknown"',
    ),
    CLOCK_STEP: (
        "Lost samples, a clock reset, or an unsynchronised clock?",
        'split the record there into two, and give one part delay = "unknown"',
    ),
    SPIKES: ("Loose contact?", "remove those samples: the record is then used in segments"),
    JUMP: (
        "Lost samples, a spike, or an impact that no input channel measured?",
        "split the record there into two",
    ),
}


def assess(
    model: Model, spectrum: Spectrum, estimate: Estimate, *, within: float | None = None
) -> Assessment:
    """The verdict on one estimate (no batch axes) from the spectrum it was made of.

    within: the share of the motion of every channel within which the rig is to describe it; None: what suits the noise.
    """
    left = every = residuals_of(model, spectrum, estimate)
    motions = np.array([not measures_input(model, channel) for channel in spectrum.channels])
    share = share_without_misfit(spectrum, ~motions, np.nan_to_num(left.measured - left.predicted))
    left = replace(left, normalised=left.normalised / np.sqrt(share))
    tones = mains_hum(left, spectrum)
    quiet = replace(left, normalised=np.where(tones, np.nan, left.normalised))
    in_time = [notice for notice in estimate.warnings if notice.code in TIME_CHANGES]
    ended = limited_channels(left, spectrum, motions)
    # Whether the noise is known from more than these residuals, so that their size says whether they are noise
    elsewhere = estimate.fit.known_noise and RESIDUAL not in spectrum.noise
    shares = discrepancies(quiet, estimate, motions, elsewhere, within)
    # Channels of moving points that do not move: they fit a rig that stands still
    against = [
        *unphysical(model, estimate),
        *unstable(estimate),
        *rejected(estimate),
        *([] if elsewhere and float(estimate.fit.p) >= REJECTED else too_far_off(shares)),
        *[
            Notice("silent_channel", f"{name} shows no motion at any line", (name,))
            for name in dead_channels(model, spectrum)
        ],
        *(notice for notice in estimate.warnings if notice.code == DISAGREE),
        *in_time,
        *ended,
        *standing_out(left, spectrum, motions, tones),
        *_smooth(quiet, motions, 1.0 if elsewhere else 0.5, any(n.code == UNEVEN for n in estimate.warnings)),
    ]
    unheard = [] if spectrum.records else _unheard(left, motions, fundamental_lines(spectrum))
    untested = [] if against else doubts_about(estimate, of_residuals=RESIDUAL in spectrum.noise)
    chance = [notice for notice in estimate.warnings if notice.code == MODES_UNSEEN]
    doubts = [*untested, *chance, *hum_notices(left, motions, tones), *unheard]
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    relative = _relative_verdict(left, motions)
    limits = [share.within for share in shares.values() if share is not None]
    # What changes in the course of a record, and channels that end, as what may be wrong; no remedy is tried
    kinds = [*(("saturation", notice) for notice in ended), *(("time", notice) for notice in in_time)]
    said = [(kind, notice.of, remedy_in_words(notice)) for kind, notice in kinds]
    findings = tuple(Finding(kind, of, phrase.text, phrase.change, None) for kind, of, phrase in said)
    return Assessment(
        verdict,
        (*against, *doubts),
        relative,
        tuple(left.largest(WORST)) if estimate.fit.dof > 0 else (),
        findings=findings,
        relative_noise=_noise_alone(left, tuple(relative)) if elsewhere else {},
        discrepancy=shares,
        within=max(limits, default=None) if within is None else within,
        residuals=every,
    )


def settled_by_size(
    assessment: Assessment, asked: bool, *, in_vain: bool = False, harmless: bool = False
) -> Assessment:
    """The verdict by how much of the motion the rig leaves, after the diagnosis.

    What χ² rejects, or cannot test, fits where the data show that it is as little as it should be, and no cause is
    likely, or one that is `harmless`: without it the unknowns would be the same.  Where it may be more, and a cause was
    sought `in_vain` while the noise is known from the residuals alone, with any course over frequency, the fit cannot
    be tested.  Where a share of the motion was asked for, only what the data show fits.
    """
    codes, unlikely = {reason.code for reason in assessment.reasons}, not likely(assessment.findings)
    if codes <= BY_SIZE and (harmless or unlikely):
        if assessment.described:
            causes = tuple(each for each in assessment.findings if each.kind != "unexplained")
            return replace(assessment, verdict="fits", reasons=(), findings=causes)
        if in_vain and unlikely and codes:
            assessment = replace(assessment, verdict="cannot tell")
    if assessment.verdict == "does not fit" or assessment.described or not asked:
        return assessment
    notices = []
    for name, share in assessment.discrepancy.items():
        if share is None:
            text = f"noise and misfit of {name} cannot be separated"
            notices.append(Notice("discrepancy_unknown", text, (name,)))
        elif share.upper95 > share.within:
            bound, limit = f"{100 * share.upper95:.3g} %", f"{100 * share.within:.3g} %"
            text = f"the model may miss up to {bound} of the motion at {name}; the limit asked for is {limit}"
            notices.append(Notice("discrepancy_bound", text, (name,)))
    others = (reason for reason in assessment.reasons if reason.code not in UNTESTED)
    return replace(assessment, verdict="cannot tell", reasons=(*notices, *others))


def likely(findings: Sequence[Finding]) -> bool:
    """Whether the causes among them are likely together; those that were read off a record have no odds."""
    causes = (each for each in findings if each.kind != "unexplained")
    return sum(1.0 if each.odds is None else each.odds for each in causes) >= CONVINCING


def one_cause(cause: Finding) -> Notice:
    """That a cause explains what noise cannot be told from."""
    text = f"{100 * (cause.explains or 0.0):.0f} % of the unexplained motion has one cause"
    return Notice("one_cause", text, cause.of)


def too_far_off(shares: Mapping[str, Discrepancy | None]) -> list[Notice]:
    """That the rig misses more of some channels than it should, beyond doubt by the noise; the worst is named."""
    told = ((share.lower95, name, share.within) for name, share in shares.items() if share is not None)
    missed = [(least, name) for least, name, within in told if least > within]
    if not missed:
        return []
    least, name = max(missed, key=lambda each: each[0])
    text = f"the model misses at least {100 * least:.3g} % of the motion at {name}"
    return [Notice("discrepancy", text, tuple(each for _, each in missed))]


def remedy_in_words(notice: Notice) -> Phrase:
    """A change in the course of a record, or a channel that ends, and what to do about it."""
    if notice.code == LIMITED:
        name = notice.of[0]
        change = f"reduce the drive, widen the range, or leave {name} out if other channels show the motion"
        return Phrase(f"{notice.text}. Clipped or saturated?", change)
    question, remedy = IN_TIME[notice.code]
    return Phrase(f"{notice.text}. {question}", remedy)


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
        text = (
            "the noise level was estimated from this fit's own residuals. Record the rig at rest and add "
            "--noise-record"
        )
        return [Notice("noise_from_residuals", text)]
    if fit.dof <= 0:
        text = "there are no more data than unknowns, so nothing is left to test the fit"
        return [Notice("few_degrees", text)]
    if fit.dof < FEWEST:
        return [Notice("few_degrees", f"{fit.dof} degrees of freedom are too few to test the fit")]
    return []


def unphysical(model: Model, estimate: Estimate) -> list[Notice]:
    """Parts of the rig that are negative beyond doubt by the sensors' noise; entries of free matrices may be."""
    rows = zip(model.unknown_names, of_one_sign(model), estimate.values, estimate.noise_sd, strict=False)
    names = tuple(name for name, held, value, sd in rows if held and value < -BEYOND * sd)
    if not names:
        return []
    # Whether all of these are springs whose elongation follows from those of the other springs
    springs = np.array([each.kind is Kind.SPRING for each in model.elements])
    named = np.array([each.name in names for each in model.elements])
    points = np.concatenate([model.B, model.D], axis=1)
    others, every = (np.linalg.matrix_rank(points[chosen]) for chosen in (springs & ~named, springs))
    bending = not np.any(named & ~springs) and others == every
    why = ", typical of bending of the parts" if bending else ""
    return [Notice("negative", f"{joined(names)} {'is' if len(names) == 1 else 'are'} negative{why}", names)]


def unstable(estimate: Estimate) -> list[Notice]:
    """The rig's modes that grow beyond doubt."""
    where, several = _growing(estimate, BEYOND)
    if not where:
        return []
    grow = "are unstable: they grow" if several else "is unstable: it grows"
    return [Notice("unstable", f"{where} {grow} instead of decaying")]


def unstable_by_chance(estimate: Estimate) -> list[Notice]:
    """Modes that grow as estimated, though by no more than noise may do: such a rig cannot be signed."""
    where, several = _growing(estimate, 0.0)
    if not where:
        return []
    text = f"{where} {'are' if several else 'is'} unstable as estimated, but possibly because of noise"
    return [Notice(PERHAPS_UNSTABLE, text)]


def _growing(estimate: Estimate, deviations: float) -> tuple[str, bool]:
    """Modes whose damping ratio is negative by more than so many standard deviations, as their table numbers them;
    whether several."""
    modes = estimate.modes
    if modes is None:
        return "", False
    grows = modes.damping_ratio < np.minimum(-deviations * np.nan_to_num(modes.damping_sd), -1e-9)
    found = [
        f"{k + 1} ({modes.frequency_hz[k]:.3g} Hz)" if modes.eigenvalues[k].imag else f"{k + 1}"
        for k in np.flatnonzero(grows).tolist()
    ]
    return (f"mode{'s' if len(found) > 1 else ''} {joined(found)}" if found else ""), len(found) > 1


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

    The misfit of a wrong rig is in proportion to the drive, whose phase may be another at each line.  Noise that is
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
        # 4.5: standard deviations of the correlation of neighbouring residuals
        if max(_likeness(turned, loud) for turned in (r, r * phase)) > 4.5:
            names.append(left.channels[c])
    if not names:
        return []
    text = f"the residuals of {joined(names)} follow a smooth trend over frequency instead of scattering"
    return [Notice("smooth_residuals", text, tuple(names))]


def _likeness(r: Complex, loud: Bools) -> float:
    """Standard deviations of the correlation of neighbouring residuals (lines,) beyond that where they are not loud."""
    alike, power = (r[1:] * np.conj(r[:-1])).real, np.abs(r[1:]) ** 2
    correlation, variance = 0.0, 0.0
    for side, lines in ((1, loud[1:]), (-1, ~loud[1:])):
        if np.any(lines):
            correlation += side * float(np.sum(alike[lines]) / max(np.sum(power[lines]), 1e-300))
            variance += 1 / (2 * np.sum(lines))
    return float(correlation / np.sqrt(variance))


def _relative_verdict(left: Residuals, motions: Bools) -> Mapping[str, float]:
    """What the model leaves of the motion of each channel, (0 … 1).

    Measured inputs count where the fit meets the outputs by another input than was measured: it is more than noise
    away, and by a greater part than any output.
    """

    def rms(values: Complex) -> Real:
        return np.sqrt(np.nanmean(np.abs(values) ** 2, axis=0))

    shown = np.any(np.isfinite(left.measured), axis=0)
    away = np.where(np.isfinite(left.measured), left.measured - left.predicted, np.nan)
    sizes = rms(left.measured[:, shown])
    parts = rms(away[:, shown]) / np.where(sizes > 0, sizes, 1.0)
    names = [name for name, there in zip(left.channels, shown, strict=True) if there]
    moved = motions[shown]
    # 2.0: rms of a channel's residuals over the noise
    otherwise = (left.rms()[shown] > 2.0) & (parts > np.max(parts[moved], initial=0.0))
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
