"""What is in data files, as tables with small pictures of their frequency content."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dashpot.data.inspection import InspectedColumn, InspectedPart, Inspection

BARS = " ▁▂▃▄▅▆▇█"
FLOOR_DB = -80.0
PICTURE = 20  # characters
MOST_BITS = 24  # numbers of more are no readings of a converter


def show_inspection(out: Console, inspection: Inspection) -> None:
    """Print one file: its format, and a table for each part."""
    out.print(Text(f"{inspection.source}: {inspection.format}"))
    for part in inspection.parts:
        out.print(Text(f"  {part_in_words(part, inspection.source)}"))
        out.print(part_table(part))
        if part.others:
            shown = ", ".join(part.others[:10]) + (" …" if len(part.others) > 10 else "")
            out.print(Text(f"  Not numbers, or not shown: {shown}"))
    if inspection.more:
        out.print(Text(f"  … and {inspection.more} more parts"))


def part_in_words(part: InspectedPart, source: str) -> str:
    """Samples, rate, duration, gaps and drive frequencies of a part, in one line."""
    name = part.source.removeprefix(source).strip(" :()")
    words = [f"{part.samples} samples"]
    if part.rate_hz is None:
        words.append("no times")
    else:
        words.append(f"{part.rate_hz:.6g} Hz over {part.duration_s:.4g} s")
        words.append(
            "evenly spaced" if part.uneven < 1e-3 else f"steps differ by up to {100 * part.uneven:.2g} %"
        )
        if part.gaps:
            words.append(f"{part.gaps} gaps")
    if part.frequencies:
        several = (
            f"{len(part.frequencies)} drive frequencies, " if len(part.frequencies) > 1 else "driven at "
        )
        ends = f"{part.frequencies[0]:g}"
        ends += f" to {part.frequencies[-1]:g}" if len(part.frequencies) > 1 else ""
        words.append(f"{several}{ends} Hz")
    return (f"{name}: " if name else "") + ", ".join(words)


def part_table(part: InspectedPart) -> Table:
    """A row for each column."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("column")
    table.add_column("unit")
    for title in ("rms", "least", "greatest", "bits"):
        table.add_column(title, justify="right", no_wrap=True)
    nyquist = "content" if part.rate_hz is None else f"0 to {part.rate_hz / 2:.4g} Hz"
    table.add_column(nyquist, no_wrap=True, min_width=PICTURE)
    remarked = any(remarks(column) for column in part.columns)
    if remarked:
        table.add_column("")
    for column in part.columns:
        bits = f"{column.bits:.0f}" if column.bits <= MOST_BITS else ""
        numbers = (f"{x:.3g}" for x in (column.rms, column.least, column.greatest))
        row = [column.name, column.unit or "", *numbers, bits, picture(column)]
        table.add_row(*(Text(cell) for cell in [*row, remarks(column)][: len(table.columns)]))
    return table


def picture(column: InspectedColumn) -> str:
    """Power over frequency as bars of eighths, 80 dB high."""
    levels = column.level_db.tolist()
    if not levels:
        return ""
    width = max(1, math.ceil(len(levels) / PICTURE))
    groups = [max(levels[i : i + width]) for i in range(0, len(levels), width)]
    return "".join(BARS[round(8 * max(0.0, 1 - level / FLOOR_DB))] for level in groups)


def remarks(column: InspectedColumn) -> str:
    """What is wrong with a column, in few words."""
    words = []
    if column.missing:
        words.append(f"{column.missing} missing")
    if column.clipped:
        words.append(f"{column.clipped} at its limit: clipped?")
    if column.rms == 0:
        words.append("constant")
    return ", ".join(words)
