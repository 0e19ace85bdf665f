"""Dwells of the largest motion: where one contradicts all others, it may be the only one that shows a nonlinear law."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from dashpot.check.diagnosis.ranking import ALIKE, Cause
from dashpot.check.diagnosis.search import Workbench
from dashpot.model.observation import measures_input

OF_A_DWELL = ("dwell", "frequency")  # kinds of causes
LOUD = 0.7  # of the largest amplitude of a channel


def at_loud_dwells(bench: Workbench, candidates: Sequence[Cause]) -> list[Cause]:
    """The causes that are of a single dwell in which a channel of the motion is about as large as in any."""
    view, Y = bench.view, np.nan_to_num(np.abs(bench.data.spectrum.amplitudes[0]))
    moves = [c for c, channel in enumerate(view.channels) if not measures_input(bench.data.model, channel)]
    size = Y[:, moves] / view.omega[:, None] ** view.derivative[moves]
    loudest = np.any(size > LOUD * np.max(size, axis=0), axis=1)
    loud = {f"{frequency:g} Hz" for frequency in bench.data.spectrum.frequency_hz[loudest]}
    return [cause for cause in candidates if cause.kind in OF_A_DWELL and not loud.isdisjoint(cause.of)]


def beside_loud_dwells(
    candidates: Sequence[Cause], doubtful: Collection[Cause], nonlinear: Sequence[Cause]
) -> list[Cause]:
    """All of the candidates but the `doubtful` ones that a nonlinear element explains about as well, and `nonlinear`.

    The element keeps all dwells as they were labelled.  One that explains no more than a single dwell does in which
    little moves, and which is therefore not doubtful, is none.
    """
    quiet = [c.remaining for c in candidates if c.kind in OF_A_DWELL and c.of and c not in doubtful]
    bad_dwell = min(quiet, default=np.inf)
    called_for = [c for c in nonlinear if bad_dwell >= ALIKE * max(c.remaining, 1.0)]
    left = min((cause.remaining for cause in called_for), default=np.inf)
    kept = [c for c in candidates if not (c in doubtful and left < ALIKE * max(c.remaining, 1.0))]
    return [*kept, *called_for]
