"""What errors of the known parameters do to the estimates (the paper's complaint about its own method, answered).

At the estimate the slope of χ² is zero, g(θ̂, p) = 0; a known parameter that is wrong by δp moves θ̂ by
−(∂g/∂θ)⁻¹ (∂g/∂p) δp.  Both slopes are taken of g itself, not of its Gauss-Newton part: residuals count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real, freeze
from dashpot.check.profile import chi2_surface
from dashpot.data.spectrum import Spectrum
from dashpot.errors import UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.method import Method
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.numerics.small_systems import solve_scaled

STEP = 1e-4  # of a parameter, in differences of the slope and between identifications


@dataclass(frozen=True)
class KnownErrors:
    """dθ̂/dp of each unknown by each known parameter, (known, unknowns), in their units.

    Known exactly (`stated` NaN) or with a standard deviation (`stated`), whose value then counts as the prior's.
    """

    known: tuple[str, ...]
    known_units: tuple[str, ...]
    known_values: Real
    stated: Real
    unknowns: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    slopes: Real

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def relative(self) -> Real:
        """Change of each unknown in per cent for 1 % of each known parameter, (known, unknowns)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            change: Real = self.slopes * self.known_values[:, None] / self.values
        return change


def known_errors(
    model: Model, spectrum: Spectrum, estimate: Estimate, method: Method | None = None
) -> KnownErrors:
    """How errors of the known parameters move the estimate of one spectrum (no batch axes).

    For methods that do not sit on the bound (`method`, as given to `identify`) the slopes are differences between two
    identifications for each known parameter.  Raises UsageError where nothing is known.
    """
    exact = [e for e in model.elements if e.value is not None and e.sd is None and e.value != 0]
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    uncertain = [u for u in view.unknowns if u.sd is not None]
    if not exact and not uncertain:
        raise UsageError("no parameter of the rig is known", cure="there is nothing whose error could matter")
    rows: list[tuple[str, str, float | None, float | None]] = [
        *((e.name, model.unit(e), e.value, np.nan) for e in exact),
        *((u.name, u.unit, u.prior, u.sd) for u in uncertain),
    ]
    known, units, values, stated = zip(*rows, strict=True)
    chosen = automatic(model, spectrum) if method is None else method
    if chosen.traits.maximum_likelihood:
        slopes = _from_slopes(model, spectrum, estimate, known[: len(exact)], known[len(exact) :])
    else:
        slopes = np.array([_by_repetition(model, spectrum, chosen, name) for name in known])
    return KnownErrors(
        known, units, np.array(values, dtype=float), np.array(stated, dtype=float), estimate.names, estimate.units,
        estimate.values, slopes,
    )  # fmt: skip


def _from_slopes(
    model: Model, spectrum: Spectrum, estimate: Estimate, exact: tuple[str, ...], uncertain: tuple[str, ...]
) -> Real:
    base = chi2_surface(model, spectrum, estimate)
    freed = replace(
        model,
        elements=tuple(replace(e, value=None) if e.name in exact else e for e in model.elements),
    )
    prepared = prepare(freed, spectrum)
    view = prepared.view
    # What whole records and nonlinear elements add follows the freed rig; the weights are those of the fit.
    data = replace(measured(prepared), W=base.data.W, root=base.data.root)
    values = {e.name: e.value for e in model.elements} | dict(zip(base.view.names, base.psi[0], strict=True))
    psi = np.array([values[name] for name in view.names], dtype=float)
    size = np.where(psi == 0, 1.0, np.abs(psi))
    delays = np.arange(len(psi)) >= len(psi) - view.delays
    step = STEP * np.where(delays, 1 / np.max(view.omega), size)
    moved = np.concatenate([psi + np.diag(step), psi - np.diag(step)])
    sign = np.repeat(base.sign[:1], len(moved), axis=0)
    gradient = local(view, data, moved, sign).gradient
    curvature = -(gradient[: len(psi)] - gradient[len(psi) :]) / (2 * step[:, None])  # [by, of]
    index = {name: i for i, name in enumerate(view.names)}
    columns = [index[name] for name in base.view.names]
    H = curvature[columns][:, columns]
    H = (H + H.T) / 2
    sides = [-curvature[index[name]][columns] for name in exact]
    for name in uncertain:
        j = base.view.names.index(name)
        side = np.zeros(len(columns))
        side[j] = base.view.prior_precision[j]
        sides.append(side)
    return np.array([solve_scaled(H, side) for side in sides])


def _by_repetition(model: Model, spectrum: Spectrum, method: Method, name: str) -> Real:
    """The slope by one known parameter, from two identifications."""
    ends, value = [], next(e.value for e in model.elements if e.name == name)
    assert value is not None
    for sign in (1.0, -1.0):
        elements = tuple(
            replace(e, value=value * (1 + sign * STEP)) if e.name == name else e for e in model.elements
        )
        ends.append(identify(replace(model, elements=elements), spectrum, method).values)
    return (ends[0] - ends[1]) / (2 * STEP * value)
