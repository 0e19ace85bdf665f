"""Dataset 55: data at nodes, of which modes are read: normal modes and complex eigenvalues."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.data.modal_data import ModalData, independent_modes
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.uff.function import (
    DIRECTIONS,
    MARK,
    DatasetStart,
    UffStream,
    dataset_starts,
    skip_dataset,
)
from dashpot.errors import DataError
from dashpot.io.words import listed, shown
from dashpot.notices import Notice

NORMAL, FIRST_ORDER, SECOND_ORDER = 2, 3, 7  # analysis types
REAL, COMPLEX = 2, 5  # data types


@dataclass(frozen=True)
class NodalMode:
    """One mode: eigenvalue in rad/s, nodes, and shapes (nodes, 3) or (nodes, 6): X, Y, Z (and rotations)."""

    eigenvalue: complex
    nodes: tuple[int, ...]
    shapes: Complex
    ids: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def frequency_hz(self) -> float:
        """Undamped natural frequency."""
        return abs(self.eigenvalue) / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """Share of critical damping."""
        return -self.eigenvalue.real / abs(self.eigenvalue) if self.eigenvalue else 0.0


def modes_of(file: DataFile) -> Iterator[NodalMode]:
    """All modes of a universal file; other datasets are passed over.

    Raises DataError, with the line, for what is damaged or cut off.
    """
    with file.reading() as raw:
        stream = UffStream(raw, file)
        for start in dataset_starts(stream):
            mode = _mode(stream, start) if start.number == 55 else None
            if start.number != 55:
                skip_dataset(stream)
            if mode is not None:
                yield mode


def _mode(stream: UffStream, start: DatasetStart) -> NodalMode | None:
    """A mode; None where the dataset holds something else."""
    ids = tuple(stream.line().decode("utf-8", errors="replace").strip() for _ in range(5))
    try:
        _, analysis, _, _, data_type, per_node = (int(field) for field in _fields(stream.line(), 10)[:6])
    except ValueError:
        raise stream.wrong("the header of data at nodes is damaged") from None
    if analysis not in (NORMAL, FIRST_ORDER, SECOND_ORDER) or data_type not in (REAL, COMPLEX):
        skip_dataset(stream)
        return None
    stream.line()
    eigenvalue = _eigenvalue(stream, analysis)
    nodes, table = _at_nodes(stream, per_node * (2 if data_type == COMPLEX else 1))
    shape = table[:, 0::2] + 1j * table[:, 1::2] if data_type == COMPLEX else table.astype(complex)
    return NodalMode(eigenvalue, nodes, shape, tuple("" if i == "NONE" else i for i in ids))


def _eigenvalue(stream: UffStream, analysis: int) -> complex:
    """The eigenvalue in rad/s; of a normal mode from its frequency in Hz and its damping ratio."""
    values = _numbers(stream, stream.line())
    if len(values) < 2:
        raise stream.wrong("the eigenvalue is missing")
    if analysis != NORMAL:
        return complex(values[0], values[1])
    damping = values[2] if len(values) > 2 else 0.0
    omega = 2 * np.pi * values[0]
    return complex(-damping * omega, omega * np.sqrt(max(0.0, 1 - damping**2)))


def _at_nodes(stream: UffStream, size: int) -> tuple[tuple[int, ...], Real]:
    """Nodes and the numbers at each, (nodes, size), to the end of the dataset."""
    nodes, rows = [], []
    while (line := stream.line()).strip() != MARK:
        try:
            nodes.append(int(line[:10]))
        except ValueError:
            raise stream.wrong("the number of a node should stand here") from None
        numbers: list[float] = []
        while len(numbers) < size:
            more = _numbers(stream, stream.line())
            if not more:
                raise stream.wrong(f"{size} numbers should stand here")
            numbers += more
        if len(numbers) != size:
            raise stream.wrong(f"{size} numbers should stand here, not {len(numbers)}")
        rows.append(numbers)
    return tuple(nodes), np.array(rows, dtype=float).reshape(len(nodes), size)


def _fields(line: bytes, width: int) -> list[bytes]:
    return [line[i : i + width] for i in range(0, len(line.rstrip()), width)]


def _numbers(stream: UffStream, line: bytes) -> list[float]:
    """Numbers in 13 columns each."""
    try:
        return [float(field.replace(b"D", b"E")) for field in _fields(line, 13) if field.strip()]
    except ValueError:
        raise stream.wrong("something that is not a number stands among the values") from None


# Modes of universal files (dataset 55) as modal data of a rig's coordinates.


USUAL_SD = 0.01, 0.2, 0.05  # relative: of frequencies, damping ratios, shapes against their largest entry
Place = tuple[int, int]  # node, direction from 1 (+X) on


def read_uff_modes(
    file: DataFile,
    coordinates: Sequence[str],
    channels: Iterable[Channel],
    relative_sd: tuple[float, float, float],
) -> tuple[ModalData, list[Notice]]:
    """Modes with shapes at those coordinates that have a node, and what was assumed.

    A node and its direction belong to a coordinate by its name (3+Z, or 3), by that of a channel that shows this
    coordinate alone, or by the list that dashpot writes; where none fits and there are as many as coordinates, in
    their order.  The file has no standard deviations: `relative_sd` gives them.  Raises DataError.
    """
    measured = [mode for mode in modes_of(file) if mode.eigenvalue.imag > 0]
    if not measured:
        raise DataError("the file has no oscillating mode", file.name, "export datasets 55 of modes")
    shares = "{:g} % of frequencies, {:g} % of damping ratios, {:g} % of a shape's largest entry"
    text = (
        f"the file has no standard deviations: assumed are {shares.format(*(100 * x for x in relative_sd))}"
    )
    notes = [Notice("modes_without_sd", text, ())]
    places = _places(measured)
    matched = _matched(measured, places, coordinates, channels)
    if not matched:
        if len(places) != len(coordinates):
            raise DataError(
                f"no node is a coordinate of the rig: there are {listed(map(_label, places))}",
                file.name,
                'list channels of these names in the rig file, such as "3+Z" = { of = "x1" }',
            )
        matched = {name: (place, 1.0) for name, place in zip(coordinates, places, strict=True)}
        pairs = ", ".join(f"{_label(place)} = {shown(name)}" for name, (place, _) in matched.items())
        text = f"nodes are taken for coordinates in their order: {pairs}"
        notes.append(Notice("modes_in_order", text, tuple(coordinates)))
    points = tuple(name for name in coordinates if name in matched)
    shapes: Complex = np.full((len(measured), len(points)), np.nan + 0j)
    for k, mode in enumerate(measured):
        for c, name in enumerate(points):
            (node, direction), factor = matched[name]
            if node in mode.nodes and direction <= mode.shapes.shape[1]:
                shapes[k, c] = mode.shapes[mode.nodes.index(node), direction - 1] / factor
    frequency = np.array([mode.frequency_hz for mode in measured])
    damping = np.array([mode.damping_ratio or np.nan for mode in measured])
    largest = np.max(np.abs(np.nan_to_num(shapes)), axis=1, initial=0.0)
    spread = relative_sd[2] * np.broadcast_to(largest[:, None], shapes.shape)
    of_frequency, of_damping = (frequency, relative_sd[0] * frequency), (damping, relative_sd[1] * damping)
    return independent_modes(points, of_frequency, of_damping, (shapes, spread)), notes


def _places(found: Sequence[NodalMode]) -> list[Place]:
    """Nodes and directions that move in some mode, in order."""
    places: set[Place] = set()
    for mode in found:
        size = np.abs(mode.shapes)
        moving = size > 1e-9 * np.max(size, initial=0.0)  # else the direction was not measured
        places.update((mode.nodes[row], column + 1) for row, column in np.argwhere(moving).tolist())
    return sorted(places)


def _label(place: Place) -> str:
    return f"{place[0]}{DIRECTIONS.get(place[1], '')}"


def _matched(
    modes: Sequence[NodalMode],
    places: Sequence[Place],
    coordinates: Sequence[str],
    channels: Iterable[Channel],
) -> dict[str, tuple[Place, float]]:
    """Place and factor of each coordinate that has one by its names.

    A coordinate goes by its own name and by those of channels that show it alone; a place by node and direction and,
    where the node moves in one direction, by the node alone and the name that the file lists for it.
    """
    names = {name: (name, 1.0) for name in coordinates}
    for channel in channels:
        if channel.quantity is not Quantity.FORCE and len(channel.of) == 1:
            ((point, factor),) = channel.of.items()
            if point in coordinates:
                names.setdefault(channel.name, (point, factor))
    pairs = (re.findall(r"(\d+) = ([^,]+)", text) for mode in modes for text in mode.ids[2:])
    listed_names = dict(pair for each in pairs for pair in each)
    nodes = [node for node, _ in places]
    matched: dict[str, tuple[Place, float]] = {}
    for place in places:
        node, texts = str(place[0]), [_label(place)]
        if nodes.count(place[0]) == 1:
            texts += [node, listed_names.get(node, "").strip()]
        for text in texts:
            if text in names:
                point, factor = names[text]
                matched.setdefault(point, (place, factor))
    return matched
