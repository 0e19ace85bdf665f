"""dashpot response: amplitude-frequency curves of a nonlinear rig, with unstable motions, folds and backbones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, cast

import numpy as np

from dashpot.app import options as opt
from dashpot.app.options import input_amplitudes, parameter_values
from dashpot.app.workers import progress
from dashpot.errors import UsageError
from dashpot.quantities import Amount

if TYPE_CHECKING:
    from dashpot.model.rigfile import Rig
    from dashpot.study.response_curves import MotionCurve

TEST = "The drive"


@opt.dashpot_command(
    "dashpot response rig.toml --set k3=1e9 --band 2:14 --amplitude u=1mm --figure curves.png",
    "dashpot response rig.toml --band 2:14 --amplitude 0.2mm --amplitude 1mm --backbone 1 -o curves.csv",
    "dashpot response rig.toml --at 9Hz --amplitude 2mm --figure folds.png",
)
def command(
    rig: opt.RigFile,
    values: Annotated[tuple[dict[str, Amount], ...], opt.SET, opt.VALUES],
    band: Annotated[
        tuple[float, float] | None,
        opt.Option("--band LOWER:UPPER", opt.BAND, TEST),
        "Frequencies of the curves, Hz.",
    ],
    at: Annotated[
        float | None,
        opt.Option("--at HZ", opt.FREQUENCY, TEST),
        "Instead of --band: one frequency, at which the drive grows from 1 % of --amplitude to all of it.",
    ],
    amplitudes: Annotated[
        tuple[Amount | dict[str, Amount], ...],
        opt.Option("--amplitude [INPUT=]VALUE", opt.AMPLITUDE, TEST, multiple=True),
        "Amplitude of all inputs (2mm, 10N) or of one (u=2mm).  May be repeated: one curve for each.  "
        "[default: 1 m, rad, N or N·m]",
    ],
    backbone: Annotated[
        tuple[int, ...],
        opt.Option("--backbone MODE", opt.Count(1, 1000), TEST, multiple=True),
        "Add the backbone curve of that mode: free undamped vibration (1 is the lowest mode).  May be repeated.",
    ],
    out: Annotated[
        str | None,
        opt.Option("--out -o FILE.csv", opt.OutputFile(), opt.OUTPUT),
        "Write the points of the curves as a table.",
    ],
    figure: Annotated[str | None, opt.FIGURE, "Draw the curves, unstable branches dashed."],
    quiet: opt.Quiet,
) -> None:
    """Compute the steady state of a nonlinear RIG over the frequency or the amplitude of the drive.

    Curves are followed through folds; the text says which parts are stable and where they turn.  Every unknown needs a
    value: from --set, or the value or guess of the rig file.
    """
    from dashpot.model.observation import measures_input
    from dashpot.model.rigfile import read_rig
    from dashpot.study import response_curves as study

    if band is not None and at is not None:
        raise UsageError("--band and --at exclude each other", cure="leave one of them out")
    if band is None and at is None:
        cure = "give --band 1:10 to follow the frequency, or --at 5 to follow the amplitude"
        raise UsageError("no range of frequency or amplitude is given", cure=cure)
    read = read_rig(rig).in_experiment()
    model, channels = read.model, read.channels
    given = parameter_values(read, values, whole=True)
    study.require_nonlinear(model)
    moving = [c for c, channel in enumerate(channels) if not measures_input(model, channel)]
    if not moving:
        cure = "add one of a coordinate to [channels], or take that section out"
        raise UsageError("no channel shows how the rig moves: all measure its inputs", rig, cure)
    theta, curves = model.theta(given), []
    with progress("response", quiet):
        for label, drive in _drives(read, amplitudes):
            if band is not None:
                curve = study.frequency_curve(model, theta, channels, drive, band, label=label)
            else:
                curve = study.amplitude_curve(model, theta, channels, drive, cast(float, at), label=label)
            curves.append(curve)
        swing = study.largest_stretch(curves)
        bones = [
            study.backbone_curve(model, theta, channels, mode - 1, swing, label=f"backbone of mode {mode}")
            for mode in backbone
        ]
    if out is not None:
        _write(read, [*curves, *bones], out)
    if figure is not None:
        _draw(read, moving, curves, [] if band is None else bones, band is None, figure)
    if not quiet:
        from dashpot.present.document import say
        from dashpot.present.response import curves_document

        say(curves_document([*curves, *bones], band is None))


def _drives(
    rig: Rig, amplitudes: Sequence[Amount | Mapping[str, Amount]]
) -> Iterator[tuple[str, dict[str, float]]]:
    """(label, amplitudes by input) of each curve: one for each amplitude that is not of an input by name."""
    named = [given for given in amplitudes if isinstance(given, Mapping)]
    of_all = [given for given in amplitudes if not isinstance(given, Mapping)]
    for common in [[each] for each in of_all] or [[]]:
        words = [str(each) for each in common]
        words += [f"{name} {amount}" for one in named for name, amount in one.items()]
        yield ", ".join(words) or "unit drive", input_amplitudes(rig.model, [*named, *common])


def _write(rig: Rig, curves: Sequence[MotionCurve], out: str) -> None:
    """A row for each point; lengths and forces in the units of the channels."""
    from dashpot.data.readers.text import write_rows

    scale = np.array([channel.scale for channel in rig.channels])
    labels = [curve.label for curve in curves for _ in curve.frequency_hz]
    told = [
        ("" if curve.stable is None else "yes" if curve.stable[k] else "no")
        for curve in curves
        for k in range(len(curve.frequency_hz))
    ]
    swings = np.concatenate([curve.swing for curve in curves]) / scale
    header = ["curve", "frequency_hz", "drive", "stable", *(f"{c.name}_swing" for c in rig.channels)]
    columns = [
        labels,
        np.concatenate([curve.frequency_hz for curve in curves]),
        np.concatenate([curve.share for curve in curves]),
        told,
        *swings.T,
    ]
    write_rows(out, header, columns)


def _draw(
    rig: Rig,
    moving: Sequence[int],
    curves: Sequence[MotionCurve],
    bones: Sequence[MotionCurve],
    by_amplitude: bool,
    path: str,
) -> None:
    from dashpot.present.figures.style import write_figure
    from dashpot.present.response import DrawnCurve, response_curves

    scale = np.array([rig.channels[c].scale for c in moving])
    drawn = []
    for curve in (*curves, *bones):
        at, swing = curve.share if by_amplitude else curve.frequency_hz, curve.swing[:, moving] / scale
        drawn.append(DrawnCurve(curve.label, at, swing, curve.stable, curve.folds, thin=curve not in curves))
    names = [rig.channels[c].name for c in moving]
    units = [rig.channels[c].unit or "SI" for c in moving]
    label = "drive / stated amplitude" if by_amplitude else "frequency, Hz"
    write_figure(path, response_curves(names, units, drawn, label))
