"""dashpot validate: how well an estimate predicts records that it was not made of."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated

from dashpot.app import options as opt
from dashpot.app.data_files import RecordOptions, estimate_and_rig
from dashpot.app.report_files import ReportFile
from dashpot.app.workers import progress
from dashpot.errors import UsageError
from dashpot.io.json_document import to_json
from dashpot.io.words import PICTURES

if TYPE_CHECKING:
    from dashpot.check.validation import RecordPrediction
    from dashpot.data.readers import Reading
    from dashpot.estimate.assessment import Finding
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig


@opt.dashpot_command(
    "dashpot validate estimate.json other_run.csv",
    "dashpot validate estimate.json run3.csv --rig rig.toml --figure prediction.svg",
)
def command(
    files: Annotated[
        tuple[str, ...], opt.NEEDED_FILES, "The estimate (JSON of identify), then data files as for identify."
    ],
    rig: Annotated[
        str | None,
        opt.Option("--rig RIG.toml", opt.INPUT_FILE, opt.RECORDS),
        "The rig file of the estimate.  [default: the one that the estimate names]",
    ],
    json_out: Annotated[str | None, opt.JSON, "the figures"],
    figure: Annotated[
        str | None,
        opt.Option("--figure --picture FILE.svg|png|pdf", opt.OutputFile(formats=PICTURES), opt.OUTPUT),
        "Draw the first record, or the settled lines, measured and predicted.",
    ],
    report: ReportFile,
    records: RecordOptions,
    quiet: opt.Quiet,
) -> None:
    """Predict records from their inputs with an estimate made from other records: FIT and χ² of every channel.

    FILES are the estimate, as identify writes it with --json, and the records.
    """
    from dashpot.present.validation import validation_document, validation_report

    if len(files) < 2:
        raise UsageError("there is no record to predict", cure="name data files after the estimate")
    estimate, read = estimate_and_rig(files[0], rig)
    predictions, findings = predictions_and_causes(read, estimate, records.reading(read, files[1:]), records)
    if figure is not None:
        from dashpot.present.figures.spectra import drawn_of, prediction_figure
        from dashpot.present.figures.style import write_figure

        write_figure(figure, prediction_figure(drawn_of(predictions)))
    if report:
        report.write(
            validation_report(read.model, read.channels, estimate, predictions, findings, report.provenance)
        )
    # FIT, rms error (of records, SI units), χ² and degrees of freedom of every channel, and causes
    rows = [
        {
            "duration_s": part.duration_s,
            "samples": part.samples,
            "channels": {
                name: {
                    "fit_percent": 100 * part.fit[c],
                    "rms_error": rms_error,
                    "chi2": part.chi2[c],
                    "dof": int(part.dof[c]),
                }
                for c, (name, rms_error) in enumerate(zip(part.channels, part.rms_error, strict=True))
            },
        }
        for part in predictions
    ]
    content = {"records": rows, "diagnosis": [finding.content() for finding in findings]}
    told = partial(validation_document, predictions, findings)
    opt.tell_result(json_out, to_json(content), told, quiet, apart=True)


def predictions_of(
    rig: Rig, estimate: Estimate, reading: Reading, options: RecordOptions
) -> tuple[RecordPrediction, ...]:
    """What an estimate predicts of data; raises DataError."""
    return predictions_and_causes(rig, estimate, reading, options, diagnosed=False)[0]


def predictions_and_causes(
    rig: Rig, estimate: Estimate, reading: Reading, options: RecordOptions, *, diagnosed: bool = True
) -> tuple[tuple[RecordPrediction, ...], tuple[Finding, ...]]:
    """The predictions of data, and what may be wrong with them where they are bad; raises DataError."""
    from dashpot.check.explain.prediction import mistakes_in_lines, mistakes_in_records
    from dashpot.check.validation import missed, validate, validate_records

    if len(rig.model.nonlinear) and reading.continuous:
        still = options.conditioning(rig).still
        with progress("validate", options.quiet):
            predictions = validate_records(rig.model, estimate, reading.records, still)
            wrong = diagnosed and missed(predictions)
            return predictions, mistakes_in_records(rig.model, estimate, reading.records) if wrong else ()
    spectrum = options.spectrum(rig, reading, options.conditioning(rig, reading))
    with progress("validate", options.quiet):
        predictions = validate(rig.model, estimate, spectrum)
        wrong = diagnosed and missed(predictions)
        return predictions, mistakes_in_lines(rig.model, estimate, spectrum) if wrong else ()
