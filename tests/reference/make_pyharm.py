"""Harmonics of nonlinear rigs by pyHarm (Safran, Apache licence), an independent code of harmonic balance.

pyHarm asks for older packages than dashpot's own, so it runs in an environment of its own:

    python3 -m venv pyharm && pyharm/bin/pip install pyharm-os==1.2.2 "jax<0.6" "pandas<3"
    pyharm/bin/python tests/reference/make_pyharm.py > tests/reference/pyharm.json

The rig: masses 3 and 2.7 kg, springs 4600 N/m and dampers 20 N s/m from x1 to x2 and from x2 to the ground, a force at
x1, and one nonlinear element from x2 to the ground.  Smoothed friction is no element of pyHarm: it is added as one.
"""

import contextlib
import io
import json
import sys

import numpy as np

M = np.diag([3.0, 2.7])
CHAIN = np.array([[1.0, -1.0], [-1.0, 2.0]])
ORDERS, INSTANTS = 9, 512
FREQUENCIES = [2.0, 4.0, 6.5, 9.0]
FORCE = 6.0  # N, cosine
CASES = {
    "cubic": {"type": "CubicSpring", "k": 1e9},
    "jenkins": {"type": "Jenkins", "k": 4000.0, "mu": 1.0, "N0": 2.0},
    "coulomb": {"type": "SmoothFriction", "k": 2.0, "v0": 0.03},
    "gap": {"type": "PenaltyBilateralGap", "k": 6000.0, "g": 5e-4},
    "one-sided": {"type": "PenaltyUnilateralGap", "k": 6000.0, "g": 3e-4},
}
RAMP = np.linspace(0.1, 1.0, 10)


def harmonics(element: dict[str, object], frequency: float) -> list[list[list[float]]]:
    """Real and imaginary parts of X at orders 0 … 9 of x1 and x2, for x(t) = Re Σ X exp(j h ω t)."""
    from pyHarm.Maestro import Maestro

    plugins = [smooth_friction()] if element["type"] == "SmoothFriction" else []
    place = {"connect": {"rig": [1]}, "dirs": [0]}
    rig = {
        "plugin": plugins,
        "system": {"type": "Base", "nh": ORDERS, "nti": INSTANTS},
        "substructures": {
            "rig": {
                "matrix": {"M": M, "K": 4600 * CHAIN, "C": 20 * CHAIN, "G": 0 * M},
                "ndofs": 1,
                "nnodes": 2,
            }
        },
        "connectors": {
            "q": {**element, **place},
            "f": {"type": "CosinusForcing", "connect": {"rig": [0]}, "dirs": [0], "amp": FORCE},
        },
    }
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        system = Maestro(rig).system
        force = next(e for e in system.LE if e.flag_extforcing)
        x, omega = np.zeros(system.ndofs_solve), 2 * np.pi * frequency
        for share in RAMP:
            force.amp = share * FORCE
            x = solved(system, x, omega)
    dofs = system.expl_dofs
    shown = []
    for node in (0, 1):
        of_node = x[np.sort(dofs[dofs["node_num"] == node].index)]
        pairs = [(of_node[0], 0.0), *((a, -b) for a, b in of_node[1:].reshape(-1, 2))]
        shown.append([[float(f"{part:.11g}") for part in pair] for pair in pairs])
    return shown


def solved(system, x, omega):
    """Newton's method on pyHarm's residual with pyHarm's slopes, halved where it grows."""
    at = np.append(x, omega)
    left = system.Residual(at)
    for _ in range(200):
        step = np.linalg.solve(system.Jacobian(at)[0], left)
        share = 1.0
        while share > 1e-4:
            there = np.append(at[:-1] - share * step, omega)
            new = system.Residual(there)
            if np.linalg.norm(new) <= np.linalg.norm(left) or np.max(np.abs(step)) < 1e-12:
                break
            share /= 2
        at, left = there, new
        if np.max(np.abs(step)) < 1e-14:
            return at[:-1]
    raise RuntimeError(f"no response at {omega / 6.2832:g} Hz: {np.max(np.abs(step)):g}")


def smooth_friction():
    """k tanh(v/v0) as an element of pyHarm, with its own transforms and rates."""
    from pyHarm.Elements.NodeToNodeElements.NodeToNodeElement import NodeToNodeElement

    class SmoothFriction(NodeToNodeElement):
        factory_keyword = "SmoothFriction"

        def __post_init__(self):
            self.k, self.v0 = self.data["k"], self.data["v0"]

        def __flag_update__(self):
            self.flag_nonlinear = self.flag_AFT = True

        def adim(self, lc, wc):
            raise NotImplementedError

        def _place(self):
            return self.Pdir[0] @ (self.Pslave - self.Pmaster)

        def evalResidual(self, xg, om):
            v = (om * self.nabla @ self._place() @ xg[self.indices]) @ self.D["ft"]
            return self._place().T @ (self.k * np.tanh(v / self.v0) @ self.D["tf"])

        def evalJacobian(self, xg, om):
            P = self._place()
            to_rate = om * (self.nabla @ P).T @ self.D["ft"]
            slope = self.k / self.v0 / np.cosh(xg[self.indices] @ to_rate / self.v0) ** 2
            self.J = P.T @ (self.D["tf"].T @ (slope[:, None] * to_rate.T))
            self.dJdom = np.zeros(len(self.indices))
            return self.J, self.dJdom

    return SmoothFriction


if __name__ == "__main__":
    table = {name: [harmonics(element, f) for f in FREQUENCIES] for name, element in CASES.items()}
    lines = [f'  "{name}": {json.dumps(rows)}' for name, rows in table.items()]
    sys.stdout.write(f'{{"frequency_hz": {FREQUENCIES}, "force": {FORCE}, "x1_x2_by_case": {{\n')
    sys.stdout.write(",\n".join(lines) + "\n}}\n")
