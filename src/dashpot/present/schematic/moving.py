"""Modes on the drawing of a rig: bodies move sideways as the mode has them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

from dashpot.arrays import Complex
from dashpot.errors import UsageError
from dashpot.estimate.result import Estimate
from dashpot.io.atomic import write_bytes
from dashpot.io.name_endings import PICTURES, chosen_format
from dashpot.model.modes import modes
from dashpot.model.network import Model
from dashpot.present.schematic.connections import Connections, connections
from dashpot.present.schematic.drawing import MOST_BODIES
from dashpot.present.schematic.frame import titled
from dashpot.present.schematic.labels import labels
from dashpot.present.schematic.layout import Placer
from dashpot.present.schematic.placed import Layout
from dashpot.present.schematic.raster import raster
from dashpot.present.schematic.scene import Part, Shape, corners, scene_parts
from dashpot.present.schematic.svg import moving_document
from dashpot.present.schematic.tree import forest
from dashpot.present.text.estimate import aperiodic_in_words
from dashpot.present.text.numbers import short

REACH = 18.0  # px that the furthest body moves
FRAMES = 16
SECONDS = 2.0


@dataclass(frozen=True)
class ModeDrawing:
    """Frames of one period of a mode, the first at its largest, with the bodies at rest behind."""

    title: str
    frames: tuple[tuple[Part, ...], ...]
    width: float
    height: float

    def svg(self) -> str:
        """As SVG that moves by itself."""
        return moving_document(self.frames, self.width, self.height, self.title, SECONDS)

    def _repr_svg_(self) -> str:
        """The same, for a notebook."""
        return self.svg()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as .svg, which moves, or as .png or .pdf of its largest.  Raises UsageError, DataError."""
        kind = chosen_format(path, PICTURES)
        if kind == "svg":
            write_bytes(path, self.svg().encode())
        else:
            still = raster(
                self.frames[0], self.width, self.height, self.title, "png" if kind == "png" else "pdf"
            )
            write_bytes(path, still)


def numbered_mode(model: Model, estimate: Estimate | None, number: int) -> tuple[str, Complex]:
    """Title and shape (coordinates,) of a mode, 1 the slowest: of an estimate, or of the values that the rig states.

    Raises ModelError where the rig states no value, UsageError where there is no such mode.
    """
    if estimate is None:
        stated = modes(model, model.parameters(model.theta({})))
        eigenvalues, shapes = stated.eigenvalues, stated.shapes
        frequencies, ratios = stated.frequency_hz, stated.damping_ratio
    else:
        found = estimate.modes
        if found is None or found.shapes.shape[-1] != model.n:
            raise UsageError(
                "the estimate has no modes of this rig", cure="give the rig file that it was made with"
            )
        eigenvalues, shapes = found.eigenvalues, found.shapes
        frequencies, ratios = found.frequency_hz, found.damping_ratio
    if number > len(eigenvalues):
        raise UsageError(
            f"there is no mode {number}", cure=f"modes are numbered from 1 to {len(eigenvalues)}"
        )
    k = number - 1
    if eigenvalues[k].imag == 0:
        return f"Mode {number}: {aperiodic_in_words(float(eigenvalues[k].real))}", shapes[k]
    title = f"Mode {number}: {short(float(frequencies[k]), 4)} Hz, damping ratio {short(float(ratios[k]), 3)}"
    return title, shapes[k]


def mode_drawing(model: Model, shape: Complex, title: str) -> ModeDrawing:
    """A mode of shape (coordinates,) on the drawing of the rig; angles and displacements each to their own scale.

    Raises UsageError where there are too many bodies for a drawing.
    """
    connected = connections(model)
    if len(connected.bodies) > MOST_BODIES:
        raise UsageError(f"{len(connected.bodies)} bodies are too many for a drawing (at most {MOST_BODIES})")
    said = labels(model, (), None, (), numbers=False)
    layout = Placer(model, (), forest(model, connected), (), said).layout()
    motion = _motion(model, connected, shape)
    frames = []
    for k in range(FRAMES):
        turn = complex(math.cos(2 * math.pi * k / FRAMES), math.sin(2 * math.pi * k / FRAMES))
        shifts = {body: (z * turn).real for body, z in motion.items()}
        drawn = [_at_rest(layout), *(_plain(part) for part in scene_parts(layout, model, said, shifts))]
        frames.append(tuple(titled(drawn, title, layout.width)[0]))
    _, width, head = titled([], title, layout.width)
    return ModeDrawing(title, tuple(frames), width, head + layout.height)


def _motion(model: Model, found: Connections, shape: Complex) -> Mapping[int, complex]:
    """Body → amplitude in px, complex."""
    at = dict(zip(model.coordinates, (complex(z) for z in shape.tolist()), strict=True))
    largest = {
        angular: max((abs(z) for name, z in at.items() if (name in model.angles) is angular), default=0.0)
        for angular in (True, False)
    }
    motion: dict[int, complex] = {}
    for index, body in enumerate(found.bodies):
        moving = [point for point in body.points if point in at]
        point = next((point for point in moving if point not in model.angles), moving[0] if moving else None)
        if point is not None:
            size = largest[point in model.angles]
            motion[index] = REACH * at[point] / size if size > 0 else 0j
    for index, body in enumerate(found.bodies):
        if body.along:
            motion[index] = sum((factor * motion.get(other, 0j) for other, factor in body.along), 0j)
    return motion


def _at_rest(layout: Layout) -> Part:
    """Outlines of the bodies where they rest."""
    return Part(
        "at rest",
        tuple(
            Shape(corners(body.box), "muted", 0.8, True, dashed=True)
            for body in layout.bodies
            if not body.wall
        ),
    )


def _plain(part: Part) -> Part:
    """Without the marks of what is known: a mode is of values alone."""
    shapes = tuple(
        replace(shape, tone="ink", weight=min(shape.weight, 1.6))
        if shape.tone in ("unknown", "known")
        else shape
        for shape in part.shapes
    )
    return replace(part, shapes=shapes)
