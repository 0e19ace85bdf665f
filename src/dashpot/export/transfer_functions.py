"""Transfer functions of identified rigs: poles, zeros and gains, polynomials, and responses over frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real, frozen
from dashpot.channel import Channel
from dashpot.data.readers.text import write_rows
from dashpot.errors import UsageError
from dashpot.export.formats import ExportOptions, Written
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.state_space import Port, StateSpace, state_space_of
from dashpot.io.atomic import write_text
from dashpot.io.json_document import optional_library, to_json
from dashpot.model.dynamics import no_steady_response
from dashpot.model.observation import channel_unit, input_channels, observation_model, transfer
from dashpot.model.rigfile.rig import is_electrical


@dataclass(frozen=True)
class TransferFunctions:
    """H_ij(s) = gain_ij Π (s − zero) / Π (s − pole) from input j to output i, all over the same poles.

    name             of the rig
    inputs, outputs  as of the state space
    poles            (K,), 1/s
    zeros            (any number,), 1/s, of output i and input j as zeros[i][j]
    gain             (outputs, inputs)
    """

    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    poles: Complex
    zeros: tuple[tuple[Complex, ...], ...]
    gain: Real

    @property
    def denominator(self) -> Real:
        """Coefficients of the denominator, (order + 1,), highest power of s first."""
        return np.real(np.poly(self.poles))

    def numerator(self, output: int, source: int) -> Real:
        """Coefficients of a numerator, (order + 1,) or fewer, highest power of s first."""
        numerator: Real = self.gain[output, source] * np.real(np.poly(self.zeros[output][source]))
        return np.atleast_1d(numerator)

    def response(self, omega: Real) -> Complex:
        """H(jω) at ω (lines,), rad/s; (lines, outputs, inputs)."""
        s = 1j * np.asarray(omega)[:, None]
        below = s - self.poles
        H = np.empty((len(s), *self.gain.shape), dtype=complex)
        for (i, j), gain in np.ndenumerate(self.gain):
            zeros = self.zeros[i][j]
            # Poles and zeros in pairs, so that neither product leaves the range of numbers.
            ratio = np.ones_like(below)
            ratio[:, : len(zeros)] = s - zeros
            H[:, i, j] = gain * np.prod(ratio / below, axis=-1)
        return H

    def to_json(self) -> str:
        """Poles, zeros, gains and polynomials as JSON; complex numbers are [re, im]."""
        rows = [
            {
                "output": seen.name,
                "input": source.name,
                "gain": float(self.gain[i, j]),
                "zeros": _pairs(self.zeros[i][j]),
                "numerator": self.numerator(i, j).tolist(),
            }
            for i, seen in enumerate(self.outputs)
            for j, source in enumerate(self.inputs)
        ]
        content: dict[str, Any] = {
            "dashpot": "transfer functions",
            "model": self.name,
            "inputs": [vars(port) for port in self.inputs],
            "outputs": [vars(port) for port in self.outputs],
            "poles": _pairs(self.poles),
            "denominator": self.denominator.tolist(),
            "functions": rows,
        }
        return to_json(content)

    def to_control(self) -> Any:
        """A TransferFunction of python-control.  Raises UsageError without it (extra "control")."""
        control = optional_library("control", "control", "to_control")
        count = range(len(self.inputs))
        numerators = [[self.numerator(i, j) for j in count] for i in range(len(self.outputs))]
        denominators = [[self.denominator for _ in count] for _ in self.outputs]
        names = {
            "inputs": [port.name for port in self.inputs],
            "outputs": [port.name for port in self.outputs],
        }
        return control.tf(numerators, denominators, **names)


def _pairs(values: Complex) -> list[list[float]]:
    return np.stack([values.real, values.imag], axis=-1).tolist()


def transfer_functions_of(system: StateSpace) -> TransferFunctions:
    """The transfer functions of a state space.

    Zeros are eigenvalues of the Rosenbrock pencil; how many there are follows from the first Markov parameter that does
    not vanish (D, CB, CAB, …), which is the gain.
    """
    poles = np.linalg.eigvals(system.A).astype(complex)
    count_out, count_in = system.D.shape
    zeros: list[tuple[Complex, ...]] = []
    gain = np.zeros((count_out, count_in))
    for i in range(count_out):
        row = []
        for j in range(count_in):
            found, gain[i, j] = _zeros(system.A, system.B[:, j], system.C[i], float(system.D[i, j]))
            row.append(found)
        zeros.append(tuple(row))
    poles, gain = frozen(poles, np.complex128), frozen(gain, np.float64)
    return TransferFunctions(system.name, system.inputs, system.outputs, poles, tuple(zeros), gain)


def write_transfer_functions(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write transfer functions as JSON.  Raises as `state_space_of`."""
    write_text(path, transfer_functions_of(state_space_of(rig, options.given)).to_json())
    return Written((path,))


def _zeros(A: Real, b: Real, c: Real, d: float) -> tuple[Complex, float]:
    """Zeros and gain of one transfer function."""
    from scipy.linalg import eigvals

    n = len(A)
    rate = max(float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)), 1e-300)
    markov, state, size = [d], b, float(np.linalg.norm(c)) * float(np.linalg.norm(b))
    scales = [max(abs(d), size / rate)]
    for k in range(n):
        markov.append(float(c @ state))
        scales.append(size * rate**k)
        state = A @ state
    leading = [k for k in range(n + 1) if abs(markov[k]) > 1e-10 * scales[k]]  # else of rounding
    if not leading:
        return np.zeros(0, dtype=complex), 0.0
    degree = leading[0]
    # Rates in units of the fastest pole, and b and c of unit length, balance the pencil.
    pencil = np.zeros((n + 1, n + 1))
    pencil[:n, :n], pencil[:n, n] = A / rate, b / np.linalg.norm(b)
    pencil[n, :n], pencil[n, n] = c / np.linalg.norm(c), d * rate / max(size, 1e-300)
    mass = np.diag([1.0] * n + [0.0])
    alpha, beta = eigvals(pencil, mass, homogeneous_eigvals=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(np.abs(beta) > 0, alpha / np.where(beta == 0, 1.0, beta), np.inf)
        size = np.round(np.log(np.abs(np.nan_to_num(values, nan=np.inf))), 9)  # of a pair the same
    values = values[np.argsort(size, kind="stable")][: n - degree] * rate
    return frozen(values, np.complex128), markov[degree]


def frequency_responses(rig: IdentifiedRig, frequency_hz: Real) -> tuple[Complex, Real]:
    """(H (lines, outputs, inputs), sd): amplitudes of the channels per unit of each input, U first, then f; SI units.

    `sd` is that of the real (and of the imaginary) part, from the covariance of the parameters.  Raises ModelError for
    nonlinear elements and where there is no steady response, UsageError if no channel shows more than inputs.
    """
    rig.require_linear("a frequency response")
    if not rig.outputs:
        raise UsageError("all channels measure inputs only", cure="list channels of the coordinates")
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
    of_rig = transfer(observation_model(rig.model, rig.outputs, omega), rig.p)
    if not np.all(np.isfinite(of_rig.G)):
        raise no_steady_response()
    variance = np.empty(of_rig.G.shape)
    for j, unit in enumerate(np.eye(of_rig.G.shape[-1])):
        slopes = of_rig.slopes(np.broadcast_to(unit.astype(complex), (len(omega), len(unit))))
        both = np.einsum("lcm,mk,lck->lc", slopes, rig.covariance, slopes.conj()).real
        variance[..., j] = both / 2
    return of_rig.G, np.sqrt(np.maximum(variance, 0.0))


def write_frequency_responses(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write a CSV: frequency_hz, then OUT/IN_re, OUT/IN_im, OUT/IN_sd in physical units.

    Raises UsageError without frequencies, and as `frequency_responses`.
    """
    frequency_hz = options.frequency_hz
    if frequency_hz is None:
        if options.data is None:
            raise UsageError(
                "frequency responses need frequencies", cure="give frequencies, or data that have some"
            )
        frequency_hz = np.unique(options.data.frequency_hz)
    H, sd = frequency_responses(rig, frequency_hz)
    header, columns = ["frequency_hz"], [frequency_hz]
    for i, channel in enumerate(rig.outputs):
        for j, (name, scale, _) in enumerate(input_units(rig)):
            factor = scale / unit_of_channel(rig, channel)[0]
            values = H[:, i, j] * factor
            header += [f"{channel.name}/{name}_{part}" for part in ("re", "im", "sd")]
            columns += [values.real, values.imag, sd[:, i, j] * factor]
    write_rows(path, header, columns)
    return Written((path,))


def input_units(rig: IdentifiedRig) -> list[tuple[str, float, str]]:
    """For each input its own channel of the same quantity, else SI: name, unit's value in SI, unit."""
    names, units = [], []
    for drive in input_channels(rig.model):
        same = [c for c in rig.channels if c.of == drive.of and c.quantity is drive.quantity]
        names.append((same[0] if same else drive).name)
        units.append(unit_of_channel(rig, same[0] if same else drive))
    return [(name, *unit) for name, unit in zip(names, units, strict=True)]


def unit_of_channel(rig: IdentifiedRig, channel: Channel) -> tuple[float, str]:
    """The unit's value in SI and its name: that of the rig file where it is one of the quantity itself, else SI."""
    raw = channel.factor != 1 or not channel.unit or is_electrical(channel.unit, channel.quantity.value)
    return (1.0, channel_unit(rig.model, channel)) if raw else (channel.scale, channel.unit)
