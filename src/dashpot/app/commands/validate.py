"""dashpot validate: how well an estimate predicts records that it was not made of."""

from __future__ import annotations

from typing import Any

from dashpot.app.options import (
    INPUT_FILE,
    RECORDS,
    STDOUT,
    conditioning_options,
    dashpot_command,
    data_argument,
    figure_option,
    json_option,
    option,
    quiet_option,
    whole_record_options,
)
from dashpot.app.report_files import report_option


@dashpot_command(
    "validate",
    "dashpot validate estimate.json other_run.csv",
    "dashpot validate estimate.json run3.csv --rig rig.toml --figure prediction.svg",
)
@data_argument(
    "The estimate (JSON of identify), then data files as for identify.", name="files", required=True
)
@option(
    "--rig",
    type=INPUT_FILE,
    metavar="RIG.toml",
    group=RECORDS,
    help="The rig file of the estimate.  [default: the one that the estimate names]",
)
@json_option("the figures")
@figure_option(
    "Draw the first record, or the settled lines, measured and predicted.", "--figure", "--picture"
)
@report_option
@conditioning_options
@whole_record_options
@quiet_option
def command(
    files: tuple[str, ...], rig: str | None, json_out: str | None, figure: str | None, report: str | None, quiet: bool,
    **conditioning: Any,
) -> None:  # fmt: skip
    """Predict records from their inputs with an estimate made from other records: FIT and χ² of every channel.

    FILES are the estimate, as identify writes it with --json, and the records.
    """
    from dashpot.app.options import write_result
    from dashpot.app.validating import estimate_and_rig, figures_of, validated
    from dashpot.errors import UsageError

    if len(files) < 2:
        raise UsageError("there is no record to predict", cure="name data files after the estimate")
    estimate, rig_read = estimate_and_rig(files[0], rig)
    outcome = validated(rig_read, estimate, files[1:], conditioning, quiet)
    predictions = outcome.predictions
    if figure is not None:
        from dashpot.present.figures.style import write_figure
        from dashpot.present.figures.validation import drawn_of, prediction_figure

        write_figure(figure, prediction_figure(drawn_of(predictions)))
    if report is not None:
        from dashpot.app.report_files import provenance, write_report
        from dashpot.present.pages.others import validation_report

        page = validation_report(
            rig_read.model, rig_read.channels, estimate, predictions, outcome.findings, provenance()
        )
        write_report(report, page)
    write_result(json_out, figures_of(predictions, outcome.findings))
    if not quiet and json_out != STDOUT:
        from dashpot.present.tables.layout import console
        from dashpot.present.tables.validation import show_validation

        show_validation(console(), predictions, outcome.findings)
