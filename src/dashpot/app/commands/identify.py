"""dashpot identify: from a rig file and test data to parameters with intervals."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from dashpot.app import options as opt
from dashpot.app.commands.validate import predictions_of
from dashpot.app.data_files import (
    RecordOptions,
    part_of,
    require_bounds_held,
    require_each_once,
    tell_notes,
    traits_of,
)
from dashpot.app.process import tell
from dashpot.app.report_files import ReportFile
from dashpot.app.workers import progress, shared_out
from dashpot.errors import DashpotError, DataError, Problem, UsageError
from dashpot.estimate.registry import method_class
from dashpot.io.atomic import write_text
from dashpot.io.ledger import noted

if TYPE_CHECKING:
    from dashpot.check.validation import RecordPrediction
    from dashpot.data.conditioning.lines import UsedDwell
    from dashpot.data.spectrum import Spectrum
    from dashpot.estimate.assessment import Finding
    from dashpot.estimate.result import Estimate
    from dashpot.fleet.data_sets import Treatment
    from dashpot.model.rigfile import Rig
    from dashpot.present.document import Provenance

ESTIMATION = "Estimation"


@opt.dashpot_command(
    "dashpot identify rig.toml data.csv",
    "dashpot identify rig.toml run1.csv run2.csv --json estimate.json --report report.html",
    usual=(
        "--method",
        "--strict",
        "--hold-out",
        "--band",
        "--noise-record",
        "--report",
        "--json",
        "--apply",
        "--figure",
        "--level",
        "--verbose",
        "--quiet",
    ),
)
def command(
    rig: opt.RigFile,
    data: Annotated[tuple[str, ...], opt.NEEDED_FILES, opt.DATA],
    chosen: opt.Method,
    positive: opt.Positive,
    strict: Annotated[
        bool, opt.Option("--strict", None, ESTIMATION), "Exit with code 4 where the model does not fit."
    ],
    within: Annotated[
        float | None,
        opt.Option("--within 2%", opt.PART, ESTIMATION),
        "The share of each channel's motion to within which the model must describe it.",
    ],
    hold_out: Annotated[
        float | None,
        opt.Option("--hold-out 25%", opt.PART, opt.RECORDS),
        "Hold out this share of every record, at its end, and predict it.",
    ],
    in_parts: Annotated[
        bool,
        opt.Option("--in-parts", None, opt.RECORDS),
        "Process files (and pieces of long records) separately and merge the estimates; for data larger than "
        "memory.",
    ],
    workers: opt.Workers,
    dask: opt.Dask,
    modal_sd: opt.ModalSd,
    json_out: Annotated[str | None, opt.JSON, "the estimate"],
    apply: Annotated[
        str | None,
        opt.Option("--apply NEW.toml", opt.OutputFile(), opt.OUTPUT),
        "Write the rig file with the most likely cause of the misfit corrected; all else stays as it is "
        "written.",
    ],
    force: Annotated[bool, opt.Option("--force", None, opt.OUTPUT), "Let --apply replace an existing file."],
    figure: Annotated[
        str | None,
        opt.FIGURE,
        "Draw the fit: responses, measured and model; for continuous records of nonlinear rigs, time histories; for "
        "measured modes, how far each unknown is from its guess.",
    ],
    report: ReportFile,
    matrices: Annotated[bool, opt.Option("--matrices", None, opt.OUTPUT), "Print M, C and K as well."],
    level: opt.Level,
    records: RecordOptions,
    seed: Annotated[int, opt.SEED, "the starting values that ml draws"],
    verbose: opt.Verbose,
    quiet: opt.Quiet,
) -> int:
    """Estimate the unknown masses, dampers and springs of RIG (a rig file, TOML) from DATA.

    DATA are data files: time records (frequency_hz, time_s, channels), complex amplitudes (frequency_hz, NAME_re,
    NAME_im, NAME_sd) or frequency response functions (frequency_hz, OUT/IN_re, OUT/IN_im).  Files of instruments
    (UFF, MAT, HDF5, TDMS, Excel, …) are read as they are; so is one file of measured modes.

    Exit codes: 0 done, whatever the verdict; 2 bad usage, model or data; 3 the data do not determine the unknowns, or
    the iteration did not converge; 4 with --strict, the model does not fit; 5 not enough memory.
    """
    from dashpot.data.readers.modes import holds_modes
    from dashpot.model.rigfile import read_rig

    if apply is not None and not force and os.path.exists(apply):
        raise UsageError("a file of this name exists", apply, "name another file, or give --force")
    whole = {"--hold-out": hold_out is not None, "--figure": figure is not None}
    if in_parts:
        what = "{} needs all data at once, which --in-parts does not have"
        _refuse(whole, what, "leave out --in-parts")
    else:
        sharing = {"--workers": workers is not None, "--dask": dask is not None}
        _refuse(sharing, "{} needs --in-parts", "add it, or leave {} out")
    modal = len(data) == 1 and holds_modes(data[0])
    if modal:
        options = {"--method": chosen != "auto", "--positive": positive, "--matrices": matrices}
        options |= {"--hold-out": hold_out is not None}
        options |= {"--in-parts": in_parts, "--within": within is not None}
        _refuse(options, "{path} contains modes, to which {} does not apply", "leave {} out", path=data[0])
    read = read_rig(rig)
    read = read if within is None else replace(read, within=within)
    if in_parts or modal:
        read.require_alike("--in-parts" if in_parts else "identification from measured modes")
    with report.of_failure(read), _remedy_written(read, apply):
        if modal:
            found = Identified(of_modes(read, data[0], modal_sd, seed, quiet))
        else:
            require_answer(read, chosen, positive, matrices)
            if in_parts:
                treatment = records.treatment(read, chosen, positive, seed)
                found = Identified(_in_parts(read, data, treatment, workers, dask, quiet))
            else:
                shares = (hold_out or 0.0, figure is not None, bool(report))
                found = identified(read, data, records, chosen, positive, seed, *shares)
    estimate = found.estimate
    if figure is not None:
        found.draw(figure, read)
    if report:
        report.write(found.report(read, level, report.provenance))
    opt.write_result(json_out, estimate.to_json())
    useful = with_a_line(() if estimate.assessment is None else estimate.assessment.findings)
    if apply is not None and useful:
        _write_applied(read, useful[0], apply)
    if not quiet and json_out != opt.STDOUT:
        _show(read, found, level, matrices, verbose)
        opt.tell_written(json_out, report.report, figure)
    if apply is not None:
        done = (
            f"Written: {apply}, the rig file with {useful[0].change}"
            if useful
            else f"Nothing to apply; {apply} was not written"
        )
        click.echo(done, err=json_out == opt.STDOUT)
    return _ending(estimate, strict)


@dataclass(frozen=True)
class Identified:
    """An estimate and what it was made from, as far as that can be shown; `histories` where there is no spectrum."""

    estimate: Estimate
    spectrum: Spectrum | None = None
    untried: tuple[str, ...] = ()
    dwells: tuple[UsedDwell, ...] = ()
    held: tuple[RecordPrediction, ...] = ()
    histories: tuple[RecordPrediction, ...] = ()

    def report(self, rig: Rig, level: float, provenance: Provenance) -> str:
        """The report, HTML."""
        from dashpot.present.identification import identification_report

        return identification_report(
            rig.model,
            self.spectrum,
            self.estimate,
            level,
            provenance,
            channels=rig.channels,
            held_out=self.held,
            untried=self.untried,
            dwells=self.dwells,
            histories=self.histories,
        )

    def draw(self, path: str, rig: Rig) -> None:
        """Draw the fit: of records without a spectrum, their histories; of modes, what has moved.

        Raises UsageError where nothing is driven, or where nothing was guessed.
        """
        from dashpot.present.figures.style import write_figure

        if self.spectrum is None and not self.histories:
            from dashpot.present.identification import moved_figure

            write_figure(path, moved_figure(rig.model, self.estimate))
        elif self.spectrum is None:
            from dashpot.present.figures.spectra import drawn_of, prediction_figure

            write_figure(path, prediction_figure(drawn_of(self.histories)))
        else:
            from dashpot.present.identification import fit_figure

            write_figure(path, fit_figure(rig.model, self.estimate, self.spectrum.channels))


def identified(
    rig: Rig,
    data: Sequence[str],
    options: RecordOptions,
    chosen: str,
    positive: bool,
    seed: int,
    hold_out: float,
    drawn: bool,
    reported: bool,
) -> Identified:
    """From all files together, but for the share `hold_out` at the end of every record, which is predicted."""
    from dashpot.api import identify
    from dashpot.data.conditioning.lines import used_dwells
    from dashpot.estimate.identify import conditioning_for

    everything = options.reading(rig, data)
    used = (0.0, 1.0 - hold_out)
    reading, method = part_of(everything, used), None if chosen == "auto" else chosen
    in_time = bool(len(rig.model.nonlinear)) and everything.continuous
    if in_time:
        options.require_in_time()
        conditioning = options.conditioning(rig)
        with progress("identify", options.quiet) as moved:
            estimate = identify(
                rig, reading, method, conditioning=conditioning, seed=seed, positive=positive, progress=moved
            )
        found = Identified(estimate)
    else:
        conditioning = options.conditioning(rig, reading)
        spectrum = options.spectrum(rig, reading, conditioning, [chosen])
        with progress("identify", options.quiet) as moved:
            estimate = identify(rig, spectrum, method, seed=seed, positive=positive, progress=moved)
        assert estimate.origin is not None
        treated = conditioning_for(rig.model, reading, conditioning, traits_of([chosen]))
        dwells = used_dwells(reading.records, spectrum, treated) if reported else ()
        untried = conditioning.untried if reading.records else ()
        found = Identified(estimate, estimate.origin.spectrum, untried, dwells)
    unheard = replace(options, quiet=True)
    if hold_out:
        held = predictions_of(rig, estimate, part_of(everything, (used[1], 1.0)), unheard)
        found = replace(found, held=held)
    if in_time and (drawn or reported):
        try:
            found = replace(found, histories=predictions_of(rig, estimate, reading, unheard))
        except DataError:  # a motion that cannot be followed is missed in a figure of it alone
            if drawn:
                raise
    return found


def of_modes(
    rig: Rig, path: str, relative_sd: tuple[float, float, float], seed: int, quiet: bool
) -> Estimate:
    """From a file of measured modes."""
    from dashpot.api import identify
    from dashpot.data.readers.modes import modes_and_notes

    modes, notes = modes_and_notes(path, rig.model.coordinates, rig.channels, relative_sd)
    tell_notes(notes, quiet)
    with progress("identify", quiet):
        estimate = identify(rig, modes, seed=seed)
    tell_notes(estimate.notes, quiet)
    return estimate


def _in_parts(
    rig: Rig, data: Sequence[str], treatment: Treatment, workers: int | None, dask: str | None, quiet: bool
) -> Estimate:
    """From every file by itself, shared out to worker processes or a cluster, and merged."""
    from dashpot.fleet.record_parts import identify_in_parts

    if len(rig.model.nonlinear):
        raise UsageError(
            "parts can be merged for linear rigs only",
            "--in-parts",
            "identify some of the files together, without --in-parts",
        )
    require_each_once(data)
    files = [noted(name) for name in data]
    with shared_out(dask, workers, len(files) == 1) as mapper, progress("identify", quiet) as moved:
        estimate = identify_in_parts(rig, files, treatment, mapper=mapper, progress=moved)
    tell_notes(estimate.notes, quiet)
    return replace(estimate, rig=rig.path)


def _refuse(options: Mapping[str, bool], what: str, cure: str, **words: str) -> None:
    """Raises UsageError that says `what` is wrong with the first option that is given, which stands for {}."""
    for name, given in options.items():
        if given:
            raise UsageError(what.format(name, **words), cure=cure.format(name))


def require_answer(rig: Rig, chosen: str, positive: bool, matrices: bool) -> None:
    """All that can be refused before data are read."""
    from dashpot.check.deficiencies import require_identifiable
    from dashpot.check.structure import require_scale_seen

    rig.model.require_unknowns(rig.path)
    require_bounds_held(chosen, positive)
    if matrices and len(rig.model.by_matrix["H"]):
        raise UsageError("hysteretic dampers do not fit into M, C or K", "--matrices", "leave the option out")
    if matrices and 0 < len(rig.model.angles & set(rig.model.coordinates)) < rig.model.n:
        raise UsageError(
            "the entries of matrices over displacements and angles have different units",
            "--matrices",
            "leave the option out",
        )
    require_identifiable(rig.model, rig.all_channels, rig.path)
    if chosen != "auto":
        require_scale_seen(method_class(chosen), rig.model, rig.channels, rig.path)


@contextmanager
def _remedy_written(rig: Rig, path: str | None) -> Iterator[None]:
    """Where the work inside gives no answer, but a cause with a remedy, the rig file is written with that taken."""
    try:
        yield
    except DashpotError as error:
        useful = with_a_line(error.causes)
        if path is None or not useful:
            raise
        _write_applied(rig, useful[0], path)
        written = Problem(f"{path} was written with the first cause corrected", cure="identify with it")
        raise type(error)([*error.problems, written]) from error


def with_a_line(findings: Sequence[object]) -> list[Finding]:
    """Those that have a line of the rig file to write."""
    from dashpot.estimate.assessment import Finding

    return [each for each in findings if isinstance(each, Finding) and (each.channels or each.elements)]


def _write_applied(rig: Rig, finding: Finding, path: str) -> None:
    """Write the rig file with the remedy of a finding taken."""
    write_text(path, corrected(rig, finding))


def corrected(rig: Rig, finding: Finding) -> str:
    """The text of a rig's file with the remedy of a finding taken: one edit, the rest as it was written."""
    from dashpot.estimate.assessment import applied
    from dashpot.model.rigfile import edited

    model, channels = applied(rig.model, rig.all_channels, finding)
    usual = tuple(channel for channel in channels if channel.only is None)
    experiments = tuple(
        replace(each, channels=tuple(channel for channel in channels if channel.only == each.name))
        for each in rig.experiments
    )
    after = replace(rig, model=model, channels=usual, experiments=experiments)
    return edited(Path(noted(rig.path)).read_text(encoding="utf-8"), rig, after)


def _show(rig: Rig, found: Identified, level: float, matrices: bool, verbose: bool) -> None:
    from dashpot.model.matrix_elements import free_names
    from dashpot.present.document import say
    from dashpot.present.estimate import estimate_document

    say(estimate_document(found.estimate, level, untried=found.untried, verbose=verbose), apart=True)
    # Free matrices are what the rig is, as long as no hysteretic damper, which is in none of them, is there as well.
    if matrices or (free_names(rig.model) and not len(rig.model.by_matrix["H"])):
        from dashpot.estimate.linear.instrumental_variables import matrices_of
        from dashpot.present.document import Document
        from dashpot.present.estimate import matrix_sections

        angular = set(rig.model.coordinates) <= rig.model.angles
        say(Document("", matrix_sections(matrices_of(rig.model, found.estimate), angular)), apart=True)
    if found.held:
        from dashpot.present.validation import validation_document

        say(validation_document(found.held), apart=True)


def _ending(estimate: Estimate, strict: bool) -> int:
    """The exit code, and a line where the iteration has not converged."""
    from dashpot.estimate.inference.diagnostics import UNSEEN_LAW
    from dashpot.present.words import sentence

    if bool(estimate.converged):
        misfits = estimate.assessment is not None and estimate.assessment.verdict == "does not fit"
        return opt.DOES_NOT_FIT if strict and misfits else 0
    cure = (
        'check signs and units of the channels (gain = "unknown" for all but one reveals a wrong one), give '
        "initial guesses of the unknowns, or try another --method"
    )
    if estimate.assessment is not None and estimate.assessment.cause is not None:
        best = estimate.assessment.cause
        cure = f"a likely cause: {sentence(best.text)} To change: {best.change}"
    if any(notice.code == "modes_outside" for notice in estimate.warnings):
        cure = (
            "the band contains too few of the rig's modes: widen --band, or state values of the unknowns "
            "named above"
        )
    unseen = [name for notice in estimate.warnings if notice.code == UNSEEN_LAW for name in notice.of]
    if unseen:
        cure = f"the data do not show {', '.join(unseen)}: remove the element, or increase the drive"
    tell(f"dashpot: {estimate.method} did not converge in {int(estimate.iterations)} iterations; {cure}")
    return opt.NOT_CONVERGED
