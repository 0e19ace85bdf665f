"""dashpot check: what of a rig can be found, before data and with them."""

from __future__ import annotations

from typing import Annotated

from dashpot.app import options as opt
from dashpot.app.data_files import RecordOptions
from dashpot.app.report_files import ReportFile
from dashpot.app.workers import progress
from dashpot.errors import UsageError
from dashpot.io.json_document import to_json

WITH_DATA = "With DATA"


@opt.dashpot_command("dashpot check rig.toml", "dashpot check rig.toml data.csv --known --profile c1")
def command(
    rig: opt.RigFile,
    data: Annotated[tuple[str, ...], opt.FILES, opt.DATA],
    profiled: Annotated[
        tuple[str, ...],
        opt.Option("--profile NAME,…", None, WITH_DATA, multiple=True),
        "Profile-likelihood interval of an unknown, in addition to the normal one.  May be repeated.",
    ],
    known: Annotated[
        bool,
        opt.Option("--known", None, WITH_DATA),
        "How far an error of each known parameter changes each estimate.",
    ],
    json_out: Annotated[str | None, opt.JSON, "the findings"],
    report: ReportFile,
    level: opt.Level,
    records: RecordOptions,
    seed: Annotated[int, opt.SEED, "the random numbers"],
    quiet: opt.Quiet,
) -> int:
    """Check whether the unknowns of RIG can be found from its channels and, with DATA, which ones only poorly.

    Exit codes: 0 all can be found; 2 bad usage, model or data; 3 some cannot: each line says which combinations can be
    found and what would help; 5 not enough memory.
    """
    from dashpot.api import check, identify
    from dashpot.check.deficiencies import require_full_rank, structure_content
    from dashpot.check.evidence import data_findings, findings_content
    from dashpot.model.rigfile import read_rig

    if (profiled or known) and not data:
        raise UsageError("--profile and --known need data", cure="name the data files after the rig file")
    read = read_rig(rig)
    model = read.model
    model.require_unknowns(rig)
    spectrum = records.read(read, data) if data else None
    channels = read.all_channels if spectrum is None else spectrum.channels
    with progress("check", quiet):
        verdict = check(read, spectrum, seed=seed)
    content = structure_content(model, channels, verdict)
    found = None
    if verdict.identifiable and spectrum is not None:
        wanted = list(opt.names(*profiled))
        with progress("check", quiet):
            estimate = identify(read, spectrum, seed=seed, judge=False)
            judged_by = spectrum if estimate.origin is None else estimate.origin.spectrum or spectrum
            found = data_findings(model, judged_by, estimate, wanted, level, known)
        content |= findings_content(found, spectrum)
    opt.write_result(json_out, to_json(content))
    with report.of_failure(read):
        require_full_rank(verdict, model, channels, rig)
    if report:
        from dashpot.present.check import check_report

        report.write(check_report(model, channels, verdict, spectrum, found, level, report.provenance))
    if not quiet and json_out != opt.STDOUT:
        from dashpot.present.check import check_document
        from dashpot.present.document import say

        say(check_document(verdict, [channel.name for channel in channels], spectrum, found))
    return 0
