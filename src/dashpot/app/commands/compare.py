"""dashpot compare: the same data through several methods, one table and one picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from dashpot.app.options import (
    AMOUNTS,
    DATA_HELP,
    INPUT_FILE,
    NOT_CONVERGED,
    STDOUT,
    conditioning_options,
    dashpot_command,
    data_argument,
    figure_option,
    json_option,
    level_option,
    modal_sd_option,
    option,
    quiet_option,
    rig_argument,
    seed_option,
    whole_record_options,
)
from dashpot.app.report_files import report_option
from dashpot.estimate.registry import METHODS, methods_for

if TYPE_CHECKING:
    from dashpot.data.modal_data import ModalData
    from dashpot.data.spectrum import Spectrum
    from dashpot.estimate.comparison import Comparison
    from dashpot.model.rigfile import Rig
    from dashpot.quantities import Amount

WHAT = "What to compare"


@dashpot_command(
    "compare",
    "dashpot compare rig.toml data.csv",
    "dashpot compare rig.toml record.csv --elements",
    'dashpot compare rig.toml data.csv --methods wls,oiv,ml --truth "m1=3,k1=4.6 kN/m" --figure methods.png',
)
@rig_argument
@data_argument(DATA_HELP)
@option(
    "--methods",
    metavar="A,B,…",
    group=WHAT,
    help=f"Estimators, in the order of the rows: {', '.join(METHODS)}.  [default: all that suit]",
)
@option(
    "--modal", "modal_file", type=INPUT_FILE, metavar="FILE", group=WHAT,
    help="Add an estimate from measured modes: CSV or JSON (frequency_hz, frequency_sd, damping_ratio, damping_sd, "
    "NAME_re, NAME_im, NAME_sd), or a universal file (dataset 55).",
)  # fmt: skip
@option(
    "--truth",
    type=AMOUNTS,
    metavar="m1=3,…",
    group=WHAT,
    help="True values where they are known; intervals that miss them are marked.  A bare number is in SI units.",
)
@modal_sd_option(WHAT)
@option(
    "--elements",
    is_flag=True,
    group=WHAT,
    help="Compare nonlinear elements that the rig might have, ranked by evidence, instead of methods.",
)
@figure_option("Draw the intervals.")
@report_option
@json_option("all estimates")
@level_option
@conditioning_options
@whole_record_options
@seed_option("the starting values that ml and the fit to modes draw")
@quiet_option
def command(
    rig: str, data: tuple[str, ...], methods: str | None, modal_file: str | None,
    modal_sd: tuple[float, float, float], truth: dict[str, Amount] | None, elements: bool,
    figure: str | None, report: str | None, json_out: str | None, seed: int, level: float, quiet: bool,
    **conditioning: Any,
) -> int:  # fmt: skip
    """Estimate the unknowns of RIG from DATA with several methods, side by side, or compare nonlinear elements.

    DATA as for identify; with --modal FILE they may be left out.  A method that does not suit the data is named with
    the reason.

    Exit codes: 0 done; 2 bad usage, model or data; 3 a method did not converge; 5 not enough memory.
    """
    from dashpot.app.options import write_result
    from dashpot.app.parameters import true_values
    from dashpot.model.rigfile import read_rig

    if elements:
        _check_elements(data, methods, modal_file, truth, figure, report)
        return _elements(rig, data, json_out, quiet, conditioning)
    chosen = _chosen(methods, bool(data), modal_file is not None)
    rig_read = read_rig(rig)
    rig_read.model.require_unknowns(rig)
    chosen = chosen or methods_for(rig_read.model)
    true = None if truth is None else true_values(rig_read, truth)
    modal = None if modal_file is None else _modes(modal_file, rig_read, modal_sd, quiet)
    spectrum = _spectrum(data, rig_read, chosen, conditioning, quiet) if data else None
    comparison = _compared(rig_read, spectrum, modal, chosen, true, seed, quiet)
    if figure is not None:
        _draw(comparison, level, figure)
    if report is not None:
        from dashpot.app.report_files import provenance, write_report
        from dashpot.present.pages.others import comparison_report

        channels = rig_read.channels if spectrum is None else spectrum.channels
        write_report(report, comparison_report(rig_read.model, channels, comparison, level, provenance()))
    write_result(json_out, comparison.to_json())
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.comparison import show_comparison
        from dashpot.present.tables.layout import console

        show_comparison(console(), comparison, level)
    return _ending(comparison)


def _check_elements(data: Sequence[str], *others: object) -> None:
    """--elements needs DATA and goes with none of the other things to compare.  Raises UsageError."""
    from dashpot.errors import UsageError

    if not data:
        raise UsageError("--elements needs data, and none are given", "--elements", "give DATA")
    if any(other is not None for other in others):
        cure = "leave out --methods, --modal, --truth, --figure and --report"
        raise UsageError("--elements works with ml only", "--elements", cure)


def _elements(
    rig: str, data: Sequence[str], json_out: str | None, quiet: bool, conditioning: dict[str, Any]
) -> int:
    """Nonlinear elements by evidence: from whole records by integration, else from the harmonics of dwells."""
    from dashpot.app.data_files import measured_data, read_files
    from dashpot.app.options import write_result
    from dashpot.app.progress import progress
    from dashpot.check.element_evidence import compare_in_dwells, compare_in_records
    from dashpot.model.rigfile import read_rig

    rig_read = read_rig(rig)
    rig_read.model.require_unknowns(rig)
    reading = read_files(rig_read, data, conditioning, quiet)
    if reading.continuous:
        with progress("compare", quiet) as moved:
            evidence = compare_in_records(rig_read.model, reading.records, progress=moved)
    else:
        measured = measured_data(rig_read, reading, conditioning, quiet, moments_for=["hls"])
        evidence = compare_in_dwells(rig_read.model, measured.spectrum)
    write_result(json_out, evidence.to_json())
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.element_evidence import show_elements
        from dashpot.present.tables.layout import console

        show_elements(console(), evidence)
    return 0


def _chosen(methods: str | None, data: bool, modal: bool) -> list[str]:
    """The names of --methods, each a method and named once; none where the option is not given."""
    from dashpot.errors import UsageError
    from dashpot.estimate.registry import method_class

    if not data and not modal:
        raise UsageError("there are no data", cure="give DATA, --modal FILE, or both")
    if methods is None:
        return []
    if not data:
        raise UsageError(
            "the methods need DATA, and none are given", "--methods", "give DATA, or leave it out"
        )
    chosen = [name.strip() for name in methods.split(",")]
    for name in chosen:
        method_class(name)
        if chosen.count(name) > 1:
            raise UsageError(f"{name} is named twice", "--methods", "name each method once")
    return chosen


def _modes(path: str, rig: Rig, relative_sd: tuple[float, float, float], quiet: bool) -> ModalData:
    from dashpot.app.data_files import tell_notes
    from dashpot.data.readers.modes import modes_and_notes

    modes, notes = modes_and_notes(path, rig.model.coordinates, rig.channels, relative_sd)
    tell_notes(notes, quiet)
    return modes


def _spectrum(
    data: Sequence[str], rig: Rig, chosen: list[str], conditioning: dict[str, Any], quiet: bool
) -> Spectrum:
    from dashpot.app.data_files import read_spectrum
    from dashpot.check.structure import require_scale

    require_scale(rig.model, rig.channels, rig.path)
    return read_spectrum(rig, data, conditioning, quiet, moments_for=chosen)


def _compared(
    rig: Rig, spectrum: Spectrum | None, modal: ModalData | None, chosen: list[str], truth: dict[str, float] | None,
    seed: int, quiet: bool,
) -> Comparison:  # fmt: skip
    from dashpot.app.progress import progress
    from dashpot.check.structure import require_scale_seen
    from dashpot.errors import DashpotError
    from dashpot.estimate.comparison import compare
    from dashpot.estimate.registry import method, method_class

    jobs, refused = {}, {}
    for name in chosen if spectrum is not None else ():
        try:
            require_scale_seen(method_class(name), rig.model, rig.channels)
            jobs[name] = method(name, seed=seed)
        except DashpotError as error:
            refused[name] = error
    with progress("compare", quiet) as moved:
        return compare(
            rig.model, spectrum, jobs, modal=modal, refused=refused, truth=truth, seed=seed, progress=moved
        )


def _draw(comparison: Comparison, level: float, figure: str) -> None:
    from dashpot.present.figures.comparison import comparison_figure
    from dashpot.present.figures.style import write_figure

    write_figure(figure, comparison_figure(comparison, level))


def _ending(comparison: Comparison) -> int:
    unsettled = [name for name, estimate in comparison.estimates.items() if not bool(estimate.converged)]
    if not unsettled:
        return 0
    click.echo(
        f"dashpot: {', '.join(unsettled)} did not converge; do not use these values: "
        "check signs and units of the channels, or the noise is too large",
        err=True,
    )
    return NOT_CONVERGED
