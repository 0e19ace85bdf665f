"""A rig as a functional mock-up unit (FMI 3.0): description, sources and, where a compiler is found, a binary."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from io import BytesIO
from typing import Any

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.channel import MOTIONS
from dashpot.errors import UsageError, printable
from dashpot.export.formats import ExportOptions, Written, distinct, xml_tag
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.state_space import DERIVATIVES, StateSpace, state_space_of
from dashpot.io.atomic import scratch, write_bytes
from dashpot.model.observation import observation_model
from dashpot.units import SI_DIMENSIONS, si_unit

SOURCE = "dashpot_fmu.c"
COMPILERS = ("cc", "gcc", "clang")


def write_fmu(rig: IdentifiedRig, path: str | os.PathLike[str], options: ExportOptions) -> Written:
    """Write the rig as a unit for co-simulation, with a binary for this platform where `options` want one.

    Raises ModelError and UsageError as `state_space_of`, DataError if it cannot be written.
    """
    rig.require_viscous("an FMU")
    system = state_space_of(rig, options.given)
    text = re.sub(r"[^A-Za-z0-9_]+", "_", rig.model.name).strip("_")[:60]
    identifier = text if re.match(r"[A-Za-z]", text) else f"rig_{text}".rstrip("_")
    unsigned = c_tables(rig, system, "") + model_description(rig, system, identifier, "", 1.0)
    token = hashlib.sha256(unsigned.encode()).hexdigest()[:32]
    fastest = float(np.max(np.abs(np.linalg.eigvals(system.A)), initial=0.0))
    step_s = float(f"{2 * np.pi / fastest / 100:.1g}") if fastest > 0 else 0.01  # 100 in a period
    build = xml_tag("SourceFileSet", {"language": "C99"}, xml_tag("SourceFile", {"name": SOURCE}))
    contents: dict[str, bytes] = {
        "modelDescription.xml": model_description(rig, system, identifier, token, step_s).encode(),
        f"sources/{SOURCE}": files("dashpot.export").joinpath(SOURCE).read_bytes(),
        "sources/rig.h": c_tables(rig, system, token).encode(),
        "sources/buildDescription.xml": (
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            '<fmiBuildDescription fmiVersion="3.0">\n'
            f'  <BuildConfiguration modelIdentifier="{identifier}">\n'
            f"    {build}\n"
            "  </BuildConfiguration>\n"
            "</fmiBuildDescription>\n"
        ).encode(),
    }
    binary = _compiled(contents) if options.compiled else None
    if binary is not None:
        machine = platform.machine().lower()
        processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
        system_name, ending = {"win32": ("windows", ".dll"), "darwin": ("darwin", ".dylib")}.get(
            sys.platform, ("linux", ".so")
        )
        contents[f"binaries/{processor}-{system_name}/{identifier}{ending}"] = binary
    out = BytesIO()  # entries without a time: the same contents give the same bytes
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    write_bytes(path, out.getvalue())
    return Written((os.fspath(path),), binary is not None)


def root_elements(rig: IdentifiedRig) -> list[int]:
    """Elements whose parameters are not tied to another's, in order."""
    return [i for i, tie in enumerate(rig.model.ties) if tie.root == i]


def c_tables(rig: IdentifiedRig, system: StateSpace, token: str) -> str:
    """The header rig.h: sizes, incidences, laws, channels and the parameters' values."""
    model = rig.model
    view = observation_model(model, rig.outputs, np.zeros(1))
    roots = root_elements(rig)
    orders = [MOTIONS.index(port.quantity) for port in system.inputs if port.quantity in MOTIONS]
    sizes = {
        "N": model.n,
        "R": len(orders),
        "S": model.S.shape[1],
        "E": len(model.elements),
        "ROOTS": len(roots),
        "O": len(rig.outputs),
        "LOWER": sum(orders),
    }
    tables: dict[str, Real | Ints | Sequence[float]] = {
        "int order_of[SOME(R)]": orders,
        "int power_of[E]": [DERIVATIVES[element.law.matrix] for element in model.elements],
        "int root_of[E]": [roots.index(tie.root) for tie in model.ties],
        "double times_of[E]": [tie.times for tie in model.ties],
        "double default_of[ROOTS]": rig.p[roots],
        "double along_x[E][N]": model.B,
        "double along_u[E][SOME(R)]": model.D,
        "double force_at[N][SOME(S)]": model.S,
        "int derivative_of[O]": view.derivative,
        "double on_x[O][N]": view.on_x,
        "double on_q[O][SOME(R + S)]": view.on_q,
        "double on_force[O][E]": view.force,
    }
    lines = ["/* One rig: sizes, elements, channels, parameters in SI units. */", f'#define TOKEN "{token}"']
    lines += [f"#define {name} {size}" for name, size in sizes.items()]
    for declared, values in tables.items():
        array = np.asarray(values)
        if not array.size:  # C has no empty arrays
            array = np.zeros((*array.shape[:-1], 1), dtype=float if declared.startswith("double") else int)
        lines.append(f"static const {declared} = {_braces(array)};")
    return "\n".join(lines) + "\n"


def _braces(values: np.ndarray[Any, Any]) -> str:
    if values.ndim == 1:
        return "{" + ", ".join(repr(value) for value in values.tolist()) + "}"
    return "{" + ",\n  ".join(_braces(row) for row in values) + "}"


@dataclass(frozen=True)
class Variable:
    """A variable of the unit: causality and variability as FMI has them; `start` where it may be set."""

    name: str
    causality: str
    variability: str
    unit: str | None
    text: str
    start: float | None = None


def variables(rig: IdentifiedRig, system: StateSpace) -> list[Variable]:
    """All variables in the order of their value references, from 0 on: time, inputs, slopes, outputs, parameters,
    starts of the states.  Names are made different by a number behind them."""
    model, n = rig.model, rig.model.n
    listed = [Variable("time", "independent", "continuous", "s", "Time")]
    for port in system.inputs:
        text = f"{port.quantity.capitalize()} given to the rig"
        listed.append(Variable(port.name, "input", "continuous", port.unit, text, 0.0))
    for port in system.inputs:
        text = f"How fast {port.name} goes on rising during the next step (0: it is held)"
        listed.append(Variable(f"{port.name}_slope", "input", "continuous", None, text, 0.0))
    for port in system.outputs:
        listed.append(Variable(port.name, "output", "continuous", port.unit, port.quantity.capitalize()))
    sd = np.abs(model.T) @ np.sqrt(np.diagonal(rig.covariance))
    for i in root_elements(rig):
        element = model.elements[i]
        text = str(element.kind).capitalize() + (f", standard deviation {sd[i]:.3g}" if sd[i] > 0 else "")
        unit = model.unit(element)
        listed.append(Variable(element.name, "parameter", "fixed", unit, text, float(rig.p[i])))
    for k, name in enumerate(system.states):
        rate = n <= k < 2 * n or (k >= 2 * n and name not in model.displacement_inputs)
        quantity = "velocity" if rate else "displacement"
        angular = (name.removesuffix("_rate") if rate else name) in model.angles
        text, unit = f"{quantity.capitalize()} at the start", si_unit(quantity, angular)
        listed.append(Variable(f"{name}_start", "parameter", "fixed", unit, text, 0.0))
    names = distinct(printable(variable.name) for variable in listed)
    return [replace(variable, name=name) for variable, name in zip(listed, names, strict=True)]


def model_description(
    rig: IdentifiedRig, system: StateSpace, identifier: str, token: str, step_s: float
) -> str:
    """The text of modelDescription.xml."""
    every = variables(rig, system)
    units = dict.fromkeys(v.unit for v in every if v.unit is not None and v.unit in SI_DIMENSIONS)
    head = {
        "fmiVersion": "3.0",
        "modelName": printable(rig.model.name or identifier),
        "instantiationToken": token,
        "generationTool": "dashpot",
        "variableNamingConvention": "flat",
        "description": (
            "Linear vibrating rig; inputs are extrapolated by their slopes during a step, which "
            "makes the step exact"
        ),
    }
    simulation = {
        "modelIdentifier": identifier,
        "canHandleVariableCommunicationStepSize": "true",
        "canGetAndSetFMUState": "true",
    }
    outputs = [str(reference) for reference, variable in enumerate(every) if variable.causality == "output"]
    described = []
    for reference, variable in enumerate(every):
        attributes = {
            "name": variable.name,
            "valueReference": reference,
            "causality": variable.causality,
            "variability": variable.variability,
            "description": variable.text,
            "unit": variable.unit if variable.unit in SI_DIMENSIONS else None,
            "start": variable.start,
        }
        described.append(f"    {xml_tag('Float64', attributes)}")
    definitions = []
    for unit in units:
        m, kg, s, rad, *_ = SI_DIMENSIONS[unit]
        powers = {"kg": kg or None, "m": m or None, "s": s or None, "rad": rad or None}
        definitions.append(f"    {xml_tag('Unit', {'name': unit}, xml_tag('BaseUnit', powers))}")
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        xml_tag("fmiModelDescription", head, "").removesuffix("</fmiModelDescription>"),
        f"  {xml_tag('CoSimulation', simulation)}",
        "  <UnitDefinitions>",
        *definitions,
        "  </UnitDefinitions>",
        f"  {xml_tag('DefaultExperiment', {'startTime': '0', 'stepSize': repr(step_s)})}",
        "  <ModelVariables>",
        *described,
        "  </ModelVariables>",
        "  <ModelStructure>",
        *(f"    {xml_tag('Output', {'valueReference': reference})}" for reference in outputs),
        *(f"    {xml_tag('InitialUnknown', {'valueReference': reference})}" for reference in outputs),
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def _compiled(contents: Mapping[str, bytes]) -> bytes | None:
    """The shared library; None if there is no compiler.  Raises UsageError if it refuses the source."""
    named = [os.environ["CC"]] if os.environ.get("CC") else []
    compiler = next(filter(None, map(shutil.which, [*named, *COMPILERS])), None)
    if compiler is None:
        return None
    with scratch() as between:
        for name in (SOURCE, "rig.h"):
            between.write(name, contents[f"sources/{name}"])
        command = [compiler, "-std=c99", "-O2", "-shared", "-o", "unit", SOURCE]
        command += [] if sys.platform == "win32" else ["-fPIC", "-lm"]
        try:
            subprocess.run(  # at most two minutes
                command, cwd=between.folder, capture_output=True, text=True, timeout=120, check=True
            )
        except (OSError, subprocess.SubprocessError) as error:
            said = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
            raise UsageError(
                f"{compiler} does not compile the FMU ({' '.join(said.split())[:200]})",
                cure="set CC to a C compiler, or leave the binary out",
            ) from None
        return between.read("unit")
