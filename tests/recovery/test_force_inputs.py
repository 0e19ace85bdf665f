"""Rigs that are shaken and pushed in separate experiments (Fritzen 1986).

Two masses of 3 and 2 kg, some 4 and 9 Hz, every parameter unknown: a measured force gives the scale that a moved base
leaves open.  Amplitudes and phases of the inputs are others at each line.  Inputs are measured exactly or with noise.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.app.cli import run
from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.data.readers import write_amplitudes
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.instrumental_variables import OptimalIV
from dashpot.estimate.method import Method
from dashpot.model.dynamics import response
from dashpot.model.rigfile import Rig as RigFile
from dashpot.model.rigfile import write_rig
from tests.networks import network
from tests.rigs import Rig, channels, covariance, noisy, perfect

D, V = Quantity.DISPLACEMENT, Quantity.VELOCITY
TRUTH = {
    "m1": 3.0, "m2": 2.0, "c1": 12.0, "c2": 8.0, "c3": 6.0, "k1": 4000.0, "k2": 3000.0, "k3": 2000.0,
}  # fmt: skip
LINES = 8
SEED = 1986


def shaken_then_pushed() -> Rig:
    """A base that moves, and a force on the first mass after that: the second half of the lines."""
    model = network(
        "x1 x2", "u f1@x1", "m1@x1 m2@x2 c1:x1-ground c2:x1-x2 c3:x2-u k1:x1-ground k2:x1-x2 k3:x2-u"
    )
    rng = np.random.default_rng(3)
    hz = np.geomspace(2.0, 13.0, LINES)
    turned = np.exp(rng.uniform(-0.7, 0.7, (LINES, 3)) + 2j * np.pi * rng.random((LINES, 3)))
    U, f, still = 0.005 * turned[:, :1], 20.0 * turned[:, 1:2], np.zeros((LINES, 1), dtype=complex)
    theta = np.array([TRUTH[unknown.name] for unknown in model.unknowns])
    return Rig(model, theta, np.tile(hz, 2), np.concatenate([U, still]), np.concatenate([still, f]))


def information(rig: Rig, data: Spectrum, lines: slice, *, exact: bool) -> Real:
    """Fisher information by central differences of the response; inputs that are noisy are unknowns of their line."""
    r = len(rig.model.displacement_inputs)
    drive = np.concatenate([rig.U, rig.f], axis=1)
    total = np.zeros((len(rig.theta), len(rig.theta)))

    def shown(line: int, theta: Real, inputs: Complex) -> Real:
        omega = rig.omega[line : line + 1]
        X = response(rig.model, rig.model.parameters(theta), omega, inputs[None, :r], inputs[None, r:])[0]
        y = np.concatenate([X, 1j * omega * X, inputs])
        return np.concatenate([y.real, y.imag])

    for line in range(*lines.indices(rig.lines)):
        q = drive.shape[1]
        columns = []
        for j, value in enumerate(rig.theta):
            step = np.zeros(len(rig.theta))
            step[j] = 1e-5 * value
            ahead, behind = (shown(line, rig.theta + s * step, drive[line]) for s in (1, -1))
            columns.append((ahead - behind) / (2 * step[j]))
        for j in range(0 if exact else 2 * q):
            step = np.zeros(q, dtype=complex)
            step[j % q] = 1.0 if j < q else 1j
            columns.append(shown(line, rig.theta, drive[line] + step) - shown(line, rig.theta, drive[line]))
        J = np.array(columns).T
        V_ = data.covariance[line]
        both = 0.5 * np.block([[V_.real, -V_.imag], [V_.imag, V_.real]])
        noisy_ = np.diagonal(both) > 0
        fisher = J[noisy_].T @ np.linalg.solve(both[np.ix_(noisy_, noisy_)], J[noisy_])
        m = len(rig.theta)
        if not exact:
            size = np.sqrt(np.diagonal(fisher))
            fisher = fisher / np.outer(size, size)
            fisher = fisher[:m, :m] - fisher[:m, m:] @ np.linalg.solve(fisher[m:, m:], fisher[m:, :m])
            fisher = fisher * np.outer(size[:m], size[:m])
        total += fisher
    return total


@pytest.mark.parametrize("inputs", [0.0, 0.02], ids=["exact", "noisy"])
@pytest.mark.parametrize("method", [OptimalIV(), MaximumLikelihood()], ids=lambda method: method.name)
def test_experiments_add_their_information(inputs: float, method: Method) -> None:
    """Shaken and pushed: shaken alone, no force says how large anything is; together all is found, and the covariance
    is the inverse of the two informations' sum, worked out by finite differences.
    """
    rig = shaken_then_pushed()
    seen = channels(rig, (D, V))
    V_ = covariance(rig, seen, 0.02, inputs=inputs, correlation=0.3 if inputs else 0.0)
    data = replace(perfect(rig, seen, V_), experiment=(np.arange(rig.lines) >= LINES).astype(int))
    parts = [information(rig, data, half, exact=not inputs) for half in (slice(0, LINES), slice(LINES, None))]
    scale = np.outer(rig.theta, rig.theta)
    lowest = [np.linalg.eigvalsh(part * scale)[0] / np.linalg.eigvalsh(part * scale)[-1] for part in parts]
    if not inputs:
        assert lowest[0] < 1e-9 < lowest[1]
    found = identify(rig.model, data, method)
    slow = np.linalg.inv(sum(parts) * scale) * scale
    np.testing.assert_allclose(found.covariance / scale, slow / scale, rtol=1e-4, atol=1e-9)


def test_the_command_line_takes_experiments_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Shaken in one file, pushed in another: the estimate of both lines together, to the last digits written."""
    monkeypatch.chdir(tmp_path)
    rig = shaken_then_pushed()
    seen = channels(rig, (D,))
    Path("rig.toml").write_text(write_rig(RigFile(rig.model, seen)), encoding="utf-8")
    V_ = covariance(rig, seen, 0.02, inputs=0.02)
    data = noisy(rig, seen, V_, np.random.default_rng([SEED, 13]))
    write_amplitudes(data.select(range(LINES)), "shaken.csv")
    write_amplitudes(data.select(range(LINES, 2 * LINES)), "pushed.csv")
    expected = identify(rig.model, data, OptimalIV())
    for method in ("oiv", "ml"):
        assert (
            run(["identify", "rig.toml", "shaken.csv", "pushed.csv", "--method", method, "--json", "-"]) == 0
        )
        parameters = json.loads(capsys.readouterr().out)["parameters"]
        for name, value, sd in zip(expected.names, expected.values, expected.sd, strict=True):
            assert parameters[name]["value"] == pytest.approx(value, abs=1e-5 * sd)
            assert parameters[name]["sd"] == pytest.approx(sd, rel=1e-5)
