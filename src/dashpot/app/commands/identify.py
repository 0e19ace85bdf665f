"""dashpot identify: from a rig file and test data to parameters with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from dashpot.app.options import (
    DATA_HELP,
    DOES_NOT_FIT,
    NOT_CONVERGED,
    PART,
    RECORDS,
    STDOUT,
    conditioning_options,
    dashpot_command,
    dask_option,
    data_argument,
    figure_option,
    file_option,
    json_option,
    level_option,
    method_option,
    modal_sd_option,
    option,
    positive_option,
    quiet_option,
    rig_argument,
    seed_option,
    whole_record_options,
    workers_option,
    write_result,
)
from dashpot.app.report_files import failure_reported, report_option

if TYPE_CHECKING:
    from dashpot.app.identifying import Identified
    from dashpot.check.validation import RecordPrediction
    from dashpot.data.spectrum import Spectrum
    from dashpot.estimate.assessment import Finding
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

ESTIMATION = "Estimation"


@dashpot_command(
    "identify",
    "dashpot identify rig.toml data.csv",
    "dashpot identify rig.toml run1.csv run2.csv --json estimate.json --report report.html",
)
@rig_argument
@data_argument(DATA_HELP, required=True)
@method_option(ESTIMATION)
@positive_option(ESTIMATION)
@option("--strict", is_flag=True, group=ESTIMATION, help="Exit with code 4 where the model does not fit.")
@option(
    "--within",
    type=PART,
    metavar="2%",
    group=ESTIMATION,
    help="The share of every channel's motion within which the model is to describe it.",
)
@option(
    "--hold-out",
    type=PART,
    metavar="25%",
    group=RECORDS,
    help="Hold out this share of every record, at its end, and predict it.",
)
@option(
    "--in-parts",
    is_flag=True,
    group=RECORDS,
    help="Identify every file by itself, very long records in pieces, and merge what they say: data beyond memory.",
)
@workers_option
@dask_option
@modal_sd_option("Measured modes")
@json_option("the estimate")
@file_option("--apply", "NEW.toml", "Write the rig file with the most likely cause of a misfit corrected.")
@figure_option("Draw the fit: responses, measured and model; of whole records of nonlinear rigs, histories.")
@report_option
@option("--matrices", is_flag=True, group="Output", help="Print M, C and K as well.")
@level_option
@conditioning_options
@whole_record_options
@seed_option("the starting values that ml draws")
@quiet_option
def command(
    rig: str, data: tuple[str, ...], chosen: str, positive: bool, json_out: str | None, figure: str | None,
    report: str | None, strict: bool, within: float | None, hold_out: float | None, apply: str | None,
    matrices: bool, level: float, seed: int, quiet: bool, modal_sd: tuple[float, float, float], in_parts: bool,
    workers: int | None, dask: str | None, **conditioning: Any,
) -> int:  # fmt: skip
    """Estimate the unknown masses, dampers and springs of RIG (a rig file, TOML) from DATA.

    DATA are data files: time records (frequency_hz, time_s, channels), complex amplitudes (frequency_hz, NAME_re,
    NAME_im, NAME_sd) or frequency response functions (frequency_hz, OUT/IN_re, OUT/IN_im).  Files of instruments
    (UFF, MAT, HDF5, TDMS, Excel, …) are read as they are, and so are files of measured modes, one alone.

    Exit codes: 0 done, whatever the verdict; 2 bad usage, model or data; 3 the data do not determine the unknowns, or
    the iteration did not converge; 4 with --strict, the model does not fit; 5 not enough memory.
    """
    from dashpot.app.identifying import (
        Identified,
        Search,
        identified_in_parts,
        identified_together,
        modal_estimate,
        require_in_parts,
    )

    whole = {"--hold-out": hold_out is not None, "--figure": figure is not None}
    require_in_parts(in_parts, {"--workers": workers is not None, "--dask": dask is not None}, whole)
    unsuited = {"--method": chosen != "auto", "--positive": positive, "--matrices": matrices}
    unsuited |= whole | {"--in-parts": in_parts, "--within": within is not None}
    used = (0.0, 1.0 - (hold_out or 0.0))
    with failure_reported(report, rig), _remedy_written(rig, apply):
        of_modes = modal_estimate(rig, data, modal_sd, seed, quiet, unsuited)
        search = Search(rig, chosen, positive, seed, quiet)
        if of_modes is not None:
            found = Identified(*of_modes)
        elif in_parts:
            found = identified_in_parts(
                search, _rig(rig, chosen, positive, matrices, within), data, conditioning, workers, dask
            )
        else:
            rig_read = _rig(rig, chosen, positive, matrices, within)
            found = identified_together(search, rig_read, data, conditioning, used, report is not None)
    held = (
        () if hold_out is None else _predicted(found.rig, found.estimate, data, conditioning, (used[1], 1.0))
    )
    drawn = found.in_time and (figure is not None or report is not None)
    histories = _histories(found.rig, found.estimate, data, conditioning, used, figure) if drawn else ()
    _draw(figure, found.rig, found.spectrum, found.estimate, histories)
    _write_report(report, found, level, held, histories)
    write_result(json_out, found.estimate.to_json())
    _apply(found.rig, found.estimate, apply)
    if not quiet and json_out != STDOUT:
        _show(found.rig, found.estimate, level, matrices, found.untried, held)
    return _ending(found.estimate, strict)


def _draw(
    path: str | None,
    rig: Rig,
    spectrum: Spectrum | None,
    estimate: Estimate,
    histories: tuple[RecordPrediction, ...],
) -> None:
    """Draw the fit, if to a path: of records without a spectrum, their histories."""
    if path is None:
        return
    from dashpot.present.figures.style import write_figure

    if spectrum is None:
        from dashpot.present.figures.validation import drawn_of, prediction_figure

        write_figure(path, prediction_figure(drawn_of(histories)))
    else:
        from dashpot.present.pages.report import fit_figure

        write_figure(path, fit_figure(rig.model, spectrum, estimate))


def _write_report(
    path: str | None,
    found: Identified,
    level: float,
    held: tuple[RecordPrediction, ...],
    histories: tuple[RecordPrediction, ...],
) -> None:
    """Write the report, if to a path."""
    if path is None:
        return
    from dashpot.app.report_files import provenance, write_report
    from dashpot.present.pages.report import identification_report

    page = identification_report(
        found.rig.model,
        found.spectrum,
        found.estimate,
        level,
        provenance(),
        channels=found.rig.channels,
        held_out=held,
        untried=found.untried,
        dwells=found.dwells,
        histories=histories,
    )
    write_report(path, page)


def _rig(path: str, chosen: str, positive: bool, matrices: bool, within: float | None) -> Rig:
    """The rig, with all that can be refused before data are read."""
    from dataclasses import replace

    from dashpot.app.parameters import require_bounds_held
    from dashpot.check.deficiencies import require_identifiable
    from dashpot.check.structure import require_scale_seen
    from dashpot.estimate.registry import method_class
    from dashpot.model.rigfile import read_rig

    rig = read_rig(path)
    rig = rig if within is None else replace(rig, within=within)
    rig.model.require_unknowns(path)
    if positive:
        require_bounds_held(chosen)
    _check_matrices(rig, matrices)
    require_identifiable(rig.model, rig.channels, path)
    if chosen != "auto":
        require_scale_seen(method_class(chosen), rig.model, rig.channels, path)
    return rig


def _predicted(
    rig: Rig,
    estimate: Estimate,
    data: tuple[str, ...],
    conditioning: dict[str, Any],
    part: tuple[float, float],
) -> tuple[RecordPrediction, ...]:
    """How well a part of each record is predicted, in shares of its length."""
    from dashpot.app.validating import predictions_of

    return predictions_of(rig, estimate, data, conditioning, True, part=part)


def _histories(
    rig: Rig, estimate: Estimate, data: tuple[str, ...], conditioning: dict[str, Any], used: tuple[float, float],
    figure: str | None,
) -> tuple[RecordPrediction, ...]:  # fmt: skip
    """The motion of records without a spectrum; none where it cannot be followed, unless a figure asks for it."""
    from dashpot.errors import DataError

    try:
        return _predicted(rig, estimate, data, conditioning, used)
    except DataError:
        if figure is not None:
            raise
        return ()


@contextmanager
def _remedy_written(rig: str, path: str | None) -> Iterator[None]:
    """Where the work inside gives no answer, but a cause with a remedy, the rig file is written with that taken."""
    from dashpot.errors import DashpotError, Problem

    try:
        yield
    except DashpotError as error:
        from dashpot.model.rigfile import read_rig

        useful = _with_a_line(error.causes)
        if path is None or not useful:
            raise
        _write_applied(read_rig(rig), useful[0], path)
        written = Problem(f"{path} has the first cause corrected", cure="identify with it")
        raise type(error)([*error.problems, written]) from error


def _apply(rig: Rig, estimate: Estimate, path: str | None) -> None:
    """Write the rig file with the first finding's remedy taken, if to a path."""
    if path is None:
        return
    from dashpot.errors import UsageError

    useful = _with_a_line(() if estimate.assessment is None else estimate.assessment.findings)
    if not useful:
        raise UsageError("there is no change to the rig file to apply", "--apply", "leave the option out")
    _write_applied(rig, useful[0], path)


def _with_a_line(findings: Sequence[object]) -> list[Finding]:
    """Those that have a line of the rig file to write."""
    from dashpot.estimate.assessment import Finding

    return [each for each in findings if isinstance(each, Finding) and (each.channels or each.elements)]


def _write_applied(rig: Rig, finding: Finding, path: str) -> None:
    """Write the rig file with the remedy of a finding taken."""
    from dataclasses import replace

    from dashpot.estimate.assessment import applied
    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import write_rig

    model, channels = applied(rig.model, rig.channels, finding)
    write_text(path, write_rig(replace(rig, model=model, channels=channels)))


def _show(
    rig: Rig, estimate: Estimate, level: float, matrices: bool, untried: tuple[str, ...],
    held: tuple[RecordPrediction, ...],
) -> None:  # fmt: skip
    from dashpot.present.tables.estimate import show_estimate
    from dashpot.present.tables.layout import console

    show_estimate(console(), estimate, level, untried=untried)
    if matrices or _of_free_matrices(rig):
        from dashpot.estimate.linear.definite import matrices_of
        from dashpot.present.tables.estimate import show_matrices

        angular = set(rig.model.coordinates) <= rig.model.angles
        show_matrices(console(), matrices_of(rig.model, estimate), angular)
    if held:
        from dashpot.present.tables.validation import show_validation

        show_validation(console(), held)


def _of_free_matrices(rig: Rig) -> bool:
    """Whether M, C and K are free and describe all of the rig: hysteretic dampers are in none of them."""
    from dashpot.model.unstructured import free_names

    return bool(free_names(rig.model)) and not len(rig.model.by_matrix["H"])


def _check_matrices(rig: Rig, wanted: bool) -> None:
    """Refuse --matrices, before the work, where they do not describe all of the rig."""
    from dashpot.errors import UsageError

    if wanted and len(rig.model.by_matrix["H"]):
        raise UsageError(
            "hysteretic dampers have no place in M, C or K", "--matrices", "leave the option out"
        )
    if wanted and 0 < len(rig.model.angles & set(rig.model.coordinates)) < rig.model.n:
        raise UsageError(
            "the entries of matrices over displacements and angles have different units",
            "--matrices",
            "leave the option out",
        )


def _ending(estimate: Estimate, strict: bool) -> int:
    """The exit code, and a line where the iteration has not converged."""
    from dashpot.estimate.inference.diagnostics import UNSEEN_LAW
    from dashpot.present.text.estimate import sentence

    if bool(estimate.converged):
        misfits = estimate.assessment is not None and estimate.assessment.verdict == "does not fit"
        return DOES_NOT_FIT if strict and misfits else 0
    cure = (
        'check signs and units of the channels (gain = "unknown" for all but one shows a wrong one), '
        "give the unknowns a guess, or try another --method"
    )
    if estimate.assessment is not None and estimate.assessment.findings:
        best = estimate.assessment.findings[0]
        cure = f"a likely cause: {sentence(best.text)} To change: {best.change}"
    if any(notice.code == "modes_outside" for notice in estimate.warnings):
        cure = "the band shows too few of the rig's modes: widen --band, or give values to the unknowns named above"
    unseen = [name for notice in estimate.warnings if notice.code == UNSEEN_LAW for name in notice.of]
    if unseen:
        cure = f"the data do not show {', '.join(unseen)}: leave the element out, or drive the rig further"
    click.echo(
        f"dashpot: {estimate.method} did not converge in {int(estimate.iterations)} iterations; {cure}",
        err=True,
    )
    return NOT_CONVERGED
