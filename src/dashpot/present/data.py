"""Data and rigs as documents: files with small pictures of their frequency content, records, spectra, rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dashpot.check.evidence import channel_summaries, span_of
from dashpot.data.inspection import InspectedColumn, InspectedPart, Inspection
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import printable
from dashpot.io.words import counted, joined, listed
from dashpot.model.rigfile import Rig
from dashpot.present.document import Block, Document, Paragraph, Table, columns_of, section
from dashpot.present.words import percent, plain, short
from dashpot.units import si_unit

BARS = " ▁▂▃▄▅▆▇█"
NOISE_FROM = {
    "white": "white residuals",
    "blocks": "frequencies next to each harmonic",
    "periods": "the scatter of the periods",
    "given": "what was given",
    "rest": "an at-rest record",
    "floor": "lines without motion",
    "smooth": "the scatter about smooth curves",
    "residual": "the residuals of the fit",
}


def inspection_document(inspection: Inspection) -> Document:
    """What is printed of one file: its format, and a table for each part."""
    blocks: list[Block] = [Paragraph(f"{inspection.source}: {inspection.format}")]
    for part in inspection.parts:
        # A row for each column of a file
        content = "content" if part.rates_hz is None else f"0 to {part.rates_hz[1] / 2:.4g} Hz"
        rows = [
            (
                printable(c.name),
                printable(c.unit or ""),
                *(f"{x:.3g}" for x in (c.rms, c.least, c.greatest)),
                # Numbers of more bits are no readings of a converter.
                f"{c.bits:.0f}" if c.bits <= 24 else "",
                picture(c),
                column_remarks(c),
            )
            for c in part.columns
        ]
        heads = ["column", "unit", "rms>", "least>", "greatest>", "bits>", content, "remarks"]
        table = columns_of(heads, rows)
        blocks += [
            Paragraph(f"  {part_in_words(part, inspection.source)}"),
            Table(table if any(table[-1].cells) else table[:-1]),
        ]
        said = [f"Note: {note.text}" for note in part.notes]
        said += [f"Damaged: {error}" for error in part.damaged[:5]]
        if part.others:
            shown = ", ".join(part.others[:10]) + (" …" if len(part.others) > 10 else "")
            said.insert(0, f"Not numbers, or not shown: {shown}")
        blocks += [Paragraph(f"  {text}") for text in said]
    if inspection.more:
        blocks.append(Paragraph(f"  … and {inspection.more} more parts"))
    return Document("", (section("", *blocks),))


def part_in_words(part: InspectedPart, source: str) -> str:
    """Samples, rate, duration, gaps and drive frequencies of a part, in one line."""
    name = part.source.removeprefix(source).strip(" :()")
    words = [counted(part.samples, "sample")]
    if part.rates_hz is None:
        words.append("no times")
    else:
        lowest, highest = (f"{rate:.6g}" for rate in part.rates_hz)
        words.append(
            f"{lowest if lowest == highest else f'{lowest} to {highest}'} Hz over {part.duration_s:.4g} s"
        )
        if part.stretches > 1:
            words.append(f"in {part.stretches} stretches")
        words.append(
            "evenly spaced" if part.uneven < 1e-3 else f"steps differ by up to {100 * part.uneven:.2g} %"
        )
        if part.longest_gap is not None:
            start, end = part.longest_gap
            which = "from" if part.gaps == 1 else "the longest from"
            words.append(f"{counted(part.gaps, 'gap')}, {which} {start:.6g} to {end:.6g} s")
    if part.complexes:
        inputs, outputs = ([c.name for c in part.complexes if c.of_input is into] for into in (True, False))
        words.append(f"responses of {listed(outputs)} to {listed(inputs)}" if inputs else "amplitudes")
    if part.frequencies:
        several = (
            f"{len(part.frequencies)} drive frequencies, " if len(part.frequencies) > 1 else "driven at "
        )
        ends = f"{part.frequencies[0]:g}"
        ends += f" to {part.frequencies[-1]:g}" if len(part.frequencies) > 1 else ""
        words.append(f"{several}{ends} Hz")
    return (f"{name}: " if name else "") + ", ".join(words)


def picture(column: InspectedColumn) -> str:
    """Power over frequency as bars of eighths, 80 dB high."""
    levels = column.level_db.tolist()
    if not levels:
        return ""
    width = max(1, math.ceil(len(levels) / 20))
    groups = [max(levels[i : i + width]) for i in range(0, len(levels), width)]
    return "".join(BARS[round(8 * max(0.0, 1 + level / 80))] for level in groups)  # eighths of 80 dB


def column_remarks(column: InspectedColumn) -> str:
    """What is wrong with a column, in few words."""
    words = []
    if column.missing:
        words.append(f"{column.missing} missing")
    if column.clipped:
        words.append(f"{column.clipped} at its limit: clipped?")
    if column.rms == 0:
        words.append("constant")
    return ", ".join(words)


# Spectra, records and rigs.


def spectrum_document(spectrum: Spectrum, units: Sequence[str], where: str = "") -> Document:
    """What a spectrum holds: lines, channels with their SI units, and how large their noise is."""
    f = spectrum.frequency_hz
    lines = "no frequencies"
    if spectrum.lines:
        lines = f"{spectrum.lines} frequencies from {short(float(min(f)))} to {short(float(max(f)))} Hz"
    # Range of the amplitudes of each channel, and how large the noise is
    summaries = channel_summaries(spectrum, units)
    rows = []
    for one in summaries:
        sizes = ["not measured", "", ""]
        if one.measured:
            relative = f"{percent(one.noise, one.typical)} %"
            sizes = [f"{short(one.low)} … {short(one.high)}", short(one.noise, 2), relative]
        rows.append((one.name, *sizes, one.unit))
    table = section("", columns_of(["channel", "amplitude>", "noise sd>", "relative>", "unit"], rows))
    # Where the noise of the amplitudes is known from
    kinds = [NOISE_FROM[kind] for kind in dict.fromkeys(spectrum.noise) if kind in NOISE_FROM]
    noise = section("", f"The noise is estimated from {joined(kinds)}." if kinds else "The noise is unknown.")
    return (
        Document("", (section("", f"{where}: {lines}"), table, noise))
        if where
        else Document(lines, (table, noise))
    )


def notebook_document(value: Rig | Record | Spectrum) -> Document:
    """A rig, a record or a spectrum, for a notebook; units of a spectrum are SI units of its channels' quantities."""
    if isinstance(value, Spectrum):
        return spectrum_document(value, [si_unit(channel.quantity.value) for channel in value.channels])
    if isinstance(value, Record):
        duration, rate = span_of(value)
        driven = "" if value.frequency_hz is None else f", driven at {short(value.frequency_hz)} Hz"
        title = f"{value.source}: {len(value.time)} samples, {short(duration)} s at {short(rate)} Hz{driven}"
        rows = ((channel.name, channel.quantity.value) for channel in value.channels)
        return Document(title, (section("", columns_of(["channel", "quantity"], rows)),))
    model = value.model
    # What an element joins: "x1, x2"; factors of levers stand before the points
    elements = []
    for e in (each for each in model.elements if not each.is_entry):
        joins = (point if abs(by) == 1 else f"{plain(by)} {point}" for point, by in e.along.items())
        known = "unknown" if e.value is None else plain(e.value)
        if e.value is not None and e.sd is not None:
            known += f" ± {plain(e.sd)}"
        elements.append((e.name, str(e.kind.value), ", ".join(joins), known, model.unit(e)))
    channels = ((channel.name, channel.quantity.value, channel.unit) for channel in value.channels)
    return Document(
        model.name or "Rig",
        (
            section("", columns_of(["element", "kind", "joins", "value>", "unit"], elements)),
            section("", columns_of(["channel", "quantity", "unit"], channels)),
        ),
    )
