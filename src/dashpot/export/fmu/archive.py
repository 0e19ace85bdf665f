"""The archive of a functional mock-up unit: description, sources and, where a compiler is found, a binary."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from importlib.resources import files
from io import BytesIO

import numpy as np

from dashpot.errors import UsageError
from dashpot.export.fmu.description import SOURCE, build_description, model_description
from dashpot.export.fmu.tables import c_tables
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.state_space import SUFFIXES, StateSpace, state_space_of
from dashpot.io.atomic import write_bytes
from dashpot.io.scratch import scratch

STEPS_PER_PERIOD = 100  # of the fastest mode, of the step size that the description proposes
COMPILERS = ("cc", "gcc", "clang")
TIME_LIMIT = 120  # s, of the compiler


def write_fmu(
    rig: IdentifiedRig,
    path: str | os.PathLike[str],
    given: str | Mapping[str, str] | None = None,
    *,
    compiled: bool = True,
) -> bool:
    """Write the rig as an FMI 3.0 unit for co-simulation; whether it holds a binary for this platform.

    `given` as of `state_space_of`.  Raises ModelError and UsageError as it does, DataError where it cannot be written.
    """
    rig.require_viscous("an FMU")
    system = state_space_of(rig, given)
    identifier = _identifier(rig.model.name)
    orders = np.array([
        SUFFIXES.index(port.name.removeprefix(name))
        for port, name in zip(system.inputs, rig.model.displacement_inputs, strict=False)
    ], dtype=np.int64)  # fmt: skip
    unsigned = c_tables(rig, orders, "") + model_description(rig, system, identifier, "", 1.0)
    token = hashlib.sha256(unsigned.encode()).hexdigest()[:32]
    contents: dict[str, bytes] = {
        "modelDescription.xml": model_description(rig, system, identifier, token, _step(system)).encode(),
        f"sources/{SOURCE}": files("dashpot.export.fmu").joinpath(SOURCE).read_bytes(),
        "sources/rig.h": c_tables(rig, orders, token).encode(),
        "sources/buildDescription.xml": build_description(identifier).encode(),
    }
    binary = _compiled(contents) if compiled else None
    if binary is not None:
        contents[f"binaries/{_platform()}/{identifier}{_extension()}"] = binary
    write_bytes(path, _packed(contents))
    return binary is not None


def _step(system: StateSpace) -> float:
    fastest = float(np.max(np.abs(np.linalg.eigvals(system.A)), initial=0.0))
    return float(f"{2 * np.pi / fastest / STEPS_PER_PERIOD:.1g}") if fastest > 0 else 0.01


def _identifier(name: str) -> str:
    """The rig's name as a name of C."""
    text = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_")[:60]
    return text if re.match(r"[A-Za-z]", text) else f"rig_{text}".rstrip("_")


def _packed(contents: Mapping[str, bytes]) -> bytes:
    """A zip archive; the same contents give the same bytes."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return out.getvalue()


def _platform() -> str:
    """FMI's name of this platform, such as x86_64-linux."""
    machine = platform.machine().lower()
    processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    system = "windows" if sys.platform == "win32" else "darwin" if sys.platform == "darwin" else "linux"
    return f"{processor}-{system}"


def _extension() -> str:
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def _compiled(contents: Mapping[str, bytes]) -> bytes | None:
    """The shared library; None where there is no compiler.  Raises UsageError where it refuses the source."""
    compiler = next(
        filter(None, (shutil.which(name) for name in (os.environ.get("CC", ""), *COMPILERS) if name)), None
    )
    if compiler is None:
        return None
    with scratch() as between:
        for name in (SOURCE, "rig.h"):
            between.write(name, contents[f"sources/{name}"])
        command = [compiler, "-std=c99", "-O2", "-shared", "-o", "unit", SOURCE]
        command += [] if sys.platform == "win32" else ["-fPIC", "-lm"]
        try:
            done = subprocess.run(
                command, cwd=between.folder, capture_output=True, text=True, timeout=TIME_LIMIT, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise _refused(compiler, str(error)) from None
        if done.returncode:
            raise _refused(compiler, done.stderr)
        return between.read("unit")


def _refused(compiler: str, text: str) -> UsageError:
    first = " ".join(text.split())[:200]
    return UsageError(
        f"{compiler} does not compile the FMU ({first})",
        cure="set CC to a C compiler, or leave the binary out",
    )
