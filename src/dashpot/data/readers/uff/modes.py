"""Dataset 55: data at nodes, of which modes are read: normal modes and complex eigenvalues."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, freeze
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.uff.stream import MARK, DatasetStart, UffStream, dataset_starts, skip_dataset

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
