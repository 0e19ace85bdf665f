"""modelDescription.xml and buildDescription.xml of a functional mock-up unit (FMI 3.0)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

from dashpot.errors import printable
from dashpot.export.fmu.tables import root_elements
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.state_space import StateSpace
from dashpot.units import si_unit

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
        *_structure(every),
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
        f"name={quoteattr(variable.name)}", f'valueReference="{reference}"', f'causality="{variable.causality}"',
        f'variability="{variable.variability}"', f"description={quoteattr(variable.text)}",
    ]  # fmt: skip
    if variable.unit in BASES:
        attributes.append(f"unit={quoteattr(variable.unit or '')}")
    if variable.start is not None:
        attributes.append(f'start="{variable.start!r}"')
    return f"    <Float64 {' '.join(attributes)}/>"


def _structure(every: Sequence[Variable]) -> list[str]:
    outputs = [reference for reference, variable in enumerate(every) if variable.causality == "output"]
    return [f'    <Output valueReference="{reference}"/>' for reference in outputs] + [
        f'    <InitialUnknown valueReference="{reference}"/>' for reference in outputs
    ]


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
