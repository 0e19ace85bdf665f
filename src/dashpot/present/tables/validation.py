"""Predictions of records that an estimate was not made of, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console

from dashpot.check.validation import RecordPrediction
from dashpot.estimate.assessment import Finding
from dashpot.present.tables.layout import TableColumn, show_paragraph, show_table
from dashpot.present.text.numbers import short
from dashpot.present.text.validation import EXPLANATION, mistakes_in_words, prediction_in_words


def show_validation(
    out: Console, predictions: Sequence[RecordPrediction], findings: tuple[Finding, ...] = ()
) -> None:
    """Print a row for each channel of each record, whether they are predicted, what may be wrong, and what FIT is."""
    out.print()
    show_table(out, validation_columns(predictions))
    out.print()
    show_paragraph(out, prediction_in_words(predictions, findings))
    for line in mistakes_in_words(findings):
        show_paragraph(out, line)
    show_paragraph(out, EXPLANATION)


def validation_columns(predictions: Sequence[RecordPrediction]) -> list[TableColumn]:
    """A row for each channel of each record: FIT, rms error and χ² over its degrees of freedom."""
    rows: list[tuple[str, ...]] = []
    for number, part in enumerate(predictions, start=1):
        errors = part.rms_error
        for c, channel in enumerate(part.channels):
            name = f"{number} ({part.duration_s:.4g} s)" if part.samples else "settled lines"
            ratio = float(part.chi2[c]) / max(float(part.dof[c]), 1.0)
            test = short(ratio) if np.isfinite(ratio) else "–"
            fit = f"{100 * part.fit[c]:.2f}" if np.isfinite(part.fit[c]) else "–"
            error = f"{errors[c]:.3g} {part.units[c]}" if part.samples else "–"
            rows.append((name, channel, str(len(part.frequency_hz)), fit, error, test))
    names, channels, lines, fits, rms_errors, tests = (tuple(cells) for cells in zip(*rows, strict=True))
    of_records = (
        [TableColumn("rms error", rms_errors, "right")] if any(p.samples for p in predictions) else []
    )
    return [
        TableColumn("record", names),
        TableColumn("channel", channels),
        TableColumn("lines", lines, "right"),
        TableColumn("FIT, %", fits, "right"),
        *of_records,
        TableColumn("χ² / dof", tests, "right"),
    ]
