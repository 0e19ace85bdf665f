"""Noise with heavy tails: large errors count for less, as Student's distribution has them.

Lange, Little and Taylor (Journal of the American Statistical Association 84, 1989).  The data are replaced by what is
predicted and ψ(residual) / E[ψ′], where ψ is the slope of the log density: least squares of these pseudo-data lead to
the estimate that is sought, and their scatter is its uncertainty (Huber and Ronchetti, Robust Statistics, 2009, §7.8).
So conditioning, noise, intervals and verdict are those of normal noise.  Of whole records the residuals in time are
meant; of tables and dwells the amplitudes, which are normal anyway for a dwell of many samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.spectrum import LinesInTime, Spectrum, flattened
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_noise import residuals_of_records
from dashpot.estimate.likelihood.table_noise import with_residual_noise
from dashpot.estimate.method import Method
from dashpot.estimate.preparation import prepare
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel
from dashpot.notices import Notice

FREEDOMS = np.geomspace(1.2, 60.0, 40)  # degrees of freedom that are tried
FEWEST = 30  # errors of a channel that show its tails
TURNS = 6  # fits to pseudo-data at most


@dataclass(frozen=True)
class Tails:
    """Student's distribution of errors of `parts` real numbers each, `scale` relative to their standard deviation.

    gain: twice the log likelihood that it has more than the normal one.
    """

    parts: int
    freedom: float
    scale: float
    gain: float

    @staticmethod
    def of(u: Complex | Real, *, known: bool) -> Tails:
        """The likeliest for errors u (N,) in standard deviations of each part; `known`: these are stated."""
        parts = 2 if np.iscomplexobj(u) else 1
        q = np.abs(u) ** 2
        square = 1.0 if known else float(np.mean(q)) / parts
        normal = -0.5 * float(np.sum(q)) / square - 0.5 * len(q) * parts * np.log(square)
        best = Tails(parts, np.inf, float(np.sqrt(square)), 0.0)
        # A variance that is stated is finite: that of two degrees of freedom or fewer is not
        for nu in FREEDOMS[FREEDOMS >= 2.1] if known else FREEDOMS:
            if known:
                square = (nu - 2) / nu
            else:
                square = float(np.median(q)) / parts
                for _ in range(50):  # EM: each step raises the likelihood
                    square = float(np.mean((nu + parts) / (nu + q / square) * q)) / parts
            logs = gammaln((nu + parts) / 2) - gammaln(nu / 2) - 0.5 * parts * np.log(nu / 2 * square)
            student = len(q) * logs - 0.5 * (nu + parts) * float(np.sum(np.log1p(q / (nu * square))))
            if 2 * (student - normal) > best.gain:
                best = Tails(parts, float(nu), float(np.sqrt(square)), 2 * float(student - normal))
        return best

    @property
    def variance(self) -> float:
        """Of a pseudo-error, where that of the error is 1 and Student's distribution holds."""
        n, nu = self.parts, self.freedom
        return self.scale**2 * (nu + n + 2) / (nu + n) if np.isfinite(nu) else 1.0

    def pseudo(self, u: Complex | Real) -> Complex | Real:
        """The errors u (N,) as least squares are to see them."""
        n, nu = self.parts, self.freedom
        if not np.isfinite(nu):
            return u
        scaled = u / self.scale
        q = np.abs(scaled) ** 2
        slope = float(np.mean((nu + n) * (1 / (nu + q) - 2 / n * q / (nu + q) ** 2)))
        weights: Real = self.scale * (nu + n) / (nu + q) / slope
        return weights * scaled


def with_heavy_tails(model: Model, spectrum: Spectrum, method: Method) -> tuple[Spectrum, Method]:
    """The spectrum with its noise, as `with_residual_noise`; as pseudo-data where the rig's noise has heavy tails.

    Of linear rigs and single tests; others are taken for normal.
    """
    plain = with_residual_noise(model, spectrum, method)
    weighed = method.traits.weighted or method.traits.maximum_likelihood
    if model.distribution == "normal" or spectrum.batch or len(model.nonlinear) or not weighed:
        return plain
    known, begun = plain
    # Standard deviation of each part of the noise, (lines, channels); inf where there is none
    variance = np.diagonal(known.covariance, axis1=-2, axis2=-1).real / 2
    sizes, tails = np.sqrt(np.where(variance > 0, variance, np.inf)), dict[tuple[int, int], Tails]()
    for turn in range(TURNS):
        data = prepare(model, flattened(known))
        solution = begun.solve(data)
        sign = data.spectrum.signs(solution.signs)
        left, _ = residuals_of_records(data.view, measured(data), solution.theta, sign)
        predicted = known.amplitudes - left
        error = spectrum.amplitudes - predicted
        if turn == 0:
            tails = {
                each.key: Tails.of(each.u, known=spectrum.noise_known)
                for each in _errors(spectrum, error, sizes, data.view)
            }
            # "auto" asks for a gain in twice the log likelihood of p = 0.001: χ² with one degree of freedom.
            least = 10.8 if model.distribution == "auto" else 0.0
            tails = {key: each for key, each in tails.items() if each.gain > least}
            if not tails:
                return plain
        pseudo, root = predicted + error, np.ones(error.shape)
        for each in _errors(spectrum, error, sizes, data.view):
            if each.key in tails:
                at = each.lines, each.channel
                pseudo[at] = predicted[at] + each.amplitudes(tails[each.key])
                if spectrum.noise_known:  # else the scatter of the pseudo-data tells it
                    root[at] = np.sqrt(tails[each.key].variance)
        moved = np.abs(pseudo - known.amplitudes) / sizes
        V = spectrum.covariance * root[:, :, None] * root[:, None, :]
        known, begun = with_residual_noise(model, replace(spectrum, amplitudes=pseudo, covariance=V), method)
        if np.nanmax(moved) < 1e-3:  # of the noise
            break
    names = {spectrum.channels[c].name: tails[number, c].freedom for number, c in tails}
    notes = [
        Notice(
            "heavy_tails",
            f"the noise of {name} has heavy tails (Student's t, {freedom:.2g} degrees of freedom): "
            "large errors are given less weight",
            (name,),
        )
        for name, freedom in names.items()
    ]
    return replace(known, notes=(*known.notes, *notes)), begun


@dataclass(frozen=True)
class _Errors:
    """Errors u (N,) of one channel in standard deviations of its noise, which are `size`, at lines (L,) of a spectrum.

    number: the stretch that is a whole record, whose errors are those of its samples; −1 for all settled lines.
    """

    number: int
    channel: int
    lines: Ints
    u: Complex | Real
    size: Real | float
    record: LinesInTime | None = None

    @property
    def key(self) -> tuple[int, int]:
        """By which tails are kept."""
        return self.number, self.channel

    def amplitudes(self, tails: Tails) -> Complex:
        """The pseudo-errors of the lines, (L,)."""
        errors = tails.pseudo(self.u) * self.size
        return errors.astype(np.complex128) if self.record is None else self.record.amplitudes(errors.real)


def _errors(spectrum: Spectrum, error: Complex, size: Real, view: ObservationModel) -> Iterator[_Errors]:
    """The errors (lines, channels) of each record, and of all settled lines, by channel; size (lines, channels) of the
    noise of each part of a line."""
    records = spectrum.records
    settled = np.flatnonzero(~np.isin(spectrum.stretch, records))
    for c in np.flatnonzero(~view.inputs_alone).tolist():
        told = settled[np.isfinite(size[settled, c]) & np.isfinite(error[settled, c])]
        if len(told) >= FEWEST:
            yield _Errors(-1, c, told, error[told, c] / size[told, c], size[told, c])
        for number in records:
            at = spectrum.in_time(number)
            history = at.history_of(error[at.lines, c])
            sd = float(np.sqrt(np.mean(history**2)))
            if sd > 0 and len(history) >= FEWEST and np.all(np.isfinite(size[at.lines, c])):
                yield _Errors(number, c, at.lines, history / sd, sd, at)
