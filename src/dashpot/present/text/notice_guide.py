"""Every notice explained: what its code means and what to do about it.

The manual's page "What can go wrong" is made of this, and a test holds it complete: each code that the package gives
stands here, and nothing else does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Explained:
    """place: where such notices arise; meaning and cure in Markdown."""

    place: str
    meaning: str
    cure: str


_VERDICT = "Reasons of a verdict"
_ESTIMATE = "Warnings of an estimate"
_RECORDS = "Notes on records and their conditioning"
_FILES = "Notes on data files"
_STUDIES = "Notes on studies"

_ALL: tuple[tuple[str, str, str, str], ...] = (
    # ------------------------------------------------------------ verdict
    (
        "chi2", _VERDICT,
        "The residuals are larger than the noise explains (χ² test, p < 0.001).",
        "Read the likely causes below the verdict; `--apply` writes the first one into a rig file.",
    ),
    (
        "negative", _VERDICT,
        ("A mass, damper or spring is negative beyond doubt. No passive part is; something is missing, reversed or "
        "stated wrongly. It is a reason of the verdict and a warning of the estimate."),
        ("Check signs and units of the channels and the elements that join this point. A negative spring to the storey "
        "after next stands for bending."),
    ),
    (
        "unstable", _VERDICT,
        "A mode of the estimated rig grows instead of dying away.",
        "As for a negative damper: signs, phase convention, delays.",
    ),
    (
        "smooth_residuals", _VERDICT,
        "Residuals of a channel run smoothly over frequency. Noise jumps from line to line; a wrong model does not.",
        "Look at them in the report; a delay gives a phase that grows with frequency, a missing mode a bump.",
    ),
    (
        "no_noise", _VERDICT,
        "The noise of the amplitudes is not given, so nothing says how large residuals may be.",
        "Add columns `NAME_sd`, use the records themselves, or measure one record at rest.",
    ),
    (
        "noise_from_residuals", _VERDICT,
        "The noise was read from the residuals of this fit, which therefore cannot contradict it.",
        "Record the rig at rest and give it with `--noise-record`.",
    ),
    (
        "few_degrees", _VERDICT,
        "Hardly more data than unknowns: the test of the fit has no power.",
        "Add frequencies or channels.",
    ),
    (
        "below_noise", _VERDICT,
        "A channel is within three standard deviations of its noise at most lines; any model fits it.",
        "Drive more strongly, use a better sensor, or leave the channel out.",
    ),
    # ------------------------------------------------------------ estimate
    (
        "model_misfit", _ESTIMATE,
        ("The model does not fit; ± and intervals are widened by the ratio of residuals to noise. Widened intervals "
        "are no promise: they do not hold a parameter's true value when what the model lacks looks like that "
        "parameter."),
        "Mend the model first ([When the model does not fit](../explain/misfit.md)).",
    ),
    (
        "modes_misfit", _ESTIMATE,
        "No values of the unknowns give these frequencies, damping ratios and shapes within their uncertainty.",
        "Check which mode is which, the shapes' points and the stated uncertainty.",
    ),
    (
        "unknown_noise", _ESTIMATE,
        ("No noise is given: it is taken as the same share of every amplitude, with a size read from the residuals. "
        "Intervals may then be too small or too large."),
        "Give `NAME_sd` in the table, or the records.",
    ),
    (
        "another_method", _ESTIMATE,
        "The method that suits the data found no answer, or one in a wrong valley; maximum likelihood took its place.",
        "Nothing; a method that is named is used whatever it finds.",
    ),
    (
        "coloured_noise", _ESTIMATE,
        ("The noise beside the drive frequency is not white; its size was measured there and the intervals include it. "
        "A transient or a slightly wrong drive frequency looks the same."),
        "Of time records: try `--settle auto` and `--refine always`. Of tables of amplitudes: nothing.",
    ),
    (
        "coloured_residuals", _ESTIMATE,
        "Residuals of a nonlinear fit to whole records are correlated in time; intervals include that.",
        "The model or the measured input lacks something: look at the residuals' frequencies.",
    ),
    (
        "negative_but_zero", _ESTIMATE,
        "A part came out negative, with 0 inside its interval: it may be absent.",
        "Leave the element out, or hold it at or above 0 with `min = 0` or `--positive`.",
    ),
    (
        "not_definite", _ESTIMATE,
        "A freely estimated matrix has a negative eigenvalue.",
        "`--method oiv+` finds the most likely matrices that are positive definite.",
    ),
    (
        "beyond_bound", _ESTIMATE,
        "The value lies beyond `min` or `max` of the rig file; the method used does not hold bounds.",
        "Use `--method ml` (or `auto`).",
    ),
    (
        "at_bound", _ESTIMATE,
        "The best allowed value is the bound itself; the text names the value that would fit best without it.",
        "If the bound is certain, use the result; else ask why the data press against it.",
    ),
    (
        "biased", _ESTIMATE,
        ("The estimate lies more than 3 standard deviations from the most likely value: noise in the measured "
        "motion biases it."),
        "Use `oiv` or `ml` (`auto` does).",
    ),
    (
        "not_unique", _ESTIMATE,
        "Another set of values, named in the text, fits equally or almost as well.",
        "Add a sensor at another point, fix a parameter or give a guess of every unknown.",
    ),
    (
        "bands_disagree",
        _ESTIMATE,
        (
            "The band was divided into six parts; leaving one out moves the values by more than noise explains, even "
            "where χ² finds nothing. Intervals are widened to the scatter of the parts. It is a reason of the verdict, "
            "too."
        ),
        "Something in the model depends on frequency: look for a missing part, a delay or a nonlinearity.",
    ),
    (
        "several_motions",
        _ESTIMATE,
        (
            "A nonlinear rig has several settled motions at the frequencies named, near a fold; the measured one was "
            "used."
        ),
        "Nothing, if the measured motion is the settled one; `dashpot response` draws the branches.",
    ),
    (
        "prior_conflict", _ESTIMATE,
        "A value stated with an `sd` is contradicted by the data.",
        ("Weigh or measure that part again, widen its `sd`, or look for the model's fault; free the value (remove it) "
        "to see what the data say alone."),
    ),
    (
        "reversed_phase", _ESTIMATE,
        "All unknown dampers are negative: the data probably use e^(−jωt).",
        "Change the sign of every imaginary part (or phase).",
    ),
    (
        "duplicated_lines", _ESTIMATE,
        "Lines repeat others to the last digit and count as independent measurements.",
        "Give each file once.",
    ),
    (
        "input_not_measured", _ESTIMATE,
        "An input is measured at some lines and missing at others, where it is unknown.",
        "If it was at rest there, write 0 in its column.",
    ),
    (
        "short_record", _ESTIMATE,
        ("The record is shorter than one period of the slowest mode: its transient and its motion are hardly told "
        "apart."),
        "Record for several periods of the slowest mode.",
    ),
    (
        "noise_factor_diverged", _ESTIMATE,
        "`tls` found no noise factor: the noise hides at least one unknown.",
        "Use `oiv` or `ml`; measure with less noise.",
    ),
    (
        "noise_near_singular", _ESTIMATE,
        "The noise almost hides a combination of unknowns; `tls` is not to be trusted.",
        "Use `oiv` or `ml`.",
    ),
    (
        "noise_not_compensated", _ESTIMATE,
        "The stated noise is too large to be taken out; `cls` leaves its bias in.",
        "Check the stated noise; use `oiv` or `ml`.",
    ),
    # ------------------------------------------------------------ records
    (
        "colour_unresolved", _RECORDS,
        ("The residual of a dwell is not white, but there are too few periods to measure its colour: intervals treat "
        "it as white and may be too small."),
        "Longer dwells; `--settle auto` if it is the transient.",
    ),
    (
        "frequency_refined", _RECORDS,
        "The true drive frequency differs from the stated one; the true one is used.",
        "Nothing, unless the difference surprises: then check the generator or the sampling rate.",
    ),
    (
        "transient_discarded", _RECORDS,
        "The start (or end) of a dwell was not steady and was left out.",
        "Nothing. `--transients estimate` would use those samples too.",
    ),
    (
        "transient_undetectable", _RECORDS,
        "Too few periods, or too many gaps, to see where the transient ends: the whole dwell is used as settled.",
        "State the settling time (`--settle 2s`), or use `--transients estimate`.",
    ),
    (
        "dwells_with_transients", _RECORDS,
        ("A test over all dwells found them unsettled, or their drive frequency wandering: each is used whole, its "
        "transient estimated with the rig."),
        "Nothing. `--transients none` takes them as settled all the same.",
    ),
    (
        "drive_wanders", _RECORDS,
        ("The phase of all channels turns together within a dwell: its drive frequency is not constant. A steady sine "
        "does not describe it; noise counts as larger than it is."),
        "Leave out `--settle` and `--refine always`: dwells whose frequency wanders are then used as whole records.",
    ),
    (
        "whole_records", _RECORDS,
        "A record without `frequency_hz` is used whole; the text gives lines and band.",
        "Nothing; `--band` changes the band.",
    ),
    (
        "gaps", _RECORDS,
        "Samples are missing, or the clock slips by a part of a step; the pieces are used as records of their own.",
        "Nothing, if the gaps are real; else export the file again.",
    ),
    (
        "record_residuals", _RECORDS,
        "The size of what a nonlinear fit leaves in each channel.",
        "Nothing; compare it with the noise of the sensor.",
    ),
    (
        "clipped", _RECORDS,
        "A channel rests at its largest value: it is probably clipped, and its amplitude too small.",
        "Widen the range or drive less.",
    ),
    (
        "periods_skipped", _RECORDS,
        "The first periods of a periodic record were left out, as the manifest says.",
        "Nothing.",
    ),
    # ------------------------------------------------------------ files
    (
        "columns_not_read", _FILES,
        "Columns that the rig file does not list as channels.",
        "Nothing, unless one should be a channel: then its name in `[channels]` is spelt differently.",
    ),
    (
        "decimal_comma", _FILES,
        "Commas in numbers were read as decimal commas although they could part thousands.",
        "If they part thousands, export the file without such commas.",
    ),
    (
        "columns_chosen", _FILES,
        "A manifest chooses columns; the others are left out without a note. This code is not shown.",
        "Nothing.",
    ),
    (
        "frequency_from_name", _FILES,
        "The drive frequency was taken from the file's name.",
        "If the number in the name is something else, give `--frequency`.",
    ),
    (
        "no_line_end", _FILES,
        "The last row has no line end: if the file was cut off, its last number is wrong.",
        "Compare the file's length with the original.",
    ),
    (
        "modes_without_sd", _FILES,
        "A universal file of modes has no standard deviations; usual ones are assumed.",
        "State what you believe of them with `--modal-sd`.",
    ),
    (
        "modes_in_order", _FILES,
        "No node of the modes has the name of a coordinate; the nodes are taken for the coordinates in their order.",
        'Check the pairs in the note; a channel of the node\'s name says it for certain: `"3+Z" = { of = "x1" }`.',
    ),
    (
        "samples_not_shared", _FILES,
        "Some samples exist in some sensors' files only and are left out.",
        "Nothing, if they are few.",
    ),
    (
        "packets_lost", _FILES,
        "A wireless sensor lost packets; the other samples keep their true times.",
        "Nothing, if they are few.",
    ),
    (
        "own_times", _FILES,
        "The sensors sampled at different moments; each channel keeps its own times and nothing is resampled.",
        "Nothing.",
    ),
    (
        "clock_estimated", _FILES,
        "The clock of a sensor was set by what it and another sensor see alike; offset and drift are given.",
        "Check that they are plausible; give synchronised files if there are any.",
    ),
    (
        "stamps_rounded", _FILES,
        "Time stamps are even times rounded to a digit that is coarse beside the sampling step: even times are used.",
        "Record with finer stamps; `--refine none` takes the stamps at their word.",
    ),
    (
        "clock_refined", _FILES,
        "All dwells move at the same ratio to their stated frequencies: two clocks differ, and the records' is used.",
        "Nothing; `--refine none` keeps the stated frequencies.",
    ),
    (
        "harmonics_driven", _FILES,
        "Every channel shows multiples of the drive's frequency in most dwells: the drive makes them; they are data.",
        "Nothing; `--orders 1` uses the fundamentals alone.",
    ),
    (
        "periods_averaged", _FILES,
        "The record repeats, as under a multisine: its periods are averaged and their scatter is the noise.",
        "Nothing; `--transients estimate` uses the record whole.",
    ),
    (
        "drift_by_evidence", _FILES,
        ("Short dwells lose much to a slope that is solved for; one test over all dwells and channels says whether "
        "there is one."),
        "Nothing; `--drift` sets it.",
    ),
    (
        "noise_moderated", _FILES,
        "Dwells of few samples know their noise badly; it leans on how that of all dwells goes with the amplitude.",
        "Nothing; `--noise own` leaves each dwell alone.",
    ),
    # ------------------------------------------------------------ studies
    (
        "damaged_blocks", _STUDIES,
        "Blocks of a study did not match their checksum or their place and were computed again.",
        "Nothing; look at the disk if it happens again.",
    ),
    (
        "outdated_blocks", _STUDIES,
        "Blocks computed by another version of dashpot were computed again.",
        "Nothing.",
    ),
)  # fmt: skip

GUIDE: Mapping[str, Explained] = MappingProxyType(
    {code: Explained(place, meaning, cure) for code, place, meaning, cure in _ALL}
)
