"""What a nonlinear rig predicts of measured harmonics, on the branch of the measured motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.nonlinear.objective import measured_part, predict_harmonics
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.network import Model
from dashpot.model.observation import observation_model

ORDERS = 31  # harmonics of the response


def predicted_lines(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
) -> tuple[Complex, Complex]:
    """(channels (lines, channels), inputs (lines, r + s)) at θ for one spectrum with noise V.

    `calibrations`: NAME.gain and NAME.delay that an estimate found.  Inputs with noise are those that suit best.
    """
    flat = replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=V[None], moments=None)
    view = observation_model(model, spectrum.channels, spectrum.omega)
    exact = measured(
        Prepared(view, flat, V[None], states_if_seen(view, flat, V[None]), True, np.ones(1, dtype=bool))
    )
    part = measured_part(exact)
    if part.dwells.orders < ORDERS:
        part = part.with_harmonics(ORDERS)
    psi = np.array([*theta, *(calibrations[name] for name in view.names[view.m :])])
    sign = np.array([calibrations.get(f"{channel.name}.sign", 1.0) for channel in spectrum.channels])
    residual, _, _, _, q, _ = predict_harmonics(view, exact, part, psi[None], sign[None])
    inputs = q[0]
    shown: Complex = exact.y[0] - residual[0]
    # Exact channels of inputs take no part in the likelihood; they show what drives.
    alone = view.inputs_alone & ~np.any(np.diagonal(exact.W[0], axis1=-2, axis2=-1), axis=0)
    shown[:, alone] = np.einsum("lcq,lq->lc", view.direct_q, inputs)[:, alone]
    return shown, inputs
