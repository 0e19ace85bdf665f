"""Files of measured modes, CSV or JSON.

CSV: one row a mode; `frequency_hz`, `frequency_sd`, optionally `damping_ratio` and `damping_sd`, and for every point of
the shapes that is measured `NAME_re`, `NAME_im` (or `NAME` alone: a real shape) and `NAME_sd`, the standard deviation
of the real and of the imaginary part, each.  Shapes have any scale; a point may be left empty in some modes.
JSON: `{"modes": [{"frequency_hz": 3.0, "frequency_sd": 0.01, "damping_ratio": 0.02, "damping_sd": 0.001,
"shape": {"x1": [1.0, 0.0], "x2": 0.6}, "shape_sd": {"x1": 0.01, "x2": 0.01}}]}`.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.data.modal_data import ModalData
from dashpot.data.readers.columns import LARGEST, Columns, bare
from dashpot.data.readers.text import open_table
from dashpot.errors import DataError
from dashpot.io.json_document import from_json
from dashpot.io.ledger import noted
from dashpot.io.words import listed, shown

FREQUENCY, FREQUENCY_SD, DAMPING, DAMPING_SD = "frequency_hz", "frequency_sd", "damping_ratio", "damping_sd"
PLAIN = (FREQUENCY, FREQUENCY_SD, DAMPING, DAMPING_SD)


def read_mode_table(path: str | os.PathLike[str], coordinates: Sequence[str]) -> ModalData:
    """The modes in a file, with shapes at those of the rig's `coordinates` that it has.

    Raises DataError, one line, with file, row and column or mode, for what is missing, no number, negative or unknown.
    """
    source = shown(os.fspath(path), 200)
    if os.fspath(path).lower().endswith(".json"):
        return _from_json(path, source, coordinates)
    return _from_table(open_table(path), coordinates)


@dataclass(frozen=True)
class _Layout:
    """Columns of the frequency, the damping ratio and their sd, and of real part, imaginary part and sd of points."""

    frequency: int
    frequency_sd: int
    damping: int | None
    damping_sd: int | None
    points: dict[str, tuple[int, int | None, int]]

    @property
    def columns(self) -> list[int]:
        """All of them."""
        of_points = (at for three in self.points.values() for at in three)
        every = (self.frequency, self.frequency_sd, self.damping, self.damping_sd, *of_points)
        return list(dict.fromkeys(at for at in every if at is not None))


def _from_table(table: Columns, coordinates: Sequence[str]) -> ModalData:
    layout = _layout(table, coordinates)
    gaps = [at for at in layout.columns if at not in (layout.frequency, layout.frequency_sd)]
    values = table.numbers(layout.columns, gaps)
    absent = np.full(len(values[layout.frequency]), np.nan)
    zeta = absent if layout.damping is None else values[layout.damping]
    zeta_sd = absent if layout.damping_sd is None else values[layout.damping_sd]
    shape, sd = _shapes(table, layout, values)
    _check_modes(table, layout, values, zeta, zeta_sd)
    _check_shapes(table, layout, sd)
    f, f_sd = values[layout.frequency], values[layout.frequency_sd]
    return _assembled(list(layout.points), f, f_sd, zeta, zeta_sd, shape, sd)


def _layout(table: Columns, coordinates: Sequence[str]) -> _Layout:
    """Where everything stands.  Raises DataError for what is missing, twice, or of no coordinate."""
    f_at, f_sd_at = table.need(FREQUENCY), table.need(FREQUENCY_SD, " (a mode without it cannot be weighed)")
    z_at = table.find(DAMPING)
    z_sd_at = None if z_at is None else table.need(DAMPING_SD, f" (it belongs to {DAMPING})")
    points: dict[str, tuple[int, int | None, int]] = {}
    for name in coordinates:
        real, alone = table.find(f"{name}_re"), table.find(name)
        if real is not None and alone is not None:
            what = f"columns {shown(name)} and {shown(name)}_re: the same point twice"
            raise DataError(what, table.source, "remove one")
        if real is not None:
            points[name] = (real, table.need(f"{name}_im"), table.need(f"{name}_sd"))
        elif alone is not None:
            points[name] = (alone, None, table.need(f"{name}_sd"))
    layout = _Layout(f_at, f_sd_at, z_at, z_sd_at, points)
    strangers = [bare(name)[0] for i, name in enumerate(table.header) if i not in layout.columns]
    if strangers:
        raise DataError(
            f"column {listed(strangers)}: not a coordinate of the rig",
            table.heading,
            f"shapes are read as NAME_re, NAME_im, NAME_sd at {listed(coordinates)}; remove the others",
        )
    return layout


def _shapes(table: Columns, layout: _Layout, values: Mapping[int, Real]) -> tuple[Complex, Real]:
    """Shapes and their sd, (modes, points); NaN where a point is left empty.  Raises DataError for half a gap."""
    count, points = len(values[layout.frequency]), len(layout.points)
    shape, sd = np.full((count, points), np.nan + 0j), np.full((count, points), np.nan)
    for c, (re, im, sd_at) in enumerate(layout.points.values()):
        imaginary = np.where(np.isnan(values[re]), np.nan, 0.0) if im is None else values[im]
        half = np.isnan(values[re]) != np.isnan(imaginary)
        lacking = ~np.isnan(values[re]) & np.isnan(values[sd_at])
        for wrong, at in ((half, re if im is None else im), (lacking, sd_at)):
            if np.any(wrong):
                raise table.error(int(np.argmax(wrong)), at, "the cell is empty", "fill the gap")
        shape[:, c], sd[:, c] = values[re] + 1j * imaginary, values[sd_at]
    return shape, sd


def _check_modes(
    table: Columns, layout: _Layout, values: Mapping[int, Real], zeta: Real, zeta_sd: Real
) -> None:
    """Raises DataError at the first frequency, damping ratio or sd that is out of range."""
    f, f_sd = values[layout.frequency], values[layout.frequency_sd]
    not_positive, above = "a standard deviation that is not positive", "give one above 0"
    unseen = "give it as a fraction; such a mode does not oscillate"
    for wrong, at, cause, cure in (
        (~(f > 0), layout.frequency, "a frequency that is not positive", "give it in Hz"),
        (~(f_sd > 0), layout.frequency_sd, not_positive, above),
        (np.abs(zeta) >= 1, layout.damping, "a damping ratio of 1 or more", unseen),
        (~np.isnan(zeta) & ~(zeta_sd > 0), layout.damping_sd, not_positive, above),
    ):
        if at is not None and np.any(wrong):
            raise table.error(int(np.argmax(wrong)), at, cause, cure)


def _check_shapes(table: Columns, layout: _Layout, sd: Real) -> None:
    """Raises DataError at the first sd of a shape that is negative, and where all of a shape are 0."""
    at = [sd_at for _, _, sd_at in layout.points.values()]
    for c, column in enumerate(at):
        if np.any(sd[:, c] < 0):
            cure = "give 0 where it is exact, else one above 0"
            raise table.error(int(np.argmax(sd[:, c] < 0)), column, "a negative standard deviation", cure)
    there = ~np.isnan(sd)
    exact = np.all((sd == 0) | ~there, axis=-1) & np.any(sd == 0, axis=-1) & (np.sum(there, axis=-1) > 1)
    if np.any(exact):
        cause = "no point of the shape has a standard deviation above 0"
        cure = "give the uncertain points theirs; only the one that the shape is scaled by is exact"
        raise table.error(int(np.argmax(exact)), at[0], cause, cure)


def _assembled(
    points: Sequence[str], f: Real, f_sd: Real, zeta: Real, zeta_sd: Real, shape: np.ndarray, sd: Real
) -> ModalData:
    covariance = np.zeros((len(f), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = f_sd**2, np.nan_to_num(zeta_sd) ** 2
    V = 2 * np.nan_to_num(sd)[:, :, None] ** 2 * np.eye(len(points))
    return ModalData(tuple(points), f, zeta, covariance, shape, V.astype(complex))


def _from_json(path: str | os.PathLike[str], source: str, coordinates: Sequence[str]) -> ModalData:
    rows = _rows_of_json(path, source)
    places = [f"{source}: mode {k + 1}" for k in range(len(rows))]
    named = [_shape(row, "shape", where) for row, where in zip(rows, places, strict=True)]
    points = [name for name in coordinates if any(name in shape for shape in named)]
    numbers = np.full((len(PLAIN), len(rows)), np.nan)
    shape = np.full((len(rows), len(points)), np.nan + 0j)
    sd = np.full((len(rows), len(points)), np.nan)
    for k, (row, where) in enumerate(zip(rows, places, strict=True)):
        numbers[:, k] = _plain_numbers(row, where)
        spread = _shape(row, "shape_sd", where)
        for name, value in named[k].items():
            if name not in points:
                raise DataError(
                    f"shape: {shown(name)} is not a coordinate of the rig",
                    where,
                    f"there are {listed(coordinates)}",
                )
            _require(name in spread, f"shape_sd: {shown(name)} is missing", where)
            _require(spread[name].real >= 0, f"shape_sd: {shown(name)} is negative", where)
            shape[k, points.index(name)], sd[k, points.index(name)] = value, spread[name].real
        uncertain = sd[k][~np.isnan(sd[k])]
        scaled = len(uncertain) < 2 or bool(np.any(uncertain > 0))
        _require(scaled, "shape_sd: no point of the shape has one above 0", where)
    return _assembled(points, numbers[0], numbers[1], numbers[2], numbers[3], shape, sd)


def _rows_of_json(path: str | os.PathLike[str], source: str) -> list[dict[str, Any]]:
    """One table for each mode."""
    try:
        content = from_json(Path(noted(path)).read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot be read ({error.strerror or error})", source, "check the path") from None
    except (ValueError, RecursionError):
        raise DataError("this is not JSON", source, "correct it, or give a CSV file") from None
    if isinstance(content, dict) and "parameters" in content:
        raise DataError("this is an estimate, not data", source, "name files of data or of modes")
    rows = content.get("modes") if isinstance(content, dict) else None
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise DataError('there is no list "modes"', source, 'write {"modes": [{"frequency_hz": …}, …]}')
    return rows


def _plain_numbers(row: Mapping[str, Any], where: str) -> list[float]:
    """Frequency and damping with their standard deviations, in the order of PLAIN; NaN where not given."""
    unknown = [key for key in row if key not in (*PLAIN, "shape", "shape_sd")]
    if unknown:
        known = f"there are {', '.join(PLAIN)}, shape, shape_sd"
        raise DataError(f"{shown(str(unknown[0]))}: unknown key", where, known)
    f, f_sd, zeta, zeta_sd = (_number(row[key], key, where) if key in row else math.nan for key in PLAIN)
    _require(f > 0, f"{FREQUENCY}: missing or not positive", where)
    _require(f_sd > 0, f"{FREQUENCY_SD}: missing or not positive", where)
    _require(math.isnan(zeta) or abs(zeta) < 1, f"{DAMPING}: not between −1 and 1", where)
    _require(math.isnan(zeta) or zeta_sd > 0, f"{DAMPING_SD}: missing or not positive", where)
    return [f, f_sd, zeta, zeta_sd]


def _require(fulfilled: bool, what: str, where: str) -> None:
    if not fulfilled:
        raise DataError(what, where, "give the number")


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
