"""HDF5, MATLAB 7.3 among it: datasets are variables, groups are parts, attributes say units and sampling."""

from __future__ import annotations

import mmap
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from dashpot.data.readers.arrays import LONG, PIECE, ArrayColumns, Streamed, parts_of_variables
from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError
from dashpot.io.ledger import noted
from dashpot.io.words import shown

UNITS = ("unit", "units", "Unit", "Units", "unit_string")
MOST_GROUPS = 10_000
MOST_OBJECTS = 100_000  # links followed in one file: 3 s of work
DEEPEST = 1000  # groups inside groups

HEAP = b"GCOL\x01\0\0\0"  # begins a heap of texts: signature, version, three zeros; then its size


def is_hdf5(file: DataFile) -> bool:
    """The signature stands at one of the places where it may."""
    return any(file.head[at : at + 8] == b"\x89HDF\r\n\x1a\n" for at in (0, 512, 1024, 2048))


def read_hdf5(file: DataFile, h5py: Any) -> Iterator[ArrayColumns]:
    """The groups that hold datasets of numbers, the outermost first.

    Attributes of a group and of those around it are scalars of it.
    """
    _refuse_endless_heaps(file.contents)
    with h5py.File(noted(file.path), "r") as content:
        for name, scalars, datasets in _Walk(h5py, content, file).groups():
            variables, units = dict(scalars), {}
            for key, item in datasets.items():
                variables |= _variable(key, item)
                units[key] = _unit(item)
                variables |= {k: v for k, v in _scalars(item).items() if k not in variables}
            if any(np.size(value) > 1 for value in variables.values()):
                place = f"{file.name} ({name})" if name else file.name
                yield from parts_of_variables(place, variables, units)


@dataclass
class _Walk:
    """The way through a file, every group once; no step of it enters another file, and the steps are counted."""

    h5py: Any
    content: Any
    file: DataFile
    steps: int = 0
    sizes: dict[int, int] = field(default_factory=dict)  # bytes of datasets, by their address

    @property
    def source(self) -> str:
        """The file, for messages."""
        return self.file.name

    def groups(self) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
        """Name, scalars (its own first, then those of the groups around it) and datasets of each group.

        Raises DataError for what is kept in another file, and where there is too much.
        """
        root = self.content.id
        ahead: deque[tuple[str, int, Any, dict[str, Any]]] = deque([("", 0, root, {})])
        seen = {self.h5py.h5o.get_info(root).addr}
        while ahead:
            name, depth, group, around = ahead.popleft()
            own = _scalars(self.h5py.Group(group))
            scalars, datasets = own | {k: v for k, v in around.items() if k not in own}, {}
            for written in list(group):
                key = written.decode("utf-8", errors="replace")
                place = f"{name}/{key}" if name else key
                item = self._followed(group, written, place)
                if isinstance(item, self.h5py.h5d.DatasetID):
                    if self._has_values(item, place):
                        datasets[key] = self.h5py.Dataset(item)
                elif isinstance(item, self.h5py.h5g.GroupID) and not key.startswith("#"):
                    address = self.h5py.h5o.get_info(item).addr
                    if address not in seen:
                        seen.add(address)
                        ahead.append((place, depth + 1, item, scalars))
            if len(seen) > MOST_GROUPS or (ahead and depth >= DEEPEST):
                deep = f"groups are nested over {DEEPEST} deep"
                what = f"there are over {MOST_GROUPS} groups" if len(seen) > MOST_GROUPS else deep
                raise DataError(what, self.source, "give a smaller file")
            yield name, scalars, datasets

    def _followed(self, group: Any, key: bytes, place: str) -> Any:
        """What a link leads to; None if it leads nowhere.  libhdf5 would follow it into another file."""
        links, at, soft = [key], group, 0
        while links:
            key = links.pop()
            if key in (b"", b"."):
                continue
            self.steps += 1
            if self.steps > MOST_OBJECTS:
                raise DataError(f"there are over {MOST_OBJECTS} objects", self.source, "give a smaller file")
            if not isinstance(at, self.h5py.h5g.GroupID) or not at.links.exists(key):
                return None
            kind = at.links.get_info(key).type
            if kind == self.h5py.h5l.TYPE_EXTERNAL:
                raise self._elsewhere(place, "an external link")
            if kind == self.h5py.h5l.TYPE_HARD:
                at = self.h5py.h5o.open(at, key)
                continue
            soft += 1
            if kind != self.h5py.h5l.TYPE_SOFT or soft > 16:  # one to the next, as libhdf5 allows
                return None
            path = at.links.get_val(key)
            links += path.split(b"/")[::-1]
            at = self.content.id if path.startswith(b"/") else at
        return at

    def _has_values(self, dataset: Any, place: str) -> bool:
        """Whether a dataset has a shape.  Raises DataError if its values are kept in other files."""
        plan = dataset.get_create_plist()
        if plan.get_layout() == self.h5py.h5d.VIRTUAL:
            raise self._elsewhere(place, "a virtual dataset")
        if plan.get_layout() == self.h5py.h5d.CONTIGUOUS and plan.get_external_count():
            raise self._elsewhere(place, "kept in an external file")
        space = dataset.get_space()
        if space.get_simple_extent_type() == self.h5py.h5s.NULL:
            return False
        size = space.get_simple_extent_npoints() * dataset.get_type().get_size()
        self.sizes[self.h5py.h5o.get_info(dataset).addr] = size
        self.file.check_unpacked(sum(self.sizes.values()))
        return True

    def _elsewhere(self, place: str, what: str) -> DataError:
        cure = "other files are not read through this one: save the data in one file"
        return DataError(f"{shown(place, 100)} is {what}", self.source, cure)


def _refuse_endless_heaps(content: bytes | mmap.mmap) -> None:
    """Raises ValueError if libhdf5 would walk for ever through a heap of texts whose objects have no size."""
    start = content.find(HEAP)
    while start >= 0:
        size = int.from_bytes(content[start + 8 : start + 16], "little")
        end, at = start + size, start + 16
        while size >= 4096 and end <= len(content) and at + 16 <= end:
            index = int.from_bytes(content[at : at + 2], "little")
            length = int.from_bytes(content[at + 8 : at + 16], "little")
            step = 16 + -(-length // 8) * 8 if index else length
            if step == 0 or at + step > end:
                raise ValueError("an object of a heap has a wrong size")
            at += step
        start = content.find(HEAP, start + 8)


def _variable(name: str, item: Any) -> dict[str, Any]:
    """A dataset of numbers as a variable; complex numbers of MATLAB are pairs of fields."""
    if item.dtype.names:
        if set(item.dtype.names) == {"real", "imag"}:
            value = item[()]
            return {name: value["real"] + 1j * value["imag"]}
        if item.ndim == 1:  # a table
            return {field: item[field] for field in item.dtype.names if item.dtype[field].kind in "fiub"}
        return {}
    if item.dtype.kind not in "fiubc" or item.size == 0 or "MATLAB_empty" in item.attrs:
        return {}
    kind = "MATLAB_class"
    if kind in item.attrs and not _is_sequence(item, kind) and item.attrs[kind] in (b"char", b"cell"):
        return {}
    if item.dtype.kind in "fiub" and max(item.shape, default=0) == item.size >= LONG:
        return {name: Streamed(item.size, partial(_pieces, item, item.shape.index(item.size)))}
    return {name: item[()]}


def _pieces(item: Any, axis: int) -> Iterator[Any]:
    """A dataset with one long axis."""
    for at in range(0, item.size, PIECE):
        yield item[tuple(slice(at, at + PIECE) if k == axis else 0 for k in range(item.ndim))]


def _scalars(item: Any) -> dict[str, Any]:
    """Attributes that are single numbers."""
    scalars: dict[str, Any] = {}
    for name in item.attrs:
        if _is_sequence(item, name):
            continue
        attribute = item.attrs.get_id(name)
        if attribute.dtype.kind in "fiu" and attribute.get_space().get_simple_extent_npoints() == 1:
            scalars[name] = np.asarray(item.attrs[name]).ravel()[0]
    return scalars


def _is_sequence(item: Any, name: str) -> bool:
    """Whether an attribute is a sequence of any length, as which libhdf5 takes some damaged texts, and dies of them."""
    return bool(item.attrs.get_id(name).get_type().get_class() == 9)  # H5T_VLEN


def _unit(item: Any) -> str | None:
    for name in UNITS:
        if name not in item.attrs:
            continue
        if _is_sequence(item, name):
            raise ValueError("a unit is not text")
        value = item.attrs[name]
        if isinstance(value, bytes):
            return value.decode("utf-8", errors="replace")
        if isinstance(value, str):
            return value
    return None
