"""Title and legend around a drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dashpot.model.network import Model
from dashpot.present.schematic.geometry import SMALL, TITLE, Anchor, Line, Text, Tone, block_width
from dashpot.present.schematic.labels import BADGES, Knowledge, Labels
from dashpot.present.schematic.placed import MARGIN
from dashpot.present.schematic.scene import Part, Shape

SAMPLE = 26.0  # length of a sample of a line in the legend
LEAST_WIDTH = 320.0
HEAD = 30.0
WORDS = {
    "unknown": "to be found",
    "estimated": "found, with {level:g} % interval",
    "known": "known",
    "doubtful": "(?) doubtful",
}


def framed(
    drawn: Sequence[Part],
    size: tuple[float, float],
    model: Model,
    labels: Labels,
    estimated: bool,
    level: float,
    note: str = "",
) -> tuple[list[Part], float, float]:
    """The parts of a drawing of that width and height with a title above and a legend below; width and height of it."""
    heading, width, head = titled(drawn, model.name, size[0])
    legend, height = _legend(labels, estimated, level, note, width, head + size[1])
    return [*heading, legend], width, height


def titled(drawn: Sequence[Part], title: str, width: float) -> tuple[list[Part], float, float]:
    """The parts of a drawing of that width below a title; width of it all, and how far they are moved down."""
    line = Line(title, "ink", TITLE, True)
    lines = _wrapped(line, max(width, LEAST_WIDTH) - 2 * MARGIN) if title else []
    head = HEAD + (len(lines) - 1) * 1.3 * TITLE if lines else 0.0
    wide = max([width, LEAST_WIDTH, *(line.width + 2 * MARGIN for line in lines)])
    texts = [Text(line, Anchor(MARGIN, MARGIN + TITLE * (0.9 + 1.3 * k))) for k, line in enumerate(lines)]
    parts = [Part("", (), tuple(texts))] if texts else []
    return [*parts, *(part.shifted((wide - width) / 2, head) for part in drawn)], wide, head


def _wrapped(line: Line, width: float) -> list[Line]:
    words, lines = line.text.split(), [""]
    for word in words:
        longer = f"{lines[-1]} {word}".strip()
        if replace(line, text=longer).width > width and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    return [replace(line, text=text) for text in lines]


def _legend(
    labels: Labels, estimated: bool, level: float, note: str, width: float, top: float
) -> tuple[Part, float]:
    """What lines and letters mean, as far as they occur, in as many rows as the width needs."""
    shapes: list[Shape] = []
    texts: list[Text] = []
    x, y = MARGIN, top + 12.0
    for sample, line in _entries(labels, estimated, level, note):
        need = (SAMPLE + 6 if sample else 0.0) + block_width([line])
        if x > MARGIN and x + need > width - MARGIN:
            x, y = MARGIN, y + 17.0
        if sample is not None:
            weight = 1.2 if sample == "known" else 2.0
            shapes.append(
                Shape(((x, y - 3.5), (x + SAMPLE, y - 3.5)), sample, weight, dashed=sample == "doubtful")
            )
            texts.append(Text(line, Anchor(x + SAMPLE + 6, y)))
        else:
            texts.append(Text(line, Anchor(x, y)))
        x += need + 18.0
    return Part("legend", tuple(shapes), tuple(texts)), y + MARGIN


def _entries(labels: Labels, estimated: bool, level: float, note: str) -> list[tuple[Tone | None, Line]]:
    present = {known for known, _, _ in labels.values.values()}
    entries: list[tuple[Tone | None, Line]] = []
    knowledge: Knowledge
    for knowledge in ("unknown", "known", "doubtful"):
        if knowledge in present:
            words = WORDS["estimated" if estimated and knowledge == "unknown" else knowledge]
            entries.append((knowledge, Line(words.format(level=100 * level), "muted", SMALL)))
    for quantity, badge in BADGES.items():
        if any(channel.quantity is quantity for channel in labels.channels):
            entries.append((None, Line(f"{quantity} sensor", "muted", SMALL, badge=badge)))
    if note:
        entries.append((None, Line(note, "muted", SMALL)))
    return entries
