"""What data show without a rig, as documents: frequency responses and modes."""

from __future__ import annotations

import numpy as np

from dashpot.free.modes import MeasuredModes
from dashpot.free.response import MeasuredResponse
from dashpot.io.words import counted
from dashpot.present.document import Document, columns_of, section
from dashpot.present.words import percent, short, value_and_sd

METHODS = {
    "dwells": "steady sines and tables of amplitudes: noise of inputs and outputs as it is known",
    "periods": "periodic excitation: means of the periods, noise from their scatter",
    "local": "records of any excitation: local rational models with transients; inputs count as exact",
}


def response_document(found: MeasuredResponse, where: str = "") -> Document:
    """A row for each pair: where the response is largest, how well it is known, coherence, distortion."""
    f = found.frequency_hz
    title = f"{len(f)} frequencies from {short(float(f[0]))} to {short(float(f[-1]))} Hz"
    rows = []
    for i, out in enumerate(found.outputs):
        for j, into in enumerate(found.inputs):
            size, sd = np.abs(found.values[:, i, j]), found.sd[:, i, j]
            peak = int(np.argmax(size))
            typical = float(np.median(size))
            rows.append(
                (
                    f"{out.name}/{into.name}",
                    short(float(size[peak])),
                    short(float(f[peak])),
                    f"{percent(float(np.median(sd)), typical)}" if np.all(np.isfinite(sd)) else "–",
                    f"{np.median(found.coherence[:, i]):.3g}" if np.isfinite(found.coherence[0, i]) else "–",
                    found.unit(out, into),
                )
            )
    heads = ["response", "largest>", "at Hz>", "sd, %>", "coherence>", "unit"]
    said = [f"From {METHODS[found.method]}."]
    if where:
        kept = len(found.independent().frequency_hz)
        some = "" if kept == len(f) else f"; {kept} lines, of which no two share data"
        said.append(f"Written to {where}{some}.")
    distorted = [(name, *(_distortion(part) for part in parts)) for name, parts in found.distortion.items()]
    heard = columns_of(["output", "even multiples>", "odd multiples>"], distorted)
    return Document(
        title,
        (
            section("", columns_of(heads, rows)),
            section("", " ".join(said)),
            *([section("", "Distortion beyond noise, of the motion (rms):", heard)] if distorted else []),
        ),
    )


def _distortion(share: float) -> str:
    if not np.isfinite(share):
        return "all driven"
    return f"{100 * share:.2g} %" if share else "none seen"


def modes_document(found: MeasuredModes, where: str = "") -> Document:
    """Frequencies, damping and shapes as size and phase, with how the fit is."""
    count = len(found.eigenvalues)
    f = found.frequency
    title = f"{counted(count, 'mode')} from {short(float(f[0]))} to {short(float(f[-1]))} Hz"
    values = [
        (
            str(k + 1),
            *value_and_sd(float(found.frequency_hz[k]), float(found.frequency_sd[k])),
            *value_and_sd(100 * float(found.damping_ratio[k]), 100 * float(found.damping_sd[k])),
        )
        for k in range(count)
    ]
    heads = ["mode", "frequency, Hz>", "±>", "damping, %>", "±>"]
    shapes = []
    for k in range(count):
        sizes = [
            value_and_sd(abs(x), float(sd)) for x, sd in zip(found.shapes[k], found.shape_sd[k], strict=True)
        ]
        angles = [f"{round(float(np.degrees(np.angle(x)))):d}°" for x in found.shapes[k]]
        shapes.append(
            (str(k + 1), *(f"{size} ∠ {angle}" for (size, _), angle in zip(sizes, angles, strict=True)))
        )
    said = "" if found.inputs else "No input is named: fitted as a free decay.  "
    if np.isfinite(found.chi2):
        ratio = (found.chi2 / found.dof) ** 0.5
        said += f"The fit leaves {ratio:.3g} × the noise."
        if ratio > 1.2:
            said += " What is more than noise is in the standard deviations; a nonlinear or changing rig is likely."
    if where:
        said += f" Written to {where}."
    table = columns_of(["mode", *(f"{name}^" for name in found.points)], shapes)
    return Document(
        title,
        (
            section("", columns_of(heads, values)),
            section("", "Shapes of displacement, the largest 1:", table),
            *([section("", said.strip())] if said else []),
        ),
    )
