"""How the command identify comes to its estimate: from data together, from histories, or part by part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dashpot.data.conditioning.used_dwells import UsedDwell
    from dashpot.data.record import Record
    from dashpot.data.spectrum import Spectrum
    from dashpot.errors import ConvergenceError, DashpotError, IdentifiabilityError
    from dashpot.estimate.result import Estimate
    from dashpot.model.network import Model
    from dashpot.model.rigfile import Rig


@dataclass(frozen=True)
class Search:
    """How an estimate is looked for: rig file, method and its options."""

    path: str
    chosen: str
    positive: bool
    seed: int
    quiet: bool


@dataclass(frozen=True)
class Identified:
    """An estimate and what it was made from, as far as that can be shown; `in_time`: from histories, not a spectrum."""

    rig: Rig
    estimate: Estimate
    spectrum: Spectrum | None = None
    untried: tuple[str, ...] = ()
    dwells: tuple[UsedDwell, ...] = ()
    in_time: bool = False


def identified_in_parts(
    search: Search, rig: Rig, data: tuple[str, ...], conditioning: dict[str, Any], workers: int | None,
    dask: str | None,
) -> Identified:  # fmt: skip
    """From every file by itself, merged."""
    from dashpot.app.in_parts import estimate_in_parts, treatment_from

    treatment = treatment_from(rig, search.chosen, search.positive, search.seed, conditioning, search.quiet)
    return Identified(rig, estimate_in_parts(search.path, rig, data, treatment, workers, dask, search.quiet))


def identified_together(
    search: Search, rig: Rig, data: tuple[str, ...], conditioning: dict[str, Any], used: tuple[float, float],
    with_dwells: bool,
) -> Identified:  # fmt: skip
    """From all files together, of whose records the share `used` counts."""
    from dashpot.app.data_files import measured_data, part_of, read_files

    reading = read_files(rig, data, conditioning, search.quiet)
    if len(rig.model.nonlinear) and reading.continuous:
        records = part_of(reading, used).records
        estimate = _of_whole_records(search.path, rig, records, conditioning, search.chosen, search.quiet)
        return Identified(rig, estimate, in_time=True)
    measured = measured_data(
        rig,
        reading,
        conditioning,
        search.quiet,
        moments_for=[search.chosen],
        part=used,
        with_dwells=with_dwells,
    )
    estimate, spectrum = _estimated(search, rig, measured.spectrum)
    return Identified(rig, estimate, spectrum, measured.untried, measured.dwells)


def _of_whole_records(
    path: str, rig: Rig, records: Sequence[Record], options: dict[str, Any], chosen: str, quiet: bool
) -> Estimate:
    """The estimate from continuous records of a nonlinear rig, examined."""
    from dataclasses import replace

    from dashpot.app.data_files import conditioning_from, with_noise_record
    from dashpot.app.progress import progress
    from dashpot.check.diagnosis.record_channels import require_sound_channels
    from dashpot.check.record_verdict import examined_records, explained
    from dashpot.errors import IdentifiabilityError, UsageError
    from dashpot.estimate.nonlinear.whole_record import fit_records

    if options.get("record_band") is not None:
        cause = "--band chooses frequencies, and whole records of nonlinear rigs are followed in time"
        raise UsageError(cause, cure="leave it out")
    wanted = None if chosen == "auto" else chosen
    still = with_noise_record(conditioning_from(options), rig, options, quiet).still
    require_sound_channels(rig.model, records)
    with progress("identify", quiet) as moved:
        fitted = fit_records(rig.model, records, wanted, still=still, progress=moved)
        try:
            estimate = fitted.estimate()
        except IdentifiabilityError as error:
            raise explained(error, rig.model, records) from error
    with progress("examine", quiet):
        return replace(examined_records(rig.model, records, estimate, fitted), rig=path)


def _estimated(search: Search, rig: Rig, spectrum: Spectrum) -> tuple[Estimate, Spectrum]:
    """The estimate, examined, and the amplitudes with the noise that it rests on.

    Where the method was not `chosen` by name, another takes its place if it finds no answer.
    """
    from dataclasses import replace

    from dashpot.app.progress import progress
    from dashpot.check.diagnosis.diagnose import examined
    from dashpot.errors import ConvergenceError, IdentifiabilityError
    from dashpot.estimate.automatic import identify_with_noise, suited_method
    from dashpot.present.text.identifiability import require_identifiable

    seed, wanted = search.seed, None if search.chosen == "auto" else search.chosen
    method = suited_method(wanted, rig.model, spectrum, seed=seed, positive=search.positive)
    require_identifiable(rig.model, spectrum.channels, search.path, spectrum)
    with progress("identify", search.quiet) as moved:
        try:
            estimate, spectrum = identify_with_noise(
                rig.model, spectrum, method, chosen=wanted is not None, seed=seed, progress=moved
            )
        except (IdentifiabilityError, ConvergenceError) as error:
            raise _explained(error, rig.model, spectrum, seed) from error
    with progress("examine", search.quiet):
        return replace(examined(rig.model, spectrum, estimate, seed=seed), rig=search.path), spectrum


def _explained(
    error: IdentifiabilityError | ConvergenceError, model: Model, spectrum: Spectrum, seed: int
) -> DashpotError:
    """The error, with what would make the rig fit where something does."""
    from dashpot.check.diagnosis.diagnose import diagnose
    from dashpot.check.diagnosis.wording import with_likely_causes

    return with_likely_causes(error, diagnose(model, spectrum, seed=seed)[:1])
