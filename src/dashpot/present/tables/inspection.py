"""What is in data files, as tables with small pictures of their frequency content."""

from __future__ import annotations

import math

from rich.console import Console
from rich.text import Text

from dashpot.data.inspection import InspectedColumn, InspectedPart, Inspection
from dashpot.errors import printable
from dashpot.io.words import counted
from dashpot.present.tables.layout import TableColumn, show_table

BARS = " ▁▂▃▄▅▆▇█"
FLOOR_DB = -80.0
PICTURE = 20  # characters
MOST_BITS = 24  # numbers of more are no readings of a converter


def show_inspection(out: Console, inspection: Inspection) -> None:
    """Print one file: its format, and a table for each part."""
    out.print(Text(f"{inspection.source}: {inspection.format}"))
    for part in inspection.parts:
        out.print(Text(f"  {part_in_words(part, inspection.source)}"))
        show_table(out, part_table(part))
        if part.others:
            shown = ", ".join(part.others[:10]) + (" …" if len(part.others) > 10 else "")
            out.print(Text(f"  Not numbers, or not shown: {shown}"))
        for note in part.notes:
            out.print(Text(f"  Note: {note.text}"))
        for error in part.damaged[:5]:
            out.print(Text(f"  Damaged: {error}"))
    if inspection.more:
        out.print(Text(f"  … and {inspection.more} more parts"))


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
    if part.frequencies:
        several = (
            f"{len(part.frequencies)} drive frequencies, " if len(part.frequencies) > 1 else "driven at "
        )
        ends = f"{part.frequencies[0]:g}"
        ends += f" to {part.frequencies[-1]:g}" if len(part.frequencies) > 1 else ""
        words.append(f"{several}{ends} Hz")
    return (f"{name}: " if name else "") + ", ".join(words)


def part_table(part: InspectedPart) -> list[TableColumn]:
    """A row for each column."""
    content = "content" if part.rates_hz is None else f"0 to {part.rates_hz[1] / 2:.4g} Hz"
    columns = part.columns
    table = [
        TableColumn("column", tuple(printable(c.name) for c in columns)),
        TableColumn("unit", tuple(printable(c.unit or "") for c in columns)),
        TableColumn("rms", tuple(f"{c.rms:.3g}" for c in columns), "right"),
        TableColumn("least", tuple(f"{c.least:.3g}" for c in columns), "right"),
        TableColumn("greatest", tuple(f"{c.greatest:.3g}" for c in columns), "right"),
        TableColumn("bits", tuple(f"{c.bits:.0f}" if c.bits <= MOST_BITS else "" for c in columns), "right"),
        TableColumn(content, tuple(picture(c) for c in columns)),
    ]
    said = tuple(column_remarks(c) for c in columns)
    return [*table, TableColumn("remarks", said)] if any(said) else table


def picture(column: InspectedColumn) -> str:
    """Power over frequency as bars of eighths, 80 dB high."""
    levels = column.level_db.tolist()
    if not levels:
        return ""
    width = max(1, math.ceil(len(levels) / PICTURE))
    groups = [max(levels[i : i + width]) for i in range(0, len(levels), width)]
    return "".join(BARS[round(8 * max(0.0, 1 - level / FLOOR_DB))] for level in groups)


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
