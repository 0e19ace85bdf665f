"""Files of measured modes: tables in CSV, JSON, and universal files (dataset 55)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence

from dashpot.channel import Channel
from dashpot.data.modal_data import ModalData
from dashpot.data.readers.columns import bare
from dashpot.data.readers.datafile import DataFile, open_file
from dashpot.data.readers.modes import FREQUENCY, FREQUENCY_SD, read_mode_table
from dashpot.data.readers.uff.function import UffStream, dataset_starts, skip_dataset
from dashpot.data.readers.uff.modes import USUAL_SD, read_uff_modes
from dashpot.data.readers.uff.reader import UffReader
from dashpot.errors import DashpotError
from dashpot.notices import Notice

AnyPath = str | os.PathLike[str]


def read_modes(
    path: AnyPath,
    coordinates: Sequence[str],
    channels: Iterable[Channel] = (),
    relative_sd: tuple[float, float, float] = USUAL_SD,
) -> ModalData:
    """The modes in a file, with shapes at those of the rig's `coordinates` that it has.

    channels     of the rig, whose names the nodes of a universal file may have
    relative_sd  of frequencies, of damping ratios and of shapes against their largest entry, for universal files,
                 which have none

    Raises DataError, one line, with file, row and column or mode, for what is missing, no number, negative or unknown.
    """
    return modes_and_notes(path, coordinates, channels, relative_sd)[0]


def modes_and_notes(
    path: AnyPath,
    coordinates: Sequence[str],
    channels: Iterable[Channel] = (),
    relative_sd: tuple[float, float, float] = USUAL_SD,
) -> tuple[ModalData, list[Notice]]:
    """The same, and what was assumed."""
    if not os.fspath(path).lower().endswith(".json"):
        file = open_file(path)
        if UffReader().sniff(file):
            return read_uff_modes(file, coordinates, channels, relative_sd)
    return read_mode_table(path, coordinates), []


def holds_modes(path: AnyPath) -> bool:
    """Whether a file holds modes and no samples or responses: a table with `frequency_sd`, JSON, datasets 55 alone.

    What cannot be read holds none: its reader says why.
    """
    name = os.fspath(path).lower()
    if name.endswith(".json"):
        return True
    if not os.path.isfile(path):
        return False
    try:
        file = open_file(path)
        if UffReader().sniff(file):
            return _datasets(file) == {55}
        text = name.removesuffix(".gz").endswith((".csv", ".txt"))
        return text and {FREQUENCY, FREQUENCY_SD} <= {bare(column)[0] for column in _first_row(file)}
    except DashpotError:
        return False


def _datasets(file: DataFile) -> set[int]:
    """Numbers of the datasets in a universal file that are read; up to the first function."""
    numbers = set()
    with file.reading() as raw:
        stream = UffStream(raw, file)
        for start in dataset_starts(stream):
            numbers.add(start.number)
            if start.number == 58:
                break
            skip_dataset(stream)
    return numbers & {55, 58}


def _first_row(file: DataFile) -> list[str]:
    text = file.head.decode("utf-8-sig", errors="replace").lstrip().split("\n", 1)[0]
    return [cell.strip().strip('"') for cell in text.replace(";", ",").replace("\t", ",").split(",")]
