"""What is done to the data before any method sees them, once and in one place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Complex, is_diagonal
from dashpot.data.repeats import flattened
from dashpot.data.spectrum import FITTED, Spectrum
from dashpot.errors import DataError
from dashpot.estimate.preparation.noise_quality import channels_correlate, without_correlation
from dashpot.estimate.preparation.state_reconstruction import States, require_seen, states_if_seen
from dashpot.estimate.preparation.weighting import with_unknown_noise, working_covariance
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, observation_model


@dataclass(frozen=True)
class Prepared:
    """Data as every method gets them: one leading axis of K repeats on the amplitudes.

    view         what the channels show of the rig at the lines
    covariance   the channels' V, (K or 1, lines, channels, channels)
    states       the channels combined to coordinates and inputs; None where some of these are not seen
    noise_known  whether V is the noise's own; else it is so up to one factor, which the residuals supply
    correlated   (K or 1,) whether the channels' noise is correlated
    """

    view: ObservationModel
    spectrum: Spectrum
    covariance: Complex
    states: States | None
    noise_known: bool
    correlated: Bools

    @property
    def model(self) -> Model:
        """The rig."""
        return self.view.model

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What later stages have made of these very data, by name."""
        return {}

    def of_rig(self, model: Model) -> Prepared:
        """The same data of a rig with the same coordinates and inputs."""
        return replace(self, view=observation_model(model, self.spectrum.channels, self.spectrum.omega))

    def only(self, repeat: int) -> Prepared:
        """One of the repeats."""
        V = self.covariance if len(self.covariance) == 1 else self.covariance[repeat : repeat + 1]
        spectrum = replace(
            self.spectrum, amplitudes=self.spectrum.amplitudes[repeat : repeat + 1], moments=None
        )
        states = None if self.states is None else self.states.rows(np.array([repeat]))
        return replace(self, spectrum=spectrum, covariance=V, states=states)

    def scaled(self, factor: np.ndarray) -> Prepared:
        """With the noise's variances times `factor` (K,)."""
        V = self.covariance * factor[:, None, None, None]
        return replace(self, covariance=V, states=states_if_seen(self.view, self.spectrum, V))

    @property
    def seen_states(self) -> States:
        """`states`.  Raises DataError, which names what is not seen, where there are none."""
        if self.states is None:
            require_seen(self.view, self.spectrum)
            raise DataError("the channels do not show every coordinate and input", cure="use the method ml")
        return self.states


def prepare(model: Model, spectrum: Spectrum, *, moments: bool = False, states: bool = True) -> Prepared:
    """Weigh the channels, judge what is known of their noise and combine them; batch axes become K repeats.

    Second moments of the samples are kept only where `moments`; without `states` the channels are not combined.
    Raises DataError where exact channels contradict each other, or measure what the model has not.
    """
    flat = flattened(spectrum)
    if not moments and flat.moments is not None:
        flat = replace(flat, moments=None)
    known = flat.noise_known
    if not known and FITTED not in flat.noise:
        flat = with_unknown_noise(flat)
    view = observation_model(model, flat.channels, flat.omega)
    V = flat.covariance if known else working_covariance(view, flat)
    V = V if V.ndim == 4 else V[None]
    correlated = np.atleast_1d(channels_correlate(flat)) if known else np.ones(len(V), dtype=bool)
    if not correlated.all() and not is_diagonal(V):
        V = np.where(correlated[:, None, None, None], V, without_correlation(V))
    return Prepared(view, flat, V, states_if_seen(view, flat, V) if states else None, known, correlated)


def without_priors(model: Model) -> Model:
    """The model with its uncertain known values taken as exact."""
    if not np.any(model.prior_precision):
        return model
    return replace(model, elements=tuple(replace(element, sd=None) for element in model.elements))
