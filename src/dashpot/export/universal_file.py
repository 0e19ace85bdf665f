"""Universal files of a rig: frequency responses, measured and fitted (dataset 58b), and modes (dataset 55)."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.check.residuals import calibrations_of, residuals
from dashpot.data.readers.uff import FRF, NodalFunction, NodalMode, NodePoint
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.export.formats import ExportOptions, Written
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.transfer_functions import frequency_responses, input_units, unit_of_channel
from dashpot.model.modes import eigenmodes
from dashpot.model.observation import input_channels


def write_rig_universal_file(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write modes, fitted frequency responses at the options' frequencies and, of their data, measured and fitted ones.

    Coordinate k is node k + 1, displacement inputs follow, then channels that are no single point.  ID line 1 of a
    function is OUT/IN, line 2 says measured or fitted; of modes, lines 3 to 5 list nodes and names.  Raises as
    `measured_responses` and `frequency_responses`.
    """
    functions: list[NodalFunction] = []
    frequency_hz = options.frequency_hz
    if options.data is not None:
        functions += measured_responses(rig, options.data)
        frequency_hz = np.unique(options.data.frequency_hz) if frequency_hz is None else frequency_hz
    if frequency_hz is not None:
        # The rig's own frequency responses in the channels' units
        H, _ = frequency_responses(rig, frequency_hz)
        functions += [
            _function(rig, channel, j, frequency_hz, H[:, i, j], "fitted")
            for i, channel in enumerate(rig.outputs)
            for j in range(H.shape[2])
        ]
    # Modes at the coordinates' nodes: X, Y, Z (and rotations about them); eigenvalues in rad/s
    rig.require_linear("a mode")
    model = rig.model
    of_rig = eigenmodes(model, rig.p)
    swinging = of_rig.eigenvalues.imag > 0
    width = 6 if model.angles else 3
    nodes = tuple(range(1, model.n + 1))
    # Names of the nodes on three ID lines, as many as there is room for
    names = [""]
    for k, name in enumerate(model.coordinates):
        text = f"{k + 1} = {name}"
        longer = f"{names[-1]}, {text}" if names[-1] else text
        if len(longer) <= 80:
            names[-1] = longer
        elif len(names) < 3 and len(text) <= 80:
            names.append(text)
        else:
            break
    out = []
    for eigenvalue, shape in zip(of_rig.eigenvalues[swinging], of_rig.shapes[swinging], strict=True):
        table = np.zeros((model.n, width), dtype=complex)
        for k, name in enumerate(model.coordinates):
            table[k, (_direction(rig, name) - 1)] = shape[k]
        frequency = abs(eigenvalue) / (2 * np.pi)
        ids = (model.name[:80], f"Mode at {frequency:.6g} Hz by dashpot", *names)
        out.append(NodalMode(complex(eigenvalue), nodes, table, ids))
    write_universal_file(path, functions, out)
    return Written((path,))


def measured_responses(rig: IdentifiedRig, data: Spectrum) -> list[NodalFunction]:
    """Measured amplitudes over the input that acts alone at their lines, its estimate from all channels of the line.

    Calibrations that were estimated are taken out.  Raises DataError for a batch, and where no line has one input only.
    """
    if data.batch:
        raise DataError("repeats cannot be exported", cure="choose one of them")
    calibrations = {} if rig.estimate is None else calibrations_of(rig.model, rig.estimate)
    compared = residuals(rig.model, rig.theta, data, calibrations)
    size = np.abs(compared.inputs)
    scale = np.max(size, axis=0, initial=0.0)
    acting = size > 1e-6 * np.where(scale > 0, scale, np.inf)
    alone = np.sum(acting, axis=1) == 1
    outputs = {channel.name: channel for channel in rig.outputs}
    functions = []
    for j in range(acting.shape[1]):
        lines = np.flatnonzero(alone & acting[:, j])
        lines = lines[np.unique(data.frequency_hz[lines], return_index=True)[1]]
        for c, name in enumerate(compared.channels):
            there = lines[np.isfinite(compared.measured[lines, c])]
            if name not in outputs or not len(there):
                continue
            frequency = data.frequency_hz[there]
            ratio = compared.measured[there, c] / compared.inputs[there, j]
            gain, delay = outputs[name].unknown_gain, outputs[name].unknown_delay
            sign = calibrations.get(f"{name}.sign", 1.0)
            by = sign * (1.0 if gain is None else calibrations[gain.name])
            late = 0.0 if delay is None else calibrations[delay.name]
            ratio = ratio / (by * np.exp(-2j * np.pi * frequency * late))
            functions.append(_function(rig, outputs[name], j, frequency, ratio, "measured"))
    if not functions:
        raise DataError(
            "the data have no frequency response: several inputs act at once at every frequency",
            cure="leave the data out, and give frequencies",
        )
    return functions


def _function(
    rig: IdentifiedRig, channel: Channel, source: int, frequency_hz: Real, values: Complex, origin: str
) -> NodalFunction:
    name, scale, unit = input_units(rig)[source]
    of_channel, channel_unit = unit_of_channel(rig, channel)
    drive = input_channels(rig.model)[source]
    ids = (f"{channel.name}/{name}", origin, rig.model.name[:80])
    shown, moved = _point(rig, channel), _point(rig, drive)
    return NodalFunction(
        FRF, shown, moved, frequency_hz, values * (scale / of_channel), channel_unit, unit, ids
    )


def _point(rig: IdentifiedRig, channel: Channel) -> NodePoint:
    """Node and direction of what a channel measures or an input moves."""
    model = rig.model
    moved = [*model.coordinates, *model.displacement_inputs]
    forces = {source.name: source.at for source in model.inputs if source.kind == "force"}
    at: list[str] = []
    for name in channel.of:
        at += forces[name] if channel.quantity is Quantity.FORCE and name in forces else [name]
    if len(at) == 1 and at[0] in moved:
        return NodePoint(channel.name[:10], moved.index(at[0]) + 1, _direction(rig, at[0]))
    names = [known.name for known in rig.channels] + list(forces)
    number = names.index(channel.name) if channel.name in names else len(names)
    return NodePoint(channel.name[:10], len(moved) + 1 + number, 1)


def _direction(rig: IdentifiedRig, point: str) -> int:
    """+X, of an angle +RX."""
    return 4 if point in rig.model.angles else 1
