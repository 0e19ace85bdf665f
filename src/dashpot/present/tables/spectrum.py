"""A spectrum, a record and a rig as text and as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Console

from dashpot.check.data_findings import ChannelSummary, channel_summaries, span_of
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.io.words import joined
from dashpot.model.rigfile import Rig
from dashpot.present.tables.layout import TableColumn, html_paragraph, html_table, show_paragraph, show_table
from dashpot.present.text.numbers import percent, plain, short
from dashpot.units import si_unit

NOISE_FROM = {
    "white": "white residuals",
    "blocks": "frequencies beside each harmonic",
    "periods": "the scatter of the periods",
    "given": "what was given",
    "rest": "a record at rest",
    "floor": "where nothing moves",
    "smooth": "the scatter about smooth curves",
    "residual": "what the fit leaves over",
}


def spectrum_columns(summaries: Sequence[ChannelSummary]) -> list[TableColumn]:
    """Range of the amplitudes of each channel, and how large the noise is."""
    rows = [_range(summary) for summary in summaries]
    amplitude, noise, relative = zip(*rows, strict=True)
    return [
        TableColumn("channel", tuple(summary.name for summary in summaries)),
        TableColumn("amplitude", amplitude, "right"),
        TableColumn("noise sd", noise, "right"),
        TableColumn("relative", relative, "right"),
        TableColumn("unit", tuple(summary.unit for summary in summaries)),
    ]


def _range(summary: ChannelSummary) -> tuple[str, str, str]:
    if not summary.measured:
        return ("not measured", "", "")
    return (
        f"{short(summary.low)} … {short(summary.high)}",
        short(summary.noise, 2),
        f"{percent(summary.noise, summary.typical)} %",
    )


def show_spectrum(out: Console, spectrum: Spectrum, units: Sequence[str], where: str) -> None:
    """Print what a spectrum holds: lines, channels with their SI units, and how large their noise is."""
    show_paragraph(out, f"{where}: {_lines(spectrum)}")
    out.print()
    show_table(out, spectrum_columns(channel_summaries(spectrum, units)))
    out.print()
    show_paragraph(out, noise_in_words(spectrum))


def noise_in_words(spectrum: Spectrum) -> str:
    """Where the noise of the amplitudes is known from."""
    kinds = [NOISE_FROM[kind] for kind in dict.fromkeys(spectrum.noise) if kind in NOISE_FROM]
    return f"The noise is estimated from {joined(kinds)}." if kinds else "The noise is unknown."


def _lines(spectrum: Spectrum) -> str:
    f = spectrum.frequency_hz
    if not spectrum.lines:
        return "no frequencies"
    return f"{spectrum.lines} frequencies from {short(float(min(f)))} to {short(float(max(f)))} Hz"


def spectrum_html(spectrum: Spectrum) -> str:
    """A spectrum for a notebook; units are those of displacements unless the channel says otherwise."""
    units = [si_unit(channel.quantity.value) for channel in spectrum.channels]
    table = html_table(spectrum_columns(channel_summaries(spectrum, units)), _lines(spectrum))
    return table + html_paragraph(noise_in_words(spectrum))


def record_html(record: Record) -> str:
    """A record for a notebook."""
    duration, rate = span_of(record)
    columns = [
        TableColumn("channel", tuple(channel.name for channel in record.channels)),
        TableColumn("quantity", tuple(channel.quantity.value for channel in record.channels)),
    ]
    driven = "" if record.frequency_hz is None else f", driven at {short(record.frequency_hz)} Hz"
    caption = f"{record.source}: {len(record.time)} samples, {short(duration)} s at {short(rate)} Hz{driven}"
    return html_table(columns, caption)


def rig_html(rig: Rig) -> str:
    """A rig for a notebook: its elements with what is known of them, and its channels."""
    model = rig.model
    parts = [element for element in model.elements if not element.is_entry]
    elements = [
        TableColumn("element", tuple(element.name for element in parts)),
        TableColumn("kind", tuple(str(element.kind.value) for element in parts)),
        TableColumn("joins", tuple(_points(element.along) for element in parts)),
        TableColumn("value", tuple(_known(element.value, element.sd) for element in parts), "right"),
        TableColumn("unit", tuple(model.unit(element) for element in parts)),
    ]
    channels = [
        TableColumn("channel", tuple(channel.name for channel in rig.channels)),
        TableColumn("quantity", tuple(channel.quantity.value for channel in rig.channels)),
        TableColumn("unit", tuple(channel.unit for channel in rig.channels)),
    ]
    return html_table(elements, model.name or "Rig") + html_table(channels)


def _points(along: Mapping[str, float]) -> str:
    """What an element joins: "x1, x2"; factors of levers stand before the points."""
    return ", ".join(
        point if abs(factor) == 1 else f"{plain(factor)} {point}" for point, factor in along.items()
    )


def _known(value: float | None, sd: float | None) -> str:
    if value is None:
        return "unknown"
    return plain(value) if sd is None else f"{plain(value)} ± {plain(sd)}"
