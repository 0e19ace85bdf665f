"""The drawing of a rig, with the values of an estimate and its modes."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

from dashpot.channel import Channel
from dashpot.errors import UsageError
from dashpot.estimate.result import Estimate
from dashpot.io.atomic import write_bytes
from dashpot.io.name_endings import PICTURES, chosen_format
from dashpot.model.network import Model
from dashpot.present.schematic.connections import Connections, connections
from dashpot.present.schematic.folded import folded
from dashpot.present.schematic.frame import framed
from dashpot.present.schematic.labels import Labels, labels
from dashpot.present.schematic.layout import Placer
from dashpot.present.schematic.placed import Layout
from dashpot.present.schematic.raster import raster
from dashpot.present.schematic.scene import Part, scene_parts
from dashpot.present.schematic.svg import svg_document
from dashpot.present.schematic.tree import forest
from dashpot.present.text.estimate import sentence

MOST_ELEMENTS, MOST_BODIES = 60, 40


@dataclass(frozen=True)
class Drawing:
    """A drawing of a rig: plain geometry, and what is drawn of it: in rows, with title and legend."""

    title: str
    model: Model
    labels: Labels
    connections: Connections
    layout: Layout
    parts: tuple[Part, ...]
    width: float
    height: float

    def svg(self) -> str:
        """As SVG, whose texts can be searched."""
        return svg_document(self.parts, self.width, self.height, self.title, drawing_description(self))

    def _repr_svg_(self) -> str:
        """The same, for a notebook."""
        return self.svg()

    def raster(self, kind: Literal["png", "pdf"]) -> bytes:
        """As PNG or PDF."""
        return raster(self.parts, self.width, self.height, self.title, kind)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it; the end of the name says how: .svg, .png or .pdf.  Raises UsageError, DataError."""
        kind = chosen_format(path, PICTURES)
        content = self.svg().encode() if kind == "svg" else self.raster("png" if kind == "png" else "pdf")
        write_bytes(path, content)


def schematic(
    model: Model,
    channels: Sequence[Channel] = (),
    estimate: Estimate | None = None,
    doubtful: Collection[str] = (),
    level: float = 0.95,
) -> Drawing:
    """The rig in the field's symbols; with values and intervals of an estimate where there is one.

    `doubtful` names parameters that are marked as such.  Of more than MOST_ELEMENTS elements only the kinds and names
    are drawn.  Raises UsageError where there are too many bodies for a drawing.
    """
    parts = connections(model, channels)
    if len(parts.bodies) > MOST_BODIES:
        raise UsageError(
            f"{len(parts.bodies)} bodies are too many for a drawing (at most {MOST_BODIES})",
            cure="draw a part of the rig",
        )
    small = len(model.elements) <= MOST_ELEMENTS
    between = [link.item for link in parts.links if link.kind == "sensor"]
    said = labels(model, channels if small else (), estimate, doubtful, between, level, numbers=small)
    layout = Placer(model, channels, forest(model, parts), parts.pushes, said).layout()
    note = "" if small else f"{len(model.elements)} elements: values are left out."
    if parts.free:
        note = sentence("Entries of matrices are not elements and are not drawn")
    rows, *size = folded(scene_parts(layout, model, said), layout.width, layout.height)
    drawn, width, height = framed(rows, (size[0], size[1]), model, said, estimate is not None, level, note)
    return Drawing(model.name or "Rig", model, said, parts, layout, tuple(drawn), width, height)


def drawing_description(drawing: Drawing) -> str:
    """The drawing in words: every element with what it joins and its value."""
    model, said = drawing.model, drawing.labels
    texts = []
    for element in model.elements:
        if element.free or element.block is not None:
            continue
        points = [*element.along, *(["ground"] if len(element.along) == 1 and element.kind != "mass" else [])]
        known, value, interval = said.values[element.name]
        of = f"{element.name}, {element.kind} of {' and '.join(points)}: {known}"
        texts.append(of + (f", {value}" if value != "?" else "") + (f" ({interval})" if interval else ""))
    return "; ".join(texts)
