"""The notices on data explained: records and their conditioning, files, studies.  `notice_guide` has all of them."""

from __future__ import annotations

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
