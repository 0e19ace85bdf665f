"""dashpot check: what of a rig can be found, before data and with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dashpot.app.options import (
    DATA_HELP,
    STDOUT,
    conditioning_options,
    dashpot_command,
    data_argument,
    json_option,
    level_option,
    names,
    option,
    quiet_option,
    rig_argument,
    seed_option,
    whole_record_options,
)
from dashpot.app.report_files import failure_reported, report_option

if TYPE_CHECKING:
    from dashpot.check.data_findings import DataFindings
    from dashpot.check.identifiability import Structure
    from dashpot.data.spectrum import Spectrum
    from dashpot.model.rigfile import Rig

WITH_DATA = "With DATA"


@dashpot_command(
    "check",
    "dashpot check rig.toml",
    "dashpot check rig.toml data.csv --known --profile c1",
)
@rig_argument
@data_argument(DATA_HELP)
@option(
    "--profile", "profiled", multiple=True, metavar="NAME,…", group=WITH_DATA,
    help="Interval of an unknown from the profile likelihood, beside the normal one.  May be repeated.",
)  # fmt: skip
@option(
    "--known", is_flag=True, group=WITH_DATA,
    help="How much an error of each known parameter moves each estimate.",
)  # fmt: skip
@json_option("the findings")
@report_option
@level_option
@conditioning_options
@whole_record_options
@seed_option("the random numbers")
@quiet_option
def command(
    rig: str, data: tuple[str, ...], profiled: tuple[str, ...], known: bool, json_out: str | None, report: str | None,
    level: float, seed: int, quiet: bool, **conditioning: Any,
) -> int:  # fmt: skip
    """Check whether the unknowns of RIG can be found from its channels and, with DATA, which ones only poorly.

    Exit codes: 0 all can be found; 2 bad usage, model or data; 3 some cannot: each line says which combinations can be
    found and what would help; 5 not enough memory.
    """
    from dashpot.app.data_files import read_spectrum
    from dashpot.app.options import write_result
    from dashpot.app.progress import progress
    from dashpot.check.data_findings import findings_content
    from dashpot.check.deficiencies import require_full_rank, structure_content
    from dashpot.check.identifiability import structure
    from dashpot.check.nonlinear_structure import nonlinear_structure
    from dashpot.errors import UsageError
    from dashpot.io.json_document import to_json
    from dashpot.model.rigfile import read_rig

    if (profiled or known) and not data:
        raise UsageError("--profile and --known need data", cure="name the data files after the rig file")
    rig_read = read_rig(rig)
    rig_read.model.require_unknowns(rig)
    spectrum = read_spectrum(rig_read, data, conditioning, quiet) if data else None
    channels = rig_read.channels if spectrum is None else spectrum.channels
    with progress("check", quiet):
        if len(rig_read.model.nonlinear):
            verdict = nonlinear_structure(rig_read.model, channels, spectrum)
        else:
            verdict = structure(rig_read.model, channels, spectrum, seed)
    content = structure_content(rig_read.model, channels, verdict)
    examined = None
    if verdict.identifiable and spectrum is not None:
        wanted = [name for text in profiled for name in names(text)]
        with progress("check", quiet):
            examined = _with_data(rig_read, spectrum, wanted, known, level, seed)
        content |= findings_content(examined, spectrum)
    write_result(json_out, to_json(content))
    with failure_reported(report, rig):
        require_full_rank(verdict, rig_read.model, channels, rig)
    if report is not None:
        from dashpot.app.report_files import provenance, write_report
        from dashpot.present.pages.others import check_report

        page = check_report(rig_read.model, channels, verdict, spectrum, examined, level, provenance())
        write_report(report, page)
    if not quiet and json_out != STDOUT:
        _show(verdict, [channel.name for channel in channels], spectrum, examined)
    return 0


def _show(
    verdict: Structure, channels: Sequence[str], spectrum: Spectrum | None, found: DataFindings | None
) -> None:
    from dashpot.present.tables.check import show_known, show_paragraphs
    from dashpot.present.tables.layout import console
    from dashpot.present.text.check import collinearity_in_words, profile_in_words, structure_in_words

    out = console()
    show_paragraphs(out, structure_in_words(verdict, channels, None if spectrum is None else spectrum.lines))
    if found is None or spectrum is None:
        return
    units = dict(zip(found.estimate.names, found.estimate.units, strict=True))
    out.print()
    show_paragraphs(out, collinearity_in_words(found.collinearity, spectrum, units))
    if found.profiles:
        out.print()
        show_paragraphs(out, [profile_in_words(one) for one in found.profiles])
    if found.known_errors is not None:
        out.print()
        show_known(out, found.known_errors)


def _with_data(
    rig: Rig, spectrum: Spectrum, profiled: Sequence[str], known: bool, level: float, seed: int
) -> DataFindings:
    """What the data say."""
    from dashpot.check.data_findings import data_findings
    from dashpot.estimate.automatic import identify_with_noise

    estimate, spectrum = identify_with_noise(rig.model, spectrum, seed=seed)
    return data_findings(rig.model, spectrum, estimate, profiled, level, known)
