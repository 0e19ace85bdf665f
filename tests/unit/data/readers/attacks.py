"""Files made to harm the reader: what each is called, how it is written, and the decisive words of its refusal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SECRET = b"a local file that no data file may show\n"


def _hdf5(path: Path, fill: Callable[[Any, Path], None], userblock: bytes = b"") -> None:
    """Two sound columns and what `fill` adds; a user block such as MATLAB writes."""
    import h5py

    with h5py.File(path, "w", userblock_size=512 if userblock else 0) as file:
        file["time_s"], file["x1"] = np.arange(32) / 128, np.arange(32.0)
        fill(file, path)
    if userblock:
        with path.open("r+b") as raw:
            raw.write(userblock.ljust(512, b" "))


def _other(path: Path) -> Path:
    """An HDF5 file beside the one that attacks."""
    import h5py

    other = path.with_name("other.bin")
    with h5py.File(other, "w") as file:
        file["u"] = np.arange(32.0)
    return other


def _external_storage(file: Any, path: Path) -> None:
    other = path.with_name("secret.bin")
    other.write_bytes(SECRET)
    file.create_dataset("u", (32,), "u1", external=[(str(other), 0, 32)])


def _external_link(file: Any, path: Path) -> None:
    import h5py

    file["u"] = h5py.ExternalLink(str(_other(path)), "/u")


def _link_through_link(file: Any, path: Path) -> None:
    import h5py

    file.create_group("#refs#")["far"] = h5py.ExternalLink(str(_other(path)), "/")
    file["u"] = h5py.SoftLink("/#refs#/far/u")


def _virtual(file: Any, path: Path) -> None:
    import h5py

    layout = h5py.VirtualLayout((32,), "f8")
    layout[:] = h5py.VirtualSource(str(_other(path)), "u", (32,))
    file.create_virtual_dataset("u", layout)


def _nested(file: Any, _: Path) -> None:
    for _ in range(1000):
        file = file.create_group("g")


def _cycle(file: Any, _: Path) -> None:
    file["a/b/c/d"] = file["/"]
    file["a/e"], file["a/b/f"] = file["a"], file["a"]


def _loop(file: Any, _: Path) -> None:
    import h5py

    file["u"], file["v"] = h5py.SoftLink("/v"), h5py.SoftLink("/u")


def _empty(file: Any, _: Path) -> None:
    import h5py

    file["u"] = h5py.Empty("f8")


def _bomb(file: Any, _: Path) -> None:
    file.create_dataset("u", (1 << 32,), "f8", chunks=(1 << 16,), compression="gzip")


MATLAB_73 = b"MATLAB 7.3 MAT-file, Platform: GLNXA64"
READS_ANOTHER = {
    "external storage": _external_storage,
    "external link": _external_link,
    "link through a link": _link_through_link,
    "virtual dataset": _virtual,
}
ATTACKS = READS_ANOTHER | {
    "groups within groups": _nested,
    "hard links in a cycle": _cycle,
    "soft links in a loop": _loop,
    "no dataspace": _empty,
    "bomb": _bomb,
}


def write_hdf5(path: Path, attack: str) -> None:
    """One of ATTACKS, as MATLAB 7.3 writes files where the name ends so."""
    _hdf5(path, ATTACKS[attack], MATLAB_73 if path.suffix == ".mat" else b"")
