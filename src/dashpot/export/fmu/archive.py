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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.errors import UsageError, printable
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.state_space import DERIVATIVES, SUFFIXES, StateSpace, state_space_of
from dashpot.io.atomic import scratch, write_bytes
from dashpot.model.observation import observation_model
from dashpot.units import si_unit

# The tables of a rig for the C source of its functional mock-up unit.


def root_elements(rig: IdentifiedRig) -> list[int]:
    """Elements whose parameters are not tied to another's, in order."""
    return [i for i, tie in enumerate(rig.model.ties) if tie.root == i]


def c_tables(rig: IdentifiedRig, orders: Ints, token: str) -> str:
    """The header rig.h: sizes, incidences, laws, channels and the parameters' values.

    orders (elements,): powers of jω.
    """
    model = rig.model
    view = observation_model(model, rig.outputs, np.zeros(1))
    roots = root_elements(rig)
    r, s = len(orders), model.S.shape[1]
    sizes = {
        "N": model.n, "R": r, "S": s, "E": len(model.elements), "ROOTS": len(roots), "O": len(rig.outputs),
        "LOWER": int(np.sum(orders)),
    }  # fmt: skip
    power = [DERIVATIVES[element.law.matrix] for element in model.elements]
    lines = ["/* One rig: sizes, elements, channels, parameters in SI units. */", f'#define TOKEN "{token}"']
    lines += [f"#define {name} {size}" for name, size in sizes.items()]
    lines += [
        _table("int", "order_of[SOME(R)]", orders),
        _table("int", "power_of[E]", power),
        _table("int", "root_of[E]", [roots.index(tie.root) for tie in model.ties]),
        _table("double", "times_of[E]", [tie.times for tie in model.ties]),
        _table("double", "default_of[ROOTS]", rig.p[roots]),
        _table("double", "along_x[E][N]", model.B),
        _table("double", "along_u[E][SOME(R)]", _some(model.D)),
        _table("double", "force_at[N][SOME(S)]", _some(model.S)),
        _table("int", "derivative_of[O]", view.derivative),
        _table("double", "on_x[O][N]", view.on_x),
        _table("double", "on_q[O][SOME(R + S)]", _some(view.on_q)),
        _table("double", "on_force[O][E]", view.force),
    ]
    return "\n".join(lines) + "\n"


def _some(table: Real) -> Real:
    """The table with one column of zeros where it has none: C has no empty arrays."""
    return table if table.shape[1] else np.zeros((len(table), 1))


def _table(kind: str, declared: str, values: Real | Ints | Sequence[float]) -> str:
    array = np.asarray(values)
    return f"static const {kind} {declared} = {_braces(array if array.size else np.zeros(1, dtype=int))};"


def _braces(values: np.ndarray[Any, Any]) -> str:
    if values.ndim == 1:
        return "{" + ", ".join(repr(value) for value in values.tolist()) + "}"
    return "{" + ",\n  ".join(_braces(row) for row in values) + "}"


# modelDescription.xml and buildDescription.xml of a functional mock-up unit (FMI 3.0).


# Exponents of kg, m, s and rad
BASES = {
    "m": (0, 1, 0, 0), "m/s": (0, 1, -1, 0), "m/s²": (0, 1, -2, 0), "N": (1, 1, -2, 0), "rad": (0, 0, 0, 1),
    "rad/s": (0, 0, -1, 1), "rad/s²": (0, 0, -2, 1), "N·m": (1, 2, -2, 0), "kg": (1, 0, 0, 0), "s": (0, 0, 1, 0),
    "N·s/m": (1, 0, -1, 0), "N/m": (1, 0, -2, 0), "kg·m²": (1, 2, 0, 0), "N·m·s/rad": (1, 2, -1, -1),
    "N·m/rad": (1, 2, -2, -1),
}  # fmt: skip
SOURCE = "dashpot_fmu.c"
DESCRIPTION = "Linear vibrating rig; inputs go on with their slopes during a step, which is then exact"
MOTIONS = ("displacement", "velocity")


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
    model = rig.model
    listed = [Variable("time", "independent", "continuous", "s", "Time")]
    for port in system.inputs:
        text = f"{port.quantity} given to the rig"
        listed.append(Variable(port.name, "input", "continuous", port.unit, text.capitalize(), 0.0))
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
    for k, name in enumerate(_starts(rig, system)):
        quantity = MOTIONS[_derivative(rig, system, k)]
        angular = _point(rig, system, k) in model.angles
        text = f"{quantity.capitalize()} at the start"
        listed.append(Variable(name, "parameter", "fixed", si_unit(quantity, angular), text, 0.0))
    taken: set[str] = set()
    unique = []
    for variable in listed:
        name, count = printable(variable.name), 1
        while name in taken:
            count += 1
            name = f"{printable(variable.name)}_{count}"
        taken.add(name)
        unique.append(Variable(name, *list(vars(variable).values())[1:]))
    return unique


def _starts(rig: IdentifiedRig, system: StateSpace) -> list[str]:
    return [f"{name}_start" for name in system.states]


def _derivative(rig: IdentifiedRig, system: StateSpace, k: int) -> int:
    """0 where a state is a displacement, 1 where it is a velocity."""
    n = rig.model.n
    return int(k >= n) if k < 2 * n else int(system.states[k] not in rig.model.displacement_inputs)


def _point(rig: IdentifiedRig, system: StateSpace, k: int) -> str:
    n = rig.model.n
    if k < 2 * n:
        return rig.model.coordinates[k % n]
    name = system.states[k]
    return name if name in rig.model.displacement_inputs else name.removesuffix("_rate")


def model_description(
    rig: IdentifiedRig, system: StateSpace, identifier: str, token: str, step_s: float
) -> str:
    """The text of modelDescription.xml."""
    every = variables(rig, system)
    units = list(dict.fromkeys(v.unit for v in every if v.unit is not None and v.unit in BASES))
    title = quoteattr(printable(rig.model.name or identifier))
    attributes = [
        'fmiVersion="3.0"', f"modelName={title}", f'instantiationToken="{token}"', 'generationTool="dashpot"',
        'variableNamingConvention="flat"', f"description={quoteattr(DESCRIPTION)}",
    ]  # fmt: skip
    kind = 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"'
    outputs = [reference for reference, variable in enumerate(every) if variable.causality == "output"]
    structure = [f'    <Output valueReference="{reference}"/>' for reference in outputs] + [
        f'    <InitialUnknown valueReference="{reference}"/>' for reference in outputs
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<fmiModelDescription {' '.join(attributes)}>",
        f'  <CoSimulation modelIdentifier="{identifier}" {kind}/>',
        "  <UnitDefinitions>",
        *(_unit(unit) for unit in units),
        "  </UnitDefinitions>",
        f'  <DefaultExperiment startTime="0" stepSize="{step_s!r}"/>',
        "  <ModelVariables>",
        *(_variable(variable, reference) for reference, variable in enumerate(every)),
        "  </ModelVariables>",
        "  <ModelStructure>",
        *structure,
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join(lines) + "\n"


def _unit(unit: str) -> str:
    names = ("kg", "m", "s", "rad")
    powers = " ".join(f'{name}="{power}"' for name, power in zip(names, BASES[unit], strict=True) if power)
    return f"    <Unit name={quoteattr(unit)}><BaseUnit {powers}/></Unit>"


def _variable(variable: Variable, reference: int) -> str:
    attributes = [
        f"name={quoteattr(variable.name)}",
        f'valueReference="{reference}"',
        f'causality="{variable.causality}"',
        f'variability="{variable.variability}"',
        f"description={quoteattr(variable.text)}",
    ]
    if variable.unit in BASES:
        attributes.append(f"unit={quoteattr(variable.unit or '')}")
    if variable.start is not None:
        attributes.append(f'start="{variable.start!r}"')
    return f"    <Float64 {' '.join(attributes)}/>"


def build_description(identifier: str) -> str:
    """The text of buildDescription.xml: which sources make the binary."""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{identifier}">\n'
        f'    <SourceFileSet language="C99"><SourceFile name="{SOURCE}"/></SourceFileSet>\n'
        "  </BuildConfiguration>\n"
        "</fmiBuildDescription>\n"
    )


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
    text = re.sub(r"[^A-Za-z0-9_]+", "_", rig.model.name).strip("_")[:60]
    identifier = text if re.match(r"[A-Za-z]", text) else f"rig_{text}".rstrip("_")
    orders = np.array(
        [
            SUFFIXES.index(port.name.removeprefix(name))
            for port, name in zip(system.inputs, rig.model.displacement_inputs, strict=False)
        ],
        dtype=np.int64,
    )
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
    # A zip archive; the same contents give the same bytes
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    write_bytes(path, out.getvalue())
    return binary is not None


def _step(system: StateSpace) -> float:
    fastest = float(np.max(np.abs(np.linalg.eigvals(system.A)), initial=0.0))
    return float(f"{2 * np.pi / fastest / STEPS_PER_PERIOD:.1g}") if fastest > 0 else 0.01


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
