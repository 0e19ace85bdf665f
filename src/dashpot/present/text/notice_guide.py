"""Every notice explained: what its code means and what to do about it.

The manual's page "What can go wrong" is generated from this. A test checks that it has every code that the package
gives, and no others.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dashpot.io.words import joined
from dashpot.notices import Notice

# The notices on data explained: records and their conditioning, files, studies. `notice_guide` has all of
# them.


RECORDS = "Notes on records and their conditioning"
FILES = "Notes on data files"
STUDIES = "Notes on studies"

# code, place, meaning and cure
DATA_NOTICES: tuple[tuple[str, str, str, str], ...] = (
    (
        "colour_unresolved", RECORDS,
        ("The residual of a dwell is not white, but there are too few periods to measure its colour: intervals treat "
        "it as white and may be too small."),
        "Use longer dwells, or `--settle auto` if a transient is the cause.",
    ),
    (
        "parts_merged", RECORDS,
        ("Every file, and every piece of a very long record, was identified by itself (`--in-parts`), and the "
        "estimates were merged by the information of each; χ² of their scatter tests whether one rig is behind all."),
        "Nothing.",
    ),
    (
        "frequency_refined", RECORDS,
        "The true drive frequency differs from the stated one; the true one is used.",
        "Nothing, unless the difference is surprising: then check the generator or the sampling rate.",
    ),
    (
        "transient_discarded", RECORDS,
        "The start or end of a dwell was not steady and was discarded.",
        "Nothing. `--transients estimate` would use those samples too.",
    ),
    (
        "transient_undetectable", RECORDS,
        "Too few periods, or too many gaps, to see a transient or where it ends: the whole dwell is used as settled.",
        "State the settling time (`--settle 2s`), or use `--transients estimate`.",
    ),
    (
        "settled_dwells", RECORDS,
        ("What was done to all dwells that have settled: how many samples are used, at which frequency, with which "
        "drift removed. Other notes give the reasons; dwells with transients and whole records have their own notes."),
        "Nothing. `--settle`, `--refine`, `--drift` and `--transients` change this; each accepts `none`.",
    ),
    (
        "dwells_with_transients", RECORDS,
        ("A test over all dwells found them unsettled, or the frequency or amplitude of their drive changing: each is "
        "used whole, and its transient is estimated with the rig."),
        "Nothing. `--transients none` treats them as settled regardless.",
    ),
    (
        "settled_by_evidence", RECORDS,
        ("Dwells of less than two periods show no transient by themselves; the fit with the loads of their ends, "
        "tested over all dwells against steady motion, finds none."),
        "Nothing. `--transients estimate` keeps the transients (wider intervals), `--transients none` skips the test.",
    ),
    (
        "transients_ignored", RECORDS,
        "A test over all dwells found them unsettled, and what was asked for (orders, frequencies) needs settled ones.",
        "Use `--transients auto` and the method `ml`, or discard the starts of the dwells (`--settle`).",
    ),
    (
        "drive_wanders", RECORDS,
        ("The phase of all channels turns together within a dwell: its drive frequency is not constant. A steady sine "
        "does not describe it; the noise is overestimated."),
        "Leave out `--settle` and `--refine always`: dwells whose frequency wanders are then used as whole records.",
    ),
    (
        "drive_fades", RECORDS,
        ("The motion of all channels grows or falls by one factor within a dwell: its drive has no constant amplitude. "
        "A steady sine does not describe it; the noise is overestimated, and values may be off by some per cent of "
        "the drift."),
        ("Leave out `--settle`, `--refine always` and `--transients none`, and use the method `ml`: dwells whose drive "
        "drifts are then used as whole records."),
    ),
    (
        "whole_records", RECORDS,
        "A record without `frequency_hz` is used whole; the text gives lines and band.",
        "Nothing; `--band` changes the band.",
    ),
    (
        "folded", RECORDS,
        ("A channel still moves at half the sampling rate, as a hammer's blow of a few samples does without a filter. "
        "What lies above is folded into the lines below, as an error of the motion that has no noise."),
        "Sample faster, or switch on the recorder's anti-aliasing filter; a softer hammer tip helps as well.",
    ),
    (
        "many_lines", RECORDS,
        ("A long record rises above its noise up to high frequencies, and all of its lines are used: the memory needed "
        "grows with them."),
        "Give a `--band` that ends above the rig's highest mode: lines far above it carry no information.",
    ),
    (
        "gaps", RECORDS,
        "Samples are missing, or the clock slips by part of a step; the pieces are used as separate records.",
        "Nothing, if the gaps are real; otherwise export the file again.",
    ),
    (
        "record_residuals", RECORDS,
        "The rms residual of a nonlinear fit in each channel.",
        "Nothing; compare it with the noise of the sensor.",
    ),
    (
        "noise_at_rest", RECORDS,
        ("The noise of every channel, inputs included, is that of the record at rest, smoothed over neighbouring "
        "lines. It goes before what periods that repeat and what residuals would tell, and lets χ² test the fit."),
        "Nothing; make sure that sensors, ranges and filters were the same in both records.",
    ),
    (
        "input_noise", RECORDS,
        ("The noise of the measured inputs of whole records, by the quiet part of an input's own spectrum or, where it "
        "has none, by what all outputs have in common. The true inputs are unknowns of the fit; values and intervals "
        "count it."),
        "Nothing; compare it with the noise of the sensor. A record at rest (`--noise-record`) tells it better.",
    ),
    (
        "held_samples", RECORDS,
        ("A channel of a whole record holds one value, or reads 0, for some samples while the motion goes on. The "
        "parts on either side are used as separate records."),
        "Check the cable and the connection.",
    ),
    (
        "dropouts", RECORDS,
        ("A channel holds one value, or reads 0, for some samples of a dwell while the motion goes on. The amplitudes "
        "are those of the other samples."),
        "Check the cable and the connection. `--refine none` takes the samples as they are.",
    ),
    (
        "clipped", RECORDS,
        ("A channel stays at its largest value: it is probably clipped. In dwells the other samples tell what the "
        "motion was there (`unclipped`); of other records the amplitude is too small."),
        "Widen the range or drive less.",
    ),
    (
        "unclipped", RECORDS,
        ("Samples of a dwell stand at the limit of a channel's range, and the sine that the others follow lies beyond "
        "it (where a transient is in them, a sine whose amplitude and phase run): these alone are used, and the "
        "amplitude's noise is that of fewer samples."),
        "Widen the range or drive less: what is clipped tells nothing. `--refine none` takes the samples as they are.",
    ),
    (
        "clipped_in_doubt", RECORDS,
        ("A channel clips in dwells that are too short to tell its transient from its steady motion: what stands in "
        "for the clipped samples may be wrong, and the values with it, by more than the intervals say."),
        "Widen the range, drive less, or record three periods or more; or leave the channel out of the rig file.",
    ),
    (
        "periods_skipped", RECORDS,
        "The first periods of a periodic record were left out, as the manifest says.",
        "Nothing.",
    ),
    (
        "periods_differ", RECORDS,
        ("The periods of a record that was given as periodic agree no better with one another than noise does: either "
        "little but noise was recorded, or the record does not repeat."),
        "If it does not repeat, leave out `lines` and `frequency_hz`: it is then used whole.",
    ),
    (
        "other_motion", RECORDS,
        ("A record was given as a dwell, but little of its motion is at the frequency stated (and its multiples that "
        "are used): it is an earthquake, a sweep or random motion, or hum and drift are louder than the drive."),
        "Leave the frequency out if the record is no dwell: it is then used whole.",
    ),
    (
        "columns_not_read", FILES,
        "Columns that the rig file does not list as channels.",
        "Nothing, unless one should be a channel: then its name in `[channels]` is spelt differently.",
    ),
    (
        "phase_unit", FILES,
        ("Phases without a stated unit are read as degrees, but all of these lie within ±π: they are in radians, or "
        "the rig moves far below its first mode."),
        "If they are radians, name the columns `NAME_phase_rad`.",
    ),
    (
        "decimal_comma", FILES,
        "Commas in numbers were read as decimal commas although they could separate thousands.",
        "If they separate thousands, export the file without such commas.",
    ),
    (
        "columns_chosen", FILES,
        "A manifest chooses columns; the others are left out without a note. This code is not shown.",
        "Nothing.",
    ),
    (
        "frequency_from_name", FILES,
        "The drive frequency was taken from the file's name.",
        "If the number in the name is something else, give `--frequency`.",
    ),
    (
        "stray_rows", FILES,
        "Rows between those of numbers were left out: comments (# or %), or the header once more.",
        "If several recordings stand in one file, check that each is read as one: `dashpot inspect`.",
    ),
    (
        "no_line_end", FILES,
        "The last row has no line ending: if the file was cut off, its last number may be wrong.",
        "Compare the file's length with the original.",
    ),
    (
        "modes_without_sd", FILES,
        "A universal file of modes has no standard deviations; typical ones are assumed.",
        "State them with `--modal-sd`.",
    ),
    (
        "modes_in_order", FILES,
        "No node of the modes has the name of a coordinate; nodes and coordinates were paired in order.",
        'Check the pairs in the note; a channel with the node\'s name settles it: `"3+Z" = { of = "x1" }`.',
    ),
    (
        "samples_not_shared", FILES,
        "Some samples are missing from the files of some sensors and were left out.",
        "Nothing, if they are few.",
    ),
    (
        "packets_lost", FILES,
        "A wireless sensor lost packets; the other samples keep their true times.",
        "Nothing, if they are few.",
    ),
    (
        "own_times", FILES,
        "The sensors sampled at different moments; each channel keeps its own times and nothing is resampled.",
        "Nothing.",
    ),
    (
        "clock_estimated", FILES,
        "The clock of a sensor was aligned by the motion it shares with another sensor; offset and drift are given.",
        "Check that they are plausible; use synchronised files if you have them.",
    ),
    (
        "stamps_rounded", FILES,
        "The time stamps are coarsely rounded; evenly spaced times are used instead.",
        "Record with finer stamps; `--refine none` uses the stamps as they are.",
    ),
    (
        "dwell_left_out", FILES,
        "A dwell ends before its first period, as where a recording was stopped within it; the others are used.",
        "Measure it again for at least one period, better ten, or correct its frequency.",
    ),
    (
        "clock_refined", FILES,
        "All dwells are off their stated frequencies by one factor: two clocks differ; the records' clock is used.",
        "Nothing; `--refine none` keeps the stated frequencies.",
    ),
    (
        "harmonics_driven", FILES,
        "Every channel shows multiples of the drive's frequency in most dwells: the drive makes them; they are data.",
        "Nothing; `--orders 1` uses the fundamentals alone.",
    ),
    (
        "noise_from_neighbours", FILES,
        "No noise is given, but the lines are dense enough for their scatter about smooth curves to show it.",
        "Give the standard deviations (columns NAME_sd) where they are known.",
    ),
    (
        "noise_fitted", FILES,
        ("No noise is given. The residuals show for each channel how much of it is constant and how much grows with "
        "the motion; the amplitudes are weighted accordingly, and intervals are as wide as that leaves them."),
        "Give the standard deviations (columns NAME_sd) where they are known: only then can the fit be tested.",
    ),
    (
        "periods_averaged", FILES,
        "The record repeats, as under a multisine: its periods are averaged and their scatter is the noise.",
        "Nothing; `--transients estimate` uses the record whole.",
    ),
    (
        "drift_by_evidence", FILES,
        ("Estimating a slope costs short dwells much precision; one test over all dwells and channels decides whether "
        "there is one."),
        "Nothing; `--drift` sets it.",
    ),
    (
        "noise_moderated", FILES,
        "Short dwells determine their noise poorly, so its estimate also draws on the other dwells.",
        "Nothing; `--noise own` uses each dwell by itself.",
    ),
    (
        "damaged_blocks", STUDIES,
        "Blocks of a study did not match their checksum or their place and were computed again.",
        "Nothing; check the disk if it happens again.",
    ),
    (
        "outdated_blocks", STUDIES,
        "Blocks computed by another version of dashpot were computed again.",
        "Nothing.",
    ),
)  # fmt: skip


# What to do about a notice, by its code; the options of the command line are named here and in `app` alone.


REMEDIED = "coloured_noise"
# Treatments of records that may help there, and how they are asked for.
OPTIONS = {"settle": "--settle auto", "refine": "--refine always"}


def with_remedy(notice: Notice, *, untried: Collection[str] = tuple(OPTIONS)) -> str:
    """The notice, followed by the options that may help; `untried`: treatments of records that were not chosen."""
    options = [option for treatment, option in OPTIONS.items() if treatment in untried]
    if notice.code != REMEDIED or not options:
        return notice.text
    same = "a transient or a slightly wrong drive frequency looks the same"
    return f"{notice.text}; {same}: try {joined(options)}"


_VERDICT = "Reasons of a verdict"
_ESTIMATE = "Warnings of an estimate"

# code, place, meaning and cure
NOTICES: tuple[tuple[str, str, str, str], ...] = (
    (
        "chi2", _VERDICT,
        "The residuals are larger than the noise explains (χ² test, p < 0.01).",
        "Read the likely causes below the verdict; `--apply` writes the first one into a rig file.",
    ),
    (
        "discrepancy", _VERDICT,
        ("Beyond noise, the rig misses more of a channel's motion than it should: at least 1 %, or the channel's noise "
        "where that is larger (at most 5 %), or what was asked for with --within (lower 95 % bound)."),
        "Read the likely causes below the verdict. If the model need not be closer, ask for less: --within 10%.",
    ),
    (
        "discrepancy_bound", _VERDICT,
        "The rig may miss more of a channel's motion than was asked for with --within: the noise hides it.",
        "Use more data or less noise, or ask for less.",
    ),
    (
        "discrepancy_unknown", _VERDICT,
        "A share of the motion was asked for with --within, and nothing tells noise from misfit.",
        "Record longer, record the rig at rest (--noise-record), or supply the standard deviations.",
    ),
    (
        "negative", _VERDICT,
        ("A mass, damper or spring is significantly negative. No passive part is: something is missing, reversed or "
        "stated wrongly. This is both a reason of the verdict and a warning of the estimate."),
        ("Check signs and units of the channels and the elements that join this point. A negative spring to the second "
        "storey up or down stands for bending."),
    ),
    (
        "unstable", _VERDICT,
        "A mode of the estimated rig is unstable: it grows instead of decaying.",
        "As for a negative damper: signs, phase convention, delays.",
    ),
    (
        "no_response", _VERDICT,
        "The search ended, without converging, at a rig that has no settled motion: some value has no size.",
        "Follow the causes that are named; else give the unknowns guesses.",
    ),
    (
        "perhaps_unstable", _VERDICT,
        ("A mode comes out unstable, but its damping ratio is less than three standard deviations below 0: the data "
        "fit, and say too little about the damping to call the rig found."),
        "Measure near the resonance of that mode, longer or with a larger drive, or state a damper that is known.",
    ),
    (
        "parts_disagree", _VERDICT,
        ("Parts of the data that were identified by themselves (`--in-parts`) give values that differ by more than "
        "their noise (χ² of their scatter, p < 0.001): the rig changed, or its misfit differs from part to part."),
        "Identify the part that is named and one other by themselves, and compare what they say.",
    ),
    (
        "parts_misfit", _VERDICT,
        "More of the parts that were identified by themselves (`--in-parts`) do not fit than sound ones would.",
        "Identify the part that is named by itself, with `--report`: residuals and causes are shown there.",
    ),
    (
        "smooth_residuals", _VERDICT,
        "Residuals of a channel vary smoothly with frequency. Noise would scatter from line to line.",
        "Look at them in the report; a delay gives a phase that grows with frequency, a missing mode a bump.",
    ),
    (
        "directed", _VERDICT,
        ("One thing, the gain or delay of a channel or an element between two points, is off by more than noise "
        "explains (score test, p < 0.001 for all together), though χ², which spreads it over all data, passes."),
        "Small as it is, it may move parameters by several standard deviations: check that channel or joint.",
    ),
    (
        "nonlinear", _VERDICT,
        ("A nonlinear element would explain part of what the linear rig leaves of whole records, beyond what any "
        "linear element at its place does (score test, p < 1e-6, alike in the parts of the records)."),
        ("Write the element in the rig file, or let `--apply` do it, and identify again; `compare --elements` weighs "
        "several."),
    ),
    (
        "element_called_for", _VERDICT,
        ("An element more would explain at least a tenth of the squared residuals that whole records of a nonlinear "
        "rig leave, alike in the parts of the records (score test, p < 1e-6 for all candidates together)."),
        ("Write the element in the rig file, or let `--apply` do it, and identify again; `compare --elements` weighs "
        "several."),
    ),
    (
        "standing_out", _VERDICT,
        ("A line of a whole record deviates more than noise of the other lines' size ever would. The noise is "
        "read from the residuals, so their mean size cannot test the fit; a single line can."),
        "Read the likely causes below the verdict; look at the channel at that frequency: clipping, a delay, play.",
    ),
    (
        "mains_hum", _VERDICT,
        "A channel carries a tone at a multiple of 50 or 60 Hz that no input drives. The test of fit leaves it out.",
        "Mend the shielding or the ground loop, or end the band below it with `--band`.",
    ),
    (
        "no_noise", _VERDICT,
        "The noise of the amplitudes is not given, so the size of the residuals cannot be judged.",
        "Add columns `NAME_sd`, use the records themselves, or measure one record at rest.",
    ),
    (
        "noise_from_residuals", _VERDICT,
        "The noise was estimated from the residuals of this fit, so they cannot test the fit.",
        "Record the rig at rest and pass that record with `--noise-record`.",
    ),
    (
        "much_left", _VERDICT,
        ("No noise is known, much of a channel's motion is left over, and with one remedy most of that is explained: "
        "noise would not be."),
        "See the likely cause.",
    ),
    (
        "few_degrees", _VERDICT,
        "There are hardly more data than unknowns, so the test of the fit has little power.",
        "Add frequencies or channels.",
    ),
    (
        "silent_channel", _VERDICT,
        "A channel of a moving point is constant, as if its sensor were off or not connected.",
        "Look at the sensor and its cable, or leave the channel out.",
    ),
    (
        "below_noise", _VERDICT,
        "A channel is below three standard deviations of its noise at most lines; any model would fit it.",
        "Drive more strongly, use a better sensor, or leave the channel out.",
    ),
    (
        "parts_left_out", _ESTIMATE,
        "Parts of the data gave no estimate (`--in-parts`): the others are merged without them.",
        "Read why the first was left out; identify it by itself.",
    ),
    (
        "model_misfit", _ESTIMATE,
        ("The model does not fit; ± and intervals are widened by the ratio of residuals to noise, and further where "
        "leaving out a sixth of the band at a time moves the parameter more. Widened intervals carry no guarantee: "
        "in 60 random rigs with eight kinds of misfit they held the true value in 92 % instead of 95, and they miss "
        "it when what the model lacks acts like that parameter over the whole band."),
        "Correct the model first ([When the model does not fit](../explain/misfit.md)).",
    ),
    (
        "unknown_noise", _ESTIMATE,
        ("No noise is given: it is taken as proportional to each amplitude and its size estimated from the residuals. "
        "Intervals may then be too small or too large."),
        "Give `NAME_sd` in the table, or the records.",
    ),
    (
        "another_method", _ESTIMATE,
        "The default method found no answer, or only a local minimum; maximum likelihood was used instead.",
        "Nothing. A method that you name with `--method` is never replaced.",
    ),
    (
        "coloured_noise", _ESTIMATE,
        ("The noise beside the drive frequency is not white; its size was measured there and the intervals include it. "
        "A transient or a slightly wrong drive frequency looks the same."),
        "For time records, try `--settle auto` and `--refine always`. For tables of amplitudes, nothing.",
    ),
    (
        "cut_record", _ESTIMATE,
        ("The motion of a strongly nonlinear rig depends so much on its start that no single simulation follows the "
        "whole record. It was cut into pieces with starts of their own; the intervals count these as unknowns."),
        "Nothing need be done. A smaller drive or shorter records show whether the parameters stay the same.",
    ),
    (
        "exact_inputs", _ESTIMATE,
        ("The motion of a nonlinear rig in a whole record depends so much on its inputs that their noise cannot be "
        "reckoned with: they count as exact. Noise in them biases the values, and the intervals do not count it. With "
        "3 % of noise on a base, values were up to nine of their standard deviations off."),
        "Measure the inputs with a quieter sensor, drive the rig less, or use settled dwells.",
    ),
    (
        "law_not_seen", _ESTIMATE,
        ("The parameter of a nonlinear element has 0 within its interval: the data fit as well without it. Constants "
        "inside its law (a clearance, a smoothing speed) then mean nothing, whatever their intervals say."),
        "Drive the rig further, so that the law shows, or leave the element out.",
    ),
    (
        "constant_hardly_seen", _ESTIMATE,
        ("A nonlinear element shows, but a length or speed inside its law has 0 within its interval. The law's other "
        "numbers depend on it, along a curve that intervals of the form value ± deviation do not follow."),
        "Drive the rig further, so that the law shows, or give the constant a value.",
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
        "If the bound is certain, use the result; otherwise find out why the data push the value past it.",
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
        "bands_disagree", _ESTIMATE,
        ("The band was divided into six parts; leaving one out moves the values by more than noise explains, even "
        "where χ² finds nothing. Intervals are widened to the scatter of the parts. It is also "
        "a reason of the verdict."),
        "Something in the model depends on frequency: look for a missing part, a delay or a nonlinearity.",
    ),
    (
        "modes_unseen", _ESTIMATE,
        ("A free decay does not show one of the modes found above its noise: the mode has died away before the record "
        "begins, or was never excited. The values named rest on a peak of the noise, and so do their intervals. The "
        "verdict is then \"cannot tell\" at best."),
        "Begin the record right after the release, strike elsewhere, or give values of parts so that fewer are sought.",
    ),
    (
        "noise_in_time", _ESTIMATE,
        ("What the model leaves over of a whole record is louder at some times than at others, as where noise grows "
        "with the motion. Samples are weighted by the noise at their time, and intervals count it; where loud and "
        "quiet times ask for different values, or limits hold unknowns, the weights are left even."),
        "Nothing need be done. Where the residuals should be sensor noise alone, look at what happens at those times.",
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
        ("Weigh or measure that part again, widen its `sd`, or look for an error in the model; remove the value "
        "to see what the data alone give."),
    ),
    (
        "reversed_phase", _ESTIMATE,
        "All unknown dampers are negative: the data probably use e^(−jωt).",
        "Change the sign of every imaginary part (or phase).",
    ),
    (
        "duplicated_lines", _ESTIMATE,
        "Some lines repeat others to the last digit, yet count as independent measurements.",
        "Give each file once.",
    ),
    (
        "input_not_measured", _ESTIMATE,
        "An input is measured at some lines and missing at others, where it is treated as unknown.",
        "If it was at rest there, write 0 in its column.",
    ),
    (
        "short_record", _ESTIMATE,
        ("The record is shorter than one period of the slowest mode: its transient can hardly be separated "
        "from its motion."),
        "Record for several periods of the slowest mode.",
    ),
    (
        "modes_outside", _ESTIMATE,
        ("The band of a whole record holds only some modes of the rig; unknowns that depend on the others stay "
        "undetermined, and the iteration may diverge."),
        "Widen `--band`, or give values to the parameters that the band cannot determine.",
    ),
    (
        "few_lines", _ESTIMATE,
        ("The lines of a whole record in the band hardly outnumber the terms that its two ends need: little "
        "information about the rig is left."),
        "Widen `--band`, or record for longer.",
    ),
    (
        "limited_channel", _ESTIMATE,
        "A channel of a whole record reads less than it should where the motion is large: clipped, or saturated.",
        "Drive less or widen the range; leave the channel out where others show the motion.",
    ),
    (
        "residual_jump", _ESTIMATE,
        ("At one moment of a whole record a channel departs from the prediction, or all residuals are loud for a "
        "while: samples were lost although the time stamps are even, or something struck the rig. Across the lines "
        "that would pass for noise; in time it stands out."),
        "Cut the record there and give the parts as separate files; if it was a blow, measure it as an input.",
    ),
    (
        "spikes", _ESTIMATE,
        "A channel departs from the prediction for single moments of a whole record, as with a loose contact.",
        "Leave those samples out: the record is then used in pieces.",
    ),
    (
        "clock_step", _ESTIMATE,
        "From some time of a whole record on a channel is later, or earlier, than the prediction by more than before.",
        ("Samples of that channel may be lost, or its clock was set while it recorded; give the parts before and after "
        "as two records, the delay of one of them unknown."),
    ),
    (
        "gain_step", _ESTIMATE,
        "From some time of a whole record on a channel reads more, or less, of the prediction than before.",
        ("Look for another range, a loose sensor or a rig that changed; give the parts before and after as two "
        "records, the gain of one of them unknown."),
    ),
    (
        "unrelated_inputs", _ESTIMATE,
        ("No output of the whole records is related to what the inputs measure, at any frequency of the band (F tests, "
        "p > 0.01): the estimate reflects noise only."),
        ("Check that the input's sensor is connected, and is on the same clock as the others; choose the band that was "
        "driven; for a free decay leave the input out and join its elements to the ground."),
    ),
    (
        "noise_factor_diverged", _ESTIMATE,
        "`tls` found no noise factor: the noise hides at least one unknown.",
        "Use `oiv` or `ml`; measure with less noise.",
    ),
    (
        "noise_near_singular", _ESTIMATE,
        "The noise almost hides a combination of unknowns; do not trust `tls`.",
        "Use `oiv` or `ml`.",
    ),
    (
        "noise_not_compensated", _ESTIMATE,
        "The stated noise is too large to be taken out; `cls` leaves its bias in.",
        "Check the stated noise; use `oiv` or `ml`.",
    ),
    *DATA_NOTICES,
)  # fmt: skip


# Notices explained by their codes, from the texts of `notice_guide`.


@dataclass(frozen=True)
class Explained:
    """place: where such notices arise; meaning and cure in Markdown."""

    place: str
    meaning: str
    cure: str


GUIDE: Mapping[str, Explained] = MappingProxyType(
    {code: Explained(place, meaning, cure) for code, place, meaning, cure in NOTICES}
)
