"""What data show without a rig, as documents: frequency responses and modes."""

from __future__ import annotations

import numpy as np

from dashpot.free.response import MeasuredResponse
from dashpot.present.document import Document, columns_of, section
from dashpot.present.words import percent, short

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
    distorted = [
        (name, *("–" if not np.isfinite(part) else f"{100 * part:.2g} %" for part in parts))
        for name, parts in found.distortion.items()
    ]
    heard = columns_of(["output", "even multiples>", "odd multiples>"], distorted)
    return Document(
        title,
        (
            section("", columns_of(heads, rows)),
            section("", " ".join(said)),
            *([section("", "Distortion beyond noise, of the motion (rms):", heard)] if distorted else []),
        ),
    )
