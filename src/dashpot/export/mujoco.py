"""A rig as a MuJoCo model (MJCF): bodies on slides and hinges, springs and dampers as fixed tendons.

A fixed tendon has the length Σ factor · joint, which is an element's elongation over the coordinates, and a stiffness
and a damping of its own.  The share of moved points is a force: for each displacement input the actuators u (force
G u), u_rate (F u̇) and u_acceleration (J ü), where these are not 0; for each force input one that acts as it does.

The integrator is RK4: MuJoCo's others are of the first order, 1 % off at the time step of the file, where RK4 with its
actuators held over each step is 5e-6 off, and 1e-9 where a control callback sets them at each stage.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from xml.sax.saxutils import quoteattr

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ModelError, printable
from dashpot.export.identified_rig import INSTEAD, IdentifiedRig
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element

SMALL = 1e-6  # kg, kg·m²: inertia of a body across its joint, which nothing asks for
STEPS_PER_PERIOD = 200  # of the fastest mode


def mujoco_model(rig: IdentifiedRig) -> str:
    """The text of the MJCF file, SI units.

    Every coordinate is a slide (a hinge where it is an angle) whose mass is what masses and inerters to the ground add
    up to.  Raises ModelError for nonlinear and hysteretic elements, masses and inerters that join coordinates or moved
    points and coordinates, coordinates without mass, and negative parameters, which MuJoCo refuses.
    """
    rig.require_viscous("a MuJoCo model")
    model = rig.model
    parts = matrices(model, rig.p)
    names = _unique([*model.coordinates])
    inertia = _inertia(rig, parts.M)
    tendons, drives = _Named(names), _Named([])
    elements = list(_tendons(rig, names, tendons))
    lines = [
        f"<mujoco model={quoteattr(printable(model.name or 'rig'))}>",
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option timestep="{_time_step(rig)!r}" integrator="RK4" gravity="0 0 0"/>',
        "  <worldbody>",
        *(_body(name, k, float(mass), point in model.angles)
          for k, (name, mass, point) in enumerate(zip(names, inertia, model.coordinates, strict=True))),
        "  </worldbody>",
        "  <tendon>",
        *elements,
    ]  # fmt: skip
    actuators = []
    for source, column in _loads(rig):
        name = drives.new(source)
        tendon = tendons.new(f"{source} load")
        lines.append(_tendon(tendon, _joints(names, column), ""))
        actuators.append(f'    <motor name={quoteattr(name)} tendon={quoteattr(tendon)} gear="1"/>')
    lines += ["  </tendon>", "  <actuator>", *actuators, "  </actuator>", "  <sensor>"]
    for name in names:
        for kind in ("pos", "vel"):
            lines.append(f"    <joint{kind} name={quoteattr(f'{name} {kind}')} joint={quoteattr(name)}/>")
    lines += ["  </sensor>", "</mujoco>"]
    return "\n".join(lines) + "\n"


class _Named:
    """Names given so far, made different by a number."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._taken = set(taken)

    def new(self, name: str) -> str:
        """The name, or the name and a number."""
        unique, count = printable(name), 1
        while unique in self._taken:
            count += 1
            unique = f"{printable(name)} {count}"
        self._taken.add(unique)
        return unique


def _unique(names: Iterable[str]) -> list[str]:
    taken = _Named([])
    return [taken.new(name) for name in names]


def _inertia(rig: IdentifiedRig, M: Real) -> Real:
    """Mass or moment of inertia of each coordinate.  Raises ModelError where masses join coordinates."""
    model = rig.model
    for i in model.by_matrix["M"]:
        element = model.elements[i]
        if len(element.along) > 1:
            cause = (
                f"a MuJoCo model cannot hold {element.name}, an inertia that joins {', '.join(element.along)}"
            )
            raise ModelError(cause, cure="export an FMU (.fmu) or a state space (.mat)")
    inertia: Real = np.diagonal(M)
    for name, mass in zip(model.coordinates, inertia, strict=True):
        if not mass > 0:
            raise ModelError(f"coordinate {name} has no mass, which MuJoCo needs", cure="give it one")
    return inertia


def _body(name: str, number: int, mass: float, turns: bool) -> str:
    text = quoteattr(name)
    if turns:
        inertial = f'mass="{mass!r}" diaginertia="{mass!r} {mass!r} {mass!r}"'
        joint = f'<joint name={text} type="hinge" axis="1 0 0"/>'
    else:
        inertial = f'mass="{mass!r}" diaginertia="{SMALL} {SMALL} {SMALL}"'
        joint = f'<joint name={text} type="slide" axis="1 0 0"/>'
    shape = '<geom type="box" size="0.02 0.04 0.04" mass="0"/>'
    at = f'pos="{0.2 * number:g} 0 0"'
    return f'    <body name={text} {at}>{joint}<inertial pos="0 0 0" {inertial}/>{shape}</body>'


def _tendons(rig: IdentifiedRig, names: list[str], taken: _Named) -> Iterator[str]:
    """A tendon for each spring and damper that joins coordinates."""
    model = rig.model
    for letter, law in (("K", "stiffness"), ("C", "damping")):
        for i in model.by_matrix[letter]:
            element, value = model.elements[i], float(rig.p[i])
            if value < 0:
                raise ModelError(f"MuJoCo takes no negative {law}, as of {element.name}", cure=INSTEAD)
            if np.any(model.B[i]):
                rest = ' springlength="0"' if letter == "K" else ""
                yield _tendon(
                    taken.new(_label(element)), _joints(names, model.B[i]), f' {law}="{value!r}"{rest}'
                )


def _label(element: Element) -> str:
    return element.name


def _tendon(name: str, joints: str, attributes: str) -> str:
    return f"    <fixed name={quoteattr(name)}{attributes}>{joints}</fixed>"


def _joints(names: list[str], factors: Real) -> str:
    return "".join(
        f'<joint joint={quoteattr(name)} coef="{float(factor)!r}"/>'
        for name, factor in zip(names, factors, strict=True)
        if factor
    )


def _loads(rig: IdentifiedRig) -> Iterator[tuple[str, Real]]:
    """Name and load on the coordinates, (n,), of each actuator."""
    model = rig.model
    parts = matrices(model, rig.p)
    for j, name in enumerate(model.displacement_inputs):
        for suffix, part in (("", parts.G), ("_rate", parts.F), ("_acceleration", parts.J)):
            if np.any(part[:, j]):
                yield f"{name}{suffix}", part[:, j]
    for j, name in enumerate(model.force_inputs):
        yield name, model.S[:, j]


def _time_step(rig: IdentifiedRig) -> float:
    from dashpot.model.modes import modes

    fastest = float(np.max(np.abs(modes(rig.model, rig.p).eigenvalues), initial=0.0))
    return min(0.002, float(f"{2 * np.pi / fastest / STEPS_PER_PERIOD:.1g}")) if fastest > 0 else 0.002
