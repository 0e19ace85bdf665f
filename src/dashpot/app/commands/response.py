"""dashpot response: amplitude-frequency curves of a nonlinear rig, with unstable motions, folds and backbones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

from dashpot.app import options as opt
from dashpot.app.commands.simulate import require_values
from dashpot.app.parameters import input_amplitudes, merged, parameter_values
from dashpot.app.progress import progress
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
        "In place of --band: one frequency, at which the drive grows from 1 % of --amplitude to all of it.",
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
        "Add the backbone of that mode, its free undamped motions (1 is the lowest).  May be repeated.",
    ],
    out: Annotated[
        str | None,
        opt.Option("--out -o FILE.csv", opt.OutputFile(), opt.OUTPUT),
        "Write the points of the curves as a table.",
    ],
    figure: Annotated[str | None, opt.FIGURE, "Draw the curves, unstable motions dashed."],
    quiet: opt.Quiet,
) -> None:
    """Follow the settled motion of a nonlinear RIG along the frequency or the size of the drive.

    The curves go through folds; the text says which parts are stable and where they turn.  Every unknown needs a
    value: from --set, or the value or guess of the rig file.
    """
    from dashpot.model.rigfile import read_rig
    from dashpot.study.response_curves import require_nonlinear

    if band is not None and at is not None:
        raise UsageError("--band and --at exclude each other", cure="leave one of them out")
    if band is None and at is None:
        cure = "give --band 1:10 to follow the frequency, or --at 5 to follow the amplitude"
        raise UsageError("nothing says what varies along the curves", cure=cure)
    rig_read = read_rig(rig)
    values_si = parameter_values(rig_read, merged(values, "--set"))
    require_values(rig_read, values_si)
    require_nonlinear(rig_read.model)
    if not _moving(rig_read):
        cure = "add one of a coordinate to [channels], or take that section out"
        raise UsageError("no channel shows how the rig moves: all show its inputs", rig, cure)
    with progress("response", quiet):
        curves = _curves(rig_read, values_si, band, at, amplitudes)
        bones = _backbones(rig_read, values_si, backbone, curves)
    if out is not None:
        _write(rig_read, [*curves, *bones], out)
    if figure is not None:
        _draw(rig_read, curves, bones, at is not None, figure)
    if not quiet:
        from dashpot.present.tables.layout import console
        from dashpot.present.tables.response_curves import show_curves

        show_curves(console(), [*curves, *bones], at is not None)


def _moving(rig: Rig) -> list[int]:
    """Positions of the channels that show more than inputs."""
    from dashpot.model.observation import measures_input

    return [c for c, channel in enumerate(rig.channels) if not measures_input(rig.model, channel)]


def _drives(
    rig: Rig, amplitudes: Sequence[Amount | Mapping[str, Amount]]
) -> list[tuple[str, dict[str, float]]]:
    """(label, amplitudes by input) of each curve."""
    common = [given for given in amplitudes if not isinstance(given, Mapping)]
    named = [given for given in amplitudes if isinstance(given, Mapping)]
    drives = []
    for whole in common if common else [None]:
        given: list[Amount | Mapping[str, Amount]] = [*named, *([] if whole is None else [whole])]
        words = [str(whole)] if whole is not None else []
        words += [f"{name} {amount}" for one in named for name, amount in one.items()]
        drives.append((", ".join(words) if words else "unit drive", input_amplitudes(rig.model, given)))
    return drives


def _curves(
    rig: Rig,
    values: Mapping[str, float],
    band: tuple[float, float] | None,
    at: float | None,
    amplitudes: Sequence[Amount | Mapping[str, Amount]],
) -> list[MotionCurve]:
    from dashpot.study.response_curves import amplitude_curve, frequency_curve

    theta = rig.model.theta(values)
    curves = []
    for label, drive in _drives(rig, amplitudes):
        if band is not None:
            curves.append(frequency_curve(rig.model, theta, rig.channels, drive, band, label=label))
        elif at is not None:
            curves.append(amplitude_curve(rig.model, theta, rig.channels, drive, at, label=label))
    return curves


def _backbones(
    rig: Rig, values: Mapping[str, float], modes: Sequence[int], curves: Sequence[MotionCurve]
) -> list[MotionCurve]:
    """Backbones as far as the curves swing."""
    from dashpot.study.response_curves import backbone_curve, largest_stretch

    theta = rig.model.theta(values)
    largest = largest_stretch(curves)
    return [
        backbone_curve(rig.model, theta, rig.channels, mode - 1, largest, label=f"backbone of mode {mode}")
        for mode in modes
    ]


def _write(rig: Rig, curves: Sequence[MotionCurve], out: str) -> None:
    """A row for each point; lengths and forces in the units of the channels."""
    import numpy as np

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
    rig: Rig, curves: Sequence[MotionCurve], bones: Sequence[MotionCurve], by_amplitude: bool, path: str
) -> None:
    import numpy as np

    from dashpot.present.figures.response import DrawnCurve, response_curves
    from dashpot.present.figures.style import write_figure

    moving = _moving(rig)
    scale = np.array([rig.channels[c].scale for c in moving])
    drawn = [
        DrawnCurve(
            curve.label, curve.share if by_amplitude else curve.frequency_hz, curve.swing[:, moving] / scale,
            curve.stable, curve.folds, thin=curve in bones,
        )
        for curve in (*curves, *([] if by_amplitude else bones))
    ]  # fmt: skip
    names = [rig.channels[c].name for c in moving]
    units = [rig.channels[c].unit or "SI" for c in moving]
    label = "drive / stated amplitude" if by_amplitude else "frequency, Hz"
    write_figure(path, response_curves(names, units, drawn, label))
