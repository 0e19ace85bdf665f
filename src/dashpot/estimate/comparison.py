"""The same data through several methods, side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from dashpot.data.modal_data import ModalData
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.method import Method
from dashpot.estimate.result import FORMAT, Estimate
from dashpot.io.json_document import data_frame, from_json, to_json
from dashpot.model.network import Model
from dashpot.shorthand import Printable

MODAL = "modal"  # the row of the estimate from measured modes


@dataclass(frozen=True)
class Comparison(Printable):
    """Estimates by method, in the order requested, and why other methods gave none.

    model         name of the rig
    names, units  of its unknowns
    estimates     by the name of the method
    refused       why a method gave none, by its name
    truth         true values of the unknowns, SI units, as far as known
    most_likely   the estimates that maximise the likelihood, the one that uses most of the data first
    """

    model: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    refused: Mapping[str, DashpotError]
    truth: Mapping[str, float] = field(default_factory=dict)
    most_likely: tuple[str, ...] = ()

    def bound_sd(self, name: str) -> float | None:
        """The Cramér-Rao bound of an unknown, from the best informed estimate of the test's own data."""
        bounds = [e[name].bound_sd for which, e in self.estimates.items() if which != MODAL]
        bounds = [bound for bound in bounds if bound > 0]
        return min(bounds) if bounds else None

    def centre(self, name: str) -> float | None:
        """The true value of an unknown, SI units, or else the most likely one; None if no method gives that."""
        if name in self.truth:
            return self.truth[name]
        return self.estimates[self.most_likely[0]][name].value if self.most_likely else None

    def to_dataframe(self) -> Any:
        """A pandas DataFrame with a row for each unknown: value and sd by each method, SI units.

        Raises UsageError without pandas (extra "analysis").
        """
        columns: dict[str, Any] = {"parameter": list(self.names), "unit": list(self.units)}
        for method, estimate in self.estimates.items():
            columns[method] = [estimate[name].value for name in self.names]
            columns[f"{method}_sd"] = [estimate[name].sd for name in self.names]
        return data_frame(columns, "parameter")

    def to_json(self) -> str:
        """Every estimate as in its own JSON, the reasons why others failed, and the true values."""
        content = {
            "dashpot": FORMAT,
            "model": self.model,
            "methods": {name: from_json(estimate.to_json()) for name, estimate in self.estimates.items()},
            "refused": {name: str(error) for name, error in self.refused.items()},
            "truth": dict(self.truth),
        }
        return to_json(content)


def compare(
    model: Model,
    spectrum: Spectrum | None,
    methods: Mapping[str, Method],
    *,
    modal: ModalData | None = None,
    refused: Mapping[str, DashpotError] | None = None,
    truth: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Identify with every method; measured modes, where given, come last.

    `refused`: methods that were ruled out before, with the reason.
    A method that the data do not suit is named with its reason.  Raises its error where no method gives anything, and
    UsageError if `truth` names what is not an unknown.
    """
    names = model.unknown_names
    true: Mapping[str, float] = {} if truth is None else truth
    for name in true:
        if name not in names:
            raise UsageError(
                f"{name} is not an unknown of this rig", cure=f"its unknowns are {', '.join(names)}"
            )
    jobs: dict[str, Callable[[], Estimate]] = {}
    if spectrum is not None:
        jobs |= {name: partial(identify, model, spectrum, method) for name, method in methods.items()}
    if modal is not None:
        from dashpot.estimate.modal import identify_modal  # loads scipy.optimize

        jobs[MODAL] = partial(identify_modal, model, modal, seed=seed)
    ruled_out = {} if refused is None else dict(refused)
    if not jobs and not ruled_out:
        raise UsageError("there is nothing to compare", cure="give data, measured modes, or both")
    estimates: dict[str, Estimate] = {}
    for done, (row, job) in enumerate(jobs.items()):
        try:
            estimates[row] = job()
        except DashpotError as error:
            ruled_out[row] = error
        if progress is not None:
            progress(done + 1, len(jobs))
    if not estimates:
        raise next(iter(ruled_out.values()))
    # Those that maximise the likelihood: of all channels, of the equation of motion, on a cone
    traits = {row: method.traits for row, method in methods.items() if row in estimates}
    there = [row for row in traits if traits[row].maximum_likelihood]
    there.sort(key=lambda row: (not traits[row].by_output, traits[row].definite))
    units = model.unknown_units
    return Comparison(model.name, names, units, estimates, ruled_out, true, tuple(there))
