"""Dataset 55: data at nodes, of which modes are read: normal modes and complex eigenvalues."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.data.modal_data import ModalData
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


USUAL_SD = (
    0.01,
    0.2,
    0.05,
)  # relative: of frequencies, of damping ratios, of shapes against their largest entry
_NAMED = re.compile(r"(\d+) = ([^,]+)")

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
    places = _places(measured)
    matched, in_order = _matched(measured, places, coordinates, channels, file.name)
    points = [name for name in coordinates if name in matched]
    shapes = np.array([[_entry(mode, *matched[name]) for name in points] for mode in measured], dtype=complex)
    shapes = shapes.reshape(len(measured), len(points))
    notes = [_assumed(relative_sd)]
    if in_order:
        pairs = ", ".join(f"{_label(place)} = {shown(name)}" for name, (place, _) in matched.items())
        notes.append(
            Notice(
                "modes_in_order", f"nodes are taken for coordinates in their order: {pairs}", tuple(points)
            )
        )
    return _modal_data(points, measured, shapes, relative_sd), notes


def _assumed(relative_sd: tuple[float, float, float]) -> Notice:
    frequency, damping, shape = (f"{100 * share:g} %" for share in relative_sd)
    text = f"the file has no standard deviations: assumed are {frequency} of frequencies, {damping} of damping ratios, "
    return Notice("modes_without_sd", f"{text}{shape} of a shape's largest entry", ())


def _modal_data(
    points: Sequence[str],
    found: Sequence[NodalMode],
    shapes: Complex,
    relative_sd: tuple[float, float, float],
) -> ModalData:
    frequency = np.array([mode.frequency_hz for mode in found])
    damping = np.array([mode.damping_ratio if mode.damping_ratio else np.nan for mode in found])
    covariance = np.zeros((len(found), 2, 2))
    covariance[:, 0, 0] = (relative_sd[0] * frequency) ** 2
    covariance[:, 1, 1] = (relative_sd[1] * np.nan_to_num(damping)) ** 2
    largest = np.max(np.abs(np.nan_to_num(shapes)), axis=1, initial=0.0)
    spread = 2 * (relative_sd[2] * largest[:, None, None]) ** 2 * np.eye(len(points))
    return ModalData(tuple(points), frequency, damping, covariance, shapes, spread.astype(complex))


def _places(found: Sequence[NodalMode]) -> list[Place]:
    """Nodes and directions that move in some mode, in order."""
    places: set[Place] = set()
    for mode in found:
        size = np.abs(mode.shapes)
        moving = size > 1e-9 * np.max(size, initial=0.0)  # else the direction was not measured
        places.update((mode.nodes[row], column + 1) for row, column in np.argwhere(moving).tolist())
    return sorted(places)


def _entry(mode: NodalMode, place: Place, factor: float) -> complex:
    """The coordinate's entry in a shape; NaN where the mode has no such node."""
    node, direction = place
    if node not in mode.nodes or direction > mode.shapes.shape[1]:
        return complex(np.nan, np.nan)
    return complex(mode.shapes[mode.nodes.index(node), direction - 1]) / factor


def _label(place: Place) -> str:
    return f"{place[0]}{DIRECTIONS.get(place[1], '')}"


def _names_of_coordinates(
    coordinates: Sequence[str], channels: Iterable[Channel]
) -> dict[str, tuple[str, float]]:
    """Coordinate and factor by each name that it goes by: its own, and those of channels that show it alone."""
    names = {name: (name, 1.0) for name in coordinates}
    for channel in channels:
        if channel.quantity is not Quantity.FORCE and len(channel.of) == 1:
            ((point, factor),) = channel.of.items()
            if point in coordinates:
                names.setdefault(channel.name, (point, factor))
    return names


def _names_of_places(modes: Sequence[NodalMode], places: Sequence[Place]) -> dict[Place, list[str]]:
    """Node and direction; for nodes that move in one direction the node alone, and the name that the file lists."""
    listed_names = dict(pair for mode in modes for text in mode.ids[2:] for pair in _NAMED.findall(text))
    nodes = [node for node, _ in places]
    names = {}
    for place in places:
        node = str(place[0])
        alone = nodes.count(place[0]) == 1
        names[place] = [_label(place), *([node, listed_names.get(node, "").strip()] if alone else [])]
    return names


def _matched(
    modes: Sequence[NodalMode],
    places: Sequence[Place],
    coordinates: Sequence[str],
    channels: Iterable[Channel],
    source: str,
) -> tuple[Mapping[str, tuple[Place, float]], bool]:
    """Place and factor of each coordinate, and whether they were taken in order.  Raises DataError."""
    names = _names_of_coordinates(coordinates, channels)
    matched: dict[str, tuple[Place, float]] = {}
    for place, texts in _names_of_places(modes, places).items():
        for text in texts:
            if text in names:
                point, factor = names[text]
                matched.setdefault(point, (place, factor))
    if matched:
        return matched, False
    if len(places) == len(coordinates):
        return {name: (place, 1.0) for name, place in zip(coordinates, places, strict=True)}, True
    raise DataError(
        f"no node is a coordinate of the rig: there are {listed([_label(place) for place in places])}",
        source,
        'list channels of these names in the rig file, such as "3+Z" = { of = "x1" }',
    )
