"""What a nonlinear rig predicts of measured harmonics, on the branch of the measured motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.nonlinear.objective import NonlinearPart, evaluate, measured_part, predict_harmonics
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, observation_model

ORDERS = 31  # harmonics of the response


@dataclass(frozen=True)
class MeasuredHarmonics:
    """Lines of one spectrum as the likelihood has them, at one θ; psi (1, M), sign (1, channels)."""

    view: ObservationModel
    exact: Measured
    part: NonlinearPart
    psi: Real
    sign: Real

    @staticmethod
    def of(
        model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
    ) -> MeasuredHarmonics:
        """With noise V (lines, channels, channels); `calibrations`: NAME.gain and NAME.delay that an estimate found."""
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
        return MeasuredHarmonics(view, exact, part, psi[None], sign[None])


def predicted_lines(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
) -> tuple[Complex, Complex]:
    """(channels (lines, channels), inputs (lines, r + s)) at θ for one spectrum with noise V.

    `calibrations`: NAME.gain and NAME.delay that an estimate found.  Inputs with noise are those that suit best.
    """
    here = MeasuredHarmonics.of(model, theta, spectrum, V, calibrations)
    view, exact = here.view, here.exact
    residual, _, _, _, q, _ = predict_harmonics(view, exact, here.part, here.psi, here.sign)
    inputs = q[0]
    shown: Complex = exact.y[0] - residual[0]
    # Exact channels of inputs take no part in the likelihood; they show what drives.
    alone = view.inputs_alone & ~np.any(np.diagonal(exact.W[0], axis1=-2, axis2=-1), axis=0)
    shown[:, alone] = np.einsum("lcq,lq->lc", view.direct_q, inputs)[:, alone]
    return shown, inputs


def noise_of_measured_inputs(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Mapping[str, float]
) -> Real:
    """Variance that the channels get, through the rig, from the noise of the inputs' channels, (lines, channels).

    To first order about the motion at θ; V takes the inputs as exact, the noise is that of `spectrum`.
    """
    here = MeasuredHarmonics.of(model, theta, spectrum, V, calibrations)
    view, dwells = here.view, here.part.dwells
    _, _, _, _, q, _ = predict_harmonics(view, here.exact, here.part, here.psi, here.sign)
    reached = here.part.warm.delta[0]
    G = evaluate(view, here.part, here.psi, here.sign, q, reached, True).G[0]
    alone = view.inputs_alone
    back = np.linalg.pinv(view.direct_q * alone[:, None])
    noise = np.where(alone[:, None] & alone, np.nan_to_num(spectrum.covariance), 0.0)
    of_inputs = np.einsum("lic,lcd,lid->li", back, noise, back.conj()).real
    # Each real change of a dwell's inputs is the real or imaginary part of one input at one line.
    parts = np.abs(dwells.input_directions(q.shape[-1])[dwells.dwell, dwells.order]) ** 2
    of_parts = dwells.by_dwell(np.einsum("liq,li->lq", parts, of_inputs / 2)[None])[0]
    return np.einsum("lcq,lq->lc", np.abs(G) ** 2, of_parts[dwells.dwell])
