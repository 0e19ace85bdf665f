"""A rig as a MuJoCo model (MJCF): bodies on slides and hinges, springs and dampers as fixed tendons.

A fixed tendon has the length Σ factor · joint, which is an element's elongation over the coordinates, and a stiffness
and a damping of its own.  The share of moved points is a force: for each displacement input the actuators u (force
G u), u_rate (F u̇) and u_acceleration (J ü), where these are not 0; for each force input one that acts as it does.

The integrator is RK4: MuJoCo's others are of the first order, 1 % off at the time step of the file, where RK4 with its
actuators held over each step is 5e-6 off, and 1e-9 where a control callback sets them at each stage.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ModelError, printable
from dashpot.export.formats import ExportOptions, Written, distinct, xml_tag
from dashpot.export.identified_rig import INSTEAD, IdentifiedRig
from dashpot.export.state_space import SUFFIXES
from dashpot.io.atomic import write_text
from dashpot.model.dynamics import matrices
from dashpot.model.modes import eigenmodes


def write_mujoco(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write the MJCF file.  Raises ModelError as `mujoco_model`, DataError if it cannot be written."""
    write_text(path, mujoco_model(rig))
    return Written((path,))


def mujoco_model(rig: IdentifiedRig) -> str:
    """The text of the MJCF file, SI units.

    Every coordinate is a slide (a hinge where it is an angle) whose mass is what masses and inerters to the ground add
    up to.  Raises ModelError for nonlinear and hysteretic elements, masses and inerters that join coordinates or moved
    points and coordinates, coordinates without mass, and negative parameters, which MuJoCo refuses.
    """
    rig.require_viscous("a MuJoCo model")
    model, parts = rig.model, matrices(rig.model, rig.p)
    for i in model.by_matrix["M"]:
        element = model.elements[i]
        if len(element.along) > 1:
            joined = ", ".join(element.along)
            raise ModelError(
                f"a MuJoCo model cannot represent {element.name}, an inertia that joins {joined}",
                cure="export an FMU (.fmu) or a state space (.mat)",
            )
    inertia = np.diagonal(parts.M).tolist()
    for name, mass in zip(model.coordinates, inertia, strict=True):
        if not mass > 0:
            raise ModelError(f"coordinate {name} has no mass, which MuJoCo needs", cure="give it one")
    joints = distinct(map(printable, model.coordinates), " ")
    elements = _elements(rig)
    loads = {
        f"{name}{suffix}": part[:, j]
        for j, name in enumerate(model.displacement_inputs)
        for suffix, part in zip(SUFFIXES, (parts.G, parts.F, parts.J), strict=True)
        if np.any(part[:, j])
    } | {name: model.S[:, j] for j, name in enumerate(model.force_inputs)}
    names = [*(name for name, _, _ in elements), *(f"{source} load" for source in loads)]
    tendons = distinct(map(printable, names), " ", joints)
    rows: list[tuple[dict[str, object], Real]] = [(law, row) for _, law, row in elements]
    rows += [({}, row) for row in loads.values()]
    fastest = float(np.max(np.abs(eigenmodes(model, rig.p).eigenvalues), initial=0.0))
    period = 2 * np.pi / fastest if fastest > 0 else np.inf
    step = min(0.002, float(f"{period / 200:.1g}"))  # s; 200 in a period, at most MuJoCo's own
    lines = [
        xml_tag("mujoco", {"model": printable(model.name or "rig")}, "").removesuffix("</mujoco>"),
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option timestep="{step!r}" integrator="RK4" gravity="0 0 0"/>',
        "  <worldbody>",
    ]
    for k, (name, mass, point) in enumerate(zip(joints, inertia, model.coordinates, strict=True)):
        lines.append(f"    {_body(name, k, mass, point in model.angles)}")
    lines += ["  </worldbody>", "  <tendon>"]
    for tendon, (law, row) in zip(tendons, rows, strict=True):
        inside = "".join(
            xml_tag("joint", {"joint": name, "coef": factor})
            for name, factor in zip(joints, row.tolist(), strict=True)
            if factor
        )
        lines.append(f"    {xml_tag('fixed', {'name': tendon, **law}, inside)}")
    lines += ["  </tendon>", "  <actuator>"]
    for source, tendon in zip(distinct(map(printable, loads), " "), tendons[len(elements) :], strict=True):
        lines.append(f"    {xml_tag('motor', {'name': source, 'tendon': tendon, 'gear': 1})}")
    lines += ["  </actuator>", "  <sensor>"]
    for name in joints:
        for kind in ("pos", "vel"):
            lines.append(f"    {xml_tag(f'joint{kind}', {'name': f'{name} {kind}', 'joint': name})}")
    lines += ["  </sensor>", "</mujoco>"]
    return "\n".join(lines) + "\n"


def _body(name: str, number: int, mass: float, turns: bool) -> str:
    """A body on its joint, with next to no inertia (kg·m²) across it, which nothing asks for."""
    across = mass if turns else 1e-6
    inertial = {"pos": "0 0 0", "mass": mass, "diaginertia": f"{across} {across} {across}"}
    inside = xml_tag("joint", {"name": name, "type": "hinge" if turns else "slide", "axis": "1 0 0"})
    inside += xml_tag("inertial", inertial) + '<geom type="box" size="0.02 0.04 0.04" mass="0"/>'
    return xml_tag("body", {"name": name, "pos": f"{0.2 * number:g} 0 0"}, inside)


def _elements(rig: IdentifiedRig) -> list[tuple[str, dict[str, object], Real]]:
    """Name, law and factors over the coordinates (n,) of each spring and damper that joins some."""
    model, found = rig.model, []
    for letter, law in (("K", "stiffness"), ("C", "damping")):
        for i in model.by_matrix[letter]:
            element, value = model.elements[i], float(rig.p[i])
            if value < 0:
                raise ModelError(f"MuJoCo takes no negative {law}, as of {element.name}", cure=INSTEAD)
            if np.any(model.B[i]):
                rest: dict[str, object] = {"springlength": 0} if letter == "K" else {}
                found.append((element.name, {law: value, **rest}, model.B[i]))
    return found
