"""What the ends of whole records add to the channels, some lines at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.record_passes import EndsFitted, RecordPieces
from dashpot.estimate.likelihood.record_sums import ends_fitted
from dashpot.model.observation import calibrated_transfer

LINES = 20_000  # at once


def shown_by_ends(data: Measured, psi: Real, sign: Real) -> Complex:
    """Loads and polynomials as they fit best at ψ (K, M) with signs (K, channels), in the channels: (K, lines,
    channels), 0 at settled lines.

    What `objective.predict` calls `at_ends`; for rigs that are `small`, whose data have ends.
    """
    assert data.ends is not None
    ends, pieces, n = data.ends, data.record_pieces, data.ends.n
    loads = _coefficients(pieces, ends_fitted(pieces, psi, sign))
    folded = ends.sampled_loads(psi)
    out = np.zeros((len(psi), len(ends.s), len(ends.rig.channels)), dtype=np.complex128)
    for record, lines in enumerate(ends.lines):
        of_record = loads[:, record]
        for first in range(0, len(lines), LINES):
            at = lines[first : first + LINES]
            s = ends.s[at]
            view = replace(ends.view, omega=ends.view.omega[at])
            G, by_load = np.split(calibrated_transfer(view, psi, sign).G, [ends.inputs], axis=-1)
            load = of_record[:, None, :n] + s[:, None] * of_record[:, None, n : 2 * n]
            shown = np.einsum("klcj,klj->klc", by_load, load)
            shown += np.einsum("klcq,lqp,kp->klc", G, ends.by_input[at], of_record[:, 2 * n :], optimize=True)
            for k, (channel, power) in enumerate(zip(ends.channel, ends.power, strict=True)):
                shown[..., channel] += s**power * of_record[:, None, 2 * n + k]
            if folded is not None and ends.loads[record]:
                shown += np.einsum("kcjl,kj->klc", folded.at(record, s), of_record[:, : 2 * n])
            out[:, at] = shown
    return out


def _coefficients(pieces: RecordPieces, fit: EndsFitted) -> Real:
    """Of loads and polynomials in the order of the ends, (K, records, 2 n + polynomials)."""
    ends, loads = pieces.ends, 2 * pieces.ends.n
    of_inputs = loads + len(pieces.of_inputs)
    out = np.zeros((*fit.z.shape[:2], ends.count))
    out[..., :loads] = fit.z[..., :loads]
    out[..., loads + pieces.of_inputs] = fit.z[..., loads:of_inputs]
    out[..., loads + pieces.fitted] = fit.z[..., of_inputs:]
    if pieces.terms:
        powers = (pieces.orthogonal[0] @ fit.t[..., None])[..., 0]
        alone = np.setdiff1d(np.arange(len(ends.channel)), pieces.of_inputs)
        out[..., loads + alone] = powers[
            :, :, ends.channel[alone], np.searchsorted(pieces.powers, ends.power[alone])
        ]
    return out
