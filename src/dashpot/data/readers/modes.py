"""Files of measured modes: tables in CSV, JSON, and universal files (dataset 55).

CSV: one row a mode; `frequency_hz`, `frequency_sd`, optionally `damping_ratio` and `damping_sd`, and for every point of
the shapes that is measured `NAME_re`, `NAME_im` (or `NAME` alone: a real shape) and `NAME_sd`, the standard deviation
of the real and of the imaginary part, each.  Shapes have any scale; a point may be left empty in some modes.  Standard
deviations of frequencies, of damping ratios or of all points that the file does not have are usual ones.
JSON: `{"modes": [{"frequency_hz": 3.0, "frequency_sd": 0.01, "damping_ratio": 0.02, "damping_sd": 0.001,
"shape": {"x1": [1.0, 0.0], "x2": 0.6}, "shape_sd": {"x1": 0.01, "x2": 0.01}}]}`, or as `dashpot modes` writes it:
each with `"frequency_hz": {"value": 3.0, "sd": 0.01}`, `damping_ratio` alike,
and `"shape": {"x1": {"re": 1.0, "im": 0.0, "sd": 0.01}}`.
Points are coordinates of the rig, or its channels that show one of them alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.channel import Channel
from dashpot.data.modal_data import ModalData, at_coordinates, independent_modes, named_points
from dashpot.data.readers.arrays import ArrayColumns
from dashpot.data.readers.columns import LARGEST, Columns, bare
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.text import open_table, write_rows
from dashpot.data.readers.uff import (
    USUAL_SD,
    NodalMode,
    UffStream,
    assumed_sd,
    dataset_starts,
    is_universal,
    read_uff_modes,
    skip_dataset,
)
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.errors import DashpotError, DataError
from dashpot.io.json_document import from_json
from dashpot.io.ledger import AnyPath, noted
from dashpot.io.words import choose_from, listed, shown
from dashpot.notices import Notice

FREQUENCY, FREQUENCY_SD, DAMPING, DAMPING_SD = "frequency_hz", "frequency_sd", "damping_ratio", "damping_sd"
PLAIN = (FREQUENCY, FREQUENCY_SD, DAMPING, DAMPING_SD)


def read_modes(
    path: AnyPath,
    coordinates: Sequence[str],
    channels: Iterable[Channel] = (),
    relative_sd: tuple[float, float, float] = USUAL_SD,
) -> ModalData:
    """The modes in a file, with shapes at those of the rig's `coordinates` that the file contains.

    channels     of the rig: points may be named after channels that measure a single coordinate
    relative_sd  of frequencies, damping ratios, and shapes (relative to their largest entry), for files that state
                 none

    Raises DataError, with file, row and column or mode, for an entry that is missing, negative, unknown or no number.
    """
    return modes_and_notes(path, coordinates, channels, relative_sd)[0]


def modes_and_notes(
    path: AnyPath,
    coordinates: Sequence[str],
    channels: Iterable[Channel] = (),
    relative_sd: tuple[float, float, float] = USUAL_SD,
) -> tuple[ModalData, list[Notice]]:
    """The same, and what was assumed."""
    channels = tuple(channels)
    names = list(named_points(coordinates, channels))
    if os.fspath(path).lower().endswith(".json"):
        # Modes as a table would have them: one a row, NaN where something is not given
        source, rows = shown(os.fspath(path), 200), []
        try:
            content = from_json(Path(noted(path)).read_text(encoding="utf-8"))
        except OSError as error:
            raise DataError(f"cannot be read ({error.strerror or error})", source, "check the path") from None
        except (ValueError, RecursionError):
            raise DataError("this is not JSON", source, "correct it, or give a CSV file") from None
        if isinstance(content, dict) and "parameters" in content:
            raise DataError("this is an estimate, not data", source, "name files of data or of modes")
        tables = content.get("modes") if isinstance(content, dict) else None
        if not isinstance(tables, list) or not tables or not all(isinstance(row, dict) for row in tables):
            raise DataError('there is no list "modes"', source, 'write {"modes": [{"frequency_hz": …}, …]}')
        for number, mode in enumerate(tables, start=1):
            where = f"{source}: mode {number}"
            # The mode with a number or a list for each key, where values stand with their standard deviations
            flat = {key: value for key, value in mode.items() if key != "participation"}
            for key, sd_key in ((FREQUENCY, FREQUENCY_SD), (DAMPING, DAMPING_SD)):
                if isinstance(value := flat.get(key), dict):
                    flat |= {key: value.get("value"), sd_key: value.get("sd")}
            shape = flat.get("shape")
            if isinstance(shape, dict) and shape and all(isinstance(point, dict) for point in shape.values()):
                flat["shape"] = {
                    name: [point.get("re"), point.get("im", 0.0)] for name, point in shape.items()
                }
                flat["shape_sd"] = {name: point.get("sd") for name, point in shape.items()}
            mode = flat
            for key in mode:
                if key not in (*PLAIN, "shape", "shape_sd"):
                    known = (*PLAIN, "shape", "shape_sd")
                    raise DataError(f"{shown(str(key))}: unknown key", where, choose_from(known))
            row = {key: _number(mode[key], key, where) for key in PLAIN if key in mode}
            spread = _shape(mode, "shape_sd", where)
            for name, value in _shape(mode, "shape", where).items():
                if name not in names:
                    what = f"shape: {shown(name)} is not a coordinate of the rig"
                    raise DataError(what, where, choose_from(coordinates))
                row |= {f"{name}_re": value.real, f"{name}_im": value.imag}
                row |= {f"{name}_sd": spread[name].real} if name in spread else {}
            rows.append(row)
        header = tuple(dict.fromkeys(name for row in rows for name in row))
        columns = tuple(np.array([row.get(name, np.nan) for row in rows]) for name in header)
        table: Columns = ArrayColumns(source, header, (), (), len(rows), columns, "mode")
    else:
        file = open_file(path)
        if is_universal(file):
            return read_uff_modes(file, coordinates, channels, relative_sd)
        table = open_table(file)
    modes, missing = _modes_of(table, names, relative_sd)
    notes = [assumed_sd(relative_sd, missing)] if any(missing) else []
    return at_coordinates(modes, coordinates, channels, table.source), notes


def write_mode_table(modes: ModalData, path: AnyPath) -> None:
    """Write modes as the table that is read here or, where the name ends in .uff or .unv, as datasets 55.

    These have no uncertainties; point k is node k, direction X, and the ID lines say which point that is.
    Raises DataError if the file cannot be written.
    """
    if os.fspath(path).lower().endswith((".uff", ".unv")):
        omega, zeta = 2 * np.pi * modes.frequency_hz, modes.damping_ratio
        eigenvalues = omega * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0.0)))
        nodes = tuple(range(1, len(modes.points) + 1))
        named = ", ".join(f"{node} = {point}" for node, point in zip(nodes, modes.points, strict=True))
        ids = ("Modes by dashpot", *(named[k : k + 80] for k in range(0, min(len(named), 320), 80)))
        shapes = np.pad(modes.shapes[..., None], ((0, 0), (0, 0), (0, 2)))
        each = zip(eigenvalues.tolist(), shapes, strict=True)
        written = [NodalMode(eigenvalue, nodes, shape, ids) for eigenvalue, shape in each]
        write_universal_file(path, modes=written)
        return
    sd = np.sqrt(np.diagonal(modes.covariance, axis1=1, axis2=2))
    columns = {
        FREQUENCY: modes.frequency_hz,
        FREQUENCY_SD: sd[:, 0],
        DAMPING: modes.damping_ratio,
        DAMPING_SD: sd[:, 1],
    }
    of_shapes = np.sqrt(np.diagonal(modes.shape_covariance, axis1=1, axis2=2).real / 2)
    for i, point in enumerate(modes.points):
        shape = modes.shapes[:, i]
        columns |= {f"{point}_re": shape.real, f"{point}_im": shape.imag, f"{point}_sd": of_shapes[:, i]}
    write_rows(path, list(columns), list(columns.values()))


def holds_modes(path: AnyPath) -> bool:
    """Whether a file holds modes and no samples or responses: a table of frequencies with their standard deviations or
    damping ratios, or alone, JSON, datasets 55 alone.

    What cannot be read holds none: its reader says why.
    """
    name = os.fspath(path).lower()
    if name.endswith(".json"):
        return True
    if not os.path.isfile(path):
        return False
    try:
        file = open_file(path)
        if is_universal(file):
            # Numbers of the datasets in a universal file that are read; up to the first function
            numbers = set()
            with file.reading() as raw:
                stream = UffStream(raw, file)
                for start in dataset_starts(stream):
                    numbers.add(start.number)
                    if start.number == 58:
                        break
                    skip_dataset(stream)
            return (numbers & {55, 58}) == {55}
        text = name.removesuffix(".gz").endswith((".csv", ".txt"))
        row = file.head.decode("utf-8-sig", errors="replace").lstrip().split("\n", 1)[0]
        cells = [cell.strip().strip('"') for cell in row.replace(";", ",").replace("\t", ",").split(",")]
        names = {bare(cell)[0] for cell in cells}
        return text and FREQUENCY in names and (len(names) == 1 or not names.isdisjoint(PLAIN[1:]))
    except DashpotError:
        return False


@dataclass(frozen=True)
class _Layout:
    """Columns of the frequency, the damping ratio and their sd, and of real part, imaginary part and sd of points."""

    frequency: int
    frequency_sd: int | None
    damping: int | None
    damping_sd: int | None
    points: dict[str, tuple[int, int | None, int | None]]

    @property
    def columns(self) -> list[int]:
        """All of them."""
        of_points = (at for three in self.points.values() for at in three)
        every = (self.frequency, self.frequency_sd, self.damping, self.damping_sd, *of_points)
        return list(dict.fromkeys(at for at in every if at is not None))


def _modes_of(
    table: Columns, names: Sequence[str], relative_sd: tuple[float, float, float]
) -> tuple[ModalData, tuple[bool, bool, bool]]:
    """The modes of a table, and of what it has no standard deviations: frequencies, damping ratios, shapes."""
    # Where everything stands
    f_at, f_sd_at, z_at = table.need(FREQUENCY), table.find(FREQUENCY_SD), table.find(DAMPING)
    z_sd_at = None if z_at is None else table.find(DAMPING_SD)
    stated = any(table.find(f"{name}_sd") is not None for name in names)
    points: dict[str, tuple[int, int | None, int | None]] = {}
    for name in names:
        real, alone = table.find(f"{name}_re"), table.find(name)
        if real is not None and alone is not None:
            what = f"columns {shown(name)} and {shown(name)}_re: the same point twice"
            raise DataError(what, table.source, "remove one")
        if real is not None:
            points[name] = (real, table.need(f"{name}_im"), table.need(f"{name}_sd") if stated else None)
        elif alone is not None:
            points[name] = (alone, None, table.need(f"{name}_sd") if stated else None)
    layout = _Layout(f_at, f_sd_at, z_at, z_sd_at, points)
    strangers = [bare(name)[0] for i, name in enumerate(table.header) if i not in layout.columns]
    if strangers:
        raise DataError(
            f"column {listed(strangers)}: not a coordinate of the rig",
            table.heading,
            f"shapes are read as NAME_re, NAME_im, NAME_sd at {listed(names)}; remove the others",
        )
    gaps = [at for at in layout.columns if at not in (layout.frequency, layout.frequency_sd)]
    values = table.numbers(layout.columns, gaps)
    absent = np.full(len(values[layout.frequency]), np.nan)
    zeta = absent if layout.damping is None else values[layout.damping]
    zeta_sd = relative_sd[1] * np.abs(zeta) if layout.damping_sd is None else values[layout.damping_sd]
    zeta = np.where(zeta_sd == 0, np.nan, zeta) if layout.damping_sd is None else zeta  # 0: not measured
    # Shapes and their sd, (modes, points); NaN where a point is left empty
    size = len(values[layout.frequency]), len(layout.points)
    shapes, sd = np.full(size, np.nan + 0j), np.full(size, np.nan)
    for c, (re, im, sd_at) in enumerate(layout.points.values()):
        imaginary = np.where(np.isnan(values[re]), np.nan, 0.0) if im is None else values[im]
        half = np.isnan(values[re]) != np.isnan(imaginary)
        table.refuse(re if im is None else im, half, "the cell is empty", "fill the gap")
        shapes[:, c] = values[re] + 1j * imaginary
        if sd_at is not None:
            table.refuse(
                sd_at, ~np.isnan(values[re]) & np.isnan(values[sd_at]), "the cell is empty", "fill the gap"
            )
            sd[:, c] = values[sd_at]
    if not stated:
        largest = np.max(np.abs(np.nan_to_num(shapes)), axis=1, initial=0.0, keepdims=True)
        sd = np.where(np.isnan(shapes), np.nan, relative_sd[2] * largest)
    f = values[layout.frequency]
    f_sd = relative_sd[0] * f if layout.frequency_sd is None else values[layout.frequency_sd]
    not_positive, above = "a standard deviation that is not positive", "give one above 0"
    unseen = "give it as a fraction; such a mode does not oscillate"
    for wrong, at, cause, cure in (
        (~(f > 0), layout.frequency, "a frequency that is not positive", "give it in Hz"),
        (~(f_sd > 0), layout.frequency_sd, not_positive, above),
        (np.abs(zeta) >= 1, layout.damping, "a damping ratio of 1 or more", unseen),
        (~np.isnan(zeta) & ~(zeta_sd > 0), layout.damping_sd, not_positive, above),
    ):
        if at is not None:
            table.refuse(at, wrong, cause, cure)
    columns = [sd_at for _, _, sd_at in layout.points.values() if sd_at is not None]
    for c, column in enumerate(columns):
        cure = "give 0 where it is exact, else one above 0"
        table.refuse(column, sd[:, c] < 0, "a negative standard deviation", cure)
    there = ~np.isnan(sd)
    exact = np.all((sd == 0) | ~there, axis=-1) & np.any(sd == 0, axis=-1) & (np.sum(there, axis=-1) > 1)
    if columns:
        cause = "no point of the shape has a standard deviation above 0"
        cure = "give the uncertain points theirs; only the one that the shape is scaled by is exact"
        table.refuse(columns[0], exact, cause, cure)
    missing = layout.frequency_sd is None, z_at is not None and z_sd_at is None, bool(points) and not stated
    return independent_modes(tuple(layout.points), (f, f_sd), (zeta, zeta_sd), (shapes, sd)), missing


def _shape(row: Mapping[str, Any], key: str, where: str) -> dict[str, complex]:
    found = row.get(key, {})
    if not isinstance(found, dict):
        raise DataError(f"{key}: not a table", where, f'write it as "{key}": {{"x1": 1.0}}')
    out = {}
    for name, value in found.items():
        parts = value if isinstance(value, list) and len(value) == 2 else [value, 0.0]
        out[name] = complex(*(_number(part, f"{key}: {shown(name)}", where) for part in parts))
    return out


def _number(value: object, key: str, where: str) -> float:
    """A finite number; whole numbers of any length are told apart before they become one."""
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST:
        return float(value)
    text = "a number of many digits" if isinstance(value, int) and value > 1 else shown(json.dumps(value))
    raise DataError(f"{key}: {text} is not a finite number", where, "give a number")
