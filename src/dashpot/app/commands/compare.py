"""dashpot compare: the same data through several methods, one table and one picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from dashpot.app import options as opt
from dashpot.app.data_files import RecordOptions, tell_notes
from dashpot.app.options import true_values
from dashpot.app.process import tell
from dashpot.app.report_files import ReportFile
from dashpot.app.workers import progress
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.registry import METHODS, method, method_class, methods_for
from dashpot.quantities import Amount

if TYPE_CHECKING:
    from dashpot.model.rigfile import Rig

WHAT = "What to compare"


@opt.dashpot_command(
    "dashpot compare rig.toml data.csv",
    "dashpot compare rig.toml record.csv --elements",
    'dashpot compare rig.toml data.csv --methods wls,oiv,ml --truth "m1=3,k1=4.6 kN/m" --figure methods.png',
)
def command(
    rig: opt.RigFile,
    data: Annotated[tuple[str, ...], opt.FILES, opt.DATA],
    methods: Annotated[
        str | None,
        opt.Option("--methods A,B,…", None, WHAT),
        f"Estimators, in the order of the rows: {', '.join(METHODS)}.  [default: all that are suitable]",
    ],
    modal_file: Annotated[
        str | None,
        opt.Option("--modal FILE", opt.INPUT_FILE, WHAT),
        "Add an estimate from measured modes: CSV or JSON (frequency_hz, frequency_sd, damping_ratio, damping_sd, "
        "NAME_re, NAME_im, NAME_sd), or a universal file (dataset 55).",
    ],
    truth: Annotated[
        dict[str, Amount] | None,
        opt.Option("--truth m1=3,…", opt.AMOUNTS, WHAT),
        "True values where they are known; intervals that miss them are marked.  A bare number is in SI units.",
    ],
    modal_sd: Annotated[opt.ModalSd, WHAT],
    elements: Annotated[
        bool,
        opt.Option("--elements", None, WHAT),
        "Compare nonlinear elements that the rig might have, ranked by evidence, instead of methods.",
    ],
    figure: Annotated[str | None, opt.FIGURE, "Draw the intervals."],
    report: ReportFile,
    json_out: Annotated[str | None, opt.JSON, "all estimates"],
    level: opt.Level,
    records: RecordOptions,
    seed: Annotated[int, opt.SEED, "the starting values that ml and the fit to modes draw"],
    quiet: opt.Quiet,
) -> int:
    """Estimate the unknowns of RIG from DATA with several methods, side by side, or compare nonlinear elements.

    DATA as for identify; with --modal FILE they may be left out.  A method that does not suit the data is named with
    the reason.

    Exit codes: 0 done; 2 bad usage, model or data; 3 a method did not converge; 5 not enough memory.
    """
    from dashpot.api import compare
    from dashpot.check.structure import require_scale, require_scale_seen
    from dashpot.data.readers.modes import modes_and_notes
    from dashpot.model.rigfile import read_rig
    from dashpot.present.comparison import comparison_document, comparison_report

    if elements:
        if not data:
            raise UsageError("--elements needs data", "--elements", "give DATA")
        if any(other is not None for other in (methods, modal_file, truth, figure, report.report)):
            cure = "leave out --methods, --modal, --truth, --figure and --report"
            raise UsageError("--elements works with ml only", "--elements", cure)
    named = [] if elements else _named(methods, bool(data), modal_file is not None)
    read = read_rig(rig)
    read.model.require_unknowns(rig)
    if elements:
        read.require_alike("--elements")
        return _elements(read, data, records, json_out)
    chosen = named or methods_for(read.model)
    true = None if truth is None else true_values(read, truth)
    modal, spectrum = None, None
    if modal_file is not None:
        read.require_alike("identification from measured modes")
        modal, notes = modes_and_notes(modal_file, read.model.coordinates, read.channels, modal_sd)
        tell_notes(notes, quiet)
    if data:
        require_scale(read.model, read.all_channels, read.path)
        spectrum = records.read(read, data, chosen)
    jobs, refused = {}, {}
    for name in chosen if spectrum is not None else ():
        try:
            require_scale_seen(method_class(name), read.model, read.channels)
            jobs[name] = method(name, seed=seed)
        except DashpotError as error:
            refused[name] = error
    with progress("compare", quiet) as moved:
        comparison = compare(
            read, spectrum, jobs, modal=modal, refused=refused, truth=true, seed=seed, progress=moved
        )
    if figure is not None:
        from dashpot.present.figures.comparison import comparison_figure
        from dashpot.present.figures.style import write_figure

        write_figure(figure, comparison_figure(comparison, level))
    if report:
        channels = read.channels if spectrum is None else spectrum.channels
        report.write(comparison_report(read.model, channels, comparison, level, report.provenance))
    opt.tell_result(json_out, comparison.to_json(), lambda: comparison_document(comparison, level), quiet)
    unsettled = [name for name, estimate in comparison.estimates.items() if not bool(estimate.converged)]
    if not unsettled:
        return 0
    tell(
        f"dashpot: {', '.join(unsettled)} did not converge; do not use these values: check signs and units of "
        "the channels; or the noise is too large"
    )
    return opt.NOT_CONVERGED


def _named(methods: str | None, data: bool, modal: bool) -> list[str]:
    """The names of --methods, each a method and named once; none where the option is not given."""
    if not data and not modal:
        raise UsageError("there are no data", cure="give DATA, --modal FILE, or both")
    if methods is None:
        return []
    if not data:
        raise UsageError("the methods need DATA", "--methods", "give DATA")
    chosen = [name.strip() for name in methods.split(",")]
    for name in chosen:
        method_class(name)
        if chosen.count(name) > 1:
            raise UsageError(f"{name} is named twice", "--methods", "name each method once")
    return chosen


def _elements(rig: Rig, data: Sequence[str], records: RecordOptions, json_out: str | None) -> int:
    """Nonlinear elements by evidence: from whole records by integration, else from the harmonics of dwells."""
    from dashpot.check.element_evidence import compare_in_dwells, compare_in_records
    from dashpot.present.comparison import elements_document

    reading = records.reading(rig, data)
    if reading.continuous:
        with progress("compare", records.quiet) as moved:
            evidence = compare_in_records(rig.model, reading.records, progress=moved)
    else:
        spectrum = records.spectrum(rig, reading, records.conditioning(rig, reading), ["hls"])
        evidence = compare_in_dwells(rig.model, spectrum)
    opt.tell_result(json_out, evidence.to_json(), lambda: elements_document(evidence), records.quiet)
    return 0
